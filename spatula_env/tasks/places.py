"""Places on an organ of any shape that a tool can be pressed on, along the surface's normal.

Lengths are in metres, points in the workspace frame. "Above" is meant along z: a place is where a vertical ray from
above meets the organ first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.contact.raycast import cast_ray
from spatula_env.contact.structures import NO_HIT
from spatula_env.geometry.overlap import overlaps
from spatula_env.geometry.rotations import conjugate, multiply, turn
from spatula_env.tasks.surface import average_normals, surface_heights, surface_samples

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray, IndexArray, IntArray
    from spatula_env.tasks.situation import Setting

CANDIDATES = 1024
"""Number of points of a surface that are tried as places."""

FEWEST_PLACES = 8
"""Number of places below which a task is not set on an organ: goals would be nearly the same in every episode."""

STEEPEST = np.deg2rad(45.0)
"""Greatest angle between the normal of a place and the vertical on an organ that is held [rad]."""

STEEPEST_FREE = np.deg2rad(8.0)
"""The same on an organ that lies free, which rolls away from under a tool that presses it obliquely [rad]."""

ROUGHEST = 0.0015
"""Greatest depth at which the surface may lie in a hollow under the middle of a tool that spans it [m]."""

COMPRESSION = 0.3
"""Greatest depth of a press, as a part of the thickness of the organ or of the distance from what is held."""

MARGIN = 0.005
"""Distance from the borders of the workspace that places keep, as randomised organs lie elsewhere [m]."""

NOWHERE = -1.0
"""Height of a surface that is not there [m]."""

UPWARDS = (0.0, 0.0, 1.0)
"""Direction from which a tool comes."""

INWARDS = 1e-5
"""Distance below the surface at which a ray through an organ begins [m]."""


@dataclass(frozen=True, eq=False)
class Spots:
    """Points on the surface of an organ, which is shifted, turned and scaled in randomised episodes.

    Attributes:
        corners: (K, 3) nodes of the triangle that each of them lies on.
        weights: (K, 3) by which the positions of these nodes are weighted.
    """

    corners: IntArray
    weights: FloatArray

    def on(self, nodes: FloatArray) -> FloatArray:
        """(K, 3) where they are on an organ with nodes (V, 3) [m]."""
        return np.asarray((nodes[self.corners] * self.weights[..., None]).sum(axis=1))

    def some(self, chosen: IntArray | BoolArray) -> Spots:
        """Some of them."""
        return Spots(self.corners[chosen], self.weights[chosen])


@dataclass(frozen=True, eq=False)
class Judged:
    """What became of the points of a surface that were tried as places.

    Attributes:
        spots: The K points that are seen from above.
        depths: (K,) greatest depths to which the organ may be pressed there, within the workspace [m].
        reasons: (K,) why they are no places, "" if they are.
    """

    spots: Spots
    depths: FloatArray
    reasons: list[str]

    @property
    def good(self) -> BoolArray:
        """(K,) which of them are places."""
        return np.array([not reason for reason in self.reasons], dtype=np.bool_)

    def told(self, organ: Any) -> str:
        """How many of them are places on an organ, and why the others are none."""
        counts = Counter(reason for reason in self.reasons if reason).most_common()
        why = ", ".join(f"{count} {reason}" for reason, count in counts)
        return (
            f"organ {getattr(organ, 'name', '')!r} has {int(self.good.sum())} places that the tool reaches: of "
            f"{len(self.reasons)} that are seen from above, {why or 'none is left out'}"
        )


def upright(normals: FloatArray) -> FloatArray:
    """Shortest rotations that turn unit normals into the vertical.

    Args:
        normals: (..., 3), none of them straight down.

    Returns:
        (..., 4) quaternions xyzw.
    """
    x, y, z = np.moveaxis(np.asarray(normals, dtype=np.float64), -1, 0)
    rotation = np.stack([y, -x, np.zeros_like(x), 1.0 + z], axis=-1)
    return np.asarray(rotation / np.sqrt((rotation**2).sum(axis=-1, keepdims=True)))


def turned_to(normals: FloatArray, orientation: FloatArray) -> FloatArray:
    """Turn a tool from where its lower face looks down to where it looks against normals.

    Args:
        normals: (..., 3) unit normals.
        orientation: (4,) of the tool over a level surface, quaternion xyzw.

    Returns:
        (..., 4) orientations.
    """
    return multiply(conjugate(upright(normals)), np.broadcast_to(orientation, (*np.shape(normals)[:-1], 4)))


def place_on(setting: Setting, places: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """Find the surface of an organ at rest at places that are seen from above.

    Args:
        setting: The setting.
        places: (K, 2) x and y [m].
        radius: Distance around a place over which the normal is averaged, as a tool does that lies on it [m].

    Returns:
        Points (K, 3) of the surface [m], and its unit normals (K, 3), weighted by area; NaN where there is no surface.
    """
    heights = setting.surface_heights(setting.rest_nodes[None], places)
    points = np.column_stack([places, heights])
    points[heights <= setting.ground_height] = np.nan
    # Of a fine surface all that is near, of a coarse one at least the triangle that is nearest.
    return points, average_normals(setting.rest_nodes, setting.triangles, points, radius, UPWARDS)


def judge_candidates(setting: Setting, depth: float, heights: Sequence[float], steepest: float = STEEPEST) -> Judged:
    """Look for places that the first tool reaches and can press along the normal of the surface.

    The tool comes down along the normal, turned to it, from the greatest of the heights, without meeting the organ
    elsewhere; its grip stays in the workspace down to the depth; and the organ is thick enough.

    Args:
        setting: The setting; nodes that its organ names as `held` do not move.
        depth: Least depth that must be possible [m].
        heights: Heights above the surface at which the tool must be free, ascending [m].
        steepest: Greatest angle between the normal and the vertical [rad].

    Returns:
        1024 points spread evenly over the surface, as far as they are seen from above.
    """
    chosen, weights = surface_samples(setting.rest_nodes, setting.triangles, CANDIDATES)
    spots = Spots(setting.triangles[chosen].astype(np.int64), weights)
    points = spots.on(setting.rest_nodes)
    seen = points[:, 2] >= setting.surface_heights(setting.rest_nodes[None], points[:, :2]) - INWARDS
    return Judged(spots.some(seen), *judge_places(setting, points[seen, :2], depth, heights, steepest))


def judge_places(
    setting: Setting, places: FloatArray, depth: float, heights: Sequence[float], steepest: float = STEEPEST
) -> tuple[FloatArray, list[str]]:
    """Say of places whether they can be pressed; see `judge_candidates`.

    Args:
        setting: The setting.
        places: (K, 2) x and y [m].
        depth: Least depth that must be possible [m].
        heights: Heights above the surface at which the tool must be free, ascending [m].
        steepest: Greatest angle between the normal and the vertical [rad].

    Returns:
        Greatest depths (K,) to which the organ may be pressed there [m], and why it cannot be pressed there at all, ""
        if it can.
    """
    tool = setting.tools[0]
    half_width, under = float(np.abs(tool.vertices[:, :2]).max()), float(tool.vertices[:, 2].min())
    points, normals = place_on(setting, places, half_width)
    held = setting.rest_nodes[list(getattr(setting.organ, "held", ()))]
    steepest = steepest if len(held) else min(steepest, STEEPEST_FREE)
    depths = np.zeros(len(points))
    reasons = []
    for row, (point, normal) in enumerate(zip(points, normals, strict=True)):
        if not np.isfinite(normal).all():
            reasons.append("are beside it")
            continue
        reach = _reach(setting, point - under * normal, normal)
        depths[row] = min(COMPRESSION * _thickness(setting, point, normal, held), reach)
        orientation = turned_to(normal, tool.orientation)
        ends = point + np.outer([heights[-1] - under, -depth - under], normal)
        if normal[2] < np.cos(steepest):
            reasons.append(f"are steeper than {np.rad2deg(steepest):.0f} degrees")
        elif (ends < setting.workspace_low + MARGIN).any() or (ends > setting.workspace_high - MARGIN).any():
            reasons.append("are not within the workspace")
        elif depths[row] < depth:
            reasons.append(f"are thinner than {depth / COMPRESSION:.3g} m above what is held")
        elif _hollow(setting, point, normal, half_width) > ROUGHEST:
            reasons.append("lie in hollows that the tool spans")
        elif not _is_free(setting, point - under * normal, normal, orientation, heights):
            reasons.append("are not free above")
        else:
            reasons.append("")
    return depths, reasons


def _thickness(setting: Setting, point: FloatArray, normal: FloatArray, held: FloatArray) -> float:
    """How far the organ reaches below a point, or how near it is held [m]."""
    start = point - INWARDS * normal
    hit, distance, _, _, _ = cast_ray(start, -normal, setting.rest_nodes, np.array(setting.triangles))
    thickness = float(distance) if hit != NO_HIT else 0.0
    if len(held):
        thickness = min(thickness, float(np.sqrt(((held - point) ** 2).sum(axis=1).min())))
    return thickness


def _reach(setting: Setting, grip: FloatArray, normal: FloatArray) -> float:
    """How far the grip can move against a normal from a point before it is near the workspace's border [m]."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = np.concatenate(
            [(grip - setting.workspace_low - MARGIN) / normal, (grip - setting.workspace_high + MARGIN) / normal]
        )
    return float(ways[np.concatenate([normal > 0.0, normal < 0.0])].min())


