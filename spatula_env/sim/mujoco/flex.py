"""An organ as one of MuJoCo's flexes: linear tetrahedra, masses of their nodes, and the longest stable step."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry.tetrahedra import fill_organ
from spatula_env.scenes import Material
from spatula_env.sim.tissue.body import UNDERESTIMATE, longest_substep, place_nodes
from spatula_env.sim.tissue.solid import POWER_STEPS, Solid

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray, Int32Array
    from spatula_env.scenes import PlacedOrgan, Scale

UNSTATED = Material(poisson_ratio=0.3)
"""Material of organs whose scene states none: linear tetrahedra bear the ratio, see `GREATEST_RATIO`."""

GREATEST_RATIO = 0.4
"""Greatest Poisson's ratio. MuJoCo's elements are linear tetrahedra with strains of their own, which lock where tissue
hardly changes its volume; `python -m benchmarks.tissue --checks mujoco` measures by how much."""


@dataclass(frozen=True)
class FlexOrgan:
    """An organ in scene units, the vertices of its surface first.

    Attributes:
        placed: The organ.
        material: What it is made of.
        nodes: (N, 3) at rest [u].
        tetrahedra: (M, 4) indices of nodes.
        masses: (N,) of the nodes, as with the engine "tissue" [kg].
        young_modulus: Young's modulus [kg/(u s2)].
        viscous_time: Viscosity divided by shear modulus [s].
        frequency: Greatest angular frequency of small motions [1/s].
        wave_speed: Speed of a shear wave [u/s].
    """

    placed: PlacedOrgan
    material: Material
    nodes: FloatArray
    tetrahedra: Int32Array
    masses: FloatArray
    young_modulus: float
    viscous_time: float
    frequency: float
    wave_speed: float

    @classmethod
    def of(cls, placed: PlacedOrgan, scale: Scale) -> FlexOrgan:
        """Fill an organ with tetrahedra, in a scene with that scale.

        Raises:
            ImportError: If the organ is not one of the presets' and Netgen is not installed; says what to install.
            ValueError: If MuJoCo has no counterpart of its material, or it cannot be filled.
        """
        material = UNSTATED if placed.material is None else placed.material
        check_material(material, placed.organ.name)
        mesh = fill_organ(placed.organ)
        solid = Solid(place_nodes(mesh.nodes, placed), mesh.tetrahedra)
        masses = material.density * scale.length**3 / scale.mass * solid.masses
        shear, lame = material.shear_modulus / scale.pressure, material.lame_parameter / scale.pressure
        return cls(
            placed=placed,
            material=material,
            nodes=solid.nodes,
            tetrahedra=mesh.tetrahedra,
            masses=masses,
            young_modulus=material.young_modulus / scale.pressure,
            viscous_time=material.viscosity / material.shear_modulus,
            frequency=math.sqrt(UNDERESTIMATE * greatest_eigenvalue(solid.nodes, mesh.tetrahedra, masses, shear, lame)),
            wave_speed=math.sqrt(shear * float(solid.volumes.sum() / masses.sum())),
        )

    @property
    def fixed(self) -> BoolArray:
        """(N,) which nodes do not move."""
        fixed = np.zeros(len(self.nodes), dtype=np.bool_)
        fixed[list(self.placed.fixed_nodes)] = True
        return fixed

    def substeps(self, dt: float) -> int:
        """Number of substeps in a step."""
        return math.ceil(dt / float(longest_substep(np.array(self.frequency**2), self.viscous_time)))


def check_material(material: Material, organ: str) -> None:
    """Check that a flex can be of a material.

    Args:
        material: The material.
        organ: Name of the organ, for the error.

    Raises:
        ValueError: If it is of another model than "neo_hookean", relaxes, or hardly changes its volume.
    """
    allowed = f"of organ {organ!r} with engine 'mujoco'"
    if material.model != "neo_hookean":
        raise ValueError(f"model of the material {allowed} must be 'neo_hookean', got {material.model!r}")
    if material.relaxation:
        raise ValueError(f"relaxation of the material {allowed} must be empty, got {material.relaxation!r}")
    if material.poisson_ratio > GREATEST_RATIO:
        raise ValueError(
            f"poisson_ratio of the material {allowed} must be at most {GREATEST_RATIO:g}, because linear tetrahedra "
            f"lock, got {material.poisson_ratio:g}"
        )


def greatest_eigenvalue(
    nodes: FloatArray, tetrahedra: Int32Array, masses: FloatArray, shear: float, lame: float
) -> float:
    """The greatest squared angular frequency of small motions, found by power iteration, from below [1/s2].

    Args:
        nodes: (N, 3) at rest [u].
        tetrahedra: (M, 4) indices of nodes.
        masses: (N,) of the nodes [kg].
        shear: Shear modulus [kg/(u s2)].
        lame: Lamé's first parameter [kg/(u s2)].
    """
    corners = nodes[tetrahedra]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    volumes, inverses = np.linalg.det(edges) / 6.0, np.linalg.inv(edges)
    gradients = np.concatenate([-inverses.sum(axis=1, keepdims=True), inverses], axis=1)
    # A fixed starting vector, so that the result is deterministic.
    shape, value = np.cos(np.arange(3.0 * len(nodes)) ** 2).reshape(-1, 3), 0.0
    for _ in range(POWER_STEPS):
        strains = np.einsum("mai,maj->mij", shape[tetrahedra], gradients)
        stresses = shear * (strains + np.swapaxes(strains, 1, 2))
        stresses += lame * np.trace(strains, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        pulls = np.einsum("mij,maj->mai", stresses * volumes[:, None, None], gradients)
        forces = [np.bincount(tetrahedra.ravel(), pulls[:, :, axis].ravel(), len(nodes)) for axis in range(3)]
        shape = np.stack(forces, axis=1) / masses[:, None]
        value = float(np.sqrt((shape**2).sum()))
        shape /= value
    return value
