from __future__ import annotations

import numba
import numpy as np
import pytest

from spatula_env import scenes
from spatula_env.geometry import Tool, fissured_block, icosphere, seed_sphere
from spatula_env.scenes import PlacedOrgan, PlacedTool, Scene
from spatula_env.sim.batch_body import BatchBody
from spatula_env.sim.bullet import BulletWorld
from spatula_env.sim.soft_body import join, soft_body

PRECISIONS = pytest.mark.parametrize("dtype", [np.float32, np.float64])
BALL = PlacedOrgan(icosphere(2.0, 1), mass=3.0)
HELD = PlacedOrgan(icosphere(2.0, 1), mass=3.0, fixed_nodes=(0, 5, 12))


def pushes(body, worlds, seed=0):
    """Changes of velocity of some nodes and displacements of others, in every world its own."""
    generator = np.random.default_rng(seed)
    shape = (worlds, len(body.vertices), 3)
    changes = generator.normal(scale=2.0, size=shape) * (generator.random(shape[:2]) < 0.1)[..., None]
    displacements = generator.normal(scale=0.02, size=shape) * (generator.random(shape[:2]) < 0.1)[..., None]
    return changes, displacements


def run(batch, steps=10, seed=0):
    """Push the nodes in every step, and return the state that the worlds are in then."""
    for step in range(steps):
        batch.step(*pushes(batch.body, batch.worlds, seed + step))
    return np.concatenate(batch.get_state(), axis=1)


# Like Bullet -------------------------------------------------------------------------------------------------------

LIKE_BULLET = {
    "seed": scenes.seed().organs[0],
    "icosphere": PlacedOrgan(icosphere(2.0, 2), position=(1.0, 2.0, 3.0), orientation=(0.5, 0.1, -0.7, 0.5), mass=4.0),
    "held": HELD,
    "fissure": PlacedOrgan(fissured_block(edge_length=0.5), fixed_nodes=tuple(range(0, 60, 3))),
}


@pytest.mark.bullet
@pytest.mark.parametrize("name", LIKE_BULLET)
def test_nodes_move_as_in_bullet(name):
    placed = LIKE_BULLET[name]
    scene = Scene((placed,), (PlacedTool(Tool.box(), (0.0, 0.0, 50.0)),), ground=None)
    body = soft_body(placed)
    double = BatchBody(body, dtype=np.float64)
    single = BatchBody(body)
    world = BulletWorld(scene)
    moved = 0.0
    try:
        velocities = np.random.default_rng(1).normal(size=body.vertices.shape)
        velocities[body.inverse_masses == 0.0] = 0.0
        positions = body.vertices
        world.set_state(positions)
        for batch in (double, single):
            batch.set_state(body.vertices, velocities)
        for step in range(40):
            changes, displacements = pushes(body, 1, step)
            displacements[:, body.inverse_masses == 0.0] = 0.0
            positions, velocities = world.step(positions + displacements[0], velocities + changes[0])
            double.step(changes, displacements)
            single.step(changes, displacements)
            assert np.abs(double.positions[0] - positions).max() < 1e-8
            assert np.abs(double.velocities[0] - velocities).max() < 1e-5
            moved = max(moved, float(np.abs(positions - body.vertices).max()))
    finally:
        world.close()
    assert moved > 0.005
    assert 0.0 < np.abs(single.positions[0] - positions).max() < 1e-3


@pytest.mark.bullet
def test_the_inverse_masses_are_those_of_the_bullet_world():
    scene = Scene((HELD, BALL), (PlacedTool(Tool.box(), (0.0, 0.0, 50.0)),))
    world = BulletWorld(scene)
    batch = BatchBody(join([soft_body(placed) for placed in scene.organs]))
    assert np.array_equal(batch.inverse_masses[0], world.inverse_masses)
    world.close()


# Worlds side by side -----------------------------------------------------------------------------------------------


