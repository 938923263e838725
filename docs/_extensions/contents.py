"""The site's table of contents, made from the lists of links in docs/index.md, which GitHub shows as they are."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

CHILDREN = {"docs/tasks": "tasks/*", "docs/reference/index": "*"}
"""Pages with pages of their own: pattern of their names, relative to the page."""


def add_contents(app: Sphinx, docname: str, source: list[str]) -> None:
    """Append a hidden table of contents: of the landing page, with one part for each section, or of a page's own."""
    if docname == app.config.root_doc:
        for section in source[0].split("\n## ")[1:]:
            caption, _, text = section.partition("\n")
            pages = re.findall(r"^- \[([^\]]*)\]\(([\w./-]+)\.md\)", text, flags=re.MULTILINE)
            source[0] += toctree([f"{title} <{page}>" for title, page in pages], f":caption: {caption}")
    elif docname in CHILDREN:
        source[0] += toctree([CHILDREN[docname]], ":glob:")


def toctree(pages: list[str], option: str) -> str:
    """A directive for a hidden table of contents."""
    return "\n".join(["\n", "```{toctree}", ":hidden:", option, "", *pages, "```", ""])


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect("source-read", add_contents)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
