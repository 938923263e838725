"""The scene of palpation: the seed's organ, held from below, under a thin spatula."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry.checks import check_positive
from spatula_env.scenes.base import Scale, ScaleName, Scene, choose_scale
from spatula_env.scenes.seed import seed

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.scenes.material import Material

STIFFNESS = 0.69
"""Effective modulus of the organ under the spatula [kg/(u s2)], x dt^2 x area / mass [u].
Measured by scripts/calibrate_stiffness.py; docs/calibration.md describes how."""


def palpate(
    tool_size: ArrayLike = (1.0, 1.0, 0.125),
    mass: float = 10.0,
    dt: float = 1.0 / 240.0,
    *,
    held_height: float = 2.0,
    nodes_per_edge: int = 6,
    faces: str = "largest",
    friction: float = 0.2,
    scale: ScaleName | Scale = "stiffness",
    material: Material | None = None,
) -> Scene:
    """The scene of the seed, its sphere held up to a height as a brain is held in the skull.

    A sphere that lies free on the ground rolls along with a spatula that slides over it, by as much as the spatula
    moves. A sphere that is held stays, so that the spatula feels the organ and not the floor.

    Args:
        tool_size: (3,) edges of the box-shaped spatula [u].
        mass: Mass of the sphere [kg].
        dt: Length of a physics step [s].
        held_height: Nodes lower than this height above the ground do not move [u].
        nodes_per_edge: Contact nodes along the longest edge of the spatula's largest faces.
        faces: Which faces carry contact nodes, "largest" or "all".
        friction: Coulomb coefficient between spatula and sphere.
        scale: How the mass scale is chosen. "stiffness": forces are those of tissue of a Young's modulus of 2 kPa.
            "density": the organ has the density of brain tissue. Or a scale.
        material: What the organ is made of, for the engine "tissue"; the mass scale then follows from its density.

    Returns:
        The scene.

    Raises:
        ValueError: If a value is not allowed, or nothing or everything would be held.
    """
    check_positive(held_height, "held_height")
    scene = seed(tool_size, mass, dt, nodes_per_edge=nodes_per_edge, faces=faces, friction=friction)
    heights = scene.organs[0].vertices[:, 2]
    held = np.flatnonzero(heights < held_height)
    if not 0 < len(held) < len(heights):
        raise ValueError(
            f"held_height must be between {heights.min():.4f} and {heights.max():.4f} u, where the sphere begins and "
            f"ends; got {held_height!r}"
        )
    organ = replace(scene.organs[0], fixed_nodes=tuple(held.tolist()), material=material)
    return replace(
        scene,
        organs=(organ,),
        scale=choose_scale(scale, organ.organ, mass, dt, STIFFNESS, material),
        name="palpate",
    )
