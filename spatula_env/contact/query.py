"""One query: find the contacts at given poses of the tools and positions of the organs, and solve for the positions.

Contacts are found and solved for in passes, because the organ may meet other contacts where a solve has put it. A query
ends when all constraints hold, no tool is in an organ and no organ crosses itself; or, if that cannot be reached, with
the best positions found.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.experimental import structref

from spatula_env._kernels import array_kernel, inline_kernel
from spatula_env.contact import skin
from spatula_env.contact.arrest import arrest, depth_of_tools
from spatula_env.contact.corners import drop_outside
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
from spatula_env.contact.motion import copy_points, turn_between
from spatula_env.contact.multipliers import keep_warm, note_passed, start_warm
from spatula_env.contact.near import has_turned, measure_shifts
from spatula_env.contact.path import RESIDUAL_TOLERANCE
from spatula_env.contact.raycast import cast_columns
from spatula_env.contact.response import measure_gaps, solve_positions, start_pushed
from spatula_env.contact.self_contact import gather_organs, keep_uncrossed, remember_sides
from spatula_env.contact.settings import (
    GROUND_FRICTION,
    GROUND_HEIGHT,
    HAS_GROUND,
    KEEPS_APART,
    MEAN_EDGE,
    MEAN_INVERSE_MASS,
    ORGAN_FRICTION,
    PENETRATION,
)
from spatula_env.contact.structures import DISPLACEMENT, NO_PAIR, Placement, reserve
from spatula_env.contact.sunk import gather_sunk_triangles

POSITION_TOLERANCE = 3e-5
"""The position solve ends when a sweep moves no constrained point farther than this [u]."""

MOST_PASSES = 10
"""Most passes in one query, unless `goes_on` adds to them."""

MOST_RETRIES = 4
"""Most times that a query goes on from positions at which organs were held back from crossing."""

RETRY_PASSES = 3
"""Passes that each of these retries adds."""

MOST_SUNK = 4
"""Most times that a query goes on because an organ is still in a tool although all contacts that were found hold."""

MOST_LOOKS = 64
"""Upper bound on the passes of a query; more than all of the above add up to."""

SUNK_DEPTH = 5e-3
"""If a solve leaves the organ deeper in a tool than this, constraints are added for the triangles that are in the tool;
see `sunk` [u]."""

PASSES_WITH_FRICTION = 2
"""In passes after these, the second half of the sweeps leaves friction as it is. Sweeps with friction at more points
than there are vertices may cycle, pass after pass; sweeps of the normal constraints alone converge."""


class QueryTools(NamedTuple):
    """The N tools of a query and what they may meet among O organs.

    Attributes:
        position: (N, 3) of each tool [u].
        rotation: (N, 9) its rotation matrix, row by row.
        last_position: (N, 3) at the last query [u].
        last_rotation: (N, 9).
        linear_velocity: (N, 3) of each tool, scaled down to the greatest speed that it may give an organ [u/s].
        angular_velocity: (N, 3) likewise [rad/s].
        passes: (N,) whether the tool comes near any organ in this step.
        quiet: (N O,) whether the tool has not come near this organ since the last query.
        looked_at: (N O,) workspace: pairs whose depth is to be measured.
    """

    position: np.ndarray
    rotation: np.ndarray
    last_position: np.ndarray
    last_rotation: np.ndarray
    linear_velocity: np.ndarray
    angular_velocity: np.ndarray
    passes: np.ndarray
    quiet: np.ndarray
    looked_at: np.ndarray


class QueryPoints(NamedTuple):
    """Positions of the V vertices of all organs in a query; (V, 3) each [u].

    Attributes:
        vertices: Their present positions, as solves have moved them; written.
        reference: Their positions at the last query.
        thrown: Their positions without contact.
        held: Their last positions at which all features were on the right sides of each other; written.
        kept: Workspace: the best positions so far.
    """

    vertices: np.ndarray
    reference: np.ndarray
    thrown: np.ndarray
    held: np.ndarray
    kept: np.ndarray


class Meeting(NamedTuple):
    """One pair of a tool and an organ.

    Attributes:
        tool: `ToolGeometry`.
        memory: `NodeMemory` of the two.
        organ: `LocalOrgan`.
        triangles: (T, 3) of the organ, counting its own vertices.
        first_vertex: Index of the organ's first vertex among those of all organs.
        friction: Coefficient.
        owner: The tool's index.
        pair: Index of this pair among all pairs of a tool (outer) and an organ (inner).
    """

    tool: Any
    memory: Any
    organ: Any
    triangles: np.ndarray
    first_vertex: int
    friction: float
    owner: int
    pair: int


class QueryPlan(NamedTuple):
    """Options of a query.

    Attributes:
        first_step: Code of the detectors' first step; 0 for the method's second step alone, on nodes.
        is_divided: Whether the tools' paths in this step are divided.
        is_only: Whether this is the step's only query.
        is_last: Whether this is the step's last query.
        predicts: Whether the organs' positions are predicted from the last step's contacts.
        sweeps: Most sweeps in a solve.
        relaxation: Over-relaxation factor of a sweep.
    """

    first_step: int
    is_divided: bool
    is_only: bool
    is_last: bool
    predicts: bool
    sweeps: int
    relaxation: float


@structref.register
class QueryProgressType(types.StructRef):
    """Numba type of `QueryProgress`."""

    def preprocess_fields(self, fields: Any) -> Any:
        """Replace literal types by the types of their values, so that the fields can be assigned other numbers."""
        return tuple((name, types.unliteral(kind)) for name, kind in fields)


class QueryProgress(structref.StructRefProxy):
    """Progress of a query, for kernels.

    Fields:
        attempt: Index of the present pass.
        last_attempt: Index of the last pass, as planned so far.
        retries: How often the query has gone on from positions at which organs were held back from crossing.
        tries: How often it has gone on because an organ was in a tool although all contacts held.
        tried: Number of constraints that pushed in the last pass; they are in the world's `trial`.
        passed: Number of constraints that pushed in this step's earlier queries; they are in the world's `earlier`.
        met: Whether organs have met themselves or each other.
        sinks: Whether constraints are added for the triangles of an organ that are in a tool; see `sunk`.
        is_over: Whether the positions of the organs are final, so that no further solve follows.
        afresh: Whether `QueryPoints.held` has changed since contacts between organs were last gathered.
        depth: How deep tools and organs are in each other; the allowed depth if it is no more than that [u].
        least: The least such depth so far [u].
        crossed: Number of places in which organs crossed before the query.
    """


structref.define_proxy(
    QueryProgress,
    QueryProgressType,
    [
        *("attempt", "last_attempt", "retries", "tries", "tried", "passed"),
        *("met", "sinks", "is_over", "afresh", "depth", "least", "crossed"),
    ],
)


@inline_kernel
def begin_query(near: Any, tried: int, passed: int) -> Any:
    """A `QueryProgress` at the beginning."""
    return QueryProgress(
        0, MOST_PASSES, 0, 0, tried, passed, False, False, False, True, 0.0, np.inf, near.crossing[skin.CROSSINGS]
    )


@array_kernel
def pose_tools(motions: Any, part: float, tools: Any, orientation: np.ndarray) -> None:
    """Put the tools at their poses after a fraction `part` of the step; `orientation` (4,), or longer, is workspace."""
    for k in range(tools.position.shape[0]):
        for axis in range(3):
            way = motions.positions[k, axis] - motions.start_positions[k, axis]
            tools.position[k, axis] = motions.positions[k, axis] - (1.0 - part) * way
        turn_between(motions.start_orientations[k], motions.orientations[k], part, orientation)
        fill_rotation(orientation, 1.0, tools.rotation[k])


@array_kernel
def remember_poses(tools: Any) -> None:
    """Store the tools' poses for the next query."""
    for k in range(tools.position.shape[0]):
        for axis in range(3):
            tools.last_position[k, axis] = tools.position[k, axis]
        for entry in range(9):
            tools.last_rotation[k, entry] = tools.rotation[k, entry]


