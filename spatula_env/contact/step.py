"""All contacts of one physics step, in one call: divide the step, detect, constrain, solve, and sum up."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from spatula_env._kernels import ARRAYS, inline_kernel, kernel
from spatula_env.contact import skin
from spatula_env.contact.arrest import arrest, depth_of_tools
from spatula_env.contact.corners import drop_outside
from spatula_env.contact.depth import pair_depth
from spatula_env.contact.features import find_candidates, gather_features, gather_ground, gather_nodes
from spatula_env.contact.flags import (
    decide_flags,
    fill_local,
    fill_record,
    fill_rotation,
    lead_by_motion,
    remember_flags,
)
from spatula_env.contact.islands import find_islands, greatest_violation
from spatula_env.contact.motion import copy_points, largest_shift, tool_passes, turn_between
from spatula_env.contact.multipliers import (
    add_passed,
    expect_vertices,
    greatest_kept_depth,
    keep_for_next,
    keep_warm,
    note_passed,
    start_warm,
    sum_passed,
)
from spatula_env.contact.path import RESIDUAL_TOLERANCE
from spatula_env.contact.raycast import cast_columns
from spatula_env.contact.response import (
    ENERGY,
    FREE,
    GREATEST_WORK,
    OVER_RELAXATION,
    REST_HEIGHT,
    STAGE,
    TOUCHED,
    UNKNOWN,
    WORK,
    energy_of,
    keep_ledger,
    limit_energy,
    measure_gaps,
    passive_share,
    scale_impulses,
    solve_positions,
    solve_velocities,
    start_pushed,
    sum_heights,
    sum_impulses,
)
from spatula_env.contact.self_contact import gather_organs, keep_uncrossed, prepare_pairs, remember_sides
from spatula_env.contact.structures import (
    DISPLACEMENT,
    IMPULSE,
    WORLD_CONTACTS,
    reserve,
)
from spatula_env.contact.sunk import gather_sunk_triangles

F8, F8_2 = ARRAYS["f8"], ARRAYS["f8_2"]

POSITION_TOLERANCE = 3e-5
"""The position solve ends when a sweep moves no constrained point farther than this [u]."""

VELOCITY_TOLERANCE = 1e-3
"""The velocity solve ends when a sweep changes no constrained point's velocity by more than this [u/s]."""

MOST_PASSES = 10
"""Most times that contacts are looked for in one query."""

MOST_RETRIES = 4
"""So many times it is gone on from where organs were held back from crossing,"""

RETRY_PASSES = 3
"""and contacts are looked for so often each time."""

MOST_SUNK = 4
"""So often a query goes on where the organ is still in a tool although all contacts that were found hold."""

MOST_LOOKS = 64
"""More often than all of that together."""

SUNK_DEPTH = 5e-3
"""Where a solve could not keep the organ out by this much, it is helped by where the organ is [u]."""

PASSES_WITH_FRICTION = 2
"""Of later ones the second half of the sweeps leaves friction as it is. Sweeps of friction at more points than there
are vertices may go in circles, pass after pass; those of what keeps surfaces apart converge."""

MOST_SWEEPS = 200
"""Most sweeps in one solve of positions under a tool that holds still. Where these are too few, friction at more points
than the organ has vertices there leaves a choice, and many times as many sweeps do not settle it either."""

MOST_SWEEPS_MOVING = 25
"""The same where a tool moves farther than `SLOW` in a step: what it touches changes from step to step, and each solve
goes on from where the last one ended."""

MOST_SWEEPS_DIVIDED = 50
"""The same in a step that is divided into several queries."""

MOST_SWEEPS_VELOCITY = 25
"""Most sweeps of the velocity solve in a step that is not divided. It begins with what the position solve has found,
and more sweeps change neither forces nor how still a held organ is."""

SLOW = 1e-3
"""Motion of a tool in a step that counts as holding still [u]."""

PATH_PART = 0.5
"""Greatest motion of a tool between two queries, in its thicknesses."""

ORGAN_PART = 0.5
"""Greatest motion of an organ's node between two queries, in mean edges of the organ."""

