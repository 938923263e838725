"""Draws the figures of docs/contact-model.md: `python scripts/contact_figures.py`, in the repository's root.

Every figure shows results of a run of the package, and nothing is random: the same code draws the same figures. With
each file it prints a caption with the numbers of that run. It takes about half a minute.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.inspection import Inspector
from benchmarks.plunges import ALLOWED
from spatula_env import Simulation, scenes
from spatula_env.contact.flags import FlaggedDetector
from spatula_env.contact.path import MARGIN, RESIDUAL_TOLERANCE, entry_plane
from spatula_env.contact.rows import ON_CORNER, ON_EDGE, ON_NODE, ON_VERTEX
from spatula_env.contact.settings import CONTACT_COUNT
from spatula_env.contact.structures import NORMAL, OWNER, PLANE, WEIGHTS, copy_constraints
from spatula_env.geometry import Tool
from spatula_env.geometry.transforms import (
    quaternion_conjugate,
    quaternion_from_axis_angle,
    quaternion_multiply,
    rotate,
)
from spatula_env.installing import install_hint
from spatula_env.sim.simulation import SimulationDiverged

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from spatula_env.arrays import FloatArray
    from spatula_env.contact.flags import FirstStep
    from spatula_env.sim.simulation import ContactName


WIDTH = 1000
"""Width of every figure [pixels]."""

DOTS_PER_INCH = 100

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
"""Orientation of a plate that lies flat, quaternion xyzw."""

STYLE: dict[Any, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": "0.35",
    "axes.grid": True,
    "axes.labelsize": 11,
    "axes.titlesize": 12,
    "figure.dpi": DOTS_PER_INCH,
    "font.family": "DejaVu Sans",
    "font.size": 10.5,
    "grid.color": "0.92",
    "legend.fontsize": 10.5,
    "legend.frameon": False,
}
"""Matplotlib settings of all figures."""

BLUE, ORANGE, GREEN, PINK, SKY = "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9"
"""M. Okabe and K. Ito's colours, for all kinds of colour vision."""

DASH = (0, (3.5, 2.0))
"""Pattern of broken lines."""

ORGAN, ORGAN_LINE, PLATE, PLATE_LINE = "#f7e9e4", "#8a4a3c", "0.85", "0.25"
"""Fill and line colours of organ and plate."""


def start_figure(height: float) -> Figure:
    """Make an empty figure, `WIDTH` wide, which opens no window.

    Args:
        height: Height of the figure [pixels].
    """
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH / DOTS_PER_INCH, height / DOTS_PER_INCH), layout="constrained")


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, without the name and version of the library that drew it."""
    figure.savefig(path, format="png", metadata={"Software": None})


def styled() -> AbstractContextManager[Any]:
    """A context in which Matplotlib uses `STYLE`.

    Raises:
        ImportError: If Matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise ImportError(f"the figures need Matplotlib: {install_hint('viz')}") from error
    context: AbstractContextManager[Any] = matplotlib.rc_context(STYLE)
    return context


def _draw_arrow(
    panel: Axes,
    start: FloatArray,
    end: FloatArray,
    colour: str,
    *,
    width: float,
    head: float,
    apart: float = 0.0,
    dash: Any = "-",
) -> None:
    """Draw an arrow from one point (2,) to another, with a gap of `apart` typographic points at both ends."""
    panel.annotate(
        "",
        (float(end[0]), float(end[1])),
        (float(start[0]), float(start[1])),
        zorder=3,
        arrowprops={
            "arrowstyle": "-|>",
            "color": colour,
            "linewidth": width,
            "linestyle": dash,
            "mutation_scale": head,
            "shrinkA": apart,
            "shrinkB": apart,
        },
    )


def top_of(simulation: Simulation) -> float:
    """Height of the organ's highest node [u]."""
    return float(simulation.nodes[:, 2].max())


def press_down(simulation: Simulation, target: float, speed: float) -> None:
    """Lower the first tool to a height [u] at a speed [u/s]; the last step is shortened as needed."""
    while (left := float(simulation.tool_position[2]) - target) > 1e-9:
        simulation.step((0.0, 0.0, -min(speed, left / simulation.dt)))


def cut_surface(vertices: FloatArray, triangles: NDArray[np.int32], y: float) -> FloatArray:
    """Cut a surface with a plane perpendicular to the y axis.

    Args:
        vertices: (V, 3) [u].
        triangles: (T, 3).
        y: Coordinate of the plane [u].

    Returns:
        (S, 2, 2) end points of the segments, as x and z [u].
    """
    segments = []
    for corners in vertices[triangles]:
        ends = []
        for a, b in ((0, 1), (1, 2), (2, 0)):
            before, after = corners[a, 1] - y, corners[b, 1] - y
            if (before < 0.0) != (after < 0.0):
                ends.append((corners[a] + before / (before - after) * (corners[b] - corners[a]))[[0, 2]])
        if len(ends) == 2:
            segments.append(ends)
    return np.array(segments).reshape(-1, 2, 2)


# The flags --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Query:
    """Result of a detector after a plate has come far into an organ in one step.

    Attributes:
        flags: (n,) nodes that are in contact.
        unfeasible: (n,) nodes that the first step refused.
        depths: (n,) depths of the nodes in contact [u].
        places: (n, 3) positions of the nodes [u].
        corners: (K, 3) corners of the plate [u].
    """

    flags: NDArray[np.bool_]
    unfeasible: NDArray[np.bool_]
    depths: FloatArray
    places: FloatArray
    corners: FloatArray


JUMP_SPEED = 100.0
"""Speed of the plate, at which both of its faces enter the organ in one step [u/s]."""

JUMP_TILT = 0.42
"""Tilt of that plate, which leaves one of its ends outside [rad]."""


