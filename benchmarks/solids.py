"""Solids for checks of tissue: blocks of tetrahedra, spheres, and where a solid is in equilibrium.

The energy is written here once more from `docs/tissue.md`, and stresses are its differences, so that what the package
computes is not checked against itself.
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
"""By how much of a cell inner nodes of a block are moved, so that its tetrahedra are irregular."""

DIFFERENCE = 1e-5
"""Of a stretch, for slopes of the energy."""

SETTLED = 1e-6
"""Greatest force on a free node in equilibrium, by the greatest on a held one."""


def block(size: FloatArray, cells: tuple[int, int, int]) -> Solid:
    """A block of so many cells, each divided into six tetrahedra, its inner nodes moved at random.

    Args:
        size: (3,) edges [u]; one corner is the origin.
        cells: Along each of them.
    """
    counts = np.array(cells) + 1
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), axis=-1).reshape(-1, 3)
    inner = np.asarray(((grid > 0) & (grid < counts - 1)).all(axis=1))
    moved = grid + inner[:, None] * np.random.default_rng(0).uniform(-JITTER, JITTER, grid.shape)
    corners = grid[(grid < counts - 1).all(axis=1)]
    tetrahedra = []
    # After H. W. Kuhn: along three edges from one corner to the opposite one, in each of the six orders.
    for order in itertools.permutations(range(3)):
        steps = np.cumsum(np.concatenate([np.zeros((1, 3), dtype=np.int64), np.eye(3, dtype=np.int64)[list(order)]]), 0)
        path = corners[:, None] + steps
        indices = np.ravel_multi_index(tuple(np.moveaxis(path, -1, 0)), tuple(counts))
        even = np.linalg.det(np.eye(3)[list(order)]) > 0.0
        tetrahedra.append(indices if even else indices[:, [0, 2, 1, 3]])
    return Solid(moved * np.asarray(size) / cells, np.concatenate(tetrahedra).astype(np.int32))


def graded_sphere(radius: float, subdivisions: int, grading: float = 0.0) -> Organ:
    """A sphere of triangles that are smaller at both poles of its z axis.

    Args:
        radius: [u].
        subdivisions: See `icosphere`.
        grading: 0: all alike; below 0.5. Near the poles edges are shorter by the factor 1 - 2 grading.
    """
    sphere = icosphere(radius, subdivisions)
    x, y, z = sphere.vertices.T
    polar, around = np.arccos(np.clip(z / radius, -1.0, 1.0)), np.arctan2(y, x)
    polar -= grading * np.sin(2.0 * polar)
    places = np.column_stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)])
    return Organ(radius * places, sphere.triangles, "sphere")


def equilibrium(
    solid: Solid, law: Hyperelastic, start: FloatArray, free: BoolArray, iterations: int = 4000
) -> tuple[FloatArray, FloatArray]:
    """Where a solid rests, some coordinates of its nodes being given.

    Args:
        solid: The solid.
        law: What it is made of.
        start: (N, 3) where nodes are at first; those coordinates that are not free stay [u].
        free: (N, 3) which coordinates are free.
        iterations: At most.

    Returns:
        (N, 3) positions [u], and (N, 3) what the solid does to its nodes there, zero for free coordinates.

    Raises:
        ImportError: If SciPy is not installed.
        RuntimeError: If it does not come to rest.
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
    # It ends where rounding lets energy fall no more.
    minimize(energy, start[free], jac=True, method="L-BFGS-B", options=options)
    forces = solid.forces(law.stress(solid.deformations(nodes)), nodes, stabiliser)
    left, greatest = np.abs(forces[free]).max(initial=0.0), np.abs(forces[~free]).max()
    if not left <= SETTLED * greatest * 100.0:
        raise RuntimeError(f"a solid has not come to rest: {left / greatest:.2g} of the greatest force is left")
    return nodes, forces


def documented_energy(material: Material, deformation: FloatArray) -> float:
    """The energy by volume at rest, as `docs/tissue.md` has it [Pa].

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
    # Where 2 c3 y would exceed -c1 it stays there.
    most = -c1 / (2.0 * c3) if c3 > 0.0 else np.inf
    of_square = c3 * y**2 if y <= most else c3 * most**2 - c1 * (y - most)
    linear = 2.0 * c1 + 4.0 * c2
    return c1 * (i1 - 3.0) + c2 * (i2 - 3.0) + of_square - linear * (j - 1.0) + 0.5 * bulk * (j - 1.0) ** 2


def uniaxial_stress(material: Material, stretch: float) -> float:
    """Nominal stress of a bar whose sides are free: the slope of the least energy of all widths [Pa]."""
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
