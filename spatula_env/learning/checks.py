"""Checks before training begins: whether the configuration is consistent, and everything it needs can be made.

Needs the extra "train".
"""

from __future__ import annotations

import dataclasses
import math
import os
import warnings
from typing import Any

import numpy as np
from gymnasium import spaces

from spatula_env.definitions import level_options
from spatula_env.envs.incentives import LIMITS
from spatula_env.envs.levels import merged
from spatula_env.learning.acting import acting_policy
from spatula_env.learning.configuration import PPOConfig, SACConfig, SACHERConfig, TQCConfig, TrainingConfig
from spatula_env.learning.demonstrations import EXPERT_MODES
from spatula_env.learning.evaluation import Plan
from spatula_env.learning.models import make_model
from spatula_env.learning.policies import judged_options, make_expert
from spatula_env.learning.saving import export_metadata
from spatula_env.learning.worlds import base_of, make_training_env


def check_training(config: TrainingConfig) -> list[str]:
    """Check that an agent can be trained by a configuration. Leaves nothing behind.

    To this end, the training and evaluation environments are made with one world each, and so is the model.

    Args:
        config: The configuration; the module of its environment has to be imported already.

    Returns:
        Warnings: values that are allowed but probably not intended.

    Raises:
        ImportError: If a required package is not installed.
        TypeError: If an option of the environment does not exist.
        ValueError: If values are invalid or inconsistent; the message names them and what is allowed.
    """
    _check_amounts(config)
    if config.algorithm == "sac_her":
        _check_hindsight(config)
    steps, transition = _rehearse(config)
    _check_memory(config, transition)
    chosen = config.hyperparameters
    worlds = config.environment.num_envs
    if isinstance(chosen, SACHERConfig):
        if steps is None:
            raise ValueError("environment.kwargs.max_episode_steps must be a number with algorithm 'sac_her'")
        whole = worlds * steps
        of = f"{worlds} worlds x {steps} steps of an episode: hindsight needs whole episodes"
        if chosen.learning_starts < whole:
            raise ValueError(
                f"hyperparameters.learning_starts must be {whole} or more, got {chosen.learning_starts} ({of})"
            )
        if chosen.buffer_size < 2 * whole:
            raise ValueError(
                f"hyperparameters.buffer_size must be {2 * whole} or more, got {chosen.buffer_size} (twice {of})"
            )
    notes = []
    if isinstance(chosen, SACConfig) and chosen.learning_starts >= config.total_steps:
        notes.append(
            f"nothing is learnt in total_steps {config.total_steps}, since hyperparameters.learning_starts is "
            f"{chosen.learning_starts}"
        )
    return notes


def _check_hindsight(config: TrainingConfig) -> None:
    """Check that the environment has no options that make transitions wrong when replayed with other goals."""
    for name, why in (
        ("terminate_on_success", "with another goal the episode would not have ended there"),
        *((name, "the replay buffer does not keep what tells of damage") for name in LIMITS),
        ("terminate_on_tangle", "the replay buffer does not keep what tells of tangles"),
    ):
        if _options(config).get(name):
            raise ValueError(
                f"environment.kwargs.{name} must be {_absent(config, name)} with algorithm 'sac_her': {why}"
            )


def _options(config: TrainingConfig) -> dict[str, Any]:
    """The environment's options, with those that its level implies."""
    environment = config.environment
    return merged(level_options(environment.id, environment.kwargs.get("level", "easy")), environment.kwargs)


def _absent(config: TrainingConfig, name: str) -> str:
    """How to do without an option of the environment."""
    kwargs = config.environment.kwargs
    return "left out" if name in kwargs else f"None, as level {kwargs['level']!r} sets it,"


def rehearse_clone(config: TrainingConfig) -> None:
    """Check that the model for behaviour cloning can be made; see `check_training`."""
    _rehearse(config, learns=False)


