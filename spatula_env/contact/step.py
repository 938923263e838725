"""All contacts of one physics step: divide the step into queries, resolve each, and sum the impulses on the organs."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types

from spatula_env._kernels import ARRAYS, array_kernel, inline_kernel, kernel
from spatula_env.contact import skin
from spatula_env.contact.depth import pair_depth
from spatula_env.contact.edge_depth import depth_of_edges, edge_depth
from spatula_env.contact.energy import keep_passive
from spatula_env.contact.flags import fill_local, fill_rotation
from spatula_env.contact.islands import find_islands, island_room
from spatula_env.contact.motion import (
    MOTIONS,
    ORGAN_MOTION,
    STEP_OUTCOME,
    copy_points,
    largest_shift,
    tool_passes,
    turn_between,
)
from spatula_env.contact.multipliers import (
    add_passed,
    expect_vertices,
    greatest_kept_depth,
    keep_for_next,
    start_warm,
    sum_passed,
)
from spatula_env.contact.query import (
    QueryPlan,
    QueryPoints,
    QueryTools,
    begin_query,
    detect,
    measure_tools,
    pose_tools,
    remember_poses,
    resolve_query,
)
from spatula_env.contact.response import OVER_RELAXATION, measure_gaps, solve_velocities, start_pushed, sum_impulses
from spatula_env.contact.self_contact import prepare_pairs, remember_sides
from spatula_env.contact.settings import (
    CONTACT_COUNT,
    CROSSED_FOR,
    CROSSINGS,
    DT,
    IS_FREE,
    KEEPS_APART,
    MEAN_EDGE,
    MEAN_INVERSE_MASS,
    QUERIES,
    RESIDUAL,
    STOPPED,
)
from spatula_env.contact.structures import IMPULSE, NO_PAIR, WORLD_CONTACTS, reserve

F8_2 = ARRAYS["f8_2"]

VELOCITY_TOLERANCE = 1e-3
"""The velocity solve ends when a sweep changes no constrained point's velocity by more than this [u/s]."""

MOST_SWEEPS = 200
"""Most sweeps of one position solve under a tool that holds still. Where these do not suffice, friction acts at more
points than the organ has vertices there, its forces are not unique, and many times as many sweeps do not settle them
either."""

MOST_SWEEPS_MOVING = 25
"""Most sweeps of one position solve where a tool moves farther than `SLOW` in a step: its contacts change from step to
step, and each solve starts from the result of the last one."""

MOST_SWEEPS_DIVIDED = 50
"""Most sweeps of one position or velocity solve in a step that is divided into several queries."""

MOST_SWEEPS_VELOCITY = 25
"""Most sweeps of the velocity solve in a step that is not divided. It starts from the result of the position solve, and
more sweeps change neither the forces nor how still a held organ is."""

SLOW = 1e-3
"""Greatest motion of a tool in a step that still counts as holding still [u]."""

PATH_PART = 0.5
"""Greatest motion of a tool between two queries, as a multiple of its thickness."""

MOST_QUERIES = 4096
"""Most parts into which the tools' paths are divided, so that no step takes long: enough for a sheet of 0.02 u at 9,800
u/s. A thinner sheet at such a speed moves farther between two queries."""

ORGAN_PART = 0.5
"""Greatest motion of an organ's node between two queries, in mean edges of the organ."""

MOST_PARTS = 4
"""If the organ's motion divides a step into at most this many parts, its positions are predicted from the last step's
contacts only if those have held (see `GREATEST_DEPTH_KEPT`)."""

GREATEST_DEPTH_KEPT = 2e-3
"""Greatest depth of the surface at the end of a step at which its contacts count as having held it [u]."""

STOPPING_DEPTH = 8e-3
"""A step stops the tools if it would leave them deeper in the organs than this and they were not so deep before [u]."""

STOPPING_WAY = 0.5
"""Tools are not stopped in a step in which a point of a tool moves farther than this, in mean edges of the organ."""

SLOWING = 0.25
"""Factor on the tools' pace, the part of their motion that they carry out in a step, after a step that stopped them."""

SPEEDING = 2.0
"""Factor by which the pace grows again, up to 1, in each step that does not stop the tools."""

SLOWEST = 2.0**-8
"""Least pace of the tools."""

FARTHEST = 1e9
"""An organ has flown apart if one of its vertices moves farther than this in a step [u]."""

NOT_FINITE = 1
"""Status that `resolve_step` returns if an organ has flown apart or a coordinate is not a number."""