MOST_PARTS = 4
"""Most parts of a step, by the organ's motion, in which contacts are not expected that did not hold in the last one."""

GREATEST_DEPTH_KEPT = 2e-3
"""Contacts that left the surface deeper than this at the end of a step have not held it [u]."""

COURANT_LIMIT = 0.125
"""Part of an organ's mean edge that a tool may make a node move in a step by giving it velocity. A faster tool moves
the organ by displacement alone: a node cannot carry more speed than its springs can answer within a step."""

EXPECTED_PART = 0.9
"""Greatest part of the last solve's displacements that is expected; see `multipliers.expect_vertices`."""

ROUNDING = 1e-12
"""Energies that differ by less, in their size, are the same."""

FLAGS, SECOND_STEP = 0, 1
"""What makes contact: the flags method, with all features of the surfaces; or its second step alone, on nodes."""

SETTINGS_LENGTH = 10
DT, MEAN_EDGE, HAS_GROUND, GROUND_HEIGHT, GROUND_FRICTION, MEAN_INVERSE_MASS, GRAVITY = 0, 1, 2, 3, 4, 5, 6
ORGAN_FRICTION, KEEPS_APART, IS_FREE = 7, 8, 9
"""Columns of the settings: length of a step [s], mean edge of the organ with the smallest [u], whether there is ground,
its height [u] and friction, mean inverse mass of the free nodes [1/kg], gravity [u/s2], friction between organs,
whether organs are kept apart from themselves and each other, whether no node is held."""

PENETRATION, RESIDUAL, QUERIES, CONTACT_COUNT, CROSSINGS, CROSSED_FOR = 0, 1, 2, 3, 4, 5
RESULT_LENGTH = 6
"""Columns of the result."""


@inline_kernel
def greatest_speed(tool: Any, linear_velocity: np.ndarray, angular_velocity: np.ndarray) -> float:
    """Of any point of a tool [u/s]."""
    linear, angular = 0.0, 0.0
    for axis in range(3):
        linear += linear_velocity[axis] * linear_velocity[axis]
        angular += angular_velocity[axis] * angular_velocity[axis]
    speed: float = np.sqrt(linear) + tool.extent[6] * np.sqrt(angular)
    return speed


@inline_kernel
def divide_paths(
    tools: Any,
    start_positions: np.ndarray,
    positions: np.ndarray,
    linear_velocities: np.ndarray,
    angular_velocities: np.ndarray,
    start: np.ndarray,
    vertices: np.ndarray,
    dt: float,
    passes: np.ndarray,
) -> int:
    """Into how many parts the tools' paths are divided, so that no tool moves too far between two queries.

    Args:
        tools: As in `resolve_step`, as the next six.
        start_positions: See there.
        positions: See there.
        linear_velocities: See there.
        angular_velocities: See there.
        start: See there.
        vertices: (V, 3) nodes at the end of the step, without contact [u].
        dt: [s].
        passes: (N,) written: whether a tool comes near an organ.

    Returns:
        It.
    """
    parts = 1
    for k in range(passes.shape[0]):
        tool = tools[k]
        passes[k] = tool_passes(start_positions[k], positions[k], tool.extent[6], start, vertices)
        if passes[k]:
            way = greatest_speed(tool, linear_velocities[k], angular_velocities[k]) * dt
            parts = max(parts, int(np.ceil(way / (PATH_PART * tool.extent[7]))))
    return parts


