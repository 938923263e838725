"""The drawable model of a scene: organs with their contact pressure, tools, forces, and marks of the goal.

The model makes meshes and curves but draws nothing: `SceneView` makes pictures of them, and `Window` shows them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.arrays import FloatArray
from spatula_env.geometry.transforms import rotation_matrix
from spatula_env.render.camera import Vector
from spatula_env.render.display_surface import DisplaySurface, vertex_normals
from spatula_env.render.moment import Moment
from spatula_env.render.occlusion import openness
from spatula_env.render.palette import (
    CAUTION,
    FORCE,
    GOAL,
    HIGHEST_PRESSURE,
    MARKER,
    PRESSURE,
    STEEL,
    TISSUE,
    TISSUE_INSIDE,
)
from spatula_env.render.primitives import BRUSHED_STEEL, WET_TISSUE, GroundPlane, Mesh, perpendicular_axes
from spatula_env.render.shapes import arrow_mesh, ring_mesh, sphere_mesh, tube_mesh
from spatula_env.tasks.marks import Patch, Path, Points, Ring

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.scenes import Scene


ARROW_LENGTH = 4.0
"""Length of a force's arrow [u/N]."""

LONGEST_ARROW = 2.5
"""Greatest length of an arrow; greater forces have the same [u]."""

LEAST_FORCE = 0.01
"""Smallest force that is drawn [N]."""

LINE_WIDTH = 0.05
"""Width of the lines of rings and paths [u]."""

PRESSURE_REACH = 0.32
"""Distance around a contact node within which the organ is coloured [u]; tools hide what lies directly under them."""

PALE_PRESSURE = 400.0
"""Pressure from which the colour of pressure replaces the colour of the tissue [Pa]; below, they are mixed."""

DARKEST = 0.22
"""Brightness of a point of the organ from which nothing of the room is visible."""

ROLE_COLORS = MappingProxyType({"goal": GOAL, "target": MARKER, "caution": CAUTION})
"""Colours of patches."""


@dataclass(frozen=True, eq=False)
class Composition:
    """Everything to draw at one moment.

    Attributes:
        meshes: Organs first, then tools and arrows.
        marks: Meshes that show a goal.
        ground: The plane under everything, or None.
        curves: (K, 3) each: points along marks whose hidden parts should shine through [u].
    """

    meshes: list[Mesh]
    marks: list[Mesh]
    ground: GroundPlane | None
    curves: list[FloatArray]


