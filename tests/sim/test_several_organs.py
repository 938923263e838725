"""Organs push each other, lie on each other, and are not pressed through themselves."""

from __future__ import annotations

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from benchmarks.crossings import CrossingCounter
from benchmarks.motions import MOTIONS
from spatula_env import Simulation, scenes
from spatula_env.geometry import Tool, box_surface, icosphere
from spatula_env.scenes import PlacedOrgan, PlacedTool, Scene
from spatula_env.sim.batch import BatchSimulation
from spatula_env.sim.report import LONGEST_CROSSED

BALL = icosphere(1.0, 2)
UPRIGHT = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))

ENGINES = ["batch", "bullet"]


def counter_of(simulation):
    """Counts crossings by other means than contact does."""
    sizes = [len(placed.organ.vertices) for placed in simulation.scene.organs]
    return CrossingCounter(simulation.nodes, simulation.triangles, np.repeat(np.arange(len(sizes)), sizes))


def crossings(counter, simulation):
    found = counter.count(simulation.nodes)
    return found.own + found.between


@pytest.mark.parametrize("engine", ENGINES)
def test_a_ball_pushed_by_a_tool_pushes_another_and_momentum_is_kept(engine):
    scene = Scene(
        organs=(PlacedOrgan(BALL, mass=2.0), PlacedOrgan(BALL, (2.1, 0.1, 0.05), mass=5.0)),
        tools=(PlacedTool(Tool.box((1.6, 1.6, 0.2), 5, "all"), (-1.2, 0.0, 0.0), UPRIGHT),),
        ground=None,
        gravity=0.0,
    )
    simulation = Simulation(scene, engine=engine, precision="double")
    counter, masses = counter_of(simulation), simulation.node_masses[:, None]
    for step in range(200):
        before = simulation.node_velocities
        report = simulation.step((1.5, 0.0, 0.0) if step < 150 else (0.0, 0.0, 0.0))
        gained = (masses * (simulation.node_velocities - before)).sum(axis=0)
        np.testing.assert_allclose(gained, -report.loads[:, :3].sum(axis=0) * simulation.dt, atol=1e-9)
        assert crossings(counter, simulation) == 0
        assert report.residual < 0.01 and report.crossings == 0 and not report.tangled
    second = slice(len(BALL.vertices), None)
    assert (masses * simulation.node_velocities)[second].sum(axis=0)[0] > 5.0
    simulation.close()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_ball_that_falls_on_a_slab_lies_still_there(engine):
    slab = box_surface((4.0, 4.0, 1.0), 0.5)
    edge = tuple(np.flatnonzero(np.abs(slab.vertices[:, :2]).max(axis=1) > 1.9).tolist())
    scene = Scene(
        organs=(
            PlacedOrgan(slab, (0.0, 0.0, 0.5), mass=20.0, fixed_nodes=edge),
            PlacedOrgan(BALL, (0.1, 0.0, 2.2), mass=1.0),
        ),
        tools=(PlacedTool(Tool.box((1.0, 1.0, 0.2), 5), (0.0, 0.0, 8.0)),),
    )
    simulation = Simulation(scene, engine=engine)
    counter = counter_of(simulation)
    second = slice(len(slab.vertices), None)
    resting = simulation.nodes[second]
    assert 1.0 < resting[:, 2].mean() < 2.1
    for _ in range(120):
        simulation.step()
        assert crossings(counter, simulation) == 0
    assert np.abs(simulation.nodes[second] - resting).max() < 0.01
    # Let fall from where it is thrown up to.
    state = simulation.save()
    lifted = state.nodes.copy()
    lifted[second, 2] += 0.5
    simulation.restore(replace(state, nodes=lifted))
    for _ in range(360):
        simulation.step()
        assert crossings(counter, simulation) == 0
    # It bounces a little, and stays on top.
    assert 1.8 < simulation.nodes[second, 2].mean() < 2.2
    simulation.close()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_fold_that_is_crushed_presses_back(engine):
    """Its walls used to go through each other: 0.34 N at a millimetre, below every limit."""
    scene = scenes.clamp()
    simulation = Simulation(scene, engine=engine)
    counter, closing = counter_of(simulation), np.zeros((2, 3))
    closing[:, 1] = 0.6, -0.6
    forces, pressures = [], []
    # Until two millimetres are left between the jaws.
    while np.ptp(simulation.tool_positions[:, 1]) - scene.tools[0].tool.size[2] > 0.1:
        report = simulation.step(closing)
        assert crossings(counter, simulation) == 0
        assert report.residual < 0.01
        forces.append(float(np.linalg.norm(report.loads[0, :3])) * scene.scale.force)
        pressures.append(report.peak_pressure_pascals)
    assert max(forces) > 0.7
    assert max(pressures) > 4000.0
    simulation.close()


