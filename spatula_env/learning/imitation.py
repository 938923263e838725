"""Imitation: training a policy's actions towards those demonstrated.

Needs the extra "train".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from spatula_env.learning.ranges import Checked, Count, Positive

CALM = math.log(0.2)
"""Log standard deviation, before squashing, with which an actor begins to explore after imitation."""

LEAST_ESTIMATE = 1.0
"""Least value by which the reward loss is divided, otherwise the mean magnitude of the critics' estimates: about one
step's reward."""


@dataclass(frozen=True)
class CloneConfig(Checked):
    """Settings of cloning.

    Attributes:
        gradient_steps: Number of gradient steps.
        batch_size: Number of samples per gradient step.
        learning_rate: Initial learning rate of Adam; decreases to zero along half a cosine wave.
        seed: Seed of networks and batches.
    """

    gradient_steps: Count = 6_000
    batch_size: Count = 256
    learning_rate: Positive = 1e-3
    seed: int = 0


def imitate(model: Any, observations: Any, actions: NDArray[np.float32], how: CloneConfig) -> list[float]:
    """Train a policy's deterministic actions towards those demonstrated.

    Args:
        model: PPO, SAC or TQC of Stable-Baselines3 and sb3-contrib.
        observations: (N, ...) or a dictionary of such arrays, normalised.
        actions: (N, A) demonstrated actions.
        how: Settings of cloning.

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
    """Reduce the exploration of an actor that has imitated, so that it stays close to what it has learnt."""
    actor = getattr(model.policy, "actor", None)
    if actor is not None:
        with torch.no_grad():
            actor.log_std.weight.zero_()
            actor.log_std.bias.fill_(CALM)


def hold_to_demonstrations(
    model: Any, imitated: tuple[NDArray[np.float32], NDArray[np.float32]], *, weight: float, batch_size: int
) -> None:
    """Keep an actor close to demonstrations, from now on, while it learns from rewards.

    Each update of the actor descends the gradient of two losses: the reward loss, divided by the mean magnitude of the
    critics' estimates to make it independent of the scale of rewards, and `weight` times the mean squared difference
    from the demonstrated actions (S. Fujimoto and S. Gu, "A Minimalist Approach to Offline Reinforcement Learning",
    NeurIPS 2021). Critics overestimate actions whose outcome they have not seen; without the second loss, the actor
    would follow them away from what it has imitated.

    Args:
        model: SAC or TQC.
        imitated: (N, ...) the demonstrators' observations, not normalised, and (N, A) their wanted actions.
        weight: Weight of imitation relative to rewards.
        batch_size: Number of samples per update.
    """
    observations, actions = imitated

    def add_gradients(optimizer: torch.optim.Optimizer, *_: Any) -> None:
        parameters = [each for group in optimizer.param_groups for each in group["params"] if each.grad is not None]
        if not parameters:
            return
        # Drawn from NumPy's global generator, as Stable-Baselines3's batches are, because checkpoints keep its state.
        rows = np.random.randint(len(actions), size=batch_size)  # noqa: NPY002 - see above
        seen, wanted = observations[rows], torch.as_tensor(actions[rows])
        normalizer = model.get_vec_normalize_env()
        if normalizer is not None:
            seen = normalizer.normalize_obs(seen)
        batch = as_tensors(seen)
        with torch.no_grad():
            estimates = model.critic(batch, wanted)
            size = (torch.cat(estimates, dim=1) if isinstance(estimates, tuple) else estimates).abs().mean()
        with torch.enable_grad():
            loss = torch.nn.functional.mse_loss(model.actor(batch, deterministic=True), wanted)
            gradients = torch.autograd.grad(loss, parameters, allow_unused=True)
        for parameter, gradient in zip(parameters, gradients, strict=True):
            # Untrained critics estimate values near zero; dividing by these must not amplify their gradients.
            parameter.grad.div_(size.clamp(min=LEAST_ESTIMATE))
            if gradient is not None:
                parameter.grad.add_(gradient, alpha=weight)

    model.actor.optimizer.register_step_pre_hook(add_gradients)


def as_tensors(observations: Any) -> Any:
    """Convert an array, or a dictionary of arrays, to torch tensors."""
    if isinstance(observations, dict):
        return {key: as_tensors(values) for key, values in observations.items()}
    # Keep pictures as bytes, a quarter of the memory; the policy converts each batch to floats.
    return torch.as_tensor(observations, dtype=None if observations.dtype == np.uint8 else torch.float32)


def _parameters(model: Any) -> list[Any]:
    actor = getattr(model.policy, "actor", None)
    return list((actor if actor is not None else model.policy).parameters())


def _step(model: Any, optimizer: Any, batch: Any, wanted: Any) -> float:
    """Make one gradient step; return the mean squared difference between actions."""
    actor = getattr(model.policy, "actor", None)
    if actor is not None:
        done = actor(batch, deterministic=True)
    else:
        done = model.policy.get_distribution(batch).mode()
    # Annotated as Any for mypy, because torch's backward is not typed.
    loss: Any = torch.nn.functional.mse_loss(done, wanted)
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    return float(loss.detach())