def _check_amounts(config: TrainingConfig) -> None:
    """Check relations between values that can be checked without making anything."""
    chosen, environment = config.hyperparameters, config.environment
    worlds = environment.num_envs
    if isinstance(chosen, PPOConfig):
        rollout = chosen.n_steps * worlds
        if not 2 <= chosen.batch_size <= rollout:
            raise ValueError(
                f"hyperparameters.batch_size must be from 2 to {rollout}, got {chosen.batch_size}: between updates "
                f"there are n_steps {chosen.n_steps} x environment.num_envs {worlds} samples"
            )
        if config.total_steps < rollout:
            raise ValueError(
                f"total_steps must be {rollout} or more, got {config.total_steps}: PPO learns after n_steps "
                f"{chosen.n_steps} x environment.num_envs {worlds} steps"
            )
        return
    if config.total_steps < worlds:
        raise ValueError(
            f"total_steps must be {worlds} or more, got {config.total_steps}: each world makes one step at least"
        )
    least = max(worlds, chosen.batch_size)
    if chosen.buffer_size < least:
        raise ValueError(
            f"hyperparameters.buffer_size must be {least} or more, got {chosen.buffer_size}: it holds a batch, and a "
            "step of all worlds"
        )
    if isinstance(chosen, TQCConfig) and chosen.top_quantiles_to_drop_per_net >= chosen.n_quantiles:
        raise ValueError(
            f"hyperparameters.top_quantiles_to_drop_per_net must be less than n_quantiles, {chosen.n_quantiles}, "
            f"got {chosen.top_quantiles_to_drop_per_net}"
        )
    ends = [name for name in ("terminate_on_success", *LIMITS) if _options(config).get(name)]
    if config.demonstrations and ends:
        raise ValueError(
            f"environment.kwargs.{ends[0]} must be {_absent(config, ends[0])} with demonstrations, whose episodes must "
            "have one length"
        )


def _rehearse(config: TrainingConfig, *, learns: bool = True) -> tuple[int | None, int]:
    """Make one world of each kind, and the model.

    Returns:
        Number of steps of an episode, None if there is no limit; and the size of an observation [bytes].
    """
    with warnings.catch_warnings():
        # Warnings are shown when training begins.
        warnings.simplefilter("ignore")
        env, _ = make_training_env(_alone(config), 0, config.hyperparameters.gamma)
        try:
            if config.algorithm == "sac_her" and not base_of(env).env.task.hindsight:
                raise ValueError(
                    f"algorithm must not be 'sac_her' with {config.environment.id}: what is achieved in it depends on "
                    "what is asked, so that hindsight would be wrong"
                )
            model = make_model(_alone(config), env, 0)
            steps: Any = base_of(env).env.max_episode_steps
            policy = acting_policy(model, model.get_vec_normalize_env(), export_metadata(config))
            size = _bytes_of(model.observation_space, np.float32 if config.algorithm == "ppo" else None)
        except AssertionError as error:
            # Raised by Stable-Baselines3's own checks.
            raise ValueError(f"{config.algorithm} cannot be made so: {error}") from error
        finally:
            env.close()
        environment, evaluation = config.environment, config.evaluation
        judged_on = judged_options(environment.id, environment.kwargs)
        plan = Plan(environment.id, judged_on, evaluation.engine, 1, evaluation.seed)
        if learns:
            judged = plan.make(1)
            try:
                policy.bound_to(judged)
                if judged.max_episode_steps is None:
                    raise ValueError(f"{environment.id} must be registered with max_episode_steps, to be evaluated")
            finally:
                judged.close()
        if config.demonstrations:
            shown = dataclasses.replace(plan, engine=environment.engine).make(
                1, obs_mode=EXPERT_MODES[0], observation=None
            )
            try:
                make_expert(shown)
            finally:
                shown.close()
    return steps, size


def _alone(config: TrainingConfig) -> TrainingConfig:
    """The configuration with one world, and with a replay buffer of minimal size."""
    chosen, worlds = config.hyperparameters, config.environment.num_envs
    hyperparameters = (
        dataclasses.replace(chosen, n_steps=chosen.n_steps * worlds)
        if isinstance(chosen, PPOConfig)
        else dataclasses.replace(chosen, buffer_size=1)
    )
    environment = dataclasses.replace(config.environment, num_envs=1)
    return dataclasses.replace(config, environment=environment, hyperparameters=hyperparameters)


def _bytes_of(space: spaces.Space[Any], kind: Any = None) -> int:
    """Size of an observation [bytes]."""
    if isinstance(space, spaces.Dict):
        return sum(_bytes_of(one, kind) for one in space.spaces.values())
    return math.prod(space.shape or ()) * np.dtype(kind or space.dtype).itemsize


def _check_memory(config: TrainingConfig, observation: int) -> None:
    """Check that the stored data will fit into memory; otherwise the system would kill the process later on."""
    room, chosen = memory(), config.hyperparameters
    if room is None:
        return
    if isinstance(chosen, PPOConfig):
        needed, what = observation * chosen.n_steps * config.environment.num_envs, "hyperparameters.n_steps"
        greatest = room // (observation * config.environment.num_envs)
    else:
        # The observations before and after each step.
        needed, what = 2 * observation * chosen.buffer_size, "hyperparameters.buffer_size"
        greatest = room // (2 * observation)
    if needed > room:
        raise ValueError(
            f"{what} must be {greatest} at most here: one observation takes {observation} bytes, all that are kept "
            f"{needed / 1e9:.1f} GB, and this machine has {room / 1e9:.1f} GB"
        )


def memory() -> int | None:
    """Memory of this machine [bytes]; None if it is unknown."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None
