"""Features that are near each other are found, compared with brute force."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from skin_helpers import edges_of, pairs_of, patches_of, skin_of, triangles_of, uncrossed

from spatula_env.contact.near import find_as_before, find_cross_pairs, find_near
from spatula_env.contact.skin import copy_near
from spatula_env.contact.tangles import place
from spatula_env.geometry import box_surface, icosphere

seeds = st.integers(0, 2**32 - 1)


def nowhere(points):
    """Mask for `find_near` that marks no vertex as out of reach."""
    return np.zeros(len(points), dtype=np.bool_)


def segment_distances(p, q, c, d):
    """Upper bounds (E,) on the distances of segment pq (3,) from segments cd (E, 3), by fine sampling of both."""
    along = np.linspace(0.0, 1.0, 41)
    first = p + along[:, None] * (q - p)
    second = c[:, None] + along[None, :, None] * (d - c)[:, None]
    return np.linalg.norm(first[None, :, None] - second[:, None], axis=-1).min(axis=(1, 2))


def test_every_part_of_a_surface_is_in_one_patch():
    organ = icosphere(1.0, 2)
    skin, _ = skin_of(organ, box_surface((1.0, 1.0, 1.0), 0.5))
    parts = patches_of(skin)
    for starts, order in zip(parts[::2], parts[1::2], strict=True):
        assert starts[0] == 0 and starts[-1] == len(order) and (np.diff(starts) >= 0).all()
        np.testing.assert_array_equal(np.sort(order), np.arange(len(order)))
    assert len(parts[1]) == len(triangles_of(skin)) and len(parts[3]) == len(edges_of(skin))


@settings(max_examples=15)
@given(seeds)
def test_what_is_within_reach_of_each_other_on_two_organs_is_found(seed):
    generator = np.random.default_rng(seed)
    organ = box_surface((1.0, 1.0, 1.0), 0.5)
    skin, near = skin_of(organ, organ)
    count = len(organ.vertices)
    shift = generator.normal(size=3)
    shift *= generator.uniform(0.9, 1.1) / np.abs(shift).max()
    points = np.concatenate([organ.vertices, organ.vertices + shift])
    points = points + 0.02 * generator.normal(size=points.shape)
    thrown, margin = points + 0.03 * generator.normal(size=points.shape), 0.03
    find_near(skin, near, points, thrown, margin, nowhere(points))
    _, edge_pairs, _ = pairs_of(near)
    assert len(edge_pairs) > 0
    reach = margin + np.linalg.norm(thrown - points, axis=1)
    edges = edges_of(skin)
    found = {(min(e, f), max(e, f)) for e, f, _ in edge_pairs.tolist()}
    first, second = np.flatnonzero(edges[:, 0] < count), np.flatnonzero(edges[:, 0] >= count)
    for e in first.tolist():
        distances = segment_distances(*points[edges[e]], points[edges[second, 0]], points[edges[second, 1]])
        for f in second[distances < reach[edges[e]].min() + reach[edges[second]].min(axis=1)].tolist():
            assert (e, f) in found


def test_a_smooth_surface_is_not_near_itself():
    organ = icosphere(3.0, 2)
    skin, near = skin_of(organ)
    find_near(skin, near, np.array(organ.vertices), np.array(organ.vertices), 0.1, nowhere(organ.vertices))
    vertex_pairs, edge_pairs, _ = pairs_of(near)
    assert len(vertex_pairs) == 0 and len(edge_pairs) == 0


def crossings_of(points, edges, triangles):
    """Edges and triangles without a vertex in common that go through each other, by trying all."""
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    heights = np.einsum("tj,etj->et", normals, points[edges[:, :1]] - corners[None, :, 0])
    others = np.einsum("tj,etj->et", normals, points[edges[:, 1:]] - corners[None, :, 0])
    found = set()
    for e, t in np.argwhere((heights > 0.0) != (others > 0.0)).tolist():
        first, second = points[edges[e]]
        place = first + heights[e, t] / (heights[e, t] - others[e, t]) * (second - first)
        sides = np.cross(np.roll(corners[t], -1, axis=0) - corners[t], place - corners[t]) @ normals[t]
        if (sides > 0.0).all() and not set(edges[e].tolist()) & set(triangles[t].tolist()):
            found.add((e, t))
    return found


def test_a_surface_that_folds_within_its_reach_is_found_near_itself():
    # A smooth surface, whose vertices may go far before they are out of reach; the cap at its pole is pushed in, and
    # stretched, so that it comes out at the sides.
    organ = icosphere(3.0, 2)
    skin, near = skin_of(organ)
    vertices = np.array(organ.vertices)
    find_near(skin, near, vertices, vertices, 4.0, nowhere(vertices))
    folded = vertices.copy()
    cap = vertices[:, 2] > 2.4
    folded[cap] = folded[cap] * (1.8, 1.8, 1.0) - (0.0, 0.0, 2.0)
    crossing = crossings_of(folded, edges_of(skin), triangles_of(skin))
    assert crossing and np.linalg.norm(folded - vertices, axis=1).max() < 4.0
    assert not place(skin, near, folded, False)
    uncrossed(skin, near, vertices, folded)
    assert crossing <= {tuple(pair) for pair in pairs_of(near)[2].tolist()}


@settings(max_examples=40)
@given(seeds, st.floats(0.05, 0.35), st.floats(0.2, 0.9))
def test_neighbours_that_a_fold_between_them_brings_together_are_found(seed, radius, noise):
    # Two patches may share one vertex, and each be flat: crossings are then due to a fold beside both.
    generator = np.random.default_rng(seed)
    organ = icosphere(1.0, 2)
    skin, near = skin_of(organ)
    vertices = np.array(organ.vertices)
    moved = np.linalg.norm(vertices - vertices[generator.integers(len(vertices))], axis=1) < radius
    vertices[moved] += noise * generator.normal(size=(int(moved.sum()), 3))
    find_near(skin, near, vertices, vertices, 0.02, nowhere(vertices))
    find_cross_pairs(skin, near)
    crossing = crossings_of(vertices, edges_of(skin), triangles_of(skin))
    assert crossing <= {tuple(pair) for pair in pairs_of(near)[2].tolist()}


@settings(max_examples=25)
@given(seeds)
def test_what_folds_between_patches_that_stay_is_found_as_from_nothing(seed):
    generator = np.random.default_rng(seed)
    organ = icosphere(1.0, 2)
    skin, near = skin_of(organ)
    points = np.array(organ.vertices)
    find_near(skin, near, points, points, 0.02, nowhere(points))
    for _ in range(3):
        moved = np.zeros(len(points), dtype=np.bool_)
        moved[generator.integers(len(points), size=2)] = True
        points[moved] += 0.3 * generator.normal(size=(int(moved.sum()), 3))
        find_near(skin, near, points, points, 0.02, moved)
    anew = skin_of(organ)[1]
    find_near(skin, anew, points, points, 0.02, nowhere(points))
    for one in (near, anew):
        find_cross_pairs(skin, one)
    crossing = crossings_of(points, edges_of(skin), triangles_of(skin))
    for one in (near, anew):
        assert crossing <= {tuple(pair) for pair in pairs_of(one)[2].tolist()}


def test_walls_that_are_pressed_together_are_near_each_other():
    organ = icosphere(3.0, 2)
    skin, near = skin_of(organ)
    flat = organ.vertices * (1.0, 1.0, 0.02)
    find_near(skin, near, flat, flat, 0.1, nowhere(flat))
    vertex_pairs, _, _ = pairs_of(near)
    triangles = triangles_of(skin)
    # Each vertex of the upper half is near a triangle of the lower one.
    upper = np.flatnonzero(organ.vertices[:, 2] > 0.5)
    below = {int(v) for v, t, _ in vertex_pairs.tolist() if organ.vertices[triangles[t], 2].max() < 0.0}
    assert set(upper.tolist()) <= below


@settings(max_examples=25)
@given(seeds, st.floats(0.0, 0.3), st.booleans())
def test_what_is_found_anew_around_moved_vertices_is_what_would_be_found_from_nothing(seed, share, crossings):
    generator = np.random.default_rng(seed)
    organ = icosphere(1.0, 2)
    skin, near = skin_of(organ, organ)
    points = np.concatenate([organ.vertices * (1.0, 1.0, 0.1), organ.vertices + np.array([0.0, 0.0, 1.2])])
    find_near(skin, near, points, points, 0.05, nowhere(points))
    if crossings:
        find_cross_pairs(skin, near)
    moved = generator.random(len(points)) < share
    points = points + np.where(moved[:, None], 0.2 * generator.normal(size=points.shape), 0.0)
    thrown = points + 0.05 * generator.normal(size=points.shape)
    find_near(skin, near, points, thrown, 0.05, moved)
    if not crossings:
        find_cross_pairs(skin, near)
    *remembered, known = copy_near(near)
    assert known
    other = skin_of(organ, organ)[1]
    find_as_before(skin, other, *remembered)
    find_cross_pairs(skin, other)
    for found, expected in zip(pairs_of(near), pairs_of(other), strict=True):
        assert found.tolist() == expected.tolist()
