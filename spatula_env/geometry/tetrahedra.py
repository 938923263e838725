"""Tetrahedral meshes that fill an organ's surface and keep its nodes and triangles.

The organs of the presets come filled, from files that `scripts/fill_presets.py` has written, so that nothing needs to
be installed for them. Other organs are filled by Netgen (J. Schöberl, NETGEN: an advancing front 2D/3D-mesh generator
based on abstract rules, Computing and Visualization in Science 1, 1997), with the extra ``tissue``. Netgen keeps the
surface exactly; its smallest altitudes are two to five times those of TetGen on three of the presets' organs and half
of them on the fourth; it has wheels for Linux, macOS and Windows; and its licence is the LGPL, where TetGen's is the
AGPL and Gmsh's the GPL. fTetWild, under the MPL, moves the surface.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.geometry.arrays import read_only
from spatula_env.geometry.checks import check_positive
from spatula_env.installing import install_hint

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.arrays import BoolArray, FloatArray, Int32Array, IntArray
    from spatula_env.geometry.meshes import Organ

FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))
"""Corners of the face opposite each corner of a tetrahedron, counter-clockwise from outside."""

PRESETS = ("seed", "fissure", "clamp", "retract")
"""The preset scenes whose organs come filled."""

GRADING = 0.1
"""How fast tetrahedra grow from the surface inwards, in Netgen's measure: 0 for not at all, 1 for fast."""

SAME = 1e-6
"""Nodes of an organ that was computed on different machines count as the same if no coordinate differs by more [u]."""

FLATTEST = 1e-3
"""Least altitude of a tetrahedron as a part of its longest edge. In a flatter one, nothing that is computed of the
tissue around it would survive rounding to single precision."""


@dataclass(frozen=True, eq=False)
class TetrahedralMesh:
    """An organ filled with tetrahedra: the nodes of its surface come first, in the organ's order.

    Construction checks the arrays with :func:`check_tetrahedra`, among other things that all volumes are positive, and
    copies them; they cannot be written to afterwards.

    Attributes:
        nodes: Positions at rest, shape (N, 3), float64 [u].
        tetrahedra: Node indices, shape (M, 4), int32; the last three counter-clockwise seen from the first's opposite
            side, so that the volume is positive.
    """

    nodes: FloatArray = field(repr=False)
    tetrahedra: Int32Array = field(repr=False)

    def __post_init__(self) -> None:
        """Check the tetrahedra and replace the arrays by read-only copies."""
        nodes, tetrahedra = check_tetrahedra(self.nodes, self.tetrahedra)
        object.__setattr__(self, "nodes", read_only(nodes, np.float64))
        object.__setattr__(self, "tetrahedra", read_only(tetrahedra, np.int32))

    @property
    def volumes(self) -> FloatArray:
        """(M,) volumes of the tetrahedra [u3]."""
        return tetrahedron_volumes(self.nodes, self.tetrahedra)

    @property
    def altitudes(self) -> FloatArray:
        """(M,) the least of each tetrahedron's four altitudes [u]."""
        return _least_altitudes(self.nodes, self.tetrahedra)

    @property
    def qualities(self) -> FloatArray:
        """(M,) 12 (3 V)^(2/3) over the sum of the six squared edges: 1 for a regular tetrahedron, 0 for a flat one.

        The mean ratio of A. Liu and B. Joe, Relationship between tetrahedron shape measures, BIT 34, 1994.
        """
        corners = self.nodes[self.tetrahedra]
        squares = sum(((corners[:, a] - corners[:, b]) ** 2).sum(axis=1) for a in range(4) for b in range(a))
        qualities: FloatArray = 12.0 * np.cbrt(3.0 * self.volumes) ** 2 / np.asarray(squares)
        return qualities

    @property
    def boundary(self) -> Int32Array:
        """(T, 3) the triangles that belong to only one tetrahedron, counter-clockwise from outside."""
        faces = self.tetrahedra[:, np.array(FACES)].reshape(-1, 3)
        _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        boundary: Int32Array = faces[np.sort(first[count == 1])]
        return boundary

    def check_fills(self, organ: Organ) -> None:
        """Check that the tetrahedra fill an organ: its nodes come first, and its triangles are the boundary.

        Args:
            organ: The organ to be filled.

        Raises:
            ValueError: If they do not; the message says what is wrong, and how often.
        """
        count = len(organ.vertices)
        if len(self.nodes) < count:
            raise ValueError(f"nodes must be the {count} of organ {organ.name!r} and more, got {len(self.nodes)}")
        apart = np.abs(self.nodes[:count] - organ.vertices).max(axis=1) > SAME
        if apart.any():
            raise ValueError(
                f"the first {count} nodes must be those of organ {organ.name!r}, {int(apart.sum())} are elsewhere"
            )
        wanted, found = _cyclic(organ.triangles), _cyclic(self.boundary)
        missing, added = (len(a - b) for a, b in ((wanted, found), (found, wanted)))
        if missing or added:
            raise ValueError(
                f"the boundary of the tetrahedra must be the {len(wanted)} triangles of organ {organ.name!r}, "
                f"{missing} are missing and {added} are not among them"
            )


