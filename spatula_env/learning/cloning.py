"""Behaviour cloning: policies that imitate demonstrations, and are corrected by the demonstrator (DAgger).

Needs the extra "train".
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecNormalize

from spatula_env.learning.configuration import SACConfig, TrainingConfig
from spatula_env.learning.demonstrations import Demonstration, collect, joined_observations
from spatula_env.learning.evaluation import Plan
from spatula_env.learning.finding import find_policy
from spatula_env.learning.imitation import CloneConfig, imitate
from spatula_env.learning.models import make_model
from spatula_env.learning.worlds import make_training_env

ROUND_SEEDS = 100_000
"""Offset between the seeds of successive rounds of corrections."""

WORLDS = 64
"""Number of worlds in which a policy acts at once while it is corrected."""


def clone(
    config: TrainingConfig, demonstrations: Sequence[Demonstration], how: CloneConfig
) -> tuple[Any, Any, list[float]]:
    """Imitate demonstrations.

    Args:
        config: Environment, algorithm, network and normalisation.
        demonstrations: Demonstrations, of which observations and wanted actions are used.
        how: Settings of cloning.

    Returns:
        The model, the normalisation of its observations (None for none), and the losses: the mean squared difference
            between actions, averaged over each tenth of the gradient steps.

    Raises:
        ValueError: If there are no demonstrations.
    """
    if not demonstrations:
        raise ValueError("demonstrations must be one at least, got none")
    torch.set_num_threads(config.torch_threads)
    config = dataclasses.replace(config, environment=dataclasses.replace(config.environment, num_envs=1))
    if isinstance(config.hyperparameters, SACConfig):
        # The replay buffer stays empty.
        config = dataclasses.replace(config, hyperparameters=dataclasses.replace(config.hyperparameters, buffer_size=1))
    env, _ = make_training_env(config, how.seed, config.hyperparameters.gamma)
    try:
        model: Any = make_model(config, env, how.seed)
        normalizer = env if isinstance(env, VecNormalize) else None
        if normalizer is not None and normalizer.norm_obs:
            observations = joined_observations(demonstrations)
            statistics = normalizer.obs_rms if isinstance(normalizer.obs_rms, dict) else {"": normalizer.obs_rms}
            for key, running in statistics.items():
                running.update(observations[key] if key else observations)
        if normalizer is not None:
            normalizer.training = False
        return model, normalizer, _fit(model, normalizer, demonstrations, how)
    finally:
        env.close()


def _fit(model: Any, normalizer: Any, demonstrations: Sequence[Demonstration], how: CloneConfig) -> list[float]:
    """Imitate demonstrations, starting from the model's present weights; return the losses."""
    observations = joined_observations(demonstrations)
    if normalizer is not None:
        observations = normalizer.normalize_obs(observations)
    return imitate(model, observations, np.concatenate([each.actions for each in demonstrations]), how)


def correct(
    folder: Path,
    number: int,
    plan: Plan,
    config: TrainingConfig,
    demonstrations: list[Demonstration],
    learner: tuple[Any, Any, CloneConfig],
) -> tuple[float, list[float]]:
    """Run one round of corrections, add them to the demonstrations, and imitate all of them.

    Args:
        folder: Folder of the saved policy that acts.
        number: Number of the round, from 1.
        plan: Plan of the demonstrations.
        config: Training configuration.
        demonstrations: Demonstrations so far; extended in place.
        learner: The model, the normalisation of its observations, and the settings of cloning.

    Returns:
        Success rate of the policy that acted, and the losses of imitating all demonstrations anew.
    """
    corrected = collect(
        dataclasses.replace(plan, seed=plan.seed + ROUND_SEEDS * number),
        num_envs=WORLDS,
        parts=config.environment.parts,
        driver=find_policy(str(folder), plan.env_id),
    )
    demonstrations += corrected
    return float(np.mean([each.success for each in corrected])), _fit(*learner[:2], demonstrations, learner[2])
