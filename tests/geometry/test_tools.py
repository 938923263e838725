from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spatula_env.geometry import Tool
from spatula_env.geometry.surface import check_surface, signed_volume

lengths = st.floats(0.01, 3.0)
sizes = st.tuples(lengths, lengths, lengths)
which = st.sampled_from(["largest", "all"])


def test_default_box_is_the_tool_of_the_seed():
    tool = Tool.box()
    assert tool.nodes.shape == tool.normals.shape == (72, 3)
    assert tool.face_normals.tolist() == [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]
    assert [len(tool.face_nodes(face)) for face in range(2)] == [36, 36]
    assert tool.thickness == 0.125
    assert tool.size.tolist() == [1.0, 1.0, 0.125]
    assert tool.bounding_radius == pytest.approx(np.sqrt(0.25 + 0.25 + 0.0625**2))
    lattice = np.linspace(-0.5, 0.5, 6)
    for face, height in ((0, -0.0625), (1, 0.0625)):
        nodes = tool.nodes[tool.face_nodes(face)]
        assert (nodes[:, 2] == height).all()
        np.testing.assert_allclose(np.unique(nodes[:, 0].round(12)), lattice, atol=1e-12)
        np.testing.assert_allclose(np.unique(nodes[:, 1].round(12)), lattice, atol=1e-12)
    assert tool.opposite.tolist() == [*range(36, 72), *range(36)]
    np.testing.assert_array_equal(tool.nodes[tool.opposite], tool.nodes * [1.0, 1.0, -1.0])


def test_shares_of_the_area_are_trapezoidal():
    tool = Tool.box()
    edge = (np.abs(np.abs(tool.nodes[:, :2]) - 0.5) < 1e-12).sum(axis=1)
    np.testing.assert_allclose(tool.areas, 0.04 * 0.5**edge)
    assert np.bincount(edge).tolist() == [32, 32, 8]


@settings(deadline=None)
@given(sizes, st.integers(2, 8), which)
def test_box_nodes(size, nodes_per_edge, faces):
    tool = Tool.box(size, nodes_per_edge, faces)
    half = 0.5 * np.array(size)
    assert len(tool.face_normals) == (2 if faces == "largest" else 6)
    # Every node is on its face: at the face's height along the normal, and within the box.
    np.testing.assert_allclose(np.einsum("ij,ij->i", tool.nodes, tool.normals), np.abs(tool.normals) @ half, rtol=1e-12)
    assert (np.abs(tool.nodes) <= half * (1.0 + 1e-12)).all()
    assert (np.abs(tool.normals).sum(axis=1) == 1.0).all()
    # Opposites are mutual, across the box, and look the other way.
    index = np.arange(len(tool.nodes))
    np.testing.assert_array_equal(tool.opposite[tool.opposite], index)
    np.testing.assert_array_equal(tool.normals[tool.opposite], -tool.normals)
    width = np.abs(tool.normals) @ np.array(size)
    np.testing.assert_allclose(
        tool.nodes[tool.opposite], tool.nodes - width[:, None] * tool.normals, rtol=0.0, atol=1e-12
    )
    # The shares of a face add up to its area.
    for face, normal in enumerate(tool.face_normals):
        area = np.prod(np.where(normal == 0.0, size, 1.0))
        assert tool.areas[tool.face_nodes(face)].sum() == pytest.approx(area)
        assert (tool.normals[tool.face_nodes(face)] == normal).all()
    assert (np.diff(tool.face) >= 0).all()
    assert tool.thickness == pytest.approx(min(size))


@settings(deadline=None)
@given(sizes, st.integers(2, 6))
def test_side_nodes_stay_clear_of_the_rim(size, nodes_per_edge):
    tool = Tool.box(size, nodes_per_edge, "all")
    half = 0.5 * np.array(size)
    side = tool.face >= 2
    on_planes = (np.abs(np.abs(tool.nodes[side]) - half) < 1e-9).sum(axis=1)
    assert (on_planes == 1).all()
    apart = np.linalg.norm(tool.nodes[:, None] - tool.nodes, axis=2)
    assert apart[~np.eye(len(apart), dtype=bool)].min() > 1e-6


@settings(deadline=None)
@given(sizes, st.floats(0.1, 2.0))
def test_node_spacing_is_the_coarsest_that_fits(size, spacing):
    tool = Tool.box(size, node_spacing=spacing, nodes_per_edge=-1)
    nodes = tool.nodes[tool.face_nodes(0)]
    for axis in np.flatnonzero(tool.face_normals[0] == 0.0):
        steps = np.diff(np.unique(nodes[:, axis].round(12)))
        steps = steps[steps > 1e-9]
        assert steps.max() <= spacing * (1.0 + 2e-6)
        assert len(steps) == 1 or size[axis] / (len(steps) - 1) > spacing


def test_node_spacing_that_divides_the_edge_exactly():
    assert len(Tool.box(node_spacing=0.2).nodes) == 72


@pytest.mark.parametrize(
    ("size", "axis"),
    [
        ((1.0, 1.0, 1.0), 2),
        ((0.1, 1.0, 1.0), 0),
        ((1.0, 0.1, 1.0), 1),
        ((0.1, 0.1, 1.0), 1),
        ((0.1, 1.0, 0.1), 2),
        ((1.0, 0.1, 0.1), 2),
    ],
)
def test_which_faces_are_the_largest(size, axis):
    tool = Tool.box(size)
    np.testing.assert_array_equal(tool.face_normals, [-np.eye(3)[axis], np.eye(3)[axis]])


