"""Evaluation of policies: runs episodes and measures them."""

from __future__ import annotations

import math
import os
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

import spatula_env
from spatula_env.data.statistics import wilson_interval
from spatula_env.envs.vector import SpatulaVectorEnv
from spatula_env.learning.policies import Policy, PolicySource
from spatula_env.naming import find_spec, vector_spec
from spatula_env.processes import available_cores, in_processes
from spatula_env.render.films import check_film, write_film

gymnasium.register_envs(spatula_env)

Episodes = dict[str, NDArray[Any]]
"""Measures of episodes: an array (n,) for each of the names in `MEASURES`."""

MEASURES = (
    "success",
    "safe_success",
    "return",
    "cost",
    "dose",
    "violation",
    "peak_force",
    "peak_pressure",
    "time_to_success",
    "path_length",
    "steps",
    "diverged",
)
"""Measures of an episode: whether it succeeded, whether it did within the task's cost budget, sum of rewards, of
costs [s] and of doses [Pa s], whether any step had a violation, greatest force [N] and pressure [Pa], time of success
[s] (NaN if none), path length of the tool [m], number of control steps, and whether physics diverged."""

WORLDS_PER_PROCESS = {"batch": 64, "tissue": 64, "bullet": 1}
"""Greatest number of worlds that are stepped together. In Bullet and in third-party engines, worlds are stepped
separately, so that none waits for another."""


@dataclass(frozen=True)
class Plan:
    """What to evaluate a policy on.

    Attributes:
        env_id: Id of the environment, with or without its module, which has to be imported already.
        kwargs: Arguments with which it is made.
        engine: "batch", "tissue", "mujoco" or "bullet".
        episodes: Number of episodes.
        seed: Seed of the first episode's environment; increases by one for each further one.
    """

    env_id: str
    kwargs: Mapping[str, Any]
    engine: str
    episodes: int
    seed: int

    def make(self, num_envs: int, **more: Any) -> SpatulaVectorEnv:
        """Make the environment with many worlds.

        Raises:
            ValueError: If it is not one of this package or built on one.
        """
        env: Any = gymnasium.make_vec(
            vector_spec(self.env_id),
            num_envs=num_envs,
            autoreset_mode="next_step",
            **{**self.kwargs, "engine": self.engine, **more},
        )
        made = env.unwrapped
        if not isinstance(made, SpatulaVectorEnv):
            env.close()
            raise ValueError(f"{self.env_id} must have a vector environment that is a SpatulaVectorEnv, got {made}")
        return made


def run_episodes(
    env: SpatulaVectorEnv,
    policy: Policy,
    seeds: Sequence[int],
    *,
    end_at_success: bool = True,
    watch: Callable[[SpatulaVectorEnv], None] | None = None,
) -> Episodes:
    """Run a policy, one episode for each seed.

    All measures cover the time until success, except the return: it covers the whole episode, as if each step left
    after success had earned the best possible reward. So it does not decrease when an agent becomes faster.

    Args:
        env: In the autoreset mode "next_step", with a step limit.
        policy: The policy.
        seeds: (n,) seeds of the episodes' environments.
        end_at_success: Whether an episode ends when its goal has been held.
        watch: Called with the environment at the beginning and after each step.

    Returns:
        Measures of the n episodes, in the order of the seeds.
    """
    results = []
    count = env.num_envs
    for first in range(0, len(seeds), count):
        chunk = list(seeds[first : first + count])
        # Spare worlds, if there are more worlds than episodes left, run episodes that are not used.
        filled = chunk + [chunk[-1]] * (count - len(chunk))
        results.append(
            {name: values[: len(chunk)] for name, values in _run(env, policy, filled, end_at_success, watch).items()}
        )
    return {name: np.concatenate([result[name] for result in results]) for name in MEASURES}


