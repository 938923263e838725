"""The face through which a point came into a convex tool, compared with a search along its path.

The greatest height of a point on a straight path over the body's planes is a convex function of time: its least value
tells whether the path leads into the body, and bisection finds when it first does.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from reference_detector import random_rotation, rotation_matrix

from spatula_env.contact.path import MARGIN, ON_PLANE, SLACK, entry_plane
from spatula_env.geometry import Tool

# What is random is drawn from a generator with a drawn seed: hypothesis prefers round numbers, with which ways lead
# exactly through edges. Those cases have tests of their own.
seeds = st.integers(0, 2**32 - 1)
body_names = st.sampled_from(["plate", "sheet", "cube", "wedge", "polyhedron 0", "polyhedron 1", "polyhedron 2"])

PLATE = Tool.box((1.0, 0.8, 0.125))
TOP, BOTTOM, RIGHT = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)
HALF = 0.0625
"""Half the plate's thickness."""


@cache
def planes(name):
    """Normals and offsets of a body's faces, each once."""
    if name == "wedge":
        points = [(x, y, z) for x in (-0.6, 0.6) for y, z in ((0.0, -0.4), (-0.4, 0.3), (0.4, 0.3))]
        tool = Tool.convex(points, 0.2)
    elif name.startswith("polyhedron"):
        points = np.random.default_rng(int(name[-1])).normal(size=(12, 3)) * [0.6, 0.5, 0.3]
        tool = Tool.convex(points, 0.3)
    else:
        tool = Tool.box({"plate": (1.0, 0.8, 0.125), "sheet": (1.0, 1.0, 0.02), "cube": (1.0, 1.0, 1.0)}[name])
    rows = np.column_stack(tool.planes)
    rows = rows[np.sort(np.unique(rows.round(9), axis=0, return_index=True)[1])]
    return np.ascontiguousarray(rows[:, :3]), np.ascontiguousarray(rows[:, 3])


def entered(before, after, normals, offsets, touching=MARGIN):
    return entry_plane(*before, *after, normals, offsets, touching)


def normal_of_entry(before, after, tool=PLATE, touching=MARGIN):
    """Normal of the face by which a point comes into a tool, or None."""
    normals, offsets = (np.ascontiguousarray(array) for array in tool.planes)
    plane = entered(before, after, normals, offsets, touching)
    return None if plane < 0 else tuple(normals[plane].round(12) + 0.0)


def search(before, after, normals, offsets):
    """(least height above the farthest plane along the path, height above each plane when the path first enters)."""
    start, way = normals @ before - offsets, normals @ (after - before)

    def farthest(time):
        return (start + time * way).max()

    low, high = 0.0, 1.0
    for _ in range(120):
        first, second = low + (high - low) / 3.0, high - (high - low) / 3.0
        low, high = (low, second) if farthest(first) < farthest(second) else (first, high)
    lowest = 0.5 * (low + high)
    if farthest(lowest) >= 0.0:
        return farthest(lowest), None
    outside, inside = 0.0, lowest
    for _ in range(80):
        middle = 0.5 * (outside + inside)
        outside, inside = (middle, inside) if farthest(middle) > 0.0 else (outside, middle)
    return farthest(lowest), start + inside * way


def random_way(generator, normals, offsets):
    """A random path that begins outside a body and leads roughly towards it."""
    size = np.abs(offsets).max()
    target = generator.normal(size=3) * 0.4 * size
    before = generator.normal(size=3) * 1.5 * size
    return before, before + (target - before) * generator.uniform(0.3, 3.0)


def is_clear(before, after, normals, offsets):
    """Whether neither end is within the tolerances of a plane."""
    heights = np.abs(np.array([normals @ before, normals @ after]) - offsets)
    return heights.min() > 2.0 * SLACK


@settings(max_examples=300)
@given(seeds, body_names)
def test_the_first_face_on_the_way(seed, name):
    generator = np.random.default_rng(seed)
    normals, offsets = planes(name)
    before, after = random_way(generator, normals, offsets)
    assume(is_clear(before, after, normals, offsets))
    assume((normals @ before - offsets).max() > 0.0)
    lowest, heights = search(before, after, normals, offsets)
    # Ways that graze the body are decided by the tolerances.
    assume(abs(lowest) > 2.0 * SLACK)
    found = entered(before, after, normals, offsets)
    if heights is None:
        assert found == -1
    else:
        # Where the way leads in by an edge of the body, either of its faces will do.
        assert heights[found] > -2.0 * SLACK
        if np.sort(heights)[-2] < -2.0 * SLACK:
            assert found == np.argmax(heights)


