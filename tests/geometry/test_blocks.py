"""Blocks with a fissure or a ridge: closed, of the right volume, with good triangles, and with regions that fit."""

from __future__ import annotations

import dataclasses
import math
import pickle

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from intersections import self_intersections

from spatula_env.geometry import FissuredBlock, Organ, RidgedBlock, fissured_block, icosphere, ridged_block
from spatula_env.geometry.surface import triangle_normals

BLOCKS = {
    "fissure": fissured_block(),
    "graded fissure": fissured_block(edge_length=0.28, base_edge_length=0.7),
    "narrow fissure": fissured_block(width=0.1),
    "wide fissure": fissured_block(width=0.6, depth=2.0, lip=0.1),
    "square block": fissured_block((5.0, 5.0, 3.0)),
    "ridge": ridged_block(),
    "graded ridge": ridged_block(base_edge_length=0.5),
    "thin ridge": ridged_block(width=0.4, height=1.0, fillet=0.1, edge_length=0.15),
}
EDGE_LENGTHS = {"graded fissure": 0.28, "thin ridge": 0.15}

block_cases = pytest.mark.parametrize("block", BLOCKS.values(), ids=BLOCKS.keys())


def corner_angles(organ):
    """Angles of the triangles (T, 3) [deg]."""
    corners = organ.vertices[organ.triangles]
    angles = []
    for k in range(3):
        first = corners[:, (k + 1) % 3] - corners[:, k]
        second = corners[:, (k + 2) % 3] - corners[:, k]
        cosine = np.einsum("ij,ij->i", first, second)
        cosine /= np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
        angles.append(np.degrees(np.arccos(cosine)))
    return np.column_stack(angles)


def stacked_volume(half_length, half_width, height):
    """Volume of superellipses of exponent 3 stacked along z, by the trapezoidal rule."""
    area = 4.0 * math.gamma(4.0 / 3.0) ** 2 / math.gamma(5.0 / 3.0) * half_length * half_width
    return float((0.5 * (area[1:] + area[:-1]) * np.diff(height)).sum())


def block_volume(size, start_length, start_width):
    """Volume below the top and the shoulder, superellipses of exponent 2.5 in profile, of a block."""
    way = np.sin(np.linspace(0.5 * np.pi, 0.0, 20001)) ** 0.8
    height = size[2] * (1.0 - way**2.5).clip(0.0) ** 0.4
    return stacked_volume(
        start_length + (0.5 * size[0] - start_length) * way, start_width + (0.5 * size[1] - start_width) * way, height
    )


# The surfaces ----------------------------------------------------------------------------------------------------


def test_the_search_for_self_intersections_finds_one():
    ball = icosphere(1.0, 2)
    assert len(self_intersections(ball.vertices, ball.triangles)) == 0
    dented = ball.vertices.copy()
    dented[0] *= -1.5
    assert len(self_intersections(dented, ball.triangles)) > 0


@block_cases
def test_a_block_does_not_cross_itself(block):
    assert len(self_intersections(block.vertices, block.triangles)) == 0


@block_cases
def test_a_block_is_like_a_sphere(block):
    # Closed, manifold and wound outwards it is already, or Organ would have refused it.
    assert len(block.vertices) - len(block.triangles) // 2 == 2


def test_a_block_is_sound_for_trimesh_too():
    trimesh = pytest.importorskip("trimesh")
    for block in BLOCKS.values():
        mesh = trimesh.Trimesh(block.vertices, block.triangles, process=False)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.euler_number == 2
        assert mesh.volume == pytest.approx(block.volume, rel=1e-9)


@block_cases
def test_triangles_are_well_shaped(block):
    angles = corner_angles(block)
    assert angles.min() > 28.0
    assert angles.max() < 118.0
    assert np.median(angles.min(axis=1)) > 45.0


@pytest.mark.parametrize("name", ["fissure", "narrow fissure", "wide fissure", "square block", "ridge", "thin ridge"])
def test_edges_are_as_long_as_wanted(name):
    lengths = BLOCKS[name].edge_lengths / EDGE_LENGTHS.get(name, 0.25)
    assert lengths.mean() == pytest.approx(1.0, abs=0.08)
    assert lengths.min() > 0.35
    assert lengths.max() < 1.7


@pytest.mark.parametrize("name", ["fissure", "graded fissure", "narrow fissure", "wide fissure"])
def test_edges_of_the_walls_are_as_long_as_wanted(name):
    block = BLOCKS[name]
    for wall in block.walls:
        own = np.isin(block.triangles, wall).all(axis=1)
        corners = block.vertices[block.triangles[own]]
        lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        assert lengths.mean() == pytest.approx(EDGE_LENGTHS.get(name, 0.25), rel=0.15)


