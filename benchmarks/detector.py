"""What does a query of the contact detector cost, how does it grow, and how do other ray casters compare?

The case is the seed's press: a spatula with 72 contact nodes, and the sphere of 652 triangles, deformed by a simulated
press. The organ's vertices change before every query. The detector and its rivals are timed in turn, a few queries
each, again and again, so that disturbances of the machine affect all of them alike. Beforehand, the answers of each
rival are compared with the detector's and with brute force. A rival with different answers is timed too, but excluded
from the comparison.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import finish, output_file, parser
from benchmarks.rivals import LIBRARIES, WRITTEN_HERE, BruteForce, Question, Rival
from spatula_env import Simulation, scenes
from spatula_env.contact import Contacts, FlaggedDetector
from spatula_env.geometry import Tool, seed_sphere
from spatula_env.geometry.transforms import rotate
from spatula_env.installing import install_hint

Key = TypeVar("Key")

SIZE = (1.0, 1.0, 0.125)
"""Size of the spatula [u]."""

TURN = np.array([0.06, 0.03, 0.25])
"""Rotation vector of the spatula: a slight tilt and turn, so that nothing is aligned with an axis by chance [rad]."""

SPEED = 2.0
"""Speed of the press [u/s]."""

PRESS_DEPTH = 0.8
"""How far the spatula is pressed down from the height at which it touches the organ's top [u]."""

ADVANCE = 0.13
"""How far the spatula is moved further down before the query [u].

After a step the contact model leaves the organ's surface just below the lower face; in the next step the organ springs
back before contacts are detected. Moving the tool instead sets about as many flags as such a step does: some thirty of
the 36 on the lower face.
"""

SPHERE_DEPTH = 0.115
"""Depth of the lower face in the spheres of the scaling measurement: the whole face, rim included, is inside [u]."""

APART = np.array([0.0, 0.0, 10.0])
"""Offset of the tool for a query without contact, which measures the cost of everything but the rays [u]."""

SHAKE = 1e-4
"""Standard deviation of the noise that makes the vertices differ from query to query [u]."""

TIMED_SHAPES = 16
"""Number of perturbed shapes that are queried in turn."""

BLOCK, SCALING_BLOCK, WARM_UP = 20, 5, 3
"""Timed queries in a row before the next side takes its turn; the same in the scaling measurement, where turns take
longer; and untimed queries before each such block."""

DISTANCE_TOLERANCE = 1e-4
"""Greatest difference of distances that single precision can explain [u]."""

LEAST_AGREEMENT = 0.98
"""Least share of equal answers of a comparable rival; a few rays pass so close to an edge that rounding decides."""

NODE_COUNTS = (328, 772, 1814, 4262, 10002)
"""Numbers of vertices V of the spheres in the scaling measurement; they have 2 V - 4 triangles: 652 to 20,000."""

CURVE_STYLES = {
    "detector": ("this package", "#c0392b", "o", 2.6),
    "brute_force": ("brute force", "#2c3e50", "s", 2.0),
    "brute_force_by_lines": ("brute force, a line at a time", "#566573", "s", 1.3),
    "brute_force_by_lanes": ("brute force, vector instructions", "#7f8c8d", "s", 1.3),
    "warp": ("Warp, refit", "#2980b9", "^", 1.3),
    "open3d": ("Open3D, rebuilt", "#27ae60", "v", 1.3),
    "embreex": ("Embree, rebuilt", "#8e44ad", "D", 1.3),
    "pybullet": ("PyBullet", "#d68910", "P", 1.3),
}
"""Style of each side's curve: label, colour, marker, line width."""

NODES_PER_EDGE = (6, 8, 11, 15, 22)
"""Nodes per edge n of the spatulas in the scaling measurement; they have 2 n^2 contact nodes: 72 to 968."""


class DetectorSide:
    """The detector, with the interface of a rival."""

    name = "detector"

    def __init__(self, question: Question) -> None:
        """Make a detector with clear flags."""
        self._question = question
        self._detector = FlaggedDetector(question.tool)
        self.contacts: Contacts | None = None

    def query(self, index: int) -> None:
        """Detect the contacts with shape `index`, through the public interface."""
        question = self._question
        self.contacts = self._detector.detect(
            question.position,
            question.orientation,
            question.shapes[index],
            question.triangles,
            linear_velocity=question.linear_velocity,
        )


