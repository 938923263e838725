"""Two jaws on either side of a ridge on a piece of an organ."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from spatula_env.geometry import Tool, ridged_block
from spatula_env.scenes.base import PlacedOrgan, PlacedTool, Scale, ScaleName, Scene, choose_scale

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.scenes.material import Material

JAW_CLEARANCE = 0.2
"""How far each jaw is from the ridge at reset [u]."""

STIFFNESS = 0.168
"""Effective modulus of the organ between the jaws [kg/(u s2)], x dt^2 x area / mass [u].
Measured by scripts/calibrate_stiffness.py; docs/calibration.md describes how."""


def clamp(
    size: ArrayLike = (4.0, 3.2, 1.2),
    mass: float = 10.0,
    dt: float = 1.0 / 240.0,
    *,
    ridge_height: float = 1.3,
    ridge_length: float = 2.0,
    ridge_width: float = 0.8,
    edge_length: float = 0.25,
    base_edge_length: float | None = 0.5,
    fixed_base: bool = False,
    jaw_size: ArrayLike = (1.2, 0.8, 0.12),
    jaw_tilt: float = 0.0,
    node_spacing: float = 0.2,
    faces: str = "all",
    friction: float = 0.4,
    scale: ScaleName | Scale = "stiffness",
    material: Material | None = None,
) -> Scene:
    """Two jaws on either side of a ridge on a piece of an organ, which rests on the ground.

    The jaws face each other along y: the first tool is at negative y and closes along +y, the second is its mirror
    image. They are above the ridge's foot. One unit is 20 mm: a ridge 40 mm long, 16 mm wide and 26 mm high, and jaws
    24 mm long. Jaws that compress the ridge by three tenths of its width press with 0.25 N each, and can then lift the
    organ, which weighs an eighth of that.

    Args:
        size: (3,) extents of the organ without the ridge [u].
        mass: Mass of the organ [kg].
        dt: Length of a physics step [s].
        ridge_height: Height of the ridge above the organ's top [u].
        ridge_length: Length of the ridge, along x [u].
        ridge_width: Width of the ridge, along y, between the jaws [u].
        edge_length: Edge length of the ridge's triangles [u].
        base_edge_length: Edge length of the organ's triangles at the base [u]; None for that of the others.
        fixed_base: Whether the base is held to the ground. Lifting then stretches the organ, which is much stiffer than
            the ridge: jaws that squeeze it by three tenths slip after about 0.1 u.
        jaw_size: (3,) edges of each jaw [u]: its length, along x; its height; its thickness, along y.
        jaw_tilt: Angle by which each jaw's lower edge is turned towards the ridge [rad].
        node_spacing: Greatest distance of contact nodes along an edge of a jaw [u].
        faces: Which faces of the jaws carry contact nodes, "largest" or "all".
        friction: Coulomb coefficient between jaws and organ: that of a toothed jaw rather than of a smooth spatula.
        scale: How the mass scale is chosen. "stiffness": forces are those of tissue of a Young's modulus of 2 kPa.
            "density": the organ has the density of brain tissue. Or a scale.
        material: What the organ is made of, for the engine "tissue"; the mass scale then follows from its density.

    Returns:
        The scene. Its organ is a :class:`~spatula_env.geometry.RidgedBlock`, which names the nodes of the ridge's
        flanks.

    Raises:
        ValueError: If a value is not allowed, or the parts do not fit into each other.
    """
    block = ridged_block(size, ridge_height, ridge_length, ridge_width, edge_length, base_edge_length=base_edge_length)
    jaw = Tool.box(jaw_size, faces=faces, node_spacing=node_spacing, name="jaw")
    if not (math.isfinite(jaw_tilt) and abs(jaw_tilt) < 0.5 * math.pi):
        raise ValueError(f"jaw_tilt must be between -pi/2 and pi/2, got {jaw_tilt!r}")
    half_height, half_thickness = 0.5 * float(jaw.size[1]), 0.5 * float(jaw.size[2])
    reach = half_height * abs(math.sin(jaw_tilt)) + half_thickness * math.cos(jaw_tilt)
    rise = half_height * math.cos(jaw_tilt) + half_thickness * abs(math.sin(jaw_tilt))
    # As high as the flanks reach: above, the crest is round.
    height = max(block.foot_height + ridge_height - 0.25 * ridge_width, block.foot_height + 2.0 * rise) - rise
    tools = []
    for side in (-1.0, 1.0):
        angle = 0.25 * math.pi - 0.5 * side * jaw_tilt
        tools.append(
            PlacedTool(
                jaw,
                position=(0.0, side * (0.5 * ridge_width + JAW_CLEARANCE + reach), height),
                orientation=(math.sin(angle), 0.0, 0.0, math.cos(angle)),
                friction=friction,
            )
        )
    return Scene(
        organs=(
            PlacedOrgan(
                block, mass=mass, fixed_nodes=tuple(block.base.tolist()) if fixed_base else (), material=material
            ),
        ),
        tools=tuple(tools),
        dt=dt,
        scale=choose_scale(scale, block, mass, dt, STIFFNESS, material),
        name="clamp",
    )
