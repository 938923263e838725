"""Pressures that are summed up during a control step: those of each physics step's report."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from spatula_env import Simulation, scenes
from spatula_env.scenes import Scene
from spatula_env.sim.batch import BatchSimulation
from spatula_env.sim.worlds import Worlds

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


@pytest.mark.parametrize(("move", "control_steps"), [(press, 10), (grip, 12)])
@pytest.mark.parametrize("engine", ["batch", pytest.param("bullet", marks=pytest.mark.bullet)])
def test_what_is_summed_up_is_what_each_step_tells(move: Any, control_steps: int, engine: str) -> None:
    scene, linear, angular = move(2)
    limits = np.array([20.0, 200.0])
    worlds = Worlds(scene, 2, engine=engine, precision="double", parallel=False)
    loads = [worlds.advance(linear, angular, STEPS, limits) for _ in range(control_steps)]
    worlds.close()
    single = Simulation(scene, engine=engine, precision="double")
    for w in range(2):
        single.reset()
        for told in loads:
            pressures = []
            for _ in range(STEPS):
                single.step(linear[w], angular[w])
                pressures.append(single.pressures())
            peaks = np.array([pressure.peak for pressure in pressures])
            faces = np.mean([pressure.faces for pressure in pressures], axis=0)
            assert told.peak_pressures[w] == peaks.max()
            assert told.mean_pressures[w] == pytest.approx(faces.max(), rel=1e-12)
            exceeded = np.maximum(peaks - limits[w], 0.0).sum() * scene.dt
            assert told.overpressures[w] == pytest.approx(exceeded, rel=1e-12)
            for mine, theirs in zip(told.node_pressures, pressures[-1].nodes, strict=True):
                assert mine[w].tolist() == theirs.tolist()
    single.close()
    assert loads[0].peak_pressures.tolist() == [0.0, 0.0]
    last = loads[-1]
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
    single = Simulation(scene, engine="batch", precision="double")
    single.set_tools(
        [replace(placed, tool=placed.tool.scaled(1.3), friction=0.5 * placed.friction) for placed in scene.tools]
    )
    for _ in range(9):
        loads = worlds.advance(linear, angular, STEPS)
        reports = [single.step(linear[0], angular[0]) for _ in range(STEPS)]
    assert loads.forces[0, 0] == pytest.approx(np.mean([report.force for report in reports], axis=0), rel=1e-12)
    assert loads.peak_pressures[0] == pytest.approx(
        max(report.wrenches[0].pressures.max() for report in reports), rel=1e-9
    )
    assert loads.peak_pressures[0] > 0.0
    single.close()


def test_limits_are_checked() -> None:
    worlds = BatchSimulation(scenes.seed(), 2)
    with pytest.raises(ValueError, match=r"pressure_limits must have shape \(2,\), got \(3,\)"):
        worlds.advance(np.zeros((2, 1, 3)), pressure_limits=np.zeros(3))


@pytest.mark.bullet
def test_bullets_own_contact_tells_no_pressure() -> None:
    scene, linear, angular = press(1)
    worlds = Worlds(scene, 1, engine="bullet", contact="bullet")
    for _ in range(8):
        loads = worlds.advance(linear, angular, STEPS, np.zeros(1))
    assert loads.forces[0, 0, 2] > 0.0
    assert loads.peak_pressures.tolist() == loads.mean_pressures.tolist() == loads.overpressures.tolist() == [0.0]
    worlds.close()
