"""The benchmark of growth: exponents are right, it measures what it claims to, and exceeded limits are reported."""

from __future__ import annotations

import copy
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.growth import __main__ as command
from benchmarks.growth import fitting, judging, killing, memory, sizes
from benchmarks.growth.sizes import Sizes
from spatula_env import Simulation, engines

SMALL = Sizes(worlds=(1, 2), organ_nodes=(162, 328), tool_edges=(2, 4), tools=(1, 2), pixels=(16, 32), calls=2)


# Figures -----------------------------------------------------------------------------------------------------------


@given(st.floats(-1.0, 3.0), st.floats(1e-3, 1e3), st.sets(st.integers(1, 10_000), min_size=2, max_size=8))
def test_the_exponent_of_a_power_is_that_power(power: float, factor: float, found: set[int]) -> None:
    ordered = sorted(found)
    assert fitting.exponent(ordered, [factor * size**power for size in ordered]) == pytest.approx(power, abs=1e-6)


def test_the_larger_half_shows_what_is_constant_elsewhere() -> None:
    row = fitting.growth({size: 100.0 + size**2 for size in (1, 10, 100, 1000)}, "s", "things")
    assert row["sizes"] == [1, 10, 100, 1000]
    assert row["exponent"] < 1.6 < 1.9 < row["last_exponent"] < 2.01
    assert fitting.growth({1: 1.0, 10: 10.0}, "s", "things")["last_exponent"] == 1.0


def curve(power: float, over: str = "things") -> dict[str, Any]:
    return fitting.growth({size: float(size) ** power for size in (1, 10, 100)}, "s", over)


def figures() -> dict[str, Any]:
    """Of a run in which all is well."""
    found: dict[str, Any] = {}
    for path, limit in judging.EXPONENTS.items():
        put(found, path, curve(limit - 0.05, path[-1]))
    for path, limit in {**judging.LIMITS, **judging.COUNTS}.items():
        put(found, path, limit)
    put(found, ("datasets", "minari"), {"whole": True})
    found["left"] = {"batch closed": {**judging.LEFT}}
    found["long"] = {"batch": {**judging.LONG}}
    return found