@array_kernel
def _any(values: np.ndarray) -> bool:
    """Whether any entry (n,) is true."""
    found = False
    for i in range(values.shape[0]):
        found |= values[i]
    return found


@array_kernel
def _all(values: np.ndarray) -> bool:
    """Whether all entries (n,) are true."""
    holds = True
    for i in range(values.shape[0]):
        holds &= values[i]
    return holds


@array_kernel
def _detect_pair(met: Any, rays: Any, plan: Any, tools: Any, points: Any, axes: np.ndarray, normal: np.ndarray) -> int:
    """Decide the flags of one tool's contact nodes and one organ, given as a `Meeting`; see `detect`."""
    tool, memory, organ, triangles, k = met.tool, met.memory, met.organ, met.triangles, met.owner
    if not tools.passes[k] and not _any(memory.flags):
        memory.unfeasible[:] = False
        return 0
    position, rotation = tools.position[k], tools.rotation[k]
    own = points.thrown[met.first_vertex : met.first_vertex + organ.local.shape[1]]
    fill_local(tools.last_position[k], tools.last_rotation[k], points.reference, met.first_vertex, organ.last_local)
    fill_local(position, rotation, own, 0, organ.local)
    if _all(memory.outside) and find_candidates(tool.extent, organ, triangles) == 0:
        # All nodes were outside the organ, and no triangle of it has come near the tool.
        memory.flags[:] = False
        memory.unfeasible[:] = False
        tools.quiet[met.pair] = True
        return 0
    status: int = cast_columns(position, rotation, own, triangles, rays, memory, organ, axes)
    if status != 0:
        return status
    for i in range(memory.hits.shape[0]):
        memory.outside[i] = memory.hits[i, 0, 1] <= 0
    remember_flags(memory)
    lead_by_motion(tool, memory, organ, triangles)
    grade = 0 if plan.first_step == 0 else 2
    decide_flags(tool, memory, organ.local, triangles, plan.first_step, True, grade, normal)
    return 0


