"""How hard a linear-elastic solid is to push, by finite elements: `python scripts/elastic_solid.py`, JSON last.

`scripts/calibrate_stiffness.py` compares the organs with solids. For a plate on a half-space there is a formula; for a
blade against the wall of a fissure or the side of a fold, and for jaws on a ridge, there is none, so the factors come
from here: force on the
tool over (Young's modulus times displacement), a length [u]. The plate on a half-space is here as well, as a check of
the elements.

Boxes of eight nodes on a grid; the dilatation is taken as constant in an element, so that nearly incompressible solids
do not lock (B-bar; T. J. R. Hughes, The Finite Element Method, 1987, section 4.5). The edges of a punch are singular:
the error is proportional to the size of the elements there, and two sizes give the limit. It takes about two minutes
and needs SciPy.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray


POISSON = 0.49
"""Poisson's ratio: soft tissue is nearly incompressible."""

GROWTH = 1.25
"""By how much an element is longer than its neighbour, away from the tool."""

NEAR = 1e-6
"""Closer than this, coordinates are the same [u]."""


@dataclass(frozen=True)
class Push:
    """What is held and what is pushed. Masks are over the nodes' coordinates, (N, 3) each.

    Attributes:
        held: Displacements that are given.
        pushed: Those of them that are -1, as the tool moves; the others are zero.
        symmetry: How many such pieces make the whole.
    """

    held: BoolArray
    pushed: BoolArray
    symmetry: int


def grid(points: list[float], sizes: list[float], largest: float = 0.5) -> FloatArray:
    """Coordinates along an axis, finer in some parts.

    Args:
        points: Ascending; each is a coordinate of the grid.
        sizes: Of the elements between each two of them: positive, the same for all; negative, its value at the
            start, and growing; zero, the mirror image: shrinking to the size that follows.
        largest: No element is larger.
    """
    made = [points[0]]
    for index, (start, stop) in enumerate(itertools.pairwise(points)):
        size, length = sizes[index], stop - start
        if size > 0.0:
            made += list(np.linspace(start, stop, max(1, round(length / size)) + 1)[1:])
            continue
        steps = [abs(size) if size < 0.0 else abs(sizes[index + 1])]
        while sum(steps) < length - NEAR:
            steps.append(min(steps[-1] * GROWTH, largest))
        along = np.cumsum(steps) * length / sum(steps)
        made += list(start + along) if size < 0.0 else [*(stop - along[::-1][1:]), stop]
    return np.array(made)


def element_stiffness(size: FloatArray, poisson: float) -> FloatArray:
    """Stiffness matrix of a box of Young's modulus 1.

    Args:
        size: (3,) of its edges.
        poisson: Poisson's ratio.

    Returns:
        (24, 24), nodes outermost; the first coordinate of a node runs fastest.
    """
    shear = 0.5 / (1.0 + poisson)
    bulk = 1.0 / (3.0 * (1.0 - 2.0 * poisson))
    material = shear * np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    material[:3, :3] -= 2.0 / 3.0 * shear
    corners = np.array([corner[::-1] for corner in itertools.product((-1.0, 1.0), repeat=3)])
    volume = float(size.prod())
    stiffness, mean_dilatation = np.zeros((24, 24)), np.zeros(24)
    for point in itertools.product((-1.0 / math.sqrt(3.0), 1.0 / math.sqrt(3.0)), repeat=3):
        factors = 1.0 + corners * point
        slopes = np.stack(
            [corners[:, k] * np.delete(factors, k, axis=1).prod(axis=1) * 0.25 / size[k] for k in range(3)], axis=1
        )
        strain = np.zeros((6, 24))
        for k in range(3):
            strain[k, k::3] = slopes[:, k]
        for row, (a, b) in enumerate(((0, 1), (1, 2), (2, 0)), start=3):
            strain[row, a::3], strain[row, b::3] = slopes[:, b], slopes[:, a]
        stiffness += strain.T @ material @ strain * volume / 8.0
        mean_dilatation += slopes.ravel() / 8.0
    return stiffness + bulk * volume * np.outer(mean_dilatation, mean_dilatation)