@inline_kernel
def keep_passive(
    world: Any,
    count: int,
    tool_count: int,
    start: np.ndarray,
    positions: np.ndarray,
    linear_velocities: np.ndarray,
    angular_velocities: np.ndarray,
    vertices: np.ndarray,
    velocities_before: np.ndarray,
    velocities: np.ndarray,
    nodal_impulses: np.ndarray,
    wrenches: np.ndarray,
) -> None:
    """Take from each organ what energy it has more than the tools have put in, from a step's impulses and its motion.

    Arguments as in `resolve_step`, at its end; what comes after `velocities_before` is changed, and `vertices`.
    """
    first_vertices, inverse_mass, ledger = world.first_vertices, world.inverse_mass, world.ledger
    rows, features = world.constraints.rows, world.constraints.features
    mean_edge, gravity = world.settings[MEAN_EDGE], world.settings[GRAVITY]
    before = ledger.copy()
    keep_ledger(
        count, rows, features, first_vertices, inverse_mass, start, positions, linear_velocities, angular_velocities,
        velocities_before, velocities, ledger,
    )  # fmt: skip
    for o in range(first_vertices.shape[0]):
        first = first_vertices[o]
        end = first_vertices[o + 1] if o + 1 < first_vertices.shape[0] else vertices.shape[0]
        if ledger[o, STAGE] != TOUCHED:
            # What it does is its own.
            ledger[o, ENERGY] = energy_of(
                first, end, inverse_mass, vertices, velocities, gravity, ledger[o, REST_HEIGHT]
            )
            ledger[o, WORK] = max(ledger[o, WORK], ledger[o, ENERGY])
            ledger[o, GREATEST_WORK] = ledger[o, WORK]
            continue
        work = ledger[o, WORK] - before[o, WORK]
        share = passive_share(
            first, end, inverse_mass, vertices, velocities, nodal_impulses, work, gravity, mean_edge, ledger[o]
        )
        if share < 1.0:
            for i in range(first, end):
                for axis in range(3):
                    velocities[i, axis] -= (1.0 - share) * inverse_mass[i] * nodal_impulses[i, axis]
            ledger[o, WORK] = before[o, WORK] + share * work
            ledger[o, GREATEST_WORK] = max(before[o, GREATEST_WORK], ledger[o, WORK])
            scale_impulses(count, rows, features, first, end, share)
            sum_impulses(count, rows, features, tool_count, positions, vertices, nodal_impulses, wrenches)
        limit_energy(first, end, inverse_mass, vertices, velocities, gravity, mean_edge, ledger[o])
        ledger[o, ENERGY] = energy_of(first, end, inverse_mass, vertices, velocities, gravity, ledger[o, REST_HEIGHT])


@kernel(types.float64(WORLD_CONTACTS, F8_2, F8_2, F8_2))
def measure_depth(world: Any, positions: np.ndarray, orientations: np.ndarray, vertices: np.ndarray) -> float:
    """How deep the tools and the organs are in each other, see `depth.pair_depth`.

    Args:
        world: `WorldContacts`.
        positions: (N, 3) of the tools [u].
        orientations: (N, 4).
        vertices: (V, 3) nodes [u].

    Returns:
        The greatest depth [u].
    """
    deepest, rotation = 0.0, np.empty(9)
    organ_count = len(world.surfaces)
    for k in range(len(world.tools)):
        fill_rotation(orientations[k], 1.0, rotation)
        for o in range(organ_count):
            memory = world.memories[k * organ_count + o]
            fill_local(positions[k], rotation, vertices, world.first_vertices[o], memory.local)
            deepest = pair_depth(world.tools[k], memory, world.surfaces[o], deepest)
    return deepest


@kernel(types.void(WORLD_CONTACTS, F8_2, F8_2))
def admit_energy(world: Any, vertices: np.ndarray, velocities: np.ndarray) -> None:
    """Enter into the ledgers what energy organs were given by hand, when they were put into a state.

    Args:
        world: `WorldContacts`; its ledgers have what they had when the state was saved.
        vertices: (V, 3) nodes in the state [u].
        velocities: (V, 3) [u/s].
    """
    first_vertices, inverse_mass, ledger = world.first_vertices, world.inverse_mass, world.ledger
    gravity = world.settings[GRAVITY]
    for o in range(first_vertices.shape[0]):
        first = first_vertices[o]
        end = first_vertices[o + 1] if o + 1 < first_vertices.shape[0] else vertices.shape[0]
        if ledger[o, STAGE] == UNKNOWN:
            ledger[o, REST_HEIGHT], ledger[o, STAGE] = sum_heights(first, end, inverse_mass, vertices), FREE
        energy = energy_of(first, end, inverse_mass, vertices, velocities, gravity, ledger[o, REST_HEIGHT])
        given = energy - ledger[o, ENERGY]
        # An unchanged state has exactly the same.
        if given > ROUNDING * abs(energy):
            ledger[o, WORK] += given
            ledger[o, GREATEST_WORK] = max(ledger[o, GREATEST_WORK], ledger[o, WORK])
        ledger[o, ENERGY] = energy