@inline_kernel
def detect(world: Any, plan: Any, tools: Any, points: Any) -> int:
    """Decide the flags of all tools' contact nodes at the positions of the organs without contact, as published.

    Returns:
        0 if all went well; otherwise the status of `raycast.cast_columns`.
    """
    organ_count, scratch = len(world.surfaces), world.room.scratch
    axes, normal = scratch.axes, scratch.normal
    tools.quiet[:] = False
    for k in range(tools.position.shape[0]):
        shape, friction = world.tools[k], world.friction[k]
        for o in range(organ_count):
            index = k * organ_count + o
            both = world.memories[index]
            met = Meeting(
                shape.geometry, both.nodes, both.organ, world.surfaces[o], world.first_vertices[o], friction, k, index
            )
            status = _detect_pair(met, shape.rays, plan, tools, points, axes, normal)
            if status != 0:
                return int(status)
    return 0


@array_kernel
def _append_contacts(
    table: Any,
    count: int,
    met: Any,
    plan: Any,
    tools: Any,
    points: Any,
    attempt: int,
    sinks: bool,
    tried: int,
    trial: Any,
    scratch: Any,
    numbers: np.ndarray,
) -> int:
    """Append the constraints of a tool and an organ in one pass, if there is room for them; see `_gather_pair`.

    Returns:
        The new count; if there is not enough room, minus the capacity that is needed, and nothing has been appended.
    """
    tool, memory, organ, triangles, k = met.tool, met.memory, met.organ, met.triangles, met.owner
    first, with_features = met.first_vertex, plan.first_step != 0
    position, rotation = tools.position[k], tools.rotation[k]
    silent = attempt == 0 and tools.quiet[met.pair]
    if silent or (not tools.passes[k] and not _any(memory.flags)):
        fill_record(tool, memory, points.thrown, first, triangles, position, rotation, True)
        return count
    placement = Placement(
        position, rotation, tools.linear_velocity[k], tools.angular_velocity[k], met.friction, k, first
    )
    before, least = count, count + tool.nodes.shape[0] + (triangles.shape[0] if sinks else 0)
    scratch.listed[0] = NO_PAIR
    for look in range(2):
        if attempt > 0 or plan.predicts:
            fill_local(position, rotation, points.vertices if look == 0 else points.thrown, first, organ.local)
        found = find_candidates(tool.extent, organ, triangles) if with_features else 0
        wanted = least + (9 * (found + tool.corners.shape[0]) if found > 0 else 0)
        if wanted > table.names.shape[0]:
            return -int(wanted)
        if found > 0:
            count = gather_features(
                table, count, tool, organ, triangles, found, placement, attempt > 0 and (sinks or not plan.is_divided),
                attempt, tried, trial, scratch,
            )  # fmt: skip
            scratch.listed[0] = met.pair
        # The predicted positions may have no contact where the positions without contact do; then the latter are used.
        if attempt > 0 or not plan.predicts or count > before:
            break
    if count > before:
        # Contact will move the organ, so that the nodes found to be outside may not stay so.
        memory.outside[:] = False
    if attempt == 0:
        # If a tool was put into an organ, the surface came through none of its faces; the published method decides.
        if with_features and count == before and not _any(memory.flags):
            for grade in (1, 0):
                if decide_flags(
                    tool, memory, organ.local, triangles, plan.first_step, True, grade, scratch.normal
                )[0] > 0:  # fmt: skip
                    break
            drop_outside(tool.nodes, memory.flags, organ.local, triangles, scratch)
        fill_record(tool, memory, points.thrown, first, triangles, position, rotation, True)
        for i in range(memory.record.shape[0]):
            numbers[PENETRATION] = max(numbers[PENETRATION], memory.record[i, 3])
    if sinks:
        count = gather_sunk_triangles(table, count, tool, organ, triangles, placement, tried, trial, scratch)
    return int(gather_nodes(table, count, tool, memory, organ.last_local, triangles, placement))