COURANT_LIMIT = 0.125
"""Greatest distance that the velocity given to a node by a tool may move it in a step, in mean edges of the organ. A
faster tool moves the organ by displacement alone: a node cannot carry more speed than its springs can answer within a
step."""

EXPECTED_PART = 0.9
"""Greatest part of the last solve's displacements that is predicted to recur; see `multipliers.expect_vertices`."""


class Division(NamedTuple):
    """Division of a step into queries.

    Attributes:
        by_tools: Number of parts into which the tools' paths are divided.
        by_organs: Number of parts into which the organs' paths are divided. The organs move first, against the tools
            at their poses before the step; then the tools move.
        predicts: Whether the organs' positions are predicted from the last step's contacts.
    """

    by_tools: int
    by_organs: int
    predicts: bool


@array_kernel
def greatest_speed(extent: np.ndarray, linear_velocity: np.ndarray, angular_velocity: np.ndarray) -> float:
    """The greatest speed that any point of a tool can have [u/s]."""
    linear, angular = 0.0, 0.0
    for axis in range(3):
        linear += linear_velocity[axis] * linear_velocity[axis]
        angular += angular_velocity[axis] * angular_velocity[axis]
    speed: float = np.sqrt(linear) + extent[6] * np.sqrt(angular)
    return speed


@inline_kernel
def divide_paths(world: Any, motions: Any, organs: Any, passes: np.ndarray) -> int:
    """Number of parts into which the tools' paths are divided, so that no tool moves too far between two queries.

    Args:
        world: `WorldContacts`.
        motions: `Motions`.
        organs: `OrganMotion`.
        passes: (N,) written: whether a tool comes near an organ.

    Returns:
        The number of parts.
    """
    parts = 1
    for k in range(passes.shape[0]):
        extent = world.tools[k].geometry.extent
        passes[k] = tool_passes(
            motions.start_positions[k], motions.positions[k], extent[6], organs.start, organs.vertices
        )
        if passes[k]:
            speed = greatest_speed(extent, motions.linear_velocities[k], motions.angular_velocities[k])
            parts = max(parts, int(np.ceil(speed * world.settings[DT] / (PATH_PART * extent[7]))))
    return min(parts, MOST_QUERIES)


@array_kernel
def move_points(points: np.ndarray, shift: np.ndarray, part: float) -> None:
    """Move points (V, 3) by a fraction `part` of their displacements (V, 3)."""
    for i in range(points.shape[0]):
        for axis in range(3):
            points[i, axis] += part * shift[i, axis]


@array_kernel
def fill_thrown(vertices: np.ndarray, free: np.ndarray, expected: np.ndarray, thrown: np.ndarray) -> None:
    """Write where vertices (V, 3) would be without the difference between their predicted and their free positions."""
    for i in range(vertices.shape[0]):
        for axis in range(3):
            thrown[i, axis] = vertices[i, axis] + (free[i, axis] - expected[i, axis])


@array_kernel
def _organ_parts(way: float, mean_edge: float) -> int:
    """Number of parts into which the organs' path [u] is divided, so that no vertex moves too far between queries."""
    return max(1, int(np.ceil(way / (ORGAN_PART * mean_edge) - 1e-9)))


@inline_kernel
def divide_step(world: Any, motions: Any, organs: Any, way: float, passes: np.ndarray, expected: np.ndarray) -> Any:
    """Decide into how many queries a step is divided, and whether the organs' positions are predicted.

    Args:
        world: `WorldContacts`.
        motions: `Motions`.
        organs: `OrganMotion`, with the vertices at their positions without contact.
        way: Greatest distance that a vertex moves without contact [u].
        passes: (N,) written: whether a tool comes near an organ.
        expected: (V, 3) written if the organs' positions are predicted: those positions [u].

    Returns:
        `Division`.
    """
    mean_edge, warm_count = world.settings[MEAN_EDGE], world.warm_count[0]
    parts, organ_parts = divide_paths(world, motions, organs, passes), 1
    if passes.shape[0] > 0:
        organ_parts = _organ_parts(way, mean_edge)
    # If an organ is thrown so far that the step would be divided, its positions are predicted instead: contact will
    # undo most of that motion, as it did in the last step. Contacts that pushed in vain, against held nodes, are no
    # basis for a prediction unless the organ is thrown far.
    predicts = organ_parts > 1 and parts == 1 and warm_count > 0
    if predicts and organ_parts <= MOST_PARTS:
        predicts = greatest_kept_depth(warm_count, world.warm.table, organs.start) <= GREATEST_DEPTH_KEPT
    if predicts:
        expect_vertices(
            warm_count, world.warm.table, world.inverse_mass, motions.start_positions, motions.linear_velocities,
            motions.angular_velocities, world.settings[DT], EXPECTED_PART, organs.vertices, expected,
        )  # fmt: skip
        expected_parts = _organ_parts(largest_shift(organs.start, expected), mean_edge)
        # Where an organ is pushed from both sides at once, in vain, the multipliers grow from step to step and predict
        # nothing.
        predicts = expected_parts <= organ_parts
        if predicts:
            organ_parts = expected_parts
    return Division(parts, organ_parts, predicts)


