"""Between a hand and an environment's physics steps: how the tool is to move, what it feels, and where it is."""

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
    """Reaches into a `SpatulaEnv` between its physics steps.

    Attributes:
        control: What an action means.
        steps: How many physics steps make a control step.
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
        self._stops: list[Callable[[], None]] = []
        self.steps = made.steps_per_action
        self.control: VelocityControl = made.control
        self.time_step = made.simulation.dt
        self.period = made.steps_per_action * made.simulation.dt

    def grip(self) -> FloatArray:
        """(3,) where the grip is now, workspace frame [m]."""
        return self._env.grip

    def reach(self) -> tuple[FloatArray, FloatArray]:
        """Two corners (3,) of where the grip can be, workspace frame [m]."""
        return self._env.reach

    def install(self, after_step: AfterStep, pilot: Pilot | None = None) -> None:
        """Have something called around every physics step, until `remove`. An exception of it ends the control step.

        Args:
            after_step: What is called after it.
            pilot: Who steers the tool in it; None: what the environment's `step` is given.
        """

        def tell(step: PhysicsStep) -> None:
            after_step(step.grip, step.force)

        self.remove()
        self._stops.append(self._env.listen(tell))
        if pilot is not None:
            self._stops.append(self._env.steer(pilot))

    def remove(self) -> None:
        """Call nothing any more. Removing twice is allowed."""
        while self._stops:
            self._stops.pop()()
