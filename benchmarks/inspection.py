"""Inspects tools and organs: how deep one is inside the other, and where organs cross themselves or each other.

The inspection shares nothing with the contact detector that it judges. Points are inside an organ by the winding number
of its surface. The depth of the surface in a tool is the greatest over all points of the triangles, not only over
vertices. Whether the organ has slipped past the tool is decided from the paths of its vertices. An organ crosses itself
where one of its edges goes through one of its triangles.

As a command it makes a motion in a scene, or repeats a recorded one, and inspects after every physics step.
`benchmarks.recordings` describes what a recording holds; `benchmarks.endurance --save` writes recordings.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from benchmarks import motions
from benchmarks.crossings import CrossingCounter, Crossings
from benchmarks.depths import BAND, depth_of_surface, find_inside, is_inside, measure_depths, see
from benchmarks.measure import finish, parser
from benchmarks.passages import count_passages, find_passages
from benchmarks.probes import RIM, Probe, make_probe
from benchmarks.recordings import restore_recording
from spatula_env import Simulation, scenes
from spatula_env._kernels import inline_kernel, kernel
from spatula_env.engines import ENGINES
from spatula_env.sim import SimulationDiverged

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from spatula_env.geometry import Tool
    from spatula_env.scenes import Scene

    FloatArray = NDArray[np.float64]

ALLOWED = 0.01
"""Greatest depth that is not a fault [u]: 0.2 mm in the scenes of the tasks."""


@dataclass(frozen=True)
class Inspection:
    """How a tool and an organ overlap at one instant.

    Attributes:
        node_depth: Greatest depth of one of the tool's contact nodes inside the organ [u].
        corner_depth: Greatest depth of one of the tool's corners inside the organ [u].
        edge_depth: Greatest depth of a sample point on the tool's edges inside the organ; samples are at most
            `EDGE_SPACING` apart [u].
        surface_depth: Greatest depth of any point of the organ's surface inside the tool, exact [u].
        centre_inside: Whether the tool's origin is inside the organ.
        enclosed: How many of the tool's columns have both ends and the middle inside the organ. A column runs from a
            contact node to its opposite; columns within `RIM` of another face do not count. A blade squeezed between
            two walls may have both ends slightly inside them, which is measured as a depth; its middle is outside.
        passages: How many vertices of the organ have gone right through the tool since the last inspection, in by one
            face and out by the opposite one, with the outside of the organ ahead. Paths are taken as straight in the
            tool's frame; those that cross one of the two faces within `RIM` of another face do not count.
        turned: How many vertices have done so with the inside of the organ ahead: an organ that resists neither contact
            with itself nor inversion may turn inside out over a tool that is rightly outside it. A vertex that goes
            back the way it came counts neither as a passage nor as turned.
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
"""The inspection of a tool that is far from all organs."""

SEEN = np.dtype(
    [
        ("node_depth", "f8"),
        ("corner_depth", "f8"),
        ("edge_depth", "f8"),
        ("surface_depth", "f8"),
        ("enclosed", "i8"),
        ("passages", "i8"),
        ("turned", "i8"),
        ("centre_inside", "?"),
    ],
    align=True,
)
"""Structured data type with the fields of `Inspection`."""

ROUNDING = 1e-9
"""Boxes count as overlapping if the gap between them is at most this [u]."""

DEPTHS = ("node_depth", "corner_depth", "edge_depth", "surface_depth")
"""The fields that are depths."""


class Past(NamedTuple):
    """State of one tool and the organs of each world, kept from one inspection to the next, for kernels.

    Attributes:
        known: (W,) whether the other fields are valid.
        vertices: (W, V, 3) vertices of the organs, in the tool's frame [u].
        sides: (W, V) bit set of the sides of the tool's box that each vertex was outside of.
        entries: (W, V) face by which each vertex inside the tool came in; -1 for other vertices and where unknown.
        strayed: (W, V) face by which each vertex came in that has gone through and not back; -1 for other vertices.
    """

    known: NDArray[np.bool_]
    vertices: FloatArray
    sides: NDArray[np.uint8]
    entries: NDArray[np.int32]
    strayed: NDArray[np.int32]


def make_past(worlds: int, vertices: int) -> Past:
    """Make an empty `Past`.

    Args:
        worlds: Number of worlds.
        vertices: Number of vertices of all organs in a world.
    """
    return Past(
        known=np.zeros(worlds, dtype=np.bool_),
        vertices=np.zeros((worlds, vertices, 3)),
        sides=np.zeros((worlds, vertices), dtype=np.uint8),
        entries=np.full((worlds, vertices), -1, dtype=np.int32),
        strayed=np.full((worlds, vertices), -1, dtype=np.int32),
    )


