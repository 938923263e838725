"""What the instructions for nodes share: the columns of their tables, and F and the quantities derived from it.

`stress`, `motion` and `held` have the intrinsics. The type of the argument `lanes`, a tuple with one number per lane,
gives the number of lanes: a kernel is compiled for the number that it is called with, and for no other.

`docs/tissue.md` has the equations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types

from spatula_env.sim.tissue.lanes import Build, Row, dot

C1, C2, TWICE_C3, GREATEST_SLOPE, REST_PRESSURE, BULK, GROWTH, STABILISER, VISCOUS_TIME = range(9)
"""Rows of `materials`: the coefficients c1, c2 and twice c3 of the energy; the greatest value of 2 c3 y; the pressure
2 c1 + 4 c2 that the distortional part has at rest; the bulk coefficient; three times the growth of |cof F|^2 / 3 beyond
which pressure is limited; the modulus of the stabiliser; and viscosity divided by shear modulus [s]."""

MATERIAL_ROWS = 9

NODE_COLUMNS = 6
"""Columns of `nodes`: one over a node's mass, zero where it is held; whether it moves; its share of the volume; and the
gradient of its own shape function, averaged around it."""

PAIR_COLUMNS = 7
"""Columns of `pairs`, of a node and a neighbour: the gradient of the neighbour's shape function, averaged around the
node; that of the node's shape function, averaged around the neighbour; and the integral of the scalar product of the
gradients of both, negative."""

STEP_ROWS = 4
"""Rows of `steps` for a substep: its length [s]; the length times the factor on stiffness per mass [s]; the length
times gravity [u/s]; and the share of a debt that is given back in it."""

SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
"""Components of a symmetric tensor, in the order in which they are kept."""


def instructions(emit: Callable[..., None], lanes: Any, *arguments: Any) -> tuple[Any, Callable[..., Any]]:
    """Signature and code generator of an intrinsic.

    Args:
        emit: Emits the instructions, given the `Build` and the arguments; for each array, a pointer to its elements.
        lanes: Type of the tuple that gives the number of lanes.
        arguments: Types of the other arguments, the first of them a C-contiguous array of reals.
    """
    signature = types.void(lanes, *arguments)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        build = Build(context, builder, signature.args[1], signature.args[0].count)
        given = [
            build.data(kind, value) if isinstance(kind, types.Array) else value
            for kind, value in zip(signature.args[1:], values[1:], strict=True)
        ]
        emit(build, *given)
        return context.get_dummy_value()

    return signature, generate


def vector(build: Build, base: Any, node: Any) -> list[Row]:
    """A node's vector, of an array (N, 3, lanes)."""
    return [build.load(build.address(base, node, axis, 3)) for axis in range(3)]


def numbers(build: Build, base: Any, place: Any, first: int, columns: int) -> list[Row]:
    """Three adjacent numbers of a row of an array, the same in all lanes."""
    return [build.number(base, place, first + k, columns) for k in range(3)]


def deformation(build: Build, positions: Any, starts: Any, neighbours: Any, pairs: Any, node: Any) -> list[list[Row]]:
    """F at a node, by rows: the sum over neighbours of the distance vector times the neighbour's gradient."""
    here, sums = vector(build, positions, node), [build.sums(3) for _ in range(3)]
    start, end = build.index(starts, node, 0, 1), build.index(starts, node, 1, 1)
    with build.each(start, end) as pair:
        there = vector(build, positions, build.index(neighbours, pair, 0, 1))
        gradient = numbers(build, pairs, pair, 0, PAIR_COLUMNS)
        for axis in range(3):
            apart = there[axis] - here[axis]
            for k in range(3):
                sums[axis][k].add(apart, gradient[k])
    return [[entry.row for entry in row] for row in sums]


def cauchy_green(f: list[list[Row]]) -> list[list[Row]]:
    """C, the product of the transposed F and F."""
    columns = [[f[i][j] for i in range(3)] for j in range(3)]
    upper = {(i, j): dot(columns[i], columns[j]) for i, j in SYMMETRIC}
    return [[upper[min(i, j), max(i, j)] for j in range(3)] for i in range(3)]


def stiffening(build: Build, material: Callable[[int], Row], first: Row, second: Row, volume: Row) -> Row:
    """2 c3 y within its bounds, by which c1 and c2 are raised."""
    strain = (first + second).plus(build.constant(-6.0), volume)
    return (material(TWICE_C3) * strain).most(build.constant(0.0)).least(material(GREATEST_SLOPE))
