"""Organs from surfaces and volumes with defects that are made here; nothing is downloaded."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spatula_env import Simulation, scenes
from spatula_env.geometry import Organ, PreparedOrgan, box_surface, icosphere, load_organ, torus
from spatula_env.geometry.crossings import self_crossings
from spatula_env.geometry.surface import check_surface, triangle_areas

LIBRARIES = ("fast_simplification", "matplotlib", "nibabel", "nrrd", "scipy", "skimage", "trimesh")
MISSING = [name for name in LIBRARIES if importlib.util.find_spec(name) is None]
pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"the extra anatomy is not installed: {', '.join(MISSING)}")

if not MISSING:
    import trimesh

    from spatula_env.anatomy import PrepareOptions, prepare_organ, reducing
    from spatula_env.anatomy.holes import fill_holes
    from spatula_env.anatomy.posing import held_nodes, posed
    from spatula_env.anatomy.reducing import _without_flaps
    from spatula_env.anatomy.remeshing import EditableMesh, remesh
    from spatula_env.anatomy.topology import (
        Surface,
        angles,
        count_edges,
        drop_degenerate,
        is_manifold,
        orient,
        weld,
    )
    from spatula_env.anatomy.volumes import restored

NODES = 120


def ellipsoid(subdivisions: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """An ellipsoid of 80 x 60 x 50 mm."""
    ball = icosphere(1.0, subdivisions)
    return ball.vertices * [40.0, 30.0, 25.0], ball.triangles.astype(np.int64)


def write(path: Path, vertices: np.ndarray, triangles: np.ndarray) -> Path:
    trimesh.Trimesh(vertices, triangles, process=False).export(path)
    return path


def prepare(path: Path, **options: object) -> tuple[PreparedOrgan, str]:
    """The organ, and what was changed."""
    wanted = {"units": "mm", "nodes": NODES, "fill": "no", **options}
    organ, report, _ = prepare_organ(path, PrepareOptions(**wanted))
    return organ, "; ".join(report.changes)


def check(organ: Organ, nodes: int = NODES) -> None:
    check_surface(organ.vertices, organ.triangles)
    assert len(organ.vertices) == nodes
    assert len(self_crossings(organ.vertices, organ.triangles)) == 0
    assert angles(organ.vertices, organ.triangles).min() > 15.0


def test_inverted_winding_and_vertices_of_an_stl_are_put_right(tmp_path: Path) -> None:
    vertices, triangles = ellipsoid()
    some = triangles.copy()
    some[::3] = some[::3, ::-1]
    organ, changes = prepare(write(tmp_path / "liver.stl", vertices, some))
    check(organ)
    assert "welded" in changes
    assert "turned, so that all face outwards" in changes
    assert organ.volume * 8.0 == pytest.approx(Organ(*ellipsoid()).volume * 1e-3, rel=1e-3)


def test_slivers_vanish(tmp_path: Path) -> None:
    vertices, triangles = ellipsoid()
    mesh = EditableMesh(vertices, triangles)
    for a, b in mesh.edges()[::40]:
        middle = mesh.split(a, b)
        mesh.points[middle] = tuple(0.999 * np.array(mesh.points[a]) + 0.001 * np.array(mesh.points[middle]))
    surface = Surface(*mesh.arrays())
    assert angles(surface.vertices, surface.triangles).min() < 0.5
    organ, _ = prepare(write(tmp_path / "liver.ply", surface.vertices, surface.triangles))
    check(organ)


def test_holes_are_filled_and_wide_ones_refused_with_their_place(tmp_path: Path) -> None:
    vertices, triangles = ellipsoid()
    middles = vertices[triangles].mean(axis=1)
    small = write(tmp_path / "small.ply", vertices, triangles[middles[:, 0] < 39.0])
    organ, changes = prepare(small, widest_hole=0.25)
    check(organ)
    assert "1 hole filled: 1 hole, " in changes
    wide = write(tmp_path / "wide.ply", vertices, triangles[middles[:, 0] < 25.0])
    with pytest.raises(ValueError, match=r"wide.ply is open: 1 hole, .* mm wide \(\d+ edges\) at \(2\d"):
        prepare(wide)


def test_places_have_no_digits_of_rounding(tmp_path: Path) -> None:
    vertices, triangles = ellipsoid()
    upper = triangles[vertices[triangles].mean(axis=1)[:, 2] > 0.0]
    number = r"(0|-?\d+\.?\d*)"
    with pytest.raises(ValueError, match=rf"edges\) at \({number}, {number}, {number}\) mm;"):
        prepare(write(tmp_path / "bowl.ply", vertices, upper))


def test_edges_of_more_than_two_triangles_are_mended(tmp_path: Path) -> None:
    vertices, triangles = ellipsoid()
    fin = np.concatenate([triangles, [[*triangles[0, :2], triangles[600, 0]]]])
    organ, changes = prepare(write(tmp_path / "fin.ply", vertices, fin))
    check(organ)
    assert "edges in more than two triangles, the first at (" in changes
    assert organ.volume * 8.0 == pytest.approx(4.0 / 3.0 * np.pi * 30.0, rel=0.1)


def test_islands_and_cavities(tmp_path: Path) -> None:
    vertices, triangles = ellipsoid()
    ball = icosphere(1.0, 1)
    count = len(ball.vertices)
    parts = [vertices, 5.0 * ball.vertices, 4.0 * ball.vertices + [70.0, 0.0, 0.0]]
    faces = [
        triangles,
        ball.triangles[:, ::-1] + len(vertices),
        ball.triangles + len(vertices) + count,
    ]
    path = write(tmp_path / "pieces.ply", np.concatenate(parts), np.concatenate(faces))
    organ, changes = prepare(path)
    check(organ)
    assert "1 island removed" in changes
    assert "1 cavity filled" in changes


def test_a_prepared_organ_is_pressed(tmp_path: Path) -> None:
    organ, _ = prepare(write(tmp_path / "liver.ply", *ellipsoid()), hold=("z<0.015",), nodes=650)
    scene = scenes.seed()
    top = float(organ.bounds[1, 2])
    scene = replace(
        scene,
        organs=(scenes.PlacedOrgan(organ, mass=1.0, fixed_nodes=organ.held),),
        tools=(replace(scene.tools[0], position=(0.0, 0.0, top + 0.3)),),
    )
    simulation = Simulation(scene, engine="batch")
    touched, held = False, list(organ.held)
    for _ in range(60):
        report = simulation.step(linear_velocity=(0.0, 0.0, -3.0))
        touched = touched or bool(report.contacts.flags.any())
        assert report.residual < 2e-3
    assert touched
    assert np.isfinite(simulation.nodes).all()
    assert simulation.nodes[held] == pytest.approx(organ.vertices[held], abs=1e-5)
    simulation.close()


def labels() -> np.ndarray:
    """A volume with an ellipsoid of label 3 with a cavity and an island, and a block of label 5."""
    grid = np.stack(np.meshgrid(*(np.arange(30.0),) * 3, indexing="ij"), axis=-1)
    volume = np.zeros((30, 30, 30), dtype=np.uint8)
    volume[(((grid - 14.0) / [11.0, 9.0, 8.0]) ** 2).sum(axis=-1) < 1.0] = 3
    volume[13:16, 13:16, 13:16] = 0
    volume[1, 1, 1] = 3
    volume[26:29, 26:29, 26:29] = 5
    return volume


def test_a_label_of_a_nifti_volume(tmp_path: Path) -> None:
    import nibabel

    image = nibabel.Nifti1Image(labels(), np.diag([3.0, -3.0, 3.0, 1.0]))
    image.header.set_xyzt_units("mm")
    path = tmp_path / "organs.nii.gz"
    image.to_filename(path)
    organ, changes = prepare(path, units=None, label=3)
    check(organ)
    assert "1 island of voxels removed" in changes
    assert "1 cavity of voxels filled" in changes
    # The voxels, the cavity in them filled; the blur and the chords between so few nodes took 8% of that.
    voxels = (labels() == 3).sum() - 1 + 27
    assert organ.volume * 8.0 == pytest.approx(voxels * 0.3**3, rel=1e-3)
    assert "volume brought back to" in changes
    # The staircases are gone: all nodes lie near the ellipsoid.
    places = (organ.vertices - organ.vertices.mean(axis=0)) * 20.0 / [33.0, 27.0, 24.0]
    assert np.abs(np.linalg.norm(places, axis=1) - 1.0).max() < 0.12
    with pytest.raises(ValueError, match=r"label must be one of those in organs.nii.gz, got 4; there are 3 .*, 5 "):
        prepare(path, units=None, label=4)
    with pytest.raises(ValueError, match=r"label must be given, as organs.nii.gz holds several: 3 "):
        prepare(path, units=None)


def test_a_label_of_an_nrrd_volume_needs_units(tmp_path: Path) -> None:
    import nrrd

    path = tmp_path / "organs.nrrd"
    nrrd.write(str(path), labels(), {"space directions": np.diag([3.0, 3.0, 3.0]), "space origin": [0.0, 0.0, 0.0]})
    with pytest.raises(ValueError, match=r"units must be given, mm or m: organs.nrrd does not say"):
        prepare(path, units=None, label=3)
    organ, _ = prepare(path, label=3)
    check(organ)


@pytest.mark.parametrize(("factor", "units", "told"), [(1.0, "m", r"in mm .* units=mm"), (1e-3, "mm", r"in m .*=m\?")])
def test_a_wrong_unit_is_refused_and_the_right_one_named(tmp_path: Path, factor: float, units: str, told: str) -> None:
    vertices, triangles = ellipsoid(2)
    path = write(tmp_path / "liver.ply", factor * vertices, triangles)
    with pytest.raises(ValueError, match=told):
        prepare(path, units=units)


def test_round_trip(tmp_path: Path) -> None:
    from spatula_env.geometry.prepared import write_prepared

    organ, _ = prepare(write(tmp_path / "liver.ply", *ellipsoid()), hold=("z<0.01",), up="-z")
    path = tmp_path / "liver.npz"
    write_prepared(path, organ)
    loaded = load_organ(path)
    assert isinstance(loaded, PreparedOrgan)
    assert loaded == organ
    assert loaded.held == organ.held
    assert loaded.provenance == organ.provenance
    assert loaded.provenance["source"] == "liver.ply"
    assert loaded.provenance["options"]["hold"] == ["z<0.01"]
    assert loaded.vertices[:, 2].min() == pytest.approx(0.0)
    assert load_organ(path, scale=2.0, name="large").volume == pytest.approx(8.0 * organ.volume)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(ValueError, match=r"liver.npz cannot be read as an organ"):
        load_organ(path)


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_an_organ_is_turned_and_not_mirrored(up: str) -> None:
    frame = posed(np.eye(3), up, "keep")
    assert np.linalg.det(frame) == pytest.approx(1.0)
    axis, sign = "xyz".index(up[-1]), -1.0 if up.startswith("-") else 1.0
    assert frame[axis].tolist() == [0.0, 0.0, sign]


def test_what_is_held() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.1, 0.0, 0.1]])
    options = PrepareOptions(hold=("z>0.05,x<0.05",), hold_nodes=(0,))
    assert held_nodes(points, options) == (0, 1)
    assert held_nodes(points, PrepareOptions(hold_boxes=((0.05, -1.0, 0.0, 0.2, 1.0, 1.0),))) == (2,)
    with pytest.raises(ValueError, match=r"'z>1' has none: the organ spans"):
        held_nodes(points, replace(options, hold=("z>1",)))
    with pytest.raises(ValueError, match=r'hold must be like "z<0.01"'):
        PrepareOptions(hold=("down",))


def test_vertices_are_welded_and_what_is_degenerate_removed() -> None:
    box = box_surface((1.0, 1.0, 1.0), 0.5)
    apart = Surface(box.vertices[box.triangles].reshape(-1, 3), np.arange(3 * len(box.triangles)).reshape(-1, 3))
    welded, count = weld(apart)
    assert len(welded.vertices) == len(box.vertices)
    assert count == len(apart.vertices) - len(box.vertices)
    more = np.concatenate([welded.triangles, welded.triangles[:2], [[0, 1, 1]]])
    assert drop_degenerate(Surface(welded.vertices, more))[1] == 3
    assert is_manifold(welded)


def test_a_strip_with_one_side_is_found() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 13)[:-1]
    turn = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(12)])
    half = np.column_stack([np.cos(angle / 2) * np.cos(angle), np.cos(angle / 2) * np.sin(angle), np.sin(angle / 2)])
    vertices = np.concatenate([turn - 0.3 * half, turn + 0.3 * half])
    triangles = []
    for k in range(12):
        a, b = k, k + 12
        c, d = (k + 1, k + 13) if k < 11 else (12, 0)
        triangles += [(a, c, b), (c, d, b)]
    assert not orient(Surface(vertices, np.array(triangles)))[2]


def test_a_hole_is_filled_with_the_least_area() -> None:
    box = box_surface((1.0, 1.0, 1.0), 0.25)
    middles = box.vertices[box.triangles].mean(axis=1)
    opened = Surface(
        box.vertices, box.triangles[~((middles[:, 2] > 0.49) & (np.abs(middles[:, :2]) < 0.25).all(axis=1))]
    )
    filled, holes, left = fill_holes(opened.kept(np.ones(len(opened.triangles), dtype=np.bool_)), 1.0)
    assert (len(holes), left) == (1, [])
    assert (count_edges(filled.triangles)[1] == 2).all()
    assert triangle_areas(filled.vertices, filled.triangles).sum() == pytest.approx(6.0)
    assert filled.volumes.sum() == pytest.approx(1.0)


def test_remeshing_keeps_a_ring_a_ring() -> None:
    ring = torus(0.05, 0.02, 24, 12)
    surface = Surface(ring.vertices, ring.triangles.astype(np.int64))
    even = remesh(surface, surface, 150)
    assert len(even.vertices) - len(count_edges(even.triangles)[0]) + len(even.triangles) == 0
    assert len(even.vertices) == 150
    assert angles(even.vertices, even.triangles).min() > 20.0
    assert len(self_crossings(even.vertices, even.triangles)) == 0


def test_flaps_of_a_decimation_are_removed() -> None:
    ball = icosphere(1.0, 2)
    flap = np.array([[0, 1, 2], [2, 1, 0]])
    surface = Surface(ball.vertices, np.concatenate([ball.triangles, flap]).astype(np.int64))
    assert not is_manifold(surface)
    assert is_manifold(_without_flaps(surface))


def test_a_fine_surface_without_a_decimation_is_wrapped(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It would take minutes to remesh it as it is."""
    path = write(tmp_path / "organ.ply", *ellipsoid(4))
    decimated = reducing._decimated_manifold
    monkeypatch.setattr(
        reducing, "_decimated_manifold", lambda s, nodes: s if len(s.vertices) == 2562 else decimated(s, nodes)
    )
    monkeypatch.setattr(reducing, "MOST_REMESHED", 2_000)
    organ, report, _ = prepare_organ(path, PrepareOptions(units="mm", nodes=NODES, fill="no"))
    assert report.steps[0].name == "remeshed (wrapped)"
    check(organ)
    monkeypatch.setattr(reducing, "MOST_REMESHED", 100)
    with pytest.raises(ValueError, match="no decimation of it is a manifold"):
        prepare_organ(path, PrepareOptions(units="mm", nodes=NODES, fill="no"))