@inline_kernel
def _to_frame(vertices: np.ndarray, position: np.ndarray, orientation: np.ndarray, local: np.ndarray) -> None:
    """Write vertices (V, 3) into `local` (V, 3), relative to a frame with a position (3,) and an orientation (4,)."""
    x, y, z, w = orientation[0], orientation[1], orientation[2], orientation[3]
    xx, xy, xz = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)
    yx, yy, yz = 2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + x * w)
    zx, zy, zz = 2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)
    for v in range(vertices.shape[0]):
        a, b, c = vertices[v, 0] - position[0], vertices[v, 1] - position[1], vertices[v, 2] - position[2]
        local[v, 0] = xx * a + xy * b + xz * c
        local[v, 1] = yx * a + yy * b + yz * c
        local[v, 2] = zx * a + zy * b + zz * c


@inline_kernel
def _fill_sides(vertices: np.ndarray, box: np.ndarray, sides: np.ndarray) -> None:
    """Write which sides of a box (6,), enlarged by `BAND`, each vertex (V, 3) is outside of: a bit for each side."""
    for v in range(vertices.shape[0]):
        bits = 0
        for axis in range(3):
            if vertices[v, axis] < box[axis] - BAND:
                bits |= 1 << axis
            if vertices[v, axis] > box[3 + axis] + BAND:
                bits |= 8 << axis
        sides[v] = bits


@inline_kernel
def _is_off(vertices: np.ndarray, box: np.ndarray, position: np.ndarray, radius: float) -> bool:
    """Whether a ball is outside the bounding box of all organs; `box` (6,) is workspace."""
    for axis in range(3):
        low, high = np.inf, -np.inf
        for v in range(vertices.shape[0]):
            low, high = min(low, vertices[v, axis]), max(high, vertices[v, axis])
        box[axis], box[3 + axis] = low, high
    for axis in range(3):
        if position[axis] + radius < box[axis] or position[axis] - radius > box[3 + axis]:
            return True
    return False


@inline_kernel
def _find_near(
    vertices: np.ndarray, triangles: np.ndarray, sides: np.ndarray, box: np.ndarray, near: np.ndarray
) -> tuple[int, bool]:
    """Write the triangles that may be within `BAND` of a box (6,) into `near` (T,).

    Returns:
        Number of these triangles, and whether the bounding box of any of them overlaps this box.
    """
    count, touching = 0, False
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if sides[a] & sides[b] & sides[c]:
            continue
        near[count] = t
        count += 1
        if not touching:
            touching = True
            for axis in range(3):
                x, y, z = vertices[a, axis], vertices[b, axis], vertices[c, axis]
                if min(x, y, z) > box[3 + axis] + ROUNDING or max(x, y, z) < box[axis] - ROUNDING:
                    touching = False
    return count, touching


@kernel()
def inspect_tool(
    probe: Probe,
    triangles: np.ndarray,
    positions: np.ndarray,
    orientations: np.ndarray,
    vertices: np.ndarray,
    active: np.ndarray,
    past: Past,
    seen: np.ndarray,
) -> None:
    """Inspect one tool of the active worlds.

    Args:
        probe: Probe of the tool.
        triangles: (T, 3) of the closed surfaces of all organs, counter-clockwise from outside.
        positions: (W, 3) of the tool [u].
        orientations: (W, 4) of the tool.
        vertices: (W, V, 3) of the organs [u].
        active: (W,) which worlds to inspect.
        past: State kept from call to call; updated in place.
        seen: (W,) output of type `SEEN`; must be zero beforehand.
    """
    size = vertices.shape[1]
    local, along = np.empty((size, 3)), np.empty((size, 3))
    sides, ways = np.empty(size, np.uint8), np.empty(size, np.int32)
    places, origin = probe.points.places, probe.points.places.shape[0] - 1
    near, around = np.empty(triangles.shape[0], np.int64), np.empty(6)
    inside, depths = np.empty(places.shape[0], np.bool_), np.empty(places.shape[0])
    for w in range(vertices.shape[0]):
        if not active[w]:
            continue
        if _is_off(vertices[w], around, positions[w], probe.radius):
            past.known[w] = False
            continue
        result = seen[w]
        _to_frame(vertices[w], positions[w], orientations[w], local)
        _fill_sides(local, probe.box, sides)
        if not past.known[w]:
            past.entries[w], past.strayed[w] = -1, -1
        elif find_passages(
            past.vertices[w], local, past.sides[w], sides, probe.normals, probe.offsets, RIM, past.entries[w], ways
        ):
            result.passages, result.turned = count_passages(
                past.vertices[w], triangles, probe.normals, ways, past.strayed[w]
            )
        past.known[w] = True
        past.vertices[w], past.sides[w] = local, sides
        count, touching = _find_near(local, triangles, sides, probe.box, near)
        see(local, along)
        # If no part of the surface reaches the tool, the tool is inside as a whole or not at all: its origin decides.
        if not touching and not is_inside(places[origin], probe.points.seen[origin], local, along, triangles):
            continue
        if touching:
            result.surface_depth = depth_of_surface(local, triangles, near[:count], probe.normals, probe.offsets)
        if not find_inside(probe.points, local, along, triangles, inside):
            continue
        measure_depths(places, local, triangles, near[:count], inside, depths)
        for i in range(probe.ends[2]):
            if i < probe.ends[0]:
                result.node_depth = max(result.node_depth, depths[i])
            elif i < probe.ends[1]:
                result.corner_depth = max(result.corner_depth, depths[i])
            else:
                result.edge_depth = max(result.edge_depth, depths[i])
        result.centre_inside = inside[origin]
        for k in range(probe.columns.shape[0]):
            if inside[probe.columns[k, 0]] and inside[probe.columns[k, 1]] and inside[probe.columns[k, 2]]:
                result.enclosed += 1