def query_after_jump(simulation: Simulation, first_step: FirstStep) -> Query:
    """Query a detector before and after one fast step of the seed's plate.

    Args:
        simulation: Simulation of `scenes.seed()`; it is not changed.
        first_step: First step of the detector, "off" or "inside".

    Returns:
        Result of the detector after the step.
    """
    tool = simulation.scene.tools[0].tool
    orientation = quaternion_from_axis_angle((0.0, 1.0, 0.0), JUMP_TILT)
    lowest = float(rotate(orientation, tool.vertices)[:, 2].min())
    before = np.array([0.0, 0.0, top_of(simulation) - lowest + 0.02])
    velocity = np.array([0.0, 0.0, -JUMP_SPEED])
    after = before + velocity * simulation.dt
    detector = FlaggedDetector(tool, first_step)
    surface = simulation.nodes, simulation.triangles
    detector.detect(before, orientation, *surface, velocity)
    found = detector.detect(after, orientation, *surface, velocity)
    return Query(
        flags=found.flags,
        unfeasible=found.unfeasible,
        depths=found.depth,
        places=rotate(orientation, tool.nodes) + after,
        corners=rotate(orientation, tool.vertices) + after,
    )


def draw_flags(path: Path) -> str:
    """Draw which nodes are in contact after a fast step, by the second step alone and by the whole method.

    Args:
        path: File to write.

    Returns:
        A caption.
    """
    simulation = Simulation(scenes.seed())
    tool = simulation.scene.tools[0].tool
    both, one = query_after_jump(simulation, "off"), query_after_jump(simulation, "inside")
    nodes, triangles, dt = simulation.nodes, simulation.triangles, simulation.dt
    simulation.close()
    rows = np.unique(tool.nodes[:, 1])
    row = float(rows[rows > 0.0].min())
    segments = cut_surface(nodes, triangles, row)
    lower = tool.normals[:, 2] < 0.0
    with styled():
        figure = start_figure(405)
        panels = figure.subplots(1, 2, sharey=True)
        titles = ("Second step alone: both faces in contact", "Flags method: one face in contact")
        for panel, title, query in zip(panels, titles, (both, one), strict=True):
            _draw_section(panel, query, segments, tool, np.isclose(tool.nodes[:, 1], row))
            panel.set_title(title)
        panels[0].set_ylabel("z [u]")
        _add_legend_of_states(figure)
        save_figure(figure, path)
    return (
        f"The seed's plate ({tool.size[2]:g} u thick), {JUMP_SPEED * dt:.2f} u farther down after one step at "
        f"{JUMP_SPEED:g} u/s, cut along a row of its nodes. The second step alone flags {(both.flags & lower).sum()} "
        f"nodes of the lower face and {(both.flags & ~lower).sum()} of the upper, which would push the organ's surface "
        f"up to {both.depths[~lower].max():.1f} u away, on its far side; the flags method flags "
        f"{(one.flags & lower).sum()} of the lower face, at most {one.depths[lower].max():.2f} u deep, and finds "
        f"{(one.unfeasible & ~lower).sum()} of the upper face unfeasible."
    )


