"""Soft actor-critic in one file, on many worlds at once: to read, copy and change.

    python -m agents.cleanrl_sac
    python -m agents.cleanrl_sac --env-id Spatula/Retract-v0 --total-steps 500000 --seed 1

The environment begins a new episode in the step that ends the previous one (`autoreset_mode="same_step"`), so every
transition is a real one: the last observation comes in `infos["final_obs"]`, and only a termination, not a truncation,
sets the value of the following state to zero. The last line of the output is one JSON object. Needs the extra "train".

Algorithm: T. Haarnoja et al., Soft actor-critic algorithms and applications, arXiv:1812.05905 (2018).
"""

from __future__ import annotations

import json
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
import tyro
from torch import Tensor, nn
from torch.nn import functional

import spatula_env  # noqa: F401  registers the environments


@dataclass
class Arguments:
    """Soft actor-critic on many worlds at once."""

    env_id: str = "Spatula/Press-v0"
    """Id of the task."""
    num_envs: int = 64
    """Number of worlds that are stepped together."""
    max_episode_steps: int = 100
    """Length at which episodes are truncated; the press takes 30 at best, and shorter episodes show more goals."""
    leave_out: tuple[str, ...] = ("landmarks",)
    """Parts of the observation that the task does not need: the organ's landmarks carry no information on the press."""
    seed: int = 0
    """World k's first episode is drawn from seed + k."""
    total_steps: int = 51_200
    """Number of steps of all worlds together."""
    learning_starts: int = 6_400
    """Number of initial steps with random actions."""
    gradient_steps: int = 8
    """Number of updates per step of all worlds."""
    buffer_size: int = 400_000
    """Number of transitions that are kept."""
    batch_size: int = 256
    """Number of transitions per update."""
    learning_rate: float = 1e-3
    """Learning rate of Adam for all networks."""
    gamma: float = 0.95
    """Discount factor."""
    tau: float = 0.01
    """Rate at which the target critics follow the critics."""
    initial_temperature: float = 0.1
    """Initial temperature; it is then tuned so that the entropy is minus the number of action components."""
    hidden: int = 128
    """Number of units in each of the two layers."""
    success_target: float | None = None
    """Training ends when this share of the last 100 episodes has succeeded; None to train for all of total_steps."""
    eval_episodes: int = 100
    """Number of final episodes with the mean action, each in a world of its own."""
    device: str = "cpu"
    """Device of the networks."""
    output: Path | None = None
    """File for the actor's weights and the normalisation, written by `torch.save`."""