def test_edges_grow_towards_the_base():
    block = BLOCKS["graded fissure"]
    corners = block.vertices[block.triangles]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
    base = np.isin(block.triangles, block.base).all(axis=1)
    middle = (corners[:, :, 2].mean(axis=1) > 1.0) & (corners[:, :, 2].mean(axis=1) < 2.0)
    outside = middle & (np.abs(corners[:, :, 1].mean(axis=1)) > 1.0)
    assert lengths[base].mean() == pytest.approx(0.7, rel=0.15)
    assert 0.35 < lengths[outside].mean() < 0.65


@pytest.mark.parametrize(("edge_length", "triangles"), [(0.45, 1100), (0.25, 3600), (0.107, 20000)])
def test_the_edge_length_decides_the_number_of_triangles(edge_length, triangles):
    assert len(fissured_block(edge_length=edge_length).triangles) == pytest.approx(triangles, rel=0.06)


def test_a_small_fissured_block_for_fast_simulations():
    assert 500 < len(fissured_block(edge_length=0.38, base_edge_length=0.9).triangles) < 700


@pytest.mark.parametrize("make", [fissured_block, ridged_block])
def test_a_block_is_its_own_mirror_image(make):
    block = make()
    mirrored = block.vertices * [1.0, -1.0, 1.0]
    order, other = np.lexsort(block.vertices.T), np.lexsort(mirrored.T)
    np.testing.assert_array_equal(block.vertices[order], mirrored[other])
    partner = np.empty(len(order), dtype=int)
    partner[other] = order
    here = {tuple(np.roll(row, -row.argmin())) for row in block.triangles}
    there = {tuple(np.roll(row, -row.argmin())) for row in partner[block.triangles][:, ::-1]}
    assert here == there


@pytest.mark.parametrize("make", [fissured_block, ridged_block])
def test_a_block_is_made_the_same_way_every_time(make):
    assert make() == make()
    assert make() != make(edge_length=0.3)


def test_volume_of_a_fissured_block():
    block = fissured_block((6.0, 5.0, 3.0), 2.0, 3.0, 0.6, 0.12, lip=0.2)
    bottom, top, radius = 1.0, 2.8, 0.3
    height = np.linspace(bottom, 3.0, 20001)
    rounding = np.where(height > top, 0.2 - np.sqrt((0.04 - (height - top) ** 2).clip(0.0)), 0.0)
    half_width = np.sqrt((radius**2 - (bottom + radius - height).clip(0.0) ** 2).clip(0.0)) + rounding
    rise = ((height - bottom) / (top - bottom)).clip(0.0, 1.0)
    # The ends lean by a tenth of the length.
    half_length = 1.5 - 0.3 * (1.0 - np.sqrt(1.0 - (1.0 - rise) ** 2)) + rounding
    hollow = stacked_volume(half_length, half_width, height)
    solid = block_volume((6.0, 5.0, 3.0), 1.7, 0.5)
    assert hollow > 0.04 * solid
    assert block.volume == pytest.approx(solid - hollow, rel=0.005)


def test_volume_of_a_ridged_block():
    block = ridged_block((4.0, 3.2, 1.2), 1.3, 2.0, 0.8, 0.08, fillet=0.25)
    height = np.linspace(1.2, 2.5, 20001)
    rounding = np.where(height < 1.45, 0.25 - np.sqrt((0.0625 - (1.45 - height) ** 2).clip(0.0)), 0.0)
    half_width = np.sqrt((0.16 - (height - 2.1).clip(0.0) ** 2).clip(0.0)) + rounding
    solid = block_volume((4.0, 3.2, 1.2), 1.25, 0.65) + stacked_volume(0.6 + half_width, half_width, height)
    assert block.volume == pytest.approx(solid, rel=0.005)


