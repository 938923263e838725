"""Looks at where tools and organs are, and says how far one is inside the other and where organs cross themselves.

It shares nothing with the contact detector that it judges: points are inside an organ by the winding number of its
surface, the depth of the surface in a tool is the greatest of any of its points, wherever on a triangle that is,
whether the organ has slipped past the tool is decided from the paths of its vertices, and an organ crosses itself where
an edge goes through a triangle.

As a command it makes a motion in a scene, or repeats a recorded one, and looks after every physics step. A recording is
an .npz file of `nodes` (V, 3) and `velocities` (V, 3) of the organs, `positions` (N, 3) and `orientations` (N, 4) of
the tools, and `linear` and `angular` (S, N, 3), how they move in each of S physics steps.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks import motions
from benchmarks.crossings import CrossingCounter, Crossings
from benchmarks.depths import depth_of_surface, locate_points
from benchmarks.measure import finish, parser
from benchmarks.passages import PARALLEL, find_passages
from spatula_env import Simulation, scenes
from spatula_env.engines import ENGINES
from spatula_env.geometry.transforms import quaternion_conjugate, rotate
from spatula_env.sim import SimulationDiverged

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from spatula_env.geometry import Tool
    from spatula_env.scenes import Scene

    FloatArray = NDArray[np.float64]

RIM = 0.1
"""So near to the rim of a face [u] a surface may slip round it between two inspections: what it does there is a matter
of depth and not of sides."""

EDGE_SPACING = 0.1
"""The tool's edges are looked at in points no farther apart than this [u]."""

ALLOWED = 0.01
"""A depth that is no fault [u]: 0.2 mm in the scenes of the tasks."""


@dataclass(frozen=True)
class Inspection:
    """How a tool and an organ overlap at one instant.

    Attributes:
        node_depth: Greatest depth of one of the tool's contact nodes inside the organ [u].
        corner_depth: Greatest depth of one of the tool's corners inside the organ [u].
        edge_depth: Greatest depth of a point of the tool's edges inside the organ, of those that are `EDGE_SPACING`
            apart [u].
        surface_depth: Greatest depth of any point of the organ's surface inside the tool, exactly [u].
        centre_inside: Whether the tool's origin is inside the organ.
        enclosed: How many of the tool's columns are inside the organ with both ends. A column runs from a contact node
            to its opposite; those within `RIM` of another face do not count.
        passages: How many vertices of the organ have gone right through the tool since the inspection before, in by one
            face and out by the opposite one, the outside of the organ ahead. Their paths are straight in the tool's
            frame; those that cross one of the two faces within `RIM` of another face do not count.
        turned: How many have done so with the inside of the organ ahead: an organ that resists neither contact with
            itself nor inversion may turn inside out over a tool that is rightly outside it. A vertex that goes back the
            way it came counts neither here nor there.
    """

    node_depth: float
    corner_depth: float
    edge_depth: float
    surface_depth: float
    centre_inside: bool
    enclosed: int
    passages: int
    turned: int

    @property
    def residual(self) -> float:
        """Greatest of the depths [u]."""
        return max(self.node_depth, self.corner_depth, self.edge_depth, self.surface_depth)

    @property
    def wrong_side(self) -> bool:
        """Whether some of the organ's surface is on the far side of the tool."""
        return self.centre_inside or self.enclosed > 0 or self.passages > 0


APART = Inspection(0.0, 0.0, 0.0, 0.0, centre_inside=False, enclosed=0, passages=0, turned=0)
"""What is seen of a tool that is far from all organs."""


