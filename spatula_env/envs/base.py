"""Common base of environments for one agent and of vector environments, apart from running their episodes."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from spatula_env.envs.incentives import check_horizon
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


COPIED = ("action_space", "observation_space", "single_action_space", "single_observation_space")
"""Attributes of which a copy has its own: spaces contain random generators for sampling."""


def _make_again(kind: type[Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    return kind(*args, **kwargs)


class EpisodesEnv:
    """Base of the environments for one agent and for many.

    Attributes:
        definition: Scene and task; set by subclasses that have an id.
        constructed_names: Names of attributes that are fixed on construction.
    """

    definition: ClassVar[Definition]
    __signature__: ClassVar[inspect.Signature]
    _gymnasium_class: ClassVar[type[Any]]
    _episodes: Episodes
    settings: EnvSettings
    constructed_names: frozenset[str]
    _made_with: tuple[tuple[Any, ...], dict[str, Any]]
    _spec: EnvSpec | None = None
    _step_limit: int | None
    _horizon: int | None

    def __new__(cls, *args: Any, **kwargs: Any) -> Any:
        """Store the arguments, with which copies are made."""
        made = super().__new__(cls)
        made._made_with = (copy.deepcopy(args), copy.deepcopy(kwargs))
        return made

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Make Gymnasium's class a direct base of every subclass, where libraries look for the kind of environment."""
        super().__init_subclass__(**kwargs)
        kind = getattr(cls, "_gymnasium_class", None)
        if kind is not None and kind not in cls.__bases__:
            cls.__bases__ = (*cls.__bases__, kind)

    def __reduce__(self) -> tuple[Any, ...]:
        """Support `copy.deepcopy` and `pickle`: a copy is a separate environment in exactly the same state.

        It is constructed with the same arguments and then set to this one's state, random generators included, so that
        what is drawn next is the same. It has no window and no listeners.
        """
        state = {name: value for name, value in vars(self).items() if name in self._copied_names()}
        return _make_again, (type(self), *self._made_with), {"attributes": state, **self._whole_state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set a copy that has just been constructed to the original's state."""
        vars(self).update(state["attributes"])
        self._set_horizon(self._horizon)
        self._set_whole_state(state)

    def _copied_names(self) -> set[str]:
        """Names of attributes that are copied directly: spaces with their generators, settings, and subclasses' own."""
        return {"_horizon", "_spec", "_step_limit", "settings", *COPIED} | (set(vars(self)) - self.constructed_names)

    def _whole_state(self) -> dict[str, Any]:
        """The rest of the state of a copy: the episodes' state, and whether the environment is closed."""
        raise NotImplementedError

    def _set_whole_state(self, state: dict[str, Any]) -> None:
        raise NotImplementedError

    # A property that replaces Gymnasium's class attribute, because the recorded spec has to be comparable and
    # serialisable.
    @property
    def spec(self) -> EnvSpec | None:
        """How the environment was made, in Python's own numbers, lists and names, including its time limit.

        It names the engine, as the default differs if PyBullet is missing.
        """
        return self._spec

    @spec.setter
    def spec(self, value: EnvSpec | None) -> None:
        if value is not None:
            kwargs = {**as_recorded(value.kwargs), "engine": self.settings.engine}
            if self.settings.material is not None:
                kwargs["material"] = as_recorded(asdict(self.settings.material))
            if self.settings.organ is not None:
                kwargs["organ"] = self.settings.organ
            if "episode_time" in kwargs:
                # `episode_time` is None if a number of steps was given.
                kwargs["episode_time"] = self.settings.episode_time
            value = replace(value, kwargs=kwargs, max_episode_steps=self._max_episode_steps)
        self._spec = value

    @property
    def _max_episode_steps(self) -> int | None:
        """Number of control steps after which episodes are truncated, under the name in Gymnasium's `TimeLimit`."""
        return self._step_limit

    @_max_episode_steps.setter
    def _max_episode_steps(self, value: int | None) -> None:
        limit = read_step_limit(value)
        check_horizon(self.settings, limited=limit is not None)
        self._step_limit = limit
        self._set_horizon(limit)

    def _set_horizon(self, steps: int | None) -> None:
        """Set the number of control steps of an episode, whoever truncates it, for the payments at ends of episodes."""
        self._horizon = self._episodes.horizon = steps

    @property
    def workspace(self) -> Workspace:
        """The cube within which the grip is kept."""
        return self._episodes.workspace

    @property
    def task(self) -> Task:
        """The task."""
        return self._episodes.task

    @property
    def task_description(self) -> str:
        """Instruction to the agent in one sentence, for policies that read one."""
        return self.task.description or f"Solve the task {self.definition.name}."

    @property
    def control(self) -> VelocityControl:
        """The control, which defines the meaning of actions."""
        return self._episodes.control

    @property
    def observation_builder(self) -> ObservationBuilder:
        """The layout of observations."""
        return self._episodes.observation_builder

    @property
    def steps_per_action(self) -> int:
        """Number of physics steps per control step."""
        return self._episodes.steps_per_action

    @property
    def compute_reward(self) -> Callable[[NDArray[Any], NDArray[Any], Any], NDArray[np.float32]]:
        """The sparse reward as a function of (achieved_goal, desired_goal, info), for hindsight replay.

        Goals are (..., G) and the result is (...). `info`, of one step or of each step, tells which steps ended by
        damage or by a tangle; where it does not tell, none did. With `reward="dense"` this attribute does not exist,
        because libraries detect the goal interface by it.
        """
        if self._episodes.settings.reward != "sparse":
            raise AttributeError("compute_reward needs the goal interface: make the environment with reward='sparse'")
        if not self.task.hindsight:
            raise AttributeError(
                f"{self.definition.name} has no compute_reward: what is achieved in it depends on what is asked, so "
                "that no step can be replayed as if something else had been asked"
            )
        task, episodes = self.task, self._episodes

        def compute(achieved: NDArray[Any], desired: NDArray[Any], info: Any) -> NDArray[np.float32]:
            reward = task.compute_reward(achieved, desired)
            badly = episodes.incentives.charged(info)
            if not badly.any():
                return reward
            return np.where(badly, np.float32(-episodes.incentives.charge(episodes.horizon)), reward)

        return compute