def _draw_section(panel: Axes, query: Query, segments: FloatArray, tool: Tool, shown: NDArray[np.bool_]) -> None:
    """Draw organ, plate, nodes and rays in a section perpendicular to y."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Polygon

    left, right, bottom, top = -0.85, 1.0, 5.1, 6.2
    outline = _order_around(segments.reshape(-1, 2))
    panel.add_patch(Polygon(outline, facecolor=ORGAN, edgecolor="none", zorder=0))
    panel.add_collection(LineCollection(list(segments), colors=ORGAN_LINE, linewidths=2.0, zorder=2))
    around = _order_around(query.corners[:, [0, 2]])
    panel.add_patch(Polygon(around, facecolor=PLATE, edgecolor=PLATE_LINE, linewidth=1.2, zorder=1, alpha=0.9))
    along = rotate(quaternion_from_axis_angle((0.0, 1.0, 0.0), JUMP_TILT), tool.normals)
    # The rays of opposite nodes coincide: drawn slightly apart, they can be told apart.
    for node in np.flatnonzero(shown):
        start, normal = query.places[node, [0, 2]], along[node, [0, 2]]
        aside = 0.012 * np.array([normal[1], -normal[0]])
        if query.flags[node]:
            end = start - query.depths[node] * normal
            visible = start - min(query.depths[node], _way_to(start[1], -normal[1], bottom, top)) * normal
            _draw_ray(panel, start + aside, visible + aside, ORANGE, "-", ends=bool(bottom < end[1] < top))
        elif query.unfeasible[node]:
            other = tool.opposite[node]
            start, normal = query.places[other, [0, 2]], along[other, [0, 2]]
            visible = start + _way_to(start[1], normal[1], bottom, top) * normal
            _draw_ray(panel, start - aside, visible - aside, BLUE, DASH, ends=False)
    for chosen, style in zip(_states(query, shown), NODE_STYLES.values(), strict=True):
        panel.plot(*query.places[chosen][:, [0, 2]].T, linestyle="none", zorder=4, **style)
    panel.set_xlim(left, right)
    panel.set_ylim(bottom, top)
    panel.set_aspect("equal")
    panel.grid(False)
    panel.set_xlabel("x [u]")
    panel.text(left + 0.03, top - 0.03, "outside", ha="left", va="top", color="0.35")
    panel.text(right - 0.03, 5.6, "organ", ha="right", va="center", color=ORGAN_LINE)
    inset = panel.inset_axes((0.735, 0.015, 0.25, 0.4))
    inset.add_patch(Polygon(outline, facecolor=ORGAN, edgecolor=ORGAN_LINE, linewidth=1.0))
    inset.add_patch(Polygon(around, facecolor=PLATE, edgecolor=PLATE_LINE, linewidth=0.8, zorder=3))
    for node in np.flatnonzero(shown & query.flags):
        start, normal = query.places[node, [0, 2]], along[node, [0, 2]]
        end = start - query.depths[node] * normal
        inset.plot([start[0], end[0]], [start[1], end[1]], color=ORANGE, linewidth=1.0)
        inset.plot(*end, ".", color=ORANGE, markersize=4)
    inset.set_xlim(-3.5, 3.5)
    inset.set_ylim(-0.3, 6.5)
    inset.set_aspect("equal")
    inset.set_xticks([])
    inset.set_yticks([])
    inset.grid(False)


NODE_STYLES: dict[str, dict[str, Any]] = {
    "flagged: in contact": {
        "marker": "o", "color": ORANGE, "markersize": 9, "markeredgecolor": "black", "markeredgewidth": 0.8,
    },
    "unfeasible: refused": {
        "marker": "X", "color": BLUE, "markersize": 10, "markeredgecolor": "black", "markeredgewidth": 0.8,
    },
    "free": {"marker": "o", "color": "white", "markersize": 8, "markeredgecolor": "0.3", "markeredgewidth": 1.4},
}  # fmt: skip
"""How nodes are drawn, by state."""


def _states(query: Query, shown: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], ...]:
    """Which nodes are flagged, unfeasible and free, in the order of `NODE_STYLES`."""
    return shown & query.flags, shown & query.unfeasible, shown & ~query.flags & ~query.unfeasible


def _draw_ray(panel: Axes, start: FloatArray, end: FloatArray, colour: str, dash: Any, *, ends: bool) -> None:
    """Draw a ray from a node, with a square where it ends on the organ, or a triangle where it goes on."""
    panel.plot([start[0], end[0]], [start[1], end[1]], color=colour, linestyle=dash, linewidth=1.4, zorder=3)
    if ends:
        panel.plot(*end, "s", color=colour, markersize=4, zorder=3)
    else:
        panel.plot(*end, "v", color=colour, markersize=6, zorder=3)


def _add_legend_of_states(figure: Figure) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], linestyle="none", label=label, **style) for label, style in NODE_STYLES.items()]
    handles.append(Line2D([], [], color=ORANGE, marker="s", markersize=4, label="ray inwards, to what the node pushes"))
    handles.append(Line2D([], [], color=BLUE, linestyle=DASH, label="ray outwards of the opposite node"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, columnspacing=1.4, handletextpad=0.6)


def _order_around(points: FloatArray) -> FloatArray:
    """Points (m, 2) of a convex outline, without duplicates and ordered around their middle."""
    points = np.unique(points.round(9), axis=0)
    away = points - points.mean(axis=0)
    ordered: FloatArray = points[np.argsort(np.arctan2(away[:, 1], away[:, 0]))]
    return ordered


def _way_to(start: float, slope: float, low: float, high: float) -> float:
    """Length of a ray from a height to slightly before the picture's upper or lower border [u].

    Args:
        start: Height at which the ray begins [u].
        slope: Vertical component of the ray's unit direction.
        low: Height of the lower border [u].
        high: Height of the upper border [u].
    """
    border = high if slope > 0.0 else low
    return (border - start) / slope - 0.02


# The path ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Way:
    """Path of a point of the organ into or through a plate, in the plate's frame.

    Attributes:
        title: Title of the panel.
        thickness: Thickness of the plate, which is 1 u wide [u].
        last: (2,) position at the last query, x and z [u].
        now: (2,) position now [u].
        middle: (2,) centre of the panel [u].
    """

    title: str
    thickness: float
    last: tuple[float, float]
    now: tuple[float, float]
    middle: tuple[float, float]


WAYS = (
    Way("Through the large face", 0.125, (0.03, -0.17), (0.10, -0.005), (0.08, 0.02)),
    Way("Round the rim, by the edge face", 0.125, (0.63, -0.07), (0.40, 0.045), (0.47, 0.02)),
    Way("Right through a thin plate", 0.02, (0.03, -0.14), (0.12, 0.12), (0.08, 0.02)),
)

FACE_NAMES = {(0, 0, -1): "lower face", (0, 0, 1): "upper face", (1, 0, 0): "edge face"}
"""Names of faces, by their outward normal."""


def find_entry(way: Way) -> tuple[int, int, FloatArray]:
    """Find the face of a plate through which a point came in, with `entry_plane`.

    Args:
        way: Path of the point.

    Returns:
        Index of the face, or -1; index of the face nearest to the point now; normals (F, 3) of all faces.
    """
    tool = Tool.box((1.0, 1.0, way.thickness), faces="all")
    normals = np.array(tool.face_normals)
    offsets = (tool.vertices @ normals.T).max(axis=0)
    (last_x, last_z), (x, z) = way.last, way.now
    face = int(entry_plane(last_x, 0.0, last_z, x, 0.0, z, normals, offsets, MARGIN))
    return face, int(np.argmin(np.abs(normals @ (x, 0.0, z) - offsets))), normals


def draw_path(path: Path) -> str:
    """Draw how the face that a surface came through is determined from its path.

    Args:
        path: File to write.

    Returns:
        A caption.
    """
    entries = [find_entry(way) for way in WAYS]
    with styled():
        from matplotlib.lines import Line2D

        figure = start_figure(395)
        panels = figure.subplots(1, len(WAYS))
        for panel, way, (face, nearest, normals) in zip(panels, WAYS, entries, strict=True):
            _draw_way(panel, way, face, nearest, normals)
        panels[0].set_ylabel("z in the tool's frame [u]")
        handles, labels = panels[0].get_legend_handles_labels()
        handles.append(Line2D([], [], color=ORANGE, linewidth=1.8, linestyle=DASH))
        figure.legend(handles, [*labels, "pushed back"], loc="outside lower center", ncols=5, columnspacing=1.4)
        save_figure(figure, path)
    told = "; ".join(
        f"{way.title[0].lower()}{way.title[1:]}: {face}, the {_face_name(normals[face])}"
        for way, (face, _, normals) in zip(WAYS, entries, strict=True)
    )
    return (
        "The face that a point of the organ came through, told by its straight path in the tool's frame since the last "
        f"query. What `entry_plane` returned: {told}."
    )


def _face_name(normal: FloatArray) -> str:
    x, y, z = np.rint(normal).astype(int).tolist()
    return FACE_NAMES[x, y, z]


def _draw_way(panel: Axes, way: Way, face: int, nearest: int, normals: FloatArray) -> None:
    """Draw a plate's section, the path of a point, and the face that it came through."""
    from matplotlib.patches import Rectangle

    half, reach, normal = 0.5 * way.thickness, 0.22, normals[face]
    names = _face_name(normal), _face_name(normals[nearest])
    panel.add_patch(
        Rectangle((-0.5, -half), 1.0, way.thickness, facecolor=PLATE, edgecolor=PLATE_LINE, linewidth=1.2, zorder=1)
    )
    ends = [(0.5, -half), (0.5, half)] if normal[0] > 0.5 else [(-0.5, -half), (0.5, -half)]
    panel.plot(
        *np.transpose(ends),
        color=ORANGE,
        linewidth=5,
        solid_capstyle="butt",
        zorder=2,
        label="face that it came through",
    )
    last, now = np.array(way.last), np.array(way.now)
    _draw_arrow(panel, last, now, BLUE, width=2.2, head=16, apart=5)
    panel.plot(
        *last,
        "o",
        color="white",
        markeredgecolor=BLUE,
        markeredgewidth=1.8,
        markersize=9,
        zorder=4,
        label="at the last query",
    )
    panel.plot(*now, "o", color=BLUE, markersize=9, zorder=4, label="now")
    along = normal[[0, 2]]
    offset = 0.5 if normal[0] > 0.5 else half
    part = (offset - last @ along) / ((now - last) @ along)
    panel.plot(
        *(last + part * (now - last)),
        "D",
        color=ORANGE,
        markeredgecolor="black",
        markersize=7,
        zorder=5,
        label="where it came through",
    )
    pushed = now + (offset - now @ along) * along
    _draw_arrow(panel, now, pushed, ORANGE, width=1.8, head=13, dash=DASH)
    panel.set_xlim(way.middle[0] - reach, way.middle[0] + reach)
    panel.set_ylim(way.middle[1] - reach, way.middle[1] + reach)
    panel.set_aspect("equal")
    panel.set_title(way.title)
    panel.set_xlabel("x in the tool's frame [u]")
    panel.text(
        0.5, 0.965, f"entry_plane: {face}, {names[0]}\nnearest now: {nearest}, {names[1]}",
        transform=panel.transAxes, ha="center", va="top", linespacing=1.4,
    )  # fmt: skip


