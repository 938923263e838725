"""Exports policies as a few arrays that act without torch.

`export_policy` converts a policy trained by Stable-Baselines3, with its normalisation, to a
`spatula_env.policies.ExportedPolicy`. Its actions are those that `model.predict(..., deterministic=True)` gives, up to
rounding.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.arrays import Float32Array
from spatula_env.policies import Entry, ExportedPolicy

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize


def export_policy(
    model: BaseAlgorithm, normalizer: VecNormalize | None = None, metadata: Mapping[str, Any] | None = None
) -> ExportedPolicy:
    """Export a trained model, to run without torch.

    Args:
        model: PPO, SAC or TQC of Stable-Baselines3 and sb3-contrib, with a policy of dense layers.
        normalizer: Normalisation of its observations; None for none.
        metadata: See `ExportedPolicy`.

    Raises:
        ValueError: If the policy is of another kind.
    """
    from gymnasium import spaces
    from torch import nn

    policy: Any = model.policy
    squash = hasattr(policy, "actor") and hasattr(policy.actor, "latent_pi")
    if squash:
        modules = [*policy.actor.latent_pi, policy.actor.mu]
        features = policy.actor.features_extractor
    elif hasattr(policy, "mlp_extractor") and hasattr(policy, "action_net"):
        modules = [*policy.mlp_extractor.policy_net, policy.action_net]
        features = policy.pi_features_extractor
    else:
        raise ValueError(f"model must be PPO, SAC or TQC, got {type(model).__name__}")
    if next(iter(features.parameters()), None) is not None:
        raise ValueError(
            "a policy with layers for pictures or points cannot be exported, only one of dense layers; "
            "evaluate and view take it from its run's folder"
        )
    names = {nn.ReLU: "relu", nn.Tanh: "tanh", nn.ELU: "elu"}
    layers: list[tuple[Float32Array, Float32Array]] = []
    activations = set()
    for module in modules:
        if isinstance(module, nn.Linear):
            layers.append((_array(module.weight), _array(module.bias)))
        elif type(module) in names:
            activations.add(names[type(module)])
        elif not isinstance(module, nn.Identity | nn.Flatten | nn.Hardtanh):
            raise ValueError(f"model has a layer that cannot be exported: {module}")
    if len(activations) > 1:
        raise ValueError(f"model must have one kind of activation, got {sorted(activations)}")

    space = model.observation_space
    keys = list(space.spaces) if isinstance(space, spaces.Dict) else [""]
    entries, clip = [], float("inf")
    for key in keys:
        one = space.spaces[key] if isinstance(space, spaces.Dict) else space
        size = int(np.prod(one.shape or ()))
        mean, scale = np.zeros(size), np.ones(size)
        if normalizer is not None and normalizer.norm_obs and (not key or key in (normalizer.norm_obs_keys or ())):
            statistics: Any = normalizer.obs_rms[key] if key else normalizer.obs_rms
            clip = float(normalizer.clip_obs)
            mean, scale = statistics.mean.reshape(-1), np.sqrt(statistics.var + normalizer.epsilon).reshape(-1)
        entries.append(Entry(key, mean.astype(np.float64), scale.astype(np.float64)))
    action_space = model.action_space
    assert isinstance(action_space, spaces.Box)
    return ExportedPolicy(
        entries=tuple(entries),
        clip=clip,
        layers=tuple(layers),
        activation=next(iter(activations), "relu"),
        squash=squash,
        low=action_space.low.astype(np.float32),
        high=action_space.high.astype(np.float32),
        metadata=dict(metadata or {}),
    )


def is_dense(model: BaseAlgorithm) -> bool:
    """Whether a model's policy consists of dense layers only, so that it can be exported."""
    policy: Any = model.policy
    actor = getattr(policy, "actor", None)
    features = policy.pi_features_extractor if actor is None else actor.features_extractor
    return next(iter(features.parameters()), None) is None


def _array(tensor: Any) -> Float32Array:
    return np.ascontiguousarray(tensor.detach().cpu().numpy(), dtype=np.float32)