@PRECISIONS
def test_a_world_does_not_depend_on_the_others(dtype):
    body = soft_body(HELD)
    generator = np.random.default_rng(0)
    gravity, stiffness = generator.uniform(0.0, 20.0, 19), generator.uniform(0.3, 1.2, 19)
    worlds = [pushes(body, 19, seed=step) for step in range(8)]
    states = []
    # Blocks of sixteen and of eight worlds, the last one not full; many threads; and worlds one by one.
    for lanes, parallel in ((16, False), (8, False), (8, True)):
        many = BatchBody(body, 19, gravity=gravity, dtype=dtype, lanes=lanes, parallel=parallel)
        many.set_parameters(stiffness=stiffness)
        for changes, displacements in worlds:
            many.step(changes, displacements)
        states.append(np.concatenate(many.get_state(), axis=1))
    assert states[0].tobytes() == states[1].tobytes() == states[2].tobytes()
    for index in (0, 7, 8, 15, 18):
        alone = BatchBody(body, gravity=gravity[index], dtype=dtype)
        alone.set_parameters(stiffness=stiffness[index])
        for changes, displacements in worlds:
            alone.step(changes[index : index + 1], displacements[index : index + 1])
        assert np.concatenate(alone.get_state(), axis=1)[0].tobytes() == states[0][index].tobytes()
    assert len({state.tobytes() for state in states[0]}) == 19


@PRECISIONS
@pytest.mark.parametrize("worlds", [1, 5, 17])
def test_the_same_happens_again(worlds, dtype):
    first = run(BatchBody(soft_body(BALL), worlds, dtype=dtype))
    assert np.abs(first).max() > 1.0
    assert run(BatchBody(soft_body(BALL), worlds, dtype=dtype)).tobytes() == first.tobytes()


def test_the_number_of_threads_makes_no_difference():
    before = numba.get_num_threads()
    states = []
    try:
        for threads in (1, before):
            numba.set_num_threads(threads)
            states.append(run(BatchBody(soft_body(BALL), 40, parallel=True)))
    finally:
        numba.set_num_threads(before)
    assert states[0].tobytes() == states[1].tobytes()


def test_a_world_that_diverges_leaves_the_others_alone_and_can_be_reset():
    body = soft_body(HELD)
    whole, broken = BatchBody(body, 10), BatchBody(body, 10)
    for step in range(6):
        changes, displacements = pushes(body, 10, step)
        whole.step(changes, displacements)
        changes[3, 7, 1] = np.nan if step == 2 else 0.0
        broken.step(changes, displacements)
        assert broken.finite.tolist() == [step < 2 or world != 3 for world in range(10)]
    others = np.arange(10) != 3
    assert np.array_equal(whole.positions[others], broken.positions[others])
    assert not np.isfinite(broken.positions[3]).all()
    broken.set_state(body.vertices, worlds=[3])
    assert broken.finite.all()
    broken.step()
    fresh = BatchBody(body)
    fresh.step()
    assert broken.finite.all()
    assert np.array_equal(broken.positions[3], fresh.positions[0])


# Going back --------------------------------------------------------------------------------------------------------


