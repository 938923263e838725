"""Can the tasks be solved, and not by chance, by haste or by evasion?

For each task and engine, the benchmark reports how often the scripted expert, the expert in haste and a random policy
succeed, how often they stay within the cost budget, the forces, pressures and costs, and the number of control steps
per second. An episode ends with success or after 200 steps. Forces, pressures and costs are given as median and maximum
over the episodes. The speed is that of stepping alone. With Bullet, episodes run in several processes, one after the
other in each; with the other engines, all at once. With `--cheaters`, it compares the returns of policies that evade
the tasks with the expert's; see `benchmarks.cheaters`.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from benchmarks import cheaters
from benchmarks.measure import finish, installed, load_average, parser
from benchmarks.parallel import available_cores, results
from spatula_env import TASKS
from spatula_env.engines import OF_EXTRAS
from spatula_env.learning import experts

ENGINES = ("batch", "tissue", "mujoco", "bullet")
POLICIES = ("expert", "hasty", "random")

EXPERT_LIMIT, RANDOM_LIMIT = 0.95, 0.05
"""Least rate of success of the expert, and greatest of the random policy."""

CAREFUL_LIMIT, HASTY_LIMIT = 0.95, 0.2
"""Least share of the expert's episodes within the cost budget, and greatest share of the hasty policy's."""

HASTE = 4.0
"""Factor on the expert's actions for the hasty policy; actions are clipped to the limits of the control."""

CHUNK = 10
"""Number of episodes of a job with Bullet."""

TOGETHER = ("batch", "tissue")
"""Engines that step all worlds together and use all cores by themselves."""

QUANTITIES = {
    "peak_force": ("episode_peak_force", "N"),
    "peak_pressure": ("episode_peak_pressure", "Pa"),
    "cost": ("episode_cost", "s"),
    "dose": ("episode_dose", "Pa s"),
}
"""Quantities reported for the episodes: key in `info`, read at the end of an episode, and unit."""


@dataclass(frozen=True)
class Job:
    """Some episodes of a task.

    Attributes:
        task: Name of the task.
        engine: "batch", "tissue", "mujoco" or "bullet".
        policy: "expert", "hasty" or "random".
        seeds: Seeds of the episodes.
    """

    task: str
    engine: str
    policy: str
    seeds: tuple[int, ...]


@dataclass(frozen=True)
class Episodes:
    """Results of some episodes; lists have an item for each episode.

    Attributes:
        success: Whether it succeeded.
        steps: Control steps until success, or until its end.
        diverged: Whether the physics diverged.
        violated: Whether the pressure was above the limit in any step.
        careful: Whether the cost was within the task's budget.
        quantities: Final value of each of `QUANTITIES`.
        step_count: Number of timed control steps, of all worlds, those that have finished included.
        seconds: How long they took [s].
    """

    success: list[bool]
    steps: list[int]
    diverged: list[bool]
    violated: list[bool]
    careful: list[bool]
    quantities: dict[str, list[float]]
    step_count: int
    seconds: float


def run_job(job: Job) -> Episodes:
    """Run the episodes of a job, one in each world of a vector environment."""
    envs = gymnasium.make_vec(
        f"Spatula/{job.task}-v0", num_envs=len(job.seeds), engine=job.engine, autoreset_mode="disabled"
    )
    try:
        return _run(envs, job)
    finally:
        envs.close()


def _run(envs: Any, job: Job) -> Episodes:
    count = len(job.seeds)
    generators = [np.random.default_rng([seed, 1]) for seed in job.seeds]
    act = None if job.policy == "random" else getattr(experts, f"{job.task}Expert")(envs)
    haste = HASTE if job.policy == "hasty" else 1.0
    observation, infos = envs.reset(seed=list(job.seeds))
    over, success, diverged = (np.zeros(count, dtype=bool) for _ in range(3))
    steps = np.zeros(count, dtype=int)
    violated = np.zeros(count, dtype=bool)
    last = {name: np.zeros(count) for name in QUANTITIES}
    seconds, step_count = 0.0, 0
    size = envs.single_action_space.shape[0]
    while not over.all():
        if act is not None:
            actions = np.clip(haste * act(observation), -1.0, 1.0).astype(np.float32)
        else:
            actions = np.stack([generator.uniform(-1.0, 1.0, size) for generator in generators]).astype(np.float32)
        start = time.perf_counter()
        observation, _, terminated, truncated, infos = envs.step(actions)
        seconds += time.perf_counter() - start
        step_count += count
        going = ~over
        steps[going] += 1
        diverged |= going & infos["diverged"]
        success |= going & infos["is_success"]
        violated |= going & infos["violation"].astype(bool)
        for name, (key, _) in QUANTITIES.items():
            last[name][going] = infos[key][going]
        over |= success | terminated | truncated
        if (terminated | truncated).any() and not over.all():
            # A world whose episode is over is reset so that the others can go on; it does not count any more.
            observation, _ = envs.reset(options={"reset_mask": terminated | truncated})
    careful = last["cost"] <= envs.unwrapped.task.cost_budget
    return Episodes(
        success.tolist(), steps.tolist(), diverged.tolist(), violated.tolist(), careful.tolist(),
        {name: values.tolist() for name, values in last.items()}, step_count, seconds,
    )  # fmt: skip


