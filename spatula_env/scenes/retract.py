"""The scene of retraction: an upright blade over a fold of an organ."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from spatula_env.geometry import Tool, ridged_block
from spatula_env.scenes.base import PlacedOrgan, PlacedTool, Scale, ScaleName, Scene, choose_scale

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.scenes.material import Material

UPRIGHT = (0.5, 0.5, 0.5, 0.5)
"""Orientation of an upright plate with its faces to the left and to the right, quaternion xyzw: its x axis along y, its
y axis upwards, and its thickness, z, along x."""

QUARTER_TURN = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
"""Orientation of the organ, quaternion xyzw: the x axis of its own frame runs along y in the scene."""

BLADE_CLEARANCE = 0.4
"""How far the blade's lower edge is above the organ at reset [u]."""

STIFFNESS = 2.03
"""Effective modulus of the organ where the blade pushes the fold [kg/(u s2)], x dt^2 x area / mass [u].
Measured by scripts/calibrate_stiffness.py; docs/calibration.md describes how."""


def retract(
    size: ArrayLike = (3.2, 3.0, 0.8),
    mass: float = 10.0,
    dt: float = 1.0 / 240.0,
    *,
    fold_height: float = 1.4,
    fold_length: float = 2.4,
    fold_width: float = 0.9,
    edge_length: float = 0.35,
    base_edge_length: float | None = 0.6,
    tool_size: ArrayLike = (1.0, 2.0, 0.09),
    node_spacing: float = 0.2,
    faces: str = "all",
    friction: float = 0.4,
    scale: ScaleName | Scale = "stiffness",
    material: Material | None = None,
) -> Scene:
    """A fold of an organ, and an upright blade above it, its faces to the left and to the right.

    The fold runs away from the operator. One unit is 20 mm: a fold 48 mm long, 18 mm wide and 28 mm high, on a piece of
    an organ that is held at its base; and a blade 20 mm wide, 40 mm high and 1.8 mm thick. Beside the fold there is
    room for the blade, which pushes it aside.

    Args:
        size: (3,) extents of the organ without the fold: along the fold, across it, and upwards [u].
        mass: Mass of the organ [kg].
        dt: Length of a physics step [s].
        fold_height: Height of the fold above the organ's top [u].
        fold_length: Length of the fold, along y [u].
        fold_width: Width of the fold, along x [u].
        edge_length: Edge length of the fold's triangles [u].
        base_edge_length: Edge length of the organ's triangles at the base [u]; None for that of the others.
        tool_size: (3,) edges of the blade [u]: its width, along y; its height, upwards; its thickness, along x.
        node_spacing: Greatest distance of contact nodes along an edge of the blade [u].
        faces: Which faces of the blade carry contact nodes, "largest" or "all".
        friction: Coulomb coefficient between blade and organ: that of moist cotton, which is laid under a retractor,
            rather than of bare steel.
        scale: How the mass scale is chosen. "stiffness": forces are those of tissue of a Young's modulus of 2 kPa.
            "density": the organ has the density of brain tissue. Or a scale.
        material: What the organ is made of, for the engine "tissue"; the mass scale then follows from its density.

    Returns:
        The scene. Its organ is a :class:`~spatula_env.geometry.RidgedBlock`, which names the nodes of the fold's
        flanks: the first those on the right, the second those on the left.

    Raises:
        ValueError: If a value is not allowed, or the parts do not fit into each other.
    """
    block = ridged_block(size, fold_height, fold_length, fold_width, edge_length, base_edge_length=base_edge_length)
    tool = Tool.box(tool_size, faces=faces, node_spacing=node_spacing, name="blade")
    top = float(block.bounds[1, 2])
    return Scene(
        organs=(
            PlacedOrgan(
                block, mass=mass, orientation=QUARTER_TURN, fixed_nodes=tuple(block.base.tolist()), material=material
            ),
        ),
        tools=(
            PlacedTool(
                tool,
                position=(0.0, 0.0, top + BLADE_CLEARANCE + 0.5 * float(tool.size[1])),
                orientation=UPRIGHT,
                friction=friction,
            ),
        ),
        dt=dt,
        scale=choose_scale(scale, block, mass, dt, STIFFNESS, material),
        name="retract",
    )
