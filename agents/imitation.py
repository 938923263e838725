"""Bringing a policy's actions close to those demonstrated.

Needs `pip install 'spatula-env[train]'`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecNormalize

CALM = math.log(0.2)
"""Logarithm of the standard deviation, before the squashing, that an actor begins to explore with after imitation."""


@dataclass(frozen=True)
class CloneConfig:
    """How cloning goes.

    Attributes:
        gradient_steps: How many.
        batch_size: Samples in each.
        learning_rate: Of Adam at the beginning; it falls to zero along a half wave.
        seed: Of networks and batches.
    """

    gradient_steps: int = 6_000
    batch_size: int = 256
    learning_rate: float = 1e-3
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the values."""
        for name in ("gradient_steps", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be 1 or more, got {getattr(self, name)!r}")
        if not 0.0 < self.learning_rate < math.inf:
            raise ValueError(f"learning_rate must be positive and finite, got {self.learning_rate!r}")


def imitate(model: Any, observations: Any, actions: NDArray[np.float32], how: CloneConfig) -> list[float]:
    """Bring a policy's deterministic actions close to those demonstrated.

    Args:
        model: PPO, SAC or TQC of Stable-Baselines3 and sb3-contrib.
        observations: (N, ...) or a dictionary of such arrays, normalised.
        actions: (N, A).
        how: How cloning goes.

    Returns:
        The losses: the mean squared difference between actions, averaged over each tenth of the gradient steps.
    """
    tensors, wanted = as_tensors(observations), torch.as_tensor(actions)
    optimizer = torch.optim.Adam(_parameters(model), lr=how.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, how.gradient_steps)
    generator = torch.Generator().manual_seed(how.seed)
    model.policy.set_training_mode(True)
    losses = []
    for _ in range(how.gradient_steps):
        rows = torch.randint(len(wanted), (how.batch_size,), generator=generator)
        batch = {key: values[rows] for key, values in tensors.items()} if isinstance(tensors, dict) else tensors[rows]
        losses.append(_step(model, optimizer, batch, wanted[rows]))
        schedule.step()
    model.policy.set_training_mode(False)
    return [float(part.mean()) for part in np.array_split(np.array(losses), min(10, len(losses)))]


def calm_down(model: Any) -> None:
    """Let an actor that has imitated explore close to what it has learnt, and not with its first, great deviation."""
    actor = getattr(model.policy, "actor", None)
    if actor is not None:
        with torch.no_grad():
            actor.log_std.weight.zero_()
            actor.log_std.bias.fill_(CALM)


class Imitator:
    """Keeps an actor close to demonstrations while it learns from rewards, less and less.

    An update of imitation follows each one by rewards, with an optimiser of its own, whose learning rate falls linearly
    to zero. At first, when critics know nothing yet, demonstrations hold the actor; in the end rewards decide alone.
    """

    def __init__(
        self,
        model: Any,
        imitated: tuple[NDArray[np.float32], NDArray[np.float32]],
        *,
        until: int,
        learning_rate: float,
        batch_size: int,
    ) -> None:
        """Get ready.

        Args:
            model: SAC or TQC.
            imitated: (N, ...) what demonstrators saw, not normalised, and (N, A) what they wanted to do.
            until: Environment steps at which imitation ends.
            learning_rate: At the beginning.
            batch_size: Samples in an update.
        """
        self._model, self._until, self._rate, self._batch_size = model, until, learning_rate, batch_size
        self._observations, self._actions = imitated
        self._optimizer = torch.optim.Adam(_parameters(model), lr=learning_rate)

    def step(self, normalizer: VecNormalize | None) -> None:
        """One update, if imitation has not ended.

        Args:
            normalizer: Of observations, as it is now; None: they are not normalised.
        """
        left = 1.0 - self._model.num_timesteps / self._until
        if left <= 0.0:
            return
        for group in self._optimizer.param_groups:
            group["lr"] = self._rate * left
        # From NumPy's global random numbers as Stable-Baselines3's batches, since checkpoints keep their state.
        rows = np.random.randint(len(self._actions), size=self._batch_size)  # noqa: NPY002 - see above
        seen = self._observations[rows]
        if normalizer is not None:
            seen = normalizer.normalize_obs(seen)
        _step(self._model, self._optimizer, as_tensors(seen), torch.as_tensor(self._actions[rows]))


def as_tensors(observations: Any) -> Any:
    """Observations, or a dictionary of them, as torch has them."""
    if isinstance(observations, dict):
        return {key: torch.as_tensor(values, dtype=torch.float32) for key, values in observations.items()}
    return torch.as_tensor(observations, dtype=torch.float32)


def _parameters(model: Any) -> list[Any]:
    actor = getattr(model.policy, "actor", None)
    return list((actor if actor is not None else model.policy).parameters())


def _step(model: Any, optimizer: Any, batch: Any, wanted: Any) -> float:
    """One gradient step; returns the mean squared difference between actions."""
    actor = getattr(model.policy, "actor", None)
    if actor is not None:
        done = actor(batch, deterministic=True)
    else:
        done = model.policy.get_distribution(batch).mode()
    # Of any type for mypy: torch does not say what backward takes.
    loss: Any = torch.nn.functional.mse_loss(done, wanted)
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    return float(loss.detach())
