"""Surfaces and labelled volumes from files, in the unit of the file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.anatomy.libraries import load

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from spatula_env.arrays import FloatArray, IntArray

SURFACES = (".stl", ".obj", ".ply", ".vtk", ".vtp", ".gii")
VOLUMES = (".nii", ".nii.gz", ".nrrd", ".nhdr")

MOST_TRIANGLES = 3_000_000
MOST_VOXELS = 1_500_000_000

UNIT_NAMES = {"mm": "mm", "millimeter": "mm", "millimetre": "mm", "m": "m", "meter": "m", "metre": "m"}


@dataclass(frozen=True, eq=False)
class RawSurface:
    """What a file of a surface holds.

    Attributes:
        vertices: (V, 3) positions, in the file's unit.
        triangles: (T, 3) vertex indices.
        units: "mm" or "m"; None if the file does not say.
    """

    vertices: FloatArray
    triangles: IntArray
    units: str | None


@dataclass(frozen=True, eq=False)
class RawVolume:
    """What a file of a labelled volume holds.

    Attributes:
        labels: (I, J, K) integers.
        affine: (4, 4) from indices of voxels to positions, in the file's unit.
        units: "mm" or "m"; None if the file does not say.
    """

    labels: NDArray[np.integer[Any]]
    affine: FloatArray
    units: str | None


def file_kind(path: Path) -> str:
    """The ending of a file's name, one of `SURFACES` and `VOLUMES`.

    Raises:
        ValueError: If it is another one.
    """
    name = path.name.lower()
    for ending in (*VOLUMES, *SURFACES):
        if name.endswith(ending):
            return ending
    raise ValueError(f"{path.name}: the file must end in one of {', '.join((*SURFACES, *VOLUMES))}")


def read_file(path: Path) -> RawSurface | RawVolume:
    """Read a surface or a labelled volume; the ending of the name says which.

    Args:
        path: The file.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If a library is not installed; the message says what to install.
        ValueError: If it cannot be read, holds no triangles, is too large, or its voxels are no labels.
    """
    kind = file_kind(path)
    if not path.is_file():
        is_there = "is no file" if path.exists() else "does not exist"
        raise FileNotFoundError(f"{os.fspath(path)!r} {is_there}")
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty")
    readers: dict[str, Callable[[Path], RawSurface | RawVolume]] = {
        ".gii": _read_gifti,
        ".nii": _read_nifti,
        ".nii.gz": _read_nifti,
        ".nrrd": _read_nrrd,
        ".nhdr": _read_nrrd,
        ".vtk": _read_vtk,
        ".vtp": _read_vtk,
    }
    try:
        raw = readers.get(kind, _read_mesh)(path)
    except (ImportError, FileNotFoundError, _Refused):
        raise
    except Exception as error:  # the libraries raise whatever the malformed content leads to
        raise ValueError(f"{path.name} cannot be read as {kind[1:].upper()}: {error}") from error
    return _checked_volume(raw, path.name) if isinstance(raw, RawVolume) else _checked_surface(raw, path.name)


class _Refused(ValueError):
    """An error whose message needs no more words."""


def _read_mesh(path: Path) -> RawSurface:
    trimesh = load("trimesh", "mesh")
    kind = path.suffix.lower()[1:]
    with path.open("rb") as stream:
        scene = trimesh.load_scene(stream, file_type=kind, process=False, maintain_order=True, skip_materials=True)
    meshes = [part for part in scene.geometry.values() if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    if not meshes:
        raise _Refused(f"{path.name} holds no triangles, or is no {kind.upper()} file")
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return RawSurface(
        np.concatenate([np.asarray(mesh.vertices, dtype=np.float64) for mesh in meshes]),
        np.concatenate([np.asarray(mesh.faces, dtype=np.int64) + s for mesh, s in zip(meshes, starts, strict=False)]),
        None,
    )


def _read_vtk(path: Path) -> RawSurface:
    mesh = load("pyvista", "viz").read(path)
    if not hasattr(mesh, "faces"):
        mesh = mesh.extract_surface()
    mesh = mesh.triangulate()
    faces = np.asarray(mesh.faces).reshape(-1, 4)[:, 1:]
    return RawSurface(np.asarray(mesh.points, dtype=np.float64), faces.astype(np.int64), None)


def _read_gifti(path: Path) -> RawSurface:
    image = load("nibabel").load(path)
    points, triangles = (image.agg_data(f"NIFTI_INTENT_{name}") for name in ("POINTSET", "TRIANGLE"))
    if not isinstance(points, np.ndarray) or not isinstance(triangles, np.ndarray):
        raise _Refused(f"{path.name} must hold one array of points and one of triangles, as a file of a surface does")
    # The format says that coordinates are in millimetres.
    return RawSurface(points.astype(np.float64), triangles.astype(np.int64), "mm")


def _read_nifti(path: Path) -> RawVolume:
    image = load("nibabel").load(path)
    _check_voxels(image.shape, path.name)
    units = image.header.get_xyzt_units()[0]
    labels = np.asanyarray(image.dataobj)
    return RawVolume(labels, np.asarray(image.affine, dtype=np.float64), {"mm": "mm", "meter": "m"}.get(units))


def _read_nrrd(path: Path) -> RawVolume:
    nrrd = load("nrrd")
    header = nrrd.read_header(str(path))
    _check_voxels(tuple(header["sizes"]), path.name)
    labels, header = nrrd.read(str(path))
    affine = np.eye(4)
    directions = header.get("space directions")
    if directions is not None and np.asarray(directions).shape == (3, 3) and np.isfinite(directions).all():
        affine[:3, :3] = np.asarray(directions).T
    elif "spacings" in header:
        affine[:3, :3] = np.diag(np.asarray(header["spacings"], dtype=np.float64)[:3])
    else:
        raise _Refused(f"{path.name} does not say how large its voxels are: it has neither directions nor spacings")
    if "space origin" in header:
        affine[:3, 3] = header["space origin"]
    told = {UNIT_NAMES.get(str(unit).lower()) for unit in header.get("space units", [])}
    return RawVolume(labels, affine, told.pop() if len(told) == 1 else None)


def _check_voxels(shape: tuple[int, ...], name: str) -> None:
    """Check the number of voxels before they are read."""
    count = int(np.prod([int(size) for size in shape], dtype=object))
    if count > MOST_VOXELS:
        raise _Refused(f"{name} has {count:,} voxels, at most {MOST_VOXELS:,} are allowed; crop it to the organ")


def _checked_surface(raw: RawSurface, name: str) -> RawSurface:
    count = len(raw.triangles)
    if not count:
        raise ValueError(f"{name} holds no triangles")
    if count > MOST_TRIANGLES:
        raise ValueError(f"{name} has {count:,} triangles, at most {MOST_TRIANGLES:,} are allowed; decimate it before")
    bad = int((~np.isfinite(raw.vertices).all(axis=1)).sum())
    if bad:
        raise ValueError(f"{name} has {bad} of {len(raw.vertices)} vertices that are not finite")
    if raw.triangles.min() < 0 or raw.triangles.max() >= len(raw.vertices):
        raise ValueError(
            f"{name} has triangles of vertices {raw.triangles.min()}..{raw.triangles.max()}, "
            f"it holds 0..{len(raw.vertices) - 1}"
        )
    return raw


def _checked_volume(raw: RawVolume, name: str) -> RawVolume:
    labels = raw.labels
    while labels.ndim > 3 and labels.shape[-1] == 1:
        labels = labels[..., 0]
    if labels.ndim != 3 or not labels.size:
        raise ValueError(f"{name} must be a volume of three dimensions, got shape {raw.labels.shape}")
    if labels.dtype.kind not in "iub":
        rounded = np.rint(labels)
        if labels.dtype.kind != "f" or not np.array_equal(rounded, labels):
            raise ValueError(
                f"{name} must hold labels, whole numbers, got other values; it may be an image: segment it"
            )
        labels = rounded.astype(np.int64)
    if not np.isfinite(raw.affine).all() or abs(np.linalg.det(raw.affine[:3, :3])) < 1e-30:
        raise ValueError(f"{name} has voxels without a size: its matrix is {raw.affine[:3, :3].tolist()}")
    return RawVolume(labels, raw.affine, raw.units)
