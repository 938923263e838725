"""Presses of the seed's sphere with the engines "mujoco" and "tissue", and with linear tetrahedra in NumPy.

The engine of this module has what MuJoCo is said to have: linear tetrahedra with strains of their own, of the energy of
`scenes.Material`, damped in proportion to their stiffness. Masses, substeps and how contact holds nodes between steps
are those of the engine "mujoco". What it adds is forces, from `Hyperelastic`'s stress.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env import engines, scenes
from spatula_env.geometry import Organ
from spatula_env.scenes import Material, PlacedOrgan, Scene
from spatula_env.sim.engine import Abilities, EngineOptions
from spatula_env.sim.mujoco.flex import FlexOrgan
from spatula_env.sim.mujoco.held import Held
from spatula_env.sim.tissue.hyperelastic import Hyperelastic
from spatula_env.sim.worlds import Worlds

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray, IntArray

LINEAR = "linear"
"""Name of this module's engine while it is registered."""

HELD_HEIGHT = 1.0
"""Nodes up to this height above the sphere's lowest are held [u]."""

APPROACH, SETTLE, MEASURE = 1.0, 0.5, 0.1
"""Duration of a press, of the wait after it, and of the time over which the force is averaged [s]."""


class LinearEngine:
    """Linear tetrahedra in NumPy, for one world and one organ."""

    abilities = Abilities(materials=True)

    def __init__(self, scene: Scene, worlds: int, options: EngineOptions) -> None:
        """See `engine.Engine`."""
        (placed,) = scene.organs
        self.organ = organ = FlexOrgan.of(placed, scene.scale)
        self._dt, self._gravity, self._count = scene.dt, scene.gravity, organ.substeps(scene.dt)
        self._law, self._moves = Hyperelastic.of(organ.material, scene.scale.pressure), ~organ.fixed
        corners = organ.nodes[organ.tetrahedra]
        edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
        inverses = np.linalg.inv(edges)
        self._volumes = np.linalg.det(edges) / 6.0
        self._gradients = np.concatenate([-inverses.sum(axis=1, keepdims=True), inverses], axis=1)
        self.positions, self.velocities = organ.nodes.copy(), np.zeros_like(organ.nodes)
        self._surface = slice(len(placed.organ.vertices))
        self._held = Held.zeros(len(placed.organ.vertices))

    @property
    def inverse_masses(self) -> FloatArray:
        """See `engine.Engine`."""
        return np.where(self._moves, 1.0 / self.organ.masses, 0.0)[None, self._surface]

    def forces(self, positions: FloatArray) -> FloatArray:
        """(N, 3) forces on the nodes at positions (N, 3) [kg u/s2]."""
        corners = self.organ.tetrahedra
        stresses = self._law.stress(np.einsum("mai,maj->mij", positions[corners], self._gradients))
        pulls = -np.einsum("mij,maj->mai", stresses * self._volumes[:, None, None], self._gradients)
        sums = [np.bincount(corners.ravel(), pulls[:, :, axis].ravel(), len(positions)) for axis in range(3)]
        return np.stack(sums, axis=1)

    def advance(self, positions: FloatArray, velocities: FloatArray, diverged: BoolArray) -> None:
        """See `engine.Engine`."""
        nodes, moving, length = self.positions[self._surface], self.velocities[self._surface], self._dt / self._count
        nodes[:], moving[:] = positions[0], velocities[0]
        directions = self._held.take_contact(nodes, moving, self._dt)
        for _ in range(self._count):
            before = moving.copy()
            leading = self.positions + self.organ.viscous_time * self.velocities
            gains = length * self.forces(leading) / self.organ.masses[:, None] - [0.0, 0.0, length * self._gravity]
            self.velocities += gains * self._moves[:, None]
            self.positions += length * self.velocities
            self._held.hold(directions, before, nodes, moving, length, 1.0 / self._count)
        self._held.give_free(nodes, moving, self._dt)
        positions[0], velocities[0] = nodes, moving
        diverged |= not np.isfinite(self.positions).all()

    def halt(self, positions: FloatArray, worlds: IntArray) -> None:
        """See `engine.Engine`."""
        if len(worlds):
            self.velocities[:] = self._held.free_velocities[:] = 0.0

    def save(self, worlds: IntArray) -> tuple[Any, ...]:
        """See `engine.Engine`."""
        return (None,) * len(worlds)

    def restore(self, positions: FloatArray, velocities: FloatArray, inner: Sequence[Any], worlds: IntArray) -> None:
        """See `engine.Engine`; inner nodes are put where they are at rest."""
        self.positions[:], self.velocities[:] = self.organ.nodes, 0.0
        self.positions[self._surface], self.velocities[self._surface] = positions[0], velocities[0]
        self._held = Held.zeros(len(positions[0]))

    def close(self) -> None:
        """See `engine.Engine`: there is nothing to free."""


