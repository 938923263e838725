"""From the file of a segmentation to an organ."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.anatomy.distances import greatest_distance
from spatula_env.anatomy.holes import Hole, fill_holes
from spatula_env.anatomy.lines import length_of, traced
from spatula_env.anatomy.options import METRES, PrepareOptions, Report, Step
from spatula_env.anatomy.posing import held_nodes, posed
from spatula_env.anatomy.reading import RawVolume, read_file
from spatula_env.anatomy.reducing import measured, reduced
from spatula_env.anatomy.topology import (
    Surface,
    angles,
    buried,
    count_edges,
    drop_degenerate,
    edge_lengths,
    orient,
    weld,
)
from spatula_env.anatomy.volumes import restored
from spatula_env.anatomy.voxels import choose_label, clean_voxels, crop, surface_of_voxels
from spatula_env.geometry.crossings import self_crossings
from spatula_env.geometry.meshes import Organ
from spatula_env.geometry.prepared import FISSURE, RIDGE, UNIT_LENGTH, PreparedOrgan
from spatula_env.geometry.surface import connected_components
from spatula_env.geometry.tetrahedra import tetrahedralize
from spatula_env.installing import DISTRIBUTION

if TYPE_CHECKING:
    from collections.abc import Callable

    from spatula_env.arrays import FloatArray

SMALLEST, LARGEST = 2e-3, 2.0
"""Allowed lengths of an organ's longest side [m]."""

CHANGED_VOLUME = 0.05
"""Change of the volume, as a part of it, from which on there is a warning."""

LOST_VOLUME = 0.5
"""Loss of the volume, as a part of it, from which on the shape is another one, and refused."""

DROPPED = 0.05
"""Part of the volume in pieces that are removed, from which on there is a warning."""

FAR = 1.0
"""Greatest distance from the segmentation, in median edges of the organ, from which on there is a warning."""

SMALL_ANGLE = 15.0
"""Least angle below which there is a warning [deg]."""


@dataclass(eq=False)
class _Log:
    """What is told while an organ is prepared."""

    progress: Callable[[str], None]
    changes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def changed(self, count: int, singular: str, plural: str, what: str) -> None:
        if count:
            self.changes.append(f"{count} {singular if count == 1 else plural} {what}")

    def dropped(self, count: int, share: float, what: str = "") -> None:
        """Tell of islands with a part of the volume."""
        told = f"{what}removed with {share:.1%} of the volume, the largest piece is kept"
        self.changed(count, "island", "islands", told)
        if share > DROPPED:
            self.warnings.append(f"{share:.1%} of the volume was in pieces that were removed; keep_islands keeps them")