def test_volume_is_restored_only_by_a_small_offset() -> None:
    ball = icosphere(1.0, 2)
    surface = Surface(ball.vertices, ball.triangles.astype(np.int64))
    volume = float(surface.volumes.sum())
    moved = restored(surface, 1.05 * volume)
    assert moved is not None
    assert moved.volumes.sum() == pytest.approx(1.05 * volume, rel=1e-3)
    assert restored(surface, 2.0 * volume) is None
    assert restored(surface, 0.8 * volume) is None


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("empty.stl", b"", "empty.stl is empty"),
        ("words.ply", b"hello", "words.ply cannot be read as PLY"),
        ("words.nii", b"hello", "words.nii cannot be read as NII"),
        ("words.nrrd", b"hello", "words.nrrd cannot be read as NRRD"),
        ("words.gii", b"hello", "words.gii cannot be read as GII"),
        ("liver.txt", b"hello", r"must end in one of \.stl, .*\.nhdr"),
    ],
)
def test_what_is_no_mesh_is_refused(tmp_path: Path, name: str, content: bytes, told: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ValueError, match=told):
        prepare(path)


@pytest.mark.skipif(importlib.util.find_spec("netgen") is None, reason="needs Netgen (extra tissue)")
def test_tetrahedra_are_made_and_used(tmp_path: Path) -> None:
    from spatula_env.geometry.tetrahedra import fill_organ

    organ, _ = prepare(write(tmp_path / "liver.ply", *ellipsoid()), fill="yes")
    assert organ.filling is not None
    assert fill_organ(organ) is organ.filling
