"""Conversion between scene units and the workspace frame in SI units, world by world."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry.rotations import conjugate, from_rotation_vector, multiply, turn

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.arrays import FloatArray, IntArray
    from spatula_env.envs.workspace import Workspace
    from spatula_env.scenes import Scale


class Frames:
    """The workspace frame of each of W worlds, and its units.

    A world's organ can be shifted, turned, larger or stiffer than others although all worlds compute the same scene:
    only workspace and units differ. Pressures keep their unit when an organ is larger, so that its material stays the
    same; they scale with the stiffness, as the density does.

    Attributes:
        length: (W,) metres in a scene unit of length.
        force: (W,) newtons in a scene unit of force.
        torque: (W,) newton-metres in a scene unit of torque.
        pressure: (W,) pascals in a scene unit of pressure.
    """

    def __init__(self, workspace: Workspace, scale: Scale, anchor: ArrayLike, count: int) -> None:
        """Start with all worlds alike.

        Args:
            workspace: The workspace without any shift.
            scale: Scale of the scene.
            anchor: (3,) point about which organs are turned and scaled [u].
            count: Number of worlds, W.
        """
        self._workspace, self._scale = workspace, scale
        self._anchor = np.array(anchor, dtype=np.float64)
        self._center = np.tile(np.array(workspace.center, dtype=np.float64), (count, 1))
        self._turn = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
        self._turned = 0
        self.length = np.full(count, scale.length)
        self.force = np.full(count, scale.force)
        self.torque = np.full(count, scale.torque)
        self.pressure = np.full(count, scale.pressure)

    def set(
        self,
        worlds: IntArray,
        *,
        shift: ArrayLike = 0.0,
        yaw: ArrayLike = 0.0,
        size: ArrayLike = 1.0,
        stiffness: ArrayLike = 1.0,
    ) -> None:
        """Set how the organs of some worlds differ from the scene's.

        Args:
            worlds: (n,) distinct indices of the worlds.
            shift: (n, 2) shift along x and y [m].
            yaw: (n,) rotation about the vertical [rad].
            size: (n,) factor on lengths.
            stiffness: (n,) factor on stiffness and density.
        """
        count = len(worlds)
        factor = np.broadcast_to(np.asarray(size, dtype=np.float64), (count,))
        stiff = np.broadcast_to(np.asarray(stiffness, dtype=np.float64), (count,))
        vector = np.zeros((count, 3))
        vector[:, 2] = yaw
        rotation = from_rotation_vector(vector)
        self._turned -= int(np.count_nonzero(self._turn[worlds, 2]))
        self._turn[worlds] = rotation
        self._turned += int(np.count_nonzero(rotation[:, 2]))
        self.length[worlds] = length = self._scale.length * factor
        anchor = np.zeros((count, 3))
        anchor[:] = (self._anchor - self._workspace.center) * self._scale.length
        anchor[:, :2] += np.asarray(shift, dtype=np.float64)
        self._center[worlds] = self._anchor - turn(conjugate(rotation), anchor) / length[:, None]
        self.pressure[worlds] = pressure = self._scale.pressure * stiff
        self.force[worlds] = pressure * length**2
        self.torque[worlds] = pressure * length**3

    def rows(self, worlds: IntArray) -> Frames:
        """Copy the frames of some distinct worlds (n,); changes of the copy have no effect here."""
        some = copy.copy(self)
        for name in ("_center", "_turn", "length", "force", "torque", "pressure"):
            setattr(some, name, getattr(self, name)[worlds])
        some._turned = int(np.count_nonzero(some._turn[:, 2]))
        return some

    def points_from_scene(self, points: FloatArray, worlds: IntArray) -> FloatArray:
        """Convert points (n, ..., 3) of the scene [u] to the workspace frames of worlds (n,) [m]."""
        return self._out(points - _fit(self._center[worlds], points), worlds) * _fit(self.length[worlds, None], points)

    def points_to_scene(self, points: FloatArray, worlds: IntArray) -> FloatArray:
        """Convert points (n, ..., 3) in the workspace frames of worlds (n,) [m] to the scene [u]."""
        return self._in(points / _fit(self.length[worlds, None], points), worlds) + _fit(self._center[worlds], points)

    def velocities_to_scene(self, velocities: FloatArray) -> FloatArray:
        """Convert velocities (W, N, 3) in the workspace frames [m/s] to the scene [u/s]."""
        return self._in(velocities / self.length[:, None, None], np.arange(len(self.length)))

    def rates_to_scene(self, rates: FloatArray) -> FloatArray:
        """Convert rates of rotation (W, N, 3) in the workspace frames to the scene [rad/s]."""
        return self._in(rates, np.arange(len(self.length)))

    def vectors_from_scene(self, vectors: FloatArray, unit: FloatArray) -> FloatArray:
        """Convert vectors (W, N, 3) of the scene to the workspace frames, with a unit (W,)."""
        return self._out(vectors * unit[:, None, None], np.arange(len(self.length)))

    def orientations_from_scene(self, orientations: FloatArray, worlds: IntArray) -> FloatArray:
        """Convert quaternions (n, N, 4) of the scene to the workspace frames of worlds (n,)."""
        return multiply(self._turn[worlds, None], orientations) if self._turned else orientations

    def orientations_to_scene(self, orientations: FloatArray, worlds: IntArray) -> FloatArray:
        """Convert quaternions (n, N, 4) in the workspace frames of worlds (n,) to the scene."""
        return multiply(conjugate(self._turn[worlds, None]), orientations) if self._turned else orientations

    def _out(self, vectors: FloatArray, worlds: IntArray) -> FloatArray:
        return turn(_fit(self._turn[worlds], vectors), vectors) if self._turned else vectors

    def _in(self, vectors: FloatArray, worlds: IntArray) -> FloatArray:
        return turn(_fit(conjugate(self._turn[worlds]), vectors), vectors) if self._turned else vectors


def _fit(values: FloatArray, like: FloatArray) -> FloatArray:
    """Add axes to values (n, k), giving (n, 1, ..., k) with as many axes as `like`."""
    return values.reshape(len(values), *(1,) * (like.ndim - 2), values.shape[1])