# The features -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class KindStyle:
    """How constraints of one kind are drawn.

    Attributes:
        name: Name of the kind.
        colour: Colour of marks and normals.
        marker: Shape of the marks.
        size: Size of the marks; kinds that may cover others are smaller.
    """

    name: str
    colour: str
    marker: str
    size: float

    @property
    def marks(self) -> dict[str, Any]:
        """Arguments of Matplotlib's `plot` for marks without lines."""
        return {
            "linestyle": "none", "marker": self.marker, "color": self.colour, "markersize": self.size,
            "markeredgecolor": "black", "markeredgewidth": 0.8, "zorder": 20.0 - self.size,
        }  # fmt: skip


KINDS = {
    ON_NODE: KindStyle("flagged node", ORANGE, "o", 13.0),
    ON_CORNER: KindStyle("tool's corner", BLUE, "s", 11.0),
    ON_VERTEX: KindStyle("organ's vertex", PINK, "D", 7.5),
    ON_EDGE: KindStyle("edges of both", GREEN, "^", 7.0),
}
"""Styles by kind, the number that a constraint's name encodes."""


@dataclass(frozen=True)
class Touch:
    """The constraints of one step between a plate and an organ.

    Attributes:
        scene: The scene.
        kinds: (C,) kind of each constraint; see `KINDS`.
        places: (C, 3) constrained points of the organ's surface [u].
        normals: (C, 3) contact normals, towards the organ.
        faces: (C,) faces of the tool.
        nodes: (V, 3) nodes of the organ [u].
        triangles: (T, 3) triangles of the organ.
        position: (3,) of the tool [u].
        orientation: (4,) of the tool.
        depth: Depth of the plate's lowest corner under the undeformed organ's top [u].
        force: (3,) force on the tool [N].
    """

    scene: scenes.Scene
    kinds: NDArray[np.int64]
    places: FloatArray
    normals: FloatArray
    faces: NDArray[np.int32]
    nodes: FloatArray
    triangles: NDArray[np.int32]
    position: FloatArray
    orientation: FloatArray
    depth: float
    force: FloatArray


def press_edge_on(depth: float = 0.5, speed: float = 1.0, turn: float = 0.4) -> Touch:
    """Press the seed's plate edge first into the organ, over its highest node.

    Args:
        depth: Depth of the press [u].
        speed: Speed of the press [u/s].
        turn: Rotation of the plate about the vertical [rad].

    Returns:
        Constraints of the step with the most kinds of constraints; among those, of the one with the most constraints,
        and among those, of the last one.
    """
    scene = scenes.seed(faces="all")
    simulation = Simulation(scene)
    top = simulation.nodes[np.argmax(simulation.nodes[:, 2])]
    orientation = quaternion_multiply(quaternion_from_axis_angle((0.0, 0.0, 1.0), turn), np.array(scenes.ON_EDGE))
    lowest = float(rotate(orientation, scene.tools[0].tool.vertices)[:, 2].min())
    simulation.place_tool((top[0], top[1], top[2] - lowest + 0.01), orientation)
    best: Touch | None = None
    for _ in range(math.ceil(depth / (speed * simulation.dt))):
        report = simulation.step((0.0, 0.0, -speed))
        count = int(simulation.worlds.last.result[0, CONTACT_COUNT])
        names, features, rows = copy_constraints(simulation.worlds.contacts[0].workspace.constraints, count)
        of_tool = features[:, OWNER] >= 0
        names, features, rows = names[of_tool], features[of_tool], rows[of_tool]
        weights = rows[:, WEIGHTS : WEIGHTS + 3]
        touch = Touch(
            scene=scene,
            kinds=names >> 60,
            places=np.einsum("ij,ijk->ik", weights, simulation.nodes[features[:, :3]]),
            normals=rows[:, NORMAL : NORMAL + 3],
            faces=features[:, PLANE],
            nodes=simulation.nodes,
            triangles=simulation.triangles,
            position=simulation.tool_position,
            orientation=orientation,
            depth=float(top[2] - simulation.tool_position[2] - lowest),
            force=report.force_newtons,
        )
        if best is None or _richness(touch) >= _richness(best):
            best = touch
    simulation.close()
    assert best is not None
    return best


