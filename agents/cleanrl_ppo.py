"""Proximal policy optimisation in one file, on many worlds at once: to read, copy and change.

    python -m agents.cleanrl_ppo
    python -m agents.cleanrl_ppo --env-id Spatula/Clamp-v0 --total-steps 2000000 --seed 1

The environment begins a new episode in the step after the one that ends an episode (`autoreset_mode="next_step"`,
Gymnasium's default, which its normalising wrappers require). So the observation after a truncation is the episode's
last one, from which the value of the rest is estimated; and the step that begins an episode, which ignores its action,
is not a transition and is left out of learning. The last line of the output is one JSON object. Needs the extra
"train".

Algorithm: J. Schulman et al., Proximal policy optimization algorithms, arXiv:1707.06347 (2017), with generalised
advantages, arXiv:1506.02438 (2015).
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
from gymnasium.wrappers import vector
from torch import Tensor, nn

import spatula_env  # noqa: F401  registers the environments


@dataclass
class Arguments:
    """Proximal policy optimisation on many worlds at once."""

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
    total_steps: int = 512_000
    """Number of steps of all worlds together."""
    rollout_steps: int = 50
    """Number of steps of each world between updates."""
    batch_size: int = 800
    """Number of transitions per optimiser step."""
    epochs: int = 10
    """Number of passes over a rollout."""
    learning_rate: float = 1e-3
    """Initial learning rate of Adam; decreases linearly to zero."""
    gamma: float = 0.95
    """Discount factor."""
    gae_lambda: float = 0.9
    """Parameter of generalised advantage estimation: 0 trusts the critic, 1 the observed rewards."""
    clip: float = 0.2
    """Clipping range of the probability ratio in an update."""
    initial_log_std: float = -0.7
    """Initial log standard deviation of actions, which range from -1 to 1: small enough to leave room for steering."""
    max_grad_norm: float = 0.5
    """Longer gradients are clipped to this norm."""
    hidden: int = 64
    """Number of units in each of the two layers."""
    success_target: float | None = None
    """Training ends when this share of the last 100 episodes has succeeded; None to train for all of total_steps."""
    eval_episodes: int = 100
    """Number of final episodes with the mean action, each in a world of its own."""
    device: str = "cpu"
    """Device of the networks."""
    output: Path | None = None
    """File for the policy's weights and the normalisation, written by `torch.save`."""


