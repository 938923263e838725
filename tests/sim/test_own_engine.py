"""A custom engine needs one module and one registration; tasks, contact, states and worlds then work with it."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env import Simulation, engines, scenes
from spatula_env.geometry import icosphere
from spatula_env.sim import SceneWarning, SimulationDiverged
from spatula_env.sim.batch_engine import BatchEngine
from spatula_env.sim.engine import Abilities, BlockEngine
from spatula_env.sim.worlds import Worlds

gym.register_envs(spatula_env)

DOWN = np.array([0.0, 0.0, -1.0], dtype=np.float32)


class SlowBatchEngine:
    """The batch engine without what takes it through several steps at once."""

    abilities = Abilities(varies=True)

    def __init__(self, *arguments: object) -> None:
        self._engine = BatchEngine(*arguments)  # type: ignore[arg-type]
        for name in ("advance", "halt", "save", "restore", "close", "set_parameters"):
            setattr(self, name, getattr(self._engine, name))

    @property
    def inverse_masses(self) -> np.ndarray:
        return self._engine.inverse_masses

    @property
    def gravity(self) -> np.ndarray:
        return self._engine.gravity


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    added = {"mattress": "mattress:MattressEngine", "slow": f"{__name__}:SlowBatchEngine"}
    for name, entry_point in added.items():
        engines.register_engine(name, entry_point)
    yield
    for name in added:
        del engines.ENGINES[name]


def test_the_press_runs_alone_and_in_many_worlds_alike() -> None:
    many = gym.make_vec("Spatula/Press-v0", num_envs=3, engine="mattress")
    many.reset(seed=5)
    shown = [many.step(np.tile(DOWN, (3, 1))) for _ in range(14)]
    for world in range(3):
        one = gym.make("Spatula/Press-v0", engine="mattress")
        assert one.spec is not None and one.spec.kwargs["engine"] == "mattress"
        one.reset(seed=5 + world)
        for observations, rewards, _, _, infos in shown:
            observation, reward, _, _, info = one.step(DOWN)
            assert observation.tolist() == observations[world].tolist()
            assert (reward, info["force"]) == (rewards[world], infos["force"][world])
        assert info["force"] > 0.05
        one.close()
    many.close()


def test_states_hold_what_is_inside_and_go_on_in_any_world() -> None:
    many = gym.make_vec("Spatula/Press-v0", num_envs=3, engine="mattress", autoreset_mode="disabled")
    start, _ = many.reset(seed=0)
    for _ in range(14):
        many.step(np.tile(DOWN, (3, 1)))
    state = pickle.loads(pickle.dumps(many.save([0, 1])))  # type: ignore[attr-defined]
    hold = np.zeros((3, 3), dtype=np.float32)
    expected = [many.step(hold)[0] for _ in range(5)]
    mask = np.array([False, True, False])
    again, _ = many.reset(options={"reset_mask": mask}, seed=[0, 1, 2])  # type: ignore[arg-type]
    assert again[1].tolist() == start[1].tolist()
    many.restore(state, [1, 0])  # type: ignore[attr-defined]
    for observations in expected:
        assert many.step(hold)[0][[1, 0]].tolist() == observations[[0, 1]].tolist()
    # Without what is inside, springs would be fastened where they were in the beginning.
    inner = state.physics.inner
    assert not np.array_equal(inner[0], inner[1])
    many.close()


def test_a_simulation_reports_its_steps() -> None:
    simulation = Simulation(scenes.seed(), engine="mattress")
    simulation.place_tool((0.0, 0.0, simulation.nodes[:, 2].max() + 0.1))
    for _ in range(30):
        report = simulation.step((0.0, 0.0, -5.0))
    assert report.force[2] > 0.0
    assert report.residual < 0.03
    np.testing.assert_allclose(report.nodal_impulses.sum(axis=0), -report.force * simulation.dt, rtol=1e-9, atol=1e-12)
    engine = simulation.worlds.engine
    simulation.close()
    assert engine.closed  # type: ignore[attr-defined]


def test_an_engine_is_asked_only_for_what_it_can_do() -> None:
    with pytest.raises(ValueError, match="contact must be 'flags' or 'second_step' with engine 'mattress'"):
        Simulation(scenes.seed(), engine="mattress", contact="bullet")
    worlds = Worlds(scenes.seed(), 2, engine="mattress")
    with pytest.raises(ValueError, match="gravity, stiffness and mass_scale must be None with MattressEngine"):
        worlds.set_parameters(gravity=1.0)
    worlds.set_parameters(friction=[0.1, 0.2])
    assert [worlds.tools_of(w)[0].friction for w in range(2)] == [0.1, 0.2]


def test_a_fine_surface_is_doubted_only_where_pulls_do_not_get_through_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("spatula_env.sim.worlds.LONGEST_SETTLING", 0.05)
    ball = scenes.PlacedOrgan(icosphere(3.0, 4), position=(0.0, 0.0, 3.0), mass=10.0)
    scene = replace(scenes.seed(), organs=(ball,), ground=None)
    Worlds(scene, 1, engine="mattress").close()
    with pytest.warns(SceneWarning) as told:
        Worlds(scene, 1, engine="batch").close()
    assert "a surface too fine for springs: it is 26 edges" in str(told[0].message)


def test_a_world_that_is_not_finite_leaves_the_others_alone() -> None:
    worlds, still = Worlds(scenes.seed(), 2, engine="mattress"), np.zeros((2, 1, 3))
    worlds.engine._anchors[1] = np.nan  # type: ignore[attr-defined]
    assert worlds.advance(still, steps=3).diverged.tolist() == [False, True]
    worlds.reset([1])
    assert not worlds.advance(still, steps=3).diverged.any()
    simulation = Simulation(scenes.seed(), engine="mattress")
    simulation.worlds.engine._anchors[:] = np.nan  # type: ignore[attr-defined]
    with pytest.raises(SimulationDiverged, match=r"positions are not finite after 0\.0042 s"):
        simulation.step()


def test_steps_in_one_call_are_those_one_by_one() -> None:
    fast, slow = (Worlds(scenes.seed(), 3, engine=name) for name in ("batch", "slow"))
    assert isinstance(fast.engine, BlockEngine)
    assert not isinstance(slow.engine, BlockEngine)
    linear = np.array([[[0.5, 0.1, -6.0]], [[0.0, 0.0, -5.0]], [[-0.5, 0.2, -4.0]]])
    for _ in range(6):
        mine, theirs = (each.advance(linear, 0.1 * linear, 12, force_limits=np.full(3, 50.0)) for each in (fast, slow))
        for name, values in vars(mine).items():
            for one, other in zip(np.atleast_1d(values), np.atleast_1d(getattr(theirs, name)), strict=True):
                np.testing.assert_array_equal(one, other, err_msg=name)
        np.testing.assert_array_equal(fast.nodes, slow.nodes)
        np.testing.assert_array_equal(fast.node_velocities, slow.node_velocities)
    assert mine.peak_forces.max() > 1.0
    state = fast.save()
    slow.restore(state)
    np.testing.assert_array_equal(fast.advance(linear, steps=12).forces, slow.advance(linear, steps=12).forces)


def test_names_are_taken_once() -> None:
    engines.register_engine("mattress", "mattress:MattressEngine")
    with pytest.raises(ValueError, match="name must be that of no other engine, but 'batch' is"):
        engines.register_engine("batch", "mattress:MattressEngine")
    with pytest.raises(ValueError, match="entry_point must be 'module:Class', got 'mattress'"):
        engines.register_engine("springs", "mattress")
    with pytest.raises(
        ValueError, match=r"engine must be one of \['bullet', .*, 'mujoco', 'mattress', 'slow'\], got 'magic'"
    ):
        Simulation(scenes.seed(), engine="magic")
