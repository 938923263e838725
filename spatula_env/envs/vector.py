"""`SpatulaVectorEnv`: many worlds behind Gymnasium's interface for vector environments."""

from __future__ import annotations

import copy
import inspect
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from spatula_env.arrays import BoolArray, FloatArray
from spatula_env.envs.attributes import call_worlds, set_in_worlds
from spatula_env.envs.base import EpisodesEnv
from spatula_env.envs.control import as_actions
from spatula_env.envs.episodes import Episodes
from spatula_env.envs.incentives import check_horizon
from spatula_env.envs.observations import Observation
from spatula_env.envs.observed_pictures import observed_pictures
from spatula_env.envs.pictures import EpisodePictures, as_frame_rate
from spatula_env.envs.settings import check_choice
from spatula_env.envs.snapshots import EnvState, check_fits
from spatula_env.envs.time_limit import read_step_limit, steps_in
from spatula_env.envs.vector_arguments import as_autoreset_mode, read_mask, read_seeds, read_worlds
from spatula_env.geometry.checks import check_count
from spatula_env.sim.worlds import Worlds

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.arrays import IntArray

OWN_ARGUMENTS = ("num_envs", "max_episode_steps", "autoreset_mode")
"""Arguments in addition to those of the environment for one agent."""

StepResult = tuple[Observation, FloatArray, BoolArray, BoolArray, dict[str, Any]]


