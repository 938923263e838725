"""Formulas as MathML, which browsers show by themselves: without scripts, fonts or a network, in light and dark."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx


def write_formula(translator: Any, node: nodes.math) -> None:
    """Write a formula in the text."""
    translator.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def write_displayed_formula(translator: Any, node: nodes.math_block) -> None:
    """Write a formula that has lines of its own."""
    translator.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


def from_github(_: Sphinx, __: str, source: list[str]) -> None:
    """Take GitHub's dollar signs with backticks as plain ones."""
    source[0] = re.sub(r"\$`([^`\n]+)`\$", r"$\1$", source[0])


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_html_math_renderer("mathml", (write_formula, None), (write_displayed_formula, None))
    app.connect("source-read", from_github)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
