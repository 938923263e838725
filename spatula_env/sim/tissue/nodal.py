"""What nodes do in a substep, in all worlds of a block: instructions on rows of lanes.

Numba intrinsics, each the body of a loop over nodes in `kernels`. How many lanes there are is told by the type of the
argument `lanes`, a tuple of so many numbers: a kernel is compiled for the lanes it is called with, and for no others.

`docs/tissue.md` has the equations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import intrinsic

from spatula_env.sim.tissue.lanes import Build, Row, cross, dot

C1, C2, TWICE_C3, GREATEST_SLOPE, REST_PRESSURE, BULK, GROWTH, STABILISER, VISCOUS_TIME = range(9)
"""Rows of `materials`: the coefficients c1, c2 and twice c3 of the energy; the greatest value of 2 c3 y; the pressure
2 c1 + 4 c2 that the distortional part has at rest; the bulk coefficient; thrice the growth of |cof F|^2 / 3 from which
on pressure is held back; the modulus that keeps elements from deforming otherwise than the nodes around them tell; and
viscosity by shear modulus [s]."""

MATERIAL_ROWS = 9

NODE_COLUMNS = 6
"""Columns of `nodes`: one over a node's mass, zero where it is held; whether it moves; its share of the volume; and the
gradient of its own shape function, averaged around it."""

PAIR_COLUMNS = 7
"""Columns of `pairs`, of a node and a neighbour: the gradient of the neighbour's shape function, averaged around the
node; that of the node's shape function, averaged around the neighbour; and the integral of the scalar product of the
gradients of both, negative."""

STEP_ROWS = 4
"""Rows of `steps` for a substep: its length [s]; that times stiffness by mass; that times gravity [u/s]; and the part
of a debt that is given back in it."""

LONGEST_THROW = 0.005
"""How far from where it has been held contact is told that a node would be without it [u]. Enough to be found in the
tool; farther, and it might be found on the other side of it."""

GIVEN_BACK = 0.2
"""Of a debt, in a step: at once it would be a blow."""

LEAST_JUMP = 1e-12
"""Contact that changes a node's velocity by less, squared, leaves it alone [u2/s2]."""

LEAST_VOLUME = 0.2
"""Of J, by which the relaxing stress is divided: where tissue is pressed to less, it is not followed exactly."""

SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))
"""Components of a symmetric tensor, in the order in which they are kept."""


def _instructions(emit: Callable[..., None], lanes: Any, *arguments: Any) -> tuple[Any, Callable[..., Any]]:
    """Signature and code of an intrinsic.

    Args:
        emit: Writes the instructions, given the `Build`, and for each array where its elements begin.
        lanes: Type of the tuple that tells how many lanes there are.
        arguments: Types of the others, the first of them a C-contiguous array of reals.
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


def _vector(build: Build, base: Any, node: Any) -> list[Row]:
    """A node's vector, of an array (N, 3, lanes)."""
    return [build.load(build.address(base, node, axis, 3)) for axis in range(3)]


def _numbers(build: Build, base: Any, place: Any, first: int, columns: int) -> list[Row]:
    """Three adjacent numbers of a row of an array, the same in all lanes."""
    return [build.number(base, place, first + k, columns) for k in range(3)]


def _deformation(build: Build, positions: Any, starts: Any, neighbours: Any, pairs: Any, node: Any) -> list[list[Row]]:
    """F at a node, by rows: the sum over neighbours of what is between them times the neighbour's gradient."""
    here, sums = _vector(build, positions, node), [build.sums(3) for _ in range(3)]
    start, end = build.index(starts, node, 0, 1), build.index(starts, node, 1, 1)
    with build.each(start, end) as pair:
        there = _vector(build, positions, build.index(neighbours, pair, 0, 1))
        gradient = _numbers(build, pairs, pair, 0, PAIR_COLUMNS)
        for axis in range(3):
            apart = there[axis] - here[axis]
            for k in range(3):
                sums[axis][k].add(apart, gradient[k])
    return [[entry.row for entry in row] for row in sums]


def _cauchy_green(f: list[list[Row]]) -> list[list[Row]]:
    """C, the product of the transposed F and F."""
    columns = [[f[i][j] for i in range(3)] for j in range(3)]
    upper = {(i, j): dot(columns[i], columns[j]) for i, j in SYMMETRIC}
    return [[upper[min(i, j), max(i, j)] for j in range(3)] for i in range(3)]


def _slope(build: Build, material: Callable[[int], Row], first: Row, second: Row, volume: Row) -> Row:
    """2 c3 y, which is what c1 and c2 are raised by, within its bounds."""
    strain = (first + second).plus(build.constant(-6.0), volume)
    return (material(TWICE_C3) * strain).most(build.constant(0.0)).least(material(GREATEST_SLOPE))


