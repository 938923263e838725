"""The engine "tissue": its forces, what it conserves, and that worlds do not depend on each other."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from spatula_env import scenes
from spatula_env.scenes import Material, Scene
from spatula_env.sim import SceneWarning
from spatula_env.sim.tissue.body import STABILISER, TissueBody
from spatula_env.sim.tissue.hyperelastic import Hyperelastic
from spatula_env.sim.tissue.kernels import advance_blocks
from spatula_env.sim.worlds import Worlds

SHORT = 1e-4
"""A step so short that it is not divided [s]."""

ELASTIC = {
    "neo_hookean": Material(viscosity=0.0),
    "brain": Material.brain("corona_radiata", viscosity=0.0),
}


def make_scene(material: Material, dt: float = SHORT, gravity: float = 0.0) -> Scene:
    return replace(scenes.seed(material=material, dt=dt), gravity=gravity)


def read(body: TissueBody, name: str, world: int = 0) -> np.ndarray:
    return body.read(getattr(body.blocks, name), np.array([world]))[0]


def step_forces(body: TissueBody, nodes: np.ndarray, world: int = 0) -> np.ndarray:
    """(N, 3) forces on the nodes, from the momenta that one step from rest gives them [kg u/s2]."""
    which = np.array([world])
    body.write(body.blocks.positions, which, nodes[None])
    body.write(body.blocks.velocities, which, 0.0)
    advance_blocks(0, len(body.blocks.positions), body.blocks)
    return read(body, "velocities", world) * body.lumps[0].masses[:, None] / body.dt


def bent(body: TissueBody, amount: float = 0.02) -> np.ndarray:
    x, y, z = body.rest.T
    return body.rest + amount * np.column_stack([y * z, np.sin(x) + z, x * y - 0.3 * z**2])


@pytest.mark.parametrize("model", ELASTIC)
@pytest.mark.parametrize(("lanes", "world"), [(1, 0), (8, 3)])
def test_kernels_do_what_numpy_says(model: str, lanes: int, world: int) -> None:
    body = TissueBody(make_scene(ELASTIC[model]), lanes, lanes=lanes, dtype=np.float64)
    lump, nodes = body.lumps[0], bent(body)
    assert body.substeps.tolist() == [[1]]
    stress = lump.law.stress(lump.solid.deformations(nodes))
    expected = lump.solid.forces(stress, nodes, STABILISER * lump.law.shear)
    np.testing.assert_allclose(step_forces(body, nodes, world), expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("model", ELASTIC)
def test_an_affine_displacement_strains_all_tissue_alike(model: str) -> None:
    body = TissueBody(make_scene(ELASTIC[model]), 1, lanes=1, dtype=np.float64)
    lump, f = body.lumps[0], np.array([[1.1, 0.05, 0.0], [-0.04, 0.95, 0.1], [0.02, 0.0, 0.97]])
    nodes = body.rest @ f.T
    np.testing.assert_allclose(lump.solid.deformations(nodes), np.broadcast_to(f, (len(nodes), 3, 3)), atol=1e-12)
    forces = step_forces(body, nodes)
    inner = np.setdiff1d(np.arange(len(nodes)), lump.surface)
    assert np.abs(forces[inner]).max() < 1e-9 * np.abs(forces).max()
    # What the surface pulls with is the stress that the model has.
    stress = lump.law.stress(f)
    virial = np.einsum("na,nb->ab", forces, body.rest) / -lump.solid.volumes.sum()
    np.testing.assert_allclose(virial, stress, atol=1e-9 * np.abs(stress).max())


@pytest.mark.parametrize("model", ELASTIC)
def test_forces_within_tissue_add_up_to_nothing_and_do_not_turn_it(model: str) -> None:
    body = TissueBody(make_scene(ELASTIC[model]), 1, lanes=1, dtype=np.float64)
    nodes = bent(body, 0.05)
    forces = step_forces(body, nodes)
    size = np.abs(forces).max()
    assert np.abs(forces.sum(axis=0)).max() < 1e-9 * size
    assert np.abs(np.cross(nodes, forces).sum(axis=0)).max() < 1e-8 * size


def test_a_turned_organ_is_at_rest() -> None:
    body = TissueBody(make_scene(ELASTIC["brain"]), 1, lanes=1, dtype=np.float64)
    turn = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])
    forces = step_forces(body, body.rest @ turn.T + 5.0)
    assert np.abs(forces).max() < 1e-9 * body.lumps[0].law.bulk


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_tissue_falls_as_a_whole(dtype: type) -> None:
    body = TissueBody(make_scene(Material(), 1.0 / 240.0, gravity=10.0), 1, lanes=1, dtype=dtype)
    for _ in range(24):
        advance_blocks(0, 1, body.blocks)
    velocities = read(body, "velocities")
    np.testing.assert_allclose(velocities, np.broadcast_to([0.0, 0.0, -1.0], velocities.shape), atol=2e-4)


def test_what_is_elastic_keeps_its_energy_and_what_is_viscous_loses_it() -> None:
    kept = {}
    for viscosity in (0.0, 0.5):
        body = TissueBody(make_scene(Material(viscosity=viscosity), 1.0 / 240.0), 1, lanes=1, dtype=np.float64)
        lump = body.lumps[0]
        body.write(body.blocks.positions, np.array([0]), bent(body, 0.005)[None])
        energies = []
        for _ in range(120):
            nodes, velocities = read(body, "positions"), read(body, "velocities")
            elastic = (lump.solid.shares * lump.law.energy(lump.solid.deformations(nodes))).sum()
            pulled = lump.solid.forces(np.zeros((len(nodes), 3, 3)), nodes, STABILISER * lump.law.shear)
            elastic -= 0.5 * (pulled * nodes).sum()
            energies.append(elastic + 0.5 * (lump.masses[:, None] * velocities**2).sum())
            advance_blocks(0, 1, body.blocks)
        kept[viscosity] = np.mean(energies[-40:]) / energies[0]
        # Velocities are those of half a substep earlier.
        assert max(energies) < 1.2 * energies[0]
    assert kept[0.0] == pytest.approx(1.0, abs=0.1)
    assert kept[0.5] < 0.9 * kept[0.0]


def test_stress_relaxes_as_the_series_says() -> None:
    shares, times = (0.3, 0.2), (0.05, 0.4)
    material = Material(viscosity=0.0, relaxation=tuple(zip(shares, times, strict=True)))
    dt = 1.0 / 240.0
    body = TissueBody(make_scene(material, dt), 1, lanes=1, dtype=np.float64)
    lump, nodes = body.lumps[0], bent(body, 0.0)
    nodes[:, 0] += 0.01 * nodes[:, 2]
    law = lump.law
    whole = law.stress(lump.solid.deformations(nodes))[0, 0, 2]
    for k in range(1, 121):
        body.write(body.blocks.positions, np.array([0]), nodes[None])
        body.write(body.blocks.velocities, np.array([0]), 0.0)
        advance_blocks(0, 1, body.blocks)
        if k in (1, 12, 60, 120):
            expected = sum(g * (1.0 - np.exp(-k * dt / t)) for g, t in zip(shares, times, strict=True))
            relaxed = read(body, "overstresses")[:, 5]
            np.testing.assert_allclose(relaxed / whole, expected, rtol=2e-3)


def test_a_step_is_divided_as_modulus_mass_and_viscosity_need() -> None:
    def substeps(**options: float) -> int:
        return int(TissueBody(make_scene(Material(**options), 1.0 / 60.0), 1, lanes=1).substeps[0, 0])

    usual = substeps()
    # Without viscosity by the square root of the modulus.
    elastic = [substeps(young_modulus=factor * 2010.0, viscosity=0.0) for factor in (1.0, 4.0)]
    assert elastic[1] == pytest.approx(2 * elastic[0], abs=2)
    assert substeps(poisson_ratio=0.49) > usual
    assert substeps(viscosity=5.0) > usual
    body = TissueBody(make_scene(Material(), 1.0 / 60.0), 3, lanes=8)
    body.set_parameters(stiffness=[1.0, 4.0, 1.0], mass_scale=[1.0, 1.0, 4.0])
    lengths = body.blocks.steps[0, 0, :, 0, :3]
    np.testing.assert_allclose(lengths.sum(axis=0), 1.0 / 60.0, rtol=1e-6)
    assert np.count_nonzero(lengths, axis=0)[1] > usual > np.count_nonzero(lengths, axis=0)[2]


@pytest.mark.parametrize(
    ("dt", "material"), [(1.0 / 100.0, Material()), (1.0 / 240.0, Material(young_modulus=10_000.0))]
)
def test_steps_too_long_for_contact_are_told(dt: float, material: Material) -> None:
    with pytest.warns(SceneWarning, match=r"organ 'sphere' is so stiff.*Take dt of 0\.00\d+ s or less"):
        Worlds(scenes.palpate(material=material, dt=dt), 1, engine="tissue").close()


@pytest.mark.parametrize("scene", [scenes.seed, scenes.palpate, scenes.fissure, scenes.clamp, scenes.retract])
def test_the_presets_steps_are_short_enough(scene: Callable[..., Scene]) -> None:
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        Worlds(scene(material=Material()), 1, engine="tissue").close()
    assert not [each for each in told if "will shake" in str(each.message)]


def test_masses_are_those_of_the_density() -> None:
    scene = scenes.seed(material=Material(density=1040.0))
    worlds = TissueBody(scene, 2, lanes=8)
    lump = worlds.lumps[0]
    assert lump.masses.sum() * scene.scale.mass == pytest.approx(1040.0 * lump.placed.organ.volume * 0.02**3)
    assert lump.masses.sum() == pytest.approx(lump.placed.mass)
    worlds.set_parameters(mass_scale=2.0, worlds=[1])
    assert worlds.inverse_masses[1] == pytest.approx(0.5 * worlds.inverse_masses[0])


@pytest.mark.parametrize(("name", "value"), [("stiffness", 0.0), ("mass_scale", -1.0), ("gravity", np.nan)])
def test_parameters_that_are_not_allowed_change_nothing(name: str, value: float) -> None:
    body = TissueBody(make_scene(Material()), 2, lanes=8)
    before = body.blocks.steps.copy()
    with pytest.raises(ValueError, match=name):
        body.set_parameters(**{name: [1.0, value]})
    assert np.array_equal(body.blocks.steps, before)


def press(worlds: Worlds, steps: int, speed: float = -4.0) -> np.ndarray:
    """Forces (W, 3) on the tools, in newtons."""
    moved = np.tile([0.0, 0.0, speed], (worlds.count, 1, 1))
    return worlds.advance(moved, steps=steps).forces[:, 0] * worlds.scene.scale.force


def ready(count: int, material: Material) -> Worlds:
    worlds = Worlds(scenes.palpate(material=material), count, engine="tissue", parallel=False)
    worlds.place_tools(np.tile([0.0, 0.0, 6.1], (count, 1, 1)))
    return worlds


def test_a_world_does_not_tell_how_many_there_are() -> None:
    material = Material(relaxation=((0.2, 0.1),))
    one, many = ready(1, material), ready(17, material)
    for _ in range(2):
        alone, among = press(one, 12)[0], press(many, 12)
        assert alone.tolist() == among[0].tolist() == among[16].tolist()
    assert alone[2] > 0.02
    assert np.array_equal(one.nodes[0], many.nodes[5])
    for worlds in (one, many):
        worlds.close()


def test_a_state_goes_on_as_it_would_have_gone_on_without() -> None:
    worlds = ready(2, Material(relaxation=((0.3, 0.2),)))
    press(worlds, 24)
    state = pickle.loads(pickle.dumps(worlds.save([0])))
    expected = press(worlds, 12)[0]
    nodes = worlds.nodes[0]
    worlds.reset([0])
    assert np.abs(worlds.nodes[0] - nodes).max() > 0.05
    worlds.restore(state, [1])
    assert press(worlds, 12)[1].tolist() == expected.tolist()
    assert np.array_equal(worlds.nodes[1], nodes)
    worlds.close()


def test_force_follows_the_modulus_and_volume_is_kept() -> None:
    worlds = ready(2, Material(poisson_ratio=0.45))
    worlds.set_parameters(stiffness=[1.0, 2.0])
    press(worlds, 24)
    held = np.mean([press(worlds, 4, 0.0) for _ in range(30)], axis=0)[:, 2]
    assert held[0] > 0.1
    # Both still swing.
    assert held[1] / held[0] == pytest.approx(2.0, rel=0.1)
    assert worlds.volumes[:, 0] == pytest.approx(worlds.scene.organs[0].organ.volume, rel=0.02)
    worlds.close()


def test_the_laws_units_are_the_scenes() -> None:
    scene = scenes.seed(material=Material())
    law = Hyperelastic.of(Material(), scene.scale.pressure)
    assert law.shear * scene.scale.pressure == pytest.approx(Material().shear_modulus)