@settings(max_examples=15)
@given(
    width=st.floats(0.1, 0.6) | st.floats(1e-6, 0.1),
    depth=st.floats(1.0, 2.5),
    length=st.floats(1.5, 4.0),
    extent=st.tuples(st.floats(5.0, 8.0), st.floats(4.0, 6.0), st.floats(2.8, 4.0)),
    edge_length=st.floats(0.3, 0.5),
    lip=st.floats(0.05, 0.4),
)
# Walls so close that the shorter diagonal at an end of the floor is in the plane y = 0.
@example(width=0.109375, depth=1.0, length=1.5, extent=(5.0, 4.0, 3.0), edge_length=0.5, lip=0.25)
# Lips that nearly reach the ends of the block.
@example(width=1e-6, depth=1.8, length=4.0, extent=(5.0, 6.0, 2.8), edge_length=0.3, lip=0.4)
def test_every_fissured_block_is_sound(width, depth, length, extent, edge_length, lip):
    block = fissured_block(extent, depth, length, width, edge_length, lip=lip)
    assert len(self_intersections(block.vertices, block.triangles)) == 0
    np.testing.assert_allclose(np.ptp(block.vertices, axis=0), extent, rtol=0.05)
    # Beyond the ends of the fissure the rows have less room than beside it, and triangles are flatter. Where not even
    # an edge has room there, they are much flatter.
    room = 0.5 * (extent[0] - length) - lip
    assert corner_angles(block).min() > (15.0 if room > edge_length else 4.0)


@settings(max_examples=15)
@given(
    make=st.sampled_from([fissured_block, ridged_block]),
    extent=st.tuples(st.floats(3.5, 7.0), st.floats(3.0, 5.0), st.floats(1.8, 4.0)),
    width=st.floats(1e-6, 0.6),
    edge_length=st.floats(0.6, 6.0),
)
# Shorter diagonals in the plane y = 0: at an end of the floor, of the crest, and of the line in the base.
@example(make=fissured_block, extent=(6.0, 5.0, 3.0), width=0.1, edge_length=0.99)
@example(make=ridged_block, extent=(4.0, 3.2, 1.2), width=0.05, edge_length=0.72)
@example(make=fissured_block, extent=(3.6, 3.7, 3.0), width=0.05, edge_length=2.3)
def test_a_block_of_few_triangles_is_sound(make, extent, width, edge_length):
    block = make(extent, width=width, edge_length=edge_length)
    assert len(block.vertices) - len(block.triangles) // 2 == 2
    assert len(self_intersections(block.vertices, block.triangles)) == 0


@pytest.mark.parametrize("width", [1e-9, 1e-3, 0.05])
def test_walls_are_as_far_apart_as_wanted_where_their_triangles_are_much_longer(width):
    block = fissured_block(width=width, edge_length=0.4)
    for wall, side in zip(block.walls, (-1.0, 1.0), strict=True):
        middle = block.vertices[wall][np.abs(block.vertices[wall, 0]) < 0.75]
        assert len(middle) > 8
        np.testing.assert_allclose(middle[:, 1], side * 0.5 * width, rtol=0.05)
    np.testing.assert_allclose(block.vertices[block.floor, 2], block.floor_height, atol=width)
    assert set(block.triangles[block.target].ravel()) & set(block.floor)


# The regions -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["fissure", "graded fissure", "narrow fissure", "wide fissure"])
def test_regions_of_a_fissured_block(name):
    block = BLOCKS[name]
    vertices = block.vertices
    regions = [block.base, *block.walls, *block.lips, block.floor]
    assert all(len(region) > 3 for region in regions)
    joined = np.concatenate(regions)
    assert len(np.unique(joined)) == len(joined)
    assert all((np.diff(region) > 0).all() for region in regions)

    assert (vertices[block.base, 2] == 0.0).all()
    assert (vertices[np.setdiff1d(np.arange(len(vertices)), block.base), 2] > 0.05).all()
    assert vertices[block.floor, 2].min() == pytest.approx(block.floor_height, abs=1e-12)
    assert (vertices[block.floor, 2] < vertices[np.concatenate(block.walls), 2].min()).all()
    # The floor's lowest nodes are in the middle of the block.
    lowest = block.floor[vertices[block.floor, 2] < block.floor_height + 1e-9]
    assert (np.abs(vertices[lowest, 1]) < 1e-12).all()
    top = vertices[np.concatenate(block.walls), 2].max()
    assert (vertices[np.concatenate(block.lips), 2] >= top).all()


def test_walls_face_each_other():
    block = BLOCKS["fissure"]
    normals = triangle_normals(block.vertices, block.triangles)
    for wall, side in zip(block.walls, (-1.0, 1.0), strict=True):
        middle = wall[np.abs(block.vertices[wall, 0]) < 0.75]
        np.testing.assert_allclose(block.vertices[middle, 1], side * 0.125, atol=0.02)
        own = np.isin(block.triangles, middle).all(axis=1)
        # Out of the tissue is into the fissure.
        assert (side * normals[own, 1] < -0.95).all()
    assert len(block.walls[0]) == len(block.walls[1])


