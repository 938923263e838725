"""The code in docs/extending.md runs as pasted: each section by itself, in a folder of its own."""

from __future__ import annotations

import importlib
import re
import sys
from dataclasses import fields, replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from spatula_env import engines, envs, geometry
from spatula_env.geometry import seed_sphere

PAGE = (Path(__file__).parents[1] / "docs" / "extending.md").read_text(encoding="utf-8")
SECTIONS = {
    title: re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    for title, text in re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", PAGE, flags=re.MULTILINE | re.DOTALL)
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    modules, ids, known = set(sys.modules), set(gymnasium.registry), set(engines.ENGINES)
    yield tmp_path
    for name in set(sys.modules) - modules:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]
    for registry, before in ((gymnasium.registry, ids), (engines.ENGINES, known)):
        for added in set(registry) - before:
            del registry[added]


def test_there_is_a_section_for_each_kind_of_thing():
    assert list(SECTIONS) == ["Add a task", "Add an organ", "Add a tool", "Add an engine"]
    assert all(SECTIONS.values())


@pytest.mark.parametrize("title", SECTIONS)
def test_a_section_runs_as_pasted(title, folder, capsys):
    for index, code in enumerate(SECTIONS[title]):
        if "load_organ" in code:
            pytest.importorskip("trimesh", reason="surfaces are read with trimesh: the extra mesh is not installed")
        file = re.match(r"# (\w+\.py)\n", code)
        if file:
            (folder / file[1]).write_text(code, encoding="utf-8")
            importlib.invalidate_caches()
            continue
        exec(compile(code, f"extending.md, {title}, block {index}", "exec"), {"__name__": "__main__"})
        told = re.findall(r"print\(.*\)  # (.*)", code)
        assert told
        assert capsys.readouterr().out.splitlines() == told


NEEDS = "### What a task needs of an organ"
ROWS = {
    task: (kind, re.findall(r"`(\w+)`", needed))
    for task, kind, needed in re.findall(
        r"^\| (\w+) \| .*?`(\w+)` \| (.*) \|$", PAGE[PAGE.index(NEEDS) :], flags=re.MULTILINE
    )
}


def definition_with(task, **changes):
    """That of an environment, with other attributes of the organ, or another organ."""
    definition = getattr(envs, f"{task}Env").definition
    scene = definition.scene()
    organ = changes.pop("organ", None) or replace(scene.organs[0].organ, **changes)
    held = np.flatnonzero(organ.vertices[:, 2] < organ.vertices[:, 2].min() + 0.2)
    placed = replace(
        scene.organs[0], organ=organ, position=(0.0, 0.0, -organ.vertices[:, 2].min()), fixed_nodes=tuple(held.tolist())
    )
    return replace(definition, scene=lambda: replace(scene, organs=(placed,)))


def environment(task, definition):
    return type("Own", (getattr(envs, f"{task}Env"),), {"definition": definition})(engine="batch")


def test_every_task_has_a_row():
    assert set(ROWS) == {"Press", "Palpate", "Retract", "Clamp", "Fissure"}


@pytest.mark.parametrize("task", ROWS)
def test_a_task_takes_the_organs_that_its_row_names(task):
    kind, needed = ROWS[task]
    bare = definition_with(task, organ=seed_sphere())
    if kind == "Organ":
        environment(task, bare).close()
        return
    with pytest.raises(ValueError, match=f"organ must be a {kind}, because") as caught:
        environment(task, bare)
    told = str(caught.value)
    assert f"nodes of its {' and '.join(needed)}" in told
    assert f"the Organ {bare.scene().organs[0].organ.name!r}" in told
    # What the message refers to is there.
    assert f"'{NEEDS.removeprefix('### ')}'" in told


@pytest.mark.parametrize("task", [task for task, (kind, _) in ROWS.items() if kind != "Organ"])
def test_a_task_needs_what_its_row_says_and_nothing_else(task):
    kind, needed = ROWS[task]
    none = np.zeros(0, dtype=np.int32)
    parts = {each.name for each in fields(getattr(geometry, kind))} - {each.name for each in fields(geometry.Organ)}
    assert set(needed) < parts
    assert all(f"`{name}`" in PAGE for name in parts)
    nothing = {name: none for name in parts - set(needed) if not name.endswith("_height")}
    nothing = {name: (none, none) if name in ("walls", "lips", "flanks") else none for name in nothing}
    env = environment(task, definition_with(task, **nothing))
    whole = environment(task, definition_with(task))
    for made in (env, whole):
        made.reset(seed=3)
    action = np.full(env.action_space.shape, 0.3, dtype=np.float32)
    mine, theirs = (made.step(action) for made in (env, whole))
    np.testing.assert_array_equal(mine[0], theirs[0])
    assert mine[1] == theirs[1]
    for made in (env, whole):
        made.close()
