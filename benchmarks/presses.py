"""Presses of the spatula into an organ of one's own, along its surface's normal, inspected in every physics step."""

from __future__ import annotations

import math
import warnings
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.crossings import CrossingCounter
from benchmarks.inspection import ALLOWED, Inspector
from spatula_env import Simulation, scenes
from spatula_env.envs.press import PRESS
from spatula_env.envs.scenery import with_short_steps
from spatula_env.envs.workspace import place_workspace, setting_of
from spatula_env.geometry.transforms import rotate
from spatula_env.scenes import Material
from spatula_env.sim import SceneWarning, SimulationDiverged
from spatula_env.tasks.places import judge_candidates, place_on, turned_to

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray, IndexArray
    from spatula_env.geometry import PreparedOrgan
    from spatula_env.tasks.situation import Setting

SPEEDS = (0.05, 0.5, 4.0)
"""Speeds of the spatula [m/s]."""

DEPTH = 0.01
"""How far its lower face is pressed below the undeformed surface [m]."""

GAP = 0.002
"""Distance from the surface at which it starts [m]."""

HEIGHTS = (0.003, 0.01, 0.02, 0.03)
"""Heights above the surface at which it has to be free of the organ [m]."""

HOLD = 0.25
"""How long it is held at the end of its way [s]."""

NEARLY = 0.9
"""Places count as equally deep from this part of the greatest depth on."""


@dataclass(frozen=True)
class Place:
    """Where the spatula is pressed.

    Attributes:
        point: (3,) on the surface at rest [u].
        normal: (3,) unit normal of the surface there.
        orientation: (4,) of the spatula, quaternion xyzw.
        allowed: Greatest depth to which the task would press there [m].
    """

    point: FloatArray
    normal: FloatArray
    orientation: FloatArray
    allowed: float


@dataclass
class Press:
    """What happened in one press. Counts are numbers of physics steps, all of which are inspected.

    Attributes:
        engine: The engine.
        speed: Speed of the spatula [m/s].
        steps: Steps made.
        touching: Steps in which the spatula felt a force.
        reached: How deep its lower face is below the undeformed surface; it stops where tissue cannot give way [m].
        reported: Greatest residual of a report [u].
        depth: Greatest exact depth of the spatula in the organ or of the organ in the spatula [u].
        missed: Steps in which a contact node was deeper than `ALLOWED` in the organ, or the spatula's middle inside it,
            and no flag was set.
        inside: Steps in which the spatula's middle or a column through its thickness was inside the organ, or some of
            the surface had gone through it.
        crossed: Steps in which the organ crossed itself.
        longest_crossed: Most of them in a row.
        shaking: Root mean square speed of the organ's nodes in the last step, after the hold [m/s].
        diverged: Why the simulation diverged; "" if it did not.
    """

    engine: str
    speed: float
    steps: int = 0
    touching: int = 0
    reached: float = 0.0
    reported: float = 0.0
    depth: float = 0.0
    missed: int = 0
    inside: int = 0
    crossed: int = 0
    longest_crossed: int = 0
    shaking: float = 0.0
    diverged: str = ""

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Drawn:
    """What is drawn of a press.

    Attributes:
        nodes: (V, 3) of the organ at the end [u].
        triangles: (T, 3) of the organ.
        corners: (K, 3) of the spatula [u].
        faces: (M, 3) its triangles.
        normal: (3,) of the surface at rest, where it is pressed.
    """

    nodes: FloatArray
    triangles: IndexArray
    corners: FloatArray
    faces: IndexArray
    normal: FloatArray


@dataclass(frozen=True)
class Pressed:
    """The presses of one organ with one engine.

    Attributes:
        engine: The engine.
        radius: Half of the smallest extent of the organ at rest [u].
        places: How many places there are, and why the others are none.
        allowed: Depth to which the task would press at the place [m]; 0 without one.
        presses: One for each speed; none without a place.
        failure: Why no press could be made, though there ought to be one; "" if it could.
        warned: What the scene warned of.
        picture: The end of the first press; None without one.
    """

    engine: str
    radius: float = math.nan
    places: str = ""
    allowed: float = 0.0
    presses: tuple[Press, ...] = ()
    failure: str = ""
    warned: tuple[str, ...] = ()
    picture: Drawn | None = field(default=None, repr=False)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "engine": self.engine,
            "radius": None if math.isnan(self.radius) else self.radius,
            "places": self.places,
            "allowed": self.allowed,
            "presses": [press.as_dict() for press in self.presses],
            "failure": self.failure,
            "warnings": list(self.warned),
        }


