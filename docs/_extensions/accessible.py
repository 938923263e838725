"""Mends what axe, which checks accessibility, finds in pages of Sphinx and Furo."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

PARAMETERS = re.compile(r"<dl>\s*((?:<dd>.*?</dd>\s*)+)</dl>", re.DOTALL)
"""Parameters of a signature that has a line for each: a list of definitions without terms, which HTML forbids."""


def mend(_app: Sphinx, _page: str, _template: str, context: dict[str, Any], _document: Any) -> None:
    """Mend a page before it is written."""
    context["furo_navigation_tree"] = context.get("furo_navigation_tree", "").replace(
        'role="heading"', 'role="heading" aria-level="2"'
    )
    if "body" in context:
        context["body"] = PARAMETERS.sub(with_spans, context["body"])


def with_spans(found: re.Match[str]) -> str:
    """A list of parameters, its elements as spans."""
    text = found[1].replace("<dd>", '<span class="parameter">').replace("</dd>", "</span>")
    return f'<span class="parameters">{text}</span>'


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    # After Furo, which makes the navigation at the usual priority.
    app.connect("html-page-context", mend, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
