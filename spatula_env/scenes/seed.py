"""The scene of the seed: a thin spatula over a soft sphere."""

from __future__ import annotations

from typing import TYPE_CHECKING

from spatula_env.geometry import Tool, seed_sphere
from spatula_env.scenes.base import PlacedOrgan, PlacedTool, Scale, ScaleName, Scene, choose_scale

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.scenes.material import Material

RESTING_SPHERE = (-0.0235445, 0.0522466, 0.0003375, 0.9983566)
"""Orientation of the seed's sphere after it has rolled to rest, quaternion xyzw. The sphere is a polyhedron: unturned,
it would stand on its first node alone, and roll from there for many seconds."""

RESTING_TISSUE = (-0.0346434, 0.2223635, 0.0083369, 0.9743125)
"""The same for a sphere of `Material()`, which its weight flattens by 0.19 u: it rolls farther before it lies."""

STIFFNESS = 0.521
"""Effective modulus of the organ under the spatula [kg/(u s2)], x dt^2 x area / mass [u].
Measured by scripts/calibrate_stiffness.py; docs/calibration.md describes how."""


def seed(
    tool_size: ArrayLike = (1.0, 1.0, 0.125),
    mass: float = 10.0,
    dt: float = 1.0 / 240.0,
    *,
    nodes_per_edge: int = 6,
    faces: str = "largest",
    friction: float = 0.2,
    scale: ScaleName | Scale = "stiffness",
    material: Material | None = None,
) -> Scene:
    """The scene of the seed: a thin spatula over a soft sphere that rests on the ground.

    The sphere has radius 3 u, 328 nodes and 652 triangles; gravity is 10 u/s2. One unit is 20 mm: a 20 x 20 x 2.5 mm
    spatula and an organ of 60 mm radius, which the Falcon's 101.6 mm cube covers one to one.

    Args:
        tool_size: (3,) edges of the box-shaped spatula [u].
        mass: Mass of the sphere [kg].
        dt: Length of a physics step [s].
        nodes_per_edge: Contact nodes along the longest edge of the spatula's largest faces.
        faces: Which faces carry contact nodes, "largest" or "all".
        friction: Coulomb coefficient between spatula and sphere.
        scale: How the mass scale is chosen. "stiffness": forces are those of tissue of a Young's modulus of 2 kPa.
            "density": the organ has the density of brain tissue. Or a scale.
        material: What the organ is made of, for the engine "tissue"; the mass scale then follows from its density.

    Returns:
        The scene.
    """
    sphere = seed_sphere()
    tool = Tool.box(size=tool_size, nodes_per_edge=nodes_per_edge, faces=faces)
    return Scene(
        organs=(
            PlacedOrgan(
                sphere,
                position=(0.0, 0.0, 3.0),
                mass=mass,
                orientation=RESTING_SPHERE,
                material=material,
                material_orientation=RESTING_TISSUE,
            ),
        ),
        tools=(PlacedTool(tool, position=(0.0, 0.0, 7.0), friction=friction),),
        dt=dt,
        scale=choose_scale(scale, sphere, mass, dt, STIFFNESS, material),
        name="seed",
    )
