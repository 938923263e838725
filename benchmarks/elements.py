"""Reference solutions of solids by an independent finite element code, felupe, with elements of second order.

felupe (https://felupe.readthedocs.io) is installed by who wants to compare: `pip install felupe`. It needs SciPy.
Only meshes and materials go in, displacements and forces come out: nothing here is computed by this package. Contact
with a plate without friction is a set of given displacements, which is found by trying: a node is let go that the plate
would have to pull, and one is held that is beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from spatula_env.arrays import BoolArray, FloatArray, Int32Array, IntArray

PERMUTATIONS = np.zeros((3, 3, 3))
"""The signs of permutations: of vector products."""
PERMUTATIONS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
PERMUTATIONS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0

RIM_CELLS = 16
"""Elements along each side of the quarter of a sphere's section."""

RIM_GRADING = 1.5
"""How much finer these are at the pole, as an exponent."""

TRIES = 40
"""Of a set of nodes in contact, at most."""

TOLERANCE = 1e-6
"""Of Newton's method."""


def load_felupe() -> Any:
    """The module `felupe`.

    Raises:
        ImportError: If it is not installed; says what to install.
    """
    try:
        import felupe
    except ImportError as error:
        raise ImportError(f"comparing with another code needs felupe: pip install felupe ({error})") from error
    return felupe


def felupe_version() -> str | None:
    """Its version; None where it is not installed."""
    try:
        return str(load_felupe().__version__)
    except ImportError:
        return None


