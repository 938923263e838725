"""The engine "mujoco": its forces, what it conserves, its states, and what it refuses."""

from __future__ import annotations

import pickle
import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from benchmarks.flexes import LinearEngine, held_sphere, linear_engine, press
from spatula_env import Simulation, scenes
from spatula_env.engines import choose_engine, is_installed
from spatula_env.geometry import Tool
from spatula_env.learning.experts import PressExpert
from spatula_env.scenes import Material, PlacedTool, Scene
from spatula_env.sim import SceneWarning
from spatula_env.sim.engine import PRECISIONS, EngineOptions
from spatula_env.sim.mujoco.engine import MujocoEngine
from spatula_env.sim.mujoco.flex import UNSTATED, FlexOrgan
from spatula_env.sim.mujoco.held import Held
from spatula_env.sim.mujoco.loading import import_mujoco
from spatula_env.sim.tissue.body import TissueBody
from spatula_env.sim.worlds import Worlds

needs_mujoco = pytest.mark.skipif(not is_installed("mujoco"), reason="the extra mujoco is not installed")
ELASTIC = Material(poisson_ratio=0.3, viscosity=0.0)


def make_scene(material: Material = ELASTIC, dt: float = 1.0 / 240.0, gravity: float = 0.0) -> Scene:
    return replace(scenes.seed(material=material, dt=dt), gravity=gravity)


def engine_of(scene: Scene, worlds: int = 1) -> MujocoEngine:
    return MujocoEngine(scene, worlds, EngineOptions())


def bent(nodes: np.ndarray, amount: float = 0.02) -> np.ndarray:
    x, y, z = nodes.T
    return nodes + amount * np.column_stack([y * z, np.sin(x) + z, x * y - 0.3 * z**2])


class Organ:
    """An organ that nothing holds, with all of its nodes in the order of its tetrahedra."""

    def __init__(self, scene: Scene) -> None:
        self.engine = engine_of(scene)
        flexes = self.engine.flexes
        self.organ = flexes.organs[0]
        self.rows = np.concatenate([flexes.surface[flexes.moving], flexes.inner])
        self.vertices = len(flexes.surface)

    def put(self, nodes: np.ndarray) -> None:
        positions, velocities = self.engine._state(0)
        positions[:], velocities[:] = nodes[self.rows], 0.0

    def step(self) -> None:
        positions, velocities = (array[: self.vertices].copy()[None] for array in self.engine._state(0))
        self.engine.advance(positions, velocities, np.zeros(1, dtype=np.bool_))

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        found = []
        for array in self.engine._state(0):
            nodes = np.empty_like(array)
            nodes[self.rows] = array
            found.append(nodes)
        return found[0], found[1]


@needs_mujoco
@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.4])
def test_forces_are_those_of_the_documented_energy(ratio: float) -> None:
    # A step so short that it is not divided.
    scene = make_scene(replace(ELASTIC, poisson_ratio=ratio), dt=1e-4)
    organ, linear = Organ(scene), LinearEngine(scene, 1, EngineOptions())
    assert organ.engine.flexes.substeps == 1
    nodes = bent(organ.organ.nodes, 0.05)
    organ.put(nodes)
    organ.step()
    expected = linear.forces(nodes)
    found = organ.read()[1] * organ.organ.masses[:, None] / scene.dt
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@needs_mujoco
def test_masses_are_those_of_tissue() -> None:
    material = replace(ELASTIC, density=1100.0)
    for scene in (make_scene(material), replace(scenes.retract(material=material), gravity=0.0)):
        tissue = TissueBody(scene, 1, lanes=1, dtype=PRECISIONS["double"])
        np.testing.assert_allclose(engine_of(scene).inverse_masses, tissue.inverse_masses, rtol=1e-12)


@needs_mujoco
def test_an_organ_falls_as_a_whole() -> None:
    organ = Organ(make_scene(gravity=10.0))
    for _ in range(24):
        organ.step()
    np.testing.assert_allclose(organ.read()[1], np.broadcast_to([0.0, 0.0, -1.0], (len(organ.rows), 3)), atol=1e-9)


