"""The scene's tools as bodies in MuJoCo's world, for contact by MuJoCo itself: `contact="mujoco"`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.geometry.transforms import rotate

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray
    from spatula_env.scenes import PlacedTool, Scene

TOOL_TO_ORGAN_MASS = 1e6
"""Mass of a tool in organ masses, and its inertia in the same by the square of a unit: contact hardly moves it then."""

ORGAN_GROUP, TOOL_GROUP = 2, 1
"""MuJoCo's contact groups: organs touch tools and organs, tools touch organs alone."""

STIFFEST = (2.0, 1.0)
"""Time constant [steps] and damping ratio of MuJoCo's soft contact, the stiffest that it allows. With its usual
time of 0.02 s, the seed's spatula, pressed down at 5 u/s and held, has got through the organ after half a second."""

RADIUS = 0.005
"""Thickness of the organ's skin, MuJoCo's usual one [u]."""

PARKING = 1e4
"""Where tools are while nothing shall be touched [u]."""

COORDINATES, VELOCITIES = 7, 6
"""What MuJoCo has for a free body: position and quaternion wxyz; linear velocity, and angular in the body's frame."""


def add_tools(mujoco: Any, spec: Any, scene: Scene) -> None:
    """Add free bodies, far heavier than the organs, to a model that has the organs already.

    MuJoCo collides the convex hull of a tool that is no box.
    """
    mass = TOOL_TO_ORGAN_MASS * sum(placed.mass for placed in scene.organs)
    for index, placed in enumerate(scene.tools):
        body = spec.worldbody.add_body(
            name=f"tool {index}", mass=mass, ipos=[0.0] * 3, inertia=[mass] * 3, explicitinertial=True
        )
        body.add_freejoint()
        geom = body.add_geom(
            contype=TOOL_GROUP,
            conaffinity=0,
            condim=3,
            # What counts where two disagree.
            priority=1,
            friction=[placed.friction, 0.0, 0.0],
            solref=[STIFFEST[0] * scene.dt, STIFFEST[1]],
        )
        half, vertices = 0.5 * placed.tool.size, placed.tool.vertices
        if len(vertices) == 8 and np.allclose(np.abs(vertices), half, rtol=0.0, atol=1e-12):
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_BOX, half
        else:
            # The mesh is moved to its centre of mass and turned to its axes, and the geom that shows it moves it back.
            spec.add_mesh(name=f"tool {index}", uservert=vertices.ravel().tolist())
            geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, f"tool {index}"


class FlexTools:
    """Poses, velocities and loads of the tools of a world; tools are the last bodies of its model."""

    def __init__(self, model: Any, data: Any, tools: tuple[PlacedTool, ...], gravity: float) -> None:
        """Look at a state.

        Args:
            model: MuJoCo's `MjModel`.
            data: MuJoCo's `MjData`; written.
            tools: The tools.
            gravity: Downward acceleration [u/s2].
        """
        count = len(tools)
        self._dt, self._gravity = float(model.opt.timestep), np.array([0.0, 0.0, -gravity])
        self._coordinates = data.qpos[len(data.qpos) - COORDINATES * count :].reshape(count, COORDINATES)
        first = len(data.qvel) - VELOCITIES * count
        self._velocities = data.qvel[first:].reshape(count, VELOCITIES)
        self._forces = data.qfrc_constraint[first:].reshape(count, VELOCITIES)
        self._orientations = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
        self.park()

    def place(self, positions: FloatArray, orientations: FloatArray) -> None:
        """Set the poses of the tools, at rest: positions (N, 3) [u] and orientations (N, 4) xyzw."""
        self._coordinates[:, :3], self._coordinates[:, 3:] = positions, np.roll(orientations, 1, axis=1)
        self._orientations, self._velocities[:] = np.array(orientations), 0.0

    def move(self, positions: FloatArray, orientations: FloatArray, linear: FloatArray, angular: FloatArray) -> None:
        """Give the tools the poses of the end of the coming step, and their velocities; see `CollidingEngine`."""
        self.place(positions, orientations)
        # Gravity acts on tools too; the velocity that it will add is subtracted beforehand.
        self._velocities[:, :3] = linear - self._gravity * self._dt
        for row, (orientation, rate) in enumerate(zip(orientations, angular, strict=True)):
            self._velocities[row, 3:] = rotate(orientation * [-1.0, -1.0, -1.0, 1.0], rate)

    def park(self) -> None:
        """Put the tools where they touch nothing."""
        self._coordinates[:] = [0.0, 0.0, PARKING, 1.0, 0.0, 0.0, 0.0]
        self._coordinates[:, 0] = PARKING * np.arange(len(self._coordinates))
        self._velocities[:] = 0.0

    def impulses(self) -> FloatArray:
        """(N, 6) linear [kg u/s] and angular [kg u2/s2] impulses that contacts gave the tools in the last step."""
        impulses: FloatArray = self._dt * self._forces
        for row, orientation in enumerate(self._orientations):
            impulses[row, 3:] = rotate(orientation, impulses[row, 3:])
        return impulses


@contextmanager
def silent(mujoco: Any) -> Iterator[None]:
    """Let MuJoCo write no warnings, which it does into a file of the folder that one is in."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
