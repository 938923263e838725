"""Organs from files: surfaces as they are, and organs that `spatula organ prepare` has written."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from spatula_env._warnings import warn
from spatula_env.arrays import FloatArray, Int32Array
from spatula_env.geometry.checks import check_positive
from spatula_env.geometry.meshes import Organ
from spatula_env.geometry.parts import describe_parts, organ_parts
from spatula_env.geometry.prepared import PREPARED_SUFFIX, read_prepared
from spatula_env.installing import install_hint

FILE_SUFFIXES = (".obj", ".stl", ".ply")
"""The formats of surfaces that :func:`load_organ` reads."""


def load_organ(path: str | os.PathLike[str], scale: float = 1.0, name: str | None = None) -> Organ:
    """Read an organ from an OBJ, STL or PLY file, or from an .npz that `spatula organ prepare` has written.

    An .npz gives a :class:`~spatula_env.geometry.prepared.PreparedOrgan`, with its held nodes, its lines and its
    tetrahedra, in scene units; it needs no extra. Of the other files, nodes and triangles keep the
    file's order. STL files name no shared vertices, so there vertices at the same position become one, in the order in
    which the file first names them. Faces of more than three corners are divided into triangles. Nothing else is
    changed: a surface with a defect is an error, which :func:`spatula_env.anatomy.prepare_organ` may mend. Needs the
    extra ``mesh``.

    Args:
        path: The file. Its suffix determines the format.
        scale: Factor from the file's unit to scene units.
        name: Name of the organ; the file's name if not given, or for an .npz the name in it.

    Returns:
        The organ, at the (scaled) coordinates of the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If trimesh is not installed.
        ValueError: If the suffix is unknown, the scale is not positive and finite, the file cannot be read or
            does not hold exactly one triangle mesh, or :func:`~spatula_env.geometry.surface.check_surface`
            finds a defect.

    Warns:
        SceneWarning: If the surface consists of several parts.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    check_positive(scale, "scale")
    if not file.is_file():
        is_there = "is no file" if file.exists() else "does not exist"
        raise FileNotFoundError(f"{os.fspath(file)!r} {is_there}")
    if suffix == PREPARED_SUFFIX:
        return read_prepared(file).scaled(scale, name)
    if suffix not in FILE_SUFFIXES:
        allowed = ", ".join((*FILE_SUFFIXES, PREPARED_SUFFIX))
        raise ValueError(f"{file.name}: the suffix must be one of {allowed}, got {file.suffix!r}")
    vertices, triangles = _read_triangles(file, suffix)
    if suffix == ".stl":
        vertices, triangles = _merge_equal(vertices, triangles)
    organ = Organ(vertices * scale, triangles, file.name if name is None else name)
    parts = organ_parts(organ)
    if len(parts) > 1:
        warn(
            f"{file.name} holds {len(parts)} parts that nothing connects ({describe_parts(parts)}): what holds "
            "one of them does not hold the others"
        )
    return organ


def _read_triangles(file: Path, suffix: str) -> tuple[FloatArray, Int32Array]:
    """Vertices and triangles of the one mesh in a file; raise ValueError where there is no such mesh."""
    try:
        import trimesh
    except ImportError as error:
        raise ImportError(f"reading a surface from a file needs trimesh: {install_hint('mesh')}") from error
    try:
        # The vertices as they are in the file: not merged, reordered, or split where textures have seams.
        with file.open("rb") as stream:
            scene = trimesh.load_scene(
                stream, file_type=suffix[1:], process=False, maintain_order=True, skip_materials=True
            )
    except Exception as error:  # the readers raise whatever the malformed text leads to
        raise ValueError(f"{file.name} cannot be read as {suffix[1:].upper()}: {error}") from error
    parts = list(scene.geometry.values())
    if not parts:
        raise ValueError(f"{file.name} holds no geometry, or is not a {suffix[1:].upper()} file")
    if len(parts) > 1:
        raise ValueError(
            f"{file.name} holds {len(parts)} geometries ({', '.join(map(str, scene.geometry))}), "
            "one is allowed; join them into one object of one material"
        )
    if not isinstance(parts[0], trimesh.Trimesh) or not len(parts[0].faces):
        raise ValueError(f"{file.name} holds no triangles, only points or lines")
    return np.array(parts[0].vertices, dtype=np.float64), np.array(parts[0].faces, dtype=np.int32)


def _merge_equal(vertices: FloatArray, triangles: Int32Array) -> tuple[FloatArray, Int32Array]:
    """Merge vertices at exactly the same position, in the order of their first appearance."""
    _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), dtype=np.int32)
    rank[order] = np.arange(len(order))
    return vertices[first[order]], rank[inverse.reshape(-1)][triangles]
