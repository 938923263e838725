"""Surfaces as they come out of segmentations, defects included, and ones of which no organ can be made.

Each is written into a file, as `spatula organ prepare` reads them. Those of brains are in the package nilearn, which
need not be installed as a whole: its files are looked for, and nothing is downloaded.
"""

from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env import scenes
from spatula_env.geometry import icosphere, torus

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray, IntArray

HALF_AXES = (50.0, 40.0, 30.0)
"""Half axes of the ellipsoid that most surfaces are made of [mm]."""

LOBES = 0.06
"""Height of its lobes, as a part of its radius."""

VOXEL = 2.0
"""Edge of a voxel [mm]."""

SLIVER = 1e-3
"""Share of a triangle's height at which a needle's third corner is above the longest side."""

MATTER = 128
"""Least grey value, of 255, of what is white matter in nilearn's template."""

HELD = 0.18
"""Part of an organ's height, from below, that is held."""

HELD_BRAIN = 0.35
"""The same of brains. A hemisphere of tissue that is held lower leans under its weight, and sways for long."""

TEMPLATES = "datasets", "data"
"""Folder of nilearn's files, within the package."""


@dataclass(frozen=True)
class Source:
    """A surface, and what ought to become of it.

    Attributes:
        write: Writes its file into a folder, and returns the file's path; None if its origin is not installed.
        units: Unit that is told to the preparation; None if the file says it.
        nodes: Number of nodes that are asked for.
        held: Part of the organ's height, from below, that is held.
        refusal: Words in the reason for which it has to be refused; "" if it has to be prepared.
        options: Further fields of `PrepareOptions`.
    """

    write: Callable[[Path], Path | None]
    units: str | None = "mm"
    nodes: int = 650
    held: float = HELD
    refusal: str = ""
    options: dict[str, Any] = field(default_factory=dict)


def sources() -> dict[str, Source]:
    """All surfaces by name, in the order in which they are reported."""
    presets = {
        f"preset {name}": Source(partial(_preset, name=name)) for name in ("seed", "retract", "fissure", "clamp")
    }
    return {
        **presets,
        "staircase": Source(_staircase, units=None, options={"label": 3}),
        "slivers": Source(_slivers),
        "duplicates": Source(_duplicates),
        "inverted": Source(partial(_inverted, every=1)),
        "half inverted": Source(partial(_inverted, every=2)),
        "holes": Source(_holes),
        "fin": Source(_fin),
        "islands": Source(_islands),
        "cavity": Source(_cavity),
        "fine sphere": Source(_fine_sphere),
        "torus": Source(_torus),
        "left pial": Source(partial(_pial, side="left"), units=None, nodes=1300, held=HELD_BRAIN),
        "right pial": Source(partial(_pial, side="right"), units=None, nodes=1300, held=HELD_BRAIN),
        "white matter": Source(_white_matter, units=None, nodes=1300, held=HELD_BRAIN),
        "sheet": Source(_sheet, refusal="is open"),
        "wrong units": Source(_wrong_units, units="m", refusal="units=mm?"),
        "60 um": Source(_tiny, refusal="60 um"),
        "no mesh": Source(_no_mesh, refusal="no triangles"),
        "empty file": Source(_empty, refusal="is empty"),
    }


def lobed(subdivisions: int = 4) -> tuple[FloatArray, IntArray]:
    """An ellipsoid with shallow lobes, vertices (V, 3) [mm] and triangles (T, 3)."""
    ball = icosphere(1.0, subdivisions)
    x, y, z = np.asarray(ball.vertices).T
    radius = 1.0 + LOBES * np.sin(3.0 * np.arctan2(y, x)) * np.sin(np.arccos(np.clip(z, -1.0, 1.0))) ** 3
    return np.asarray(ball.vertices) * radius[:, None] * HALF_AXES, ball.triangles.astype(np.int64)


def _write(file: Path, vertices: FloatArray, triangles: IntArray) -> Path:
    """Write a surface as it is; the ending of the name says how."""
    import trimesh

    trimesh.Trimesh(vertices, triangles, process=False).export(file)
    return file