def summarize(parts: Iterable[Episodes]) -> dict[str, Any]:
    """Summarise all episodes of a task, an engine and a policy."""
    chunks = list(parts)
    success = np.concatenate([part.success for part in chunks])
    steps = np.concatenate([part.steps for part in chunks])
    summary: dict[str, Any] = {
        "episodes": len(success),
        "success": float(success.mean()),
        "steps_to_success": float(np.median(steps[success])) if success.any() else None,
        "violation_rate": float(np.concatenate([part.violated for part in chunks]).mean()),
        "within_budget": float(np.concatenate([part.careful for part in chunks]).mean()),
        "non_finite": int(np.concatenate([part.diverged for part in chunks]).sum()),
        "steps_per_second": sum(part.step_count for part in chunks) / sum(part.seconds for part in chunks),
    }
    for name, (_, unit) in QUANTITIES.items():
        values = np.concatenate([part.quantities[name] for part in chunks])
        summary[name] = {"median": float(np.median(values)), "max": float(values.max()), "unit": unit}
    return summary


def plan(tasks: Iterable[str], engines: Iterable[str], policies: Iterable[str], episodes: int, seed: int) -> list[Job]:
    """Plan the jobs: engines in `TOGETHER` run all episodes of a task in one job, others in chunks of `CHUNK`."""
    jobs = []
    for task in tasks:
        for engine in engines:
            for policy in policies:
                seeds = tuple(range(seed, seed + episodes))
                size = episodes if engine in TOGETHER else CHUNK
                jobs += [Job(task, engine, policy, seeds[first : first + size]) for first in range(0, episodes, size)]
    return jobs


def measure(jobs: list[Job], workers: int) -> dict[str, dict[str, dict[str, Any]]]:
    """Run all jobs; returns the figures by task, engine and policy."""
    found: dict[tuple[str, str, str], list[Episodes]] = {}
    together = [job for job in jobs if job.engine in TOGETHER]
    others = [job for job in jobs if job.engine not in TOGETHER]
    for chosen, processes in ((together, 1), (others, workers)):
        if not chosen:
            continue
        with closing(results(run_job, chosen, processes, "episodes")) as stream:
            for job, episodes in stream:
                found.setdefault((job.task, job.engine, job.policy), []).append(episodes)
    table: dict[str, dict[str, dict[str, Any]]] = {}
    for job in jobs:
        entry = table.setdefault(job.task, {}).setdefault(job.engine, {})
        if job.policy not in entry:
            entry[job.policy] = summarize(found[job.task, job.engine, job.policy])
    return table


def passed(table: dict[str, dict[str, dict[str, Any]]]) -> bool:
    """Whether every expert is good and careful enough, the other policies are not, and nothing has diverged."""

    def is_as_it_should_be(policy: str, row: dict[str, Any]) -> bool:
        if row["non_finite"]:
            return False
        if policy == "expert":
            return bool(row["success"] >= EXPERT_LIMIT and row["within_budget"] >= CAREFUL_LIMIT)
        return bool(row["within_budget"] <= HASTY_LIMIT if policy == "hasty" else row["success"] <= RANDOM_LIMIT)

    return all(
        is_as_it_should_be(policy, row)
        for engines in table.values()
        for policies in engines.values()
        for policy, row in policies.items()
    )