def press_organ(organ: PreparedOrgan, engine: str, speeds: tuple[float, ...] = SPEEDS) -> Pressed:
    """Press an organ at some speeds, each time from rest, and inspect every step.

    The scene is that of Press on an organ of one's own. Forces are not calibrated, as they are not looked at: that
    changes the meaning of a unit of mass, and no motion.

    Args:
        organ: The organ, with held nodes, and for "tissue" with tetrahedra unless Netgen is installed.
        engine: "batch" or "tissue".
        speeds: Speeds of the spatula [m/s].
    """
    scene = scenes.organ_from_above(organ)
    if engine == "tissue":
        scene = with_short_steps(scenes.with_material(scene, Material()))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SceneWarning)
        try:
            simulation = Simulation(scene, engine=engine)
        except (ImportError, ValueError, SimulationDiverged) as error:
            return Pressed(engine, failure=str(error))
    warned = tuple(str(each.message) for each in caught)
    try:
        rest = simulation.nodes
        radius = 0.5 * float(np.ptp(rest, axis=0).min())
        workspace = place_workspace(scene, rest, PRESS.workspace_height)
        setting = setting_of(scene, workspace, rest)
        place, told = find_place(setting)
        if place is None:
            return Pressed(engine, radius, told, warned=warned)
        point = workspace.to_scene(place.point)
        presses: list[Press] = []
        picture = None
        for speed in speeds:
            simulation.reset()
            presses.append(_press(simulation, engine, point, place, speed))
            if picture is None:
                picture = _drawn(simulation, place.normal)
        return Pressed(engine, radius, told, place.allowed, tuple(presses), "", warned, picture)
    finally:
        simulation.close()


def find_place(setting: Setting) -> tuple[Place | None, str]:
    """The place that may be pressed deepest; of those that are nearly as deep, the nearest to the workspace's middle.

    Args:
        setting: Setting of the press.

    Returns:
        The place, with its point in the workspace frame [m], or None if none can be pressed `DEPTH` deep; and how many
        there are and why the others are none.
    """
    judged = judge_candidates(setting, DEPTH, HEIGHTS)
    told = judged.told(setting.organ)
    good = np.flatnonzero(judged.good)
    if not len(good):
        return None, told
    deep = good[judged.depths[good] >= NEARLY * judged.depths[good].max()]
    points = judged.spots.some(deep).on(setting.rest_nodes)
    nearest = int(np.argmin((points[:, :2] ** 2).sum(axis=1)))
    tool = setting.tools[0]
    half_width = float(np.abs(tool.vertices[:, :2]).max())
    point, normal = (found[0] for found in place_on(setting, points[nearest : nearest + 1, :2], half_width))
    return Place(point, normal, turned_to(normal, tool.orientation), float(judged.depths[deep[nearest]])), told


def _press(simulation: Simulation, engine: str, point: FloatArray, place: Place, speed: float) -> Press:
    """Press once, hold, and inspect every step; the point is in the scene [u]."""
    length, dt = simulation.scene.scale.length, simulation.dt
    shape = simulation.scene.tools[0].tool
    result = Press(engine, speed)
    inspector = Inspector(shape, simulation.triangles)
    counter = CrossingCounter(simulation.nodes, simulation.triangles)
    under = float(np.asarray(shape.vertices)[:, 2].min())
    start = point + (GAP / length - under) * place.normal
    simulation.place_tool(start, place.orientation)
    inspector.inspect(simulation.tool_position, simulation.tool_orientation, simulation.nodes)
    left, in_a_row = (DEPTH + GAP) / length, 0
    for _ in range(math.ceil(left / (speed / length * dt) - 1e-9) + round(HOLD / dt)):
        way = min(speed / length * dt, left)
        left -= way
        try:
            report = simulation.step(-way / dt * place.normal)
        except SimulationDiverged as error:
            result.diverged = str(error)
            break
        nodes, flags = simulation.nodes, report.contacts.flags
        if not (np.isfinite(nodes).all() and np.isfinite(report.force).all()):
            result.diverged = "nodes or forces are not finite"
            break
        seen = inspector.inspect(simulation.tool_position, simulation.tool_orientation, nodes)
        crossings = counter.count(nodes).own
        in_a_row = in_a_row + 1 if crossings else 0
        result.steps += 1
        result.reached = float((start - simulation.tool_position) @ place.normal) * length - GAP
        result.touching += bool(np.any(report.force))
        result.reported = max(result.reported, report.residual)
        result.depth = max(result.depth, seen.residual)
        result.missed += bool((seen.node_depth > ALLOWED or seen.centre_inside) and not flags.any())
        result.inside += seen.wrong_side
        result.crossed += crossings > 0
        result.longest_crossed = max(result.longest_crossed, in_a_row)
    result.shaking = length * math.sqrt(float((simulation.node_velocities**2).sum(axis=1).mean()))
    return result


def _drawn(simulation: Simulation, normal: FloatArray) -> Drawn:
    tool = simulation.scene.tools[0].tool
    corners = rotate(simulation.tool_orientation, np.asarray(tool.vertices)) + simulation.tool_position
    return Drawn(simulation.nodes, simulation.triangles, corners, tool.triangles, normal)
