from __future__ import annotations

import numpy as np
import pytest

from spatula_env.render import MATTE, Background, GroundPlane, Lighting, Material, Mesh

VERTICES = np.eye(3)
TRIANGLES = np.array([[0, 1, 2]])


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("vertices", {"vertices": np.zeros((3, 2))}),
        ("vertices", {"vertices": np.full((3, 3), np.inf)}),
        ("triangles", {"triangles": np.array([[0, 1, 3]])}),
        ("triangles", {"triangles": np.array([[0, 1, -1]])}),
        ("triangles", {"triangles": np.array([[0.0, 1.0, 2.0]])}),
        ("triangles", {"triangles": np.array([0, 1, 2])}),
        ("color", {"color": (0, 0, 1.5)}),
        ("vertex_colors", {"vertex_colors": np.zeros((2, 3))}),
        ("vertex_colors", {"vertex_colors": np.full((3, 3), np.nan)}),
        ("opacity", {"opacity": 1.1}),
        ("back_color", {"back_color": (0, 0)}),
        ("clip_plane", {"clip_plane": ((0, 0, 0), (0, 0, 0))}),
        ("clip_plane", {"clip_plane": ((0, 0, 0),)}),
        ("capped", {"capped": True}),
        ("capped", {"capped": True, "opacity": 0.5, "clip_plane": ((0, 0, 0), (0, 0, 1))}),
        ("rind", {"rind": 0.1}),
        ("texture", {"texture": np.zeros((2, 3))}),
        ("refine", {"refine": 3}),
        ("refine", {"refine": 1, "smooth": False}),
    ],
)
def test_bad_meshes(name, options):
    with pytest.raises(ValueError, match=name):
        Mesh(**{"vertices": VERTICES, "triangles": TRIANGLES, **options})


def test_moved_keeps_all_but_the_vertices():
    mesh = Mesh(VERTICES, TRIANGLES, color=(0.1, 0.2, 0.3), opacity=0.5, clip_plane=((0, 0, 1), (0, 0, 2)))
    moved = mesh.moved(VERTICES + 1.0)
    np.testing.assert_array_equal(moved.vertices, VERTICES + 1.0)
    assert (moved.color, moved.opacity, moved.clip_plane) == (mesh.color, 0.5, ((0, 0, 1), (0, 0, 1)))
    with pytest.raises(ValueError, match="triangles"):
        mesh.moved(VERTICES[:2])


@pytest.mark.parametrize(
    ("make", "name", "value"),
    [
        (Material, "specular", 1.5),
        (Material, "shininess", 0.5),
        (Material, "mottle", -0.1),
        (GroundPlane, "style", "wood"),
        (GroundPlane, "height", np.nan),
        (GroundPlane, "tile", 0.0),
        (GroundPlane, "fade_end", 1.0),
        (GroundPlane, "shadow", 2.0),
        (GroundPlane, "color", (0, 0, 2)),
        (GroundPlane, "center", (0.0, np.inf)),
        (Background, "top", (0, 0)),
        (Lighting, "key_direction", (0.0, 0.0, -1.0)),
        (Lighting, "key_direction", (0.0, 0.0, 0.0)),
        (Lighting, "key", -1.0),
        (Lighting, "shadow", 1.5),
    ],
)
def test_bad_settings(make, name, value):
    with pytest.raises(ValueError, match=name):
        make(**{name: value})


def test_settings_are_values():
    assert GroundPlane(center=np.array([1.0, 2.0])) == GroundPlane(center=(1, 2))
    assert Lighting(key_direction=(0, 0, 5)).key_direction == (0, 0, 1)
    assert Material() == MATTE