class Inspector:
    """Inspects one tool and one organ, step after step.

    Args:
        tool: The tool.
        triangles: (T, 3) of the organ's closed surface, counter-clockwise from outside; or of several organs.
    """

    def __init__(self, tool: Tool, triangles: ArrayLike) -> None:
        self._triangles = np.array(triangles, dtype=np.int32, order="C")
        # No early exit, however far the tool is: it may go right through the organ in one step.
        self._probe = make_probe(tool)._replace(radius=np.inf)
        self._past: Past | None = None
        self._every = np.ones(1, dtype=np.bool_)

    def reset(self) -> None:
        """Forget where the organ was, so that the next inspection counts no passages."""
        self._past = None

    def inspect(self, position: ArrayLike, orientation: ArrayLike, vertices: FloatArray) -> Inspection:
        """Inspect the present state.

        Args:
            position: (3,) of the tool [u].
            orientation: (4,) of the tool, unit quaternion xyzw.
            vertices: (V, 3) of the organ, world frame [u], finite.

        Returns:
            The inspection.
        """
        if self._past is None:
            self._past = make_past(1, len(vertices))
        seen = np.zeros(1, dtype=SEEN)
        inspect_tool(
            self._probe,
            self._triangles,
            np.array(position, dtype=np.float64)[None],
            np.array(orientation, dtype=np.float64)[None],
            np.ascontiguousarray(vertices)[None],
            self._every,
            self._past,
            seen,
        )
        return _as_inspection(seen[0])


def _as_inspection(row: Any) -> Inspection:
    """Convert one record of type `SEEN`."""
    return Inspection(**dict(zip(SEEN.names or (), row.tolist(), strict=True)))


@dataclass(frozen=True)
class WorldInspection:
    """Inspection of a world at one instant.

    Attributes:
        tools: Inspection of each tool against all organs together.
        crossings: Crossings of the organs.
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


@dataclass(frozen=True)
class WorldsInspection:
    """Inspection of many worlds at one instant; zero in inactive worlds.

    Attributes:
        tools: (W, N) of type `SEEN`: inspection of each tool against all organs together.
        own: (W,) crossings of organs with themselves.
        between: (W,) crossings of organs with each other.
    """

    tools: Any
    own: NDArray[np.int64]
    between: NDArray[np.int64]

    @property
    def residuals(self) -> FloatArray:
        """(W,) greatest depth of a tool in an organ or the other way round [u]."""
        return np.max([self.tools[name] for name in DEPTHS], axis=0).max(axis=1)

    @property
    def wrong_side(self) -> NDArray[np.bool_]:
        """(W,) whether some of an organ's surface is on the far side of a tool."""
        tools = self.tools
        return (tools["centre_inside"] | (tools["enclosed"] > 0) | (tools["passages"] > 0)).any(axis=1)

    def world(self, index: int) -> WorldInspection:
        """Inspection of the world with this index."""
        return WorldInspection(
            tuple(_as_inspection(row) for row in self.tools[index]),
            Crossings(int(self.own[index]), int(self.between[index])),
        )


