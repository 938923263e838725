"""viser's page, with a name, an icon and a script of its own."""

from __future__ import annotations

import re
from urllib.parse import quote

TITLE = "Spatula"

ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32">'
    '<path fill="#d48b87" d="M2 30a14 14 0 0 1 28 0z"/>'
    '<path fill="#3b82d6" d="M14 2h4v12h5v6H9v-6h5z"/></svg>'
)
"""An organ, and a spatula that presses it."""


def dressed(document: bytes, script: str) -> bytes:
    """A page with our script before everything else, and with our name and icon.

    Args:
        document: viser's.
        script: Where the script is.

    Raises:
        ValueError: If the page has no head.
    """
    head, found, rest = document.partition(b"<head>")
    if not found:
        raise ValueError("the page has no head")
    icon = f'<link rel="icon" href="data:image/svg+xml,{quote(ICON)}">'.encode()
    # A page without them, of another version of viser, just keeps its own.
    rest = re.sub(rb"<title>[^<]*</title>", f"<title>{TITLE}</title>".encode(), rest, count=1)
    rest = re.sub(rb'<link\s+rel="icon"[^>]*>', icon, rest, count=1)
    return b"".join([head, found, f'<script src="{script}"></script>'.encode(), rest])