def test_order_of_all_faces():
    expected = [[0, -1, 0], [0, 1, 0], [-1, 0, 0], [1, 0, 0], [0, 0, -1], [0, 0, 1]]
    assert Tool.box((2.0, 0.1, 1.0), faces="all").face_normals.tolist() == expected


def test_side_faces_of_the_default_box():
    tool = Tool.box(faces="all")
    assert [len(tool.face_nodes(face)) for face in range(6)] == [36, 36, 5, 5, 5, 5]
    np.testing.assert_allclose(
        np.unique(tool.nodes[tool.face_nodes(2), 1].round(12)), [-0.4, -0.2, 0.0, 0.2, 0.4], atol=1e-12
    )
    assert len(Tool.box((1.0, 1.0, 0.5), faces="all").face_nodes(2)) == 15  # three rows


@settings(deadline=None)
@given(sizes)
def test_surface_of_a_box(size):
    tool = Tool.box(size)
    assert tool.vertices.shape == (8, 3)
    assert tool.triangles.shape == (12, 3)
    check_surface(tool.vertices, tool.triangles, smallest=0.0)
    assert signed_volume(tool.vertices, tool.triangles) == pytest.approx(np.prod(size))


@settings(deadline=None)
@given(sizes, st.integers(0, 2**32 - 1))
def test_box_contains(size, seed):
    points = np.random.default_rng(seed).uniform(-2.0, 2.0, size=(200, 3))
    expected = (np.abs(points) < 0.5 * np.array(size)).all(axis=1)
    np.testing.assert_array_equal(Tool.box(size).contains(points), expected)


def test_surface_is_not_inside():
    tool = Tool.box()
    assert not tool.contains(tool.nodes).any()
    assert not tool.contains(tool.vertices).any()
    assert tool.contains([[0.0, 0.0, 0.0], [0.49, 0.49, 0.062], [0.0, 0.0, 0.063]]).tolist() == [
        True,
        True,
        False,
    ]


def test_face_nodes_checks_the_face():
    with pytest.raises(ValueError, match="face must be from 0 to 1, got 2"):
        Tool.box().face_nodes(2)


def test_tool_cannot_be_written_to():
    tool = Tool.box()
    for entry in dataclasses.fields(tool):
        if entry.name != "name":
            with pytest.raises(ValueError, match="read-only"):
                getattr(tool, entry.name)[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        tool.size[0] = 2.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        tool.name = "other"


def test_types_of_the_arrays():
    tool = Tool.box(faces="all")
    for key in ("nodes", "normals", "face_normals", "areas", "vertices", "size"):
        assert getattr(tool, key).dtype == np.float64
    for key in ("opposite", "face", "triangles"):
        assert getattr(tool, key).dtype == np.int32


def test_tools_are_equal_by_value():
    assert Tool.box() == Tool.box()
    assert len({Tool.box(), Tool.box(), Tool.box(nodes_per_edge=5)}) == 2
    assert Tool.box() != dataclasses.replace(Tool.box(), name="other")
    assert Tool.box() != "box"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"size": (1.0, 1.0)}, r"size must have shape \(3,\)"),
        ({"size": (1.0, 1.0, 0.0)}, r"size\[2\] must be positive and finite, got 0.0"),
        ({"size": (1.0, -1.0, 1.0)}, r"size\[1\] must be positive"),
        ({"size": (1.0, np.inf, 1.0)}, "size must be finite"),
        ({"nodes_per_edge": 1}, "nodes_per_edge must be an integer of at least 2, got 1"),
        ({"nodes_per_edge": 6.0}, "nodes_per_edge must be an integer of at least 2, got 6.0"),
        ({"nodes_per_edge": True}, "nodes_per_edge must be an integer"),
        ({"faces": "biggest"}, "faces must be one of 'largest', 'all', got 'biggest'"),
        ({"node_spacing": 0.0}, "node_spacing must be positive"),
        ({"node_spacing": np.nan}, "node_spacing must be positive"),
        ({"node_spacing": 1e-4}, r"at most 100000 nodes, this lattice has about 2e\+08"),
        ({"nodes_per_edge": 10**6}, r"at most 100000 nodes, this lattice has about 2e\+12"),
    ],
)
def test_impossible_boxes_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Tool.box(**arguments)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nodes": np.zeros((72, 2))}, r"nodes must have shape \(72, 3\), got \(72, 2\)"),
        ({"nodes": np.full((72, 3), np.nan)}, "nodes must be finite"),
        ({"normals": np.zeros((71, 3))}, "normals must have shape"),
        ({"opposite": np.arange(72)}, "72 of 72 nodes are not their opposite's opposite, first node 0"),
        ({"opposite": np.roll(np.arange(72), 1)}, "opposite's opposite"),
        ({"opposite": np.arange(72) + 1}, "opposite must name nodes from 0 to 71"),
        ({"face": np.full(72, 2)}, "face must be from 0 to 1"),
        ({"face": np.zeros(72, dtype=int)}, "normals must be those of the nodes' faces"),
        ({"face_normals": [[0.0, 0.0, -2.0], [0.0, 0.0, 2.0]]}, "face_normals must be of unit length"),
        ({"areas": np.zeros(72)}, "areas must be positive"),
        ({"triangles": Tool.box().triangles[1:]}, "surface 'box' is open: 3 boundary edges"),
    ],
)
def test_parts_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(Tool.box(), **changes)
