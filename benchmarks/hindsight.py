"""Is hindsight relabelling true: would the episode have gone the same way with the relabelled goal as its goal?

In each task with the goal interface, a noisy expert acts. As in hindsight experience replay, the achieved goal of one
step of each episode becomes its goal; the step is drawn from those whose achieved goal is a valid goal. The actions are
then repeated in an episode with the same seed and that goal. Exactly those steps that `compute_reward` counts as a
success with the relabelled goal must be within tolerance there.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from benchmarks.measure import finish, parser
from spatula_env import TASKS
from spatula_env.learning import experts

STEPS = 60
"""Control steps of an episode."""

NOISE = 0.3
"""Standard deviation of the noise that is added to the expert's actions."""

WORLDS = 50
"""Number of episodes that are played at a time."""


def tasks_with_hindsight() -> list[str]:
    """Names of the tasks that have the goal interface."""
    found = []
    for name in TASKS:
        env: Any = gymnasium.make_vec(f"Spatula/{name}-v0", num_envs=1, reward="sparse")
        if env.unwrapped.task.hindsight:
            found.append(name)
        env.close()
    return found


def compare(env: Any, task: str, seeds: Sequence[int]) -> dict[str, int]:
    """Play episodes, relabel them, and play them again.

    Args:
        env: Vector environment of the task with `reward="sparse"`, of as many worlds as there are seeds.
        task: Name of the task.
        seeds: Seeds of the episodes.

    Returns:
        Counts: "episodes" that could be relabelled; "claimed", steps that count as successes in hindsight; "denied",
        those of them that are not within tolerance in the environment; and "missed", steps within tolerance that
        hindsight does not count.
    """
    made, generator = env.unwrapped, np.random.default_rng([seeds[0], 4])
    expert = getattr(experts, f"{task}Expert")(env)
    observation, _ = env.reset(seed=list(seeds))
    actions, achieved = [], []
    for _ in range(STEPS):
        noise = NOISE * generator.standard_normal(env.action_space.shape)
        actions.append(np.clip(expert(observation) + noise, -1.0, 1.0).astype(np.float32))
        observation, *_ = env.step(actions[-1])
        achieved.append(observation["achieved_goal"].astype(np.float64))
    reached = np.stack(achieved)
    goals, possible = made.goals.copy(), np.zeros(len(seeds), dtype=np.bool_)
    for world in range(len(seeds)):
        askable = [goal for goal in reached[:, world] if _may_be_asked(made.task, goal)]
        if askable:
            goals[world], possible[world] = askable[generator.integers(len(askable))], True
    claimed = made.compute_reward(reached, np.broadcast_to(goals, reached.shape), None) == 0.0
    env.reset(seed=list(seeds), options={"goal": goals})
    counts = {"episodes": int(possible.sum()), "claimed": 0, "denied": 0, "missed": 0}
    for step, action in enumerate(actions):
        *_, infos = env.step(action)
        within = infos["within_tolerance"]
        counts["claimed"] += int((claimed[step] & possible).sum())
        counts["denied"] += int((claimed[step] & ~within & possible).sum())
        counts["missed"] += int((~claimed[step] & within & possible).sum())
    return counts


def _may_be_asked(task: Any, goal: Any) -> bool:
    try:
        task.check_goal(goal)
    except ValueError:
        return False
    return True


def measure(task: str, engine: str, episodes: int, seed: int) -> dict[str, int]:
    """The sums of `compare` over many episodes."""
    total = {"episodes": 0, "claimed": 0, "denied": 0, "missed": 0}
    worlds = min(WORLDS, episodes)
    env = gymnasium.make_vec(
        f"Spatula/{task}-v0", num_envs=worlds, engine=engine, reward="sparse", autoreset_mode="disabled"
    )
    try:
        for first in range(seed, seed + episodes, worlds):
            for name, count in compare(env, task, range(first, first + worlds)).items():
                total[name] += count
    finally:
        env.close()
    return total


def main() -> None:
    """Measure and print."""
    options = parser(__doc__ or "")
    options.add_argument("--tasks", nargs="+", choices=TASKS, help="default: those that offer hindsight")
    options.add_argument("--engine", default="batch")
    options.add_argument("--episodes", type=int, default=1000, help="in each task; default: %(default)s")
    options.add_argument("--seed", type=int, default=0, help="of the first episode")
    arguments = options.parse_args()
    start = time.perf_counter()
    table = {
        task: measure(task, arguments.engine, arguments.episodes, arguments.seed)
        for task in arguments.tasks or tasks_with_hindsight()
    }
    if not arguments.json:
        for task, row in table.items():
            print(
                f"{task:8} {row['episodes']} episodes relabelled: of {row['claimed']} steps of success {row['denied']} "
                f"denied, {row['missed']} missed"
            )
    finish(
        {
            "benchmark": "hindsight",
            "passed": all(row["denied"] == row["missed"] == 0 < row["claimed"] for row in table.values()),
            "tasks": table,
            "seconds": time.perf_counter() - start,
        }
    )


if __name__ == "__main__":
    main()