class RunningNorm:
    """Normalises observations by the mean and standard deviation of all that were seen."""

    def __init__(self, size: int) -> None:
        """Start without observations, for vectors of a given size."""
        self.mean, self.variance, self.count = np.zeros(size), np.ones(size), 1e-4

    def update(self, batch: np.ndarray) -> None:
        """Update with a batch (n, size), by the parallel formula of Chan, Golub and LeVeque (1979)."""
        delta, total = batch.mean(axis=0) - self.mean, self.count + len(batch)
        squares = self.variance * self.count + batch.var(axis=0) * len(batch)
        self.variance = (squares + delta**2 * self.count * len(batch) / total) / total
        self.mean, self.count = self.mean + delta * len(batch) / total, total

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Normalise observations (..., size), clipped to ten standard deviations."""
        scaled = (observations - self.mean) / np.sqrt(self.variance + 1e-8)
        return np.clip(scaled, -10.0, 10.0).astype(np.float32)


class Replay:
    """Ring buffer of the latest transitions; observations are stored without normalisation."""

    def __init__(self, size: int, observation_size: int, action_size: int) -> None:
        """Allocate space for a number of transitions."""
        self.observations = np.zeros((size, observation_size), np.float32)
        self.next_observations = np.zeros((size, observation_size), np.float32)
        self.actions = np.zeros((size, action_size), np.float32)
        self.rewards, self.terminations = np.zeros(size, np.float32), np.zeros(size, np.float32)
        self.size, self.added = size, 0

    def add(
        self,
        observations: np.ndarray,
        next_observations: np.ndarray,
        actions: np.ndarray,
        rewards: np.ndarray,
        terminations: np.ndarray,
    ) -> None:
        """Add a transition of each world."""
        rows = (self.added + np.arange(len(rewards))) % self.size
        self.observations[rows], self.next_observations[rows] = observations, next_observations
        self.actions[rows], self.rewards[rows], self.terminations[rows] = actions, rewards, terminations
        self.added += len(rewards)

    def sample(self, rng: np.random.Generator, count: int, norm: RunningNorm, device: str) -> tuple[Tensor, ...]:
        """Sample transitions, with replacement."""
        rows = rng.integers(min(self.added, self.size), size=count)
        batch = (
            norm(self.observations[rows]),
            self.actions[rows],
            self.rewards[rows],
            norm(self.next_observations[rows]),
            self.terminations[rows],
        )
        return tuple(torch.as_tensor(values, device=device) for values in batch)


def layers(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    """Two hidden layers."""
    return nn.Sequential(
        nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, outputs)
    )


class Actor(nn.Module):
    """A normal distribution, squashed to [-1, 1] by the hyperbolic tangent."""

    def __init__(self, observation_size: int, action_size: int, hidden: int) -> None:
        """Make a network with two outputs per action component: mean and log standard deviation."""
        super().__init__()
        self.net = layers(observation_size, hidden, 2 * action_size)

    def forward(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        """Random actions (n, A), and their log densities (n,)."""
        mean, log_std = self.net(observations).chunk(2, dim=-1)
        normal = torch.distributions.Normal(mean, log_std.clamp(-20.0, 2.0).exp())
        drawn = normal.rsample()
        # log(1 - tanh(x)^2), in a form that stays accurate where tanh is flat.
        squash = 2.0 * (np.log(2.0) - drawn - functional.softplus(-2.0 * drawn))
        return torch.tanh(drawn), (normal.log_prob(drawn) - squash).sum(dim=-1)

    def act(self, observations: Tensor) -> Tensor:
        """The mean actions (n, A)."""
        return torch.tanh(self.net(observations).chunk(2, dim=-1)[0])


class Critics(nn.Module):
    """Two estimates of the value of an action."""

    def __init__(self, observation_size: int, action_size: int, hidden: int) -> None:
        """Make two networks that share nothing."""
        super().__init__()
        self.nets = nn.ModuleList(layers(observation_size + action_size, hidden, 1) for _ in range(2))

    def forward(self, observations: Tensor, actions: Tensor) -> Tensor:
        """(2, n) both estimates."""
        inputs = torch.cat([observations, actions], dim=-1)
        return torch.stack([net(inputs).squeeze(-1) for net in self.nets])


def entries(envs: Any, leave_out: tuple[str, ...]) -> np.ndarray:
    """Indices of the observation's entries that the agent sees."""
    slices = envs.unwrapped.observation_builder.slices
    unknown = sorted(set(leave_out) - set(slices))
    if unknown:
        raise ValueError(f"leave_out must be of {sorted(slices)}, got {unknown}")
    return np.concatenate([np.arange(part.start, part.stop) for name, part in slices.items() if name not in leave_out])


def evaluate(arguments: Arguments, actor: Actor, norm: RunningNorm) -> tuple[float, float]:
    """Success rate and mean return of unseen episodes, with the mean action."""
    envs = gym.make_vec(
        arguments.env_id,
        num_envs=arguments.eval_episodes,
        max_episode_steps=arguments.max_episode_steps,
        autoreset_mode="disabled",
    )
    seen = entries(envs, arguments.leave_out)
    observations, _ = envs.reset(seed=1_000_000)
    returns, ended, success = (np.zeros(envs.num_envs), *np.zeros((2, envs.num_envs), bool))
    while not ended.all():
        with torch.no_grad():
            actions = actor.act(torch.as_tensor(norm(observations[:, seen]), device=arguments.device)).cpu().numpy()
        observations, rewards, terminations, truncations, infos = envs.step(actions)
        returns += np.where(ended, 0.0, rewards)
        success = np.where(ended, success, infos["is_success"])
        done = terminations | truncations
        ended |= done
        if done.any() and not ended.all():
            observations, _ = envs.reset(options={"reset_mask": done})
    envs.close()
    return float(success.mean()), float(returns.mean())


