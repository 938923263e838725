"""A fissure in a piece of an organ, and a thin spatula that stands on edge above it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry import Tool, fissured_block
from spatula_env.scenes.base import PlacedOrgan, PlacedTool, Scale, ScaleName, Scene, choose_scale

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.scenes.material import Material

ON_EDGE = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
"""Orientation of a plate on edge, quaternion xyzw: its y axis upwards and its thickness, z, along negative y."""

FISSURE_CLEARANCE = 0.3
"""How far the spatula's edge is above the organ at reset [u]."""

STIFFNESS = 0.609
"""Effective modulus of the organ where the blade pushes a wall [kg/(u s2)], x dt^2 x area / mass [u].
Measured by scripts/calibrate_stiffness.py; docs/calibration.md describes how."""


def fissure(
    size: ArrayLike = (6.0, 5.0, 3.0),
    mass: float = 10.0,
    dt: float = 1.0 / 240.0,
    *,
    depth: float = 1.6,
    length: float = 3.0,
    width: float = 0.25,
    edge_length: float = 0.25,
    base_edge_length: float | None = 0.65,
    fixed_floor: bool = True,
    tool_size: ArrayLike = (1.0, 2.0, 0.125),
    node_spacing: float = 0.2,
    faces: str = "all",
    friction: float = 0.2,
    scale: ScaleName | Scale = "stiffness",
    material: Material | None = None,
) -> Scene:
    """A fissure in a piece of an organ, and a thin spatula that stands on edge above it.

    One unit is 20 mm, as in :func:`seed`: a fissure 60 mm long, 32 mm deep and 5 mm wide, about as large as the lateral
    fissure of the brain, and a spatula 20 mm wide and 2.5 mm thick, as the seed's. Moving a wall aside by 6 mm takes
    0.27 N, and by 10 mm 0.46 N. Averaged over the part of the blade in the fissure, that is a pressure of 0.5 and
    0.9 kPa; the greatest pressures are 2.4 and 3.9 kPa.

    A blade half as thick occasionally passes through a fold of the walls, with 0.1 N: about once in 10,000 random
    control steps. The surface's mesh is 0.25 u wide there.

    The organ is held at its base, which is on the ground. An organ that is a surface of springs is hollow: if the floor
    of the fissure is not held, it hangs loosely between the walls and follows the wall that is pushed, and the fissure
    moves sideways more than it opens. In a real organ the tissue below holds the floor; here its nodes are fixed.

    Args:
        size: (3,) extents of the organ [u].
        mass: Mass of the organ [kg].
        dt: Length of a physics step [s].
        depth: Depth of the fissure [u].
        length: Length of the fissure, along x [u].
        width: Distance of the fissure's walls, along y [u].
        edge_length: Edge length of the organ's triangles in and around the fissure [u].
        base_edge_length: Edge length of the organ's triangles at the base [u]; None for that of the others.
        fixed_floor: Whether the floor of the fissure is held too.
        tool_size: (3,) edges of the spatula [u]: its width, along x; its height, upwards; its thickness, along y.
        node_spacing: Greatest distance of contact nodes along an edge of the spatula [u].
        faces: Which faces of the spatula carry contact nodes, "largest" or "all".
        friction: Coulomb coefficient between spatula and organ.
        scale: How the mass scale is chosen. "stiffness": forces are those of tissue of a Young's modulus of 2 kPa.
            "density": the organ has the density of brain tissue. Or a scale.
        material: What the organ is made of, for the engine "tissue"; the mass scale then follows from its density.

    Returns:
        The scene. Its organ is a :class:`~spatula_env.geometry.FissuredBlock`, which names the nodes of walls and floor
        and the target.

    Raises:
        ValueError: If a value is not allowed, or the parts do not fit into each other.
    """
    block = fissured_block(size, depth, length, width, edge_length, base_edge_length=base_edge_length)
    tool = Tool.box(tool_size, faces=faces, node_spacing=node_spacing)
    fixed = np.union1d(block.base, block.floor) if fixed_floor else block.base
    top = float(block.bounds[1, 2])
    return Scene(
        organs=(PlacedOrgan(block, mass=mass, fixed_nodes=tuple(fixed.tolist()), material=material),),
        tools=(
            PlacedTool(
                tool,
                position=(0.0, 0.0, top + FISSURE_CLEARANCE + 0.5 * float(tool.size[1])),
                orientation=ON_EDGE,
                friction=friction,
            ),
        ),
        dt=dt,
        scale=choose_scale(scale, block, mass, dt, STIFFNESS, material),
        name="fissure",
    )
