"""viser's page with this package's title, icon and script."""

from __future__ import annotations

import re
from urllib.parse import quote

TITLE = "Spatula"

ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32">'
    '<path fill="#d48b87" d="M2 30a14 14 0 0 1 28 0z"/>'
    '<path fill="#3b82d6" d="M14 2h4v12h5v6H9v-6h5z"/></svg>'
)
"""An organ pressed by a spatula."""


def dressed(document: bytes, script: str) -> bytes:
    """Insert a script before all others, and replace title and icon.

    Args:
        document: viser's page.
        script: Path of the script on the server.

    Raises:
        ValueError: If the page has no head element.
    """
    head, found, rest = document.partition(b"<head>")
    if not found:
        raise ValueError("the page has no head")
    icon = f'<link rel="icon" href="data:image/svg+xml,{quote(ICON)}">'.encode()
    # If another version of viser has no title or icon, its page stays as it is.
    rest = re.sub(rb"<title>[^<]*</title>", f"<title>{TITLE}</title>".encode(), rest, count=1)
    rest = re.sub(rb'<link\s+rel="icon"[^>]*>', icon, rest, count=1)
    return b"".join([head, found, f'<script src="{script}"></script>'.encode(), rest])