@inline_kernel
def _gather_pair(
    world: Any,
    plan: Any,
    tools: Any,
    points: Any,
    progress: Any,
    k: int,
    o: int,
    count: int,
    numbers: np.ndarray,
) -> int:
    """Append the constraints of tool `k` and organ `o` in one pass, making room for them. Returns the new count."""
    index, constraints = k * len(world.surfaces) + o, world.constraints
    shape, both, trial, scratch = world.tools[k], world.memories[index], world.trial.table, world.room.scratch
    met = Meeting(
        shape.geometry, both.nodes, both.organ, world.surfaces[o], world.first_vertices[o], world.friction[k], k, index
    )
    attempt, sinks, tried = progress.attempt, progress.sinks, progress.tried
    appended = -1
    while appended < 0:
        appended = _append_contacts(
            constraints.table, count, met, plan, tools, points, attempt, sinks, tried, trial, scratch, numbers
        )
        if appended < 0:
            reserve(constraints, count, -appended)
    return int(appended)


@inline_kernel
def gather_contacts(world: Any, plan: Any, tools: Any, points: Any, progress: Any, numbers: np.ndarray) -> int:
    """Write the constraints of one pass: of organs with themselves and each other, with the ground and with tools.

    Returns:
        The number of constraints.
    """
    settings, constraints, count, vertices = world.settings, world.constraints, 0, points.vertices
    if settings[KEEPS_APART] > 0.0:
        count = gather_organs(
            constraints, 0, world.skin, world.near, points.held, vertices, points.thrown, points.reference,
            settings[MEAN_EDGE], settings[ORGAN_FRICTION], progress.afresh,
        )  # fmt: skip
        progress.afresh = False
    progress.met |= count > 0
    if settings[HAS_GROUND] > 0.0:
        reserve(constraints, count, count + vertices.shape[0])
        count = gather_ground(
            constraints.table, count, vertices, points.reference, world.inverse_mass, settings[GROUND_HEIGHT],
            settings[GROUND_FRICTION],
        )  # fmt: skip
    for k in range(tools.position.shape[0]):
        for o in range(len(world.surfaces)):
            count = _gather_pair(world, plan, tools, points, progress, k, o, count, numbers)
    return count


@inline_kernel
def measure_tools(
    world: Any, plan: Any, tools: Any, vertices: np.ndarray, attempt: int, is_placed: bool = False
) -> float:
    """Measure how deep tools and organs are in each other [u], with vertices (V, 3).

    Returns the allowed depth if it is no deeper than that: zero in the step's last query; `RESIDUAL_TOLERANCE` in
    earlier ones, where it is enough to know that it is not too deep. Set `is_placed` if the memories' `local` holds
    the organs at these vertices already: contacts have then just been gathered there, in a pass after the first.
    """
    organ_count = len(world.surfaces)
    for k in range(tools.position.shape[0]):
        for o in range(organ_count):
            index = k * organ_count + o
            tools.looked_at[index] = tools.passes[k] and (attempt > 0 or not tools.quiet[index])
    allowed = 0.0 if plan.is_last else RESIDUAL_TOLERANCE
    depth: float = depth_of_tools(
        world, tools.position.shape[0], tools.looked_at, tools.position, tools.rotation, vertices, allowed,
        is_placed,
    )  # fmt: skip
    return depth


@inline_kernel
def _uncross(world: Any, points: Any, known: int, held: np.ndarray, vertices: np.ndarray) -> bool:
    """Hold vertices (V, 3) back from crossing on their way from `held` (V, 3). Returns whether any was held back."""
    return bool(
        keep_uncrossed(
            world.skin, world.near, world.inverse_mass, known, world.trial.table, held, vertices,
            world.settings[MEAN_EDGE],
        )
    )  # fmt: skip