def check_tetrahedra(nodes: ArrayLike, tetrahedra: ArrayLike) -> tuple[FloatArray, IntArray]:
    """Check that a solid can be made of tetrahedra.

    Args:
        nodes: (N, 3) [u].
        tetrahedra: (M, 4) node indices.

    Returns:
        Both as arrays, float64 and int64.

    Raises:
        ValueError: If arrays have another shape, positions are not finite, indices name no node, a node is in no
            tetrahedron, or tetrahedra are inside out or flat; the message says how many.
    """
    places, corners = np.asarray(nodes, dtype=np.float64), np.asarray(tetrahedra)
    if places.ndim != 2 or places.shape[1] != 3 or not np.isfinite(places).all():
        raise ValueError(f"nodes must be finite and of shape (N, 3), got shape {places.shape}")
    if corners.ndim != 2 or corners.shape[1] != 4 or not len(corners) or not np.issubdtype(corners.dtype, np.integer):
        raise ValueError(f"tetrahedra must be integers of shape (M, 4), got {corners.dtype} of shape {corners.shape}")
    if corners.min() < 0 or corners.max() >= len(places):
        raise ValueError(
            f"tetrahedra must name nodes in 0..{len(places) - 1}, got {int(corners.min())}..{int(corners.max())}"
        )
    unused = np.bincount(corners.ravel(), minlength=len(places)) == 0
    if unused.any():
        raise ValueError(f"every node must be in a tetrahedron, {int(unused.sum())} of {len(places)} are in none")
    inverted = tetrahedron_volumes(places, corners) <= 0.0
    if inverted.any():
        raise ValueError(
            f"tetrahedra must have a positive volume, {int(inverted.sum())} of {len(corners)} are inside out or flat, "
            f"tetrahedron {int(np.argmax(inverted))} the first"
        )
    edges = places[corners[:, [1, 2, 3, 2, 3, 3]]] - places[corners[:, [0, 0, 0, 1, 1, 2]]]
    flat = _least_altitudes(places, corners) < FLATTEST * np.linalg.norm(edges, axis=2).max(axis=1)
    if flat.any():
        raise ValueError(
            f"tetrahedra must be higher than {FLATTEST:g} of their longest edge, {int(flat.sum())} of {len(corners)} "
            f"are flatter, tetrahedron {int(np.argmax(flat))} the first"
        )
    return places, corners.astype(np.int64)


def tetrahedron_volumes(nodes: FloatArray, tetrahedra: IntArray | Int32Array) -> FloatArray:
    """Volumes (..., M) of tetrahedra (M, 4) with nodes (..., N, 3), negative for those inside out [u3]."""
    corners = nodes[..., tetrahedra, :]
    edges = corners[..., 1:, :] - corners[..., :1, :]
    volumes: FloatArray = np.linalg.det(edges) / 6.0
    return volumes


def fill_organ(organ: Organ) -> TetrahedralMesh:
    """Fill an organ with tetrahedra: its own, those that come with the organs of the presets, or else Netgen's.

    Args:
        organ: The organ; it may have several parts and cavities.

    Returns:
        The mesh; results are cached, so an organ that was filled recently gives the same object.

    Raises:
        ImportError: If the organ is not that of a preset and Netgen is not installed; the message says what to
            install.
        ValueError: If the organ cannot be filled.
    """
    # Of an organ that was prepared with tetrahedra; its class is made of the one in this module.
    own: TetrahedralMesh | None = getattr(organ, "filling", None)
    return _fill_organ(organ) if own is None else own


@lru_cache(maxsize=16)
def _fill_organ(organ: Organ) -> TetrahedralMesh:
    return find_preset(organ) or tetrahedralize(organ)