def _emit_stress(
    build: Build,
    positions: Any,
    stresses: Any,
    overstresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    node: Any,
    *,
    general: bool,
) -> None:
    def material(row: int) -> Row:
        return build.load(build.address(materials, None, row, MATERIAL_ROWS))

    f = _deformation(build, positions, starts, neighbours, pairs, node)
    # Row i of the cofactors of F is the vector product of its other two rows.
    cofactors = [cross(f[(i + 1) % 3], f[(i + 2) % 3]) for i in range(3)]
    one, two = build.constant(1.0), build.constant(2.0)
    volume = dot(f[0], cofactors[0])
    flat = [entry for row in cofactors for entry in row]
    second = dot(flat, flat)
    # Beyond this growth the pressure's stiffness is held at what a substep bears.
    hold = one.least(material(GROWTH) / second)
    pressure = material(BULK) * (volume - one) - material(REST_PRESSURE)
    if not general:
        pressure = pressure * hold
        slope = material(C1) * two - material(STABILISER)
        stress = [[(slope * f[i][j]).plus(pressure, cofactors[i][j]) for j in range(3)] for i in range(3)]
    else:
        c = _cauchy_green(f)
        first = (c[0][0] + c[1][1]) + c[2][2]
        slope = _slope(build, material, first, second, volume)
        pressure = pressure.plus(build.constant(-6.0), slope) * hold
        of_second = (material(C2) + slope) * two * hold
        of_first = ((material(C1) + slope) * two - material(STABILISER)).plus(of_second, first)
        # 2 s1 + 2 s2 (I1 - C) less what has relaxed, which F is multiplied by.
        middle = [[-(of_second * c[i][j]) for j in range(3)] for i in range(3)]
        for k, (i, j) in enumerate(SYMMETRIC):
            middle[i][j] = middle[i][j] - build.load(build.address(overstresses, node, k, 6))
            middle[j][i] = middle[i][j]
        for k in range(3):
            middle[k][k] = middle[k][k] + of_first
        stress = [
            [dot(f[i], [middle[k][j] for k in range(3)]).plus(pressure, cofactors[i][j]) for j in range(3)]
            for i in range(3)
        ]
    share = build.number(nodes, node, 2, NODE_COLUMNS)
    for i in range(3):
        for j in range(3):
            build.store(stress[i][j] * share, build.address(stresses, node, 3 * i + j, 9))


def _emit_neo_hookean(build: Build, *given: Any) -> None:
    _emit_stress(build, *given, general=False)


def _emit_general(build: Build, *given: Any) -> None:
    _emit_stress(build, *given, general=True)