@inline_kernel
def _arrest_tools(world: Any, plan: Any, tools: Any, points: Any, progress: Any, crosses: bool) -> bool:
    """Let the organs keep their places relative to the tools, as a last resort, unless that makes matters worse.

    First only the parts near the tools move with them (skipped if organs begin to cross); then the rest of the organs
    also goes back to its positions at the last query; see `arrest.arrest`.

    Returns:
        Whether it was tried.
    """
    near, tool_count, crossings = world.near, tools.position.shape[0], world.near.crossing[skin.CROSSINGS]
    begins_to_cross = crossings > 0.0 and progress.crossed == 0.0
    # Beside a tool that moves far in a step, the paths alone decide where the organ is: it is not held in its place.
    if plan.is_divided or tool_count == 0 or not (progress.depth > SUNK_DEPTH or begins_to_cross):
        return False
    for stage in range(1 if begins_to_cross else 0, 2):
        copy_points(points.vertices, points.kept)
        arrest(
            world, tool_count, tools.looked_at, tools.position, tools.rotation, points.reference, stage == 1,
            points.kept,
        )  # fmt: skip
        if crosses:
            near.crossing[skin.CROSSINGS] = progress.crossed
            _uncross(world, points, 0, points.reference, points.kept)
        left = progress.depth
        if plan.first_step != 0:
            left = measure_tools(world, plan, tools, points.kept, progress.attempt)
        if left <= max(progress.depth, SUNK_DEPTH) and near.crossing[skin.CROSSINGS] <= crossings:
            progress.depth, crossings = left, near.crossing[skin.CROSSINGS]
            copy_points(points.kept, points.vertices)
        near.crossing[skin.CROSSINGS] = crossings
        if progress.depth <= SUNK_DEPTH and crossings <= progress.crossed:
            break
    return True


@inline_kernel
def _allowed_depth(plan: Any) -> float:
    """Greatest depth of an organ in a tool at which no constraints for the triangles in the tool are added [u]."""
    if not plan.is_divided:
        return RESIDUAL_TOLERANCE
    # In later queries of a divided step the paths of points still tell which face they came through; after the last
    # query none follows.
    return SUNK_DEPTH if plan.is_last else np.inf


@inline_kernel
def goes_on(world: Any, plan: Any, tools: Any, points: Any, progress: Any, settled: bool) -> bool:
    """Decide whether a query goes on after its constraints hold (`settled`) or its planned passes are used up.

    It does if a tool is still in an organ, or if organs cross; crossing organs are first moved to where they do not.
    """
    near, attempt, vertices = world.near, progress.attempt, points.vertices
    with_features = plan.first_step != 0
    if with_features:
        progress.depth = measure_tools(world, plan, tools, vertices, attempt, True)
    if progress.depth > _allowed_depth(plan) and progress.tries < MOST_SUNK:
        # Constraints are missing, or could not be fulfilled.
        progress.sinks = progress.sinks or settled or progress.depth > SUNK_DEPTH
        if progress.depth < progress.least:
            progress.least = progress.depth
            copy_points(vertices, points.kept)
        progress.tries, progress.last_attempt = progress.tries + 1, attempt + 2
        return True
    progress.is_over = progress.tries > 0 and progress.depth > max(progress.least, RESIDUAL_TOLERANCE)
    if progress.is_over:
        copy_points(points.kept, vertices)
        progress.depth = progress.least
    crosses = progress.met or near.crossing[skin.CROSSINGS] > 0.0
    if not crosses and world.settings[KEEPS_APART] > 0.0:
        # Where the surface has folded, it may cross outside the known pairs. The shifts were measured when the contacts
        # were gathered.
        if progress.is_over:
            measure_shifts(near, points.held, vertices)
        crosses = near.counts[skin.IS_KNOWN] != 1 or has_turned(world.skin, near, vertices)
    if crosses and _uncross(world, points, progress.tried, points.held, vertices):
        progress.is_over = True
        if with_features:
            progress.depth = measure_tools(world, plan, tools, vertices, attempt)
        most = MOST_RETRIES if progress.depth > SUNK_DEPTH else 1
        if progress.retries < most:
            # Go on with the tools' contacts from where the organs have been put.
            remember_sides(near, progress.tried, world.trial.table)
            copy_points(vertices, points.held)
            progress.retries, progress.last_attempt = progress.retries + 1, attempt + RETRY_PASSES
            progress.afresh, progress.is_over, progress.sinks = True, False, False
            progress.tries, progress.least = 0, np.inf
            return True
    if _arrest_tools(world, plan, tools, points, progress, crosses):
        progress.is_over = True
    return bool(progress.is_over)


