"""Links from names in code, such as `SpatulaEnv`, to the reference."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.nodes import make_refnode

TOO_COMMON = frozenset({"Path"})
"""Names that also mean something else."""


def link(app: Sphinx, document: nodes.document, docname: str) -> None:
    """Make a link of each name in code that leads to one public object."""
    found = names(app)
    for code in list(document.findall(nodes.literal)):
        entry = choose(found[code.astext()], docname)
        if entry is not None and not is_within(code, nodes.reference, addnodes.download_reference, nodes.title):
            code.replace_self(make_refnode(app.builder, docname, entry.docname, entry.node_id, code.deepcopy()))


def is_within(node: nodes.Node | None, *kinds: type[nodes.Node]) -> bool:
    """Whether a node is part of one of these kinds, such as a link."""
    while (node := node and node.parent) is not None:
        if isinstance(node, kinds):
            return True
    return False


def choose(entries: list[Any], docname: str) -> Any:
    """The object that a name stands for on a page: the one on this page, or else the only one; None if unclear."""
    here = [entry for entry in entries if entry.docname == docname]
    classes = [entry for entry in entries if entry.objtype in {"class", "exception"}]
    chosen = here or (classes if len(classes) == len(entries) else [])
    return chosen[0] if len(chosen) == 1 else None


def names(app: Sphinx) -> defaultdict[str, list[Any]]:
    """The objects of the reference by full name and, if they are not parts of a class, by the last part of it."""
    found: defaultdict[str, list[Any]] = defaultdict(list)
    for name, entry in app.env.domains.python_domain.objects.items():
        if entry.aliased:
            continue
        found[name].append(entry)
        last = name.rpartition(".")[2]
        if last not in TOO_COMMON and entry.objtype in {"class", "data", "exception", "function"}:
            found[last].append(entry)
    return found


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect("doctree-resolved", link)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
