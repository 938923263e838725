"""The state of a simulation: determinism, saving and restoring, several simulations at once, and memory."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from driving import everything, press, start_above

from spatula_env import scenes
from spatula_env.sim import Simulation
from spatula_env.sim.batch import BatchSimulation

EXACT = 1e-9


@pytest.fixture(scope="module")
def pair():
    """Two simulations of one scene."""
    simulations = Simulation(scenes.seed()), Simulation(scenes.seed())
    yield simulations
    for simulation in simulations:
        simulation.close()


def drive(simulation, steps=80):
    """Press, drag and turn; return all that can be seen of every step."""
    seen = []
    for k in range(steps):
        linear = (2.0, 0.5, -20.0) if k < steps // 2 else (-1.0, 0.0, 5.0)
        report = simulation.step(linear, (0.2, 0.0, 1.0))
        seen.append(
            np.concatenate(
                [
                    everything(simulation),
                    report.force,
                    report.torque,
                    report.nodal_impulses.ravel(),
                    report.contacts.depth,
                    [report.penetration, report.residual],
                ]
            )
        )
    return np.array(seen)


def ready(simulation):
    """Reset, and put the tool just above the organ."""
    top = start_above(simulation)
    simulation.place_tool((0.0, 0.0, top + 0.1))


# Determinism -------------------------------------------------------------------------------------------------------


def test_two_simulations_go_on_identically(pair):
    one, other = pair
    ready(one)
    ready(other)
    assert everything(one).tobytes() == everything(other).tobytes()
    seen = drive(one)
    assert seen[:, -2].max() > 0.0
    assert seen.tobytes() == drive(other).tobytes()


def test_after_another_reset_the_same_happens_again(pair):
    simulation = pair[0]
    ready(simulation)
    first = drive(simulation)
    for speed in (60.0, 1.0):
        # Whatever happened in between.
        press(simulation, 1.0, speed)
        ready(simulation)
        assert drive(simulation).tobytes() == first.tobytes()


def test_the_first_run_is_like_all_others(pair):
    # No run has gone before in a new simulation, not even a reset.
    new = Simulation(scenes.seed())
    new.place_tool((0.0, 0.0, new.nodes[:, 2].max() + 0.1))
    first = drive(new)
    new.reset()
    new.place_tool((0.0, 0.0, new.nodes[:, 2].max() + 0.1))
    assert drive(new).tobytes() == first.tobytes()
    new.close()


@pytest.mark.parametrize("seed", [None, 0, 1, 2**31])
def test_the_seed_of_a_reset_changes_nothing(pair, seed):
    simulation = pair[0]
    simulation.reset()
    expected = everything(simulation)
    simulation.reset(seed=seed)
    np.testing.assert_array_equal(everything(simulation), expected)


def digest(simulation):
    ready(simulation)
    return hashlib.sha256(drive(simulation).tobytes()).hexdigest()


def test_another_process_finds_the_same_bits(pair):
    here = Path(__file__).parent
    code = (
        "import test_simulation_state as t; from spatula_env import scenes; from spatula_env.sim import Simulation;"
        " s = Simulation(scenes.seed()); print('digest', t.digest(s)); s.close()"
    )
    root = Path(sys.modules["spatula_env"].__file__).parents[1]
    paths = os.pathsep.join([str(here), str(root), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=True,
        timeout=240,
    )
    assert f"digest {digest(pair[1])}" in done.stdout


# Saving and restoring ----------------------------------------------------------------------------------------------


def arrive(simulation, situation):
    """Bring a simulation to where its state is to be saved."""
    if situation == "at rest":
        simulation.reset()
    elif situation == "before contact":
        ready(simulation)
        simulation.step((0.0, 0.0, -20.0))
    elif situation == "in contact":
        press(simulation, 0.8, 5.0, 0.1)
    elif situation == "mid-press":
        press(simulation, 0.8, 60.0)
    elif situation == "after release":
        press(simulation, 0.8, 5.0)
        for _ in range(60):
            simulation.step((0.0, 0.0, 8.0))


SITUATIONS = ["at rest", "before contact", "in contact", "mid-press", "after release"]


def assert_next_steps_equal(simulation, others, steps=50):
    """Compare `steps` steps of drives that go on from the same state."""
    expected = drive(simulation, steps)
    count = 3 * len(simulation.nodes)
    for other, state in others:
        other.restore(state)
        seen = drive(other, steps)
        np.testing.assert_allclose(seen[:, :count], expected[:, :count], rtol=0.0, atol=EXACT)
        # Velocities and forces are positions' differences divided by the time step once and twice. A rounding error of
        # either position counts, and a solve that ends on a tolerance passes it on.
        dt = simulation.dt
        np.testing.assert_allclose(
            seen[:, count : 2 * count], expected[:, count : 2 * count], rtol=0.0, atol=4.0 * EXACT / dt
        )
        np.testing.assert_array_equal(seen[:, 2 * count : 2 * count + 8], expected[:, 2 * count : 2 * count + 8])
        force = slice(2 * count + 8, 2 * count + 14)
        np.testing.assert_allclose(seen[:, force], expected[:, force], rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("situation", SITUATIONS)
def test_restore_goes_on_as_before(pair, situation):
    one, other = pair
    other.reset()
    arrive(one, situation)
    state = one.save()
    kept = everything(one)
    # In the simulation that saved, later; in another that has done other things.
    press(other, 0.3, 20.0)
    assert_next_steps_equal(one, [(one, state), (other, state), (one, state)])
    one.restore(state)
    np.testing.assert_array_equal(everything(one), kept)


@pytest.mark.bullet
def test_restore_brings_the_flags_back():
    # Flags that no pose tells: inside, the top's were set by a small step up. With Bullet's own contact the detector
    # only watches, and the hollow organ does not mind a tool in its middle.
    one, other = (Simulation(scenes.seed(), contact="bullet") for _ in range(2))
    one.place_tool((0.0, 0.0, 4.0))
    one.step((0.0, 0.0, 0.1))
    state = one.save()
    tool = one.scene.tools[0].tool
    for simulation in (one, other, one):
        simulation.restore(state)
        np.testing.assert_array_equal(simulation.save().flags, state.flags)
        for _ in range(3):
            contacts = simulation.step((0.0, 0.0, -0.1)).contacts
            np.testing.assert_array_equal(contacts.flags, tool.face == 1)
    # Without them the step down would choose the bottom.
    one.restore(state)
    one.place_tool(state.tool_positions[0])
    np.testing.assert_array_equal(one.step((0.0, 0.0, -0.1)).contacts.flags, tool.face == 0)
    one.close()
    other.close()


def test_a_state_is_not_changed_by_what_follows(pair):
    simulation = pair[0]
    arrive(simulation, "in contact")
    state = simulation.save()
    arrays = [state.nodes, state.node_velocities, state.tool_positions, state.tool_orientations, state.flags[0][0]]
    kept = [array.copy() for array in arrays]
    drive(simulation, 20)
    simulation.restore(state)
    drive(simulation, 20)
    simulation.reset()
    for array, before in zip(arrays, kept, strict=True):
        np.testing.assert_array_equal(array, before)
    # Nor does the simulation change with a state that it gave, or took.
    simulation.restore(state)
    before, given = everything(simulation), simulation.save()
    for array in (*arrays, given.nodes, given.node_velocities, given.tool_positions, given.tool_orientations):
        array[...] = 1
    np.testing.assert_array_equal(everything(simulation), before)
    simulation.step()


def test_a_state_of_another_scene_is_refused(pair):
    simulation = pair[0]
    arrive(simulation, "in contact")
    state, before = simulation.save(), everything(simulation)
    bad = {
        "nodes": state.nodes[:-1],
        "node_velocities": state.node_velocities[:-1],
        "tool_positions": np.zeros((2, 3)),
        "tool_orientations": np.zeros((2, 4)),
        "contact": dataclasses.replace(state.contact, flags=((state.flags[0][0][:-1],),)),
    }
    for name, value in bad.items():
        with pytest.raises(ValueError, match="flags" if name == "contact" else name):
            simulation.restore(dataclasses.replace(state, **{name: value}))
        np.testing.assert_array_equal(everything(simulation), before)
        np.testing.assert_array_equal(simulation.save().flags, state.flags)


@pytest.mark.parametrize("contact", ["second_step", "bullet"])
def test_the_other_contact_models_restore_too(contact):
    simulation = Simulation(scenes.seed(), contact=contact)
    ready(simulation)
    for _ in range(20):
        simulation.step((0.0, 0.0, -5.0))
    state = simulation.save()
    runs = []
    for _ in range(2):
        simulation.restore(state)
        run = []
        for _ in range(20):
            simulation.step((0.0, 0.0, -5.0))
            run.append(simulation.nodes)
        runs.append(run)
    np.testing.assert_allclose(runs[0], runs[1], rtol=0.0, atol=EXACT)
    simulation.close()


# Side by side ------------------------------------------------------------------------------------------------------


def test_three_simulations_at_once_do_not_disturb_each_other(pair):
    trio = [*pair, Simulation(scenes.seed())]
    expected = []
    for speed, simulation in zip((5.0, 20.0, 60.0), trio, strict=True):
        ready(simulation)
        expected.append([simulation.step((0.0, 0.0, -speed)).force for _ in range(30)] + [simulation.nodes])
    for simulation in trio:
        ready(simulation)
    forces = [[], [], []]
    for _ in range(30):
        for k, speed in enumerate((5.0, 20.0, 60.0)):
            forces[k].append(trio[k].step((0.0, 0.0, -speed)).force)
    for k in range(3):
        np.testing.assert_array_equal(forces[k], expected[k][:-1])
        np.testing.assert_array_equal(trio[k].nodes, expected[k][-1])
    # Closing one leaves the others alive.
    trio[2].close()
    assert np.isfinite(trio[0].step().force).all()
    assert np.isfinite(trio[1].step().force).all()


# Memory ------------------------------------------------------------------------------------------------------------


def resident_bytes():
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


needs_proc = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")


@needs_proc
def test_resets_do_not_let_memory_grow(pair):
    simulation = pair[0]
    for _ in range(100):
        simulation.reset()
    before = resident_bytes()
    for _ in range(200):
        simulation.reset()
    assert resident_bytes() - before < 4e6


@needs_proc
def test_steps_in_contact_do_not_let_memory_grow(pair):
    simulation = pair[0]
    press(simulation, 0.8, 20.0, 0.5)
    before = resident_bytes()
    for _ in range(400):
        report = simulation.step()
    assert report.contacts.flags.any()
    assert resident_bytes() - before < 4e6


@needs_proc
def test_saving_and_restoring_does_not_let_memory_grow(pair):
    simulation = pair[0]
    press(simulation, 0.8, 20.0)
    state = simulation.save()
    for _ in range(100):
        simulation.restore(state)
    before = resident_bytes()
    for _ in range(200):
        simulation.restore(state)
        state = simulation.save()
    assert resident_bytes() - before < 4e6


# Energy that a state was given by hand -------------------------------------------------------------------------------


def spun(simulation, rate=1.0):
    """The simulation's state with its organ turning about its middle."""
    state = simulation.save()
    arms = state.nodes - state.nodes.mean(axis=0)
    return replace(state, node_velocities=np.cross([0.0, 0.0, rate], arms))