def make_question(
    tool: Tool,
    position: NDArray[np.float64],
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
) -> Question:
    """Make a question of a tool, tilted by `TURN` and moving downwards, and an organ.

    Args:
        tool: The tool.
        position: (3,) of the tool [u].
        vertices: (V, 3) of the organ, which the shapes perturb slightly [u].
        triangles: (T, 3) of the organ.

    Returns:
        The question. Its last shape is the organ turned by one radian about the vertical through the tool.
    """
    orientation = turn_quaternion()
    generator = np.random.default_rng(0)
    shapes = [vertices + SHAKE * generator.normal(size=vertices.shape) for _ in range(TIMED_SHAPES)]
    about = np.array([0.0, 0.0, np.sin(0.5), np.cos(0.5)])
    shapes.append(np.ascontiguousarray(rotate(about, vertices - position) + position))
    return Question(
        tool=tool,
        position=np.array(position),
        orientation=orientation,
        linear_velocity=np.array([0.0, 0.0, -SPEED]),
        triangles=np.array(triangles, dtype=np.int32),
        shapes=shapes,
        nodes=np.ascontiguousarray(rotate(orientation, tool.nodes) + position),
        normals=np.ascontiguousarray(rotate(orientation, tool.normals)),
    )


def turn_quaternion() -> NDArray[np.float64]:
    """The spatula's orientation, (4,) quaternion xyzw."""
    angle = float(np.linalg.norm(TURN))
    return np.array([*(np.sin(0.5 * angle) * TURN / angle), np.cos(0.5 * angle)])


def pressed_sphere(nodes_per_edge: Sequence[int] = (6,)) -> list[Question]:
    """Questions about the seed's sphere, pressed by the seed's spatula.

    Args:
        nodes_per_edge: Nodes per edge of the tools to ask about; the press itself is the same for all.

    Returns:
        A question for each tool.
    """
    simulation = Simulation(scenes.seed(tool_size=SIZE))
    simulation.reset(seed=0)
    # The lower face of the untilted tool is half a thickness below its origin.
    start = simulation.nodes[:, 2].max() + 0.5 * SIZE[2]
    simulation.place_tool((0.0, 0.0, start), turn_quaternion())
    for _ in range(round(PRESS_DEPTH / (SPEED * simulation.dt))):
        simulation.step((0.0, 0.0, -SPEED))
    position = simulation.tool_position - np.array([0.0, 0.0, ADVANCE])
    vertices, triangles = np.array(simulation.nodes), np.array(simulation.triangles)
    simulation.close()
    return [
        make_question(Tool.box(SIZE, nodes_per_edge=count), position, vertices, triangles) for count in nodes_per_edge
    ]


def finer_spheres(node_counts: Sequence[int]) -> list[Question]:
    """Questions about the seed's spatula in spheres of the seed's radius and increasing resolution.

    Args:
        node_counts: Numbers of vertices of the spheres.

    Returns:
        A question for each sphere.
    """
    tool, questions = Tool.box(SIZE), []
    for count in node_counts:
        organ = seed_sphere(node_count=count)
        # Off the pole, where there is a vertex.
        position = np.array([0.031, 0.017, 3.0 - SPHERE_DEPTH + 0.5 * SIZE[2]])
        questions.append(make_question(tool, position, organ.vertices, organ.triangles))
    return questions


def flags_from_rays(question: Question, index: int, hits: NDArray[np.int32]) -> NDArray[np.bool_]:
    """The flags that a detector without earlier flags would set, computed from where rays meet the organ.

    Args:
        question: The question.
        index: Index of the shape.
        hits: (2 n,) the triangle each ray meets first, -1 for none.

    Returns:
        (n,) the flags.
    """
    corners = question.shapes[index][question.triangles]
    outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    leaves = ((outwards[hits] * question.directions).sum(axis=1) > 0.0) & (hits >= 0)
    inside, leaves_outwards = leaves[0::2], leaves[1::2]
    leads = question.normals @ question.linear_velocity > 0.0
    flags, visited = np.zeros(len(leads), dtype=bool), np.zeros(len(leads), dtype=bool)
    for node in [*np.flatnonzero(leads), *np.flatnonzero(~leads)]:
        other = question.tool.opposite[node]
        visited[node] = True
        refused = flags[other] and (leaves_outwards[other] or (visited[other] and inside[node]))
        flags[node] = inside[node] and not refused
    return flags