@inline_kernel
def make_tools(world: Any, step: Any, motions: Any, passes: np.ndarray) -> tuple[Any, float]:
    """Make the `QueryTools` of a step in its `StepRoom`. Returns them and the greatest speed of any tool [u/s]."""
    count, pairs = passes.shape[0], passes.shape[0] * len(world.surfaces)
    vectors, rotations = step.vectors, step.rotations
    tools = QueryTools(
        vectors[0, :count], rotations[0, :count], vectors[1, :count], rotations[1, :count], vectors[2, :count],
        vectors[3, :count], passes, step.pairs[0, :pairs], step.pairs[1, :pairs],
    )  # fmt: skip
    for index in range(pairs):
        tools.quiet[index] = tools.looked_at[index] = False
    fastest, greatest = 0.0, COURANT_LIMIT * world.settings[MEAN_EDGE] / world.settings[DT]
    for k in range(count):
        speed = greatest_speed(
            world.tools[k].geometry.extent, motions.linear_velocities[k], motions.angular_velocities[k]
        )
        limit = greatest / speed if speed > greatest else 1.0
        fastest = max(fastest, speed)
        for axis in range(3):
            tools.linear_velocity[k, axis] = limit * motions.linear_velocities[k, axis]
            tools.angular_velocity[k, axis] = limit * motions.angular_velocities[k, axis]
            tools.last_position[k, axis] = motions.start_positions[k, axis]
        fill_rotation(motions.start_orientations[k], 1.0, tools.last_rotation[k])
    return tools, fastest


@kernel(types.float64(WORLD_CONTACTS, F8_2, F8_2, F8_2))
def measure_depth(world: Any, positions: np.ndarray, orientations: np.ndarray, vertices: np.ndarray) -> float:
    """Measure how deep the tools and the organs penetrate each other.

    See `depth.pair_depth` and `edge_depth.edge_depth`.

    Args:
        world: `WorldContacts`.
        positions: (N, 3) of the tools [u].
        orientations: (N, 4).
        vertices: (V, 3) nodes [u].

    Returns:
        The greatest depth [u].
    """
    deepest, rotation, scratch = 0.0, np.empty(9), world.room.scratch
    scratch.listed[0] = NO_PAIR
    organ_count = len(world.surfaces)
    for k in range(len(world.tools)):
        fill_rotation(orientations[k], 1.0, rotation)
        for o in range(organ_count):
            local = world.memories[k * organ_count + o].organ.local
            fill_local(positions[k], rotation, vertices, world.first_vertices[o], local)
            deepest = pair_depth(world.tools[k].geometry, local, world.surfaces[o], 0, deepest, scratch)
            deepest = edge_depth(world.tools[k].geometry, local, world.surfaces[o], deepest, scratch)
    return deepest


@inline_kernel
def _begin_ways(
    start: np.ndarray, expected: np.ndarray, vertices: np.ndarray, queries: int, predicts: bool
) -> np.ndarray:
    """Put vertices (V, 3) where the first query begins.

    Returns:
        (V, 3) displacements of the vertices over the whole step, if it is divided into queries [u]; otherwise `start`,
        which is not used.
    """
    if queries > 1:
        # Computed before the copy, because `expected` may be the same array as `vertices`.
        ways: np.ndarray = expected - start
        copy_points(start, vertices)
        return ways
    if predicts:
        # Without a prediction, `expected` is the same array as `vertices`, and there is nothing to copy.
        copy_points(expected, vertices)
    return start