def _richness(touch: Touch) -> tuple[int, int]:
    """Sort key of steps: number of kinds of constraints, then number of constraints."""
    return len(set(touch.kinds.tolist())), len(touch.kinds)


def draw_features(path: Path, depth: float = 0.5) -> str:
    """Draw the constraints of one step of a plate that is pressed edge first into the organ.

    Args:
        path: File to write.
        depth: Depth of the press [u].

    Returns:
        A caption.
    """
    touch = press_edge_on(depth)
    counts = {style.name: int((touch.kinds == kind).sum()) for kind, style in KINDS.items()}
    millimetres = 1e3 * touch.scene.scale.length
    with styled():
        figure = start_figure(690)
        upper, lower = figure.subplots(2, 1, height_ratios=(2.6, 1.0))
        _draw_edge_in_space(upper, touch)
        _draw_edge_from_below(lower, touch)
        handles, labels = upper.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, columnspacing=1.4, handletextpad=0.4)
        save_figure(figure, path)
    told = ", ".join(f"{name}: {count}" for name, count in counts.items())
    return (
        f"The seed's plate pressed edge first {touch.depth:.2f} u ({touch.depth * millimetres:.1f} mm) into the organ "
        f"with {touch.force[2]:.2f} N, and all {len(touch.kinds)} constraints of that step ({told}): above in space, "
        "with the normals along which each pushes the organ, below seen from under the plate."
    )


VIEW_TURN, VIEW_HEIGHT = 0.65, 0.42
"""Viewing direction in space: angle away from the normal of the plate's large face, and angle downwards [rad]."""

NORMAL_LENGTH = 0.16
"""Length of drawn normals [u]."""


