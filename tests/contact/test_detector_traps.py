"""Cases in which thin tools or fast motion could mislead a contact detector, each with a known answer."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_detector import random_rotation, rotation_matrix

from spatula_env.contact import FlaggedDetector
from spatula_env.geometry import Tool, box_surface, icosphere, seed_sphere

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
CUBE = box_surface((4.0, 4.0, 4.0), 0.7)
"""Its walls are at x, y, z = -2 and 2."""

SPHERE = seed_sphere()

PLATE = Tool.box((1.0, 1.0, 0.125), 4)
BOTTOM, TOP = PLATE.face_nodes(0), PLATE.face_nodes(1)
HALF = 0.0625

# Away from all symmetries, so that no ray passes exactly through an edge unless a test intends it.
X, Y = 0.0137, 0.0271

seeds = st.integers(0, 2**32 - 1)


def count(contacts):
    """How many nodes are flagged on the top face, and on the bottom face."""
    return int(contacts.flags[TOP].sum()), int(contacts.flags[BOTTOM].sum())


def shifted(organ, shift):
    return organ.vertices + np.array(shift, dtype=np.float64)


def is_inside_convex(organ, points):
    """Distance of points from the planes of a convex surface: positive inside, negative outside."""
    a, b, c = (organ.vertices[organ.triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return -(points @ normals.T - (normals * a).sum(axis=1)).max(axis=1)


# Slow motion -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("first_step", ["inside", "any_hit"])
def test_slow_rise_flags_the_leading_face_alone(first_step):
    detector = FlaggedDetector(PLATE, first_step)
    for height in np.arange(-2.3, 1.9, 0.03):
        contacts = detector.detect((X, Y, height), UPRIGHT, CUBE.vertices, CUBE.triangles, UP)
        depth = height + HALF + 2.0
        assert count(contacts) == ((16, 0) if depth > 0.0 else (0, 0))
        np.testing.assert_allclose(contacts.depth[TOP], max(depth, 0.0), atol=1e-12)
        # While the lower face is outside there is nothing to refuse; once it is inside, it is refused.
        assert contacts.unfeasible[BOTTOM].all() == (depth > 0.0)
        if depth > 0.0:
            np.testing.assert_allclose(contacts.normal[TOP], np.tile(DOWN, (16, 1)), atol=1e-12)
            np.testing.assert_allclose(contacts.points[TOP, 2], -2.0, atol=1e-12)
            np.testing.assert_allclose(contacts.barycentric[TOP].sum(axis=1), 1.0, atol=1e-12)


def test_contact_points_are_where_their_weights_say():
    contacts = FlaggedDetector(PLATE).detect((X, Y, 2.9), UPRIGHT, SPHERE.vertices, SPHERE.triangles, DOWN)
    flagged = contacts.flags
    assert flagged.sum() > 8
    corners = SPHERE.vertices[SPHERE.triangles[contacts.triangle[flagged]]]
    np.testing.assert_allclose(
        np.einsum("nc,ncx->nx", contacts.barycentric[flagged], corners), contacts.points[flagged], atol=1e-9
    )
    nodes = PLATE.nodes + np.array([X, Y, 2.9])
    np.testing.assert_allclose(contacts.points, nodes - contacts.depth[:, None] * PLATE.normals, rtol=0.0, atol=1e-12)
    assert (contacts.barycentric >= 0.0).all()
    assert ((contacts.normal[flagged] * PLATE.normals[flagged]).sum(axis=1) < 0.0).all()
    # What is not flagged says so in every array.
    clear = ~flagged
    assert (contacts.triangle[clear] == -1).all()
    assert not contacts.depth[clear].any()
    assert not contacts.normal[clear].any()
    assert not contacts.barycentric[clear].any()


def test_slow_rise_into_a_sphere_flags_more_and_more_nodes():
    detector, counts = FlaggedDetector(PLATE), []
    for height in np.arange(-3.2, 2.5, 0.02):
        contacts = detector.detect((X, Y, height), UPRIGHT, SPHERE.vertices, SPHERE.triangles, UP)
        counts.append(count(contacts))
    tops, bottoms = np.array(counts).T
    assert not bottoms.any()
    assert (np.diff(tops) >= 0).all()
    assert tops[0] == 0
    assert tops[-1] == 16
    # The sphere is round: its nodes are not all touched at once.
    assert len(set(tops)) > 4


def test_second_step_alone_flags_both_faces():
    detector = FlaggedDetector(PLATE, "off")
    contacts = detector.detect((X, Y, -2.0), UPRIGHT, CUBE.vertices, CUBE.triangles, UP)
    assert count(contacts) == (16, 0)
    contacts = detector.detect((X, Y, -1.9), UPRIGHT, CUBE.vertices, CUBE.triangles, UP)
    assert count(contacts) == (16, 16)
    assert not contacts.unfeasible.any()
    # Both faces push, in opposite directions.
    np.testing.assert_allclose(contacts.depth[TOP], 0.1 + HALF, atol=1e-12)
    np.testing.assert_allclose(contacts.depth[BOTTOM], 3.9 + HALF, atol=1e-12)


# Fast motion -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("first_step", ["inside", "any_hit"])
@pytest.mark.parametrize(("velocity", "expected"), [(UP, (16, 0)), (DOWN, (0, 16))])
def test_one_step_jump_to_fully_inside_picks_the_leading_face(first_step, velocity, expected):
    detector = FlaggedDetector(PLATE, first_step)
    for _ in range(3):
        contacts = detector.detect((X, Y, 0.3), UPRIGHT, CUBE.vertices, CUBE.triangles, velocity)
        assert count(contacts) == expected
        np.testing.assert_array_equal(contacts.unfeasible, ~contacts.flags)
    # Once decided it stays so, also when the tool turns back or rests.
    for later in ((0.0, 0.0, 0.0), UP, DOWN):
        contacts = detector.detect((X, Y, 0.3), UPRIGHT, CUBE.vertices, CUBE.triangles, later)
        assert count(contacts) == expected


def test_at_rest_the_first_face_by_index_wins():
    contacts = FlaggedDetector(PLATE).detect((X, Y, 0.3), UPRIGHT, CUBE.vertices, CUBE.triangles)
    assert count(contacts) == (0, 16)


def test_what_leads_is_decided_node_by_node():
    # Turning about +y moves nodes with x < 0 up and nodes with x > 0 down.
    contacts = FlaggedDetector(PLATE).detect(
        (X, Y, 0.3), UPRIGHT, CUBE.vertices, CUBE.triangles, angular_velocity=(0.0, 2.0, 0.0)
    )
    np.testing.assert_array_equal(contacts.flags[TOP], PLATE.nodes[TOP, 0] < 0.0)
    np.testing.assert_array_equal(contacts.flags[BOTTOM], PLATE.nodes[BOTTOM, 0] > 0.0)
    # If the translation is faster than the rotation, all nodes move the same way.
    contacts = FlaggedDetector(PLATE).detect(
        (X, Y, 0.3), UPRIGHT, CUBE.vertices, CUBE.triangles, (0.0, 0.0, 1.1), (0.0, 2.0, 0.0)
    )
    assert count(contacts) == (16, 0)


def test_what_leads_is_decided_in_the_world_frame():
    # Upside down, the face that is the bottom in the tool's frame is on top.
    upside_down = (1.0, 0.0, 0.0, 0.0)
    contacts = FlaggedDetector(PLATE).detect((X, Y, 0.3), upside_down, CUBE.vertices, CUBE.triangles, UP)
    assert count(contacts) == (0, 16)


@pytest.mark.parametrize("thickness", [0.01, 0.125, 1.0])
def test_rays_are_longer_than_the_tool(thickness):
    tool = Tool.box((1.0, 1.0, thickness), 3)
    top = tool.face_nodes(1)
    contacts = FlaggedDetector(tool).detect((X, Y, 1.3), UPRIGHT, CUBE.vertices, CUBE.triangles, UP)
    assert contacts.flags[top].all()
    np.testing.assert_allclose(contacts.depth[top], 3.3 + thickness / 2.0, atol=1e-12)


def test_rays_are_longer_than_the_organ_of_the_seed():
    contacts = FlaggedDetector(PLATE).detect((X, Y, 2.4), UPRIGHT, SPHERE.vertices, SPHERE.triangles, UP)
    assert contacts.flags[TOP].all()
    assert (contacts.depth[TOP] > 4.8).all()


def test_nodes_touched_before_the_jump_keep_their_face():
    # Moving down, the bottom would be chosen: so it is for the only node of the top without a flag from before.
    detector = FlaggedDetector(PLATE)
    touched = np.zeros(32, dtype=bool)
    touched[TOP[1:]] = True
    detector.flags = touched
    for _ in range(3):
        contacts = detector.detect((X, Y, 0.3), UPRIGHT, CUBE.vertices, CUBE.triangles, DOWN)
        assert count(contacts) == (15, 1)
        assert contacts.flags[BOTTOM[0]]
        assert contacts.unfeasible[TOP[0]]


def test_a_jump_clean_through_is_invisible_to_a_single_query():
    # Why a simulation must divide the path.
    detector = FlaggedDetector(PLATE)
    for height in (-2.5, 2.5):
        contacts = detector.detect((X, Y, height), UPRIGHT, CUBE.vertices, CUBE.triangles, (0.0, 0.0, 1200.0))
        assert count(contacts) == (0, 0)
    # Divided, with the flags carried along, it is seen in time.
    counts = []
    for height in np.arange(-2.5, 2.5, HALF):
        contacts = detector.detect((X, Y, height), UPRIGHT, CUBE.vertices, CUBE.triangles, (0.0, 0.0, 1200.0))
        counts.append(count(contacts))
    assert counts[0] == (0, 0)
    assert counts[len(counts) // 2] == (16, 0)


# Memory ------------------------------------------------------------------------------------------------------------


def test_memory_is_lost_only_when_the_face_leaves():
    detector = FlaggedDetector(PLATE)

    def at(height, velocity):
        return count(detector.detect((X, Y, height), UPRIGHT, CUBE.vertices, CUBE.triangles, velocity))

    assert at(-2.0, UP) == (16, 0)
    assert at(1.9, UP) == (16, 0)
    # The top is out on the far side, the bottom still in: the contact is now the bottom's.
    assert at(2.0, UP) == (0, 16)
    # And stays the bottom's when the tool turns back, until the bottom leaves in its turn.
    assert at(1.5, DOWN) == (0, 16)
    assert at(-1.9, DOWN) == (0, 16)
    assert at(-2.0, DOWN) == (16, 0)
    assert at(-2.1, DOWN) == (0, 0)


@settings(deadline=None, max_examples=50)
@given(seeds, st.sampled_from(["inside", "any_hit"]))
def test_any_motion_inside_leaves_the_flags_alone(seed, first_step):
    generator = np.random.default_rng(seed)
    sphere = icosphere(2.0, 2)
    detector = FlaggedDetector(PLATE, first_step)
    flags = np.zeros(32, dtype=bool)
    # Each pair's owner is drawn by lot.
    flags[np.where(generator.random(16) < 0.5, TOP, BOTTOM)] = True
    detector.flags = flags
    for _ in range(8):
        contacts = detector.detect(
            generator.uniform(-0.5, 0.5, 3),
            random_rotation(generator),
            sphere.vertices,
            sphere.triangles,
            generator.normal(size=3),
            generator.normal(size=3),
        )
        np.testing.assert_array_equal(contacts.flags, flags)
        np.testing.assert_array_equal(contacts.unfeasible, ~flags)


@settings(deadline=None, max_examples=100)
@given(seeds, st.booleans())
def test_a_pair_has_one_flag_if_it_is_inside_and_none_if_it_is_outside(seed, all_faces):
    generator = np.random.default_rng(seed)
    sphere = icosphere(2.0, 1)
    tool = Tool.box((1.0, 0.7, 0.3), 4, "all" if all_faces else "largest")
    detector = FlaggedDetector(tool)
    # Whatever was remembered, even both nodes of a pair.
    detector.flags = generator.random(len(tool.nodes)) < 0.5
    position = generator.normal(size=3)
    position *= generator.uniform(1.2, 2.3) / np.linalg.norm(position)
    orientation = random_rotation(generator)
    contacts = detector.detect(position, orientation, sphere.vertices, sphere.triangles, generator.normal(size=3))
    inside = is_inside_convex(sphere, tool.nodes @ rotation_matrix(orientation).T + position) > 0.0
    assert not (contacts.flags & contacts.flags[tool.opposite]).any()
    assert not (contacts.flags & ~inside).any()
    np.testing.assert_array_equal(contacts.flags | contacts.flags[tool.opposite], inside | inside[tool.opposite])


@pytest.mark.parametrize("first_step", ["inside", "any_hit", "off"])
def test_outside_all_flags_are_cleared(first_step):
    detector = FlaggedDetector(PLATE, first_step)
    for height in (-2.2, 2.2, 9.0):
        detector.flags = np.ones(32, dtype=bool)
        contacts = detector.detect((X, Y, height), UPRIGHT, CUBE.vertices, CUBE.triangles, UP)
        assert not contacts.flags.any()
        assert not detector.flags.any()


def test_reset_forgets():
    detector = FlaggedDetector(PLATE)
    detector.detect((X, Y, 0.3), UPRIGHT, CUBE.vertices, CUBE.triangles, UP)
    assert detector.flags.any()
    detector.reset()
    assert not detector.flags.any()
    contacts = detector.detect((X, Y, 0.3), UPRIGHT, CUBE.vertices, CUBE.triangles, DOWN)
    assert count(contacts) == (0, 16)


# Two walls ---------------------------------------------------------------------------------------------------------

# A fissure between x = 0 and x = 1, and a plate that stands in the left wall: one face (x = 0.05) has just come out
# into the gap, with its flags still set, the other (x = -0.075) is inside.
WALL = box_surface((2.0, 4.0, 4.0), 0.7)
FISSURE_VERTICES = np.concatenate([shifted(WALL, (-1.0, 0.0, 0.0)), shifted(WALL, (2.0, 0.0, 0.0))])
FISSURE_TRIANGLES = np.concatenate([WALL.triangles, WALL.triangles + len(WALL.vertices)])
STANDING = Tool.box((0.125, 1.0, 1.0), 4)
LEFT, RIGHT = STANDING.face_nodes(0), STANDING.face_nodes(1)


def query_fissure(first_step):
    detector = FlaggedDetector(STANDING, first_step)
    stale = np.zeros(32, dtype=bool)
    stale[RIGHT] = True
    detector.flags = stale
    return detector.detect(
        (-0.0125, X, Y), UPRIGHT, FISSURE_VERTICES, FISSURE_TRIANGLES, linear_velocity=(-1.0, 0.0, 0.0)
    )


def test_fissure_a_second_wall_in_front_does_not_refuse_a_good_contact():
    contacts = query_fissure("inside")
    assert contacts.flags[LEFT].all()
    assert not contacts.flags[RIGHT].any()
    assert not contacts.unfeasible[LEFT].any()
    np.testing.assert_allclose(contacts.depth[LEFT], 0.075, atol=1e-12)


def test_fissure_to_the_letter_a_second_wall_refuses_the_contact():
    contacts = query_fissure("any_hit")
    assert not contacts.flags.any()
    assert contacts.unfeasible[LEFT].all()


@pytest.mark.parametrize("first_step", ["inside", "any_hit"])
def test_fissure_between_the_walls_there_is_no_contact(first_step):
    contacts = FlaggedDetector(STANDING, first_step).detect(
        (0.5, X, Y), UPRIGHT, FISSURE_VERTICES, FISSURE_TRIANGLES, linear_velocity=(1.0, 0.0, 0.0)
    )
    assert not contacts.flags.any()


@pytest.mark.parametrize("first_step", ["inside", "any_hit"])
def test_fissure_pressing_on_the_far_wall(first_step):
    detector = FlaggedDetector(STANDING, first_step)
    for x in np.arange(0.5, 1.5, 0.04):
        contacts = detector.detect(
            (x, X, Y), UPRIGHT, FISSURE_VERTICES, FISSURE_TRIANGLES, linear_velocity=(1.0, 0.0, 0.0)
        )
        depth = max(x + HALF - 1.0, 0.0)
        assert not contacts.flags[LEFT].any()
        np.testing.assert_allclose(contacts.depth[RIGHT], depth, atol=1e-12)


# Edge-on -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("first_step", ["inside", "any_hit"])
@pytest.mark.parametrize("velocity", [(1.0, 0.0, 0.0), (1.0, 0.0, 1e-3), (1.0, 0.0, -1e-3)])
def test_edge_on_motion_never_flags_both_nodes_of_a_pair(first_step, velocity):
    detector = FlaggedDetector(PLATE, first_step)
    for x in np.arange(-2.7, 0.0, 0.05):
        contacts = detector.detect((x, Y, 0.1), UPRIGHT, CUBE.vertices, CUBE.triangles, velocity)
        assert not (contacts.flags & contacts.flags[PLATE.opposite]).any()
        inside = PLATE.nodes[:, 0] + x > -2.0
        np.testing.assert_array_equal(contacts.flags | contacts.flags[PLATE.opposite], inside)
        # Both faces come in at once: the one that moves ahead, or else the first, takes the contact.
        assert not contacts.flags[BOTTOM if velocity[2] > 0.0 else TOP].any()


def test_edge_on_the_faces_of_the_rim_see_the_contact():
    tool = Tool.box((1.0, 1.0, 0.125), 4, "all")
    front = np.flatnonzero(tool.normals[:, 0] == 1.0)
    contacts = FlaggedDetector(tool).detect(
        (-2.45, Y, 0.1), UPRIGHT, CUBE.vertices, CUBE.triangles, linear_velocity=(1.0, 0.0, 0.0)
    )
    assert contacts.flags[front].all()
    np.testing.assert_allclose(contacts.depth[front], 0.05, atol=1e-12)


# Rays through edges and vertices -----------------------------------------------------------------------------------


@pytest.mark.parametrize("x", [0.0, 0.25, 0.5, 0.125])
@pytest.mark.parametrize("y", [0.0, 0.25, 0.5, 0.125])
def test_rays_through_vertices_edges_and_diagonals_of_a_grid(x, y):
    # Nodes every 0.25, grid of 0.5: rays through vertices, through both kinds of edges and through diagonals.
    cube = box_surface((4.0, 4.0, 4.0), 0.5)
    tool = Tool.box((1.0, 1.0, 0.125), 5)
    detector = FlaggedDetector(tool, "off")
    contacts = detector.detect((x, y, -2.0), UPRIGHT, cube.vertices, cube.triangles)
    np.testing.assert_array_equal(contacts.flags, tool.face == 1)
    np.testing.assert_allclose(contacts.depth[25:], HALF, atol=1e-12)
    contacts = detector.detect((x, y, 0.3), UPRIGHT, cube.vertices, cube.triangles)
    assert contacts.flags.all()
    contacts = detector.detect((x, y, 2.1), UPRIGHT, cube.vertices, cube.triangles)
    assert not contacts.flags.any()
    np.testing.assert_allclose(contacts.barycentric.sum(), 0.0)


HALF_TURN = np.sqrt(0.5)
RIGHT_ANGLES = [
    (0.0, 0.0, 0.0, 1.0),
    (1.0, 0.0, 0.0, 0.0),
    (HALF_TURN, 0.0, 0.0, HALF_TURN),
    (0.0, HALF_TURN, 0.0, HALF_TURN),
    (0.0, 0.0, HALF_TURN, HALF_TURN),
    (0.5, 0.5, 0.5, 0.5),
    (0.5, -0.5, 0.5, -0.5),
]


@pytest.mark.parametrize("orientation", RIGHT_ANGLES)
@pytest.mark.parametrize("subdivisions", [0, 2])
def test_rays_in_the_symmetry_planes_of_a_symmetric_mesh(orientation, subdivisions):
    # The three planes of symmetry run along edges and through vertices of the icosphere.
    sphere = icosphere(2.0, subdivisions)
    tool = Tool.box((3.0, 3.0, 0.25), 7, "all")
    nodes = tool.nodes @ rotation_matrix(orientation).T
    detector = FlaggedDetector(tool, "off")
    seen = 0
    for shift in np.linspace(-2.2, 2.2, 23):
        for axis in np.eye(3):
            contacts = detector.detect(shift * axis, orientation, sphere.vertices, sphere.triangles)
            inside = is_inside_convex(sphere, nodes + shift * axis)
            sure = np.abs(inside) > 1e-9
            np.testing.assert_array_equal(contacts.flags[sure], inside[sure] > 0.0)
            seen += int(contacts.flags.sum())
    assert seen > 1000


@pytest.mark.parametrize("first_step", ["inside", "any_hit"])
def test_exactly_aligned_pairs_have_one_flag(first_step):
    sphere = icosphere(2.0, 2)
    tool = Tool.box((3.0, 3.0, 0.25), 7)
    detector = FlaggedDetector(tool, first_step)
    for height in np.linspace(-2.5, 2.5, 41):
        contacts = detector.detect((0.0, 0.0, height), UPRIGHT, sphere.vertices, sphere.triangles, UP)
        inside = is_inside_convex(sphere, tool.nodes + np.array([0.0, 0.0, height]))
        pair = np.maximum(inside, inside[tool.opposite])
        assert not (contacts.flags & contacts.flags[tool.opposite]).any()
        sure = np.abs(pair) > 1e-9
        np.testing.assert_array_equal((contacts.flags | contacts.flags[tool.opposite])[sure], (pair > 0.0)[sure])


def voxel_surface(filled):
    """The boundary of a set of unit cubes, two triangles a square, cube (i, j, k) reaching from there to +1."""
    padded = np.pad(filled, 1)
    corners = []
    for axis in range(3):
        first, second = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        step = np.eye(3, dtype=int)[axis]
        for cell in np.argwhere(padded):
            low = cell - 1.0
            if not padded[tuple(cell - step)]:
                corners.append([low, low + second, low + first + second, low + first])
            if not padded[tuple(cell + step)]:
                low = low + step
                corners.append([low, low + first, low + first + second, low + second])
    corners = np.array(corners).reshape(-1, 4, 3)
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    quads = index.reshape(-1, 4)
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)


def is_surrounded(filled, points):
    """Which points have only filled cubes, and which only empty ones, within 1e-6 around them."""
    padded = np.pad(filled, 3)
    around = np.array(np.meshgrid(*[[-1e-6, 1e-6]] * 3)).reshape(3, 8).T
    cells = np.floor(points[:, None, :] + around).astype(int) + 3
    cells = np.clip(cells, 0, np.array(padded.shape) - 1)
    here = padded[cells[..., 0], cells[..., 1], cells[..., 2]]
    return here.all(axis=1), ~here.any(axis=1)


@settings(deadline=None, max_examples=150)
@given(st.lists(st.booleans(), min_size=27, max_size=27), st.sampled_from(RIGHT_ANGLES), seeds)
def test_rays_along_the_walls_of_a_concave_body(cells, orientation, seed):
    # Silhouettes everywhere, convex and concave: nodes stand on grid lines, so that rays run along walls, through
    # ridges and through re-entrant edges. What is surrounded by the body is inside, what is surrounded by air is not.
    filled = np.array(cells).reshape(3, 3, 3)
    if not filled.any():
        return
    vertices, triangles = voxel_surface(filled)
    tool = Tool.box((2.0, 2.0, 0.3), 5)
    generator = np.random.default_rng(seed)
    detector = FlaggedDetector(tool, "off")
    # At home coordinates are exact; elsewhere they are rounded, and rays pass edges at a hair's breadth.
    for shift in (np.zeros(3), np.zeros(3), generator.normal(size=3), 1e3 * generator.normal(size=3)):
        position = generator.integers(0, 7, 3) / 2.0
        # Along the rays the nodes stay clear of walls.
        position += rotation_matrix(orientation)[:, 2] * generator.uniform(-0.1, 0.1)
        contacts = detector.detect(position + shift, orientation, vertices + shift, triangles)
        inside, outside = is_surrounded(filled, tool.nodes @ rotation_matrix(orientation).T + position)
        assert contacts.flags[inside].all()
        assert not contacts.flags[outside].any()


def diamond_bar(radius):
    """A bar along y, its section a square standing on a corner: vertical rays graze its ridges at x = +-radius."""
    section = radius * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    vertices = np.concatenate([np.column_stack([section[:, 0], np.full(4, y), section[:, 1]]) for y in (-1.9, 1.9)])
    triangles = [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]]
    for k in range(4):
        a, b = k, (k + 1) % 4
        triangles += [[a, a + 4, b + 4], [a, b + 4, b]]
    a, b, c = (vertices[np.array(triangles)[:, k]] for k in range(3))
    outwards = np.einsum("ij,ij->", a, np.cross(b, c)) > 0.0
    return vertices, np.array(triangles, dtype=np.int32)[:, :: 1 if outwards else -1]


RAKE = Tool.box((2.0, 2.0, 0.125), 5)
"""Its nodes are at x = -1, -0.5, 0, 0.5 and 1."""


def test_a_ray_that_grazes_a_ridge_from_outside_crosses_nothing():
    vertices, triangles = diamond_bar(1.0)
    contacts = FlaggedDetector(RAKE, "off").detect((0.0, 0.0, 1.5), UPRIGHT, vertices, triangles, DOWN)
    assert not contacts.flags.any()
    # A cube beneath the bar, with the plate coming into it: rays pass the ridges, and only the cube counts.
    vertices = np.concatenate([vertices, shifted(CUBE, (0.0, 0.0, -4.0))])
    triangles = np.concatenate([triangles, CUBE.triangles + 8])
    contacts = FlaggedDetector(RAKE).detect((0.0, 0.0, -2.0), UPRIGHT, vertices, triangles, DOWN)
    np.testing.assert_array_equal(contacts.flags, RAKE.face == 0)
    np.testing.assert_allclose(contacts.depth[RAKE.face == 0], HALF, atol=1e-12)


def test_a_ray_that_grazes_a_ridge_from_inside_goes_on():
    # The bar as a cavity in the cube: rays that graze its ridges have not left the cube there.
    bar, inwards = diamond_bar(0.5)
    vertices = np.concatenate([CUBE.vertices, bar])
    triangles = np.concatenate([CUBE.triangles, inwards[:, ::-1] + len(CUBE.vertices)])
    contacts = FlaggedDetector(RAKE).detect((0.0, 0.0, 1.5), UPRIGHT, vertices, triangles, UP)
    np.testing.assert_array_equal(contacts.flags, RAKE.face == 1)
    top = RAKE.face == 1
    expected = np.where(RAKE.nodes[top, 0] == 0.0, 1.0 + HALF, 3.5 + HALF)
    np.testing.assert_allclose(contacts.depth[top], expected, atol=1e-12)


def test_a_node_exactly_on_the_surface_touches_without_depth():
    detector = FlaggedDetector(PLATE)
    for offset, expected in ((-1e-9, 0), (1e-9, 16)):
        detector.reset()
        contacts = detector.detect((X, Y, -2.0 - HALF + offset), UPRIGHT, CUBE.vertices, CUBE.triangles, UP)
        assert count(contacts) == (expected, 0)
    # Exactly on it either answer is right, but not a deep contact, and not the other face's.
    detector.reset()
    contacts = detector.detect((X, Y, -2.0 - HALF), UPRIGHT, CUBE.vertices, CUBE.triangles, UP)
    assert not contacts.flags[BOTTOM].any()
    np.testing.assert_allclose(contacts.depth, 0.0, atol=1e-12)
    assert np.isfinite(contacts.barycentric).all()
    # The same on the far side: the pair is inside, so one of its nodes has the contact.
    contacts = detector.detect((X, Y, 2.0 - HALF), UPRIGHT, CUBE.vertices, CUBE.triangles, UP)
    assert (contacts.flags ^ contacts.flags[PLATE.opposite]).all()


def test_a_vertex_exactly_on_a_node():
    # Nodes at the grid's own vertices: position and height coincide.
    cube = box_surface((4.0, 4.0, 4.0), 0.5)
    tool = Tool.box((1.0, 1.0, 0.125), 3)
    contacts = FlaggedDetector(tool).detect((0.0, 0.0, -2.0 - HALF), UPRIGHT, cube.vertices, cube.triangles, UP)
    assert not contacts.flags[tool.face == 0].any()
    np.testing.assert_allclose(contacts.depth, 0.0, atol=1e-12)
    assert np.isfinite(contacts.barycentric).all()
    assert np.isfinite(contacts.normal).all()


# What must not matter ----------------------------------------------------------------------------------------------


def permuted(tool, order):
    """The same tool with its nodes in another order."""
    rank = np.argsort(order)
    return Tool(
        nodes=tool.nodes[order],
        normals=tool.normals[order],
        opposite=rank[tool.opposite[order]],
        face=tool.face[order],
        face_normals=tool.face_normals,
        areas=tool.areas[order],
        vertices=tool.vertices,
        triangles=tool.triangles,
    )


@settings(deadline=None, max_examples=15)
@given(seeds, st.sampled_from([UP, DOWN, (0.0, 0.0, 0.0)]))
def test_in_slow_motion_the_order_of_the_nodes_does_not_matter(seed, velocity):
    generator = np.random.default_rng(seed)
    order = generator.permutation(32)
    one, other = FlaggedDetector(PLATE), FlaggedDetector(permuted(PLATE, order))
    turned = random_rotation(generator)
    vertices = SPHERE.vertices @ rotation_matrix(turned).T
    # Rising slowly from below, whatever the stated velocity makes of the order.
    for height in np.arange(-3.2, 0.0, 0.1):
        pose = (X, Y, height), UPRIGHT
        contacts = one.detect(*pose, vertices, SPHERE.triangles, velocity)
        others = other.detect(*pose, vertices, SPHERE.triangles, velocity)
        np.testing.assert_array_equal(contacts.flags[order], others.flags)
        np.testing.assert_array_equal(contacts.triangle[order], others.triangle)
        assert count(contacts)[1] == 0
    assert count(contacts)[0] == 16


@settings(deadline=None, max_examples=50)
@given(seeds, st.sampled_from(["inside", "any_hit", "off"]))
def test_the_order_of_the_triangles_does_not_matter(seed, first_step):
    generator = np.random.default_rng(seed)
    order = generator.permutation(len(SPHERE.triangles))
    # Another first corner does not change a triangle.
    turns = (np.arange(3) + generator.integers(0, 3, (len(order), 1))) % 3
    triangles = np.take_along_axis(SPHERE.triangles[order], turns, axis=1)
    position, orientation = generator.normal(size=3) * 1.8, random_rotation(generator)
    velocity, flags = generator.normal(size=3), generator.random(32) < 0.3
    results = []
    for mesh in (SPHERE.triangles, triangles):
        detector = FlaggedDetector(PLATE, first_step)
        detector.flags = flags
        results.append(detector.detect(position, orientation, SPHERE.vertices, mesh, velocity))
    one, other = results
    np.testing.assert_array_equal(one.flags, other.flags)
    np.testing.assert_array_equal(one.unfeasible, other.unfeasible)
    flagged = one.flags
    np.testing.assert_array_equal(one.triangle[flagged], order[other.triangle[flagged]])
    np.testing.assert_allclose(one.depth, other.depth, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(one.normal, other.normal, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(
        np.take_along_axis(one.barycentric[flagged], turns[other.triangle[flagged]], axis=1),
        other.barycentric[flagged],
        rtol=0.0,
        atol=1e-9,
    )


@settings(deadline=None, max_examples=50)
@given(seeds, st.sampled_from(["inside", "any_hit", "off"]))
def test_where_the_scene_is_and_how_it_is_turned_does_not_matter(seed, first_step):
    generator = np.random.default_rng(seed)
    position, orientation = generator.normal(size=3) * 1.8, random_rotation(generator)
    linear, angular, flags = generator.normal(size=3), generator.normal(size=3), generator.random(32) < 0.3
    shift, turn = 10.0 * generator.normal(size=3), random_rotation(generator)
    turning = rotation_matrix(turn)
    # turn * orientation, by Hamilton's rule
    vector, scalar = orientation[:3], orientation[3]
    turned = np.append(
        turn[3] * vector + scalar * turn[:3] + np.cross(turn[:3], vector), turn[3] * scalar - turn[:3] @ vector
    )
    one, other = FlaggedDetector(PLATE, first_step), FlaggedDetector(PLATE, first_step)
    one.flags = other.flags = flags
    here = one.detect(position, orientation, SPHERE.vertices, SPHERE.triangles, linear, angular)
    there = other.detect(
        turning @ position + shift,
        turned,
        SPHERE.vertices @ turning.T + shift,
        SPHERE.triangles,
        turning @ linear,
        turning @ angular,
    )
    np.testing.assert_array_equal(here.flags, there.flags)
    np.testing.assert_array_equal(here.unfeasible, there.unfeasible)
    np.testing.assert_array_equal(here.triangle, there.triangle)
    np.testing.assert_allclose(here.depth, there.depth, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(here.barycentric, there.barycentric, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(here.normal @ turning.T, there.normal, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(here.points @ turning.T + shift, there.points, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_the_unit_of_length_does_not_matter(factor):
    plate = Tool.box(np.array([1.0, 1.0, 0.125]) * factor, 4)
    ours = FlaggedDetector(PLATE).detect((X, Y, 2.9), UPRIGHT, SPHERE.vertices, SPHERE.triangles, DOWN)
    theirs = FlaggedDetector(plate).detect(
        np.array([X, Y, 2.9]) * factor, UPRIGHT, SPHERE.vertices * factor, SPHERE.triangles, DOWN
    )
    assert ours.flags.any()
    np.testing.assert_array_equal(ours.flags, theirs.flags)
    np.testing.assert_array_equal(ours.triangle, theirs.triangle)
    np.testing.assert_allclose(ours.depth * factor, theirs.depth, rtol=0.0, atol=1e-12 * factor)
