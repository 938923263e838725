"""The index of the site, which the search shows first, made from the table in docs/words.md."""

from __future__ import annotations

import os
import re
from functools import cache
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

PAGE = "docs/words"


def add_entries(app: Sphinx, document: nodes.document) -> None:
    """Add the entries that lead to the page that has been read: for the search, and for the index."""
    docname = app.env.current_document.docname
    anchors = app.env.metadata[docname].get("myst_slugs", {})
    entries: list[tuple[str, str, str, str, None]] = []
    for word, page, anchor in rows(str(app.env.doc2path(PAGE))):
        # A word that leads to an anchor that is not there is a dead link, of which MyST warns.
        if page == docname and (not anchor or anchor in anchors):
            entries.append(("single", word, anchors[anchor][1] if anchor else "", "main", None))
    document.insert(0, addnodes.index(entries=entries))
    app.env.domains.index_domain.entries.setdefault(docname, []).extend(entries)


@cache
def rows(path: str) -> list[tuple[str, str, str]]:
    """Each word with a page and an anchor to which it leads."""
    found = []
    for words, links in re.findall(
        r"^\| ([^|]*?) \| ([^|]*?) \|$", Path(path).read_text(encoding="utf-8"), re.MULTILINE
    ):
        for target, anchor in re.findall(r"\]\(([^)#]*)\.md#?([^)]*)\)", links):
            page = os.path.normpath(os.path.join(os.path.dirname(PAGE), target)).replace(os.sep, "/")
            found += [(word, page, anchor) for word in words.split(", ")]
    return found


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect("doctree-read", add_entries)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
