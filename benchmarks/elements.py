"""Reference solutions of solids by an independent finite element code, felupe, with elements of second order.

felupe (https://felupe.readthedocs.io) is an optional dependency: `pip install felupe`. It needs SciPy. It receives
meshes and materials and returns displacements and forces; nothing here is computed by this package. Contact with a
frictionless plate is modelled by prescribed displacements of an active set of nodes, which is found by iteration: a
node that the plate would have to pull is released, and one that is beyond the plate is added.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from spatula_env.arrays import BoolArray, FloatArray, Int32Array, IntArray

PERMUTATIONS = np.zeros((3, 3, 3))
"""The Levi-Civita symbol, for vector products."""
PERMUTATIONS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
PERMUTATIONS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0

RIM_CELLS = 16
"""Elements along each side of the quarter of a sphere's section."""

RIM_GRADING = 1.5
"""Exponent that makes these elements finer towards the pole; 1 would leave them uniform."""

TRIES = 40
"""Greatest number of contact sets that are tried for a depth, and of Newton iterations of a solve."""

TOLERANCE = 1e-6
"""Tolerance of Newton's method."""


def load_felupe() -> Any:
    """Import the module `felupe`.

    Raises:
        ImportError: If it is not installed; the message says what to install.
    """
    try:
        import felupe
    except ImportError as error:
        raise ImportError(f"comparing with another code needs felupe: pip install felupe ({error})") from error
    return felupe


def felupe_version() -> str | None:
    """Version of felupe; None if it is not installed."""
    try:
        return str(load_felupe().__version__)
    except ImportError:
        return None


def neo_hookean(shear: float, lame: float) -> Any:
    """The package's model "neo_hookean" as a felupe material: G / 2 (I1 - 3) - G (J - 1) + (L + G) / 2 (J - 1)^2.

    Args:
        shear: Shear modulus G.
        lame: Lamé's first parameter L.
    """
    bulk, unit = lame + shear, np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))

    def cofactors(f: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The cofactor matrix of the deformation gradient, and J - 1."""
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
        points: (P, d) points of the mesh, at rest.
        field: The displacement field.
        solid: The felupe body, which assembles forces and stiffness.
    """

    points: FloatArray
    field: Any
    solid: Any

    @classmethod
    def of(cls, mesh: Any, region: Any, kind: Any, material: Any) -> Body:
        """Make a body of a mesh, the class of its region, the class of its field and a material."""
        felupe = load_felupe()
        field = felupe.FieldContainer([kind(region(mesh), dim=mesh.points.shape[1])])
        return cls(mesh.points, field, felupe.SolidBody(material, field))

    @property
    def moved(self) -> FloatArray:
        """(P, d) displaced points."""
        return np.asarray(self.points + self.field[0].values)

    def solve(self, given: Mapping[int, float]) -> FloatArray:
        """Solve for equilibrium, starting from the current displacements.

        Args:
            given: Prescribed displacements by degree of freedom, which is d times the point plus the axis.

        Returns:
            (P, d) nodal forces, which are zero but at prescribed degrees of freedom, where they are the reactions.
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
    """Force on a sphere of radius 1 between two frictionless plates, both of which move towards its centre.

    A quarter of the sphere's section is meshed with axisymmetric elements of nine nodes.

    Args:
        shear: Shear modulus.
        lame: Lamé's first parameter.
        depths: How far each plate is moved, relative to the radius, ascending.
        cells: Elements along each side of the quarter.

    Returns:
        (n,) forces, in the unit of the moduli times the radius squared.

    Raises:
        RuntimeError: If no consistent set of nodes in contact is found within `TRIES` iterations.
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
    """Mesh a quarter of a disc of radius 1 with quadrilaterals that are finer towards the end of the first axis."""
    along = np.linspace(0.0, 1.0, cells + 1)
    u, v = np.meshgrid(1.0 - (1.0 - along) ** RIM_GRADING, along**RIM_GRADING, indexing="ij")
    # The elliptical map takes the outer sides of a square to the arc of the disc.
    points = np.column_stack([(u * np.sqrt(1.0 - 0.5 * v**2)).ravel(), (v * np.sqrt(1.0 - 0.5 * u**2)).ravel()])
    index = np.arange(len(points)).reshape(cells + 1, cells + 1)
    corners = (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    return load_felupe().Mesh(points, np.stack(corners, axis=-1).reshape(-1, 4), "quad")


def _outline(cells: IntArray) -> IntArray:
    """Nodes on boundary edges, those of one element only; elements (C, 9) have edge midpoints as nodes 4 to 7."""
    edges: dict[tuple[int, int], list[int]] = {}
    for cell in cells.tolist():
        for a, b, middle in ((0, 1, 4), (1, 2, 5), (2, 3, 6), (3, 0, 7)):
            edges.setdefault((min(cell[a], cell[b]), max(cell[a], cell[b])), []).append(cell[middle])
    return np.unique([node for ends, middles in edges.items() if len(middles) == 1 for node in (*ends, middles[0])])


def _on_arc(points: FloatArray, cells: int) -> BoolArray:
    """(P,) which points are on the arc; the tolerance includes midpoints of its edges, which are slightly inside it."""
    return np.asarray(np.linalg.norm(points, axis=1) > 1.0 - 1.0 / cells**2)


def solve_tetrahedra(
    nodes: FloatArray,
    tetrahedra: Int32Array,
    shear: float,
    lame: float,
    given: Mapping[tuple[int, int], float],
    increments: int,
) -> tuple[FloatArray, FloatArray]:
    """Solve for equilibrium of a tetrahedral mesh, with quadratic elements of ten nodes in place of four.

    Where both ends of an edge have prescribed displacements along an axis, its midpoint gets their mean.

    Args:
        nodes: (N, 3) at rest.
        tetrahedra: (M, 4).
        shear: Shear modulus.
        lame: Lamé's first parameter.
        given: Prescribed displacements, by node and axis.
        increments: Number of steps in which they are applied.

    Returns:
        (N, 3) displacements of the nodes, and (3,) sum of the reactions along each axis at those degrees of freedom
        whose prescribed displacement is not zero.
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