@kernel(
    types.int64(
        *(WORLD_CONTACTS, types.boolean, types.int64, types.int64, types.boolean),
        *(F8_2, F8_2, F8_2, F8_2, F8_2, F8_2),
        *(F8_2, F8_2, F8_2, F8_2, F8_2, F8_2, F8_2, F8),
    )
)
def resolve_step(
    world: Any,
    with_tools: bool,
    mode: int,
    first_step: int,
    exclusive: bool,
    start_positions: np.ndarray,
    start_orientations: np.ndarray,
    positions: np.ndarray,
    orientations: np.ndarray,
    linear_velocities: np.ndarray,
    angular_velocities: np.ndarray,
    start: np.ndarray,
    free_vertices: np.ndarray,
    free_velocities: np.ndarray,
    vertices: np.ndarray,
    velocities: np.ndarray,
    nodal_impulses: np.ndarray,
    wrenches: np.ndarray,
    result: np.ndarray,
) -> int:
    """Resolve all contacts at the end of a step.

    Args:
        world: `WorldContacts`; what it remembers is written.
        with_tools: Whether there are tools; only the ground counts otherwise.
        mode: `FLAGS` or `SECOND_STEP`.
        first_step: Code of the detectors' first step.
        exclusive: As in the detectors.
        start_positions: (N, 3) of the tools at the start of the step [u].
        start_orientations: (N, 4).
        positions: (N, 3) at its end [u].
        orientations: (N, 4).
        linear_velocities: (N, 3) [u/s].
        angular_velocities: (N, 3) [rad/s].
        start: (V, 3) nodes at the start of the step [u].
        free_vertices: (V, 3) nodes at its end, without contact [u].
        free_velocities: (V, 3) [u/s].
        vertices: (V, 3) written: nodes at the end of the step [u].
        velocities: (V, 3) written [u/s].
        nodal_impulses: (V, 3) written: what the tools gave the nodes [kg u/s].
        wrenches: (N + 1, 6) written: impulse and its moment about each tool's origin, that the organs give the tool;
            last what they give the ground [kg u/s, kg u2/s2].
        result: (5,) written, by the column names of this module.

    Returns:
        0; otherwise what `raycast.cast_columns` returned.
    """
    tools, memories, surfaces, constraints, earlier, trial = (
        world.tools, world.memories, world.surfaces, world.constraints, world.earlier, world.trial,
    )  # fmt: skip
    warm, warm_count = world.warm, world.warm_count
    first_vertices, friction, settings = world.first_vertices, world.friction, world.settings
    inverse_mass = world.inverse_mass
    dt, mean_edge = settings[DT], settings[MEAN_EDGE]
    if mode == SECOND_STEP:
        # Both faces of a tool push against each other; what they come to in one step is not carried into the next.
        warm_count[0] = 0
    tool_count, organ_count = len(tools) if with_tools else 0, len(surfaces)
    vertex_count = vertices.shape[0]
    result[:] = 0.0
    for i in range(vertex_count):
        for axis in range(3):
            vertices[i, axis], velocities[i, axis] = free_vertices[i, axis], free_velocities[i, axis]
    passes, quiet = np.zeros(tool_count, np.bool_), np.zeros(tool_count * organ_count, np.bool_)
    looked_at = np.zeros(tool_count * organ_count, np.bool_)
    parts = divide_paths(
        tools, start_positions, positions, linear_velocities, angular_velocities, start, vertices, dt, passes
    )
    organ_parts = 1
    if tool_count > 0:
        organ_parts = max(1, int(np.ceil(largest_shift(start, vertices) / (ORGAN_PART * mean_edge) - 1e-9)))
    # An organ that is thrown so far that the step would be divided is expected where contact undoes that, about as it
    # did in the last step. What pushed in vain, against held nodes, is no measure unless the organ is thrown far.
    predicts = organ_parts > 1 and parts == 1 and warm_count[0] > 0
    if predicts and organ_parts <= MOST_PARTS:
        predicts = greatest_kept_depth(warm_count[0], warm, start) <= GREATEST_DEPTH_KEPT
    expected = vertices
    if predicts:
        expected = np.empty_like(vertices)
        expect_vertices(
            warm_count[0], warm, inverse_mass, start_positions, linear_velocities, angular_velocities, dt,
            EXPECTED_PART, vertices, expected,
        )  # fmt: skip
        expected_parts = max(1, int(np.ceil(largest_shift(start, expected) / (ORGAN_PART * mean_edge) - 1e-9)))
        # What is pushed from both sides at once, in vain, has multipliers that grow from step to step and tell nothing.
        predicts = expected_parts <= organ_parts
        if predicts:
            organ_parts = expected_parts
        else:
            expected = vertices
    queries = organ_parts + (parts if parts > 1 else 0)
    result[QUERIES] = queries
    near, held, kept = world.near, np.empty_like(start), np.empty_like(start)
    apart = settings[KEEPS_APART] > 0.0
    if apart:
        prepare_pairs(
            world.skin, near, start, expected if queries == 1 else start, mean_edge, settings[IS_FREE] > 0.0,
            warm_count[0], warm,
        )  # fmt: skip
    reference = start
    shift = start
    if queries > 1:
        shift = np.empty_like(start)
        for i in range(vertex_count):
            for axis in range(3):
                shift[i, axis] = expected[i, axis] - start[i, axis]
                vertices[i, axis] = start[i, axis]
    elif predicts:
        copy_points(expected, vertices)
    position, rotation, last_position, last_rotation = (
        np.empty((tool_count, 3)),
        np.empty((tool_count, 9)),
        np.empty((tool_count, 3)),
        np.empty((tool_count, 9)),
    )
    orientation = np.empty(4)
    linear, angular = np.empty((tool_count, 3)), np.empty((tool_count, 3))
    fastest = 0.0
    for k in range(tool_count):
        greatest = COURANT_LIMIT * mean_edge / dt
        speed = greatest_speed(tools[k], linear_velocities[k], angular_velocities[k])
        limit = greatest / speed if speed > greatest else 1.0
        fastest = max(fastest, speed)
        for axis in range(3):
            linear[k, axis] = limit * linear_velocities[k, axis]
            angular[k, axis] = limit * angular_velocities[k, axis]
            last_position[k, axis] = start_positions[k, axis]
        fill_rotation(start_orientations[k], 1.0, last_rotation[k])
    holders, starts = np.full(vertex_count, -1), np.zeros(tool_count + 2, np.int64)
    count, passed, tried = 0, 0, 0
    organ_done, depth = 0.0, 0.0
    # In a step that is divided more may be asked than can be had, and what is overdone in one place is then missing in
    # another.
    relaxation = OVER_RELAXATION if queries == 1 else 1.0
    sweeps = MOST_SWEEPS if fastest * dt <= SLOW else MOST_SWEEPS_MOVING
    if queries > 1:
        sweeps = MOST_SWEEPS_DIVIDED
    for query in range(queries):
        # The organs move first, against the tools where they were; then the tools.
        organ_part = min((query + 1) / organ_parts, 1.0) if query < organ_parts else 1.0
        tool_part = 1.0
        if parts > 1:
            tool_part = max(query + 1 - organ_parts, 0) / parts
        elif query < organ_parts - 1:
            tool_part = 0.0
        if queries > 1:
            reference = vertices.copy()
            for i in range(vertex_count):
                for axis in range(3):
                    vertices[i, axis] += (organ_part - organ_done) * shift[i, axis]
            organ_done = organ_part
        # The flags are decided where the organs would be without contact, as published.
        thrown = vertices
        if predicts and query == queries - 1:
            thrown = np.empty_like(vertices)
            for i in range(vertex_count):
                for axis in range(3):
                    thrown[i, axis] = vertices[i, axis] + (free_vertices[i, axis] - expected[i, axis])
        quiet[:] = False
        for k in range(tool_count):
            tool = tools[k]
            for axis in range(3):
                way = positions[k, axis] - start_positions[k, axis]
                position[k, axis] = positions[k, axis] - (1.0 - tool_part) * way
            turn_between(start_orientations[k], orientations[k], tool_part, orientation)
            fill_rotation(orientation, 1.0, rotation[k])
            for o in range(organ_count):
                memory = memories[k * organ_count + o]
                first = first_vertices[o]
                own = thrown[first : first + memory.local.shape[1]]
                if not passes[k] and not memory.states[0].any():
                    memory.states[1] = False
                    continue
                fill_local(last_position[k], last_rotation[k], reference, first, memory.last_local)
                fill_local(position[k], rotation[k], own, 0, memory.local)
                if memory.states[6].all() and find_candidates(tool, memory, surfaces[o]) == 0:
                    # Nothing came near a tool that was outside.
                    memory.states[0] = False
                    memory.states[1] = False
                    quiet[k * organ_count + o] = True
                    continue
                status: int = cast_columns(position[k], rotation[k], own, surfaces[o], tool, memory)
                if status != 0:
                    return status
                for i in range(memory.hits.shape[0]):
                    memory.states[6, i] = memory.hits[i, 0, 1] <= 0
                remember_flags(memory.states)
                lead_by_motion(tool, memory, surfaces[o])
                decide_flags(tool, memory, surfaces[o], first_step, exclusive, 0 if mode == SECOND_STEP else 2)
        retries, last_attempt, met, tries, sinks, least, is_last = 0, MOST_PASSES, False, 0, False, np.inf, False
        crossed, afresh = near.crossing[skin.CROSSINGS], True
        # Between queries it is enough to know that it is not too deep.
        depth, allowed = 0.0, 0.0 if query == queries - 1 else RESIDUAL_TOLERANCE
        copy_points(reference, held)
        for attempt in range(MOST_LOOKS):
            count = 0
            if apart:
                count = gather_organs(
                    constraints, 0, world.skin, near, held, vertices, thrown, reference, mean_edge,
                    settings[ORGAN_FRICTION], afresh,
                )  # fmt: skip
                afresh = False
            met |= count > 0
            if settings[HAS_GROUND] > 0.0:
                reserve(constraints, count, count + vertex_count)
                count = gather_ground(
                    constraints.rows, constraints.features, constraints.names, count, vertices, reference,
                    inverse_mass, settings[GROUND_HEIGHT], settings[GROUND_FRICTION],
                )  # fmt: skip
            for k in range(tool_count):
                tool = tools[k]
                for o in range(organ_count):
                    memory, first, triangles = memories[k * organ_count + o], first_vertices[o], surfaces[o]
                    silent = attempt == 0 and quiet[k * organ_count + o]
                    if silent or (not passes[k] and not memory.states[0].any()):
                        fill_record(tool, memory, thrown, first, triangles, position[k], rotation[k], True)
                        continue
                    before = count
                    for look in range(2):
                        if attempt > 0 or predicts:
                            fill_local(position[k], rotation[k], vertices if look == 0 else thrown, first, memory.local)
                        if mode == FLAGS:
                            count = gather_features(
                                constraints, count, tool, memory, triangles, first, position[k], rotation[k], linear[k],
                                angular[k], friction[k], k, attempt > 0 and parts == 1, attempt, tried, trial,
                            )  # fmt: skip
                        # Where less was thrown into the tool than expected, it is looked where that really is.
                        if attempt > 0 or not predicts or count > before:
                            break
                    if count > before:
                        # Contact moves the organ on from where its nodes were found to be outside.
                        memory.states[6] = False
                    if attempt == 0:
                        # A tool that was put into an organ came through no face. Then the published method decides.
                        if mode == FLAGS and count == before and not memory.states[0].any():
                            for grade in (1, 0):
                                if decide_flags(tool, memory, triangles, first_step, exclusive, grade)[0] > 0:
                                    break
                            drop_outside(tool, memory, triangles)
                        fill_record(tool, memory, thrown, first, triangles, position[k], rotation[k], True)
                        for i in range(memory.record.shape[0]):
                            result[PENETRATION] = max(result[PENETRATION], memory.record[i, 3])
                    if sinks:
                        count = gather_sunk_triangles(
                            constraints, count, tool, memory, triangles, first, position[k], rotation[k], linear[k],
                            angular[k], friction[k], k, tried, trial,
                        )  # fmt: skip
                    reserve(constraints, count, count + tool.nodes.shape[0])
                    count = gather_nodes(
                        constraints.rows, constraints.features, constraints.names, count, tool, memory, triangles,
                        first, position[k], rotation[k], linear[k], angular[k], friction[k], k,
                    )  # fmt: skip
            rows, features = constraints.rows, constraints.features
            measure_gaps(count, rows, features, inverse_mass, settings[MEAN_INVERSE_MASS], vertices)
            order = np.empty(count, np.int64)
            islands = find_islands(count, features, inverse_mass, tool_count, holders, order, starts)
            # The first solve is there for friction too, which holds a surface that only touches.
            settled = attempt > 0 and greatest_violation(order, rows, features) <= RESIDUAL_TOLERANCE
            if settled or attempt >= last_attempt or is_last:
                if is_last:
                    break
                if mode == FLAGS:
                    for k in range(tool_count):
                        for o in range(organ_count):
                            looked_at[k * organ_count + o] = passes[k] and (
                                attempt > 0 or not quiet[k * organ_count + o]
                            )
                    depth = depth_of_tools(world, tool_count, looked_at, position, rotation, vertices, allowed)
                # A tool that goes far in a step is where it is by its way alone.
                if parts == 1 and depth > RESIDUAL_TOLERANCE and tries < MOST_SUNK:
                    # Rows are missing, or could not be kept.
                    sinks = sinks or settled or depth > SUNK_DEPTH
                    if depth < least:
                        least = depth
                        copy_points(vertices, kept)
                    tries, last_attempt = tries + 1, attempt + 2
                    continue
                is_last = tries > 0 and depth > max(least, RESIDUAL_TOLERANCE)
                if is_last:
                    copy_points(kept, vertices)
                    depth = least
                crosses = met or near.crossing[skin.CROSSINGS] > 0.0
                if crosses and keep_uncrossed(world.skin, near, inverse_mass, tried, trial, held, vertices, mean_edge):
                    is_last = True
                    if mode == FLAGS:
                        depth = depth_of_tools(world, tool_count, looked_at, position, rotation, vertices, allowed)
                    most = MOST_RETRIES if depth > SUNK_DEPTH else 1
                    if retries < most:
                        # Tools go on, and push where the organ has been left.
                        remember_sides(near, tried, trial)
                        copy_points(vertices, held)
                        afresh = True
                        retries, last_attempt, is_last = retries + 1, attempt + RETRY_PASSES, False
                        tries, least, sinks = 0, np.inf, False
                        continue
                crossings = near.crossing[skin.CROSSINGS]
                if parts == 1 and tool_count > 0 and (depth > SUNK_DEPTH or (crossings > 0.0 and crossed == 0.0)):
                    is_last = True
                    for stage in range(1 if (crossings > 0.0 and crossed == 0.0) else 0, 2):
                        copy_points(vertices, kept)
                        arrest(world, tool_count, looked_at, position, rotation, reference, stage == 1, kept)
                        if crosses:
                            near.crossing[skin.CROSSINGS] = crossed
                            keep_uncrossed(world.skin, near, inverse_mass, 0, trial, reference, kept, mean_edge)
                        left = depth
                        if mode == FLAGS:
                            left = depth_of_tools(world, tool_count, looked_at, position, rotation, kept, allowed)
                        if left <= max(depth, SUNK_DEPTH) and near.crossing[skin.CROSSINGS] <= crossings:
                            depth, crossings = left, near.crossing[skin.CROSSINGS]
                            copy_points(kept, vertices)
                        near.crossing[skin.CROSSINGS] = crossings
                        if depth <= SUNK_DEPTH and crossings <= crossed:
                            break
                if not is_last:
                    break
                continue
            if attempt == 0 and query == queries - 1 and (predicts or queries == 1):
                # From here on the organs are where they would be without contact, and what pushes them is known.
                if predicts:
                    copy_points(thrown, vertices)
                start_warm(count, rows, features, constraints.names, DISPLACEMENT, warm_count[0], warm, 1.0)
                start_pushed(count, rows, features, inverse_mass, DISPLACEMENT, vertices)
            if attempt > 0:
                # What has pushed already may give way again.
                start_warm(count, rows, features, constraints.names, DISPLACEMENT, tried, trial, 1.0)
            # What stands on the ground by itself is settled by one sweep.
            solve_positions(order[: starts[0]], rows, features, inverse_mass, vertices, 1, POSITION_TOLERANCE, 1)
            frictional = sweeps if attempt < PASSES_WITH_FRICTION else sweeps // 2
            for island in range(islands):
                members = order[starts[island] : starts[island + 1]]
                if attempt == 0 or greatest_violation(members, rows, features) > RESIDUAL_TOLERANCE:
                    solve_positions(
                        members, rows, features, inverse_mass, vertices, sweeps, POSITION_TOLERANCE, frictional,
                        relaxation,
                    )  # fmt: skip
            tried = keep_warm(count, rows, features, constraints.names, trial)
            if query < queries - 1:
                passed = note_passed(count, passed, constraints, earlier, position)
        if query < queries - 1:
            sum_passed(passed, earlier)
            remember_sides(near, tried, trial)
        for k in range(tool_count):
            for axis in range(3):
                last_position[k, axis] = position[k, axis]
            for entry in range(9):
                last_rotation[k, entry] = rotation[k, entry]
    crossing = near.crossing
    crossing[skin.CROSSED_FOR] = crossing[skin.CROSSED_FOR] + dt if crossing[skin.CROSSINGS] > 0.0 else 0.0
    result[CROSSINGS], result[CROSSED_FOR] = crossing[skin.CROSSINGS], crossing[skin.CROSSED_FOR]
    keep_for_next(tried, trial, passed if parts == 1 else 0, earlier, warm)
    warm_count[0] = tried
    measure_gaps(count, constraints.rows, constraints.features, inverse_mass, settings[MEAN_INVERSE_MASS], vertices)
    if mode != FLAGS:
        for k in range(tool_count):
            for o in range(organ_count):
                looked_at[k * organ_count + o] = passes[k] and not quiet[k * organ_count + o]
        depth = depth_of_tools(world, tool_count, looked_at, position, rotation, vertices, 0.0)
    result[RESIDUAL] = depth
    if passed > 0:
        reserve(constraints, count, count + passed)
        count = add_passed(count, passed, constraints, earlier, positions)
        measure_gaps(count, constraints.rows, constraints.features, inverse_mass, settings[MEAN_INVERSE_MASS], vertices)
    rows, features = constraints.rows, constraints.features
    if queries == 1:
        # A point that was on its plane, and was moved back by so much, came that far in the time step: the impulse that
        # stops it is the displacement over the time step.
        start_warm(count, rows, features, constraints.names, IMPULSE, tried, trial, 1.0 / dt)
        start_pushed(count, rows, features, inverse_mass, IMPULSE, velocities)
    if queries == 1:
        sweeps = MOST_SWEEPS_VELOCITY
    order = np.empty(count, np.int64)
    islands = find_islands(count, features, inverse_mass, tool_count, holders, order, starts)
    solve_velocities(order[: starts[0]], rows, features, inverse_mass, velocities, dt, 1, VELOCITY_TOLERANCE)
    for island in range(islands):
        solve_velocities(
            order[starts[island] : starts[island + 1]], rows, features, inverse_mass, velocities, dt, sweeps,
            VELOCITY_TOLERANCE, relaxation,
        )  # fmt: skip
    result[CONTACT_COUNT] = count
    sum_impulses(count, rows, features, tool_count, positions, vertices, nodal_impulses, wrenches)
    if tool_count > 0 and mode == FLAGS:
        keep_passive(
            world, count, tool_count, start, positions, linear_velocities, angular_velocities, vertices,
            free_velocities, velocities, nodal_impulses, wrenches,
        )  # fmt: skip
    return 0