def neo_hookean(shear: float, lame: float) -> Any:
    """The material G / 2 (I1 - 3) - G (J - 1) + (L + G) / 2 (J - 1)^2, which is the model "neo_hookean", for felupe.

    Args:
        shear: Shear modulus G.
        lame: Lamé's first parameter L.
    """
    bulk, unit = lame + shear, np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))

    def cofactors(f: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The cofactors, and J - 1."""
        found = 0.5 * np.einsum("ikm,jln,kl...,mn...->ij...", PERMUTATIONS, PERMUTATIONS, f, f)
        return found, np.einsum("ij...,ij...->...", found, f) / 3.0 - 1.0

    def stress(given: list[Any], **_: Any) -> list[Any]:
        cofactor, change = cofactors(given[0])
        return [shear * given[0] + (bulk * change - shear) * cofactor, given[-1]]

    def elasticity(given: list[Any], **_: Any) -> list[Any]:
        f = given[0]
        cofactor, change = cofactors(f)
        tangent = (bulk * change - shear) * np.einsum("ikm,jln,mn...->ijkl...", PERMUTATIONS, PERMUTATIONS, f)
        tangent += bulk * np.einsum("ij...,kl...->ijkl...", cofactor, cofactor)
        return [tangent + shear * unit.reshape(unit.shape + (1,) * (f.ndim - 2))]

    return load_felupe().Material(stress, elasticity)


@dataclass(frozen=True)
class Body:
    """A meshed solid in felupe.

    Attributes:
        points: (P, d) of the mesh.
        field: Displacements.
        solid: Assembles forces and stiffness.
    """

    points: FloatArray
    field: Any
    solid: Any

    @classmethod
    def of(cls, mesh: Any, region: Any, kind: Any, material: Any) -> Body:
        """A body of a mesh, a region's class, a field's class and a material."""
        felupe = load_felupe()
        field = felupe.FieldContainer([kind(region(mesh), dim=mesh.points.shape[1])])
        return cls(mesh.points, field, felupe.SolidBody(material, field))

    @property
    def moved(self) -> FloatArray:
        """(P, d) where the points are."""
        return np.asarray(self.points + self.field[0].values)

    def solve(self, given: Mapping[int, float]) -> FloatArray:
        """Find equilibrium.

        Args:
            given: Displacements by degree of freedom: d times the point plus the axis.

        Returns:
            (P, d) what holds the points.
        """
        held = np.array(sorted(given))
        free = np.setdiff1d(np.arange(self.points.size), held)
        values = np.array([given[place] for place in held.tolist()])
        felupe = load_felupe()
        felupe.newtonraphson(
            items=[self.solid], dof0=held, dof1=free, ext0=values, tol=TOLERANCE, maxiter=TRIES, verbose=0
        )
        return np.asarray(self.solid.assemble.vector(self.field).toarray().reshape(self.points.shape))


def press_sphere(shear: float, lame: float, depths: Sequence[float], cells: int = RIM_CELLS) -> FloatArray:
    """Force on a sphere of radius 1 between two plates without friction, each of which is moved towards its middle.

    A quarter of its section is meshed, with elements of nine nodes that are symmetric about the axis.

    Args:
        shear: Shear modulus.
        lame: Lamé's first parameter.
        depths: Ascending, how far each plate is moved, by the radius.
        cells: Elements along each side.

    Returns:
        (n,) forces, in units of the modulus.
    """
    felupe = load_felupe()
    mesh = felupe.mesh.convert(_quarter(cells), order=2, calc_points=True, calc_midfaces=True)
    body = Body.of(mesh, felupe.RegionBiQuadraticQuad, felupe.FieldAxisymmetric, neo_hookean(shear, lame))
    points = body.points
    rim = np.flatnonzero(np.isin(np.arange(len(points)), _outline(mesh.cells)) & _on_arc(points, cells))
    middle, axis = np.flatnonzero(points[:, 0] < 1e-9), np.flatnonzero(points[:, 1] < 1e-9)
    touching, forces = rim[points[rim, 0] > 1.0 - 0.5 * depths[0]], []
    for depth in depths:
        for _ in range(TRIES):
            given = {2 * k: 0.0 for k in middle.tolist()} | {2 * k + 1: 0.0 for k in axis.tolist()}
            given |= {2 * k: 1.0 - depth - points[k, 0] for k in touching.tolist()}
            pushed = body.solve(given)[:, 0]
            pulled = touching[pushed[touching] > 0.0]
            beyond = np.setdiff1d(rim[body.moved[rim, 0] > 1.0 - depth + 1e-9], touching)
            if not len(pulled) and not len(beyond):
                break
            touching = np.union1d(np.setdiff1d(touching, pulled), beyond)
        else:
            raise RuntimeError(f"no set of nodes in contact was found, {depth} deep")
        forces.append(-pushed[touching].sum())
    return np.array(forces)


def _quarter(cells: int) -> Any:
    """The quarter of a disc of radius 1, as quadrilaterals that are finer at the end of the first axis."""
    along = np.linspace(0.0, 1.0, cells + 1)
    u, v = np.meshgrid(1.0 - (1.0 - along) ** RIM_GRADING, along**RIM_GRADING, indexing="ij")
    # A square's sides become the disc's: the elliptical map.
    points = np.column_stack([(u * np.sqrt(1.0 - 0.5 * v**2)).ravel(), (v * np.sqrt(1.0 - 0.5 * u**2)).ravel()])
    index = np.arange(len(points)).reshape(cells + 1, cells + 1)
    corners = (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    return load_felupe().Mesh(points, np.stack(corners, axis=-1).reshape(-1, 4), "quad")


def _outline(cells: IntArray) -> IntArray:
    """Nodes on edges of one element alone, of elements (C, 9) whose edges' middles are nodes 4 to 7."""
    edges: dict[tuple[int, int], list[int]] = {}
    for cell in cells.tolist():
        for a, b, middle in ((0, 1, 4), (1, 2, 5), (2, 3, 6), (3, 0, 7)):
            edges.setdefault((min(cell[a], cell[b]), max(cell[a], cell[b])), []).append(cell[middle])
    return np.unique([node for ends, middles in edges.items() if len(middles) == 1 for node in (*ends, middles[0])])


def _on_arc(points: FloatArray, cells: int) -> BoolArray:
    """(P,) which points are on the arc; middles of its edges are a little within."""
    return np.asarray(np.linalg.norm(points, axis=1) > 1.0 - 1.0 / cells**2)


def solve_tetrahedra(
    nodes: FloatArray,
    tetrahedra: Int32Array,
    shear: float,
    lame: float,
    given: Mapping[tuple[int, int], float],
    increments: int,
) -> tuple[FloatArray, FloatArray]:
    """Equilibrium of a solid of tetrahedra, each with ten nodes instead of four.

    A node in the middle of an edge both of whose ends are given along an axis is given there too.

    Args:
        nodes: (N, 3) at rest.
        tetrahedra: (M, 4).
        shear: Shear modulus.
        lame: Lamé's first parameter.
        given: Displacements, by node and axis.
        increments: In how many steps they are made.

    Returns:
        (N, 3) displacements of the nodes, and (3,) what holds those that are displaced.
    """
    felupe = load_felupe()
    mesh = felupe.mesh.add_midpoints_edges(felupe.Mesh(nodes, tetrahedra, "tetra"))
    body = Body.of(mesh, felupe.RegionQuadraticTetra, felupe.Field, neo_hookean(shear, lame))
    values = {3 * node + axis: value for (node, axis), value in given.items()}
    pairs = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))
    for cell in mesh.cells.tolist():
        for middle, (a, b) in zip(cell[4:], pairs, strict=True):
            for axis in range(3):
                ends = (3 * cell[a] + axis, 3 * cell[b] + axis)
                if all(end in values for end in ends):
                    values[3 * middle + axis] = 0.5 * (values[ends[0]] + values[ends[1]])
    for part in np.linspace(0.0, 1.0, increments + 1)[1:]:
        forces = body.solve({place: part * value for place, value in values.items()})
    moved = np.array([place for place, value in values.items() if value != 0.0])
    total = np.bincount(moved % 3, forces.ravel()[moved], 3).astype(np.float64)
    return np.asarray(body.field[0].values[: len(nodes)]), total