def _preset(folder: Path, name: str) -> Path:
    scene = getattr(scenes, name)()
    placed = scene.organs[0]
    return _write(
        folder / f"preset_{name}.ply",
        1e3 * scene.scale.length * np.asarray(placed.vertices),
        placed.organ.triangles.astype(np.int64),
    )


def _staircase(folder: Path) -> Path:
    """Label 3 of a volume of voxels; another label lies beside it."""
    counts = np.ceil(2.2 * np.array(HALF_AXES) / VOXEL).astype(int)
    places = np.stack(np.meshgrid(*(np.arange(count) for count in counts), indexing="ij"), axis=-1) - 0.5 * (counts - 1)
    inside = ((places * VOXEL / HALF_AXES) ** 2).sum(axis=-1) < 1.0
    labels = np.where(inside, 3, 0).astype(np.uint8)
    labels[:3, :3, :3] = 1
    return _write_labels(folder / "staircase.nii.gz", labels, np.diag([VOXEL, VOXEL, VOXEL, 1.0]))


def _write_labels(file: Path, labels: Any, affine: FloatArray) -> Path:
    import nibabel

    image = nibabel.Nifti1Image(labels, affine)
    image.header.set_xyzt_units("mm")
    nibabel.save(image, file)
    return file


def _slivers(folder: Path) -> Path:
    """Every eighth triangle is divided at a point almost on one of its sides: a needle and two others."""
    vertices, triangles = lobed()
    chosen = np.arange(len(triangles)) % 8 == 0
    a, b, c = triangles[chosen].T
    points = 0.5 * (1.0 - SLIVER) * (vertices[a] + vertices[b]) + SLIVER * vertices[c]
    new = len(vertices) + np.arange(len(points))
    divided = [np.column_stack(corners) for corners in ((a, b, new), (b, c, new), (c, a, new))]
    return _write(
        folder / "slivers.ply", np.concatenate([vertices, points]), np.concatenate([triangles[~chosen], *divided])
    )


def _duplicates(folder: Path) -> Path:
    """Triangles that share no vertex, as all files in the STL format."""
    vertices, triangles = lobed()
    return _write(
        folder / "duplicates.stl", vertices[triangles].reshape(-1, 3), np.arange(triangles.size).reshape(-1, 3)
    )


def _inverted(folder: Path, every: int) -> Path:
    """Every n-th triangle is wound the other way round."""
    vertices, triangles = lobed()
    triangles[::every] = triangles[::every, ::-1]
    return _write(folder / f"inverted_{every}.ply", vertices, triangles)


def _holes(folder: Path) -> Path:
    """The triangles within 3.5 mm of six vertices are missing."""
    vertices, triangles = lobed()
    middles = vertices[triangles].mean(axis=1)
    missing = np.zeros(len(triangles), dtype=np.bool_)
    for vertex in np.linspace(0, len(vertices) - 1, 6).astype(int):
        missing |= np.linalg.norm(middles - vertices[vertex], axis=1) < 3.5
    return _write(folder / "holes.obj", vertices, triangles[~missing])


def _fin(folder: Path) -> Path:
    """Two triangles more stand on an edge and share another edge with each other."""
    vertices, triangles = lobed()
    a, b, _ = triangles[0]
    first, second = 1.15 * vertices[a], 1.15 * vertices[b]
    new = len(vertices)
    fin = np.array([[a, b, new], [b, new + 1, new]])
    return _write(folder / "fin.ply", np.vstack([vertices, first, second]), np.concatenate([triangles, fin]))


def _islands(folder: Path) -> Path:
    """Three balls float around the organ."""
    vertices, triangles = lobed()
    balls = [np.asarray(icosphere(4.0, 2).vertices) + shift for shift in ([70, 0, 0], [0, 60, 5], [0, -55, 20])]
    return _merged(folder / "islands.ply", [(vertices, triangles), *((ball, _ball_triangles()) for ball in balls)])


