"""What the tool feels, from every physics step of an environment, and where it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.teleop.device import FloatArray

if TYPE_CHECKING:
    import gymnasium

    from spatula_env.envs.control import VelocityControl

AfterStep = Callable[[FloatArray, FloatArray], None]
"""Takes the grip (3,) in the workspace frame [m] and the force (3,) of the organ on the tools [N]."""


class EnvironmentTap:
    """Looks into a `SpatulaEnv` between its physics steps.

    Attributes:
        control: What an action means.
        period: Length of a control step [s].
        time_step: Length of a physics step [s].
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        """Find the environment below all wrappers.

        Args:
            env: An environment for one agent.

        Raises:
            TypeError: If it is none of this package.
        """
        # Imported here: a device alone needs no physics.
        from spatula_env.envs.spatula_env import SpatulaEnv

        made = env.unwrapped
        if not isinstance(made, SpatulaEnv):
            raise TypeError(f"env must be one of the Spatula environments for one agent, got {env}")
        self._simulation = made.simulation
        self._frames = made._episodes.frames
        self._first = np.zeros(1, dtype=np.int64)
        self.control: VelocityControl = made.control
        self.time_step = made.simulation.dt
        self.period = made.steps_per_action * made.simulation.dt

    def grip(self) -> FloatArray:
        """(3,) where the grip is now, workspace frame [m]."""
        points = self._frames.points_from_scene(self._simulation.tool_positions[None], self._first)
        return np.asarray(points[0].mean(axis=0))

    def install(self, after_step: AfterStep) -> None:
        """Have something called after every physics step, until `remove`.

        Args:
            after_step: What; an exception of it ends the control step.
        """
        # The class's own method: a tap replaces the one before it.
        step = type(self._simulation).step.__get__(self._simulation)

        def tapped(*arguments: Any, **keywords: Any) -> Any:
            report = step(*arguments, **keywords)
            force = report.loads[:, :3].sum(axis=0)
            after_step(self.grip(), self._frames.vectors_from_scene(force[None, None], self._frames.force)[0, 0])
            return report

        # Before the class's own, until `remove`.
        vars(self._simulation)["step"] = tapped

    def remove(self) -> None:
        """Call nothing any more. Removing twice is allowed."""
        vars(self._simulation).pop("step", None)