def put(found: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    for name in path[:-1]:
        found = found.setdefault(name, {})
    found[path[-1]] = value


def test_all_is_well() -> None:
    verdict = judging.judge(figures())
    assert all(row["passed"] for row in verdict.values())
    count = len(judging.EXPONENTS) + len(judging.LIMITS) + len(judging.COUNTS) + 1 + len(judging.LEFT) + 1
    assert len(verdict) == count
    assert judging.judge({"sizes": figures()["sizes"]}).keys() < verdict.keys()
    assert judging.judge({}) == {}


@pytest.mark.parametrize(
    ("path", "value"),
    [
        *((path, curve(limit + 0.02)) for path, limit in judging.EXPONENTS.items()),
        *((path, 1.01 * limit) for path, limit in judging.LIMITS.items()),
        *((path, 1) for path in judging.COUNTS),
        (("datasets", "minari"), {"whole": False}),
        *((("left", "batch closed", name), limit + 1) for name, limit in judging.LEFT.items()),
        (("long", "batch", "growth"), 5.1),
    ],
    ids=str,
)
def test_what_is_too_much_is_told(path: tuple[str, ...], value: Any) -> None:
    bad = copy.deepcopy(figures())
    put(bad, path, value)
    assert sum(not row["passed"] for row in judging.judge(bad).values()) == 1


# What is measured --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2, 3])
def test_all_tools_press_alike(count: int) -> None:
    scene = sizes.with_tools(count)
    simulation = Simulation(scene, engine="batch")
    # One unit and a bit from the surface to begin with.
    distances = np.linalg.norm(simulation.nodes[:, None] - [tool.position for tool in scene.tools], axis=2).min(axis=0)
    np.testing.assert_allclose(distances, distances[0], atol=0.15)
    assert sizes.step_in_contact(scene, 1) > 0.0
    simulation.close()


def test_an_organ_of_so_many_nodes_is_held_as_in_palpation() -> None:
    organ = sizes.with_organ(642).organs[0]
    assert len(organ.vertices) == pytest.approx(642, rel=0.05)
    assert (organ.vertices[list(organ.fixed_nodes), 2] < 2.0).all()
    assert 0 < len(organ.fixed_nodes) < len(organ.vertices) / 2


def test_sizes_are_measured() -> None:
    found = sizes.measure_sizes(SMALL, dict(command.SIZES))
    rows = {name: row for part in found.values() for name, row in part.items()}
    assert {path[-1] for path in judging.EXPONENTS if path[0] == "sizes"} == rows.keys()
    assert rows["step of all worlds"]["sizes"] == rows["reset of one world"]["sizes"] == [1, 2]
    assert rows["step, tool's nodes"]["sizes"] == [8, 32]
    assert rows["picture"]["sizes"] == [256, 1024]
    assert all(cost > 0.0 for row in rows.values() for cost in row["costs"])


def test_a_dataset_is_measured(tmp_path) -> None:
    pytest.importorskip("minari", reason="pip install 'spatula-env[data]'")
    from benchmarks.growth import datasets

    found = datasets.measure_datasets(tmp_path, milestones=(2, 4), compared=2)
    assert found["appended"]["sizes"] == found["merged"]["sizes"] == found["opened"]["sizes"] == [2, 4]
    assert found["minari"] == {"episodes": 6, "steps": 300, "seconds": found["minari"]["seconds"], "whole": True}
    assert 1.0 < found["payload_ratio"] < 1.5
    assert found["append"]["ratio"] > 0.0 and found["list"]["seconds"] >= found["list"]["cpu_seconds"] / 4 > 0.0
    paths = [*judging.EXPONENTS, *judging.LIMITS]
    assert all(judging._at({"datasets": found}, path) is not None for path in paths if path[0] == "datasets")


def test_programs_are_killed_and_nothing_is_lost() -> None:
    pytest.importorskip("minari", reason="pip install 'spatula-env[data]'")
    found = killing.measure_killing(1)
    assert found["passed"] and found["kills"] == 1
    assert found["found"] >= found["told"] >= 3


@pytest.mark.parametrize("name", ["lost", "twice", "damaged", "left_behind"])
def test_what_a_kill_may_break_is_told(name: str) -> None:
    good = {"kills": 2, "told": 9, "found": 13, "lost": 0, "twice": 0, "damaged": 0, "left_behind": 0, "seconds": 1.0}
    assert killing.Killing(**good).passed
    assert not killing.Killing(**{**good, name: 1}).passed
    # More than one of each program.
    assert not killing.Killing(**{**good, "found": 14}).passed


@pytest.mark.parametrize("ending", memory.ENDINGS)
def test_what_is_left_of_environments_is_looked_for(ending: str) -> None:
    found = memory.in_fresh_process(memory.leave_environments, "batch", ending, 10, 5)
    assert (found.clients, found.descriptors, found.threads, found.files) == (0, 0, 0, 0)
    assert len(found.memory) == 2 and found.growth == found.memory[-1] - found.memory[0]


@pytest.mark.bullet
def test_clients_that_are_held_are_counted() -> None:
    held = Simulation(sizes.with_tools(1), engine="bullet")
    assert memory._clients(1000) >= 1
    held.close()


@pytest.mark.parametrize("engine", [pytest.param("bullet", marks=pytest.mark.bullet), "batch"])
def test_memory_is_watched(engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "SAMPLES", 5)
    steps = 10 if engine == "bullet" else 320
    found = memory.run_long(engine, steps, show=False)
    assert found.steps == steps
    assert len(found.memory) == 5
    assert found.growth == pytest.approx(found.memory[-1] - found.memory[max(len(found.memory) // 10 - 1, 0)])
    assert found.peak_growth >= found.growth
    assert memory.LongRun(1, [1.0], 5.0, 6.0, 1.0).passed
    assert not memory.LongRun(1, [1.0], 5.1, 6.0, 1.0).passed


# The command -------------------------------------------------------------------------------------------------------


def test_the_last_line_is_json_and_there_is_a_picture(monkeypatch, capsys, tmp_path) -> None:
    pytest.importorskip("matplotlib", reason="pip install 'spatula-env[viz]'")
    monkeypatch.setattr(command, "QUICK", SMALL)
    picture = tmp_path / "growth.png"
    words = ["--quick", "--parts", "sizes", "--of-sizes", "pictures", "--picture", str(picture)]
    status = command.main(words)
    *lines, last = capsys.readouterr().out.splitlines()
    found = json.loads(last)
    assert found["benchmark"] == "growth" and found["quick"] and found["parts"] == ["sizes"]
    assert found["thresholds"].keys() == {"exponent of picture over pixels"}
    assert status == 1 - found["passed"] == 0
    assert len(lines) == 1 and "passed" in lines[0]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_engines_that_are_not_installed_are_left_out(monkeypatch, capsys) -> None:
    monkeypatch.setattr(
        command, "measure_left", lambda names, count: {f"{name} x": dict(judging.LEFT) for name in names}
    )
    command.main(["--quick", "--parts", "left", "--json"])
    thresholds = json.loads(capsys.readouterr().out)["thresholds"]
    named = [name for name in engines.ENGINES if f"left {name} x growth" in thresholds]
    assert named == [name for name in engines.ENGINES if name not in engines.OF_EXTRAS and engines.is_installed(name)]
