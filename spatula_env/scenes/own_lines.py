"""Scenes with an organ of one's own that names a line: the floor of a fissure, or the crest of a ridge."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry import Tool
from spatula_env.geometry.prepared import FISSURE, RIDGE
from spatula_env.scenes.base import PlacedTool, Scene
from spatula_env.scenes.fissure import ON_EDGE
from spatula_env.scenes.own_organ import in_units, scene_on_ground

if TYPE_CHECKING:
    from spatula_env.geometry.prepared import PreparedOrgan
    from spatula_env.scenes.material import Material

CLEARANCE = 0.006
"""Height of the tools' lower edges above the organ's top at reset [m]."""

OPENING = 0.024
"""Free width between the jaws at reset [m]."""

NODE_SPACING = 0.004
"""Greatest distance of contact nodes along an edge of a tool [m]."""


def organ_with_fissure(
    organ: PreparedOrgan,
    mass: float = 10.0,
    dt: float = 1.0 / 240.0,
    *,
    friction: float = 0.2,
    fixed_floor: bool = True,
    material: Material | None = None,
) -> Scene:
    """The spatula of `scenes.fissure` on edge, 20 mm wide, 40 mm high and 2.5 mm thick, above a fissure of an organ.

    The organ stands on the ground, turned about the vertical so that the line "fissure" runs along x, with the line's
    middle over the origin.

    Args:
        organ: The organ; its held nodes do not move.
        mass: Mass of the organ [kg].
        dt: Length of a physics step [s].
        friction: Coulomb coefficient between spatula and organ.
        fixed_floor: Whether the nodes of the line are held too, as in `scenes.fissure`.
        material: What the organ is made of, for the engine "tissue"; the mass scale then follows from its density.

    Returns:
        The scene.

    Raises:
        ValueError: If the organ names no line "fissure".
    """
    organ = _along_x(organ, FISSURE)
    tool = Tool.box(in_units((0.02, 0.04, 0.0025), organ), faces="all", node_spacing=NODE_SPACING / organ.unit_length)
    placed = PlacedTool(tool, (0.0, 0.0, _above(organ, tool)), ON_EDGE, friction)
    fixed = sorted({*organ.held, *organ.lines[FISSURE]}) if fixed_floor else organ.held
    return scene_on_ground(organ, (placed,), mass, dt, material, tuple(fixed))


def organ_with_ridge(
    organ: PreparedOrgan,
    mass: float = 10.0,
    dt: float = 1.0 / 240.0,
    *,
    friction: float = 0.4,
    material: Material | None = None,
) -> Scene:
    """The jaws of `scenes.clamp`, 24 mm long, 16 mm high and 2.4 mm thick each, above a ridge of an organ.

    The organ stands on the ground, turned about the vertical so that the line "ridge" runs along x, with the line's
    middle over the origin. The jaws face each other along y, the first at negative y.

    Args:
        organ: The organ; its held nodes do not move.
        mass: Mass of the organ [kg].
        dt: Length of a physics step [s].
        friction: Coulomb coefficient between jaws and organ.
        material: What the organ is made of, for the engine "tissue"; the mass scale then follows from its density.

    Returns:
        The scene.

    Raises:
        ValueError: If the organ names no line "ridge".
    """
    organ = _along_x(organ, RIDGE)
    size = in_units((0.024, 0.016, 0.0024), organ)
    jaw = Tool.box(size, faces="all", node_spacing=NODE_SPACING / organ.unit_length, name="jaw")
    aside = 0.5 * (OPENING / organ.unit_length + float(jaw.size[2]))
    jaws = tuple(PlacedTool(jaw, (0.0, side * aside, _above(organ, jaw)), ON_EDGE, friction) for side in (-1.0, 1.0))
    return scene_on_ground(organ, jaws, mass, dt, material, organ.held)


def _along_x(organ: PreparedOrgan, name: str) -> PreparedOrgan:
    """The organ on the ground, turned by a right angle at most until a line runs along x, over the origin."""
    line = organ.line(name)[:, :2]
    # Along the greatest extent of the line: its nodes may lie to the left and to the right of it.
    direction = np.linalg.svd(line - line.mean(axis=0), full_matrices=False)[2][0]
    turned = organ.turned(-math.remainder(math.atan2(direction[1], direction[0]), math.pi))
    low, high = turned.line(name)[:, :2].min(axis=0), turned.line(name)[:, :2].max(axis=0)
    x, y = 0.5 * (low + high)
    return turned.moved((-x, -y, -turned.bounds[0, 2]))


def _above(organ: PreparedOrgan, tool: Tool) -> float:
    """Height at which a tool on edge is just above the organ [u]."""
    return float(organ.bounds[1, 2]) + CLEARANCE / organ.unit_length + 0.5 * float(tool.size[1])