@array_kernel
def _effort(queries: int, way: float) -> tuple[int, float]:
    """The greatest number of sweeps in a solve, and the relaxation factor of a sweep.

    Args:
        queries: Number of queries in the step.
        way: Greatest distance that a point of a tool moves in the step [u].
    """
    if queries > 1:
        # The constraints may contradict each other; over-relaxing one would then violate another.
        return MOST_SWEEPS_DIVIDED, 1.0
    return MOST_SWEEPS if way <= SLOW else MOST_SWEEPS_MOVING, OVER_RELAXATION


@array_kernel
def _parts_done(queries: int, organ_parts: int, tool_parts: int) -> tuple[float, float]:
    """The fractions of their paths that the organs and the tools have covered after a number of queries of a step.

    The organs move first, against the tools at their poses before the step; then the tools move.
    """
    organ_part = min(queries / organ_parts, 1.0)
    if tool_parts > 1:
        return organ_part, max((queries - organ_parts) / tool_parts, 0.0)
    return organ_part, 0.0 if queries < organ_parts else 1.0


@inline_kernel
def solve_impulses(
    world: Any,
    plan: Any,
    count: int,
    tried: int,
    velocities: np.ndarray,
    islands: int,
    order: np.ndarray,
    starts: np.ndarray,
) -> None:
    """Solve for the impulses that stop the organs' surfaces at what they touch, and apply them.

    Args:
        world: `WorldContacts`; its constraints have been measured, and their impulses are written.
        plan: `QueryPlan` of the step's last query.
        count: Number of constraints.
        tried: Number of constraints that pushed in the last position solve.
        velocities: (V, 3) changed [u/s].
        islands: Number of islands of constraints; see `islands.find_islands` for this and the next two.
        order: (C,) constraints in the order in which they are solved.
        starts: (N + 2,) where each island begins in `order`.
    """
    table, inverse_mass, dt, sweeps = world.constraints.table, world.inverse_mass, world.settings[DT], plan.sweeps
    rows, features = table.rows, table.features
    if plan.is_only:
        # A point that was on its plane, and that the position solve moved back by some displacement, had moved by as
        # much in the time step: the impulse that stops it is the displacement divided by the time step.
        start_warm(count, table, IMPULSE, tried, world.trial.table, 1.0 / dt)
        start_pushed(count, rows, features, inverse_mass, IMPULSE, velocities)
        sweeps = MOST_SWEEPS_VELOCITY
    solve_velocities(order[: starts[0]], rows, features, inverse_mass, velocities, dt, 1, VELOCITY_TOLERANCE)
    for island in range(islands):
        solve_velocities(
            order[starts[island] : starts[island + 1]], rows, features, inverse_mass, velocities, dt, sweeps,
            VELOCITY_TOLERANCE, plan.relaxation,
        )  # fmt: skip


@inline_kernel
def _finish_step(
    world: Any,
    plan: Any,
    progress: Any,
    count: int,
    islands: int,
    order: np.ndarray,
    motions: Any,
    organs: Any,
    outcome: Any,
    room: Any,
) -> None:
    """Store what the next step needs, apply the impulses to the organs, and sum the impulses and wrenches."""
    near, numbers, dt, passed, tried = world.near, outcome.numbers, world.settings[DT], progress.passed, progress.tried
    near.crossing[skin.CROSSED_FOR] += dt
    if near.crossing[skin.CROSSINGS] == 0.0:
        near.crossing[skin.CROSSED_FOR] = 0.0
    numbers[CROSSINGS], numbers[CROSSED_FOR] = near.crossing[skin.CROSSINGS], near.crossing[skin.CROSSED_FOR]
    keep_for_next(tried, world.trial.table, 0 if plan.is_divided else passed, world.earlier.table, world.warm)
    world.warm_count[0] = tried
    if passed > 0:
        reserve(world.constraints, count, count + passed)
        count = add_passed(count, passed, world.constraints.table, world.earlier.table, motions.positions)
    table, tool_count = world.constraints.table, motions.positions.shape[0]
    measure_gaps(
        count, table.rows, table.features, world.inverse_mass, world.settings[MEAN_INVERSE_MASS], organs.vertices
    )
    if order.shape[0] < count:
        order = np.empty(count, np.int64)
        islands = find_islands(count, table.features, world.inverse_mass, tool_count, order, room)
    solve_impulses(world, plan, count, tried, organs.velocities, islands, order, room.starts)
    numbers[CONTACT_COUNT] = count
    sum_impulses(
        count, table.rows, table.features, tool_count, motions.positions, organs.vertices, outcome.nodal_impulses,
        outcome.wrenches,
    )  # fmt: skip
    if tool_count > 0 and plan.first_step != 0:
        keep_passive(world, count, motions, organs, outcome)


