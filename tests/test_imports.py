"""Which module may import which: a layer builds only on the layers below it, and there are no import cycles.

Imports inside functions and for type checking alone count, too: they do not make a module easier to understand.
"""

from __future__ import annotations

from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[1]

LAYERS = (
    {"cli"},
    {"demo", "learning", "teleop"},
    {"data", "policies"},
    {"definitions", "extending"},
    {"envs", "naming"},
    {"render", "sim"},
    {"tasks"},
    {"contact"},
    {"scenes"},
    {"anatomy"},
    {"geometry"},
    {
        "engines",
        "installing",
        "pressure_limits",
        "printing",
        "processes",
        "threads",
        "_bullet",
        "_kernels",
        "_warnings",
        "arrays",
        "changes",
        "files",
    },
    {"_compilation", "_kernel_cache"},
)
"""Modules and packages of `spatula_env`, from top to bottom. Each may import what is in layers below its own."""

SAME_LAYER = {("envs", "naming"), ("naming", "envs")}
"""Allowed imports within a layer, (importer, imported): `naming` needs the classes of environments, and `envs` looks up
environments by name."""

CIRCLES: set[frozenset[str]] = set()
"""Known import cycles. None may be added; remove a cycle from here when it has been broken."""

PACKAGES = ("spatula_env", "agents", "benchmarks")


@pytest.fixture(scope="module")
def graphs() -> dict[str, grimp.ImportGraph]:
    """The graph of each package, by its name."""
    return {name: grimp.build_graph(name, cache_dir=None) for name in PACKAGES}


def arrows(graph: grimp.ImportGraph) -> dict[str, set[str]]:
    return {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}


def circles(imported: dict[str, set[str]]) -> set[frozenset[str]]:
    """Import cycles, as sets of modules that import each other."""
    imported = {module: set(others) for module, others in imported.items()}
    found = set()
    while True:
        try:
            TopologicalSorter(imported).prepare()
        except CycleError as error:
            path = error.args[1]
            found.add(frozenset(path))
            # Listed the other way round: each is imported by the next.
            imported[path[1]].discard(path[0])
        else:
            return found


def layer_of(name: str) -> int:
    """How far from the top."""
    return next(number for number, layer in enumerate(LAYERS) if name in layer)


def test_every_module_has_one_layer(graphs: dict[str, grimp.ImportGraph]) -> None:
    there = {name.partition(".")[2] for name in graphs["spatula_env"].find_children("spatula_env")}
    listed = [name for layer in LAYERS for name in layer]
    assert sorted(listed) == sorted(there)


def test_no_arrow_runs_up_or_aside(graphs: dict[str, grimp.ImportGraph]) -> None:
    wrong = []
    for module, others in arrows(graphs["spatula_env"]).items():
        for other in others:
            one, two = (f"{name}.".split(".")[1] for name in (module, other))
            # The package itself registers the environments, and has names of `scenes` and `sim`.
            if one and two and one != two and (one, two) not in SAME_LAYER and layer_of(two) <= layer_of(one):
                wrong.append(f"{module} imports {other}")
    assert wrong == []


def test_nothing_goes_round_in_a_circle(graphs: dict[str, grimp.ImportGraph]) -> None:
    found = set().union(*(circles(arrows(graph)) for graph in graphs.values()))
    assert found - CIRCLES == set(), "modules import each other"
    assert CIRCLES - found == set(), "these circles are gone: take them out of CIRCLES"


def test_circles_are_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": set()}) == set()
    assert circles({"a": {"b"}, "b": {"a", "c"}, "c": {"d"}, "d": {"c"}}) == {frozenset("ab"), frozenset("cd")}


@pytest.mark.parametrize("name", ["agents", "benchmarks", "tests"])
def test_what_is_installed_needs_no_checkout(name: str) -> None:
    wrong = [
        file.relative_to(ROOT)
        for file in (ROOT / "spatula_env").rglob("*.py")
        for line in file.read_text(encoding="utf-8").splitlines()
        if line.strip().startswith((f"import {name}", f"from {name}"))
    ]
    assert wrong == []