def agreement(question: Question, rival: Rival, index: int) -> tuple[float, float | None]:
    """Compare a rival's answers with those of the detector and of brute force.

    Args:
        question: The question.
        rival: The rival.
        index: Index of the shape.

    Returns:
        (rays, nodes): share of the rays whose distance, and triangle if the rival reports triangles, equals that of
        brute force; and share of the nodes whose flag, and triangle and depth where it is set, equals the detector's,
        or None if the rival does not report triangles.
    """
    reference, detector = BruteForce(question), DetectorSide(question)
    for side in (reference, detector, rival):
        side.query(index)
    hits, distances = rival.answer()
    true_hits, true_distances = reference.answer()
    same = np.isclose(distances, true_distances, rtol=0.0, atol=DISTANCE_TOLERANCE)
    if hits is None:
        return float(same.mean()), None
    same &= hits == true_hits
    contacts = detector.contacts
    assert contacts is not None
    flags = flags_from_rays(question, index, hits)
    depth_same = np.abs(distances[0::2] - contacts.depth) < DISTANCE_TOLERANCE
    contact_same = (hits[0::2] == contacts.triangle) & depth_same
    return float(same.mean()), float(((flags == contacts.flags) & (contact_same | ~flags)).mean())


def interleaved(queries: Mapping[Key, Callable[[int], None]], repeats: int, block: int = BLOCK) -> dict[Key, float]:
    """Time several queries in turn.

    Args:
        queries: Functions to time, by key; each is called with the index of a shape, a different one every time.
        repeats: Least number of timed calls of each; rounded up to whole blocks.
        block: Number of timed calls in a row.

    Returns:
        Median time of a call of each [us].
    """
    times: dict[Key, list[int]] = {key: [] for key in queries}
    gc.collect()
    gc.disable()
    try:
        for turn in range(-(-repeats // block)):
            for key, query in queries.items():
                for call in range(-WARM_UP, block):
                    index = (turn * block + call) % TIMED_SHAPES
                    start = time.perf_counter_ns()
                    query(index)
                    elapsed = time.perf_counter_ns() - start
                    if call >= 0:
                        times[key].append(elapsed)
    finally:
        gc.enable()
    return {key: float(np.median(elapsed)) / 1e3 for key, elapsed in times.items()}


def examine(question: Question, kinds: Sequence[type[Rival]]) -> tuple[dict[str, Rival], dict[str, dict[str, Any]]]:
    """Construct the rivals whose packages are installed, and check their answers.

    Args:
        question: The question.
        kinds: Classes of the rivals.

    Returns:
        (rivals, rows): the rivals that are installed, by name; and the result row of each class, without its time.
    """
    rivals: dict[str, Rival] = {}
    rows: dict[str, dict[str, Any]] = {}
    for kind in kinds:
        row: dict[str, Any] = {"us": None, "ratio": None, "comparable": False, "reason": None}
        rows[kind.name] = row
        try:
            rival = kind(question)
        except (ImportError, OSError) as error:
            row["reason"] = f"not installed: {error}"
            continue
        rivals[kind.name] = rival
        # The last shape is far from the others, which exposes a rival whose search structure did not follow.
        pairs = [agreement(question, rival, index) for index in (0, TIMED_SHAPES, 1)]
        rays = min(pair[0] for pair in pairs)
        nodes = None if pairs[0][1] is None else min(pair[1] for pair in pairs if pair[1] is not None)
        row |= {"version": rival.version, "rays_agree": rays, "nodes_agree": nodes}
        if nodes is None:
            row["reason"] = "does not say which triangles it means"
        if rays < LEAST_AGREEMENT or (nodes is not None and nodes < LEAST_AGREEMENT):
            row["reason"] = "answers something else for vertices that have moved"
        row["comparable"] = row["reason"] is None
    return rivals, rows


def compare(
    question: Question, repeats: int, kinds: Sequence[type[Rival]] = WRITTEN_HERE + LIBRARIES
) -> dict[str, Any]:
    """Time the detector and its rivals on one question.

    Args:
        question: The question.
        repeats: Number of timed queries of each.
        kinds: Classes of the rivals.

    Returns:
        The detector's time in contact and in the air; and for each rival its time, the ratio to the detector's, and the
        shares of answers that agree.
    """
    rivals, rows = examine(question, kinds)
    side, apart = DetectorSide(question), DetectorSide(replace(question, position=question.position + APART))
    queries = {"detect": side.query, "apart": apart.query, **{name: rival.query for name, rival in rivals.items()}}
    medians = interleaved(queries, repeats)
    for name, rival in rivals.items():
        rows[name] |= {"us": medians[name], "ratio": medians[name] / medians["detect"]}
        rival.close()
    best = best_of(rows)
    best_library = best_of({kind.name: rows[kind.name] for kind in kinds if kind in LIBRARIES})
    assert side.contacts is not None
    return {
        "nodes": len(question.nodes),
        "triangles": len(question.triangles),
        "flags": int(side.contacts.flags.sum()),
        "detect_us": medians["detect"],
        "apart_us": medians["apart"],
        "rivals": rows,
        "best_rival": best,
        "ratio_to_best_rival": None if best is None else rows[best]["ratio"],
        "best_library": best_library,
        "ratio_to_best_library": None if best_library is None else rows[best_library]["ratio"],
        "ratio_to_brute_force": rows["brute_force"]["ratio"] if "brute_force" in rows else None,
    }


def best_of(rows: dict[str, dict[str, Any]]) -> str | None:
    """Name of the fastest comparable rival, None if there is none."""
    times = {name: row["us"] for name, row in rows.items() if row["comparable"]}
    return min(times, key=lambda name: times[name]) if times else None


def exponent(sizes: Sequence[float], times: Sequence[float]) -> float:
    """The power of the size with which a time grows: the least-squares slope in logarithmic coordinates."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def scaling(questions: Sequence[Question], axis: str, repeats: int, kinds: Sequence[type[Rival]]) -> dict[str, Any]:
    """Measure how times grow with size; all sizes and all sides are timed in turn.

    Args:
        questions: From the smallest to the largest.
        axis: What grows, "nodes" or "triangles".
        repeats: Least number of timed queries of each side and size.
        kinds: Rivals to time beside the detector; those that are not comparable at every size are left out.

    Returns:
        Sizes, numbers of flags, times of each side and the exponents of their growth.
    """
    sides = [DetectorSide(question) for question in questions]
    found = [examine(question, kinds) for question in questions]
    names = [kind.name for kind in kinds if all(rows[kind.name]["comparable"] for _, rows in found)]
    queries: dict[tuple[str, int], Callable[[int], None]] = {}
    for size, (side, (rivals, _)) in enumerate(zip(sides, found, strict=True)):
        queries["detector", size] = side.query
        queries |= {(name, size): rivals[name].query for name in names}
    medians = interleaved(queries, repeats, SCALING_BLOCK)
    for rivals, _ in found:
        for rival in rivals.values():
            rival.close()
    sizes = [len(question.nodes if axis == "nodes" else question.triangles) for question in questions]
    times = {name: [medians[name, size] for size in range(len(sizes))] for name in ("detector", *names)}
    return {
        "sizes": sizes,
        "flags": [int(side.contacts.flags.sum()) for side in sides if side.contacts is not None],
        "us": times,
        "exponent": {name: exponent(sizes, values) for name, values in times.items()},
    }


def draw(curves: dict[str, dict[str, Any]], file: Path) -> None:
    """Draw how the times grow.

    Args:
        curves: From "triangles" and "nodes" to results of `scaling`.
        file: The picture; its suffix says the format.

    Raises:
        ImportError: If Matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
        from matplotlib.ticker import FuncFormatter
    except ImportError as error:
        raise ImportError(f"the picture needs matplotlib: {install_hint('viz')}") from error

    figure = Figure(figsize=(10.0, 5.0), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    words = {"triangles": ("T", "triangles of the organ"), "nodes": ("n", "contact nodes of the tool")}
    titles = {"triangles": "an organ of finer triangles, 72 nodes", "nodes": "a tool of more nodes, 652 triangles"}
    for panel, (name, result) in zip(panels, curves.items(), strict=True):
        symbol, label = words[name]
        for side, times in result["us"].items():
            text, colour, marker, width = CURVE_STYLES[side]
            panel.loglog(result["sizes"], times, marker=marker, color=colour, linewidth=width, label=text)
        heights = spread(np.log([times[-1] for times in result["us"].values()]), 0.3)
        for side, height in zip(result["us"], heights, strict=True):
            panel.annotate(
                f"${symbol}^{{{result['exponent'][side]:.2f}}}$",
                (result["sizes"][-1], float(np.exp(height))),
                xytext=(9, 0),
                textcoords="offset points",
                va="center",
                color=CURVE_STYLES[side][1],
                annotation_clip=False,
            )
        panel.set_xlabel(f"{label}, ${symbol}$")
        panel.set_title(titles[name], fontsize=11)
        panel.set_xticks(result["sizes"])
        panel.minorticks_off()
        panel.xaxis.set_major_formatter(FuncFormatter(lambda size, _: f"{size:,.0f}"))
        panel.yaxis.set_major_formatter(FuncFormatter(lambda time, _: f"{time:,.0f}"))
        panel.grid(True, which="major", color="#dddddd", linewidth=0.8)
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("median time of a query [µs]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(file, dpi=150)


def spread(values: NDArray[np.float64], gap: float) -> NDArray[np.float64]:
    """Move values apart, keeping their order, until none is nearer to the next than `gap`."""
    upwards, downwards = values.copy(), values.copy()
    order = np.argsort(values)
    for below, above in pairwise(order):
        upwards[above] = max(upwards[above], upwards[below] + gap)
    for above, below in pairwise(order[::-1]):
        downwards[below] = min(downwards[below], downwards[above] - gap)
    return 0.5 * (upwards + downwards)


def report(result: dict[str, Any]) -> None:
    """Print a result in words."""
    print(f"{result['nodes']} nodes, {result['triangles']} triangles, {result['flags']} flags set")
    print(f"  {'detect':22} {result['detect_us']:8.1f} us   (with the tool in the air {result['apart_us']:.1f})")
    for name, row in result["rivals"].items():
        if row["us"] is None:
            print(f"  {name:22}  skipped: {row['reason']}")
            continue
        remark = "" if row["comparable"] else f"   not compared: {row['reason']}"
        nodes = "     -" if row["nodes_agree"] is None else f"{100 * row['nodes_agree']:5.1f}%"
        agree = f"agree: rays {100 * row['rays_agree']:5.1f}%, nodes {nodes}"
        print(f"  {name:22} {row['us']:8.1f} us  x {row['ratio']:5.1f}   {agree}   {row['version']}{remark}")
    if result["best_rival"] is not None:
        print(f"best rival: {result['best_rival']}, {result['ratio_to_best_rival']:.1f} times as long")


def main() -> None:
    """Measure and print."""
    options = parser(__doc__ or "")
    options.add_argument("--repeats", type=int, default=2000, help="queries that count (default: %(default)s)")
    options.add_argument("--no-scaling", action="store_true", help="leave out how the times grow")
    options.add_argument("--picture", type=output_file, help="draw how the times grow into this file")
    arguments = options.parse_args()
    if arguments.repeats < BLOCK:
        options.error(f"--repeats must be at least {BLOCK}, got {arguments.repeats}")
    if arguments.picture is not None and arguments.no_scaling:
        options.error("--picture shows the scaling, which --no-scaling leaves out")
    result = compare(pressed_sphere()[0], arguments.repeats)
    if not arguments.json:
        report(result)
    if not arguments.no_scaling:
        kinds = [kind for kind in WRITTEN_HERE + LIBRARIES if result["rivals"][kind.name]["comparable"]]
        curves = {
            "triangles": scaling(finer_spheres(NODE_COUNTS), "triangles", arguments.repeats // 20, kinds),
            "nodes": scaling(pressed_sphere(NODES_PER_EDGE), "nodes", arguments.repeats // 20, kinds),
        }
        result["scaling"] = curves
        if not arguments.json:
            for name, curve in curves.items():
                print(f"{name}: {curve['sizes']}")
                for side, times in curve["us"].items():
                    row = " ".join(f"{time:8.1f}" for time in times)
                    print(f"  {side:22} {row} us   exponent {curve['exponent'][side]:.2f}")
        if arguments.picture is not None:
            draw(curves, arguments.picture)
    finish({"benchmark": "detector", **result})


if __name__ == "__main__":
    main()