def _draw_edge_in_space(panel: Axes, touch: Touch) -> None:
    """Draw plate, organ and constraints in a parallel projection."""
    from matplotlib.collections import PolyCollection

    tool = touch.scene.tools[0].tool
    corners = rotate(touch.orientation, tool.vertices) + touch.position
    middle = corners[corners[:, 2] < touch.position[2]].mean(axis=0)
    across = rotate(touch.orientation, (0.0, 0.0, -1.0))
    heading = math.atan2(across[1], across[0]) + VIEW_TURN
    ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
    right = np.array([ahead[1], -ahead[0], 0.0])
    up = math.sin(VIEW_HEIGHT) * ahead + np.array([0.0, 0.0, math.cos(VIEW_HEIGHT)])
    screen = np.stack([right, up], axis=1)
    surface = touch.nodes[touch.triangles] - middle
    normals = np.cross(surface[:, 1] - surface[:, 0], surface[:, 2] - surface[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    towards = np.cross(right, up)
    shown = np.flatnonzero(normals @ towards > 0.0)
    shown = shown[np.argsort(surface[shown].mean(axis=1) @ towards)]
    light = 0.86 + 0.14 * normals[shown] @ np.array([-0.45, -0.35, 0.82])
    from matplotlib.colors import to_rgb

    colours = np.clip(np.outer(light, to_rgb(ORGAN)), 0.0, 1.0)
    panel.add_collection(
        PolyCollection(
            list(surface[shown] @ screen), facecolors=colours, edgecolors=ORGAN_LINE, linewidths=0.9, zorder=1
        )
    )
    faces = (corners[np.array(BOX_QUADS)] - middle) @ screen
    panel.add_collection(
        PolyCollection(list(faces), facecolors=(0.55, 0.6, 0.68, 0.16), edgecolors=PLATE_LINE, linewidths=1.1, zorder=2)
    )
    for kind, style in KINDS.items():
        chosen = touch.kinds == kind
        starts = (touch.places[chosen] - middle) @ screen
        ends = (touch.places[chosen] + NORMAL_LENGTH * touch.normals[chosen] - middle) @ screen
        for start, end in zip(starts, ends, strict=True):
            _draw_arrow(panel, start, end, style.colour, width=1.8, head=11)
        panel.plot(*starts.T, **style.marks, label=f"{style.name}: {int(chosen.sum())}")
    panel.set_xlim(-1.05, 1.05)
    panel.set_ylim(-0.42, 0.58)
    panel.set_aspect("equal")
    panel.grid(False)
    panel.set_xticks([])
    panel.set_yticks([])
    panel.plot([-0.98, -0.78], [0.5, 0.5], color="black", linewidth=3.0, solid_capstyle="butt")
    panel.text(-0.75, 0.5, f"0.2 u = {0.2e3 * touch.scene.scale.length:g} mm", va="center")


BOX_QUADS = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
"""Indices of the corners of each face of `Tool.box`."""


def _draw_edge_from_below(panel: Axes, touch: Touch) -> None:
    """Draw the plate's lower edge face and the organ's edges near it, in the tool's frame, seen along its y axis."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Rectangle

    width, height, thickness = touch.scene.tools[0].tool.size.tolist()
    inverse = quaternion_conjugate(touch.orientation)
    local = rotate(inverse, touch.nodes - touch.position)
    places = rotate(inverse, touch.places - touch.position)
    sides = np.concatenate([touch.triangles[:, [0, 1]], touch.triangles[:, [1, 2]], touch.triangles[:, [2, 0]]])
    edges = local[np.unique(np.sort(sides), axis=0)]
    edges = edges[(np.abs(edges[:, :, 1] + 0.5 * height) < 0.8).all(axis=1)]
    panel.add_patch(
        Rectangle(
            (-0.5 * width, -0.5 * thickness),
            width,
            thickness,
            facecolor=PLATE,
            edgecolor=PLATE_LINE,
            linewidth=1.2,
            zorder=1,
        )
    )
    panel.add_collection(LineCollection(list(edges[:, :, [0, 2]]), colors=ORGAN_LINE, linewidths=1.1, zorder=2))
    for kind, style in KINDS.items():
        panel.plot(*places[touch.kinds == kind][:, [0, 2]].T, **style.marks)
    panel.set_xlim(-0.62, 0.62)
    panel.set_ylim(-0.13, 0.13)
    panel.set_aspect("equal")
    panel.grid(False)
    panel.set_facecolor(ORGAN)
    panel.set_xlabel("x in the tool's frame [u]")
    panel.set_ylabel("z [u]")


# Pressure ---------------------------------------------------------------------------------------------------------

DEPTHS = (0.1, 0.17, 0.4)
"""Depths of the plate's lower face under the undeformed organ's top [u]."""

LIMITS = ((2.67, "20 mmHg"), (4.0, "30 mmHg"))
"""Pressures to mark [kPa], and their values in mmHg, the usual unit for the pressure of brain retractors."""


def press_to_depths(depths: Sequence[float], speed: float = 1.0, hold: float = 0.4) -> list[tuple[FloatArray, float]]:
    """Press the seed's plate, lying flat, and hold it at several depths, one after the other.

    Args:
        depths: Depths of its lower face under the undeformed organ's top, ascending [u].
        speed: Speed between depths [u/s].
        hold: How long it is held at each depth [s].

    Returns:
        For each depth the pressure on each node [kPa] and the upward force [N], averaged over the last quarter of the
        hold.
    """
    simulation = Simulation(scenes.seed())
    height = top_of(simulation) + 0.5 * float(simulation.scene.tools[0].tool.size[2])
    simulation.place_tool((0.0, 0.0, height + 0.01))
    found = []
    for depth in depths:
        press_down(simulation, height - depth, speed)
        reports = [simulation.step() for _ in range(round(hold / simulation.dt))]
        last = reports[-max(len(reports) // 4, 1) :]
        found.append(
            (
                np.mean([report.pressures_pascals for report in last], axis=0) / 1e3,
                float(np.mean([report.force_newtons[2] for report in last])),
            )
        )
    simulation.close()
    return found


def draw_pressure(path: Path, depths: Sequence[float] = DEPTHS) -> str:
    """Draw the contact pressure on the plate's lower face at several depths.

    Args:
        path: File to write.
        depths: Ascending [u].

    Returns:
        A caption.
    """
    scene = scenes.seed()
    tool, millimetres = scene.tools[0].tool, 1e3 * scene.scale.length
    lower = np.flatnonzero(tool.normals[:, 2] < 0.0)
    found = press_to_depths(depths)
    highest = math.ceil(max(float(pressures.max()) for pressures, _ in found))
    with styled():
        figure = start_figure(340)
        from matplotlib.colors import Normalize

        panels = figure.subplots(1, len(depths), sharey=True, squeeze=False)[0]
        image: Any = None
        for panel, depth, (pressures, force) in zip(panels, depths, found, strict=True):
            image = _draw_map(panel, tool.nodes[lower], pressures[lower], Normalize(0.0, highest))
            panel.set_title(f"{depth:g} u ({depth * millimetres:g} mm) deep: {force:.2f} N", fontsize=11.5)
            panel.set_xticks([-0.5, 0.0, 0.5])
            panel.set_xlabel("x [u]")
        panels[0].set_yticks([-0.5, 0.0, 0.5])
        panels[0].set_ylabel("y [u]")
        bar = figure.colorbar(image, ax=panels.tolist(), pad=0.015, shrink=0.82)
        bar.set_label("contact pressure [kPa]")
        for pressure, _ in LIMITS:
            bar.ax.axhline(pressure, color="white", linewidth=4.0)
            bar.ax.axhline(pressure, color=ORANGE, linewidth=2.0)
        bar.set_ticks([0.0, *(pressure for pressure, _ in LIMITS), *range(6, highest + 1, 2)])
        bar.ax.set_yticklabels(
            ["0", *(f"{pressure:.3g} ({name})" for pressure, name in LIMITS), *map(str, range(6, highest + 1, 2))]
        )
        save_figure(figure, path)
    told = "; ".join(
        f"{depth:g} u: {force:.2f} N, mean {pressures[lower] @ tool.areas[lower] / tool.areas[lower].sum():.2f} kPa, "
        f"peak {pressures.max():.2f} kPa"
        for depth, (pressures, force) in zip(depths, found, strict=True)
    )
    return (
        f"Contact pressure on the {len(lower)} nodes of the seed's plate's lower face, each on its share of the face, "
        f"held at {len(depths)} depths ({told}); marked on the scale: "
        f"{', '.join(f'{pressure:g} kPa ({name})' for pressure, name in LIMITS)}."
    )


def _draw_map(panel: Axes, places: FloatArray, values: FloatArray, scale: Any) -> Any:
    """Draw a map of a face with each node's share of it coloured by a value; returns the image, for a colour bar.

    The nodes must be a grid that reaches the rim of the face.
    """
    xs, ys = np.unique(places[:, 0].round(9)), np.unique(places[:, 1].round(9))
    table = np.full((len(ys), len(xs)), np.nan)
    columns, rows = np.searchsorted(xs, places[:, 0] - 1e-6), np.searchsorted(ys, places[:, 1] - 1e-6)
    table[rows, columns] = values
    borders = [np.concatenate([c[:1], 0.5 * (c[1:] + c[:-1]), c[-1:]]) for c in (xs, ys)]
    image = panel.pcolormesh(*borders, table, cmap="cividis", norm=scale, edgecolors="white", linewidth=0.6)
    middles = [0.5 * (b[1:] + b[:-1]) for b in borders]
    for row, column in np.ndindex(*table.shape):
        value = table[row, column]
        panel.text(
            middles[0][column], middles[1][row], f"{value:.1f}" if value >= 0.05 else "0", ha="center", va="center",
            fontsize=8.5,
            color="black" if scale(value) > 0.5 else "white",
        )  # fmt: skip
    panel.set_aspect("equal")
    panel.grid(False)
    return image


# Force ------------------------------------------------------------------------------------------------------------

CONTACTS: dict[ContactName, tuple[str, str, float]] = {
    "second_step": ("second step alone", SKY, 1.0),
    "bullet": ("Bullet's own contact", ORANGE, 2.2),
    "flags": ("flags method", "black", 2.0),
}
"""Contact models: label, colour and line width."""

SLIGHT = 0.05
"""Force below which there is considered to be none [N]."""

HELD_AT = 4.6
"""Height of the plate's middle where it is held [u]."""


def record_force(contact: ContactName, speed: float, seconds: float) -> FloatArray:
    """Lower the seed's plate into the organ and hold it.

    Args:
        contact: The contact model.
        speed: Speed of the way down [u/s].
        seconds: Duration of the record [s].

    Returns:
        (steps,) upward force on the plate in each step [N]; NaN once the simulation has diverged.
    """
    simulation = Simulation(scenes.seed(), contact=contact)
    height = top_of(simulation) + 0.5 * float(simulation.scene.tools[0].tool.size[2])
    simulation.place_tool((0.0, 0.0, height + 0.05))
    forces = np.full(round(seconds / simulation.dt), np.nan)
    try:
        for step in range(len(forces)):
            left = max(float(simulation.tool_position[2]) - HELD_AT, 0.0)
            forces[step] = simulation.step((0.0, 0.0, -min(speed, left / simulation.dt))).force_newtons[2]
    except SimulationDiverged:
        pass
    finally:
        simulation.close()
    return forces


def draw_force(path: Path, speed: float = 20.0, seconds: float = 0.5) -> str:
    """Draw the force on the plate over time, by contact model.

    Args:
        path: File to write.
        speed: Speed of the way down [u/s].
        seconds: Duration shown [s].

    Returns:
        A caption.
    """
    forces = {contact: record_force(contact, speed, seconds) for contact in CONTACTS}
    scene = scenes.seed()
    start = Simulation(scene)
    way = top_of(start) + 0.5 * float(scene.tools[0].tool.size[2]) + 0.05 - HELD_AT
    start.close()
    arrived = math.ceil(way / speed / scene.dt - 1e-9) * scene.dt
    with styled():
        figure = start_figure(480)
        panels = figure.subplots(2, 1, sharex=True, height_ratios=(1.3, 1.0))
        for panel in panels:
            for contact, (name, colour, width) in CONTACTS.items():
                times = scene.dt * np.arange(1, len(forces[contact]) + 1)
                panel.plot(times, forces[contact], color=colour, linewidth=width, label=name)
            panel.axvline(arrived, color="0.5", linewidth=1.0, linestyle=DASH, zorder=1)
            panel.set_ylabel("upward force [N]")
            panel.set_xlim(0.0, seconds)
        panels[0].text(
            arrived + 0.01 * seconds, 0.88, "held from here", transform=panels[0].get_xaxis_transform(), color="0.35"
        )
        panels[1].set_ylim(-0.3, 1.4)
        panels[1].set_xlabel("time [s]")
        panels[0].set_title(f"A press at {speed:g} u/s ({speed * scene.scale.speed:g} m/s); below, the same enlarged")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles[::-1], labels[::-1], loc="outside lower center", ncols=3)
        save_figure(figure, path)
    told = "; ".join(_tell_force(contact, force) for contact, force in forces.items())
    return (
        f"Upward force on the seed's plate, pressed {way - 0.05:.2f} u deep at {speed:g} u/s "
        f"({speed * scene.scale.speed:g} m/s) and held, by contact model (in the second half of the time: {told})."
    )


def _tell_force(contact: ContactName, forces: FloatArray) -> str:
    held = forces[len(forces) // 2 :]
    pushed = np.flatnonzero(np.abs(forces) > SLIGHT)
    if not (np.abs(held) > SLIGHT).any():
        last = (pushed.max(initial=-1) + 1) * scenes.Scene.dt
        return f"{CONTACTS[contact][0]} none, and none after {last:.2f} s"
    return (
        f"{CONTACTS[contact][0]} {np.nanmean(held):.2f} N, standard deviation {np.nanstd(held):.2f} N, "
        f"between {np.nanmin(held):.1f} and {np.nanmax(held):.1f} N"
    )


# Speed ------------------------------------------------------------------------------------------------------------

SPEEDS = (0.1, 0.3, 1.0, 3.0, 10.0, 20.0, 30.0, 60.0, 100.0, 200.0, 500.0, 1000.0, 2000.0)
"""Speeds of plunges [u/s]."""

THICKNESSES = {0.02: (BLUE, "o"), 0.125: (ORANGE, "s"), 0.5: (GREEN, "^")}
"""Thicknesses of plates [u], with colour and marker."""

ENTRIES = {"by its face": UPRIGHT, "by its edge": scenes.ON_EDGE}
"""Part of the plate that goes in first, and the plate's orientation, quaternion xyzw."""

PLUNGE_DEPTH = 1.0
"""Depth of plunges under the undeformed organ's top [u]."""

SHOWN = (1e-5, 0.2)
"""Limits of the axis of residuals [u]; values beyond are drawn at the limits."""


def plunge_residuals(
    thickness: float, speeds: Sequence[float], depth: float = PLUNGE_DEPTH
) -> dict[str, NDArray[np.float64]]:
    """Drive a plate into the organ from above, at several speeds, and measure how deep either is in the other.

    No step is shortened: the plate starts a whole number of steps before its final depth, so that at 2000 u/s it comes
    from 8 u away and reaches the depth within one step.

    Args:
        thickness: Thickness of the plate [u].
        speeds: Speeds of the plunges [u/s].
        depth: Depth of the plunges [u].

    Returns:
        By entry, (speeds, 2): the greatest residual of a report, and the greatest of the independent inspection, over
        all steps down and the tenth of a second after them [u]; the latter is infinite if some of the organ came to the
        far side of the tool.
    """
    scene = scenes.seed(tool_size=(1.0, 1.0, thickness), faces="all")
    simulation = Simulation(scene)
    inspector = Inspector(scene.tools[0].tool, simulation.triangles)
    top, dt = top_of(simulation), simulation.dt
    found = {}
    for entry, orientation in ENTRIES.items():
        greatest = np.zeros((len(speeds), 2))
        lowest = float(rotate(np.array(orientation), scene.tools[0].tool.vertices)[:, 2].min())
        for index, speed in enumerate(speeds):
            steps = math.ceil((depth + 0.02) / (speed * dt) - 1e-9)
            simulation.reset()
            simulation.place_tool((0.0, 0.0, top - lowest - depth + steps * speed * dt), orientation)
            inspector.reset()
            inspector.inspect(simulation.tool_position, simulation.tool_orientation, simulation.nodes)
            for step in range(steps + round(0.1 / dt)):
                report = simulation.step((0.0, 0.0, -speed if step < steps else 0.0))
                seen = inspector.inspect(simulation.tool_position, simulation.tool_orientation, simulation.nodes)
                # A part of the organ on the far side of the tool is worse than any depth.
                inspected = math.inf if seen.wrong_side else seen.residual
                greatest[index] = np.maximum(greatest[index], (report.residual, inspected))
        found[entry] = greatest
    simulation.close()
    return found


def draw_speed(path: Path, speeds: Sequence[float] = SPEEDS, depth: float = PLUNGE_DEPTH) -> str:
    """Draw how far plates of several thicknesses are in the organ, over their speed.

    Args:
        path: File to write.
        speeds: Speeds of the plunges [u/s].
        depth: Depth of the plunges [u].

    Returns:
        A caption.
    """
    found = {thickness: plunge_residuals(thickness, speeds, depth) for thickness in THICKNESSES}
    scale = scenes.seed().scale
    with styled():
        from matplotlib.lines import Line2D

        figure = start_figure(470)
        panels = figure.subplots(1, len(ENTRIES), sharey=True)
        for panel, entry in zip(panels, ENTRIES, strict=True):
            for thickness, (colour, marker) in THICKNESSES.items():
                told, inspected = np.clip(found[thickness][entry], *SHOWN).T
                panel.plot(speeds, told, color=colour, marker=marker, linewidth=1.6, markersize=6, clip_on=False)
                panel.plot(
                    speeds, inspected, color=colour, marker=marker, linewidth=1.2, markersize=7, linestyle=DASH,
                    markerfacecolor="none", markeredgewidth=1.4, clip_on=False,
                )  # fmt: skip
            panel.axhline(ALLOWED, color="black", linewidth=1.6)
            panel.axhline(RESIDUAL_TOLERANCE, color="0.5", linewidth=1.2, linestyle=(0, (1, 1.5)))
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.set_ylim(*SHOWN)
            panel.set_xlim(0.07, 3000.0)
            panel.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            panel.set_xlabel(f"speed [u/s], 1 u = {1e3 * scale.length:g} mm")
            panel.set_title(f"The plate goes in {entry}")
        panels[0].set_ylabel("greatest residual [u]")
        panels[0].text(0.09, 1.15 * ALLOWED, f"allowed: {ALLOWED:g} u", va="bottom")
        tolerance = f"tolerance of the solve: {RESIDUAL_TOLERANCE:g} u"
        panels[0].text(0.09, 1.2 * RESIDUAL_TOLERANCE, tolerance, va="bottom", color="0.35")
        handles = [
            Line2D([], [], color=colour, marker=marker, linewidth=1.6, label=f"{thickness:g} u thick")
            for thickness, (colour, marker) in THICKNESSES.items()
        ]
        handles.append(Line2D([], [], color="0.3", marker="o", linewidth=1.6, label="told by the report"))
        hollow: dict[str, Any] = {"marker": "o", "markerfacecolor": "none", "linestyle": DASH}
        handles.append(Line2D([], [], color="0.3", label="seen by the inspection", **hollow))
        figure.legend(handles=handles, loc="outside lower center", ncols=5, columnspacing=1.3)
        save_figure(figure, path)
    told = ", ".join(
        f"{thickness:g} u: {np.max([values[:, 0].max() for values in by_entry.values()]):.2g} and "
        f"{np.max([values[:, 1].max() for values in by_entry.values()]):.2g} u"
        for thickness, by_entry in found.items()
    )
    return (
        f"Greatest residual of plunges {depth:g} u ({depth * 1e3 * scale.length:g} mm) deep from above, over speeds "
        f"from {min(speeds):g} to {max(speeds):g} u/s, as the report tells it and as an independent inspection sees it "
        f"(greatest of all by thickness: {told}); {ALLOWED:g} u is allowed."
    )


# The command ------------------------------------------------------------------------------------------------------

FIGURES = {
    "flags.png": draw_flags,
    "path.png": draw_path,
    "features.png": draw_features,
    "pressure.png": draw_pressure,
    "force.png": draw_force,
    "speed.png": draw_speed,
}
"""Functions that draw the figures, by file name."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw all figures, or some, and print their captions.

    Args:
        arguments: Command-line arguments; those of the process by default.

    Raises:
        ImportError: If Matplotlib is not installed.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs/images"), help="folder (default: %(default)s)")
    parser.add_argument(
        "--only", nargs="+", choices=FIGURES, default=list(FIGURES), help="figures to draw (default: all)"
    )
    chosen = parser.parse_args(arguments)
    with styled():
        chosen.output.mkdir(parents=True, exist_ok=True)
    for name in chosen.only:
        print(f"{chosen.output / name}: {FIGURES[name](chosen.output / name)}", flush=True)


if __name__ == "__main__":
    main()