def tetrahedralize(organ: Organ, grading: float = GRADING, max_edge: float | None = None) -> TetrahedralMesh:
    """Fill an organ by Netgen. Needs the extra ``tissue``.

    Args:
        organ: The organ.
        grading: How fast tetrahedra grow from the surface inwards: 0 for not at all, 1 for fast.
        max_edge: Length that edges inside should not exceed [u]; by default the grading alone limits it.

    Returns:
        The mesh.

    Raises:
        ImportError: If Netgen is not installed; the message says what to install.
        ValueError: If an argument is not allowed, or the organ cannot be filled.
    """
    check_positive(grading, "grading")
    check_positive(max_edge, "max_edge", or_none=True)
    meshing = _load_netgen(organ)
    # Netgen has some absolute lengths built in, so all organs are scaled to the same size for it.
    scale = 1.0 / float(np.ptp(organ.bounds, axis=0).max())
    mesh = meshing.Mesh(dim=3)
    for vertex in (organ.vertices * scale).tolist():
        mesh.Add(meshing.MeshPoint(meshing.Pnt(*vertex)))
    face = mesh.Add(meshing.FaceDescriptor(surfnr=1, domin=1, bc=1))
    for triangle in (organ.triangles + 1).tolist():
        mesh.Add(meshing.Element2D(face, triangle))
    options = meshing.MeshingParameters(maxh=10.0 if max_edge is None else max_edge * scale, grading=grading)
    try:
        mesh.GenerateVolumeMesh(options)
    except Exception as error:  # Netgen raises a type of its own
        raise ValueError(f"organ {organ.name!r} cannot be filled with tetrahedra: {error}") from error
    nodes = np.array([point.p for point in mesh.Points()]) / scale
    elements = [[corner.nr - 1 for corner in element.vertices] for element in mesh.Elements3D()]
    if not elements:
        raise ValueError(f"organ {organ.name!r} cannot be filled with tetrahedra: Netgen has made none")
    # Restore the surface's nodes to the last bit; and Netgen orders corners the other way round.
    nodes[: len(organ.vertices)] = organ.vertices
    filled = TetrahedralMesh(nodes, np.array(elements)[:, [0, 2, 1, 3]])
    filled.check_fills(organ)
    return filled


def _load_netgen(organ: Organ) -> Any:
    """Import the module `netgen.meshing`, or raise an ImportError that says what to install."""
    try:
        from netgen import meshing
    except ImportError as error:
        raise ImportError(
            f"organ {organ.name!r} is none of the presets', and filling it with tetrahedra needs Netgen: "
            f"{install_hint('tissue')}"
        ) from error
    return meshing


def find_preset(organ: Organ) -> TetrahedralMesh | None:
    """The tetrahedra that come with a preset's organ; None for any other organ."""
    for name in PRESETS:
        triangles, mesh = _read_preset(name)
        count = len(organ.vertices)
        if len(triangles) != len(organ.triangles) or not np.array_equal(triangles, organ.triangles):
            continue
        if count <= len(mesh.nodes) and np.abs(mesh.nodes[:count] - organ.vertices).max() <= SAME:
            nodes = mesh.nodes.copy()
            nodes[:count] = organ.vertices
            return TetrahedralMesh(nodes, mesh.tetrahedra)
    return None


@lru_cache(maxsize=len(PRESETS))
def _read_preset(name: str) -> tuple[Int32Array, TetrahedralMesh]:
    """The triangles (T, 3) of the surface of a preset's organ, and the mesh that fills it."""
    place = resources.files("spatula_env.geometry").joinpath("filled", f"{name}.npz")
    with resources.as_file(place) as path, np.load(path) as file:
        return file["triangles"].astype(np.int32), TetrahedralMesh(file["nodes"], file["tetrahedra"])


def _least_altitudes(nodes: FloatArray, tetrahedra: IntArray | Int32Array) -> FloatArray:
    """Least altitudes (M,) of tetrahedra: three times the volume, over the area of the largest face [u]."""
    corners = nodes[tetrahedra]
    areas = [
        0.5 * np.linalg.norm(np.cross(corners[:, b] - corners[:, a], corners[:, c] - corners[:, a]), axis=1)
        for a, b, c in FACES
    ]
    altitudes: FloatArray = 3.0 * tetrahedron_volumes(nodes, tetrahedra) / np.max(areas, axis=0)
    return altitudes


def _cyclic(triangles: Int32Array) -> set[tuple[int, ...]]:
    """The set of triangles, each rotated so that it begins with its least index."""
    first = np.argmin(triangles, axis=1)[:, None]
    turned = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    return set(map(tuple, turned.tolist()))


def inverted(nodes: FloatArray, tetrahedra: Int32Array) -> BoolArray:
    """Whether each tetrahedron (..., M) with nodes (..., N, 3) is inside out or flat."""
    return np.asarray(tetrahedron_volumes(nodes, tetrahedra) <= 0.0)
