"""What the tool feels, from every physics step of an environment, and where it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from spatula_env.teleop.device import FloatArray

if TYPE_CHECKING:
    import gymnasium

    from spatula_env.envs.control import VelocityControl
    from spatula_env.envs.listening import PhysicsStep

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
        self._env = made
        self._stop: Callable[[], None] | None = None
        self.control: VelocityControl = made.control
        self.time_step = made.simulation.dt
        self.period = made.steps_per_action * made.simulation.dt

    def grip(self) -> FloatArray:
        """(3,) where the grip is now, workspace frame [m]."""
        return self._env.grip

    def install(self, after_step: AfterStep) -> None:
        """Have something called after every physics step, until `remove`.

        Args:
            after_step: What; an exception of it ends the control step.
        """

        def tell(step: PhysicsStep) -> None:
            after_step(step.grip, step.force)

        self.remove()
        self._stop = self._env.listen(tell)

    def remove(self) -> None:
        """Call nothing any more. Removing twice is allowed."""
        if self._stop is not None:
            self._stop()
            self._stop = None
