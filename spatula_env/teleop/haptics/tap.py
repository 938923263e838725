"""Access to an environment between its physics steps: steers the tool, and reads its force and position."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from spatula_env.teleop.device import FloatArray

if TYPE_CHECKING:
    import gymnasium

    from spatula_env.envs.control import VelocityControl
    from spatula_env.envs.physics_listener import PhysicsStep
    from spatula_env.envs.steering import Pilot

AfterStep = Callable[[FloatArray, FloatArray], None]
"""Takes the grip (3,) in the workspace frame [m] and the force (3,) of the organ on the tools [N]."""


class EnvironmentTap:
    """Hooks into a `SpatulaEnv` between its physics steps.

    Attributes:
        control: Meaning of the actions.
        steps: Number of physics steps per control step.
        period: Length of a control step [s].
        time_step: Length of a physics step [s].
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        """Find the environment below all wrappers.

        Args:
            env: An environment for one agent.

        Raises:
            TypeError: If it is not one of this package.
        """
        # Imported here because a device alone needs no physics.
        from spatula_env.envs.spatula_env import SpatulaEnv

        made = env.unwrapped
        if not isinstance(made, SpatulaEnv):
            raise TypeError(f"env must be one of the Spatula environments for one agent, got {env}")
        self._env = made
        self._stops: list[Callable[[], None]] = []
        self.steps = made.steps_per_action
        self.control: VelocityControl = made.control
        self.time_step = made.simulation.dt
        self.period = made.steps_per_action * made.simulation.dt

    def grip(self) -> FloatArray:
        """(3,) current position of the grip, workspace frame [m]."""
        return self._env.grip

    def reach(self) -> tuple[FloatArray, FloatArray]:
        """Two corners (3,) of the region that the grip can reach, workspace frame [m]."""
        return self._env.reach

    def install(self, after_step: AfterStep, pilot: Pilot | None = None) -> None:
        """Call functions around every physics step, until `remove`. An exception in one of them ends the control step.

        Args:
            after_step: Called after each physics step.
            pilot: Steers the tool in each physics step; None to use the action given to the environment's `step`.
        """

        def tell(step: PhysicsStep) -> None:
            after_step(step.grip, step.force)

        self.remove()
        self._stops.append(self._env.listen(tell))
        if pilot is not None:
            self._stops.append(self._env.steer(pilot))

    def remove(self) -> None:
        """Stop calling the functions. Removing twice is allowed."""
        while self._stops:
            self._stops.pop()()
