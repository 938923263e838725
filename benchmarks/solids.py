"""Solids for checks of tissue: blocks of tetrahedra, spheres, and the equilibrium of a solid.

The energy density is implemented here a second time, from `docs/tissue.md`, and stresses are its finite differences, so
that the package is not checked against itself.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry import Organ, icosphere
from spatula_env.sim.tissue.body import STABILISER
from spatula_env.sim.tissue.solid import Solid

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray
    from spatula_env.scenes import Material
    from spatula_env.sim.tissue.hyperelastic import Hyperelastic

JITTER = 0.15
"""Greatest random displacement of a block's inner nodes along each axis, in cells, to make its tetrahedra irregular."""

DIFFERENCE = 1e-5
"""Step in stretch or shear of the finite differences of the energy."""

SETTLED = 1e-4
"""Greatest force on a free node, relative to that on a held one, at which a solid counts as being in equilibrium."""


def block(size: FloatArray, cells: tuple[int, int, int]) -> Solid:
    """A block of cells, each divided into six tetrahedra, with randomly displaced inner nodes.

    Args:
        size: (3,) lengths of the edges [u]; one corner is the origin.
        cells: Number of cells along each edge.
    """
    counts = np.array(cells) + 1
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), axis=-1).reshape(-1, 3)
    inner = np.asarray(((grid > 0) & (grid < counts - 1)).all(axis=1))
    moved = grid + inner[:, None] * np.random.default_rng(0).uniform(-JITTER, JITTER, grid.shape)
    corners = grid[(grid < counts - 1).all(axis=1)]
    tetrahedra = []
    # H. W. Kuhn's subdivision: paths along three edges from one corner to the opposite one, in each of the six orders.
    for order in itertools.permutations(range(3)):
        steps = np.cumsum(np.concatenate([np.zeros((1, 3), dtype=np.int64), np.eye(3, dtype=np.int64)[list(order)]]), 0)
        path = corners[:, None] + steps
        indices = np.ravel_multi_index(tuple(np.moveaxis(path, -1, 0)), tuple(counts))
        even = np.linalg.det(np.eye(3)[list(order)]) > 0.0
        tetrahedra.append(indices if even else indices[:, [0, 2, 1, 3]])
    return Solid(moved * np.asarray(size) / cells, np.concatenate(tetrahedra).astype(np.int32))


def geodesic_sphere(radius: float, frequency: int) -> Organ:
    """A sphere of nearly equal triangles: an icosahedron whose edges are divided, with 10 frequency^2 + 2 nodes.

    Args:
        radius: Radius [u].
        frequency: Number of parts of an edge. A power of two gives what `icosphere` does.
    """
    solid = icosphere(1.0, 0)
    first, second = np.nonzero(np.add.outer(*[np.arange(frequency + 1)] * 2) <= frequency)
    weights = np.column_stack([frequency - first - second, first, second]) / frequency
    number = {place: index for index, place in enumerate(zip(first.tolist(), second.tolist(), strict=True))}
    upward = [[number[i, j], number[i + 1, j], number[i, j + 1]] for i, j in number if i + j < frequency]
    downward = [[number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]] for i, j in number if i + j < frequency - 1]
    faces = np.array(upward + downward)
    points = (weights @ solid.vertices[solid.triangles]).reshape(-1, 3)
    triangles = (faces + len(weights) * np.arange(len(solid.triangles))[:, None, None]).reshape(-1, 3)
    # Nodes on the icosahedron's edges belong to two or five of its triangles.
    _, kept, merged = np.unique(np.round(points, 9), axis=0, return_index=True, return_inverse=True)
    vertices = points[kept] * (radius / np.linalg.norm(points[kept], axis=1, keepdims=True))
    return Organ(vertices, merged.ravel()[triangles].astype(np.int32), "sphere")


def graded_sphere(radius: float, frequency: int, grading: float = 0.0) -> Organ:
    """A sphere whose triangles are smaller at both poles of its z axis.

    Args:
        radius: Radius [u].
        frequency: See `geodesic_sphere`.
        grading: From 0, uniform, to less than 0.5. Edges near the poles are shorter by the factor 1 - 2 grading.
    """
    sphere = geodesic_sphere(radius, frequency)
    x, y, z = sphere.vertices.T
    polar, around = np.arccos(np.clip(z / radius, -1.0, 1.0)), np.arctan2(y, x)
    polar -= grading * np.sin(2.0 * polar)
    places = np.column_stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)])
    return Organ(radius * places, sphere.triangles, "sphere")


