"""Bringing a policy's actions close to those demonstrated.

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
"""Logarithm of the standard deviation, before the squashing, that an actor begins to explore with after imitation."""

LEAST_ESTIMATE = 1.0
"""The rewards' loss is divided by the mean size of the critics' estimates, but by this at least: about one step's
reward."""


@dataclass(frozen=True)
class CloneConfig(Checked):
    """How cloning goes.

    Attributes:
        gradient_steps: How many.
        batch_size: Samples in each.
        learning_rate: Of Adam at the beginning; it falls to zero along a half wave.
        seed: Of networks and batches.
    """

    gradient_steps: Count = 6_000
    batch_size: Count = 256
    learning_rate: Positive = 1e-3
    seed: int = 0


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


def hold_to_demonstrations(
    model: Any, imitated: tuple[NDArray[np.float32], NDArray[np.float32]], *, weight: float, batch_size: int
) -> None:
    """Hold an actor close to demonstrations, from now on, while it learns from rewards.

    Each update of the actor goes down the gradient of two losses at once: that of the rewards, divided by the mean size
    of the critics' estimates, so that it does not depend on how rewards are scaled, and `weight` times the mean squared
    difference from what was demonstrated (S. Fujimoto and S. Gu, "A Minimalist Approach to Offline Reinforcement
    Learning", NeurIPS 2021). Critics that have not seen what comes of an action overrate it; without the second loss
    the actor follows them away from what it has imitated.

    Args:
        model: SAC or TQC.
        imitated: (N, ...) what demonstrators saw, not normalised, and (N, A) what they wanted to do.
        weight: Of imitation beside rewards.
        batch_size: Samples in an update.
    """
    observations, actions = imitated

    def add_gradients(optimizer: torch.optim.Optimizer, *_: Any) -> None:
        parameters = [each for group in optimizer.param_groups for each in group["params"] if each.grad is not None]
        if not parameters:
            return
        # From NumPy's global random numbers as Stable-Baselines3's batches, since checkpoints keep their state.
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
            # Critics that know nothing yet estimate next to nothing, which must not make them louder.
            parameter.grad.div_(size.clamp(min=LEAST_ESTIMATE))
            if gradient is not None:
                parameter.grad.add_(gradient, alpha=weight)

    model.actor.optimizer.register_step_pre_hook(add_gradients)


def as_tensors(observations: Any) -> Any:
    """Observations, or a dictionary of them, as torch has them."""
    if isinstance(observations, dict):
        return {key: as_tensors(values) for key, values in observations.items()}
    # Pictures take a quarter of the room as they are; policies make numbers of a batch of them.
    return torch.as_tensor(observations, dtype=None if observations.dtype == np.uint8 else torch.float32)


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
