"""What environments for one agent and for many have in common besides their episodes."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from spatula_env.envs.time_limit import read_step_limit
from spatula_env.tasks.plain import as_recorded

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec

    from spatula_env.envs.control import VelocityControl
    from spatula_env.envs.episodes import Episodes
    from spatula_env.envs.observations import ObservationBuilder
    from spatula_env.envs.settings import Definition, EnvSettings
    from spatula_env.envs.workspace import Workspace
    from spatula_env.tasks.base import Task


class EpisodesEnv:
    """What environments for one agent and for many tell of their episodes.

    Attributes:
        definition: Scene and task; subclasses with an id have one.
    """

    definition: ClassVar[Definition]
    __signature__: ClassVar[inspect.Signature]
    _gymnasium_class: ClassVar[type[Any]]
    _episodes: Episodes
    settings: EnvSettings
    _spec: EnvSpec | None = None
    _step_limit: int | None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Make Gymnasium's class a direct base of every subclass: libraries look there for what an environment is."""
        super().__init_subclass__(**kwargs)
        kind = getattr(cls, "_gymnasium_class", None)
        if kind is not None and kind not in cls.__bases__:
            cls.__bases__ = (*cls.__bases__, kind)

    # A property, for Gymnasium's class attribute: what is recorded is to be written to a file and compared.
    @property
    def spec(self) -> EnvSpec | None:
        """How the environment was made, in Python's own numbers, lists and names, and when its episodes are cut.

        It names the engine, whose default is another one where PyBullet is missing.
        """
        return self._spec

    @spec.setter
    def spec(self, value: EnvSpec | None) -> None:
        if value is not None:
            kwargs = {**as_recorded(value.kwargs), "engine": self.settings.engine}
            if "episode_time" in kwargs:
                # None where a number of steps was told.
                kwargs["episode_time"] = self.settings.episode_time
            value = replace(value, kwargs=kwargs, max_episode_steps=self._max_episode_steps)
        self._spec = value

    @property
    def _max_episode_steps(self) -> int | None:
        """After how many control steps episodes are cut, under the name that Gymnasium's `TimeLimit` has for it."""
        return self._step_limit

    @_max_episode_steps.setter
    def _max_episode_steps(self, value: int | None) -> None:
        self._step_limit = read_step_limit(value)

    @property
    def workspace(self) -> Workspace:
        """The cube that the grip is kept in."""
        return self._episodes.workspace

    @property
    def task(self) -> Task:
        """What is asked."""
        return self._episodes.task

    @property
    def task_description(self) -> str:
        """What is asked, as a sentence that instructs; for policies that read one."""
        return self.task.description or f"Solve the task {self.definition.name}."

    @property
    def control(self) -> VelocityControl:
        """What an action means."""
        return self._episodes.control

    @property
    def observation_builder(self) -> ObservationBuilder:
        """How observations are laid out."""
        return self._episodes.observation_builder

    @property
    def steps_per_action(self) -> int:
        """Physics steps in a control step."""
        return self._episodes.steps_per_action

    @property
    def compute_reward(self) -> Callable[[NDArray[Any], NDArray[Any], Any], NDArray[np.float32]]:
        """The sparse reward of goals, for hindsight replay: of (achieved_goal, desired_goal, info).

        Goals are (..., G) and the result is (...); `info` is not looked at. There is no such attribute with
        `reward="dense"`, because libraries tell by it which environments have the goal interface.
        """
        if self._episodes.settings.reward != "sparse":
            raise AttributeError("compute_reward needs the goal interface: make the environment with reward='sparse'")
        task = self.task

        def compute(achieved: NDArray[Any], desired: NDArray[Any], info: Any) -> NDArray[np.float32]:
            return task.compute_reward(achieved, desired)

        return compute