class Inspector:
    """Inspects one tool and one organ, step after step.

    Args:
        tool: The tool.
        triangles: (T, 3) of the organ's closed surface, counter-clockwise from outside; or of several organs.
    """

    def __init__(self, tool: Tool, triangles: ArrayLike) -> None:
        self._triangles = np.array(triangles, dtype=np.int32, order="C")
        self._planes = _distinct_planes(*tool.planes)
        groups = (tool.nodes, tool.vertices, _edge_points(tool, *self._planes), np.zeros((1, 3)))
        self._points: FloatArray = np.concatenate(groups)
        self._ends = np.cumsum([len(group) for group in groups])
        self._radius = tool.bounding_radius
        self._columns = _inner_columns(tool, *self._planes)
        self._inside = np.zeros(len(self._points), dtype=np.bool_)
        self._depths = np.zeros(len(self._points))
        self._before: FloatArray | None = None
        self._entries = np.zeros(0, dtype=np.int32)
        self._ways = self._entries
        # Vertices that have gone through, with the normal of the face by which they came in.
        self._strayed: dict[int, FloatArray] = {}

    def reset(self) -> None:
        """Forget where the organ was, so that the next inspection counts no passages."""
        self._before = None
        self._strayed.clear()

    def inspect(self, position: ArrayLike, orientation: FloatArray, vertices: FloatArray) -> Inspection:
        """Look at the present state.

        Args:
            position: (3,) of the tool [u].
            orientation: (4,) of the tool, unit quaternion xyzw.
            vertices: (V, 3) of the organ, world frame [u], finite.

        Returns:
            What was seen.
        """
        local = np.ascontiguousarray(rotate(quaternion_conjugate(orientation), vertices - np.asarray(position)))
        locate_points(self._points, local, self._triangles, self._inside, self._depths)
        passages, turned = self._count_passages(local)
        self._before = local
        inside = self._inside
        nodes, corners, edges = (part.max(initial=0.0) for part in np.split(self._depths, self._ends[:3])[:3])
        return Inspection(
            node_depth=float(nodes),
            corner_depth=float(corners),
            edge_depth=float(edges),
            surface_depth=depth_of_surface(local, self._triangles, *self._planes),
            centre_inside=bool(inside[-1]),
            enclosed=int((inside[self._columns[:, 0]] & inside[self._columns[:, 1]]).sum()),
            passages=passages,
            turned=turned,
        )

    def is_apart(self, position: FloatArray, low: FloatArray, high: FloatArray) -> bool:
        """Whether a ball around the tool is outside of the box around all organs, from its lower corner to its upper.

        Args:
            position: (3,) of the tool [u].
            low: (3,) [u].
            high: (3,) [u].
        """
        return bool((position + self._radius < low).any() or (position - self._radius > high).any())

    def _count_passages(self, local: FloatArray) -> tuple[int, int]:
        """Count vertices that have come through since the last time, the organ's outside and inside ahead."""
        if self._before is None:
            self._entries = np.full(len(local), -1, dtype=np.int32)
            self._ways = np.empty_like(self._entries)
            return 0, 0
        normals, offsets = self._planes
        find_passages(self._before, local, normals, offsets, RIM, self._entries, self._ways)
        through = np.flatnonzero(self._ways >= 0)
        if not len(through):
            return 0, 0
        outwards = _vertex_normals(self._before, self._triangles)
        passages, turned = 0, 0
        for vertex in through.tolist():
            way = normals[self._ways[vertex]]
            if self._strayed.get(vertex, way) @ way < 0.0:
                del self._strayed[vertex]
                continue
            self._strayed[vertex] = way
            if outwards[vertex] @ way < 0.0:
                passages += 1
            else:
                turned += 1
        return passages, turned


@dataclass(frozen=True)
class WorldInspection:
    """What is seen of a world at one instant.

    Attributes:
        tools: Of each tool, against all organs together.
        crossings: Of the organs.
    """

    tools: tuple[Inspection, ...]
    crossings: Crossings

    @property
    def residual(self) -> float:
        """Greatest depth of a tool in an organ or the other way round [u]."""
        return max(seen.residual for seen in self.tools)

    @property
    def wrong_side(self) -> bool:
        """Whether some of an organ's surface is on the far side of a tool."""
        return any(seen.wrong_side for seen in self.tools)


class WorldInspector:
    """Inspects all tools and organs of one world, step after step.

    Args:
        scene: What is in it.
    """

    def __init__(self, scene: Scene) -> None:
        sizes = [len(placed.organ.vertices) for placed in scene.organs]
        starts = np.cumsum([0, *sizes[:-1]])
        triangles = np.concatenate(
            [placed.organ.triangles + start for placed, start in zip(scene.organs, starts, strict=True)]
        )
        self._tools = [Inspector(placed.tool, triangles) for placed in scene.tools]
        vertices = np.concatenate([placed.vertices for placed in scene.organs])
        self._crossings = CrossingCounter(vertices, triangles, np.repeat(np.arange(len(sizes)), sizes))

    def reset(self) -> None:
        """Forget where the organs were, so that the next inspection counts no passages."""
        for inspector in self._tools:
            inspector.reset()

    def inspect(self, positions: FloatArray, orientations: FloatArray, vertices: FloatArray) -> WorldInspection:
        """Look at the present state.

        Args:
            positions: (N, 3) of the tools [u].
            orientations: (N, 4) of the tools, unit quaternions xyzw.
            vertices: (V, 3) of all organs, world frame [u], finite.

        Returns:
            What was seen.
        """
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        tools = []
        for inspector, position, orientation in zip(self._tools, positions, orientations, strict=True):
            if inspector.is_apart(position, low, high):
                inspector.reset()
                tools.append(APART)
            else:
                tools.append(inspector.inspect(position, orientation, vertices))
        return WorldInspection(tuple(tools), self._crossings.count(vertices))