@inline_kernel
def solve_contacts(
    world: Any, plan: Any, points: Any, progress: Any, count: int, islands: int, order: np.ndarray, starts: np.ndarray
) -> None:
    """Move the organs to positions at which the constraints of a pass hold.

    Args:
        world: `WorldContacts`; its constraints have been measured.
        plan: `QueryPlan`.
        points: `QueryPoints`; vertices are moved.
        progress: `QueryProgress`.
        count: Number of constraints.
        islands: Number of islands of constraints; see `islands.find_islands` for this and the next two.
        order: (C,) constraints in the order in which they are solved.
        starts: (N + 2,) where each island begins in `order`.
    """
    table, inverse_mass, vertices = world.constraints.table, world.inverse_mass, points.vertices
    rows, features, sweeps, attempt = table.rows, table.features, plan.sweeps, progress.attempt
    if attempt == 0 and plan.is_last and (plan.predicts or plan.is_only):
        # Solve from the positions without contact, warm-started with the last step's displacements.
        if plan.predicts:
            copy_points(points.thrown, vertices)
        start_warm(count, table, DISPLACEMENT, world.warm_count[0], world.warm.table, 1.0)
        start_pushed(count, rows, features, inverse_mass, DISPLACEMENT, vertices)
    if attempt > 0:
        # Constraints that pushed in the last pass keep their multipliers, so that they may give way again.
        start_warm(count, table, DISPLACEMENT, progress.tried, world.trial.table, 1.0)
    # Ground constraints that share no vertex with others are solved by one sweep.
    solve_positions(order[: starts[0]], rows, features, inverse_mass, vertices, 1, POSITION_TOLERANCE, 1)
    frictional = sweeps if attempt < PASSES_WITH_FRICTION else sweeps // 2
    for island in range(islands):
        members = order[starts[island] : starts[island + 1]]
        if attempt == 0 or greatest_violation(members, rows, features) > RESIDUAL_TOLERANCE:
            solve_positions(
                members, rows, features, inverse_mass, vertices, sweeps, POSITION_TOLERANCE, frictional,
                plan.relaxation,
            )  # fmt: skip
    progress.tried = keep_warm(count, table, world.trial)


@inline_kernel
def resolve_query(
    world: Any,
    plan: Any,
    tools: Any,
    points: Any,
    progress: Any,
    room: Any,
    numbers: np.ndarray,
) -> tuple[int, int, np.ndarray]:
    """Find and solve for the contacts of a query, pass after pass.

    Args:
        world: `WorldContacts`.
        plan: `QueryPlan`.
        tools: `QueryTools`, whose flags have been decided.
        points: `QueryPoints`; vertices are moved.
        progress: `QueryProgress`, written.
        room: `IslandRoom`.
        numbers: Columns of the result; penetration is written.

    Returns:
        The number of constraints, the number of islands, and the order of the constraints (C,); see
        `islands.find_islands`.
    """
    inverse_mass, mean, tool_count = world.inverse_mass, world.settings[MEAN_INVERSE_MASS], tools.position.shape[0]
    copy_points(points.reference, points.held)
    for attempt in range(MOST_LOOKS):
        progress.attempt = attempt
        count = gather_contacts(world, plan, tools, points, progress, numbers)
        table = world.constraints.table
        measure_gaps(count, table.rows, table.features, inverse_mass, mean, points.vertices)
        order = np.empty(count, np.int64)
        islands = find_islands(count, table.features, inverse_mass, tool_count, order, room)
        # The first pass is always solved, also for friction, which holds a surface that only touches.
        settled = attempt > 0 and greatest_violation(order, table.rows, table.features) <= RESIDUAL_TOLERANCE
        if settled or attempt >= progress.last_attempt or progress.is_over:
            if progress.is_over or not goes_on(world, plan, tools, points, progress, settled):
                break
            continue
        solve_contacts(world, plan, points, progress, count, islands, order, room.starts)
        if not plan.is_last:
            progress.passed = note_passed(count, progress.passed, table, world.earlier.table, tools.position)
    return count, islands, order
