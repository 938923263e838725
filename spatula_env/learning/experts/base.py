"""Base of scripted policies: reads observations by the names of their parts, single or in batches."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray
from spatula_env.envs.observations import GOAL_ENTRIES

if TYPE_CHECKING:
    import gymnasium


class Expert(ABC):
    """A memoryless policy: the action depends on the observation only, which is the same as an agent's.

    Attributes:
        task: Name of the task it solves, as in the environment's `Definition`.
        max_speed: Greatest speed of the grip along each axis [m/s].
        max_rotation_rate: Greatest rate of rotation of the tools about each axis [rad/s].
        max_jaw_speed: Greatest speed of the jaws [m/s].
        names: Names of the action's components.
        late: Whether actions or observations may be late, so that quick regulation would overshoot.
    """

    task: ClassVar[str]

    def __init__(self, env: gymnasium.Env[Any, Any] | gymnasium.vector.VectorEnv[Any, Any, Any]) -> None:
        """Read the layout of an environment's observations and actions.

        Args:
            env: Environment of the task, for one agent or many, wrapped or not, in the mode "state" or "dict", with all
                parts and any reward, noise, delay and history.

        Raises:
            ValueError: If it is none of these.
        """
        made: Any = env.unwrapped
        definition = getattr(made, "definition", None)
        if definition is None or definition.name != self.task:
            raise ValueError(f"env must be a {self.task} environment, got {env}")
        if made.settings.obs_mode not in ("state", "dict"):
            raise ValueError(f"env must have obs_mode 'state' or 'dict', got {made.settings.obs_mode!r}")
        if made.settings.observation.parts != "all":
            raise ValueError(f"env must have observation.parts 'all', got {made.settings.observation.parts!r}")
        self._slices = made.observation_builder.slices
        self._stacked = made.settings.observation.history > 1
        greatest_delay = made.settings.randomization.get("action_delay", (0.0, 0.0))[1]
        self.late: bool = max(greatest_delay, made.settings.observation.delay) > 0.0
        control = made.control
        self.max_speed, self.max_rotation_rate = control.max_speed, control.max_rotation_rate
        self.max_jaw_speed, self.names = control.max_jaw_speed, control.names

    @abstractmethod
    def velocities(self, observation: Any) -> Mapping[str, FloatArray]:
        """Velocities in SI units, (...) each, by names of action components; components that are left out are zero.

        Args:
            observation: An observation or a batch; read it with `part`, `goal` and `error`.
        """

    def __call__(self, observation: Any) -> NDArray[np.float32]:
        """The action (A,) for an observation, or the actions (W, A) for those of W worlds."""
        wanted = self.velocities(observation)
        unknown = set(wanted) - set(self.names)
        if unknown:
            raise ValueError(f"actions have no {', '.join(sorted(unknown))}; there are {', '.join(self.names)}")
        shape = self.part(observation, "tool_position").shape[:-1]
        columns = [np.broadcast_to(wanted.get(name, 0.0) / self._greatest(name), shape) for name in self.names]
        return np.asarray(np.clip(np.stack(columns, axis=-1), -1.0, 1.0), dtype=np.float32)

    def part(self, observation: Any, name: str) -> FloatArray:
        """A part (..., k) of one or many observations; the newest if several are stacked."""
        if isinstance(observation, Mapping) and name in observation:
            values = np.asarray(observation[name], dtype=np.float64)
        else:
            whole = observation["observation"] if isinstance(observation, Mapping) else observation
            values = np.asarray(whole, dtype=np.float64)[..., self._slices[name]]
        return values[..., -1, :] if self._stacked and name not in GOAL_ENTRIES else values

    def has_part(self, name: str) -> bool:
        """Whether observations have a part of this name."""
        return name in self._slices

    def goal(self, observation: Any) -> FloatArray:
        """The goal (..., G), for any reward."""
        sparse = isinstance(observation, Mapping) and "desired_goal" in observation
        return self.part(observation, "desired_goal" if sparse else "goal")

    def error(self, observation: Any) -> FloatArray:
        """The goal minus what has been achieved (..., G), for any reward."""
        if isinstance(observation, Mapping) and "desired_goal" in observation:
            return self.part(observation, "desired_goal") - self.part(observation, "achieved_goal")
        return self.part(observation, "error")

    def _greatest(self, name: str) -> float:
        if name.startswith("rotation"):
            return float(self.max_rotation_rate)
        return float(self.max_jaw_speed if name.startswith("jaw") else self.max_speed)