def _hollow(setting: Setting, point: FloatArray, normal: FloatArray, half_width: float) -> float:
    """How deep a point lies below the highest one under a level tool that is turned to the normal [m]."""
    nodes = turn(upright(normal), setting.rest_nodes - point)
    grid = half_width * np.linspace(-1.0, 1.0, 5)
    spots = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    under = local_heights(nodes[None], setting.triangles, spots)
    return float(under.max())


def local_heights(nodes: FloatArray, triangles: IndexArray, places: FloatArray) -> FloatArray:
    """Heights of surfaces in frames of their own, as `Setting.surface_heights`; far below where there is no surface.

    Args:
        nodes: (W, V, 3) nodes of the surfaces, or (1, V, 3) [m].
        triangles: (T, 3).
        places: (W, 2) x and y [m].
    """
    heights: FloatArray = surface_heights(
        np.ascontiguousarray(nodes), np.array(triangles), np.ascontiguousarray(places), NOWHERE
    )
    return heights


def _is_free(
    setting: Setting, middle: FloatArray, normal: FloatArray, orientation: FloatArray, heights: Sequence[float]
) -> bool:
    """Whether the tool overlaps no organ at heights above where it lies on the surface."""
    tool = setting.tools[0]
    corners = turn(orientation, tool.vertices)
    return not any(
        overlaps(setting.rest_nodes, setting.triangles, corners + middle + height * normal, tool.triangles)
        for height in heights
    )