def energy(simulation):
    masses = np.where(np.isfinite(simulation.node_masses), simulation.node_masses, 0.0)
    return 0.5 * float(masses @ (simulation.node_velocities**2).sum(axis=1))


@pytest.mark.parametrize("engine", ["batch", "bullet"])
@pytest.mark.parametrize("touched", [False, True])
def test_a_state_keeps_the_energy_that_it_was_given(engine, touched):
    simulation = Simulation(scenes.seed(), engine=engine)
    try:
        if touched:
            # A tool has just come to touch: its little work is counted, and the organ's energy limited to that.
            ready(simulation)
            while not simulation.step((0.0, 0.0, -5.0)).force.any():
                pass
            simulation.place_tool((0.0, 0.0, 20.0))
        # More than that work.
        simulation.restore(spun(simulation, 8.0 if touched else 1.0))
        before = energy(simulation)
        simulation.step()
        # It lost 99.99 % of it. Friction on the ground takes a little, and what was dented swings back.
        assert energy(simulation) > 0.9 * before
    finally:
        simulation.close()


def test_worlds_keep_the_energy_that_they_were_given():
    worlds = BatchSimulation(scenes.seed(), 2)
    state = worlds.save()
    arms = state.nodes[1] - state.nodes[1].mean(axis=0)
    velocities = state.node_velocities.copy()
    velocities[1] = np.cross([0.0, 0.0, 1.0], arms)
    worlds.restore(replace(state, node_velocities=velocities))
    worlds.advance(np.zeros((2, 1, 3)), steps=1)
    squares = (worlds.node_velocities**2).sum(axis=(1, 2))
    assert squares[0] < 1e-3
    assert squares[1] > 0.9 * (velocities[1] ** 2).sum()


