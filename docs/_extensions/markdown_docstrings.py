"""Docstrings in Markdown: tables, formulas, headings and code in backticks, beside Google's sections.

Napoleon makes field lists of the sections. What it returns is handed to MyST, which knows field lists as well. Types
are shown as the source has them, because `NDArray[np.float64]` says more than what it stands for.
"""

from __future__ import annotations

import inspect
import re
from dataclasses import is_dataclass
from typing import Any

from docutils import nodes
from myst_parser.parsers.sphinx_ import MystParser
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, GoogleDocstring
from sphinx.util.docutils import SphinxDirective, new_document

RUBRIC = re.compile(r"^\.\. rubric:: (.*)$")

HEADING = re.compile(r"^#{2,} (.*)$")

ARGUMENT = re.compile(r"^:(?:param|ivar) \\?(\*{0,2})([\w\\]+): ?(.*)$")


class MarkdownDocstring(SphinxDirective):
    """The directive `markdown-docstring`: its content is parsed as Markdown."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Parse the content; returns what it consists of."""
        document = new_document(self.get_source_info()[0], self.state.document.settings)
        MystParser().parse("\n".join(self.content), document)
        return document.children


def as_markdown(lines: list[str]) -> list[str]:
    """Convert headings, examples and what Napoleon writes otherwise than Markdown does; returns the new lines."""
    out: list[str] = []
    example = False
    for line in lines:
        prompt = line.lstrip().startswith((">>>", "..."))
        if prompt and not example:
            out.append("```python")
            example = True
        elif example and not line.strip():
            out.append("```")
            example = False
        if match := (RUBRIC.match(line) or HEADING.match(line)):
            out += ["```{rubric} " + match[1], "```"]
        else:
            out.append(line.strip() if example else line)
    return [*out, "```"] if example else out


def with_types(lines: list[str], what: str, described: Any) -> list[str]:
    """Add the types of arguments and of what is returned, from the annotations."""
    called = described.__init__ if what in {"class", "exception"} and not is_dataclass(described) else described
    types = annotations(described) | annotations(called)
    out: list[str] = []
    for line in lines:
        match = ARGUMENT.match(line)
        name = match[2].replace("\\", "") if match else ""
        if match and is_dataclass(described):
            # The fields of a dataclass are its arguments.
            line = line.replace(":ivar ", ":param ", 1)
        out.append(line)
        if match and types.get(name):
            kind = "type" if line.startswith(":param") else "vartype"
            out.insert(-1, f":{kind} {match[1]}{name}: `{types[name]}`")
    returned = next((index for index, line in enumerate(out) if line.startswith(":returns:")), None)
    if returned is not None and types.get("return"):
        # Behind what is said of it, which is as far as lines are indented.
        end = next((index for index in range(returned + 1, len(out)) if out[index][:1].strip()), len(out))
        out.insert(end, f":rtype: `{types['return']}`")
    return out


def annotations(described: Any) -> dict[str, str]:
    """Annotations of a function, or of a class and those that it inherits from, as they are written."""
    classes = reversed(described.__mro__) if inspect.isclass(described) else [inspect.unwrap(described)]
    return {name: str(text) for each in classes for name, text in getattr(each, "__annotations__", {}).items()}


def convert(_app: Sphinx, what: str, name: str, described: Any, _options: Any, lines: list[str]) -> None:
    """Wrap a docstring in the directive."""
    if any(line.strip() for line in lines):
        # Of an attribute or a property, Napoleon takes what is before a colon for a type, which nobody means here.
        kind = "method" if what in {"attribute", "property"} else what
        fields = GoogleDocstring(lines, Config(napoleon_use_ivar=True), what=kind, name=name, obj=described).lines()
        text = with_types(as_markdown(fields), what, described)
        lines[:] = [".. markdown-docstring::", "", *(f"   {line}" for line in text), ""]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.add_directive("markdown-docstring", MarkdownDocstring)
    app.connect("autodoc-process-docstring", convert)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
