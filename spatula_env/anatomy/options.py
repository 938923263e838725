"""What can be asked of the preparation of an organ, and what is told of it."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.geometry.checks import check_boolean, check_count, check_positive, is_number

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray

METRES = {"mm": 1e-3, "m": 1.0}
"""Metres in each unit of length."""

AXES = ("x", "y", "z", "-x", "-y", "-z")

PLACES = ("ground", "center", "keep")

FILLINGS = ("auto", "yes", "no")

MOST_NODES = 20_000

HALF_SPACE = re.compile(r"\s*([xyz])\s*([<>])\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*")


@dataclass(frozen=True)
class PrepareOptions:
    """How an organ is prepared.

    Attributes:
        units: Unit of the file, "mm" or "m"; None if the file says it itself.
        label: Label of the organ in a volume; None if there is only one.
        nodes: Number of nodes of the surface, 50 to 20,000.
        keep_islands: Whether unconnected pieces stay; else the largest alone does.
        keep_cavities: Whether inner cavities stay; else they are filled.
        widest_hole: Greatest width of a hole that is filled, as a part of the organ's diagonal.
        up: Axis of the file that will point up.
        place: "ground": the lowest point is at z = 0, and x and y are centred; "center": all three are centred; "keep":
            the file's coordinates, turned.
        hold: Half spaces whose nodes are held, such as "z<0.01" [m]; several in one, with commas, must all be met.
        hold_boxes: Boxes whose nodes are held: lower corner, then upper corner, six numbers each [m].
        hold_nodes: Indices of further held nodes.
        fissure: Points along the floor of a fissure, its two ends at least, three numbers each [m]; none if the organ
            is not to name one. As those of `hold`, they are positions after turning and placing.
        ridge: The same along the crest of a ridge.
        fill: Whether tetrahedra are made: "auto" if Netgen is installed, "yes", "no".
    """

    units: str | None = None
    label: int | None = None
    nodes: int = 650
    keep_islands: bool = False
    keep_cavities: bool = False
    widest_hole: float = 0.1
    up: str = "z"
    place: str = "ground"
    hold: tuple[str, ...] = ()
    hold_boxes: tuple[tuple[float, ...], ...] = ()
    hold_nodes: tuple[int, ...] = ()
    fissure: tuple[tuple[float, ...], ...] = ()
    ridge: tuple[tuple[float, ...], ...] = ()
    fill: str = "auto"

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: If one is not allowed.
        """
        for name, allowed in (("up", AXES), ("place", PLACES), ("fill", FILLINGS)):
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name} must be one of {', '.join(allowed)}, got {getattr(self, name)!r}")
        if self.units is not None and self.units not in METRES:
            raise ValueError(f"units must be one of {', '.join(METRES)}, got {self.units!r}")
        check_count(self.nodes, "nodes", 50, MOST_NODES)
        for name in ("keep_islands", "keep_cavities"):
            check_boolean(getattr(self, name), name)
        check_positive(self.widest_hole, "widest_hole")
        for text in self.hold:
            half_spaces(text)
        for box in self.hold_boxes:
            if len(box) != 6 or not all(map(is_number, box)) or any(box[k] > box[k + 3] for k in range(3)):
                raise ValueError(f"hold_boxes must be lower corners, then upper corners, six numbers, got {box}")
        for name in ("fissure", "ridge"):
            points = getattr(self, name)
            if len(points) == 1 or not all(len(point) == 3 and all(map(is_number, point)) for point in points):
                raise ValueError(f"{name} must be two points or more, three numbers each, in metres, got {points}")


@dataclass(frozen=True)
class Step:
    """What a surface was like after a step.

    Attributes:
        name: What was done.
        nodes: Number of nodes.
        closed: Whether each edge is in two triangles.
        crossings: Edges that go through triangles.
        least_angle: Least angle of all triangles [deg].
        low_angle: Angle below which 5 of 100 are [deg].
        volume: Volume [cm3].
    """

    name: str
    nodes: int
    closed: bool
    crossings: int
    least_angle: float
    low_angle: float
    volume: float


@dataclass(frozen=True)
class Report:
    """What was done, and what came out.

    Attributes:
        source: Name of the file.
        units: Its unit.
        read: Vertices and triangles as read, or as marching cubes gave them.
        changes: What was changed, in words.
        steps: The surface after each step, those that were given up included.
        result: Numbers of the organ: nodes, triangles, held, lines (nodes and length_mm of each), size_mm, volume_cm3,
            volume_change, edges_mm, angles_deg, and tetrahedra. The change is a part of the volume of the
            segmentation, of the cleaned voxels or of the mended surface; None if that is not closed.
        warnings: What to look at.
    """

    source: str
    units: str
    read: tuple[int, int]
    changes: tuple[str, ...]
    steps: tuple[Step, ...]
    result: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def half_spaces(text: str) -> list[tuple[int, bool, float]]:
    """The half spaces of an option such as "z<0.01,x>0": axis, whether below, and limit [m].

    Raises:
        ValueError: If it is malformed.
    """
    found = []
    for part in text.split(","):
        match = HALF_SPACE.fullmatch(part)
        if match is None:
            raise ValueError(f'hold must be like "z<0.01" or "z<0.01,x>0", in metres, got {text!r}')
        found.append(("xyz".index(match[1]), match[2] == "<", float(match[3])))
    return found


def in_half_spaces(points: FloatArray, text: str) -> BoolArray:
    """(n,) whether points (n, 3) [m] are in all half spaces of an option."""
    inside = np.ones(len(points), dtype=np.bool_)
    for axis, below, limit in half_spaces(text):
        inside &= (points[:, axis] < limit) if below else (points[:, axis] > limit)
    return inside
