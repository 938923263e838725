"""Stiffness of linear-elastic solids against tools, by finite elements: `python scripts/elastic_solid.py`, JSON last.

`scripts/calibrate_stiffness.py` compares the organs with elastic solids. For a plate on a half-space there is a
formula. For a blade against the wall of a fissure or the side of a fold, and for jaws on a ridge, there is none, so
their factors are computed here: force on the tool over Young's modulus times displacement, a length [u]. The plate on a
half-space is included as a check of the elements.

The elements are boxes of eight nodes on a grid. The dilatation is constant in an element, so that nearly incompressible
solids do not lock (B-bar; T. J. R. Hughes, The Finite Element Method, 1987, section 4.5). The stress is singular at the
edges of a punch, where the error is proportional to the size of the elements: two sizes are extrapolated to the limit.
It takes about two minutes and needs SciPy.
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
"""Ratio of the lengths of successive elements, away from the tool."""

NEAR = 1e-6
"""Coordinates that differ by less than this count as equal [u]."""


@dataclass(frozen=True)
class Push:
    """Boundary conditions; masks are over the nodes' coordinates, (N, 3) each.

    Attributes:
        held: Coordinates with prescribed displacements.
        pushed: Those of them that the tool displaces, by -1; the others are held at zero.
        symmetry: Number by which the force on the meshed piece is multiplied.
    """

    held: BoolArray
    pushed: BoolArray
    symmetry: int


def grid(points: list[float], sizes: list[float], largest: float = 0.5) -> FloatArray:
    """Coordinates of a grid along an axis, finer in some intervals.

    Args:
        points: Ends of the intervals, ascending; each is a coordinate of the grid.
        sizes: Size of the elements in each interval. Positive: uniform. Negative: its magnitude is the size at the
            start, and elements grow by `GROWTH`. Zero: elements shrink to the size of the next interval.
        largest: Greatest size of a growing or shrinking element, before all are scaled to fit the interval.
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
        size: (3,) lengths of its edges.
        poisson: Poisson's ratio.

    Returns:
        (24, 24) matrix, with three consecutive rows per node; nodes are ordered with their first coordinate fastest.
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
    """Force on a frictionless tool that moves by one unit into a solid of Young's modulus 1.

    Args:
        axes: Coordinates of the grid along x, y and z [u].
        inside: Maps coordinates of the centres of boxes to whether these belong to the solid.
        push: Maps the nodes (N, 3) to boundary conditions.
        poisson: Poisson's ratio.

    Returns:
        The force over the modulus and the displacement [u].

    Raises:
        RuntimeError: If the linear solve does not converge.
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
    # The force on a tool that has moved by one unit is twice the energy. The energy's error is quadratic in the
    # residual of the iterative solve, which depends on the processor.
    return float(displacements @ (matrix @ displacements) * given.symmetry)


def _planes(nodes: FloatArray, *planes: tuple[int, float]) -> BoolArray:
    """(N, 3) mask of the displacements across planes, each an axis and a coordinate, of the nodes on them."""
    held = np.zeros(nodes.shape, dtype=np.bool_)
    for axis, value in planes:
        held[np.abs(nodes[:, axis] - value) < NEAR, axis] = True
    return held


def half_space(size: float, half: float = 0.5, extent: float = 12.0) -> float:
    """The square plate, 1 u wide, on a large block, of which a quarter is meshed.

    Args:
        size: Size of the elements under the plate [u].
        half: Half an edge of the plate [u].
        extent: Width and depth of the quarter [u].
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
    """The blade, 1 u wide, 0.25 u above the floor, against a wall of the block of `scenes.fissure`; half is meshed.

    Args:
        size: Size of the elements near the blade [u].
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
    """Two jaws, 1.2 x 0.8 u, against the ridge of `scenes.clamp`, each moving by one unit; a quarter is meshed.

    Args:
        size: Size of the elements near the jaws [u].
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
    """The blade, 1 u wide, 0.35 u above the foot, against one side of the fold of `scenes.retract`; half is meshed.

    Args:
        size: Size of the elements near the blade [u].
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
"""For each case the function that solves it, and the two sizes of elements [u]."""


def main() -> None:
    """Solve all cases and print them."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None).parse_args()
    results = {}
    for name, (solve, sizes) in CASES.items():
        coarse, fine = (solve(size) for size in sizes)
        ratio = sizes[0] / sizes[1]
        # Richardson extrapolation: the error is proportional to the size of the elements.
        limit = (ratio * fine - coarse) / (ratio - 1.0)
        results[name] = {"sizes": sizes, "values": [coarse, fine], "limit": limit}
        print(f"{name}: {coarse:.3f} and {fine:.3f} u, in the limit {limit:.3f} u", flush=True)
    print(json.dumps({"poisson": POISSON, "factors": results}))


if __name__ == "__main__":
    main()