@inline_kernel
def slow_tools(world: Any, motions: Any) -> None:
    """Let the tools carry out only a part of their motion, after a step that has stopped them.

    A tool that moves as fast as before, even away from where it was stopped, may be stopped again and again: a step
    that is too long for the organ to follow leaves it too deep as well. Shorter steps let the tool out.

    Args:
        world: `WorldContacts`.
        motions: `Motions`; their ends and velocities are written if the pace is less than 1.
    """
    pace, turned = world.pace[0], world.room.step.orientation
    if pace == 1.0:
        return
    for k in range(motions.positions.shape[0]):
        turn_between(motions.start_orientations[k], motions.orientations[k], pace, turned)
        for entry in range(4):
            motions.orientations[k, entry] = turned[entry]
        for axis in range(3):
            start = motions.start_positions[k, axis]
            motions.positions[k, axis] = start + pace * (motions.positions[k, axis] - start)
            motions.linear_velocities[k, axis] *= pace
            motions.angular_velocities[k, axis] *= pace


@inline_kernel
def stop_tools(world: Any, plan: Any, tools: Any, motions: Any, organs: Any, crossings: float, depth: float) -> float:
    """Put tools and organs back to where they were before the step, if they were not too deep in each other there.

    Where an organ is pinned or wound up, there may be no place for it beside the tool. The tool is then stopped, so
    that nothing gets deeper from step to step. The caller does not stop tools that move far in a step.

    Args:
        world: `WorldContacts`.
        plan: `QueryPlan` of the step's last query.
        tools: `QueryTools`; written.
        motions: `Motions`; if the tools are stopped, their ends become their starts, and their velocities zero.
        organs: `OrganMotion`, of which the vertices are written.
        crossings: Number of places in which organs crossed before the step.
        depth: How deep tools and organs are in each other after the step [u].

    Returns:
        How deep they are afterwards [u]; `depth` if nothing was done.
    """
    pose_tools(motions, 0.0, tools, world.room.scratch.axes)
    before: float = measure_tools(world, plan, tools, organs.start, 1)
    before = depth_of_edges(world, tools.position, tools.rotation, organs.start, before)
    # An organ that a fast tool had already penetrated would not be freed by stopping the tool.
    if before > STOPPING_DEPTH:
        return depth
    copy_points(organs.start, organs.vertices)
    copy_points(motions.start_positions, motions.positions)
    for k in range(motions.positions.shape[0]):
        for entry in range(4):
            motions.orientations[k, entry] = motions.start_orientations[k, entry]
        for axis in range(3):
            motions.linear_velocities[k, axis] = motions.angular_velocities[k, axis] = 0.0
    # The pairs of near features are found anew, from these positions, at the start of the next step.
    world.near.crossing[skin.CROSSINGS], world.near.counts[skin.IS_KNOWN] = crossings, 0
    return before


@inline_kernel
def _measure_and_stop(
    world: Any, plan: Any, tools: Any, motions: Any, organs: Any, progress: Any, crossings: float, way: float
) -> float:  # fmt: skip
    """Measure the depth along the tools' edges, too, at the end of a step, and stop the tools if they are too deep.

    The pace is lowered in a step that stops the tools, and grows again otherwise; see `stop_tools` and `slow_tools`.

    Args:
        world: `WorldContacts`.
        plan: `QueryPlan` of the step's last query.
        tools: `QueryTools`.
        motions: `Motions`; written if the tools are stopped.
        organs: `OrganMotion`; written if the tools are stopped.
        progress: `QueryProgress`; its depth is written.
        crossings: Number of places in which organs crossed before the step.
        way: Greatest distance that a point of a tool moves in the step [u].

    Returns:
        1 if the tools were stopped or slowed, otherwise 0.
    """
    depth = depth_of_edges(world, tools.position, tools.rotation, organs.vertices, progress.depth)
    progress.depth = depth
    if plan.first_step != 0 and depth > STOPPING_DEPTH and way <= STOPPING_WAY * world.settings[MEAN_EDGE]:
        progress.depth = stop_tools(world, plan, tools, motions, organs, crossings, depth)
    pace: float = world.pace[0]
    if progress.depth < depth:
        world.pace[0] = max(SLOWEST, SLOWING * pace)
        return 1.0
    world.pace[0] = min(SPEEDING * pace, 1.0)
    return 1.0 if pace < 1.0 else 0.0