@PRECISIONS
@pytest.mark.parametrize("worlds", [1, 6, 18])
def test_a_subset_goes_back_to_what_was_saved_and_goes_on_as_then(worlds, dtype):
    body = soft_body(BALL)
    batch = BatchBody(body, worlds, dtype=dtype)
    run(batch, 5)
    chosen = np.unique([0, worlds // 2, worlds - 1])
    saved = batch.get_state(chosen)
    first = run(batch, 5, seed=50)
    before = batch.get_state()
    batch.set_state(*saved, worlds=chosen)
    others = np.setdiff1d(np.arange(worlds), chosen)
    for now, then in zip(batch.get_state(), before, strict=True):
        assert np.array_equal(now[others], then[others])
    again = run(batch, 5, seed=50)
    assert np.array_equal(again[chosen], first[chosen])
    assert not (again[others] == first[others]).all(axis=(1, 2)).any()


def test_one_state_for_many_worlds_and_a_mask_that_chooses_them():
    body = soft_body(BALL)
    batch = BatchBody(body, 9)
    run(batch, 3)
    mask = np.arange(9) % 3 == 1
    raised = body.vertices + np.array([0.0, 0.0, 2.0])
    batch.set_state(raised, worlds=mask)
    positions, velocities = batch.get_state(mask)
    assert np.array_equal(positions, np.repeat(raised[None].astype(np.float32), 3, axis=0))
    assert not velocities.any()
    assert batch.get_state(~mask)[1].any(axis=(1, 2)).all()
    batch.set_state(raised, worlds=np.zeros(9, dtype=bool))
    assert not np.array_equal(batch.positions[0], raised.astype(np.float32))


def test_what_is_read_is_a_copy():
    batch = BatchBody(soft_body(BALL), 2)
    for read in ("positions", "velocities", "gravity", "stiffness", "mass_scale", "inverse_masses"):
        getattr(batch, read)[:] = 7.0
        assert not (getattr(batch, read) == 7.0).all()


# Physics -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-11), (np.float32, 6e-4)])
def test_a_free_body_falls_as_a_stone(dtype, tolerance):
    # x_n = x_0 - g dt^2 n (n + 1) / 2 (semi-implicit Euler), whatever the links do.
    gravity = np.array([10.0, 0.0, 3.7])
    body = soft_body(BALL)
    batch = BatchBody(body, 3, gravity=gravity, dtype=dtype)
    for _ in range(200):
        batch.step()
    weights = body.masses / body.masses.sum()
    fallen = weights @ body.vertices - np.einsum("i,wij->wj", weights, batch.positions)
    expected = gravity * batch.dt**2 * 200 * 201 / 2
    assert np.abs(fallen[:, 2] - expected).max() < tolerance
    assert np.abs(fallen[:, :2]).max() < tolerance
    assert np.abs(np.einsum("i,wi->w", weights, batch.velocities[..., 2]) + 200 * gravity * batch.dt).max() < tolerance


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-12), (np.float32, 1e-3)])
def test_momentum_changes_by_what_was_given(dtype, tolerance):
    body = soft_body(BALL)
    batch = BatchBody(body, 4, gravity=0.0, dtype=dtype)
    given = np.zeros((4, 3))
    for step in range(60):
        changes, _ = pushes(body, 4, step)
        batch.step(changes)
        given += np.einsum("i,wij->wj", body.masses, changes)
    momentum = np.einsum("i,wij->wj", body.masses, batch.velocities)
    assert np.abs(given).max() > 1.0
    assert np.abs(momentum - given).max() < tolerance * np.abs(given).max()


@PRECISIONS
def test_fixed_nodes_stay_whatever_is_asked_of_them(dtype):
    body = soft_body(HELD)
    batch = BatchBody(body, 3, dtype=dtype)
    batch.set_state(body.vertices, np.ones_like(body.vertices))
    fixed = list(HELD.fixed_nodes)
    start = batch.positions[:, fixed]
    for _ in range(20):
        batch.step(np.ones((3, *body.vertices.shape)), np.full((3, *body.vertices.shape), 0.01))
    assert np.array_equal(batch.positions[:, fixed], start)
    assert not batch.velocities[:, fixed].any()
    free = body.inverse_masses > 0.0
    assert np.abs(batch.positions[:, free] - body.vertices[free]).max(axis=(1, 2)).min() > 0.01


@PRECISIONS
def test_a_displacement_leaves_the_velocity(dtype):
    body = soft_body(BALL)
    batch = BatchBody(body, 2, gravity=0.0, dtype=dtype)
    batch.set_parameters(stiffness=0.0)
    displacements = np.zeros((2, *body.vertices.shape))
    displacements[1, 4] = (0.25, -0.5, 0.125)
    start = batch.positions
    batch.step(displacements=displacements)
    assert np.allclose(batch.positions - start, displacements, atol=1e-6)
    assert not batch.velocities.any()
    # What was asked for is not asked for again.
    batch.step()
    batch.step(velocity_changes=np.zeros_like(displacements))
    assert np.allclose(batch.positions - start, displacements, atol=1e-6)


def test_a_body_at_rest_stays():
    batch = BatchBody(soft_body(BALL), 2, gravity=0.0, dtype=np.float64)
    for _ in range(50):
        batch.step()
    assert np.abs(batch.positions - batch.body.vertices).max() < 1e-13


def test_stiffer_worlds_give_way_less():
    batch = BatchBody(soft_body(HELD), 4)
    batch.set_parameters(stiffness=[0.1, 0.3, 1.0, 0.0])
    for _ in range(20):
        batch.step()
    sag = np.abs(batch.positions - batch.body.vertices).max(axis=(1, 2))
    assert sag[3] > sag[0] > sag[1] > sag[2] > 0.0


def test_mass_tells_in_what_forces_do_and_not_in_how_it_falls():
    batch = BatchBody(soft_body(HELD), 3)
    batch.set_parameters(mass_scale=4.0, worlds=[1])
    batch.step()
    assert np.array_equal(batch.positions[0], batch.positions[1])
    masses = batch.inverse_masses
    assert np.array_equal(masses[1], masses[0] / 4.0)
    assert np.array_equal(masses[2], batch.body.inverse_masses)
    assert batch.mass_scale.tolist() == [1.0, 4.0, 1.0]