def test_random_ways_are_of_all_kinds():
    # The comparison above is meaningful only if enough paths meet the body, end in it, or go through it.
    generator = np.random.default_rng(0)
    normals, offsets = planes("plate")
    kinds = np.zeros(3)
    for _ in range(300):
        before, after = random_way(generator, normals, offsets)
        missed = entered(before, after, normals, offsets) < 0
        ends_inside = (normals @ after - offsets).max() < 0.0
        kinds += missed, ends_inside, not missed and not ends_inside
    assert kinds.min() > 20


@settings(max_examples=100)
@given(seeds, body_names)
def test_neither_the_order_of_the_planes_nor_a_rotation_matters(seed, name):
    generator = np.random.default_rng(seed)
    normals, offsets = planes(name)
    before, after = random_way(generator, normals, offsets)
    assume(is_clear(before, after, normals, offsets))
    found = entered(before, after, normals, offsets)
    order = generator.permutation(len(offsets))
    shuffled = entered(before, after, np.ascontiguousarray(normals[order]), offsets[order])
    assert (order[shuffled] if shuffled >= 0 else -1) == found
    turn, shift = rotation_matrix(random_rotation(generator)), generator.normal(size=3)
    turned = np.ascontiguousarray(normals @ turn.T)
    assert entered(turn @ before + shift, turn @ after + shift, turned, offsets + turned @ shift) == found


@settings(max_examples=100)
@given(seeds, body_names, st.floats(0.0, 0.95))
def test_from_any_place_before_the_body_the_face_is_the_same(seed, name, part):
    # A step divided in two: the first part ends in front of the body, the second gives the same face.
    generator = np.random.default_rng(seed)
    normals, offsets = planes(name)
    before, after = random_way(generator, normals, offsets)
    found = entered(before, after, normals, offsets)
    nearer = before + part * (after - before)
    assume(is_clear(before, after, normals, offsets) and is_clear(nearer, after, normals, offsets))
    assume((normals @ nearer - offsets).max() > 0.0)
    if entered(before, nearer, normals, offsets) == -1:
        assert entered(nearer, after, normals, offsets) == found


# Where points end --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("end", [0.06, 0.0, -0.06, -0.1, -5.0])
def test_a_thin_plate_keeps_the_face_however_far_the_way_leads(end):
    assert normal_of_entry((0.1, 0.2, 0.5), (0.15, 0.1, end)) == TOP
    assert normal_of_entry((0.1, 0.2, -0.5), (0.15, 0.1, -end)) == BOTTOM


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ((0.1, 0.2, 0.5), (0.1, 0.2, 0.07)),  # ends above
        ((0.1, 0.2, 0.5), (0.1, 0.2, 0.9)),  # goes away
        ((0.4, 0.2, 0.5), (0.7, 0.2, -0.5)),  # passes beside the rim, which is at 0.5
        ((-0.9, 0.2, 0.1), (0.9, 0.2, 0.08)),  # along the top, above
        ((0.6, 0.3, 0.0), (0.3, 0.9, 0.0)),  # passes outside of an edge
        ((0.2, 0.1, 0.0), (0.2, 0.1, 0.5)),  # was deep inside and leaves
    ],
)
def test_ways_that_do_not_lead_in(before, after):
    assert normal_of_entry(before, after) is None


@pytest.mark.parametrize(("height", "expected"), [(0.5 * MARGIN, TOP), (1.5 * MARGIN, None)])
def test_what_is_within_the_margin_touches(height, expected):
    assert normal_of_entry((0.1, 0.2, 0.3), (0.1, 0.2, HALF + height)) == expected
    # So does what slides along a face.
    assert normal_of_entry((0.1, 0.2, HALF + height), (-0.3, 0.1, HALF + height)) == expected


@pytest.mark.parametrize("after", [HALF, HALF - 0.01, -HALF - 1.0])
def test_a_point_that_rested_on_a_face_is_pushed_by_it(after):
    for before in (HALF, HALF - 0.5 * MARGIN, HALF + 0.5 * MARGIN):
        assert normal_of_entry((0.1, 0.2, before), (0.1, 0.2, after)) == TOP


@pytest.mark.parametrize("left", [2.0 * MARGIN, 0.9 * SLACK])
def test_what_was_left_inside_is_still_before_its_face(left):
    before = (0.1, 0.2, HALF - left)
    assert normal_of_entry(before, (0.1, 0.2, HALF - 2.0 * left)) == TOP
    # Deep through the plate, and out of it on the other side.
    assert normal_of_entry(before, (0.1, 0.2, -HALF - 1.0)) == TOP
    # It may rise again as well.
    assert normal_of_entry(before, (0.1, 0.2, HALF + 2.0 * MARGIN)) is None