def main(arguments: Arguments) -> dict[str, float]:
    """Train an agent; the returned results are also the last line of the output."""
    torch.manual_seed(arguments.seed)
    rng = np.random.default_rng(arguments.seed)
    device = arguments.device
    envs: Any = gym.make_vec(
        arguments.env_id,
        num_envs=arguments.num_envs,
        max_episode_steps=arguments.max_episode_steps,
        autoreset_mode="same_step",
    )
    seen = entries(envs, arguments.leave_out)
    action_size = envs.single_action_space.shape[0]
    norm, replay = RunningNorm(len(seen)), Replay(arguments.buffer_size, len(seen), action_size)
    actor = Actor(len(seen), action_size, arguments.hidden).to(device)
    critics = Critics(len(seen), action_size, arguments.hidden).to(device)
    targets = Critics(len(seen), action_size, arguments.hidden).to(device)
    targets.load_state_dict(critics.state_dict())
    log_temperature = torch.tensor(np.log(arguments.initial_temperature), dtype=torch.float32, device=device)
    log_temperature.requires_grad_()
    actor_optimizer = torch.optim.Adam(actor.parameters(), arguments.learning_rate)
    critic_optimizer = torch.optim.Adam(critics.parameters(), arguments.learning_rate)
    temperature_optimizer = torch.optim.Adam([log_temperature], arguments.learning_rate)

    def update() -> None:
        now, actions, rewards, later, terminations = replay.sample(rng, arguments.batch_size, norm, device)
        temperature = log_temperature.detach().exp()
        with torch.no_grad():
            next_actions, next_densities = actor(later)
            worth = targets(later, next_actions).min(dim=0).values - temperature * next_densities
            wanted = rewards + arguments.gamma * (1.0 - terminations) * worth
        critic_loss = (critics(now, actions) - wanted).pow(2).mean(dim=1).sum()
        critic_optimizer.zero_grad()
        critic_loss.backward()
        critic_optimizer.step()

        drawn, densities = actor(now)
        actor_loss = (temperature * densities - critics(now, drawn).min(dim=0).values).mean()
        actor_optimizer.zero_grad()
        actor_loss.backward()
        actor_optimizer.step()

        # The target entropy is minus the number of action components: a greater entropy lowers the temperature.
        temperature_loss = log_temperature.exp() * (action_size - densities.detach().mean())
        temperature_optimizer.zero_grad()
        temperature_loss.backward()
        temperature_optimizer.step()

        with torch.no_grad():
            for target, source in zip(targets.parameters(), critics.parameters(), strict=True):
                target.lerp_(source, arguments.tau)

    began = time.perf_counter()
    successes: deque[bool] = deque(maxlen=100)
    observations = envs.reset(seed=arguments.seed)[0][:, seen]
    norm.update(observations)
    steps = 0
    while steps < arguments.total_steps:
        if steps < arguments.learning_starts:
            actions = rng.uniform(-1.0, 1.0, (arguments.num_envs, action_size)).astype(np.float32)
        else:
            with torch.no_grad():
                actions = actor(torch.as_tensor(norm(observations), device=device))[0].cpu().numpy()
        following, rewards, terminations, truncations, infos = envs.step(actions)
        following = following[:, seen]
        steps += arguments.num_envs
        # Where an episode has ended, `following` is the first observation of the next one; the last one is kept
        # separately.
        reached = following.copy()
        ended = terminations | truncations
        for world in np.flatnonzero(ended):
            reached[world] = infos["final_obs"][world][seen]
            successes.append(bool(infos["final_info"]["is_success"][world]))
        replay.add(observations, reached, actions, rewards, terminations)
        norm.update(reached)
        observations = following
        if steps >= arguments.learning_starts:
            for _ in range(arguments.gradient_steps):
                update()
        if ended.any():
            rate, temperature = np.mean(successes), log_temperature.exp().item()
            print(
                f"{steps:8d} steps  {time.perf_counter() - began:6.0f} s  success {rate:.2f}  {temperature=:.3f}",
                flush=True,
            )
            if arguments.success_target is not None and len(successes) == 100 and rate >= arguments.success_target:
                break
    seconds = time.perf_counter() - began
    envs.close()
    success, episode_return = evaluate(arguments, actor, norm)
    if arguments.output is not None:
        weights = {name: value.cpu() for name, value in actor.state_dict().items()}
        torch.save(
            {"actor": weights, "mean": torch.tensor(norm.mean), "variance": torch.tensor(norm.variance)},
            arguments.output,
        )
    result = {"steps": steps, "seconds": round(seconds, 1), "success": success, "return": round(episode_return, 3)}
    print(json.dumps(result))
    return result


if __name__ == "__main__":
    main(tyro.cli(Arguments))