def _run(
    env: SpatulaVectorEnv,
    policy: Policy,
    seeds: list[int],
    end_at_success: bool,
    watch: Callable[[SpatulaVectorEnv], None] | None,
) -> Episodes:
    """Run one episode in each world."""
    count = env.num_envs
    observation, _ = env.reset(seed=seeds)
    policy.begin(seeds)
    if watch is not None:
        watch(env)
    episodes: Episodes = {name: np.zeros(count) for name in MEASURES}
    episodes["time_to_success"][:] = np.nan
    for name in ("success", "safe_success", "violation", "diverged"):
        episodes[name] = np.zeros(count, dtype=np.bool_)
    going = np.ones(count, dtype=np.bool_)
    position = _tool_position(env, observation)
    while going.any():
        actions = np.where(going[:, None], policy(observation), 0.0)
        observation, rewards, terminated, truncated, infos = env.step(actions)
        if watch is not None:
            watch(env)
        before, position = position, _tool_position(env, observation)
        episodes["return"] += np.where(going, rewards, 0.0)
        episodes["steps"] += going
        episodes["path_length"] += np.where(going, np.sqrt(((position - before) ** 2).sum(axis=1)), 0.0)
        first = going & infos["is_success"] & ~episodes["success"]
        episodes["time_to_success"][first] = infos["time"][first]
        episodes["success"] |= first
        episodes["safe_success"] |= first & infos["is_safe_success"]
        episodes["diverged"] |= going & infos["diverged"]
        # These are sums over the episode so far.
        for name in ("cost", "dose", "peak_force", "peak_pressure"):
            episodes[name] = np.where(going, infos[f"episode_{name}"], episodes[name])
        episodes["violation"] |= going & (infos["episode_violation_time"] > 0.0)
        going &= ~(terminated | truncated)
        done = going & episodes["success"]
        if end_at_success and done.any():
            going &= ~done
            if env.max_episode_steps is not None:
                left = env.max_episode_steps - episodes["steps"]
                episodes["return"] += np.where(done, left * _best_reward(env), 0.0)
            if going.any():
                # Reset finished worlds while the others go on: a world costs least at the start, with the tool in the
                # air.
                observation, _ = env.reset(options={"reset_mask": done})
                position = _tool_position(env, observation)
    return episodes


def evaluate(
    source: PolicySource, plan: Plan, *, processes: int | None = None, end_at_success: bool = True
) -> tuple[Episodes, float]:
    """Run a policy with a suitable number of worlds and processes.

    Args:
        source: Source of the policy.
        plan: What to evaluate it on.
        processes: Number of processes; None for one, which distributes its worlds over threads, in the engines "batch"
            and "tissue", and for one per core in others.
        end_at_success: See `run_episodes`.

    Returns:
        Measures of the episodes, and the number of control steps per second, resets included.
    """
    seeds = [plan.seed + k for k in range(plan.episodes)]
    if processes is None:
        processes = available_cores() if WORLDS_PER_PROCESS.get(plan.engine, 1) == 1 else 1
    processes = max(1, min(processes, len(seeds)))
    if processes == 1:
        episodes, seconds = _evaluate_some(source, plan, seeds, end_at_success)
        return episodes, float(episodes["steps"].sum()) / seconds
    shares = [share.tolist() for share in np.array_split(np.array(seeds), processes)]
    work = partial(_evaluate_some, source, plan, end_at_success=end_at_success)
    prepare = partial(_register, find_spec(plan.env_id))
    # Closing ends the processes at once if this is interrupted.
    with closing(in_processes(work, shares, processes, prepare)) as stream:
        found = dict(stream)
    parts = [found[number] for number in range(len(shares))]
    episodes = {name: np.concatenate([part[0][name] for part in parts]) for name in MEASURES}
    return episodes, float(episodes["steps"].sum()) / max(part[1] for part in parts)


def _register(spec: EnvSpec) -> None:
    """Register in another process an environment that may only have been registered in this one."""
    gymnasium.registry.setdefault(spec.id, spec)


def _evaluate_some(
    source: PolicySource, plan: Plan, seeds: list[int], end_at_success: bool = True
) -> tuple[Episodes, float]:
    """Run some of a plan's episodes in this process; also returns the time they took, without setup [s]."""
    worlds = min(WORLDS_PER_PROCESS.get(plan.engine, 1), len(seeds))
    # Reduce the worlds as far as possible with the same number of rounds.
    worlds = math.ceil(len(seeds) / math.ceil(len(seeds) / worlds))
    env = plan.make(worlds)
    try:
        policy = source.make(env)
        start = time.perf_counter()
        with warnings.catch_warnings():
            # Divergence is counted and reported.
            warnings.filterwarnings("ignore", "physics has diverged", RuntimeWarning)
            episodes = run_episodes(env, policy, seeds, end_at_success=end_at_success)
        return episodes, time.perf_counter() - start
    finally:
        env.close()


