"""Pressures that are summed up during a control step: those of each physics step's report."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from spatula_env import Simulation, scenes
from spatula_env.scenes import Scene
from spatula_env.sim.batch import BatchSimulation
from spatula_env.sim.worlds import Loads, SeparateWorlds

STEPS = 6


def press(count: int) -> tuple[Scene, np.ndarray, np.ndarray]:
    """A spatula that comes down on the sphere, tilting, in each world at another speed."""
    scene = scenes.seed()
    linear, angular = np.zeros((count, 1, 3)), np.zeros((count, 1, 3))
    linear[:, 0, 2] = -np.linspace(8.0, 12.0, count)
    linear[:, 0, 0] = 0.5
    angular[:, 0, 0] = 0.3
    return scene, linear, angular


def grip(count: int) -> tuple[Scene, np.ndarray, np.ndarray]:
    """Jaws that close on a ridge."""
    scene = scenes.clamp()
    linear, angular = np.zeros((count, 2, 3)), np.zeros((count, 2, 3))
    linear[:, 0, 1] = np.linspace(1.5, 2.0, count)
    linear[:, 1, 1] = -np.linspace(1.8, 1.6, count)
    return scene, linear, angular


def advance_both(move: Any, control_steps: int, limits: np.ndarray) -> tuple[list[Loads], list[Loads]]:
    scene, linear, angular = move(2)
    batch = BatchSimulation(scene, 2, dtype=np.float64, parallel=False)
    separate = SeparateWorlds([Simulation(scene, engine="batch", precision="double") for _ in range(2)])
    shown = [
        [worlds.advance(linear, angular, STEPS, limits) for _ in range(control_steps)] for worlds in (batch, separate)
    ]
    separate.close()
    return shown[0], shown[1]


@pytest.mark.parametrize(("move", "control_steps"), [(press, 10), (grip, 12)])
def test_both_ways_of_stepping_worlds_tell_the_same_pressures(move: Any, control_steps: int) -> None:
    mine, theirs = advance_both(move, control_steps, np.array([20.0, 200.0]))
    for loads, others in zip(mine, theirs, strict=True):
        for name in ("peak_pressures", "mean_pressures", "overpressures"):
            values = getattr(loads, name)
            assert values == pytest.approx(getattr(others, name), rel=1e-9, abs=1e-9), name
        for pressures, other in zip(loads.node_pressures, others.node_pressures, strict=True):
            assert pressures == pytest.approx(other, rel=1e-9, abs=1e-9)
    assert mine[0].peak_pressures.tolist() == [0.0, 0.0]
    last = mine[-1]
    assert (last.peak_pressures > last.mean_pressures).all()
    assert (last.mean_pressures > 0.0).all()
    assert (last.overpressures > 0.0).all()
    assert last.overpressures[0] != last.overpressures[1]


def test_what_is_summed_up_is_what_each_step_reports() -> None:
    scene, linear, angular = press(1)
    worlds = BatchSimulation(scene, 1, dtype=np.float64)
    single = Simulation(scene, engine="batch", precision="double")
    limit = 100.0
    for _ in range(9):
        loads = worlds.advance(linear, angular, STEPS, np.array([limit]))
        reports = [single.step(linear[0], angular[0]) for _ in range(STEPS)]
    tool = scene.tools[0].tool
    pressures = np.array([report.wrenches[0].pressures for report in reports])
    peaks = pressures.max(axis=1)
    assert loads.peak_pressures[0] == pytest.approx(peaks.max(), rel=1e-9)
    assert loads.overpressures[0] == pytest.approx(np.maximum(peaks - limit, 0.0).sum() * scene.dt, rel=1e-9)
    assert loads.node_pressures[0][0] == pytest.approx(pressures[-1], rel=1e-9)
    forces = pressures * tool.areas
    on_faces = [
        forces[:, tool.face == face].sum(axis=1).mean() / tool.areas[tool.face == face].sum() for face in (0, 1)
    ]
    assert loads.mean_pressures[0] == pytest.approx(max(on_faces), rel=1e-9)
    # Without friction along the face, the pressure on the lower one carries the force.
    assert peaks.max() > limit
    single.close()


def test_where_nothing_is_touched_there_is_no_pressure() -> None:
    worlds = BatchSimulation(scenes.seed(), 2)
    loads = worlds.advance(np.zeros((2, 1, 3)), steps=STEPS, pressure_limits=np.zeros(2))
    assert not loads.peak_pressures.any()
    assert not loads.mean_pressures.any()
    assert not loads.overpressures.any()
    assert not loads.node_pressures[0].any()


def test_pressure_goes_when_the_tool_goes() -> None:
    scene, linear, angular = press(2)
    worlds = BatchSimulation(scene, 2)
    for _ in range(9):
        loads = worlds.advance(linear, angular, STEPS)
    assert (loads.node_pressures[0].max(axis=1) > 0.0).all()
    for _ in range(12):
        loads = worlds.advance(-2.0 * linear, angular, STEPS)
    assert not loads.node_pressures[0].any()
    assert not loads.peak_pressures.any()


def test_a_larger_tool_is_pressed_by_its_own_areas() -> None:
    scene, linear, angular = press(1)
    worlds = BatchSimulation(scene, 1, dtype=np.float64)
    worlds.vary(np.array([0.5]), np.array([1.3]))
    single = SeparateWorlds([Simulation(scene, engine="batch", precision="double")])
    single.vary(np.array([0.5]), np.array([1.3]), np.array([0]))
    for _ in range(9):
        mine, theirs = (each.advance(linear, angular, STEPS, np.array([50.0])) for each in (worlds, single))
    assert mine.forces == pytest.approx(theirs.forces, rel=1e-9, abs=1e-9)
    assert mine.peak_pressures[0] > 0.0
    assert mine.peak_pressures == pytest.approx(theirs.peak_pressures, rel=1e-9)
    assert mine.overpressures == pytest.approx(theirs.overpressures, rel=1e-9)
    single.close()


def test_limits_are_checked() -> None:
    worlds = BatchSimulation(scenes.seed(), 2)
    with pytest.raises(ValueError, match=r"pressure_limits must have shape \(2,\), got \(3,\)"):
        worlds.advance(np.zeros((2, 1, 3)), pressure_limits=np.zeros(3))


@pytest.mark.bullet
def test_bullets_own_contact_tells_no_pressure() -> None:
    scene, linear, angular = press(1)
    worlds = SeparateWorlds([Simulation(scene, engine="bullet", contact="bullet")])
    for _ in range(8):
        loads = worlds.advance(linear, angular, STEPS, np.zeros(1))
    assert loads.forces[0, 0, 2] > 0.0
    assert loads.peak_pressures.tolist() == loads.mean_pressures.tolist() == loads.overpressures.tolist() == [0.0]
    worlds.close()