class SpatulaVectorEnv(EpisodesEnv, VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    r"""Any task, in many worlds of a scene with one organ.

    World k of an environment seeded with s goes through the same episodes as a `SpatulaEnv` seeded with s + k, up to
    the accuracy of the engine. All results follow Gymnasium's `SyncVectorEnv`, except for a world whose physics
    diverges: its episode is truncated, and the others go on.

    ## Arguments
    Those of the environment for one agent, with another default of `engine`, and some more:

    | Parameter           | Type                     | Default       | Description                                   |
    | ------------------- | ------------------------ | ------------- | --------------------------------------------- |
    | `num_envs`          | **int**                  | `1`           | How many worlds, W                            |
    | `max_episode_steps` | **int \| None**          | `None`        | Instead of `episode_time`; -1: never cut      |
    | `autoreset_mode`    | **str or AutoresetMode** | `"next_step"` | `"next_step"`, `"same_step"` or `"disabled"`  |
    | `engine`            | **str**                  | `"batch"`     | `"batch"`, `"bullet"`, `"tissue"`, `"mujoco"` |

    After an episode's end, the next step ignores the action and begins the next episode ("next_step"); or the step that
    ends an episode returns the beginning of the next one, with the last observation and info in `infos["final_obs"]`
    and `infos["final_info"]` ("same_step"); or `reset` with the option "reset_mask" begins new episodes ("disabled").
    These are the modes of Gymnasium's `AutoresetMode`.

    `gymnasium.vector.VectorEnv` is a direct base of every subclass, whether it is named there or not.

    Attributes:
        definition: Scene and task; set by subclasses.
        settings: All options.
    """

    _gymnasium_class = VectorEnv

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Give the class a signature that lists its arguments."""
        super().__init_subclass__(**kwargs)
        if "definition" in vars(cls):
            own = list(inspect.signature(SpatulaVectorEnv.__init__).parameters.values())[1:-1]
            cls.__signature__ = cls.definition.signature(*own, engine="batch")

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = "next_step",
        **options: Any,
    ) -> None:
        """Load the scene and compose the parts; the class describes the arguments.

        Raises:
            TypeError: If an option does not exist.
            ValueError: If an option is invalid, or a number is out of its range.
        """
        before = set(vars(self))
        limit = read_step_limit(max_episode_steps)
        check_count(num_envs, "num_envs", 1)
        self._mode = as_autoreset_mode(autoreset_mode)
        settings = self.definition.read(options, type(self).__name__, OWN_ARGUMENTS, engine="batch")
        if settings.render_mode is not None:
            check_choice(settings.render_mode, "render_mode", (None, "rgb_array"))
        never = settings.episode_time is None if max_episode_steps is None else limit is None
        check_horizon(settings, limited=not never)
        self._episodes = Episodes(
            self.definition,
            settings,
            lambda scene: Worlds(scene, num_envs, engine=settings.engine, contact=settings.contact),
            observed_pictures,
        )
        if max_episode_steps is None:
            limit = steps_in(settings.episode_time, self._episodes.period)
        else:
            settings = replace(settings, episode_time=None)
        self.settings = settings
        self.num_envs = int(num_envs)
        self._step_limit = limit
        self._set_horizon(limit)
        self.render_mode = settings.render_mode
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": as_frame_rate(settings.control_frequency),
            "autoreset_mode": self._mode,
        }
        self.single_observation_space = self._episodes.observation_builder.space
        self.single_action_space = self._episodes.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._pictures = EpisodePictures(self._episodes, settings.width, settings.height)
        self._generators: list[np.random.Generator | None] = [None] * self.num_envs
        self._seeds: list[int | None] = [None] * self.num_envs
        self._begun: BoolArray = np.zeros(self.num_envs, dtype=np.bool_)
        self._over: BoolArray = np.zeros(self.num_envs, dtype=np.bool_)
        self.constructed_names = frozenset({*dir(SpatulaVectorEnv), "definition", *vars(self)} - before)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin new episodes, in all worlds or in some.

        Args:
            seed: Restarts random numbers, of world k from seed + k, or from element k of a sequence. Where it is None,
                they continue.
            options: "goal" (G,) or (W, G) and "tool_position" (3,) or (W, 3) replace what is drawn [m]; "reset_mask"
                (W,) bool selects the worlds in which to begin.

        Returns:
            The observations of all worlds, and infos of those that begin, with the same keys as after a step.

        Raises:
            ValueError: If a seed or an option is misspelt, malformed or out of its range, or a tool would begin in the
                organ or below the stop above the ground; nothing is changed in this case. Options that do not belong to
                this package are ignored, with a warning.
        """
        self._check_open()
        worlds, rest = read_mask(options, self.num_envs)
        chosen = self._episodes.choose(rest, worlds)
        fresh = {
            world: seeding.np_random(one)
            for world, one in read_seeds(seed, self.num_envs, worlds).items()
            if one is not None or self._generators[world] is None
        }
        generators = {world: fresh[world][0] if world in fresh else self._generator(world) for world in worlds.tolist()}
        self._episodes.check_begin(generators, chosen)
        for world, (generator, number) in fresh.items():
            self._generators[world], self._seeds[world] = generator, number
        self._begin(worlds, chosen)
        return self._episodes.observation, self._infos_of(worlds)

    def step(self, actions: NDArray[np.float32]) -> StepResult:
        """Move the tools of all worlds for one control step.

        Args:
            actions: (W, A) actions as defined by `control`; clipped to [-1, 1].

        Returns:
            Observations, rewards (W,), whether episodes ended by success, damage or a tangle (W,), whether they were
            truncated (W,), and infos: arrays (W,) under each name, with a mask (W,) under the name after an underscore.

        Raises:
            ValueError: If `actions` has the wrong shape or is not finite; nothing is changed in this case.
            ResetNeeded: If a world has no episode in progress.
        """
        self._check_begun("step")
        episodes = self._episodes
        resting = self._over
        if self._mode is AutoresetMode.DISABLED and resting.any():
            raise ResetNeeded(
                f"the episodes of worlds {np.flatnonzero(resting).tolist()} are over; "
                "call reset(options={'reset_mask': mask}) before step()"
            )
        wanted = as_actions(actions, self.num_envs, episodes.control.size, ignored=resting)
        going = ~resting
        if going.any():
            outcome = episodes.step(wanted)
            rewards, lost = np.where(going, outcome.reward, 0.0), outcome.diverged & going
            terminated, truncated = outcome.terminated & going, lost.copy()
            if self._step_limit is not None:
                truncated |= (episodes.elapsed >= self._step_limit) & going
        else:
            rewards = np.zeros(self.num_envs)
            terminated, truncated, lost = resting & False, resting & False, resting & False
        if resting.any():
            self._begin(np.flatnonzero(resting))
        self._over = terminated | truncated
        infos: dict[str, Any] = {}
        if self._mode is AutoresetMode.SAME_STEP and self._over.any():
            ended = self._over
            infos = self._last_seen(ended)
            self._begin(np.flatnonzero(ended))
        infos.update(self._infos_of(np.arange(self.num_envs)))
        observation = episodes.observation
        if lost.any():
            warnings.warn(
                f"physics has diverged in worlds {np.flatnonzero(lost).tolist()}: their episodes are cut",
                RuntimeWarning,
                stacklevel=2,
            )
        return observation, rewards, terminated, truncated, infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """W pictures (height, width, 3), or None if `render_mode` is None."""
        self._check_begun("render")
        return None if self.render_mode is None else self._pictures.draw()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the engine; `close` calls it once."""
        self._episodes.close()

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of every world, or read an attribute of it, as Gymnasium's vector environments do.

        Args:
            name: Name of a method or an attribute of the environment for one agent, such as "render", "goal",
                "task_description" or "_max_episode_steps".
            *args: Arguments of the method.
            **kwargs: Keyword arguments of the method.

        Returns:
            (W,) result of the method, or value of the attribute, in each world.

        Raises:
            AttributeError: If worlds have no such attribute, or it is one that a single world cannot have alone.
        """
        return call_worlds(self, name, *args, **kwargs)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """An attribute of every world (W,); see `call`.

        Raises:
            AttributeError: If worlds have no such attribute.
        """
        return call_worlds(self, name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute in all worlds.

        Args:
            name: "_max_episode_steps", a property with a setter, or an attribute that a subclass has added.
            values: One value, or a list or tuple of W values, which must be equal because worlds share their
                attributes.

        Raises:
            AttributeError: If there is no such attribute, or setting it would have no effect.
            ValueError: If there are not W values, or they differ.
        """
        set_in_worlds(self, name, values)

    def save(self, worlds: ArrayLike | None = None) -> EnvState:
        """Save everything that the next step depends on, in all worlds or in some; see `SpatulaEnv.save`.

        Args:
            worlds: (n,) indices, or (W,) a mask; all by default.

        Returns:
            The state of n worlds, which can be restored any number of times, in any worlds, and pickled.

        Raises:
            ResetNeeded: If no episode has begun in one of them.
            ValueError: If a world does not exist, or physics has diverged in one of them.
        """
        self._check_open()
        chosen = read_worlds(worlds, self.num_envs)
        if not self._begun[chosen].all():
            missing = chosen[~self._begun[chosen]].tolist()
            raise ResetNeeded(f"call reset() before save(): nothing has begun in worlds {missing}")
        lost = self._episodes.info_of(chosen)["diverged"]
        if lost.any():
            raise ValueError(
                f"worlds must not have diverged, as {chosen[lost].tolist()} have: there is nothing to go on from"
            )
        physics, episodes = self._episodes.save(chosen)
        return EnvState(
            name=self.definition.name,
            settings=self.settings,
            physics=physics,
            episodes=episodes,
            generators=tuple(copy.deepcopy(self._generators[world]) for world in chosen.tolist()),
            seeds=tuple(self._seeds[world] for world in chosen.tolist()),
            over=self._over[chosen],
        )

    def restore(self, state: EnvState, worlds: ArrayLike | None = None) -> tuple[Observation, dict[str, Any]]:
        """Restore a saved state, in all worlds or in some. No `reset` is needed before.

        From there on, the same actions lead to bitwise identical results, in whichever world.

        Args:
            state: State of n worlds, from `save` here or in another environment like this one; or of one world, to
                which all of `worlds` are set.
            worlds: (n,) worlds to restore it in, or (W,) a mask; all by default.

        Returns:
            The observations of all worlds, and infos of those that were restored.

        Raises:
            TypeError: If it is not a state of an environment.
            ValueError: If it belongs to another environment, or to another number of worlds; nothing is changed in this
                case.
        """
        self._check_open()
        chosen = read_worlds(worlds, self.num_envs)
        check_fits(state, self.definition.name, self.settings, self._episodes.setting)
        if state.count not in (1, len(chosen)):
            raise ValueError(f"state must be of {len(chosen)} worlds, or of one, it is of {state.count}")
        if state.count != len(chosen):
            state = state.rows(np.zeros(len(chosen), dtype=np.int64))
        self._put(state, chosen)
        return self._episodes.observation, self._infos_of(chosen)

    def _put(self, state: EnvState, worlds: IntArray) -> None:
        self._episodes.restore(state.physics, state.episodes, worlds)
        for row, world in enumerate(worlds.tolist()):
            self._generators[world], self._seeds[world] = copy.deepcopy(state.generators[row]), state.seeds[row]
        self._begun[worlds] = True
        self._over[worlds] = state.over

    def _whole_state(self) -> dict[str, Any]:
        begun = np.flatnonzero(self._begun)
        state = self.save(begun) if len(begun) and not self.closed else None
        random = (copy.deepcopy(self._generators), list(self._seeds))
        return {"state": state, "begun": begun, "random": random, "closed": self.closed}

    def _set_whole_state(self, state: dict[str, Any]) -> None:
        self._generators, self._seeds = state["random"]
        if state["state"] is not None:
            self._put(state["state"], state["begun"])
        if state["closed"]:
            self.close()

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """How new episodes begin when one has ended."""
        return self._mode

    @property
    def worlds(self) -> Worlds:
        """The physics."""
        return self._episodes.worlds

    @property
    def max_episode_steps(self) -> int | None:
        """Number of control steps after which episodes are truncated; None for no limit. Can be set at any time."""
        return self._step_limit

    @max_episode_steps.setter
    def max_episode_steps(self, value: int | None) -> None:
        self._max_episode_steps = value

    @property
    def grips(self) -> FloatArray:
        """(W, 3) present position of the grip in each world, workspace frames [m]."""
        return self._episodes.grips

    @property
    def goals(self) -> FloatArray:
        """(W, G) goal of each world's episode, as a copy [m]."""
        return self._episodes.goals.copy()

    # Gymnasium has one exchangeable generator for all worlds. Here each world has its own.
    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Random generator of each world."""
        return tuple(self._generator(world) for world in range(self.num_envs))

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of each world's random generator."""
        for world in range(self.num_envs):
            self._generator(world)
        return tuple(seed for seed in self._seeds if seed is not None)

    def _begin(self, worlds: IntArray, chosen: Mapping[str, FloatArray] | None = None) -> None:
        self._episodes.begin({world: self._generator(world) for world in worlds.tolist()}, chosen)
        self._begun[worlds] = True
        self._over[worlds] = False

    def _generator(self, world: int) -> np.random.Generator:
        generator = self._generators[world]
        if generator is None:
            generator, self._seeds[world] = seeding.np_random()
            self._generators[world] = generator
        return generator

    def _last_seen(self, ended: BoolArray) -> dict[str, Any]:
        """Final observations and infos of ended episodes, in Gymnasium's layout, once the next ones have begun."""
        worlds, last = np.flatnonzero(ended), np.full(self.num_envs, None, dtype=object)
        for world, observation in zip(worlds.tolist(), self._episodes.observations_of(worlds), strict=True):
            last[world] = observation
        final = self._infos_of(worlds)
        return {"final_obs": last, "_final_obs": ended.copy(), "final_info": final, "_final_info": ended.copy()}

    def _infos_of(self, worlds: IntArray) -> dict[str, Any]:
        """Infos in Gymnasium's layout: values for some worlds (n,), zeros for others, and a mask beside each name."""
        mask = np.zeros(self.num_envs, dtype=np.bool_)
        mask[worlds] = True
        infos: dict[str, Any] = {}
        for name, values in self._episodes.info_of(worlds).items():
            infos[name] = np.zeros(self.num_envs, dtype=values.dtype)
            infos[name][worlds] = values
            infos[f"_{name}"] = mask.copy()
        return infos

    def _check_open(self) -> None:
        if self.closed:
            raise ClosedEnvironmentError("this environment is closed; make a new one")

    def _check_begun(self, method: str) -> None:
        self._check_open()
        if not self._begun.all():
            raise ResetNeeded(
                f"call reset() before {method}(): nothing has begun in worlds {np.flatnonzero(~self._begun).tolist()}"
            )