@pytest.mark.parametrize(("name", "seed"), [("palpate", 1), ("fissure", 3), ("retract", 2)])
def test_random_motions_that_are_kept_for_a_while_fold_nothing_through_itself(name, seed):
    simulation = Simulation(getattr(scenes, name)(), engine="batch")
    counter = counter_of(simulation)
    linear, angular = MOTIONS["random"](simulation, 2.0, np.random.default_rng(seed))
    longest = since = 0
    for velocity, turning in zip(linear, angular, strict=True):
        report = simulation.step(velocity, turning)
        since = since + 1 if crossings(counter, simulation) else 0
        longest = max(longest, since)
        assert not report.tangled
    assert longest * simulation.dt < 0.1
    simulation.close()


def tangled_state(simulation):
    """A held node of the organ's bottom put above its top, as no motion would."""
    state = simulation.save()
    nodes = state.nodes.copy()
    held = np.flatnonzero(~np.isfinite(simulation.node_masses))
    lowest = held[np.argmin(nodes[held, 2])]
    nodes[lowest, 2] = nodes[:, 2].max() + 1.0
    return replace(state, nodes=nodes)


def test_a_tangle_that_was_put_there_is_told_and_can_end_an_episode():
    simulation = Simulation(scenes.palpate(), engine="batch")
    counter = counter_of(simulation)
    simulation.restore(tangled_state(simulation))
    told = []
    for _ in range(40):
        report = simulation.step()
        assert report.crossings > 0 and crossings(counter, simulation) > 0
        told.append(report.tangled)
    assert told.index(True) * simulation.dt == pytest.approx(LONGEST_CROSSED, abs=1.5 * simulation.dt)
    assert all(told[told.index(True) :])
    # How long it has been is a part of the state.
    saved = simulation.save()
    simulation.reset()
    assert not simulation.step().tangled
    simulation.restore(saved)
    assert simulation.step().tangled
    simulation.close()


def test_a_tangle_that_springs_can_undo_is_undone():
    """The organ's top put below its bottom."""
    simulation = Simulation(scenes.palpate(), engine="batch")
    counter, state = counter_of(simulation), simulation.save()
    nodes = state.nodes.copy()
    inner = np.linalg.norm(nodes[:, :2] - nodes[:, :2].mean(axis=0), axis=1) < 1.2
    nodes[inner & (nodes[:, 2] > nodes[:, 2].mean()), 2] -= 6.5
    assert counter.count(nodes).own > 0
    simulation.restore(replace(state, nodes=nodes))
    for _ in range(24):
        simulation.step()
    assert crossings(counter, simulation) == 0
    simulation.close()


def test_worlds_of_a_batch_tell_their_own_tangles():
    worlds = BatchSimulation(scenes.palpate(), 2)
    single = Simulation(scenes.palpate(), engine="batch")
    state = worlds.save()
    state.nodes[1] = tangled_state(single).nodes
    worlds.restore(state)
    loads = worlds.advance(np.zeros((2, 1, 3)), steps=30)
    assert loads.tangled.tolist() == [False, True]
    saved = worlds.save()
    worlds.reset()
    worlds.restore(saved)
    assert worlds.advance(np.zeros((2, 1, 3)), steps=1).tangled.tolist() == [False, True]
    single.close()


@pytest.mark.parametrize("ends", [False, True])
def test_an_environment_tells_a_tangle(ends):
    env = gymnasium.make("Spatula/Palpate-v0", engine="batch", terminate_on_tangle=ends)
    _, info = env.reset(seed=0)
    assert info["tangled"] is False
    simulation = env.unwrapped.simulation
    simulation.restore(tangled_state(simulation))
    seen = []
    for _ in range(6):
        _, _, terminated, _, info = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
        seen.append((info["tangled"], terminated))
        if terminated:
            break
    assert any(tangled for tangled, _ in seen)
    assert all(terminated == (tangled and ends) for tangled, terminated in seen)
    env.close()
