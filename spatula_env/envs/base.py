"""The base of environments for one agent and of vector environments, beside their episodes."""

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
"""Attributes that a copy has of its own: sampling from a space draws from random numbers of its own."""


def _make_again(kind: type[Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    return kind(*args, **kwargs)


class EpisodesEnv:
    """What environments for one agent and for many tell of their episodes.

    Attributes:
        definition: Scene and task; subclasses with an id have one.
        constructed_names: Of attributes that are decided when the environment is made.
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
        """Remember the arguments, from which a copy is made."""
        made = super().__new__(cls)
        made._made_with = (copy.deepcopy(args), copy.deepcopy(kwargs))
        return made

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Make Gymnasium's class a direct base of every subclass: libraries look there for what an environment is."""
        super().__init_subclass__(**kwargs)
        kind = getattr(cls, "_gymnasium_class", None)
        if kind is not None and kind not in cls.__bases__:
            cls.__bases__ = (*cls.__bases__, kind)

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy, for `copy.deepcopy` and `pickle`: an environment of its own in exactly the same state.

        It is made with the same arguments, and put to the state of this one: also what is drawn next is the same. It
        has no window and no listeners.
        """
        state = {name: value for name, value in vars(self).items() if name in self._copied_names()}
        return _make_again, (type(self), *self._made_with), {"attributes": state, **self._whole_state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Put a copy that has just been made to the state of the original."""
        vars(self).update(state["attributes"])
        self._set_horizon(self._horizon)
        self._set_whole_state(state)

    def _copied_names(self) -> set[str]:
        """Names of what is copied as it is: spaces with their random numbers, settings, and what a subclass adds."""
        return {"_horizon", "_spec", "_step_limit", "settings", *COPIED} | (set(vars(self)) - self.constructed_names)

    def _whole_state(self) -> dict[str, Any]:
        """What else a copy needs: the state, and whether all is closed."""
        raise NotImplementedError

    def _set_whole_state(self, state: dict[str, Any]) -> None:
        raise NotImplementedError

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
            if self.settings.material is not None:
                kwargs["material"] = as_recorded(asdict(self.settings.material))
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
        limit = read_step_limit(value)
        check_horizon(self.settings, limited=limit is not None)
        self._step_limit = limit
        self._set_horizon(limit)

    def _set_horizon(self, steps: int | None) -> None:
        """Let the ends of episodes know after how many control steps they are cut, by whomever."""
        self._horizon = self._episodes.horizon = steps

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

        Goals are (..., G) and the result is (...). `info`, of one step or of each, tells which step ended by damage or
        by a tangle; where it tells nothing, none did. There is no such attribute with `reward="dense"`, because
        libraries tell by it which environments have the goal interface.
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