def summarize(episodes: Episodes) -> dict[str, Any]:
    """Summarise episodes in plain numbers.

    Args:
        episodes: From `run_episodes`.

    Returns:
        "success_rate" with "success_interval", Wilson's 95 % interval; "safe_success_rate", within the cost budget;
        means of "return" (with "return_deviation"), "cost" [s], "dose" [Pa s], "steps", "path_length" [m];
        "violation_rate", the share of episodes with a violation; means and greatest values of "peak_force" [N] and
        "peak_pressure" [Pa]; mean and median of "time_to_success" [s] over the episodes that succeeded (None if none
        did); "diverged", a number of episodes.
    """
    count = len(episodes["success"])
    successes = int(episodes["success"].sum())
    times = episodes["time_to_success"][episodes["success"]]
    return {
        "episodes": count,
        "success_rate": successes / count,
        "success_interval": list(wilson_interval(successes, count)),
        "safe_success_rate": float(episodes["safe_success"].mean()),
        "return": float(episodes["return"].mean()),
        "return_deviation": float(episodes["return"].std()),
        "cost": float(episodes["cost"].mean()),
        "dose": float(episodes["dose"].mean()),
        "violation_rate": float(episodes["violation"].mean()),
        "peak_force": float(episodes["peak_force"].mean()),
        "peak_force_max": float(episodes["peak_force"].max()),
        "peak_pressure": float(episodes["peak_pressure"].mean()),
        "peak_pressure_max": float(episodes["peak_pressure"].max()),
        "time_to_success": float(times.mean()) if len(times) else None,
        "time_to_success_median": float(np.median(times)) if len(times) else None,
        "path_length": float(episodes["path_length"].mean()),
        "steps": float(episodes["steps"].mean()),
        "diverged": int(episodes["diverged"].sum()),
    }


def film(source: PolicySource, plan: Plan, path: str | os.PathLike[str], episodes: int = 3) -> None:
    """Write a film of some episodes in sequence.

    Args:
        source: Source of the policy.
        plan: What to run it on; the first episodes are shown.
        path: Ends with .mp4 or .gif.
        episodes: Greatest number of episodes.

    Raises:
        ImportError: If the encoder is not installed: the extra "video" for .mp4, "demo" for .gif.
    """
    check_film(Path(path))
    frames: list[NDArray[np.uint8]] = []

    def watch(env: SpatulaVectorEnv) -> None:
        pictures = env.render()
        assert pictures is not None
        frames.append(pictures[0])

    env = plan.make(1, render_mode="rgb_array")
    try:
        policy = source.make(env)
        seeds = [plan.seed + k for k in range(min(episodes, plan.episodes))]
        run_episodes(env, policy, seeds, end_at_success=True, watch=watch)
        rate = env.metadata["render_fps"]
    finally:
        env.close()
    write_film(Path(path), frames, rate)


def _best_reward(env: SpatulaVectorEnv) -> float:
    """Reward of a step in which the goal is held perfectly."""
    if env.settings.reward == "sparse" or env.settings.terminate_on_success:
        return 0.0
    return env.task.best_reward


def _tool_position(env: SpatulaVectorEnv, observation: Any) -> NDArray[np.float64]:
    """(W, 3) observed positions of the tools [m]; the newest of stacked frames."""
    part = env.observation_builder.slices["tool_position"]
    if isinstance(observation, Mapping):
        if "tool_position" in observation:
            numbers, part = observation["tool_position"], slice(None)
        else:
            entry = next(name for name in ("sensors", "state", "observation") if name in observation)
            numbers = observation[entry]
    else:
        numbers = observation
    position = np.asarray(numbers, dtype=np.float64)[..., part]
    return position.reshape(env.num_envs, -1, 3)[:, -1]