@intrinsic
def find_neo_hookean(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    stresses: Any,
    overstresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    node: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Write a node's stress times its volume (N, 9, lanes), where c2 and c3 are zero and nothing relaxes."""
    return _instructions(
        _emit_neo_hookean, lanes, positions, stresses, overstresses, starts, neighbours, pairs, nodes, materials, node
    )


@intrinsic
def find_stress(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    stresses: Any,
    overstresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    node: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Write a node's stress times its volume (N, 9, lanes)."""
    return _instructions(
        _emit_general, lanes, positions, stresses, overstresses, starts, neighbours, pairs, nodes, materials, node
    )


def _force(
    build: Build,
    positions: Any,
    stresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    node: Any,
) -> list[Row]:
    """What the stresses of a node and its neighbours, and the stabiliser, do to the node."""
    here, sums, draws = _vector(build, positions, node), build.sums(3), build.sums(3)
    start, end = build.index(starts, node, 0, 1), build.index(starts, node, 1, 1)
    with build.each(start, end) as pair:
        neighbour = build.index(neighbours, pair, 0, 1)
        there = _vector(build, positions, neighbour)
        gradient = _numbers(build, pairs, pair, 3, PAIR_COLUMNS)
        weight = build.number(pairs, pair, 6, PAIR_COLUMNS)
        for axis in range(3):
            for k in range(3):
                sums[axis].add(build.load(build.address(stresses, neighbour, 3 * axis + k, 9)), gradient[k])
            draws[axis].add(there[axis] - here[axis], weight)
    gradient = _numbers(build, nodes, node, 3, NODE_COLUMNS)
    stabiliser = build.load(build.address(materials, None, STABILISER, MATERIAL_ROWS))
    forces = []
    for axis in range(3):
        total = sums[axis].row
        for k in range(3):
            total = total.plus(build.load(build.address(stresses, node, 3 * axis + k, 9)), gradient[k])
        forces.append((stabiliser * draws[axis].row) - total)
    return forces


def _emit_move(
    build: Build,
    positions: Any,
    velocities: Any,
    leading: Any,
    next_leading: Any,
    stresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    steps: Any,
    node: Any,
    substep: Any,
    touch: tuple[Any, Any, Any] | None = None,
) -> None:
    force = _force(build, leading, stresses, starts, neighbours, pairs, nodes, materials, node)
    length, push, fall, part = (build.load(build.address(steps, substep, row, STEP_ROWS)) for row in range(STEP_ROWS))
    inverse, moves = (build.number(nodes, node, column, NODE_COLUMNS) for column in range(2))
    lead = build.load(build.address(materials, None, VISCOUS_TIME, MATERIAL_ROWS))
    push = push * inverse
    gains = [push * force[axis] for axis in range(3)]
    gains[2] = gains[2].plus(-fall, moves)
    if touch is not None:
        directions, holds, debts = touch
        gains = [gain.plus(part, debt) for gain, debt in zip(gains, _vector(build, debts, node), strict=True)]
        direction = _vector(build, directions, node)
        # What pushes against the contact is held; what leads away from it is not.
        pressed = dot(gains, direction).least(build.constant(0.0))
        for axis in range(3):
            gains[axis] = gains[axis].plus(-pressed, direction[axis])
            at_hold = build.address(holds, node, axis, 3)
            build.store(build.load(at_hold).plus(-pressed, direction[axis]), at_hold)
    for axis in range(3):
        at_velocity, at_position, at_leading = (
            build.address(base, node, axis, 3) for base in (velocities, positions, next_leading)
        )
        velocity = build.load(at_velocity) + gains[axis]
        position = build.load(at_position).plus(length, velocity)
        build.store(velocity, at_velocity)
        build.store(position, at_position)
        build.store(position.plus(lead, velocity), at_leading)


def _emit_move_surface(build: Build, directions: Any, holds: Any, debts: Any, *given: Any) -> None:
    move: Callable[..., None] = _emit_move
    move(build, *given, touch=(directions, holds, debts))


@intrinsic
def move_inner(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    velocities: Any,
    leading: Any,
    next_leading: Any,
    stresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    steps: Any,
    node: Any,
    substep: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Move an inner node on by a substep, and write where forces will be taken at in the next one."""
    return _instructions(
        _emit_move, lanes, positions, velocities, leading, next_leading, stresses, starts, neighbours, pairs, nodes,
        materials, steps, node, substep,
    )  # fmt: skip


@intrinsic
def move_surface(
    typing_context: Any,
    lanes: Any,
    directions: Any,
    holds: Any,
    debts: Any,
    positions: Any,
    velocities: Any,
    leading: Any,
    next_leading: Any,
    stresses: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    nodes: Any,
    materials: Any,
    steps: Any,
    node: Any,
    substep: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Move a surface node on by a substep, held by what it touches."""
    return _instructions(
        _emit_move_surface, lanes, directions, holds, debts, positions, velocities, leading, next_leading, stresses,
        starts, neighbours, pairs, nodes, materials, steps, node, substep,
    )  # fmt: skip


def _throw_time(build: Build, hold: list[Row], dt: Any) -> Row:
    """How long a node that was held is let fly for contact: a step, or until `LONGEST_THROW`."""
    squared = dot(hold, hold)
    longest = build.constant(LONGEST_THROW) / squared.most(build.constant(LEAST_JUMP)).root()
    return longest.least(build.spread(dt))


def _emit_take_contact(
    build: Build,
    positions: Any,
    velocities: Any,
    free_velocities: Any,
    directions: Any,
    holds: Any,
    debts: Any,
    dt: Any,
    node: Any,
) -> None:
    velocity, hold = _vector(build, velocities, node), _vector(build, holds, node)
    jump = [v - free for v, free in zip(velocity, _vector(build, free_velocities, node), strict=True)]
    squared, none = dot(jump, jump), build.constant(0.0)
    time = _throw_time(build, hold, dt)
    is_free = squared.is_less(build.constant(LEAST_JUMP))
    inverse = build.choose(is_free, none, build.constant(1.0) / squared.root())
    for axis in range(3):
        at_position, at_velocity, at_direction, at_hold, at_debt = (
            build.address(base, node, axis, 3) for base in (positions, velocities, directions, holds, debts)
        )
        build.store(jump[axis] * inverse, at_direction)
        # A node that nothing holds any more was held for one step too long, which it is given back by and by.
        owed = build.choose(is_free, hold[axis], none)
        build.store(build.load(at_position).plus(owed, time), at_position)
        build.store(velocity[axis] + owed, at_velocity)
        build.store((build.load(at_debt) * build.constant(1.0 - GIVEN_BACK)) - owed, at_debt)
        build.store(none, at_hold)


@intrinsic
def take_contact(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    velocities: Any,
    free_velocities: Any,
    directions: Any,
    holds: Any,
    debts: Any,
    dt: Any,
    node: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Find in which direction contact has changed a surface node's velocity, and let go what it leaves alone."""
    return _instructions(
        _emit_take_contact, lanes, positions, velocities, free_velocities, directions, holds, debts, dt, node
    )


def _emit_give_free(
    build: Build, positions: Any, velocities: Any, free_velocities: Any, holds: Any, dt: Any, node: Any
) -> None:
    hold = _vector(build, holds, node)
    time = _throw_time(build, hold, dt)
    for axis in range(3):
        at_position, at_velocity, at_free = (
            build.address(base, node, axis, 3) for base in (positions, velocities, free_velocities)
        )
        velocity = build.load(at_velocity) - hold[axis]
        build.store(velocity, at_velocity)
        build.store(velocity, at_free)
        build.store(build.load(at_position).plus(-hold[axis], time), at_position)


@intrinsic
def give_free(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    velocities: Any,
    free_velocities: Any,
    holds: Any,
    dt: Any,
    node: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Put a surface node where it would be had nothing held it, for contact to hold it again."""
    return _instructions(_emit_give_free, lanes, positions, velocities, free_velocities, holds, dt, node)


def _emit_lead(build: Build, positions: Any, velocities: Any, leading: Any, materials: Any, node: Any) -> None:
    lead = build.load(build.address(materials, None, VISCOUS_TIME, MATERIAL_ROWS))
    for axis in range(3):
        at_position, at_velocity, at_leading = (
            build.address(base, node, axis, 3) for base in (positions, velocities, leading)
        )
        build.store(build.load(at_position).plus(lead, build.load(at_velocity)), at_leading)


@intrinsic
def lead_node(
    typing_context: Any, lanes: Any, positions: Any, velocities: Any, leading: Any, materials: Any, node: Any
) -> tuple[Any, Callable[..., Any]]:
    """Write where forces on a node will be taken at, from where it is and how it moves."""
    return _instructions(_emit_lead, lanes, positions, velocities, leading, materials, node)


def _emit_relax(
    build: Build,
    positions: Any,
    overstresses: Any,
    histories: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    materials: Any,
    relaxation: Any,
    terms: Any,
    node: Any,
) -> None:
    def material(row: int) -> Row:
        return build.load(build.address(materials, None, row, MATERIAL_ROWS))

    f = _deformation(build, positions, starts, neighbours, pairs, node)
    cofactors = [cross(f[(i + 1) % 3], f[(i + 2) % 3]) for i in range(3)]
    volume = dot(f[0], cofactors[0])
    c = _cauchy_green(f)
    first = (c[0][0] + c[1][1]) + c[2][2]
    flat = [entry for row in cofactors for entry in row]
    two, slope = build.constant(2.0), _slope(build, material, first, dot(flat, flat), volume)
    of_second = (material(C2) + slope) * two
    of_first = ((material(C1) + slope) * two).plus(of_second, first)
    # The inverse of C is the product of the transposed cofactors and the cofactors, by J squared.
    inward = -(material(REST_PRESSURE).plus(build.constant(6.0), slope) / volume.most(build.constant(LEAST_VOLUME)))
    stress = []
    for i, j in SYMMETRIC:
        entry = inward * dot([cofactors[k][i] for k in range(3)], [cofactors[k][j] for k in range(3)])
        entry = entry.plus(-of_second, c[i][j])
        stress.append(entry + of_first if i == j else entry)
    sums = build.sums(6)
    with build.each(build.whole(0), terms) as term:
        keep, share = (build.load(build.address(relaxation, term, row, 2)) for row in range(2))
        place = build.builder.add(build.builder.mul(node, terms), term)
        for k in range(6):
            at = build.address(histories, place, k, 6)
            # What the stress has become to which this term has relaxed.
            history = stress[k].plus(keep, build.load(at) - stress[k])
            build.store(history, at)
            sums[k].add(share, history)
    for k in range(6):
        build.store(sums[k].row, build.address(overstresses, node, k, 6))


@intrinsic
def relax_node(
    typing_context: Any,
    lanes: Any,
    positions: Any,
    overstresses: Any,
    histories: Any,
    starts: Any,
    neighbours: Any,
    pairs: Any,
    materials: Any,
    relaxation: Any,
    terms: Any,
    node: Any,
) -> tuple[Any, Callable[..., Any]]:
    """Let a node's stress relax for a step: write the histories (N, terms, 6, lanes) and their sum (N, 6, lanes)."""
    return _instructions(
        _emit_relax, lanes, positions, overstresses, histories, starts, neighbours, pairs, materials, relaxation,
        terms, node,
    )  # fmt: skip