class SceneModel:
    """Makes the `Composition` of a scene, moment after moment.

    Attributes:
        surface: The organs' surface for display.
        tissue: (V', 3) colours of its vertices, darker where little of the room is visible.
        tools: Meshes of the tools in their own frames.
        ground: The ground, or None.
    """

    def __init__(self, scene: Scene, triangles: NDArray[np.int32], levels: int | None = None) -> None:
        """Prepare the meshes.

        Args:
            scene: The scene with organs and tools.
            triangles: (T, 3) of all organs, indices into all their nodes.
            levels: How many times to split the organs' triangles in four; None: until they are small.
        """
        nodes = np.concatenate([placed.vertices for placed in scene.organs])
        self.surface = surface = DisplaySurface(nodes, triangles, levels)
        normals = vertex_normals(surface.rest, surface.triangles)
        light = DARKEST + (1.0 - DARKEST) * openness(surface.rest, normals, surface.triangles)
        # Colours are display values, which are approximately a root of light.
        self._gain = np.minimum(light, 1.0)[:, None] ** (1.0 / 2.2)
        self.tissue = np.ascontiguousarray(self._gain * TISSUE)
        self._organ = Mesh(
            surface.rest,
            surface.triangles,
            color=TISSUE,
            vertex_colors=self.tissue,
            material=WET_TISSUE,
            texture=surface.rest,
        )
        self.tools = [
            Mesh(
                placed.tool.vertices,
                placed.tool.triangles,
                color=STEEL,
                smooth=False,
                material=BRUSHED_STEEL,
                texture=np.array(placed.tool.vertices),
            )
            for placed in scene.tools
        ]
        self._contact_nodes = [np.array(placed.tool.nodes) for placed in scene.tools]
        self._contact_normals = [np.array(placed.tool.normals) for placed in scene.tools]
        self.ground = None
        if scene.ground is not None:
            middle = 0.5 * (nodes.min(axis=0) + nodes.max(axis=0))
            self.ground = GroundPlane(scene.ground.height, center=(float(middle[0]), float(middle[1])))

    def compose(self, moment: Moment, cut: tuple[Vector, Vector] | None = None) -> Composition:
        """Compose everything to draw at one moment.

        Args:
            moment: The moment.
            cut: (point, normal): organs are cut open, and their part on the side of the normal is removed.

        Raises:
            ValueError: If the number of tools, of forces or of pressures is not that of the scene.
        """
        count = len(self.tools)
        positions = _rows(moment.tool_positions, "tool_positions", count, 3)
        orientations = _rows(moment.tool_orientations, "tool_orientations", count, 4)
        rotations = [rotation_matrix(orientation) for orientation in orientations]
        nodes = np.asarray(moment.nodes, dtype=np.float64)
        points = self.surface.place(nodes)
        colors = self.tissue
        patches = [mark for mark in moment.marks if isinstance(mark, Patch)]
        if patches:
            colors = self._patched(colors, patches, len(nodes))
        if moment.pressures is not None:
            if len(moment.pressures) != count:
                raise ValueError(f"pressures must be given for {count} tools, got {len(moment.pressures)}")
            for index, pressure in enumerate(moment.pressures):
                places = positions[index] + moment.tool_scale * self._contact_nodes[index] @ rotations[index].T
                out = self._contact_normals[index] @ rotations[index].T
                colors = self._pressed(colors, points, places, out, pressure)
        organ = replace(self._organ, vertices=points, vertex_colors=colors)
        if cut is not None:
            organ = replace(organ, clip_plane=cut, capped=True, back_color=TISSUE_INSIDE)
        meshes = [organ]
        for tool, position, rotation in zip(self.tools, positions, rotations, strict=True):
            meshes.append(replace(tool, vertices=position + moment.tool_scale * tool.vertices @ rotation.T))
        if moment.forces is not None:
            for position, force in zip(positions, _rows(moment.forces, "forces", count, 3), strict=True):
                size = float(np.linalg.norm(force))
                if size > LEAST_FORCE:
                    length = min(ARROW_LENGTH, LONGEST_ARROW / size)
                    meshes.append(arrow_mesh(position, length * force, color=FORCE, casts_shadow=False))
        signs: list[Mesh] = []
        curves: list[FloatArray] = []
        for mark in moment.marks:
            if isinstance(mark, Ring):
                signs.append(ring_mesh(mark.point, mark.radius, mark.normal, width=LINE_WIDTH, casts_shadow=False))
                curves.append(_circle(mark.point, mark.radius, mark.normal))
            elif isinstance(mark, Path):
                signs.append(tube_mesh(mark.points, width=LINE_WIDTH))
                curves.append(mark.points)
            elif isinstance(mark, Points):
                signs.append(sphere_mesh(mark.points, 2.0 * LINE_WIDTH, casts_shadow=False))
                curves += [_circle(point, 2.0 * LINE_WIDTH) for point in mark.points]
        ground = self.ground
        if ground is not None and moment.ground_height is not None:
            ground = replace(ground, height=moment.ground_height)
        return Composition(meshes, signs, ground, curves)

    def _patched(self, colors: FloatArray, patches: Sequence[Patch], count: int) -> FloatArray:
        """Colours (V', 3) with some patches of the organ's `count` nodes coloured."""
        for patch in patches:
            inside = np.zeros((count, 1))
            inside[patch.nodes] = 1.0
            # The colour extends to the middle of the edges that leave the patch, if the surface is split that far.
            share = np.clip(2.0 * self.surface.interpolate(inside) - 1.0, 0.0, 1.0)
            colors = self.dyed(patch.role, colors, share)
        return colors

    def dyed(self, role: str, colors: FloatArray | None = None, share: ArrayLike = 1.0) -> FloatArray:
        """Colours (V', 3) of the organs' vertices where a patch dyes them.

        Args:
            role: Role of the patch.
            colors: (V', 3) colours without it; None for those of the tissue.
            share: (V', 1) how much each vertex belongs to the patch, 0..1.
        """
        bare = self.tissue if colors is None else colors
        # The dye is darkened less than the tissue, so that a patch at the bottom of a fissure is visible.
        dye = np.sqrt(self._gain) * ROLE_COLORS[role]
        dyed: FloatArray = bare + 0.8 * np.asarray(share) * (dye - bare)
        return dyed

    def _pressed(
        self, colors: FloatArray, points: FloatArray, places: FloatArray, out: FloatArray, pressure: FloatArray
    ) -> FloatArray:
        """Colours (V', 3) of vertices at `points` (V', 3), with the pressure (n,) on contact nodes of a tool.

        The nodes are at `places` (n, 3), and `out` (n, 3) are the outward normals of their faces.
        """
        pressure = np.asarray(pressure, dtype=np.float64)
        if pressure.shape != (len(places),):
            raise ValueError(f"pressures must be given for {len(places)} contact nodes, got {pressure.shape}")
        pressing = np.flatnonzero(pressure > 0.05 * PALE_PRESSURE)
        if not len(pressing):
            return colors
        places, out, pressure = places[pressing], out[pressing], pressure[pressing]
        low, high = places.min(axis=0) - PRESSURE_REACH, places.max(axis=0) + PRESSURE_REACH
        near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        if not len(near):
            return colors
        normals = vertex_normals(points, self.surface.triangles)[near]
        away = ((points[near, None] - places) ** 2).sum(axis=2) / PRESSURE_REACH**2
        # The surface that a face presses faces it; another surface close by does not.
        facing = np.clip(0.3 - 2.0 * (normals @ out.T), 0.0, 1.0)
        falloff = np.maximum(1.0 - away, 0.0)
        felt = (falloff * facing * pressure).max(axis=1)
        share = 0.9 * np.minimum(felt / PALE_PRESSURE, 1.0)[:, None]
        warm = PRESSURE(felt, 0.0, HIGHEST_PRESSURE) * np.sqrt(self._gain[near])
        colors = colors.copy()
        colors[near] += share * (warm - colors[near])
        return colors


def _rows(values: ArrayLike, name: str, count: int, size: int) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape == (size,):
        array = array[None]
    if array.shape != (count, size):
        raise ValueError(f"{name} must have the shape ({count}, {size}), got {array.shape}")
    return array


def _circle(point: FloatArray, radius: float, normal: ArrayLike = (0.0, 0.0, 1.0)) -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    first, second, _ = perpendicular_axes(normal)
    circle: FloatArray = point + radius * (np.outer(np.cos(angle), first) + np.outer(np.sin(angle), second))
    return circle
