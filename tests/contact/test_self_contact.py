"""Organs are kept apart from themselves and from each other."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from skin_helpers import gathered, skin_of

from spatula_env.contact.self_contact import SEPARATION, SIDE_BIT, gather_organs, leave_out, touching_pairs
from spatula_env.contact.structures import FOURTH, NO_VERTEX, NORMAL, ORGANS, OWNER, POINT, WEIGHTS
from spatula_env.geometry import Organ, box_surface, icosphere

seeds = st.integers(0, 2**32 - 1)
TETRAHEDRON = Organ(
    np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]),
    np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]),
    "tetrahedron",
)


def two(shift):
    """Two tetrahedra, the second one above the face of the first that looks to (1, 1, 1), with a corner towards it."""
    return np.concatenate([TETRAHEDRON.vertices, TETRAHEDRON.vertices + shift])


def test_a_vertex_that_came_through_a_triangle_is_held_before_it():
    skin, near = skin_of(TETRAHEDRON, TETRAHEDRON)
    names, features, rows = gathered(gather_organs, skin, near, two(0.5), two(0.3))
    assert len(names) == 1
    assert features[0, OWNER] == ORGANS and features[0, FOURTH] != NO_VERTEX
    normal = rows[0, NORMAL : NORMAL + 3]
    np.testing.assert_allclose(np.abs(normal), 1.0 / np.sqrt(3.0), atol=1e-12)
    # The fourth vertex is the corner that came: it is to go outwards from the face.
    assert features[0, FOURTH] == 4 and normal.sum() > 0.0 and not names[0] & SIDE_BIT
    np.testing.assert_allclose(rows[0, POINT : POINT + 3], SEPARATION * normal, atol=1e-12)
    np.testing.assert_allclose(rows[0, WEIGHTS : WEIGHTS + 3], -1.0 / 3.0, atol=1e-6)


def test_what_stays_apart_makes_no_constraint():
    skin, near = skin_of(TETRAHEDRON, TETRAHEDRON)
    assert len(gathered(gather_organs, skin, near, two(0.7), two(0.5))[0]) == 0


def test_the_side_is_that_from_which_a_feature_came():
    """From inside outwards as well: walls of a hollow organ are kept apart too."""
    skin, near = skin_of(TETRAHEDRON, TETRAHEDRON)
    names, features, rows = gathered(gather_organs, skin, near, two(0.3), two(0.34))
    corner = features[:, FOURTH] == 4
    assert corner.sum() == 1 and names[corner][0] & SIDE_BIT
    assert rows[corner][0, NORMAL : NORMAL + 3].sum() < 0.0


def test_crossed_edges_are_held_on_their_sides():
    """Two needles, one laid over the other and moved through it."""
    needle = Organ(
        np.array([(-1, 0, 0), (1, 0.1, 0), (1, -0.1, 0), (1, 0, -0.1)], dtype=float), TETRAHEDRON.triangles, "n"
    )
    skin, near = skin_of(needle, needle)
    turned = needle.vertices[:, [1, 0, 2]] * (1.0, 1.0, -1.0)

    def at(height):
        return np.concatenate([needle.vertices, turned + np.array([0.0, 0.0, height])])

    names, _, rows = gathered(gather_organs, skin, near, at(0.1), at(-0.05))
    kinds = set((names >> 60).tolist())
    assert kinds >= {6}
    edges = rows[names >> 60 == 6]
    # Edges of the second organ are weighted with plus: they are to stay above.
    assert (np.abs(edges[:, NORMAL + 2]) > 0.5).any()


def test_what_touches_in_an_organs_own_shape_is_left_out():
    organ = box_surface((1.0, 1.0, 0.02), 0.5)
    skin, near = skin_of(organ)
    vertices = np.array(organ.vertices)
    touching = touching_pairs(skin, near, vertices, 1.0)
    assert len(touching) > 0 and (np.diff(touching) > 0).all()
    leave_out(skin, touching)
    skin_names = gathered(gather_organs, skin, near, vertices, vertices)[0]
    assert len(skin_names) == 0


@settings(max_examples=20)
@given(seeds)
def test_pairs_do_not_depend_on_what_was_known_before(seed):
    """Results do not depend on whether candidates were found at the present positions, or earlier and farther away."""
    generator = np.random.default_rng(seed)
    organ = icosphere(1.0, 1)
    points = np.concatenate([organ.vertices, organ.vertices + generator.normal(size=3) / np.sqrt(3.0) * 2.0])
    held, now = points + 0.05 * generator.normal(size=points.shape), points + 0.05 * generator.normal(size=points.shape)
    outcomes = []
    for earlier in (None, points):
        skin, near = skin_of(organ, organ)
        if earlier is not None:
            gathered(gather_organs, skin, near, earlier, earlier)
        outcomes.append(gathered(gather_organs, skin, near, held, now))
    for first, second in zip(*outcomes, strict=True):
        np.testing.assert_array_equal(first, second)