def show(table: dict[str, dict[str, dict[str, Any]]]) -> None:
    """Print a table."""
    print(
        f"{'task':8} {'engine':6} {'policy':6} {'success':>7} {'steps':>5} {'force N':>15} {'pressure kPa':>15} "
        f"{'cost ms':>17} {'budget':>7} {'dose Pa s':>17} {'> 4 kPa':>7} {'steps/s':>8}"
    )
    for task, engines in table.items():
        for engine, policies in engines.items():
            for policy, row in policies.items():
                force, pressure, cost, dose = (row[name] for name in QUANTITIES)
                steps = f"{row['steps_to_success']:.0f}" if row["steps_to_success"] is not None else "-"
                print(
                    f"{task:8} {engine:6} {policy:6} {100 * row['success']:6.0f}% {steps:>5} "
                    f"{force['median']:7.2f}/{force['max']:7.2f} "
                    f"{pressure['median'] / 1e3:7.2f}/{pressure['max'] / 1e3:7.1f} "
                    f"{1e3 * cost['median']:8.1f}/{1e3 * cost['max']:8.0f} {100 * row['within_budget']:6.0f}% "
                    f"{dose['median']:8.1f}/{dose['max']:8.0f} {100 * row['violation_rate']:6.0f}% "
                    f"{row['steps_per_second']:8.0f}"
                )


def report_cheaters(tasks: Sequence[str], engines: Sequence[str], episodes: int, seed: int, *, quiet: bool) -> None:
    """Measure and print the returns of cheaters."""
    start = time.perf_counter()
    rows = cheaters.measure(tasks, engines, episodes, seed)
    if not quiet:
        cheaters.show(rows)
    finish(
        {
            "benchmark": "cheaters",
            "passed": all(row["ahead"] for row in rows),
            "episodes": episodes,
            "rows": rows,
            "seconds": time.perf_counter() - start,
        }
    )


def report_one(
    tasks: Sequence[str], engines: Sequence[str], name: str, episodes: int, seed: int, *, quiet: bool
) -> None:
    """Count and print the successes of one cheater."""
    start = time.perf_counter()
    table = {
        task: {engine: cheaters.count_successes(task, engine, name, episodes, seed) for engine in engines}
        for task in tasks
    }
    for task, row in table.items() if not quiet else ():
        for engine, found in row.items():
            print(
                f"{task:8} {engine:6} {name}: {found['successes']} of {found['episodes']} episodes succeed, "
                f"{found['within']} are within tolerance in any step, {found['at_reset']} at the reset"
            )
    finish(
        {
            "benchmark": "cheaters",
            "only": name,
            "passed": all(found["successes"] == 0 for row in table.values() for found in row.values()),
            "tasks": table,
            "seconds": time.perf_counter() - start,
        }
    )


def main() -> None:
    """Measure and print."""
    options = parser(__doc__ or "")
    options.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    options.add_argument(
        "--engines", nargs="+", choices=ENGINES, default=[each for each in ENGINES if each not in OF_EXTRAS]
    )
    options.add_argument("--policies", nargs="+", choices=POLICIES, default=list(POLICIES))
    options.add_argument("--episodes", type=int, default=100)
    options.add_argument("--seed", type=int, default=0, help="of the first episode")
    options.add_argument("--workers", type=int, default=available_cores(), help="processes with Bullet")
    options.add_argument("--cheaters", action="store_true", help="what policies earn that evade the tasks")
    options.add_argument("--only", metavar="NAME", help="with --cheaters: how often this one succeeds, such as hover")
    arguments = options.parse_args()
    if arguments.only and not arguments.cheaters:
        options.error("argument --only: needs --cheaters")
    if arguments.episodes < 1:
        options.error(f"argument --episodes: must be at least 1, got {arguments.episodes}")
    engines = installed(arguments.engines)
    if arguments.only:
        report_one(arguments.tasks, engines, arguments.only, arguments.episodes, arguments.seed, quiet=arguments.json)
        return
    if arguments.cheaters:
        report_cheaters(arguments.tasks, engines, arguments.episodes, arguments.seed, quiet=arguments.json)
        return
    jobs = plan(arguments.tasks, engines, arguments.policies, arguments.episodes, arguments.seed)
    start = time.perf_counter()
    table = measure(jobs, arguments.workers)
    if not arguments.json:
        show(table)
    finish(
        {
            "benchmark": "tasks",
            "passed": passed(table),
            "limits": {
                "expert": EXPERT_LIMIT,
                "random": RANDOM_LIMIT,
                "careful": CAREFUL_LIMIT,
                "hasty": HASTY_LIMIT,
            },
            "tasks": table,
            "load": load_average(),
            "seconds": time.perf_counter() - start,
        }
    )


if __name__ == "__main__":
    main()