@kernel(types.int64(WORLD_CONTACTS, types.int64, MOTIONS, ORGAN_MOTION, STEP_OUTCOME))
def resolve_step(world: Any, first_step: int, motions: Any, organs: Any, outcome: Any) -> int:
    """Resolve all contacts at the end of a step.

    Args:
        world: `WorldContacts`; the memory in it is updated.
        first_step: Code of the detectors' first step. With 0 there is no first step, and only flagged nodes make
            contact: this is the published method's second step alone.
        motions: `Motions` of the tools; of no tools if only the ground is to make contact. Written if
            `numbers[STOPPED]` is 1: the tools were then stopped, or slowed down after an earlier stop.
        organs: `OrganMotion`; written.
        outcome: `StepOutcome`; written.

    Returns:
        0 if all went well; `NOT_FINITE` if an organ has flown apart; otherwise the status of `raycast.cast_columns`.
    """
    settings, near, numbers = world.settings, world.near, outcome.numbers
    start, vertices, tool_count = organs.start, organs.vertices, motions.positions.shape[0]
    dt, mean_edge, warm_count = settings[DT], settings[MEAN_EDGE], world.warm_count
    if first_step == 0:
        # Without the first step both faces of a tool may push against each other; such multipliers must not be carried
        # into the next step.
        warm_count[0] = 0
    numbers[:] = 0.0
    copy_points(organs.free_vertices, vertices)
    copy_points(organs.free_velocities, organs.velocities)
    way = largest_shift(start, vertices)
    if not way < FARTHEST:
        return NOT_FINITE
    slow_tools(world, motions)
    step, vertex_count = world.room.step, vertices.shape[0]
    passes, predicted = step.passes[:tool_count], step.points[0, :vertex_count]
    division = divide_step(world, motions, organs, way, passes, predicted)
    expected = predicted if division.predicts else vertices
    parts, organ_parts = division.by_tools, division.by_organs
    queries = organ_parts + (parts if parts > 1 else 0)
    numbers[QUERIES] = queries
    if settings[KEEPS_APART] > 0.0:
        prepare_pairs(
            world.skin, near, start, expected if queries == 1 else start, mean_edge, settings[IS_FREE] > 0.0,
            warm_count[0], world.warm.table,
        )  # fmt: skip
    reference, crossings = start, near.crossing[skin.CROSSINGS]
    shift = _begin_ways(start, expected, vertices, queries, division.predicts)
    tools, fastest = make_tools(world, step, motions, passes)
    sweeps, relaxation = _effort(queries, fastest * dt)
    held, kept = step.points[2, :vertex_count], step.points[3, :vertex_count]
    room = island_room(step, tool_count, vertex_count)
    plan = QueryPlan(first_step, parts > 1, queries == 1, queries == 1, division.predicts, sweeps, relaxation)
    progress, organ_done = begin_query(near, 0, 0), 0.0
    for query in range(queries):
        organ_part, tool_part = _parts_done(query + 1, organ_parts, parts)
        if queries > 1:
            reference = vertices.copy()
            move_points(vertices, shift, organ_part - organ_done)
            organ_done = organ_part
        is_last = query == queries - 1
        # The flags are decided at the positions that the organs would have without contact, as published.
        thrown = vertices
        if division.predicts and is_last:
            thrown = step.points[1, :vertex_count]
            fill_thrown(vertices, organs.free_vertices, expected, thrown)
        pose_tools(motions, tool_part, tools, step.orientation)
        plan = QueryPlan(first_step, parts > 1, queries == 1, is_last, division.predicts, sweeps, relaxation)
        points = QueryPoints(vertices, reference, thrown, held, kept)
        status = detect(world, plan, tools, points)
        if status != 0:
            return status
        if query > 0:
            progress = begin_query(near, progress.tried, progress.passed)
        count, islands, order = resolve_query(world, plan, tools, points, progress, room, numbers)
        if not is_last:
            sum_passed(progress.passed, world.earlier.table)
            remember_sides(near, progress.tried, world.trial.table)
        remember_poses(tools)
    if first_step == 0:
        progress.depth = measure_tools(world, plan, tools, vertices, 0)
    numbers[STOPPED] = _measure_and_stop(world, plan, tools, motions, organs, progress, crossings, fastest * dt)
    numbers[RESIDUAL] = progress.depth
    _finish_step(world, plan, progress, count, islands, order, motions, organs, outcome, room)
    return 0