def resistance(
    axes: tuple[FloatArray, FloatArray, FloatArray],
    inside: Callable[[FloatArray, FloatArray, FloatArray], BoolArray],
    push: Callable[[FloatArray], Push],
    poisson: float = POISSON,
) -> float:
    """Force on a tool without friction that moves by one unit into a solid of Young's modulus 1.

    Args:
        axes: Coordinates of the grid along x, y and z [u].
        inside: Which of the boxes, given by the coordinates of their centres, are there.
        push: From the nodes (N, 3) to what is held and pushed.
        poisson: Poisson's ratio.

    Returns:
        The force over the modulus and the displacement [u].
    """
    from scipy.sparse import coo_matrix, diags
    from scipy.sparse.linalg import cg

    centres = np.meshgrid(*[0.5 * (axis[1:] + axis[:-1]) for axis in axes], indexing="ij")
    cells = np.argwhere(inside(*centres))
    shape = tuple(len(axis) for axis in axes)
    corners = np.array([corner[::-1] for corner in itertools.product((0, 1), repeat=3)])
    numbers = np.ravel_multi_index(tuple((cells[:, None] + corners).transpose(2, 0, 1)), shape)
    used, nodes_of = np.unique(numbers, return_inverse=True)
    nodes = np.stack([axis[index] for axis, index in zip(axes, np.unravel_index(used, shape), strict=True)], axis=1)
    sizes = np.stack([np.diff(axis)[cells[:, k]] for k, axis in enumerate(axes)], axis=1)
    kinds, kind = np.unique(sizes.round(9), axis=0, return_inverse=True)
    stiffnesses = np.array([element_stiffness(size, poisson) for size in kinds])[kind.ravel()]
    unknowns = (nodes_of.reshape(-1, 8, 1) * 3 + np.arange(3)).reshape(-1, 24)
    count = 3 * len(nodes)
    rows, columns = np.repeat(unknowns, 24, axis=1), np.tile(unknowns, (1, 24))
    matrix = coo_matrix((stiffnesses.ravel(), (rows.ravel(), columns.ravel())), shape=(count, count)).tocsr()

    given = push(nodes)
    held, pushed = given.held.ravel(), given.pushed.ravel()
    displacements = np.where(pushed, -1.0, 0.0)
    free = ~held
    reduced = matrix[free][:, free]
    solution, failed = cg(
        reduced, -(matrix @ displacements)[free], rtol=1e-8, maxiter=20_000, M=diags(1.0 / reduced.diagonal())
    )
    if failed:
        raise RuntimeError("the solve did not converge")
    displacements[free] = solution
    # Twice the energy of a tool that has moved by one unit. An iterative solve gets the energy right to the square of
    # what it leaves of the forces, and what it leaves depends on the processor.
    return float(displacements @ (matrix @ displacements) * given.symmetry)


def _planes(nodes: FloatArray, *planes: tuple[int, float]) -> BoolArray:
    """(N, 3) of nodes in planes across an axis, which do not leave them."""
    held = np.zeros(nodes.shape, dtype=np.bool_)
    for axis, value in planes:
        held[np.abs(nodes[:, axis] - value) < NEAR, axis] = True
    return held


def half_space(size: float, half: float = 0.5, extent: float = 12.0) -> float:
    """The plate, 1 u square, on a large cube: a quarter of it.

    Args:
        size: Of the elements under the plate [u].
        half: Half an edge of the plate [u].
        extent: Of the quarter, and its depth [u].
    """
    across = grid([0.0, half + 0.25, extent], [size, -size], 2.0)

    def push(nodes: FloatArray) -> Push:
        held = _planes(nodes, (0, 0.0), (1, 0.0))
        held[nodes[:, 2] < NEAR - extent] = True
        under = (nodes[:, 2] > -NEAR) & (nodes[:, :2] < half + NEAR).all(axis=1)
        pushed = np.zeros_like(held)
        pushed[under, 2] = True
        return Push(held | pushed, pushed, 4)

    return resistance((across, across, -across[::-1]), lambda x, y, z: x < math.inf, push)


def fissure_wall(size: float, fixed_floor: bool = True, lip: float = 0.2) -> float:
    """The blade, 1 u wide, 0.25 u above the floor, against a wall of the block of `scenes.fissure`: half of it.

    Args:
        size: Of the elements near the blade [u].
        fixed_floor: Whether the fissure's floor is held, as in the scene.
        lip: Radius of the rounded edge where the wall meets the top [u].
    """
    wall, bottom = 0.125, 1.4
    x = grid([0.0, 0.75, 1.5, 3.0], [size, size, -size])
    side = grid([wall, wall + lip, 2.5], [size, -size])
    y = np.concatenate([-side[::-1], side])
    z = grid([0.0, bottom, bottom + 0.25, 3.0 - lip, 3.0], [0.0, size, size, size])

    def inside(x: FloatArray, y: FloatArray, z: FloatArray) -> BoolArray:
        beside = np.abs(y) - wall
        rounded = (beside < lip) & (z > 3.0 - lip) & (np.hypot(lip - beside, z - 3.0 + lip) > lip)
        return ~((x < 1.5) & (((beside < 0.0) & (z > bottom)) | rounded))

    def push(nodes: FloatArray) -> Push:
        held = _planes(nodes, (0, 0.0))
        held[nodes[:, 2] < NEAR] = True
        if fixed_floor:
            floor = (np.abs(nodes[:, 2] - bottom) < NEAR) & (np.abs(nodes[:, 1]) < wall + NEAR)
            held[floor & (nodes[:, 0] < 1.5 + NEAR)] = True
        on_wall = (np.abs(nodes[:, 1] + wall) < NEAR) & (nodes[:, 0] < 0.5 + NEAR)
        on_wall &= (nodes[:, 2] > bottom + 0.25 - NEAR) & (nodes[:, 2] < 3.0 - lip + NEAR)
        pushed = np.zeros_like(held)
        pushed[on_wall, 1] = True
        return Push(held | pushed, pushed, 2)

    return resistance((x, y, z), inside, push)


