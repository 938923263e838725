"""The protective stop: which part of a motion is removed, and when."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatula_env import scenes
from spatula_env.arrays import FloatArray
from spatula_env.sim.batch import BatchSimulation
from spatula_env.sim.drive import restrain
from spatula_env.sim.worlds import Worlds

vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
APART = np.array([[0.2, 0.0, 0.0], [-0.3, 0.4, 1.2]])


def stop(
    positions: FloatArray, linear: FloatArray, angular: FloatArray, forces: FloatArray, limit: float
) -> tuple[bool, FloatArray, FloatArray]:
    """Call `restrain`; returns its result and the velocities that it writes."""
    restrained_linear, restrained_angular = np.full_like(linear, np.nan), np.full_like(angular, np.nan)
    stopped = restrain(positions, linear, angular, forces, limit, restrained_linear, restrained_angular)
    return stopped, restrained_linear, restrained_angular


@given(vectors, vectors, vectors, st.floats(0.1, 4.0))
def test_a_single_tool_loses_only_what_pushes_on(
    velocity: tuple[float, ...], rate: tuple[float, ...], force: tuple[float, ...], limit: float
) -> None:
    linear, angular, forces = np.array([velocity]), np.array([rate]), np.array([force])
    size = np.linalg.norm(forces)
    stopped, shown, turning = stop(APART[:1], linear, angular, forces, limit)
    assert stopped == (size > limit)
    if not stopped:
        assert shown.tolist() == linear.tolist()
        assert turning.tolist() == angular.tolist()
        return
    direction = forces[0] / size
    onward = float(linear[0] @ direction)
    assert shown[0] @ direction == pytest.approx(max(onward, 0.0), abs=1e-9)
    assert shown[0] - (shown[0] @ direction) * direction == pytest.approx(linear[0] - onward * direction, abs=1e-9)
    assert not turning.any()


@given(st.tuples(vectors, vectors), st.tuples(vectors, vectors), st.floats(0.1, 4.0))
def test_jaws_that_are_stopped_stay_in_line(
    velocities: tuple[tuple[float, ...], ...], forces: tuple[tuple[float, ...], ...], limit: float
) -> None:
    linear, on_tools = np.array(velocities), np.array(forces)
    stopped, shown, turning = stop(APART, linear, np.ones((2, 3)), on_tools, limit)
    if not stopped:
        assert shown.tolist() == linear.tolist()
        return
    away = (APART[1] - APART[0]) / np.linalg.norm(APART[1] - APART[0])
    parting = shown[1] - shown[0]
    assert parting - (parting @ away) * away == pytest.approx(np.zeros(3), abs=1e-9)
    assert not turning.any()
    # Neither faster than asked for, nor the other way.
    asked = float((linear[1] - linear[0]) @ away)
    assert parting @ away == pytest.approx(asked, abs=1e-9) or parting @ away == pytest.approx(0.0, abs=1e-9)
    for tool, resists in enumerate(np.linalg.norm(on_tools, axis=1) > limit):
        if resists:
            own = (1.0 if tool == 1 else -1.0) * 0.5 * (parting @ away) * away
            assert own @ on_tools[tool] >= -1e-9
    if (np.linalg.norm(on_tools, axis=1) > limit).sum() == 1:
        tool = int(np.argmax(np.linalg.norm(on_tools, axis=1)))
        assert shown.mean(axis=0) @ on_tools[tool] >= -1e-9


@given(st.permutations(range(2)), st.tuples(vectors, vectors), st.tuples(vectors, vectors))
def test_jaws_may_be_named_either_way(
    order: list[int], velocities: tuple[tuple[float, ...], ...], forces: tuple[tuple[float, ...], ...]
) -> None:
    linear, on_tools = np.array(velocities), np.array(forces)
    on_tools[1] = 0.0  # With two forces that resist, which is taken first may matter.
    here = stop(APART, linear, np.zeros((2, 3)), on_tools, 0.5)[1]
    there = stop(
        np.ascontiguousarray(APART[order]),
        np.ascontiguousarray(linear[order]),
        np.zeros((2, 3)),
        np.ascontiguousarray(on_tools[order]),
        0.5,
    )[1]
    assert there == pytest.approx(here[order], abs=1e-9)


@pytest.mark.parametrize("engine", ["batch", "bullet"])
def test_a_tool_is_stopped_within_a_physics_step(engine: str) -> None:
    # Pressed down at 5 u/s for half a second in one call: without a limit it goes on to the end.
    scene = scenes.seed()
    down = np.tile([0.0, 0.0, -5.0], (2, 1, 1))
    limits = np.array([200.0, 1e12])
    worlds = Worlds(scene, 2, engine=engine)
    try:
        start = worlds.tool_positions
        loads = worlds.advance(down, np.zeros_like(down), 240, None, limits)
        way = (start - worlds.tool_positions)[:, 0, 2]
        assert way[1] == pytest.approx(5.0)
        assert way[0] < 4.0
        assert loads.restrained[1] == 0.0
        # It went on whenever it was not stopped, and slid a little along the surface while it was.
        assert way[0] == pytest.approx(5.0 * (1.0 - loads.restrained[0]), rel=0.01)
        # Beyond the limit it gets by what one physics step adds, and by how the organ swings against the tool.
        assert 200.0 < loads.peak_forces[0, 0] < 500.0 < loads.peak_forces[1, 0]
        # What it last met counts in the next call too, until the tool is put elsewhere.
        before = worlds.tool_positions
        last = worlds.advance(down, np.zeros_like(down), 1, None, np.array([1e-3, 1e12]))
        assert last.restrained.tolist() == [1.0, 0.0]
        assert np.linalg.norm(worlds.tool_positions[0] - before[0]) < 0.1 * 5.0 * scene.dt
        worlds.reset(np.array([0]))
        assert worlds.advance(down, np.zeros_like(down), 1, None, np.full(2, 1e-3)).restrained.tolist() == [0.0, 1.0]
    finally:
        worlds.close()


def test_what_a_tool_met_is_saved_and_restored() -> None:
    down, nothing = np.tile([0.0, 0.0, -5.0], (1, 1, 1)), np.zeros((1, 1, 3))
    first, second = BatchSimulation(scenes.seed(), 1), BatchSimulation(scenes.seed(), 1)
    first.advance(down, nothing, 150)
    second.restore(first.save())
    for worlds in (first, second):
        assert worlds.advance(down, nothing, 1, None, np.array([1e-3])).restrained.tolist() == [1.0]
    assert first.nodes.tolist() == second.nodes.tolist()


def test_a_bad_limit_is_refused() -> None:
    worlds = BatchSimulation(scenes.seed(), 2)
    with pytest.raises(ValueError, match=r"force_limits must have shape \(2,\), got \(3,\)"):
        worlds.advance(np.zeros((2, 1, 3)), force_limits=np.zeros(3))
