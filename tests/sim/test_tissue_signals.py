"""How tissue is strained and stressed."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from spatula_env import Simulation, scenes
from spatula_env.scenes import Material
from spatula_env.sim.tissue.body import TissueBody
from spatula_env.sim.tissue.kernels import advance_blocks
from spatula_env.sim.tissue.signals import eigenvalues, nodal_strains, organ_strains
from spatula_env.sim.worlds import Worlds

ONE = np.array([0])
F = np.array([[1.2, 0.05, 0.0], [-0.04, 0.9, 0.1], [0.02, 0.0, 0.97]])


def make_body(material: Material, dt: float = 1e-4) -> TissueBody:
    return TissueBody(scenes.seed(material=material, dt=dt), 1, lanes=1, dtype=np.float64)


@pytest.mark.parametrize("material", [Material(), Material.brain("cortex")])
def test_an_affine_displacement_has_its_strain_and_stress_everywhere(material: Material) -> None:
    body = make_body(material)
    body.write(body.blocks.positions, ONE, (body.rest @ F.T)[None])
    found, law = nodal_strains(body, ONE), body.lumps[0].law
    strain = 0.5 * (np.linalg.eigvalsh(F.T @ F)[-1] - 1.0)
    cauchy = law.stress(F) @ F.T / np.linalg.det(F)
    np.testing.assert_allclose(found.strains, strain, rtol=1e-9)
    np.testing.assert_allclose(found.stresses, np.linalg.eigvalsh(cauchy)[-1], rtol=1e-9)


def test_stress_that_has_relaxed_is_not_told() -> None:
    body = make_body(Material(viscosity=0.0, relaxation=((0.4, 0.01),)), 1.0 / 240.0)
    nodes = body.rest @ F.T
    for _ in range(60):
        body.write(body.blocks.positions, ONE, nodes[None])
        body.write(body.blocks.velocities, ONE, 0.0)
        advance_blocks(0, 1, body.blocks)
    body.write(body.blocks.positions, ONE, nodes[None])
    law = body.lumps[0].law
    whole = law.stress(F) @ F.T / np.linalg.det(F)
    pressure = law.bulk * (np.linalg.det(F) - 1.0) * np.eye(3)
    # What resists volume does not relax.
    expected = np.linalg.eigvalsh(0.6 * whole + 0.4 * pressure)[-1]
    np.testing.assert_allclose(nodal_strains(body, ONE).stresses, expected, rtol=1e-3)


def test_eigenvalues_are_those_of_numpy() -> None:
    tensors = np.random.default_rng(0).normal(size=(500, 3, 3))
    tensors += np.swapaxes(tensors, 1, 2)
    # Equal ones too, and zero.
    tensors = np.concatenate([tensors, [np.eye(3), np.zeros((3, 3)), np.diag([1.0, 1.0, -2.0])]])
    parts = {(i, j): tensors[:, i, j] for i in range(3) for j in range(i, 3)}
    np.testing.assert_allclose(np.stack(eigenvalues(parts), axis=-1), np.linalg.eigvalsh(tensors)[:, ::-1], atol=1e-7)


def test_shares_count_volume_and_high_is_below_the_peak() -> None:
    body = make_body(Material())
    nodes = body.rest.copy()
    upper = nodes[:, 2] > 3.0
    nodes[upper] += [0.3, 0.0, 0.0] * (nodes[upper, 2:] - 3.0)
    body.write(body.blocks.positions, ONE, nodes[None])
    told, lump = organ_strains(body, ONE, 0.1), body.lumps[0]
    strains, shares = nodal_strains(body, ONE).strains[0], lump.solid.shares / lump.solid.shares.sum()
    assert told.peak_strains[0, 0] == strains.max() > told.high_strains[0, 0]
    assert shares[strains > told.high_strains[0, 0]].sum() <= 0.05 < shares[strains >= told.high_strains[0, 0]].sum()
    assert told.strained_shares[0, 0] == pytest.approx(shares[strains > 0.1].sum())
    assert 0.4 < told.strained_shares[0, 0] < 0.6


def test_a_world_among_others_is_told_as_alone() -> None:
    def pressed(count: int) -> Worlds:
        worlds = Worlds(scenes.palpate(material=Material()), count, engine="tissue", parallel=False)
        worlds.place_tools(np.tile([0.0, 0.0, 6.1], (count, 1, 1)))
        worlds.advance(np.tile([0.0, 0.0, -4.0], (count, 1, 1)), steps=24)
        return worlds

    one, many = pressed(1), pressed(9)
    alone, among = one.strains(), many.strains([8, 0])
    for single, several in zip(alone, among, strict=True):
        assert single.shape == (1, 1)
        assert several.tolist() == [single[0].tolist()] * 2
    assert 0.02 < alone.high_strains[0, 0] < alone.peak_strains[0, 0] < 1.0
    for worlds in (one, many):
        worlds.close()


def test_springs_have_no_strains() -> None:
    simulation = Simulation(scenes.seed(), engine="batch")
    with pytest.raises(RuntimeError, match="strains are of organs that are a material: use engine='tissue'"):
        simulation.strains()
    simulation.close()


def test_info_tells_strains_of_tissue_and_their_dose() -> None:
    with gym.make("Spatula/Palpate-v0", engine="tissue", disable_env_checker=True) as env:
        _, info = env.reset(seed=0)
        down = np.where(np.array(env.unwrapped.control.names) == "velocity_z", -1.0, 0.0).astype(np.float32)
        assert info["strain_dose"] == info["episode_strain_dose"] == 0.0
        shares, peaks = [], []
        for _ in range(30):
            _, _, _, _, info = env.step(down)
            shares.append(info["strained_share"])
            peaks.append(info["peak_strain"])
            assert info["strain_dose"] == pytest.approx(shares[-1] / 20.0)
        state = env.unwrapped.save()
        assert info["episode_peak_strain"] == max(peaks) > 0.21
        assert info["episode_strain_dose"] == pytest.approx(sum(shares) / 20.0)
        assert info["peak_stress"] > info["high_stress"] > 0.0
        env.reset(seed=1)
        env.unwrapped.restore(state)
        _, _, _, _, later = env.step(0.0 * down)
        assert later["episode_peak_strain"] >= max(peaks)
    with gym.make("Spatula/Palpate-v0", engine="batch", disable_env_checker=True) as env:
        assert "peak_strain" not in env.reset(seed=0)[1]
