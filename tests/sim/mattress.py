"""A custom engine: every node hangs on a spring of its own, like those of a mattress, which creeps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.scenes import Scene
from spatula_env.sim.engine import Abilities, EngineOptions

FloatArray = NDArray[np.float64]

STIFFNESS, DAMPING, CREEP = 4000.0, 60.0, 0.5
"""Stiffness [1/s2] and damping [1/s] of a spring, per mass of its node; and rate of its creep, per stretch [1/s]."""


class MattressEngine:
    """W mattresses; the anchors of the springs are their internal state."""

    abilities = Abilities()

    def __init__(self, scene: Scene, worlds: int, options: EngineOptions) -> None:
        assert options.contact in self.abilities.contacts
        self._dt, self._gravity = scene.dt, np.array([0.0, 0.0, -scene.gravity])
        vertices = np.concatenate([placed.vertices for placed in scene.organs])
        masses = [np.full(len(p.organ.vertices), p.mass / len(p.organ.vertices)) for p in scene.organs]
        self._inverse_masses = np.repeat(1.0 / np.concatenate(masses)[None], worlds, axis=0)
        self._shape = vertices
        self._anchors = np.repeat(vertices[None], worlds, axis=0)
        self.closed = False

    @property
    def inverse_masses(self) -> FloatArray:
        return self._inverse_masses

    def advance(self, positions: FloatArray, velocities: FloatArray, diverged: NDArray[np.bool_]) -> None:
        dt, go = self._dt, ~diverged
        pull = STIFFNESS * (self._anchors[go] - positions[go]) + self._gravity
        velocities[go] = (velocities[go] + dt * pull) / (1.0 + dt * DAMPING + dt**2 * STIFFNESS)
        positions[go] += dt * velocities[go]
        self._anchors[go] += dt * CREEP * (positions[go] - self._anchors[go] - self._gravity / STIFFNESS)
        diverged |= ~np.isfinite(positions).all(axis=(1, 2))

    def halt(self, positions: FloatArray, worlds: NDArray[np.int64]) -> None:
        """Anchors have no velocity."""

    def save(self, worlds: NDArray[np.int64]) -> tuple[Any, ...]:
        return tuple(self._anchors[worlds])

    def restore(
        self, positions: FloatArray, velocities: FloatArray, inner: Sequence[Any], worlds: NDArray[np.int64]
    ) -> None:
        for w, anchors in zip(worlds.tolist(), inner, strict=True):
            self._anchors[w] = self._shape if anchors is None else anchors

    def close(self) -> None:
        self.closed = True
