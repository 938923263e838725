from __future__ import annotations

import builtins
import re
from pathlib import Path

import numpy as np
import pytest

from spatula_env.geometry import box_surface, load_organ, seed_sphere, torus
from spatula_env.installing import install_hint

trimesh = pytest.importorskip("trimesh")

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
FACES = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
PLY_HEADER = (
    "ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
)


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def obj_text(organ) -> str:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in organ.vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in organ.triangles.tolist()]
    return "\n".join(lines) + "\n"


def test_obj_comes_through_unchanged(tmp_path):
    organ = seed_sphere()
    loaded = load_organ(write(tmp_path, "liver.obj", obj_text(organ)))
    np.testing.assert_array_equal(loaded.vertices, organ.vertices)
    np.testing.assert_array_equal(loaded.triangles, organ.triangles)
    assert loaded.name == "liver.obj"


def test_ply_comes_through_unchanged(tmp_path):
    organ = torus()
    path = tmp_path / "ring.PLY"
    trimesh.Trimesh(organ.vertices, organ.triangles, process=False).export(path, file_type="ply")
    loaded = load_organ(str(path), name="ring")
    np.testing.assert_array_equal(loaded.vertices, organ.vertices.astype(np.float32))
    np.testing.assert_array_equal(loaded.triangles, organ.triangles)
    assert loaded.name == "ring"


@pytest.mark.parametrize("file_type", ["stl", "stl_ascii"])
def test_stl_vertices_are_joined(tmp_path, file_type):
    organ = box_surface((1.0, 2.0, 0.3), 0.3)
    path = tmp_path / "box.stl"
    trimesh.Trimesh(organ.vertices, organ.triangles, process=False).export(path, file_type=file_type)
    loaded = load_organ(path)
    assert len(loaded.vertices) == len(organ.vertices)
    # Triangle by triangle the same corners; the vertices are numbered as they first appear.
    np.testing.assert_allclose(loaded.vertices[loaded.triangles], organ.vertices[organ.triangles], rtol=1e-6, atol=1e-7)
    assert (np.diff(np.unique(loaded.triangles.ravel(), return_index=True)[1]) > 0).all()


def test_scale(tmp_path):
    path = write(tmp_path, "liver.obj", TETRAHEDRON + FACES)
    assert load_organ(path, scale=0.05).volume == pytest.approx(0.05**3 / 6.0)
    with pytest.raises(ValueError, match=r"0.001 to 1000 u across"):
        load_organ(path, scale=1e4)


def test_texture_seams_and_normals_do_not_split_vertices(tmp_path):
    extra = "vt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\nvn 1 0 0\n"
    faces = "f 1/1/1 3/2/1 2/3/1\nf 1/2/2 2/3/2 4/1/2\nf 2/1/1 3/2/1 4/3/1\nf 1/1/2 4/3/2 3/2/2\n"
    organ = load_organ(write(tmp_path, "liver.obj", TETRAHEDRON + extra + faces))
    assert organ.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert organ.triangles.tolist() == [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_quads_are_divided(tmp_path, suffix):
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    if suffix == "obj":
        text = "".join(f"v {x} {y} {z}\n" for x, y, z in corners)
        text += "".join("f " + " ".join(str(k + 1) for k in quad) + "\n" for quad in quads)
    else:
        text = PLY_HEADER.format(vertices=8, faces=6) + "".join(f"{x} {y} {z}\n" for x, y, z in corners)
        text += "".join("4 " + " ".join(map(str, quad)) + "\n" for quad in quads)
    organ = load_organ(write(tmp_path, f"cube.{suffix}", text))
    assert organ.vertices.tolist() == [list(map(float, corner)) for corner in corners]
    assert len(organ.triangles) == 12
    assert organ.volume == pytest.approx(1.0)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"liver\.obj"):
        load_organ(tmp_path / "liver.obj")
    with pytest.raises(FileNotFoundError):
        load_organ(tmp_path)


@pytest.mark.parametrize("name", ["liver.gltf", "liver"])
def test_unknown_suffix(tmp_path, name):
    with pytest.raises(ValueError, match=r"must be one of \.obj, \.stl, \.ply, \.npz, got"):
        load_organ(write(tmp_path, name, TETRAHEDRON + FACES))


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan])
def test_scale_is_checked(tmp_path, scale):
    with pytest.raises(ValueError, match="scale must be positive"):
        load_organ(write(tmp_path, "liver.obj", TETRAHEDRON + FACES), scale=scale)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("empty.obj", "", "empty.obj holds no geometry"),
        ("words.obj", "hello world\n", "holds no geometry"),
        ("empty.stl", "", "holds no geometry"),
        ("words.stl", "hello", "holds no geometry"),
        ("empty.ply", "", "cannot be read as PLY"),
        ("words.ply", "hello", "cannot be read as PLY"),
        ("cut.ply", PLY_HEADER.format(vertices=4, faces=4) + "0 0 0\n", "holds no triangles"),
        ("range.obj", TETRAHEDRON + FACES.replace("f 1 3 2", "f 1 3 9"), "cannot be read as OBJ|outside"),
        ("cloud.obj", TETRAHEDRON, "no triangles, only points or lines"),
        (
            "cloud.ply",
            PLY_HEADER.format(vertices=2, faces=0) + "0 0 0\n1 0 0\n",
            "no triangles, only points or lines",
        ),
        (
            "materials.obj",
            TETRAHEDRON + "usemtl a\nf 1 3 2\nf 1 2 4\nusemtl b\nf 2 3 4\nf 1 4 3\n",
            "holds 2 geometries .*, one is allowed; join them",
        ),
        ("nan.obj", TETRAHEDRON.replace("v 1 0 0", "v nan 0 0") + FACES, "1 vertex of 4 not finite"),
        (
            "loose.obj",
            "v 9 9 9\n" + TETRAHEDRON + "f 2 4 3\nf 2 3 5\nf 3 4 5\nf 2 5 4\n",
            "1 vertex of no triangle",
        ),
        ("twice.obj", TETRAHEDRON + "v 0 0 1\n" + FACES.replace("1 4 3", "1 5 3"), "1 duplicate vertex"),
        ("open.obj", TETRAHEDRON + "f 1 3 2\nf 1 2 4\nf 2 3 4\n", "at least 4 triangles"),
        (
            "out.obj",
            TETRAHEDRON + "f 2 3 1\nf 4 2 1\nf 4 3 2\nf 3 4 1\n",
            "inside-out: signed volume -0.166667",
        ),
    ],
)
def test_files_without_a_valid_surface(tmp_path, name, text, message):
    with pytest.raises(ValueError, match=message):
        load_organ(write(tmp_path, name, text))


def test_stl_with_two_solids(tmp_path):
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    text = f"solid a\n{facet}endsolid a\nsolid b\n{facet}endsolid b\n"
    with pytest.raises(ValueError, match=r"holds 2 geometries \(a, b\)"):
        load_organ(write(tmp_path, "two.stl", text))


def test_stl_with_a_hole(tmp_path):
    organ = box_surface()
    path = tmp_path / "open.stl"
    trimesh.Trimesh(organ.vertices, organ.triangles[1:], process=False).export(path)
    with pytest.raises(ValueError, match=r"'open.stl' is open: 3 boundary edges"):
        load_organ(path)


def test_without_trimesh_the_error_says_what_to_install(tmp_path, monkeypatch):
    original = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name == "trimesh":
            raise ImportError(name)
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(ImportError, match=re.escape(install_hint("mesh"))):
        load_organ(write(tmp_path, "liver.obj", TETRAHEDRON + FACES))
