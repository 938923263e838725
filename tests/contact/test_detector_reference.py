"""The detector sets exactly the same flags as the reference implementation of the flags method."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_detector import ReferenceDetector, Surface, random_rotation, rotation_matrix

from spatula_env.contact import FlaggedDetector
from spatula_env.geometry import Tool, box_surface, icosphere, seed_sphere, torus

TOLERANCE = 1e-9

# Everything continuous is drawn from a generator with a drawn seed, not by hypothesis, which prefers round numbers:
# with those, rays pass exactly through edges, and the plain form has no answer there.
seeds = st.integers(0, 2**32 - 1)
organ_names = st.sampled_from(["sphere", "icosphere", "torus", "box"])
tool_names = st.sampled_from(["plate", "plate, all faces", "block, all faces", "polyhedron 0", "polyhedron 1"])
first_steps = st.sampled_from(["inside", "any_hit", "off"])


@cache
def organ(name):
    return {
        "sphere": lambda: seed_sphere(),
        "icosphere": lambda: icosphere(2.0, 2),
        "torus": lambda: torus(1.5, 0.5, 24, 12),
        "box": lambda: box_surface((2.0, 1.5, 1.0), 0.3),
    }[name]()


@cache
def tool(name):
    if name == "plate":
        return Tool.box((1.0, 0.8, 0.125), 5)
    if name == "plate, all faces":
        return Tool.box((1.0, 1.0, 0.125), 5, "all")
    if name == "block, all faces":
        return Tool.box((0.9, 0.7, 0.8), 4, "all")
    generator = np.random.default_rng(int(name[-1]))
    return Tool.convex(generator.normal(size=(9, 3)) * [0.6, 0.5, 0.3], 0.25)


def deform(surface, generator, dent):
    """Random smooth dents and bulges, so that a surface is neither convex nor symmetric, turned at random."""
    vertices = surface.vertices @ rotation_matrix(random_rotation(generator)).T
    size = np.ptp(vertices, axis=0).max()
    for _ in range(4):
        centre = vertices[generator.integers(len(vertices))]
        near = np.exp(-((vertices - centre) ** 2).sum(axis=1) / (0.2 * size) ** 2)
        vertices = vertices + near[:, None] * generator.normal(size=3) * dent * size
    return vertices + generator.normal(size=3)


def random_pose(generator, vertices):
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    position = generator.uniform(low, high)
    if generator.random() < 0.5:
        # At the surface, where some nodes are inside and some outside.
        position = vertices[generator.integers(len(vertices))] + 0.2 * generator.normal(size=3)
    return position, random_rotation(generator)


def assert_same(contacts, expected):
    np.testing.assert_array_equal(contacts.flags, expected.flags)
    np.testing.assert_array_equal(contacts.unfeasible, expected.unfeasible)
    np.testing.assert_array_equal(contacts.triangle, expected.triangle)
    np.testing.assert_allclose(contacts.barycentric, expected.barycentric, rtol=0.0, atol=TOLERANCE)
    np.testing.assert_allclose(contacts.depth, expected.depth, rtol=0.0, atol=TOLERANCE)
    np.testing.assert_allclose(contacts.normal, expected.normal, rtol=0.0, atol=TOLERANCE)
    np.testing.assert_allclose(contacts.points, expected.points, rtol=0.0, atol=TOLERANCE)


@settings(deadline=None, max_examples=150)
@given(seeds, organ_names, tool_names, first_steps, st.booleans(), st.sampled_from([0.0, 0.1, 0.4]))
def test_one_query_from_any_flags(seed, organ_name, tool_name, first_step, exclusive, dent):
    generator = np.random.default_rng(seed)
    surface, probe = organ(organ_name), tool(tool_name)
    vertices = deform(surface, generator, dent)
    detector = FlaggedDetector(probe, first_step, exclusive=exclusive)
    reference = ReferenceDetector(probe, first_step, exclusive)
    flags = generator.random(len(probe.nodes)) < generator.choice([0.0, 0.3, 1.0])
    detector.flags, reference.flags = flags, flags.tolist()
    pose = random_pose(generator, vertices)
    motion = generator.normal(size=3), generator.normal(size=3)
    contacts = detector.detect(*pose, vertices, surface.triangles, *motion)
    assert_same(contacts, reference.detect(*pose, vertices, surface.triangles, *motion))
    np.testing.assert_array_equal(detector.flags, contacts.flags)


@settings(deadline=None, max_examples=40)
@given(seeds, organ_names, tool_names, first_steps)
def test_a_walk_with_memory(seed, organ_name, tool_name, first_step):
    generator = np.random.default_rng(seed)
    surface, probe = organ(organ_name), tool(tool_name)
    vertices = deform(surface, generator, 0.1)
    detector, reference = FlaggedDetector(probe, first_step), ReferenceDetector(probe, first_step)
    position, orientation = random_pose(generator, vertices)
    for _ in range(6):
        shift, spin = generator.normal(size=3) * 0.2, generator.normal(size=3)
        position = position + shift
        orientation = orientation + generator.normal(size=4) * 0.05
        orientation /= np.linalg.norm(orientation)
        vertices = vertices + generator.normal(size=vertices.shape) * 0.01
        query = (position, orientation, vertices, surface.triangles, shift, spin)
        assert_same(detector.detect(*query), reference.detect(*query))


@settings(deadline=None, max_examples=50)
@given(seeds, st.integers(1, 60), tool_names, first_steps, st.booleans())
def test_triangles_in_the_air(seed, count, tool_name, first_step, exclusive):
    # No closed surface at all: rays may enter twice, or leave without having entered.
    generator = np.random.default_rng(seed)
    probe = tool(tool_name)
    vertices = generator.normal(size=(3 * count, 3))
    triangles = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    detector = FlaggedDetector(probe, first_step, exclusive=exclusive)
    reference = ReferenceDetector(probe, first_step, exclusive)
    for _ in range(2):
        query = (*random_pose(generator, vertices), vertices, triangles, generator.normal(size=3))
        contacts = detector.detect(*query)
        assert_same(contacts, reference.detect(*query))
        # What "exclusive" promises, on any surface whatever.
        assert not exclusive or first_step == "off" or not (contacts.flags & contacts.flags[probe.opposite]).any()


@pytest.mark.parametrize("first_step", ["inside", "any_hit", "off"])
def test_the_comparison_sees_contacts_of_all_kinds(first_step):
    # The comparisons above are meaningful only if random poses often lead to contact.
    generator = np.random.default_rng(1)
    surface, probe = organ("sphere"), tool("plate")
    seen = np.zeros(3)
    for _ in range(60):
        vertices = deform(surface, generator, 0.1)
        detector = FlaggedDetector(probe, first_step)
        contacts = detector.detect(
            *random_pose(generator, vertices), vertices, surface.triangles, generator.normal(size=3)
        )
        seen += contacts.flags.sum(), contacts.unfeasible.sum(), (~contacts.flags & ~contacts.unfeasible).sum()
    assert seen[0] > 200
    assert seen[2] > 200
    assert (seen[1] > 200) == (first_step != "off")


@pytest.mark.parametrize("axis", range(3))
def test_the_plain_ray_cast_against_a_box(axis):
    # The reference needs a reference: a box's walls are where they are.
    size = np.array([2.0, 1.5, 1.0])
    surface = Surface(*(lambda box: (box.vertices, box.triangles))(box_surface(size, 0.3)))
    start, direction = np.array([0.111, 0.222, 0.0333]), np.zeros(3)
    direction[axis] = -2.0
    index, distance, weights = surface.cast(start, direction)
    assert distance == pytest.approx((start[axis] + size[axis] / 2.0) / 2.0, abs=1e-12)
    assert surface.normals[index][axis] == pytest.approx(-1.0)
    corners = box_surface(size, 0.3).vertices[box_surface(size, 0.3).triangles[index]]
    np.testing.assert_allclose(weights @ corners, start + distance * direction, atol=1e-12)
    assert surface.cast(start + 5.0 * direction, direction)[0] == -1
