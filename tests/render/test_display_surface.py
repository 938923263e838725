from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spatula_env.geometry import seed_sphere
from spatula_env.geometry.blocks import fissured_block
from spatula_env.geometry.transforms import rotation_matrix
from spatula_env.render.display_surface import DisplaySurface, vertex_normals

CUBE = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
CUBE_TRIANGLES = np.array(
    [0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3],
    dtype=np.int32,
).reshape(-1, 3)


def edge_uses(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """How many triangles each edge has, vertices at one place counting as one."""
    _, same = np.unique(np.round(points, 9), axis=0, return_inverse=True)
    named = same.reshape(-1)[triangles]
    pairs = np.sort(np.stack([named, np.roll(named, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    return np.unique(pairs, axis=0, return_counts=True)[1]


@pytest.mark.parametrize("levels", [0, 1, 2])
def test_a_cube_keeps_its_edges(levels: int) -> None:
    surface = DisplaySurface(CUBE, CUBE_TRIANGLES, levels)
    assert len(surface.triangles) == 12 * 4**levels
    normals = vertex_normals(surface.rest, surface.triangles)
    # Every vertex is on one face, whose normal it has, and every face is flat.
    assert np.abs(np.abs(normals).max(axis=1) - 1.0).max() < 1e-12
    on_face = np.where(normals > 0.5, surface.rest - 1.0, np.where(normals < -0.5, surface.rest, 0.0))
    assert np.abs(on_face).max() < 1e-12
    assert (edge_uses(surface.rest, surface.triangles) == 2).all()


def test_a_sphere_is_smooth_and_gets_rounder() -> None:
    sphere = seed_sphere()
    coarse, fine = (DisplaySurface(sphere.vertices, sphere.triangles, levels) for levels in (0, 2))
    assert len(coarse.rest) == len(sphere.vertices)
    assert (edge_uses(fine.rest, fine.triangles) == 2).all()

    def flatness(surface: DisplaySurface) -> float:
        middles = surface.rest[surface.triangles].mean(axis=1)
        return 3.0 - float(np.linalg.norm(middles, axis=1).mean())

    assert flatness(fine) < 0.25 * flatness(coarse)


def test_a_block_with_a_fissure_has_no_gaps() -> None:
    block = fissured_block()
    surface = DisplaySurface(block.vertices, block.triangles, 1)
    assert len(surface.rest) > len(block.vertices) + len(block.triangles)
    assert (edge_uses(surface.rest, surface.triangles) == 2).all()
    # As it deforms, too.
    bent = block.vertices + 0.3 * np.sin(1.3 * block.vertices[:, [1, 2, 0]])
    assert (edge_uses(surface.place(bent), surface.triangles) == 2).all()


def test_triangles_are_split_until_they_are_small() -> None:
    sphere = seed_sphere()
    assert len(DisplaySurface(sphere.vertices, sphere.triangles).triangles) > len(sphere.triangles)
    small = 0.2 * sphere.vertices
    assert len(DisplaySurface(small, sphere.triangles).triangles) == len(sphere.triangles)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=7, max_size=7))
def test_moving_the_nodes_moves_the_vertices(numbers: list[float]) -> None:
    quaternion = np.array(numbers[:4])
    if np.linalg.norm(quaternion) < 0.1:
        quaternion = np.array([0.0, 0.0, 0.0, 1.0])
    rotation = rotation_matrix(quaternion / np.linalg.norm(quaternion))
    shift = 3.0 * np.array(numbers[4:])
    sphere = seed_sphere()
    surface = DisplaySurface(sphere.vertices, sphere.triangles, 1)
    moved = surface.place(sphere.vertices @ rotation.T + shift)
    np.testing.assert_allclose(moved, surface.rest @ rotation.T + shift, atol=1e-12)


def test_values_are_linear_between_nodes() -> None:
    surface = DisplaySurface(CUBE, CUBE_TRIANGLES, 2)
    values = CUBE @ np.array([[1.0, 2.0], [-3.0, 0.5], [0.25, 1.0]])
    np.testing.assert_allclose(
        surface.interpolate(values), surface.rest @ np.array([[1.0, 2.0], [-3.0, 0.5], [0.25, 1.0]]), atol=1e-12
    )