def test_the_target_is_at_the_middle_of_the_floor():
    block = BLOCKS["fissure"]
    corners = block.vertices[block.triangles[block.target]]
    assert np.abs(corners.mean(axis=1)[:, 0]).max() <= 0.3
    assert np.isin(block.triangles[block.target], block.floor).any(axis=1).all()
    assert corners[:, :, 2].max() < block.floor_height + 0.4
    # Both sides of the lowest line, from one end of the target to the other.
    assert (corners[:, :, 1].mean(axis=1) > 0.0).sum() == (corners[:, :, 1].mean(axis=1) < 0.0).sum()
    assert np.ptp(corners[:, :, 0]) > 0.5
    assert len(fissured_block(target_length=1.2).target) > len(block.target)
    assert len(fissured_block(target_length=1e-3).target) >= 2


def test_regions_of_a_ridged_block():
    block = BLOCKS["ridge"]
    vertices = block.vertices
    joined = np.concatenate([block.base, *block.flanks, block.crest])
    assert len(np.unique(joined)) == len(joined)
    assert (vertices[block.base, 2] == 0.0).all()
    assert block.foot_height == 1.2
    for flank, side in zip(block.flanks, (-1.0, 1.0), strict=True):
        middle = flank[np.abs(vertices[flank, 0]) < 0.5]
        assert len(middle) > 5
        np.testing.assert_allclose(vertices[middle, 1], side * 0.4, atol=0.02)
        assert vertices[flank, 2].min() > 1.2 + 0.25 - 1e-9
    assert vertices[block.crest, 2].min() > vertices[np.concatenate(block.flanks), 2].max()
    assert vertices[block.crest, 2].max() == pytest.approx(2.5)


@pytest.mark.parametrize("make", [fissured_block, ridged_block])
def test_blocks_are_organs_that_cannot_be_changed(make):
    block = make(edge_length=0.4)
    assert isinstance(block, Organ)
    assert block == Organ(block.vertices, block.triangles, block.name)
    copy = pickle.loads(pickle.dumps(block))
    assert copy == block
    np.testing.assert_array_equal(copy.base, block.base)
    with pytest.raises(ValueError, match="read-only"):
        block.base[0] = 3
    with pytest.raises(dataclasses.FrozenInstanceError):
        block.base = block.base


# What is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize(
    ("make", "name"),
    [
        *[(fissured_block, key) for key in ("depth", "length", "width", "edge_length", "lip", "base_edge_length")],
        (fissured_block, "target_length"),
        *[(ridged_block, key) for key in ("height", "length", "width", "edge_length", "fillet", "base_edge_length")],
    ],
)
def test_lengths_must_be_positive(make, name, value):
    with pytest.raises(ValueError, match=f"^{name} must be positive and finite, got {value}"):
        make(**{name: value})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: fissured_block((6.0, 5.0)), "size must have shape"),
        (lambda: ridged_block((4.0, 0.0, 1.0)), r"size\[1\] must be positive"),
        (lambda: fissured_block(depth=3.0), r"depth must be less than the height of the block \(3\), got 3"),
        (lambda: fissured_block(length=5.7), "length and twice lip must be less than the length of the block"),
        (lambda: fissured_block((6.0, 0.6, 3.0)), "width and twice lip must be less than the width of the block"),
        (lambda: fissured_block(depth=0.3), "half width and lip must be less than depth"),
        (lambda: fissured_block(width=0.6, length=0.5), "width must be less than length"),
        (lambda: fissured_block(edge_length=1e-3), "edge_length must not make more than 100000 nodes"),
        (lambda: fissured_block(edge_length=1e-9), "edge_length must not make more than 100000 nodes"),
        (lambda: ridged_block(length=3.6), "length and twice fillet must be less than the length of the block"),
        (lambda: ridged_block((4.0, 1.2, 1.2)), "width and twice fillet must be less than the width of the block"),
        (lambda: ridged_block(height=0.6), "half width and fillet must be less than height"),
        (lambda: ridged_block(width=0.8, length=0.7), "width must be less than length"),
    ],
)
def test_parts_must_fit_into_each_other(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_blocks_know_what_they_are():
    assert isinstance(fissured_block(edge_length=0.5), FissuredBlock)
    assert isinstance(ridged_block(edge_length=0.5), RidgedBlock)
    assert fissured_block(edge_length=0.5).name == "fissured block"
    assert ridged_block(edge_length=0.5, name="gyrus").name == "gyrus"