def layers(inputs: int, hidden: int, outputs: int, last_gain: float) -> nn.Sequential:
    """Two hidden layers with orthogonal initial weights."""
    net = nn.Sequential(
        nn.Linear(inputs, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh(), nn.Linear(hidden, outputs)
    )
    for layer, gain in zip((net[0], net[2], net[4]), (2**0.5, 2**0.5, last_gain), strict=True):
        assert isinstance(layer, nn.Linear)
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return net


class Agent(nn.Module):
    """A normal distribution of actions, whose standard deviation does not depend on the observation, and a critic."""

    def __init__(self, observation_size: int, action_size: int, hidden: int, log_std: float) -> None:
        """Initialise so that the first actions are close to zero."""
        super().__init__()
        self.actor = layers(observation_size, hidden, action_size, last_gain=0.01)
        self.critic = layers(observation_size, hidden, 1, last_gain=1.0)
        self.log_std = nn.Parameter(torch.full((action_size,), log_std))

    def distribution(self, observations: Tensor) -> torch.distributions.Distribution:
        """Distribution of the actions (n, A)."""
        normal = torch.distributions.Normal(self.actor(observations), self.log_std.exp())
        return torch.distributions.Independent(normal, 1)

    def value(self, observations: Tensor) -> Tensor:
        """Discounted value (n,) of the rest of the episode."""
        return self.critic(observations).squeeze(-1)


def entries(envs: Any, leave_out: tuple[str, ...]) -> np.ndarray:
    """Indices of the observation's entries that the agent sees."""
    slices = envs.unwrapped.observation_builder.slices
    unknown = sorted(set(leave_out) - set(slices))
    if unknown:
        raise ValueError(f"leave_out must be of {sorted(slices)}, got {unknown}")
    return np.concatenate([np.arange(part.start, part.stop) for name, part in slices.items() if name not in leave_out])


def make(arguments: Arguments, num_envs: int) -> Any:
    """Make worlds with the observations that the agent sees, normalised."""
    envs: Any = gym.make_vec(
        arguments.env_id,
        num_envs=num_envs,
        max_episode_steps=arguments.max_episode_steps,
        autoreset_mode="next_step",
    )
    seen, space = entries(envs, arguments.leave_out), envs.single_observation_space
    smaller = gym.spaces.Box(space.low[seen], space.high[seen], dtype=np.float32)
    envs = vector.RecordEpisodeStatistics(envs)
    envs = vector.TransformObservation(
        envs, lambda observations: observations[:, seen], single_observation_space=smaller
    )
    return vector.NormalizeObservation(envs)


def advantages(
    rewards: Tensor, values: Tensor, terminations: Tensor, ended: Tensor, gamma: float, gae_lambda: float
) -> Tensor:
    """Generalised advantage estimates (T, W).

    Args:
        rewards: (T, W) rewards.
        values: (T + 1, W) values of the observations before each step, and of those after the last.
        terminations: (T, W) one where the episode was terminated, so that what follows has no value.
        ended: (T, W) one where the episode is over, so that nothing that follows counts for this step.
        gamma: Discount factor.
        gae_lambda: See `Arguments`.
    """
    result, later = torch.zeros_like(rewards), torch.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        surprise = rewards[t] + gamma * values[t + 1] * (1.0 - terminations[t]) - values[t]
        later = surprise + gamma * gae_lambda * (1.0 - ended[t]) * later
        result[t] = later
    return result


def evaluate(arguments: Arguments, agent: Agent, trained: Any) -> tuple[float, float]:
    """Success rate and mean return of unseen episodes, with the mean action."""
    envs = make(arguments, arguments.eval_episodes)
    envs.obs_rms, envs.update_running_mean = trained.obs_rms, False
    observations, _ = envs.reset(seed=1_000_000)
    returns, ended, success = (np.zeros(envs.num_envs), *np.zeros((2, envs.num_envs), bool))
    while not ended.all():
        with torch.no_grad():
            actions = agent.actor(torch.as_tensor(observations, dtype=torch.float32, device=arguments.device))
        observations, _, terminations, truncations, infos = envs.step(actions.cpu().numpy())
        # Only the first episode of each world counts.
        new = (terminations | truncations) & ~ended
        if new.any():
            returns[new], success[new] = infos["episode"]["r"][new], infos["is_success"][new]
        ended |= new
    envs.close()
    return float(success.mean()), float(returns.mean())


def main(arguments: Arguments) -> dict[str, float]:
    """Train an agent; the returned results are also the last line of the output."""
    torch.manual_seed(arguments.seed)
    device = arguments.device
    normalized = make(arguments, arguments.num_envs)
    envs: Any = vector.NormalizeReward(normalized, gamma=arguments.gamma)
    size, action_size = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    agent = Agent(size, action_size, arguments.hidden, arguments.initial_log_std).to(device)
    optimizer = torch.optim.Adam(agent.parameters(), arguments.learning_rate, eps=1e-5)

    shape = (arguments.rollout_steps, arguments.num_envs)
    seen, drawn = torch.zeros(*shape, size, device=device), torch.zeros(*shape, action_size, device=device)
    densities, rewards, terminations, ended, begins = torch.zeros(5, *shape, device=device)
    values = torch.zeros(shape[0] + 1, shape[1], device=device)

    def tensor(array: np.ndarray) -> Tensor:
        return torch.as_tensor(array, dtype=torch.float32, device=device)

    def roll_out(observation: Tensor, over: Tensor) -> tuple[Tensor, Tensor]:
        """Fill the tensors above; return the next observation (W, size), and (W,) where an episode is over."""
        for t in range(arguments.rollout_steps):
            with torch.no_grad():
                distribution = agent.distribution(observation)
                action = distribution.sample()
                densities[t], values[t] = distribution.log_prob(action), agent.value(observation)
            # The step after an episode's end begins the next one, whatever the action.
            seen[t], drawn[t], begins[t] = observation, action, over
            following, reward, terminated, truncated, infos = envs.step(action.cpu().numpy())
            rewards[t], terminations[t] = tensor(reward), tensor(terminated)
            ended[t] = over = tensor(terminated | truncated)
            observation = tensor(following)
            successes.extend(infos["is_success"][terminated | truncated].tolist())
        with torch.no_grad():
            values[-1] = agent.value(observation)
        return observation, over

    def update() -> None:
        gained = advantages(rewards, values, terminations, ended, arguments.gamma, arguments.gae_lambda)
        wanted = gained + values[:-1]
        real = torch.nonzero(begins.flatten() == 0.0).squeeze(-1)
        flat = [part.flatten(0, 1) for part in (seen, drawn, densities, gained, wanted)]
        for _ in range(arguments.epochs):
            for rows in real[torch.randperm(len(real), device=device)].split(arguments.batch_size):
                now, actions, before, advantage, target = (part[rows] for part in flat)
                distribution = agent.distribution(now)
                ratio = (distribution.log_prob(actions) - before).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std(unbiased=False) + 1e-8)
                clipped = ratio.clamp(1.0 - arguments.clip, 1.0 + arguments.clip)
                actor_loss = -torch.minimum(ratio * advantage, clipped * advantage).mean()
                loss = actor_loss + 0.5 * (agent.value(now) - target).pow(2).mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), arguments.max_grad_norm)
                optimizer.step()

    began = time.perf_counter()
    successes: deque[bool] = deque(maxlen=100)
    observation = tensor(envs.reset(seed=arguments.seed)[0])
    over = torch.zeros(arguments.num_envs, device=device)
    rollouts = -(-arguments.total_steps // (arguments.rollout_steps * arguments.num_envs))
    for rollout in range(rollouts):
        optimizer.param_groups[0]["lr"] = arguments.learning_rate * (1.0 - rollout / rollouts)
        observation, over = roll_out(observation, over)
        update()
        steps = (rollout + 1) * arguments.rollout_steps * arguments.num_envs
        rate = np.mean(successes) if successes else 0.0
        print(f"{steps:8d} steps  {time.perf_counter() - began:6.0f} s  success {rate:.2f}", flush=True)
        if arguments.success_target is not None and len(successes) == 100 and rate >= arguments.success_target:
            break
    seconds = time.perf_counter() - began
    envs.close()
    success, episode_return = evaluate(arguments, agent, normalized)
    if arguments.output is not None:
        weights = {name: value.cpu() for name, value in agent.state_dict().items()}
        mean, variance = (torch.tensor(part) for part in (normalized.obs_rms.mean, normalized.obs_rms.var))
        torch.save({"agent": weights, "mean": mean, "variance": variance}, arguments.output)
    result = {"steps": steps, "seconds": round(seconds, 1), "success": success, "return": round(episode_return, 3)}
    print(json.dumps(result))
    return result


if __name__ == "__main__":
    main(tyro.cli(Arguments))