def test_a_tool_adds_its_work_to_what_a_state_was_given_and_no_more():
    simulation = Simulation(scenes.seed(), engine="batch", precision="double")
    try:
        simulation.restore(spun(simulation, 0.5))
        given = energy(simulation)
        height = simulation.node_masses @ simulation.nodes[:, 2]
        work = 0.0
        for step in range(400):
            velocity = np.array([0.0, 0.0, -20.0 if step < 48 else (0.0 if step < 96 else 40.0)])
            report = simulation.step(velocity)
            work -= float(report.force @ velocity) * simulation.dt
            fallen = simulation.scene.gravity * (simulation.node_masses @ simulation.nodes[:, 2] - height)
            assert energy(simulation) - fallen <= 1.01 * (given + max(work, 0.0)) + 1.0
        assert work > 100.0
    finally:
        simulation.close()


# What kernels are handed ---------------------------------------------------------------------------------------------


def test_numbers_may_be_of_any_type_and_arrays_in_any_order():
    scene = scenes.seed()
    whole = replace(scene, tools=(replace(scene.tools[0], friction=1),))
    outcomes = []
    for chosen, order, kind in (
        (replace(scene, tools=(replace(scene.tools[0], friction=1.0),)), "C", np.float64),
        (whole, "F", np.float64),
        (whole, "F", np.int64),
    ):
        simulation = Simulation(chosen, engine="batch")
        try:
            state = simulation.save()
            simulation.restore(replace(state, nodes=np.asfortranarray(state.nodes)))
            for _ in range(40):
                report = simulation.step(
                    np.array([[0.0, 0.0, -20.0]], dtype=kind, order=order), np.zeros((1, 3), dtype=kind, order=order)
                )
            outcomes.append(report.force)
        finally:
            simulation.close()
    assert np.linalg.norm(outcomes[0]) > 0.0
    np.testing.assert_array_equal(outcomes[1], outcomes[0])
    np.testing.assert_array_equal(outcomes[2], outcomes[0])


def test_velocities_of_several_tools_may_be_in_fortran_order():
    simulation = Simulation(scenes.clamp(), engine="batch")
    worlds = BatchSimulation(scenes.clamp(), 3)
    velocities = np.array([[1.0, 0.0, -1.0], [-1.0, 0.0, -1.0]])
    try:
        simulation.step(np.asfortranarray(velocities), np.asfortranarray(velocities))
        turned = simulation.tool_orientations
        simulation.reset()
        simulation.step(velocities, velocities)
        np.testing.assert_array_equal(simulation.tool_orientations, turned)
        simulation.restore(replace(simulation.save(), nodes=simulation.nodes.astype(np.float32)))
        simulation.step()
        worlds.advance(np.asfortranarray(np.tile(velocities, (3, 1, 1))), steps=2)
    finally:
        simulation.close()
