"""Behaviour cloning: policies that imitate demonstrations, and are corrected by those who gave them.

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
"""Seeds of a round of corrections are so much greater than those of the one before."""

WORLDS = 64
"""In which a policy that is corrected acts at once."""


def clone(
    config: TrainingConfig, demonstrations: Sequence[Demonstration], how: CloneConfig
) -> tuple[Any, Any, list[float]]:
    """Imitate demonstrations.

    Args:
        config: Environment, algorithm, network and normalisation.
        demonstrations: Of which observations and wanted actions count.
        how: How cloning goes.

    Returns:
        The model, what normalises its observations (None: nothing), and the losses: the mean squared difference between
        actions, averaged over each tenth of the gradient steps.

    Raises:
        ValueError: If there is no demonstration.
    """
    if not demonstrations:
        raise ValueError("demonstrations must be one at least, got none")
    torch.set_num_threads(config.torch_threads)
    config = dataclasses.replace(config, environment=dataclasses.replace(config.environment, num_envs=1))
    if isinstance(config.hyperparameters, SACConfig):
        # It stays empty.
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
    """Imitate demonstrations, going on from what a model does now; returns the losses."""
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
    """One round of corrections, which are added to the demonstrations.

    Args:
        folder: Where the policy is saved that acts.
        number: Of the round, from 1.
        plan: Of the demonstrations.
        config: What is trained.
        demonstrations: So far; lengthened.
        learner: The model, what normalises its observations, and how it imitates.

    Returns:
        The success rate of the policy that acted, and the losses of imitating all anew.
    """
    corrected = collect(
        dataclasses.replace(plan, seed=plan.seed + ROUND_SEEDS * number),
        num_envs=WORLDS,
        parts=config.environment.parts,
        driver=find_policy(str(folder), plan.env_id),
    )
    demonstrations += corrected
    return float(np.mean([each.success for each in corrected])), _fit(*learner[:2], demonstrations, learner[2])