# Arguments ---------------------------------------------------------------------------------------------------------


def test_parameters_of_some_worlds_change():
    batch = BatchBody(soft_body(BALL), 20, gravity=np.arange(20.0))
    batch.set_parameters(gravity=[1.5, 2.5], stiffness=0.5, worlds=[18, 3])
    assert batch.gravity[[18, 3, 4]].tolist() == [1.5, 2.5, 4.0]
    assert np.flatnonzero(batch.stiffness == 0.5).tolist() == [3, 18]
    assert batch.stiffness.shape == (20,)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"gravity": [1.0, 2.0]}, r"gravity must be a number or have shape \(3,\), got \(2,\)"),
        ({"gravity": [1.0, 2.0, np.nan]}, "gravity must be finite, in world 2"),
        ({"stiffness": 2.0}, "stiffness must be zero to less than 2, in world 0 it is not, got 2"),
        ({"stiffness": [1.0, -0.5], "worlds": [2, 1]}, "stiffness .* in world 1 .*-0.5"),
        ({"mass_scale": 0.0}, "mass_scale must be more than zero"),
        ({"gravity": 1.0, "worlds": [3]}, r"worlds must be indices in 0..2 or a mask of shape \(3,\), got \[3\]"),
        ({"gravity": 1.0, "worlds": [0.5]}, "worlds must be indices"),
        ({"gravity": 1.0, "worlds": [True, False]}, "worlds must be indices"),
    ],
)
def test_bad_parameters_change_nothing(arguments, message):
    batch = BatchBody(soft_body(BALL), 3)
    with pytest.raises(ValueError, match=message):
        batch.set_parameters(**{"gravity": 5.0, **arguments})
    assert batch.gravity.tolist() == [10.0] * 3
    assert batch.stiffness.tolist() == batch.mass_scale.tolist() == [1.0] * 3


def test_bad_states_change_nothing():
    body = soft_body(BALL)
    batch = BatchBody(body, 3)
    start = batch.positions
    bad = np.repeat(body.vertices[None] + 1.0, 2, axis=0)
    bad[1, 2, 0] = np.inf
    with pytest.raises(ValueError, match="positions must be finite, in world 2 it is not"):
        batch.set_state(bad, worlds=[0, 2])
    with pytest.raises(ValueError, match="velocities must have shape"):
        batch.set_state(body.vertices + 1.0, np.zeros(3))
    with pytest.raises(ValueError, match="positions must have shape"):
        batch.set_state(0.0)
    assert np.array_equal(batch.positions, start)


@pytest.mark.parametrize("name", ["velocity_changes", "displacements"])
def test_pushes_of_another_shape_are_refused(name):
    batch = BatchBody(soft_body(BALL), 3)
    with pytest.raises(ValueError, match=rf"{name} must have shape \(3, 42, 3\), got \(2, 42, 3\)"):
        batch.step(**{name: np.zeros((2, 42, 3))})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"worlds": 0}, "worlds must be an integer, 1 or more, got 0"),
        ({"worlds": 2.5}, "worlds must be an integer"),
        ({"dt": 0.0}, "dt"),
        ({"dtype": np.int32}, "dtype must be float32 or float64, got int32"),
        ({"lanes": 4}, "lanes must be 1, 8 or 16, got 4"),
        ({"gravity": np.inf}, "gravity must be finite"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        BatchBody(soft_body(BALL), **arguments)


def test_read_only_arguments_are_taken():
    body = soft_body(PlacedOrgan(seed_sphere(node_count=60)))
    batch = BatchBody(body, 2)
    state = np.repeat(body.vertices[None], 2, axis=0)
    nothing = np.zeros_like(state)
    for array in (state, nothing):
        array.setflags(write=False)
    batch.set_state(state, nothing)
    batch.step(nothing, nothing)
    assert batch.finite.all()


@PRECISIONS
@pytest.mark.parametrize("worlds", [1, 8, 40])
def test_vectors_do_not_straddle_cache_lines(worlds, dtype):
    blocks = BatchBody(soft_body(BALL), worlds, dtype=dtype).blocks
    for array in (blocks.positions, blocks.velocities, blocks.stiffness):
        assert array.ctypes.data % 64 == 0
        assert array.flags.c_contiguous