@needs_mujoco
def test_momentum_is_kept_and_energy_too_where_nothing_is_viscous() -> None:
    kept = {}
    for viscosity in (0.0, 0.5):
        organ = Organ(make_scene(replace(ELASTIC, viscosity=viscosity)))
        linear = LinearEngine(make_scene(ELASTIC), 1, EngineOptions())
        organ.put(bent(organ.organ.nodes, 0.005))
        masses, energies, momenta = organ.organ.masses[:, None], [], []
        for _ in range(120):
            before = organ.read()[1]
            nodes = organ.read()[0]
            organ.step()
            # Velocities are half a substep before and after the positions.
            velocities = 0.5 * (before + organ.read()[1])
            gradients = np.einsum("mai,maj->mij", nodes[organ.organ.tetrahedra], linear._gradients)
            stored = (linear._volumes * linear._law.energy(gradients)).sum()
            energies.append(stored + 0.5 * (masses * velocities**2).sum())
            momenta.append(np.abs((masses * velocities).sum(axis=0)).max() / (masses * np.abs(velocities)).sum())
        assert max(momenta) < 1e-9
        kept[viscosity] = np.mean(energies[-20:]) / np.mean(energies[:20])
    assert kept[0.0] == pytest.approx(1.0, abs=0.1)
    assert kept[0.5] < 0.9 * kept[0.0]


@needs_mujoco
def test_the_spatula_meets_the_force_of_the_same_elements_in_numpy() -> None:
    scene = held_sphere(replace(ELASTIC, viscosity=4.0))
    with linear_engine() as name:
        expected = press(scene, name, 0.25, approach=0.2, settle=0.1)
    found = press(scene, "mujoco", 0.25, approach=0.2, settle=0.1)
    force, nodes = found.differs(expected)
    assert found.force > 0.1
    assert force < 1e-3
    assert nodes < 1e-3


@needs_mujoco
def test_the_ground_bears_the_organs_weight_and_a_tool_feels_what_it_gives() -> None:
    scene = scenes.palpate(material=UNSTATED)
    simulation = Simulation(scene, engine="mujoco")
    masses = simulation.node_masses
    free = np.isfinite(masses)
    simulation.place_tool((0.0, 0.0, simulation.nodes[:, 2].max() + 0.1))
    for _ in range(30):
        before = simulation.node_velocities
        report = simulation.step((0.0, 0.0, -2.0))
        np.testing.assert_allclose(report.nodal_impulses.sum(axis=0), -report.force * simulation.dt, atol=1e-9)
        assert report.residual < 0.03
        assert np.isfinite(before[free]).all()
    assert report.force[2] > 0.0
    simulation.close()
    lying = Simulation(scenes.seed(material=replace(UNSTATED, viscosity=5.0)), engine="mujoco")
    weights = [lying.step().ground_force[2] for _ in range(60)]
    assert np.mean(weights) == pytest.approx(10.0 * lying.scene.organs[0].mass, rel=0.05)
    lying.close()


def pressed(count: int, steps: int = 24) -> Worlds:
    worlds = Worlds(scenes.palpate(material=UNSTATED), count, engine="mujoco", parallel=False)
    worlds.place_tools(np.tile([0.0, 0.0, 6.1], (count, 1, 1)))
    advance(worlds, steps)
    return worlds


def advance(worlds: Worlds, steps: int, speed: float = -4.0) -> np.ndarray:
    return worlds.advance(np.tile([0.0, 0.0, speed], (worlds.count, 1, 1)), steps=steps).forces[:, 0]


