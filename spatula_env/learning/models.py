"""Makes algorithms of Stable-Baselines3 and sb3-contrib from configurations.

Needs the extra "train".
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from spatula_env.learning.configuration import (
    NetworkConfig,
    PPOConfig,
    SACConfig,
    SACHERConfig,
    TQCConfig,
    TrainingConfig,
)
from spatula_env.learning.networks import policy_class, policy_settings
from spatula_env.learning.replay import DemonstrationReplayBuffer


def algorithm_class(config: TrainingConfig) -> type[BaseAlgorithm]:
    """The algorithm's class for a configuration."""
    if config.algorithm == "ppo":
        return PPO
    if config.algorithm == "tqc":
        from sb3_contrib import TQC

        return TQC
    return SAC


def make_model(config: TrainingConfig, env: VecEnv, seed: int) -> BaseAlgorithm:
    """Make an untrained model.

    Args:
        config: Training configuration.
        env: Training environment.
        seed: Seed of its networks, actions and batches.
    """
    chosen = config.hyperparameters
    policy = policy_class(env.observation_space)
    network = {**_network(config.network), **policy_settings(env.observation_space)}
    rate = _schedule(chosen.learning_rate, chosen.final_learning_rate)
    if isinstance(chosen, PPOConfig):
        return PPO(
            policy,
            env,
            learning_rate=rate,
            n_steps=chosen.n_steps,
            batch_size=chosen.batch_size,
            n_epochs=chosen.n_epochs,
            gamma=chosen.gamma,
            gae_lambda=chosen.gae_lambda,
            clip_range=chosen.clip_range,
            ent_coef=chosen.ent_coef,
            vf_coef=chosen.vf_coef,
            max_grad_norm=chosen.max_grad_norm,
            target_kl=chosen.target_kl,
            policy_kwargs={**network, "log_std_init": chosen.log_std_init},
            seed=seed,
            device="cpu",
        )
    assert isinstance(chosen, SACConfig)
    settings: dict[str, Any] = {
        "learning_rate": rate,
        "buffer_size": chosen.buffer_size,
        "learning_starts": chosen.learning_starts,
        "batch_size": chosen.batch_size,
        "tau": chosen.tau,
        "gamma": chosen.gamma,
        # With overlap, the caller takes the gradient steps while worlds are stepped.
        "gradient_steps": 0 if config.overlap else chosen.gradient_steps,
        "ent_coef": chosen.ent_coef,
        "target_entropy": chosen.target_entropy,
        "policy_kwargs": {**network, "n_critics": chosen.n_critics},
        "seed": seed,
        "device": "cpu",
    }
    if isinstance(chosen, TQCConfig):
        settings["policy_kwargs"]["n_quantiles"] = chosen.n_quantiles
        settings["top_quantiles_to_drop_per_net"] = chosen.top_quantiles_to_drop_per_net
    if isinstance(chosen, SACHERConfig):
        settings["replay_buffer_class"] = HerReplayBuffer
        settings["replay_buffer_kwargs"] = {
            "n_sampled_goal": chosen.n_sampled_goal,
            "goal_selection_strategy": chosen.goal_selection_strategy,
        }
    if config.demonstration_share:
        if policy == "MultiInputPolicy":
            raise ValueError(
                "demonstration_share must be 0 where observations are a dictionary: with environment.kwargs.obs_mode "
                "other than 'state', and with environment.kwargs.reward 'sparse'"
            )
        settings["replay_buffer_class"] = DemonstrationReplayBuffer
        settings["replay_buffer_kwargs"] = {"share": config.demonstration_share}
    return algorithm_class(config)(policy, env, **settings)


def _network(config: NetworkConfig) -> dict[str, Any]:
    activations = {"relu": nn.ReLU, "tanh": nn.Tanh, "elu": nn.ELU}
    return {"net_arch": list(config.layers), "activation_fn": activations[config.activation]}


def _schedule(first: float, last: float | None) -> float | Callable[[float], float]:
    if last is None:
        return first
    final = last

    def rate(remaining: float) -> float:
        return final + (first - final) * remaining

    return rate