def ridge(size: float) -> float:
    """Two jaws, 1.2 x 0.8 u, against the ridge of `scenes.clamp`, each moving by one unit: a quarter of it.

    Args:
        size: Of the elements near the jaws [u].
    """
    x = grid([0.0, 0.6, 1.0, 2.0], [size, size, -size])
    y = grid([0.0, 0.4, 1.6], [size, -size])
    z = grid([0.0, 1.2, 1.5, 2.3, 2.5], [0.0, size, size, size])

    def push(nodes: FloatArray) -> Push:
        held = _planes(nodes, (0, 0.0), (1, 0.0), (2, 0.0))
        flank = (np.abs(nodes[:, 1] - 0.4) < NEAR) & (nodes[:, 0] < 0.6 + NEAR)
        flank &= (nodes[:, 2] > 1.5 - NEAR) & (nodes[:, 2] < 2.3 + NEAR)
        pushed = np.zeros_like(held)
        pushed[flank, 1] = True
        return Push(held | pushed, pushed, 2)

    return resistance((x, y, z), lambda x, y, z: (z < 1.2) | ((y < 0.4) & (x < 1.0)), push)


def fold(size: float) -> float:
    """The blade, 1 u wide, 0.35 u above the foot, against one side of the fold of `scenes.retract`: half of it.

    Args:
        size: Of the elements near the blade [u].
    """
    x = grid([0.0, 0.5, 1.2, 1.6], [size, size, -size])
    side = grid([0.45, 1.5], [-size])
    y = np.concatenate([-side[::-1], np.linspace(-0.45, 0.45, round(0.9 / size) + 1)[1:-1], side])
    z = grid([0.0, 0.8, 1.15, 1.975, 2.2], [0.0, size, size, size])

    def push(nodes: FloatArray) -> Push:
        held = _planes(nodes, (0, 0.0))
        held[nodes[:, 2] < NEAR] = True
        flank = (np.abs(nodes[:, 1] - 0.45) < NEAR) & (nodes[:, 0] < 0.5 + NEAR)
        flank &= (nodes[:, 2] > 1.15 - NEAR) & (nodes[:, 2] < 1.975 + NEAR)
        pushed = np.zeros_like(held)
        pushed[flank, 1] = True
        return Push(held | pushed, pushed, 2)

    return resistance((x, y, z), lambda x, y, z: (z < 0.8) | ((np.abs(y) < 0.45) & (x < 1.2)), push)


CASES: dict[str, tuple[Callable[[float], float], tuple[float, float]]] = {
    "half_space": (half_space, (0.125, 0.0625)),
    "fissure": (fissure_wall, (0.1, 0.05)),
    "fissure_free_floor": (lambda size: fissure_wall(size, fixed_floor=False), (0.1, 0.05)),
    "clamp": (ridge, (0.1, 0.05)),
    "retract": (fold, (0.1, 0.05)),
}
"""What is pushed, and the sizes of the elements [u]."""


def main() -> None:
    """Solve all cases and print them."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None).parse_args()
    results = {}
    for name, (solve, sizes) in CASES.items():
        coarse, fine = (solve(size) for size in sizes)
        ratio = sizes[0] / sizes[1]
        # The error is proportional to the size of the elements.
        limit = (ratio * fine - coarse) / (ratio - 1.0)
        results[name] = {"sizes": sizes, "values": [coarse, fine], "limit": limit}
        print(f"{name}: {coarse:.3f} and {fine:.3f} u, in the limit {limit:.3f} u", flush=True)
    print(json.dumps({"poisson": POISSON, "factors": results}))


if __name__ == "__main__":
    main()