def _distinct_planes(normals: FloatArray, offsets: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The planes of a tool's faces, each once: normals (F, 3) and offsets (F,)."""
    rows = np.column_stack([normals, offsets])
    first = np.sort(np.unique(rows.round(9), axis=0, return_index=True)[1])
    return np.ascontiguousarray(normals[first]), np.ascontiguousarray(offsets[first])


def _vertex_normals(vertices: FloatArray, triangles: NDArray[np.int32]) -> FloatArray:
    """Outward normals at the vertices (V, 3): sums of the area vectors of the triangles around each."""
    a, b, c = vertices[triangles[:, 0]], vertices[triangles[:, 1]], vertices[triangles[:, 2]]
    normals = np.zeros_like(vertices)
    np.add.at(normals, triangles.ravel(), np.repeat(np.cross(b - a, c - a), 3, axis=0))
    return normals


def _edge_points(tool: Tool, normals: FloatArray, offsets: FloatArray) -> FloatArray:
    """Points (m, 3) of a tool's edges, ends left out, no farther apart than `EDGE_SPACING`."""
    corners = tool.vertices
    on_plane = np.abs(corners @ normals.T - offsets) < PARALLEL * tool.bounding_radius
    pairs = np.unique(np.sort(tool.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    points = []
    for first, second in pairs.tolist():
        # A triangle's side within a face lies on one plane, an edge of the tool on two.
        if (on_plane[first] & on_plane[second]).sum() >= 2:
            parts = int(np.ceil(np.linalg.norm(corners[second] - corners[first]) / EDGE_SPACING))
            points += [corners[first] + k / parts * (corners[second] - corners[first]) for k in range(1, parts)]
    return np.array(points).reshape(-1, 3)


def _inner_columns(tool: Tool, normals: FloatArray, offsets: FloatArray) -> NDArray[np.int64]:
    """Pairs of opposite contact nodes (c, 2) whose connection keeps `RIM` from all faces but theirs."""
    columns = []
    for node, other in enumerate(tool.opposite.tolist()):
        if node > other:
            continue
        ends = tool.nodes[[node, other]]
        depths = (offsets - ends @ normals.T).min(axis=0)
        across = np.abs(normals @ tool.normals[[node, other]].T).max(axis=1) > 1.0 - PARALLEL
        if (depths[~across] >= RIM).all():
            columns.append((node, other))
    return np.array(columns, dtype=np.int64).reshape(-1, 2)


@dataclass
class Tally:
    """What was seen in the physics steps of a run.

    Attributes:
        steps: How many.
        touching: In which a tool felt a force.
        depth: Greatest [u].
        deepest_step: When that was, counted from 0.
        deep: In which a depth was greater than `ALLOWED`.
        deep_uncrossed: How many of those had no organ that crossed itself.
        longest_deep: How many of them followed each other at most.
        unreported: In which a depth was greater than `ALLOWED` and the report's residual was not.
        reported: Greatest residual of a report [u].
        wrong_side: In which some of an organ's surface was on the far side of a tool.
        crossed: In which an organ crossed itself.
        longest_crossed: How many of those followed each other at most.
        most_crossings: Greatest number of crossings of organs with themselves.
        crossed_between: In which organs crossed each other.
        diverged: Whether the simulation broke down.
    """

    steps: int = 0
    touching: int = 0
    depth: float = 0.0
    deepest_step: int = -1
    deep: int = 0
    deep_uncrossed: int = 0
    longest_deep: int = 0
    unreported: int = 0
    reported: float = 0.0
    wrong_side: int = 0
    crossed: int = 0
    longest_crossed: int = 0
    most_crossings: int = 0
    crossed_between: int = 0
    diverged: bool = False
    _deep_since: int = 0
    _crossed_since: int = 0

    @property
    def crossed_now(self) -> int:
        """For how many steps an organ has crossed itself without a break."""
        return self._crossed_since

    def add(self, seen: WorldInspection, *, touching: bool, reported: float) -> None:
        """Count one physics step.

        Args:
            seen: What was seen after it.
            touching: Whether a tool felt a force in it.
            reported: Its report's residual [u].
        """
        depth, own = seen.residual, seen.crossings.own
        if depth > self.depth:
            self.depth, self.deepest_step = depth, self.steps
        self.steps += 1
        self.touching += touching
        self.deep += depth > ALLOWED
        self.deep_uncrossed += depth > ALLOWED and own == 0
        self._deep_since = self._deep_since + 1 if depth > ALLOWED else 0
        self.longest_deep = max(self.longest_deep, self._deep_since)
        self.unreported += depth > ALLOWED >= reported
        self.reported = max(self.reported, reported)
        self.wrong_side += seen.wrong_side
        self.crossed += own > 0
        self._crossed_since = self._crossed_since + 1 if own else 0
        self.longest_crossed = max(self.longest_crossed, self._crossed_since)
        self.most_crossings = max(self.most_crossings, own)
        self.crossed_between += seen.crossings.between > 0

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}


def watch_motion(simulation: Simulation, linear: FloatArray, angular: FloatArray, *, show: bool = False) -> Tally:
    """Move a simulation's tools, and look after every physics step.

    Args:
        simulation: Where to begin.
        linear: (S, N, 3) of the tools in each step [u/s].
        angular: (S, N, 3) world frame [rad/s].
        show: Whether to print a line for each step.

    Returns:
        What was seen.
    """
    inspector, tally = WorldInspector(simulation.scene), Tally()
    inspector.inspect(simulation.tool_positions, simulation.tool_orientations, simulation.nodes)
    if show:
        print(" step    node   corner     edge  surface residual | reported crossings    force [N] flags")
    for step, (v, w) in enumerate(zip(linear, angular, strict=True)):
        try:
            report = simulation.step(v, w)
        except SimulationDiverged:
            tally.diverged = True
            break
        seen = inspector.inspect(simulation.tool_positions, simulation.tool_orientations, simulation.nodes)
        force = float(np.linalg.norm(report.loads[:, :3], axis=1).max())
        tally.add(seen, touching=force > 0.0, reported=report.residual)
        if show:
            deepest = max(seen.tools, key=lambda each: each.residual)
            flags = sum(int(found.flags.sum()) for row in report.all_contacts for found in row)
            print(
                f"{step:5d} {deepest.node_depth:8.4f} {deepest.corner_depth:8.4f} {deepest.edge_depth:8.4f}"
                f" {deepest.surface_depth:8.4f} {seen.residual:8.4f} | {report.residual:8.4f}"
                f" {seen.crossings.own:9d} {force * simulation.scene.scale.force:12.3f} {flags:5d}"
                + ("  wrong side" if seen.wrong_side else "")
            )
    return tally


def restore_recording(simulation: Simulation, path: Path) -> tuple[FloatArray, FloatArray]:
    """Put a simulation into the state of a recording.

    Args:
        simulation: Of the scene that was recorded.
        path: Of the .npz file.

    Returns:
        How the tools move: linear and angular velocities, (S, N, 3) each.

    Raises:
        ValueError: If the file lacks something, or does not fit the scene.
    """
    with np.load(path) as recorded:
        missing = [name for name in motions.RECORDED if name not in recorded]
        if missing:
            raise ValueError(f"{path} must hold {list(motions.RECORDED)}, it lacks {missing}")
        nodes, velocities, positions, orientations, linear, angular = (
            np.array(recorded[name], dtype=np.float64) for name in motions.RECORDED
        )
    simulation.restore(
        replace(
            simulation.save(),
            nodes=nodes,
            node_velocities=velocities,
            tool_positions=positions,
            tool_orientations=orientations,
        )
    )
    return linear, angular


def main() -> None:
    """Make a motion, look, and print."""
    options = parser(__doc__ or "")
    options.formatter_class = argparse.RawDescriptionHelpFormatter
    options.add_argument("--scene", choices=motions.SCENES, default="seed")
    options.add_argument("--engine", choices=ENGINES, default="batch")
    options.add_argument("--motion", choices=tuple(motions.MOTIONS), default="slide")
    options.add_argument("--recording", type=Path, help="an .npz file, instead of a motion")
    options.add_argument("--seconds", type=float, default=1.0, help="how long a motion is [s]")
    options.add_argument("--seed", type=int, default=0, help="of a motion")
    arguments = options.parse_args()
    if not arguments.seconds > 0.0:
        options.error(f"--seconds must be positive, got {arguments.seconds}")
    simulation = Simulation(getattr(scenes, arguments.scene)(), engine=arguments.engine)
    if arguments.recording is not None:
        try:
            linear, angular = restore_recording(simulation, arguments.recording)
        except (OSError, ValueError) as error:
            options.error(f"--recording: {error}")
    else:
        generator = np.random.default_rng(arguments.seed)
        linear, angular = motions.MOTIONS[arguments.motion](simulation, arguments.seconds, generator)
    start = time.perf_counter()
    tally = watch_motion(simulation, linear, angular, show=not arguments.json)
    simulation.close()
    finish(
        {
            "benchmark": "inspection",
            "scene": arguments.scene,
            "engine": arguments.engine,
            "motion": str(arguments.recording or arguments.motion),
            "passed": not (tally.deep or tally.wrong_side or tally.crossed or tally.diverged),
            "seconds": time.perf_counter() - start,
            **tally.as_dict(),
        }
    )


if __name__ == "__main__":
    main()