@needs_mujoco
def test_a_state_goes_on_as_it_would_have_gone_on_without() -> None:
    worlds, alone = pressed(2), pressed(1)
    assert np.array_equal(worlds.nodes[1], alone.nodes[0])
    state = pickle.loads(pickle.dumps(worlds.save([0])))
    expected = advance(worlds, 6)[0]
    assert expected[2] > 0.0
    nodes = worlds.nodes[0]
    worlds.reset([0])
    assert np.abs(worlds.nodes[0] - nodes).max() > 0.05
    worlds.restore(state, [1])
    assert advance(worlds, 6)[1].tolist() == expected.tolist()
    assert np.array_equal(worlds.nodes[1], nodes)
    with pytest.raises(ValueError, match=r"an inner state must be of 164 inner and \d+ surface nodes, got 0 and 0"):
        worlds.engine.restore(
            worlds.nodes[:1], worlds.nodes[:1], [SimpleNamespace(positions=[], holds=[])], np.array([0])
        )
    worlds.close()
    alone.close()


@needs_mujoco
def test_inner_nodes_follow_a_surface_that_is_given_alone() -> None:
    engine = engine_of(make_scene())
    rest, flexes = engine.flexes.rest, engine.flexes
    turn = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])
    moved = rest @ turn.T + 5.0
    surface = moved[flexes.surface][None]
    engine.restore(surface, np.zeros_like(surface), (None,), np.array([0]))
    np.testing.assert_allclose(
        engine._state(0)[0], moved[np.r_[flexes.surface[flexes.moving], flexes.inner]], atol=1e-9
    )
    velocities = np.zeros_like(surface)
    engine.advance(surface, velocities, np.zeros(1, dtype=np.bool_))
    assert np.abs(velocities).max() < 1e-9