@contextmanager
def linear_engine() -> Iterator[str]:
    """The name of `LinearEngine`, which is registered in the meantime."""
    engines.register_engine(LINEAR, f"{__name__}:LinearEngine")
    try:
        yield LINEAR
    finally:
        del engines.ENGINES[LINEAR]


@dataclass(frozen=True)
class Press:
    """A sphere that a spatula has been pressed into, at rest.

    Attributes:
        force: Mean force on the spatula [N].
        ripple: Standard deviation of the force over the time of averaging, by the mean.
        moved: (V, 3) displacements of the nodes [u].
    """

    force: float
    ripple: float
    moved: FloatArray

    def differs(self, expected: Press) -> tuple[float, float]:
        """Difference of the force, and of the node that differs most by the greatest displacement."""
        greatest = np.linalg.norm(expected.moved, axis=1).max()
        apart = np.linalg.norm(self.moved - expected.moved, axis=1).max()
        return abs(self.force / expected.force - 1.0), float(apart / greatest)


def held_sphere(material: Material, organ: Organ | None = None) -> Scene:
    """The seed's scene with its sphere, or another organ there, held at its base, without ground and weight.

    Args:
        material: The material.
        organ: A sphere of the same size; None: the seed's.
    """
    scene = scenes.seed(material=material)
    placed = scene.organs[0] if organ is None else PlacedOrgan(organ, scene.organs[0].position, material=material)
    heights = placed.vertices[:, 2]
    base = tuple(np.flatnonzero(heights < heights.min() + HELD_HEIGHT).tolist())
    return replace(scene, organs=(replace(placed, fixed_nodes=base),), gravity=0.0, ground=None)


def press(scene: Scene, engine: str, depth: float, approach: float = APPROACH, settle: float = SETTLE) -> Press:
    """Press the spatula into a sphere from above, by a smooth motion, and wait.

    Args:
        scene: See `held_sphere`.
        engine: The engine, which integrates in double precision.
        depth: How far below the sphere's highest node [u].
        approach: Duration of the motion [s].
        settle: Duration of the wait [s].
    """
    worlds = Worlds(scene, 1, engine=engine, precision="double", parallel=False)
    before = worlds.nodes[0]
    half = 0.5 * float(np.ptp(scene.tools[0].tool.vertices[:, 2]))
    worlds.place_tools(np.array([[[0.0, 0.0, before[:, 2].max() + half]]]))
    steps, still = round(approach / scene.dt), np.zeros((1, 1, 3))
    for step in range(steps):
        part = (1.0 - math.cos(2.0 * math.pi * (step + 0.5) / steps)) / (steps * scene.dt)
        worlds.advance(np.array([[[0.0, 0.0, -depth * part]]]))
    worlds.advance(still, steps=round(settle / scene.dt))
    forces = [worlds.advance(still).forces[0, 0, 2] * scene.scale.force for _ in range(round(MEASURE / scene.dt))]
    moved = worlds.nodes[0] - before
    worlds.close()
    return Press(float(np.mean(forces)), float(np.std(forces) / np.mean(forces)), moved)