def test_a_face_that_the_point_was_before_goes_before_one_that_it_was_left_behind():
    # A hair under the top, beside the rim: it comes in by the rim.
    before = (0.5 + 0.3, 0.1, HALF - 0.5 * SLACK)
    assert normal_of_entry(before, (0.3, 0.1, HALF - 0.6 * SLACK)) == RIGHT
    # Beneath the top by no more than a rounding error, it has been before both, and falls faster than it comes in.
    before = (0.5 + 1e-3, 0.1, HALF + 1e-7)
    assert normal_of_entry(before, (0.5 - 1e-3, 0.1, HALF - 0.02)) == RIGHT
    assert normal_of_entry((0.5 - 1e-3, 0.1, HALF + 1e-7), (0.5 - 2e-3, 0.1, HALF - 0.02)) == TOP


def test_what_was_deep_inside_belongs_to_the_face_that_was_nearest():
    assert normal_of_entry((0.1, 0.2, 0.02), (0.1, 0.2, -0.05)) == TOP
    assert normal_of_entry((0.1, 0.2, -0.02), (0.1, 0.2, 0.05)) == BOTTOM
    assert normal_of_entry((0.49, 0.2, 0.0), (0.3, 0.2, 0.05)) == RIGHT
    # A point that does not move at all, too.
    assert normal_of_entry((0.1, 0.2, 0.02), (0.1, 0.2, 0.02)) == TOP


def test_a_point_that_slides_along_one_face_comes_through_another():
    # It ends on the rim's plane exactly, as points of an organ on a contact node's ray do, and sinks through the top.
    before, after = (0.6, 0.1, HALF + 0.05), (0.5, 0.1, 0.0)
    assert normal_of_entry(before, after, touching=-ON_PLANE) == TOP
    # One that may rest on a plane has come to rest on the rim.
    assert normal_of_entry(before, after, touching=MARGIN) == RIGHT
    # Behind the rim it has come through it in either case.
    for touching in (MARGIN, -ON_PLANE):
        assert normal_of_entry(before, (0.5 - 2.0 * MARGIN, 0.1, 0.0), touching=touching) == RIGHT


# Edges and corners -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("way", "expected"), [((-1.0, 0.1, -2.0), TOP), ((-2.0, 0.1, -1.0), RIGHT)])
def test_in_by_an_edge_the_face_against_which_it_moves_faster(way, expected):
    edge = np.array([0.5, 0.0, HALF])
    assert normal_of_entry(edge - 0.3 * np.array(way), edge + 0.01 * np.array(way)) == expected


@settings(max_examples=100)
@given(seeds, st.tuples(*[st.sampled_from([-1.0, 1.0])] * 3))
def test_in_by_a_corner_the_fastest_face(seed, corner):
    generator = np.random.default_rng(seed)
    normals, offsets = planes("cube")
    outwards = np.array(corner)
    way = -outwards * generator.uniform(0.1, 1.0, size=3)
    assume(np.diff(np.sort(np.abs(way))).min() > 1e-3)
    at = 0.5 * outwards
    found = entered(at - way, at + 0.3 * way, normals, offsets)
    assert normals[found] @ way == pytest.approx(-np.abs(way).max())


def test_a_way_along_an_edge_line_meets_the_cap():
    # Exactly in the line in which top and rim meet, from beyond the end of it.
    assert normal_of_entry((0.5, 0.9, HALF), (0.5, 0.1, HALF)) in {(0.0, 1.0, 0.0), TOP, RIGHT}
    assert normal_of_entry((0.5, 0.9, HALF), (0.5, 0.41, HALF)) is None


@pytest.mark.parametrize("name", ["plate", "polyhedron 0"])
def test_a_point_that_rests_stays_with_its_face_in_ever_so_many_steps(name):
    # Pressed a little further each time, and put back onto the face as the response does, it never changes its face.
    normals, offsets = planes(name)
    generator = np.random.default_rng(3)
    for face in range(len(offsets)):
        # A place on the face: the nearest one to the origin, which is inside of it on these bodies or not at all.
        place = normals[face] * offsets[face]
        if (normals @ place - offsets).max() > 1e-9:
            continue
        place = place + (generator.uniform() - 0.5) * SLACK * normals[face]
        for _ in range(20):
            sunk = place - generator.uniform(0.0, 0.3) * normals[face]
            assert entered(place, sunk, normals, offsets) == face
            place = normals[face] * (offsets[face] - generator.uniform(0.0, 0.9) * MARGIN)