def equilibrium(
    solid: Solid, law: Hyperelastic, start: FloatArray, free: BoolArray, iterations: int = 4000
) -> tuple[FloatArray, FloatArray]:
    """Find the equilibrium of a solid with some prescribed coordinates, by minimising its energy.

    Args:
        solid: The solid.
        law: Its material.
        start: (N, 3) initial positions of the nodes; coordinates that are not free keep these values [u].
        free: (N, 3) which coordinates are free.
        iterations: Greatest number of iterations.

    Returns:
        (N, 3) positions [u], and (N, 3) forces of the solid on its nodes there, nearly zero for free coordinates.

    Raises:
        ImportError: If SciPy is not installed.
        RuntimeError: If the minimisation does not come to rest.
    """
    from scipy.optimize import minimize

    stabiliser, nodes = STABILISER * law.shear, start.copy()
    nothing = np.zeros((len(start), 3, 3))

    def energy(coordinates: FloatArray) -> tuple[float, FloatArray]:
        nodes[free] = coordinates
        deformations = solid.deformations(nodes)
        forces = solid.forces(law.stress(deformations), nodes, stabiliser)
        stored = float((solid.shares * law.energy(deformations)).sum())
        stored -= 0.5 * float((solid.forces(nothing, nodes, stabiliser) * nodes).sum())
        return stored, -forces[free]

    options = {"maxiter": iterations, "maxfun": 2 * iterations, "maxcor": 30, "ftol": 0.0, "gtol": 0.0}
    # With zero tolerances, it ends where rounding lets the energy decrease no further.
    minimize(energy, start[free], jac=True, method="L-BFGS-B", options=options)
    forces = solid.forces(law.stress(solid.deformations(nodes)), nodes, stabiliser)
    left, greatest = np.abs(forces[free]).max(initial=0.0), np.abs(forces[~free]).max()
    if not left <= SETTLED * greatest:
        raise RuntimeError(f"a solid has not come to rest: {left / greatest:.2g} of the greatest force is left")
    return nodes, forces


def documented_energy(material: Material, deformation: FloatArray) -> float:
    """Energy per volume at rest, by the formula in `docs/tissue.md` [Pa].

    Args:
        material: The material.
        deformation: (3, 3) deformation gradient, with strains as in tests.
    """
    shear = material.shear_modulus
    first, square = material.rivlin
    c1, c3 = first * shear, square * shear
    c2 = 0.5 * shear - c1
    c = deformation.T @ deformation
    i1 = float(np.trace(c))
    i2, j = 0.5 * (i1**2 - float((c * c).sum())), float(np.linalg.det(deformation))
    y = i1 + i2 - 6.0 * j
    bulk = material.lame_parameter + 2.0 * c1
    # The slope 2 c3 y is capped at -c1.
    most = -c1 / (2.0 * c3) if c3 > 0.0 else np.inf
    of_square = c3 * y**2 if y <= most else c3 * most**2 - c1 * (y - most)
    linear = 2.0 * c1 + 4.0 * c2
    return c1 * (i1 - 3.0) + c2 * (i2 - 3.0) + of_square - linear * (j - 1.0) + 0.5 * bulk * (j - 1.0) ** 2


def uniaxial_stress(material: Material, stretch: float) -> float:
    """Nominal stress of a bar with free sides: the slope of its energy, minimised over the lateral stretch [Pa]."""
    from scipy.optimize import minimize_scalar

    def least(along: float) -> float:
        found = minimize_scalar(
            lambda across: documented_energy(material, np.diag([along, across, across])),
            bounds=(0.8 * along**-0.5, 1.2 * along**-0.5),
            method="bounded",
            options={"xatol": 1e-10},
        )
        return float(found.fun)

    return (least(stretch + DIFFERENCE) - least(stretch - DIFFERENCE)) / (2.0 * DIFFERENCE)


def shear_stress(material: Material, amount: float) -> float:
    """Shear stress of a block in simple shear: the slope of the energy [Pa]."""

    def energy(shear: float) -> float:
        deformation = np.eye(3)
        deformation[0, 2] = shear
        return documented_energy(material, deformation)

    return (energy(amount + DIFFERENCE) - energy(amount - DIFFERENCE)) / (2.0 * DIFFERENCE)