def prepare_organ(
    path: str | os.PathLike[str],
    options: PrepareOptions | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[PreparedOrgan, Report, Surface]:
    """Make an organ of a surface or of a labelled volume. Needs the extra ``anatomy``.

    Args:
        path: A surface (STL, OBJ, PLY, VTK, VTP, GIFTI) or a volume (NIfTI, NRRD).
        options: What is asked for.
        progress: Called with a line before each step that may take long.

    Returns:
        The organ, the report, and the surface as it was before it was mended and decimated, posed like the organ [m].

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If a library is not installed; the message says what to install.
        ValueError: If an option is not allowed, or no organ can be made; the message says why, and where.
    """
    wanted = PrepareOptions() if options is None else options
    file = Path(path)
    log = _Log(progress)
    progress(f"reading {file.name}")
    raw = read_file(file)
    units = wanted.units or raw.units
    if units is None:
        raise ValueError(f"units must be given, mm or m: {file.name} does not say which unit its coordinates have")
    if raw.units is not None and raw.units != units:
        log.warnings.append(f"{file.name} says that it is in {raw.units}, and was read in {units} as asked")
    volume = None
    if isinstance(raw, RawVolume):
        start, volume = _from_volume(raw, wanted, file.name, METRES[units], log)
    else:
        if wanted.label is not None:
            raise ValueError(f"label must not be given, as {file.name} is a surface: got {wanted.label}")
        start = Surface(raw.vertices * METRES[units], raw.triangles)
    _check_size(start, units, file.name)
    mended = _mended(start, wanted, file.name, log)
    surface, steps = reduced(mended, wanted.nodes, file.name, progress)
    if volume is None:
        volume = _enclosed(mended)
    surface, change = _with_volume(surface, volume, steps, log)
    _check_shape(mended, surface, change, file.name)
    organ, result = _finished(surface, change, wanted, file.name, log)
    result["distance_mm"] = _distance(mended, surface, result, log, both=volume is not None)
    report = Report(
        file.name,
        units,
        (len(start.vertices), len(start.triangles)),
        tuple(log.changes),
        tuple(steps),
        result,
        tuple(log.warnings),
    )
    organ = replace(organ, provenance=_provenance(wanted, report))
    return organ, report, Surface(_posed_like(start.vertices, surface.vertices, wanted), start.triangles)


def _from_volume(raw: RawVolume, options: PrepareOptions, name: str, metres: float, log: _Log) -> tuple[Surface, float]:
    """The surface of a label, and the volume of its voxels [m3], which the blur does not change."""
    label = choose_label(raw, options.label, name)
    log.progress(f"taking label {label} out of {' x '.join(map(str, raw.labels.shape))} voxels")
    affine = raw.affine.copy()
    affine[:3] *= metres
    inside, matrix = crop(raw.labels == label, affine)
    inside, cleaned = clean_voxels(inside, keep_islands=options.keep_islands, keep_cavities=options.keep_cavities)
    log.dropped(cleaned.islands, cleaned.removed, "of voxels ")
    log.changed(cleaned.cavities, "cavity", "cavities", "of voxels filled")
    log.progress("marching cubes")
    surface = surface_of_voxels(inside, matrix)
    log.changes.append(f"surface of label {label} made by marching cubes, staircases blurred")
    return surface, float(inside.sum() * abs(np.linalg.det(matrix[:3, :3])))


def _check_size(surface: Surface, units: str, name: str) -> None:
    longest = float(np.ptp(surface.vertices, axis=0).max())
    if SMALLEST <= longest <= LARGEST:
        return
    other = "m" if units == "mm" else "mm"
    instead = longest * METRES[other] / METRES[units]
    hint = f"; in {other} it would be {_length(instead)}: units={other}?" if SMALLEST <= instead <= LARGEST else ""
    raise ValueError(
        f"{name} must be {_length(SMALLEST)} to {_length(LARGEST)} long, in {units} it is {_length(longest)}{hint}"
    )


def _length(metres: float) -> str:
    for unit, factor in (("m", 1.0), ("mm", 1e-3)):
        if metres >= factor:
            return f"{metres / factor:.3g} {unit}"
    return f"{metres / 1e-6:.3g} um"


def _mended(surface: Surface, options: PrepareOptions, name: str, log: _Log) -> Surface:
    """Weld, drop, wind, fill and choose; the result may have edges that are in more than two triangles."""
    log.progress(f"mending {len(surface.triangles)} triangles")
    surface, welded = weld(surface)
    log.changed(welded, "vertex", "vertices", "welded to others or of no triangle")
    surface, dropped = drop_degenerate(surface)
    log.changed(dropped, "triangle", "triangles", "without area or twice there removed")
    if not len(surface.triangles):
        raise ValueError(f"{name} holds no triangle that has an area")
    pairs, uses = count_edges(surface.triangles)
    crowded = uses > 2
    if crowded.any():
        place = surface.vertices[pairs[np.argmax(crowded)]].mean(axis=0)
        log.changes.append(
            f"{int(crowded.sum())} edges in more than two triangles, the first at {_place(place)}: "
            "mended by a wrap of voxels"
        )
        return surface
    surface, turned, orientable = orient(surface)
    if not orientable:
        raise ValueError(f"{name} has only one side, like a Moebius strip: its triangles cannot be wound outwards")
    surface, filled, left = fill_holes(surface, options.widest_hole * surface.diagonal)
    if left:
        raise ValueError(
            f"{name} is open: {_describe(left)}; widest_hole allows {options.widest_hole:g} of its diagonal"
        )
    log.changed(len(filled), "hole", "holes", f"filled: {_describe(filled)}" if filled else "")
    surface = _chosen_pieces(orient(surface)[0], options, log)
    log.changed(turned, "triangle", "triangles", "turned, so that all face outwards")
    return surface


def _describe(holes: list[Hole]) -> str:
    told = sorted(holes, key=lambda hole: -hole.width)[:5]
    words = [f"{1e3 * hole.width:.3g} mm wide ({hole.edges} edges) at {_place(hole.place)}" for hole in told]
    more = f" and {len(holes) - len(told)} more" if len(holes) > len(told) else ""
    return f"{len(holes)} hole{'s' * (len(holes) != 1)}, " + ", ".join(words) + more


def _place(point: Any) -> str:
    # Rounded to a micrometre; adding zero makes 0 of -0.
    return f"({', '.join(f'{round(1e3 * float(value), 3) + 0.0:.4g}' for value in point)}) mm"


def _chosen_pieces(surface: Surface, options: PrepareOptions, log: _Log) -> Surface:
    """Keep the largest piece, or all; fill cavities, or keep them."""
    component = connected_components(surface.triangles)
    count = int(component.max()) + 1
    if count == 1:
        return surface
    inside, untested = buried(surface, component)
    volumes = np.bincount(component, weights=surface.volumes)
    keep = np.zeros(count, dtype=np.bool_)
    keep[~inside] = options.keep_islands
    keep[inside] = options.keep_cavities
    keep[untested] = False
    keep[int(np.argmax(volumes))] = True
    tested = np.ones(count, dtype=np.bool_)
    tested[untested] = False
    islands = ~keep & ~inside & tested
    log.dropped(int(islands.sum()), float(volumes[islands].sum() / np.maximum(volumes[~inside].sum(), 1e-300)))
    log.changed(int((~keep & inside).sum()), "cavity", "cavities", "filled")
    log.changed(len(untested), "speck", "specks", "removed, the smallest of very many pieces")
    turned = np.where(inside[component][:, None], surface.triangles[:, ::-1], surface.triangles)
    return Surface(surface.vertices, turned).kept(keep[component])


def _posed_like(vertices: FloatArray, like: FloatArray, options: PrepareOptions) -> FloatArray:
    """Positions in the frame of an organ that was posed: turned alike, moved alike."""
    shift = posed(like, options.up, options.place)[0] - posed(like[:1], options.up, "keep")[0]
    moved: FloatArray = posed(vertices, options.up, "keep") + shift
    return moved


def _with_volume(surface: Surface, volume: float | None, steps: list[Step], log: _Log) -> tuple[Surface, float | None]:
    """Give a surface the volume that it had at first, where a small offset of the nodes does that.

    Args:
        surface: Closed, wound outwards.
        volume: What the segmentation encloses [m3]; None if it is not closed.
        steps: The step is added.
        log: Is told what was done.

    Returns:
        The surface, and the change of the volume that is left, as a part of it; None if there was none to compare.
    """
    if volume is None or volume <= 0.0:
        return surface, None
    lost = float(surface.volumes.sum()) / volume - 1.0
    moved = restored(surface, volume)
    if moved is None:
        return surface, lost
    steps.append(measured(moved, "volume restored"))
    log.changes.append(f"volume brought back to {1e6 * volume:.4g} cm3 of the segmentation, from {lost:+.1%}")
    return moved, float(moved.volumes.sum()) / volume - 1.0


def _enclosed(surface: Surface) -> float | None:
    """The volume of a mended surface [m3]; None if it is open, or pieces of it overlap, which the sum counts twice."""
    if not (count_edges(surface.triangles)[1] == 2).all():
        return None
    several = connected_components(surface.triangles).any()
    if several and len(self_crossings(surface.vertices, surface.triangles)):
        return None
    return float(surface.volumes.sum())


def _check_shape(mended: Surface, surface: Surface, change: float | None, name: str) -> None:
    """Refuse an organ that has lost most of itself."""
    if change is not None and change < -LOST_VOLUME:
        edge = 1e3 * float(np.median(edge_lengths(surface.vertices, surface.triangles)))
        thickness = 2e3 * float(mended.volumes.sum()) / mended.area
        raise ValueError(
            f"{name} loses {-change:.0%} of its volume with {len(surface.vertices)} nodes, whose edges are {edge:.3g} "
            f"mm long: it is {thickness:.2g} mm thick in the mean, and what is thinner than an edge is lost; more "
            "nodes keep more of it"
        )


def _distance(mended: Surface, surface: Surface, result: dict[str, Any], log: _Log, *, both: bool) -> float:
    """Greatest distance of organ and segmentation [mm]; there is a warning if it is great beside edges.

    Where pieces of the segmentation overlap, what is inside of others is not of the organ: `both` is then false.
    """
    far = 1e3 * greatest_distance(surface, mended, both=both)
    if far > FAR * result["edges_mm"][1]:
        log.warnings.append(
            f"the organ is up to {far:.3g} mm from the segmentation's surface, more than its edges of "
            f"{result['edges_mm'][1]:.3g} mm: look at the picture"
        )
    return round(far, 3)


def _finished(
    surface: Surface, change: float | None, options: PrepareOptions, name: str, log: _Log
) -> tuple[PreparedOrgan, dict[str, Any]]:
    """The organ, posed, held and filled, and its numbers."""
    vertices = posed(surface.vertices, options.up, options.place)
    held = held_nodes(vertices, options)
    lines = {
        name: traced(vertices, surface.triangles, points, name)
        for name, points in ((FISSURE, options.fissure), (RIDGE, options.ridge))
        if points
    }
    organ = Organ(vertices / UNIT_LENGTH, surface.triangles.astype(np.int32), name)
    filling = None
    if options.fill == "yes" or (options.fill == "auto" and find_spec("netgen") is not None):
        log.progress("filling with tetrahedra")
        filling = tetrahedralize(organ)
    prepared = PreparedOrgan(organ.vertices, organ.triangles, name, held=held, filling=filling, lines=lines)
    corners, lengths = angles(vertices, surface.triangles), 1e3 * edge_lengths(vertices, surface.triangles)
    result: dict[str, Any] = {
        "nodes": len(vertices),
        "triangles": len(surface.triangles),
        "held": len(held),
        "lines": {
            name: {"nodes": len(nodes), "length_mm": round(1e3 * length_of(vertices[list(nodes)]), 2)}
            for name, nodes in lines.items()
        },
        "size_mm": (1e3 * np.ptp(vertices, axis=0)).round(2).tolist(),
        "volume_cm3": round(1e6 * float(surface.volumes.sum()), 4),
        "volume_change": None if change is None else round(change, 4),
        "edges_mm": [round(float(value), 3) for value in (lengths.min(), np.median(lengths), lengths.max())],
        "angles_deg": [round(float(v), 2) for v in (corners.min(), np.percentile(corners, 5), corners.max())],
        "tetrahedra": 0 if filling is None else len(filling.tetrahedra),
    }
    if filling is not None:
        result["tetrahedron_quality"] = [
            round(float(v), 3) for v in (filling.qualities.min(), filling.qualities.mean())
        ]
    if change is None:
        log.warnings.append("the volume cannot be compared, as the surface of the file is open or pieces of it overlap")
    elif abs(change) > CHANGED_VOLUME:
        log.warnings.append(f"the volume has changed by {change:+.1%}: more nodes keep more of the shape")
    if result["angles_deg"][0] < SMALL_ANGLE:
        log.warnings.append(f"the least angle is {result['angles_deg'][0]:g} degrees: look at the picture")
    if not held:
        log.warnings.append("no node is held: the organ will lie free")
    if filling is None and options.fill == "auto":
        log.warnings.append("no tetrahedra were made, as Netgen (the extra tissue) is not installed")
    return prepared, result


def _provenance(options: PrepareOptions, report: Report) -> dict[str, Any]:
    # Imported here because it takes long.
    from importlib.metadata import PackageNotFoundError, version

    try:
        release = version(DISTRIBUTION)
    except PackageNotFoundError:
        release = "unknown"
    told = asdict(report)
    provenance: dict[str, Any] = {
        "source": report.source,
        "units": report.units,
        "options": asdict(options),
        "version": release,
        "report": {name: told[name] for name in ("read", "changes", "steps", "result", "warnings")},
    }
    # As a file gives it back, with lists in place of tuples.
    return dict(json.loads(json.dumps(provenance)))