class WorldsInspector:
    """Inspects all tools and organs of many worlds of one scene, step after step.

    Args:
        scene: Scene of each world.
        worlds: Number of worlds.
    """

    def __init__(self, scene: Scene, worlds: int) -> None:
        sizes = [len(placed.organ.vertices) for placed in scene.organs]
        starts = np.cumsum([0, *sizes[:-1]])
        self._triangles = np.concatenate(
            [placed.organ.triangles + start for placed, start in zip(scene.organs, starts, strict=True)]
        ).astype(np.int32)
        self._probes = [make_probe(placed.tool) for placed in scene.tools]
        self._pasts = [make_past(worlds, sum(sizes)) for _ in scene.tools]
        vertices = np.concatenate([placed.vertices for placed in scene.organs])
        self._crossings = CrossingCounter(vertices, self._triangles, np.repeat(np.arange(len(sizes)), sizes), worlds)
        self._every = np.ones(worlds, dtype=np.bool_)

    def reset(self, worlds: ArrayLike) -> None:
        """Forget where the organs of some worlds (n,) were, so that the next inspection counts no passages there."""
        for past in self._pasts:
            past.known[np.asarray(worlds, dtype=np.int64)] = False

    def inspect(
        self,
        positions: FloatArray,
        orientations: FloatArray,
        vertices: FloatArray,
        active: NDArray[np.bool_] | None = None,
    ) -> WorldsInspection:
        """Inspect the present state.

        Args:
            positions: (W, N, 3) of the tools [u].
            orientations: (W, N, 4) of the tools, unit quaternions xyzw.
            vertices: (W, V, 3) of all organs, world frame [u], finite in active worlds.
            active: (W,) which worlds to inspect; all by default.

        Returns:
            The inspection.
        """
        active = self._every if active is None else active
        vertices = np.ascontiguousarray(vertices)
        tools = np.zeros((len(self._probes), len(vertices)), dtype=SEEN)
        for index, (probe, past) in enumerate(zip(self._probes, self._pasts, strict=True)):
            inspect_tool(
                probe,
                self._triangles,
                np.ascontiguousarray(positions[:, index]),
                np.ascontiguousarray(orientations[:, index]),
                vertices,
                active,
                past,
                tools[index],
            )
        return WorldsInspection(tools.T, *self._crossings.count_all(vertices, active))


class WorldInspector:
    """Inspects all tools and organs of one world, step after step.

    Args:
        scene: Scene of the world.
    """

    def __init__(self, scene: Scene) -> None:
        self._worlds = WorldsInspector(scene, 1)

    def reset(self) -> None:
        """Forget where the organs were, so that the next inspection counts no passages."""
        self._worlds.reset([0])

    def inspect(self, positions: FloatArray, orientations: FloatArray, vertices: FloatArray) -> WorldInspection:
        """Inspect the present state.

        Args:
            positions: (N, 3) of the tools [u].
            orientations: (N, 4) of the tools, unit quaternions xyzw.
            vertices: (V, 3) of all organs, world frame [u], finite.

        Returns:
            The inspection.
        """
        return self._worlds.inspect(positions[None], orientations[None], vertices[None]).world(0)


@dataclass
class Tally:
    """Counts over the physics steps of a run.

    Attributes:
        steps: Number of steps.
        touching: Steps in which a tool felt a force.
        depth: Greatest depth [u].
        deepest_step: Step in which that was, counted from 0.
        deep: Steps in which a depth was greater than `ALLOWED`.
        deep_uncrossed: Deep steps in which no organ crossed itself.
        longest_deep: Greatest number of consecutive deep steps.
        unreported: Deep steps in which the residual of the report was not greater than `ALLOWED`.
        reported: Greatest residual of a report [u].
        wrong_side: Steps in which some of an organ's surface was on the far side of a tool.
        crossed: Steps in which an organ crossed itself.
        longest_crossed: Greatest number of consecutive steps in which an organ crossed itself.
        most_crossings: Greatest number of crossings of organs with themselves in a step.
        crossed_between: Steps in which organs crossed each other.
        diverged: Whether the simulation diverged.
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
        """Number of consecutive steps, up to the latest one, in which an organ has crossed itself."""
        return self._crossed_since

    def add(self, seen: WorldInspection, *, touching: bool, reported: float) -> None:
        """Count one physics step.

        Args:
            seen: Inspection after the step.
            touching: Whether a tool felt a force in it.
            reported: Residual of the step's report [u].
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
        """The counts, for JSON."""
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}


def watch_motion(simulation: Simulation, linear: FloatArray, angular: FloatArray, *, show: bool = False) -> Tally:
    """Move a simulation's tools, and inspect after every physics step.

    Args:
        simulation: The simulation, in the state to begin from.
        linear: (S, N, 3) linear velocities of the tools in each step [u/s].
        angular: (S, N, 3) angular velocities, world frame [rad/s].
        show: Whether to print a line for each step.

    Returns:
        Counts over all steps, up to a divergence.
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


def main() -> None:
    """Make a motion, inspect it, and print."""
    options = parser(__doc__ or "")
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
