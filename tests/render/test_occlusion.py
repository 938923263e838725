from __future__ import annotations

import numpy as np

from spatula_env.geometry import seed_sphere
from spatula_env.geometry.blocks import fissured_block
from spatula_env.render.display_surface import vertex_normals
from spatula_env.render.occlusion import openness


def seen(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    return openness(vertices, vertex_normals(vertices, triangles), triangles)


def test_a_sphere_hides_nothing_from_itself() -> None:
    sphere = seed_sphere()
    assert seen(sphere.vertices, sphere.triangles).min() > 0.93


def test_it_is_dark_in_a_fissure() -> None:
    block = fissured_block()
    open_share = seen(block.vertices, block.triangles)
    outside = np.setdiff1d(
        np.arange(len(block.vertices)), np.concatenate([block.floor, block.base, *block.walls, *block.lips])
    )
    deep = block.floor[block.vertices[block.floor, 2] < block.floor_height + 0.1]
    assert open_share[deep].mean() < 0.2
    assert np.median(open_share[outside]) > 0.9
    walls = np.concatenate(block.walls)
    high = block.vertices[walls, 2] > np.median(block.vertices[walls, 2])
    assert open_share[walls[high]].mean() > 1.5 * open_share[walls[~high]].mean()


def test_size_and_place_do_not_matter() -> None:
    block = fissured_block()
    first = seen(block.vertices, block.triangles)
    second = seen(0.1 * block.vertices + 7.0, block.triangles)
    assert np.abs(first - second).max() < 0.05