@needs_mujoco
def test_a_world_that_is_not_finite_leaves_the_others_alone_and_writes_no_file(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    worlds = pressed(2, 1)
    worlds.engine._state(1)[1][-1] = np.nan  # type: ignore[attr-defined]
    assert worlds.advance(np.zeros((2, 1, 3)), steps=3).diverged.tolist() == [False, True]
    worlds.reset([1])
    assert not worlds.advance(np.zeros((2, 1, 3)), steps=3).diverged.any()
    assert not list(tmp_path.iterdir())
    worlds.close()


@needs_mujoco
def test_organs_push_each_other_and_momentum_is_kept() -> None:
    one = scenes.seed(material=UNSTATED).organs[0]
    scene = Scene(
        organs=(replace(one, position=(0.0, 0.0, 0.0)), replace(one, position=(6.1, 0.2, 0.1))),
        tools=(PlacedTool(Tool.box((1.6, 1.6, 0.2), 5, "all"), (-3.3, 0.0, 0.0), (0.0, 0.5**0.5, 0.0, 0.5**0.5)),),
        ground=None,
        gravity=0.0,
        scale=scenes.seed(material=UNSTATED).scale,
    )
    simulation = Simulation(scene, engine="mujoco")
    for _ in range(60):
        before = simulation.node_velocities
        report = simulation.step((4.0, 0.0, 0.0))
        assert report.residual < 0.01 and report.crossings == 0
    assert report.force[0] < 0.0
    assert before.shape == (2 * len(one.organ.vertices), 3)
    second = slice(len(one.organ.vertices), None)
    assert simulation.node_velocities[second, 0].mean() > 0.0
    simulation.close()


def own_contact(scene: Scene) -> Simulation:
    return Simulation(scene, engine="mujoco", contact="mujoco")


@needs_mujoco
def test_mujocos_own_contact_holds_a_slow_spatula_with_the_force_that_flags_find() -> None:
    scene = held_sphere(replace(ELASTIC, viscosity=4.0))
    found = {}
    for contact in ("flags", "mujoco"):
        simulation = Simulation(scene, engine="mujoco", contact=contact)  # type: ignore[arg-type]
        top, half = float(simulation.nodes[:, 2].max()), 0.0625
        simulation.place_tool((0.0, 0.0, top + half))
        for _ in range(120):
            report = simulation.step((0.0, 0.0, -0.5))
        forces = [simulation.step().force_newtons for _ in range(60)]
        found[contact] = np.mean(forces[-30:], axis=0)
        # MuJoCo's contact is soft: it yields by some hundredths of a unit.
        assert simulation.step().residual < 0.06
        assert np.abs(report.loads[0, 3:]).max() > 0.0
        simulation.close()
    assert found["mujoco"][2] == pytest.approx(found["flags"][2], rel=0.3)


@needs_mujoco
def test_with_mujocos_own_contact_tools_feel_what_organs_gain() -> None:
    scene = replace(make_scene(UNSTATED), ground=None)
    one = scene.tools[0]
    turned = replace(one, position=(0.4, 0.2, 6.3), orientation=(0.3**0.5, 0.0, 0.0, 0.7**0.5))
    simulation = own_contact(replace(scene, tools=(turned, replace(one, position=(0.0, 0.0, 8.0)))))
    masses = simulation.node_masses
    engine: Any = simulation.worlds.engine
    flexes = engine.flexes
    every = np.concatenate([masses[flexes.moving], flexes.organs[0].masses[flexes.inner]])[:, None]
    total, touched = np.zeros((2, 3)), 0
    for _ in range(12):
        before = (every * engine._state(0)[1]).sum(axis=0)
        report = simulation.step([[0.0, 0.0, -3.0], [0.0, 0.0, 0.0]], [[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]])
        after = (every * engine._state(0)[1]).sum(axis=0)
        gained = after - before
        total += [report.loads[0, :3] * simulation.dt, -gained]
        assert not report.loads[1].any() and np.isnan(report.nodal_impulses).all() and report.table is None
        touched += bool(report.loads[0].any())
    assert touched > 5
    # In some steps MuJoCo's solver ends with forces that are a few per cent from what it has moved.
    np.testing.assert_allclose(total[0], total[1], atol=0.03 * np.abs(total).max())
    simulation.close()


@needs_mujoco
def test_the_torque_of_mujocos_own_contact_is_about_the_tools_origin_in_the_worlds_frame() -> None:
    scene = replace(held_sphere(UNSTATED), gravity=0.0)
    one = scene.tools[0]
    found = []
    # The same box, given at another place of its own frame.
    for shift in (0.0, 0.3):
        away = [shift, 0.0, 0.0]
        tool = replace(one.tool, vertices=one.tool.vertices + away, nodes=one.tool.nodes + away)
        turn = (0.0, 0.0, 0.5**0.5, 0.5**0.5)
        placed = replace(one, tool=tool, position=(0.4, -shift, 6.05), orientation=turn)
        simulation = own_contact(replace(scene, tools=(placed,)))
        for _ in range(24):
            report = simulation.step((0.0, 0.0, -2.0))
        found.append(report.loads[0])
        simulation.close()
    force, torque = found[0][:3], found[0][3:]
    assert force[2] > 0.0
    np.testing.assert_allclose(found[1][:3], force, rtol=0.05, atol=0.05 * force[2])
    np.testing.assert_allclose(found[1][3:], torque + np.cross([0.0, 0.3, 0.0], force), atol=0.05 * np.abs(force).max())


@needs_mujoco
def test_states_of_mujocos_own_contact_go_on_exactly_and_tools_can_be_exchanged(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scene = scenes.palpate(material=replace(UNSTATED, viscosity=5.0))
    worlds = Worlds(scene, 2, engine="mujoco", contact="mujoco", parallel=False)
    worlds.place_tools(np.tile([0.0, 0.0, 6.1], (2, 1, 1)))
    advance(worlds, 24)
    state = worlds.save([0])
    expected = advance(worlds, 6)[0]
    assert expected[2] > 0.0
    worlds.restore(state, [1])
    assert advance(worlds, 6)[1].tolist() == expected.tolist()
    tool = scenes.palpate().tools[0].tool
    worlds.set_tools([replace(tool, vertices=2.0 * tool.vertices, nodes=2.0 * tool.nodes)], worlds=[1])
    worlds.place_tools(np.tile([0.0, 0.0, 6.1], (2, 1, 1)))
    forces = advance(worlds, 24)
    assert forces[1, 2] > 1.2 * forces[0, 2] > 0.0
    worlds.engine._state(1)[1][-1] = np.nan  # type: ignore[attr-defined]
    assert worlds.advance(np.zeros((2, 1, 3)), steps=3).diverged.tolist() == [False, True]
    assert not list(tmp_path.iterdir())
    worlds.close()


@needs_mujoco
def test_steps_that_are_too_long_for_an_organ_are_told() -> None:
    with pytest.warns(SceneWarning, match="forces of contact will shake with steps of"):
        engine_of(make_scene(replace(ELASTIC, young_modulus=2e5, viscosity=50.0)))


@needs_mujoco
def test_an_engines_own_contact_chooses_the_engine() -> None:
    assert choose_engine(contact="mujoco") == "mujoco"
    with pytest.raises(ValueError, match="contact must be 'flags' or 'second_step' or 'mujoco' with engine 'mujoco'"):
        Simulation(scenes.seed(), engine="mujoco", contact="bullet")


@needs_mujoco
def test_the_press_is_an_environment_that_the_expert_succeeds_in() -> None:
    env = gym.make("Spatula/Press-v0", engine="mujoco")
    assert env.spec is not None and env.spec.kwargs["engine"] == "mujoco"
    made: Any = env.unwrapped
    check_env(made, skip_render_check=True)
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="the extra train is not installed")
    checker.check_env(made)
    observation, _ = env.reset(seed=1)
    expert = PressExpert(env)
    for step in range(60):
        if step == 10:
            state = made.save()
        observation, _, _, _, info = env.step(expert(observation))
        if info["is_success"]:
            break
    assert info["is_success"]
    made.restore(state)
    first = [made.step(env.action_space.sample() * 0.0)[0] for _ in range(2)]
    made.restore(state)
    again = [made.step(env.action_space.sample() * 0.0)[0] for _ in range(2)]
    assert np.array_equal(first, again)
    env.close()


def test_held_nodes_gain_no_velocity_against_contact_and_get_it_back() -> None:
    held, dt = Held.zeros(2), 0.01
    positions, velocities = np.zeros((2, 3)), np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    directions = held.take_contact(positions, velocities, dt)
    assert directions.tolist() == [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    before = velocities.copy()
    velocities += [0.5, 0.0, -3.0]
    positions += dt * velocities
    held.hold(directions, before, positions, velocities, dt, 1.0)
    assert velocities.tolist() == [[0.5, 0.0, 1.0], [0.5, 0.0, -3.0]]
    np.testing.assert_allclose(positions, dt * velocities)
    held.give_free(positions, velocities, dt)
    # Contact gets the velocity that the node would have, at a place no farther away than is allowed.
    assert velocities[0].tolist() == [0.5, 0.0, -2.0]
    np.testing.assert_allclose(positions[0], [0.005, 0.0, 0.01 - 0.005])
    # It leaves the node alone, which is then as if held, and gets the difference back in many steps.
    assert not held.take_contact(positions, velocities, dt).any()
    np.testing.assert_allclose(velocities[0], [0.5, 0.0, 1.0])
    np.testing.assert_allclose(held.debts[0], [0.0, 0.0, -3.0])


@pytest.mark.parametrize(
    ("material", "told"),
    [
        (
            Material.brain("cortex", poisson_ratio=0.3),
            "model of the material of organ .* must be 'neo_hookean', got 'ri",
        ),
        (replace(UNSTATED, relaxation=((0.3, 2.0),)), r"relaxation of the material .* must be empty, got \(\(0.3"),
        (Material(poisson_ratio=0.49), "poisson_ratio of the material .* must be at most 0.4, .* got 0.49"),
    ],
)
def test_materials_without_a_counterpart_are_refused(material: Material, told: str) -> None:
    scene = scenes.seed(material=material)
    with pytest.raises(ValueError, match=told):
        FlexOrgan.of(scene.organs[0], scene.scale)


def test_a_missing_or_old_mujoco_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"engine='mujoco' needs MuJoCo 4.0 .*pip install .*\[mujoco\]") as raised:
        gym.make("Spatula/Press-v0", engine="mujoco")
    assert raised.value.name == "mujoco"
    monkeypatch.setitem(sys.modules, "mujoco", SimpleNamespace(__version__="3.17.0"))
    with pytest.raises(ImportError, match=r"version 3.17.0 is installed"):
        import_mujoco()