def _cavity(folder: Path) -> Path:
    """The surface of a ventricle, wound inwards as a boundary is, lies inside."""
    vertices, triangles = lobed()
    inner = np.asarray(icosphere(10.0, 2).vertices)
    return _merged(folder / "cavity.ply", [(vertices, triangles), (inner, _ball_triangles()[:, ::-1])])


def _ball_triangles() -> IntArray:
    return icosphere(1.0, 2).triangles.astype(np.int64)


def _merged(file: Path, parts: list[tuple[FloatArray, IntArray]]) -> Path:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    return _write(
        file,
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([triangles + start for (_, triangles), start in zip(parts, starts, strict=False)]),
    )


def _fine_sphere(folder: Path) -> Path:
    """A sphere of 40,962 vertices."""
    ball = icosphere(45.0, 6)
    return _write(folder / "fine_sphere.ply", np.asarray(ball.vertices), ball.triangles.astype(np.int64))


def _torus(folder: Path) -> Path:
    ring = torus(45.0, 20.0, 96, 48)
    return _write(folder / "torus.ply", np.asarray(ring.vertices), ring.triangles.astype(np.int64))


def nilearn_file(*names: str) -> Path | None:
    """A file of nilearn's own data, which is not imported; None if it is not there."""
    found = find_spec("nilearn")
    for place in () if found is None else found.submodule_search_locations or ():
        file = Path(place).joinpath(*TEMPLATES, *names)
        if file.exists():
            return file
    return None


def _pial(folder: Path, side: str) -> Path | None:
    """A hemisphere of fsaverage5, unpacked."""
    packed = nilearn_file("fsaverage5", f"pial_{side}.gii.gz")
    if packed is None:
        return None
    file = folder / f"pial_{side}.gii"
    file.write_bytes(gzip.decompress(packed.read_bytes()))
    return file


def _white_matter(folder: Path) -> Path | None:
    """The white matter of the MNI 152 template, an image of grey values, made a label by a threshold."""
    packed = nilearn_file("mni_icbm152_wm_tal_nlin_sym_09a_converted.nii.gz")
    if packed is None:
        return None
    import nibabel

    image: Any = nibabel.load(packed)
    inside: BoolArray = np.asanyarray(image.dataobj) >= MATTER
    return _write_labels(folder / "white_matter.nii.gz", inside.astype(np.uint8), image.affine)


def _sheet(folder: Path) -> Path:
    """A wide sheet, open all around."""
    x, y = np.meshgrid(np.linspace(-60.0, 60.0, 31), np.linspace(-60.0, 60.0, 31), indexing="ij")
    first = (np.arange(30)[:, None] * 31 + np.arange(30)).reshape(-1)
    triangles = np.concatenate(
        [np.column_stack([first, first + 31, first + 32]), np.column_stack([first, first + 32, first + 1])]
    )
    heights = 10.0 * np.cos(x / 30.0) * np.cos(y / 30.0)
    return _write(folder / "sheet.ply", np.column_stack([x.ravel(), y.ravel(), heights.ravel()]), triangles)


def _wrong_units(folder: Path) -> Path:
    """Millimetres that are said to be metres: an organ of 60 m."""
    vertices, triangles = lobed()
    return _write(folder / "wrong_units.stl", 60.0 * vertices / np.ptp(vertices, axis=0).max(), triangles)


def _tiny(folder: Path) -> Path:
    """An organ of 60 um."""
    vertices, triangles = lobed()
    return _write(folder / "tiny.ply", 0.06 * vertices / np.ptp(vertices, axis=0).max(), triangles)


def _no_mesh(folder: Path) -> Path:
    """Points without triangles."""
    file = folder / "no_mesh.obj"
    file.write_text("".join(f"v {x:.6g} {y:.6g} {z:.6g}\n" for x, y, z in lobed(1)[0].tolist()), encoding="ascii")
    return file


def _empty(folder: Path) -> Path:
    file = folder / "empty.stl"
    file.write_bytes(b"")
    return file
