"""How much of the bounds of their observations do the tasks use, and how often are observations clipped?

Four drivers act in each task: the scripted expert, with randomised organs and tools; the expert in haste, without
randomisation; uniform actions that are kept for a while; and violent actions, whose numbers are -1, 0 or 1 and are kept
for a while too, with randomised organs and tools. For each measured part of the observation, the benchmark reports the
share of the range between its bounds that its numbers cover, and the share of the control steps in which one of them is
at a bound. A number that no driver changes is constant; there must be none.

Pose and velocity are not listed: their bounds are those of the workspace and of the control.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import load_env_creator
from numpy.typing import NDArray

from benchmarks.measure import finish, parser
from spatula_env import TASKS
from spatula_env.learning import experts

DRIVERS = ("expert", "hasty", "kept", "violent")

HASTE = 4.0
"""Factor on the expert's actions for the hasty driver; actions are clipped to the limits of the control."""

KEPT_FOR = (5, 40)
"""Least number of control steps for which a random action is kept, and the greatest number plus one."""

MOVED = ("tool_position", "tool_velocity", "tool_orientation", "tool_rotation_rate", "jaw_opening", "jaw_speed")
"""Parts whose bounds are set by the workspace and the control."""

TOLD = ("goal", "error", "hold_progress")
"""Parts that follow from the task's goal."""

FELT = ("contact_force", "contact_torque", "contact_depth", "normal_force")
"""Parts that may hardly ever reach their bounds under any driver. Pressures of tissue that cannot give way, and places
on an organ that is pushed away, have no useful bounds: how often they are clipped is reported only."""

LEAST_USED = 0.05
"""Least share of the range between the bounds of each measured part that the expert or the hasty driver must cover."""

MOST_CLIPPED = 0.005
"""Greatest share of the control steps in which a part in `FELT` may be clipped; for the expert and in haste it is 0."""


@dataclass(frozen=True)
class Seen:
    """Statistics of the observations of a driver in some episodes.

    Attributes:
        low: (D,) least value of each number.
        high: (D,) greatest value of each number.
        clipped: (D,) number of control steps in which each number was clipped: at a bound, lower bounds of 0 excepted.
        any_clipped: By part, number of control steps in which any of its numbers was clipped.
        steps: Control steps, summed over all worlds.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    clipped: NDArray[np.int64]
    any_clipped: Mapping[str, int]
    steps: int


def chance(kind: str, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float32]:
    """Draw actions (W, A) of the driver "kept" or "violent"."""
    drawn = generator.uniform(-1.0, 1.0, shape) if kind == "kept" else generator.integers(-1, 2, shape)
    return np.asarray(drawn, dtype=np.float32)


def ranges_without_noise(env_id: str) -> dict[str, Any]:
    """The default randomisation of an environment without sensor noise, which would change every number."""
    entry_point = gymnasium.spec(env_id).vector_entry_point
    assert entry_point is not None
    definition: Any = load_env_creator(entry_point) if isinstance(entry_point, str) else entry_point
    return {name: each for name, each in definition.definition.randomization.items() if name != "sensor_noise"}


def drive(task: str, driver: str, worlds: int, steps: int, seed: int, **options: Any) -> tuple[Seen, Any]:
    """Let a driver act.

    Args:
        task: Name of the task.
        driver: One of `DRIVERS`.
        worlds: Number of worlds.
        steps: Control steps in each world; a world whose episode ends earlier is reset and goes on.
        seed: Seed of the first world.
        **options: Further options of the environment.

    Returns:
        Statistics of the observations, and the builder of the observations.
    """
    env_id = f"Spatula/{task}-v0"
    if driver in ("expert", "violent"):
        options = {"randomization": ranges_without_noise(env_id), **options}
    env: Any = gymnasium.make_vec(env_id, num_envs=worlds, autoreset_mode="disabled", **options)
    try:
        builder, space = env.unwrapped.observation_builder, env.single_observation_space
        generator = np.random.default_rng([seed, 5])
        shape = (worlds, env.single_action_space.shape[0])
        expert = getattr(experts, f"{task}Expert")(env) if driver in ("expert", "hasty") else None
        actions, left = chance("kept", shape, generator), np.zeros(worlds, dtype=np.int64)
        observation, _ = env.reset(seed=list(range(seed, seed + worlds)))
        low, high = observation.min(axis=0).astype(np.float64), observation.max(axis=0).astype(np.float64)
        clipped = np.zeros(len(low), dtype=np.int64)
        any_clipped = dict.fromkeys(builder.slices, 0)
        for _ in range(steps):
            if expert is not None:
                faster = HASTE if driver == "hasty" else 1.0
                actions = np.clip(faster * expert(observation), -1.0, 1.0).astype(np.float32)
            else:
                fresh = left <= 0
                actions = np.where(fresh[:, None], chance(driver, shape, generator), actions)
                left = np.where(fresh, generator.integers(*KEPT_FOR, worlds), left) - 1
            observation, _, terminated, truncated, _ = env.step(actions)
            low, high = np.minimum(low, observation.min(axis=0)), np.maximum(high, observation.max(axis=0))
            # A lower bound of zero does not count: parts of contact are zero where there is no contact.
            at_bound = ((observation <= space.low) & (space.low < 0.0)) | (observation >= space.high)
            clipped += at_bound.sum(axis=0)
            for name, part in builder.slices.items():
                any_clipped[name] += int(at_bound[:, part].any(axis=1).sum())
            over = terminated | truncated
            if over.any():
                observation, _ = env.reset(options={"reset_mask": over})
        return Seen(low, high, clipped, any_clipped, worlds * steps), builder
    finally:
        env.close()


def measure(task: str, worlds: int, steps: int, seed: int) -> dict[str, Any]:
    """Let all drivers act in a task.

    Returns:
        "parts": for each part by name, "used", the share of the range between its bounds that its most variable number
        covers under the expert or in haste, whichever is greater; and "clipped", by driver, the share of the control
        steps in which it was clipped. "constant": names and indices of numbers that no driver changes.
    """
    seen: dict[str, Seen] = {}
    builder: Any = None
    for driver in DRIVERS:
        seen[driver], builder = drive(task, driver, worlds, steps, seed)
    parts = {
        part.name: {
            "used": max(
                float(np.max((each.high - each.low)[where] / (part.high - part.low)))
                for each in (seen["expert"], seen["hasty"])
            ),
            "clipped": {driver: each.any_clipped[part.name] / each.steps for driver, each in seen.items()},
        }
        for part, where in zip(builder.parts, builder.slices.values(), strict=True)
        if part.name not in MOVED + TOLD and part.unit != "1"
    }
    low = np.min([each.low for each in seen.values()], axis=0)
    high = np.max([each.high for each in seen.values()], axis=0)
    constant = [
        f"{name}[{place - where.start}]"
        for name, where in builder.slices.items()
        for place in range(where.start, where.stop)
        if low[place] == high[place]
    ]
    return {"parts": parts, "constant": constant}


def passed(table: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether every part uses its bounds and is hardly ever clipped, and no number is constant."""
    return all(
        not row["constant"]
        and all(
            part["used"] >= LEAST_USED
            and max(part["clipped"]["expert"], part["clipped"]["hasty"]) == 0.0
            and (name not in FELT or max(part["clipped"].values()) <= MOST_CLIPPED)
            for name, part in row["parts"].items()
        )
        for row in table.values()
    )


def show(task: str, row: Mapping[str, Any]) -> None:
    """Print what was measured of a task."""
    for name, part in row["parts"].items():
        clipped = "".join(f"{100 * part['clipped'][driver]:15.2f} %" for driver in DRIVERS)
        print(f"{task:8} {name:16} {100 * part['used']:4.0f} %{clipped}")
    print(f"{task:8} constant: {', '.join(row['constant']) or 'none'}", flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    options = parser(__doc__ or "")
    options.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    options.add_argument("--episodes", type=int, default=64, help="of each driver; default: %(default)s")
    options.add_argument("--steps", type=int, default=200, help="of an episode; default: %(default)s")
    options.add_argument("--seed", type=int, default=0, help="of the first episode")
    chosen = options.parse_args(arguments)
    for name in ("episodes", "steps"):
        if getattr(chosen, name) < 1:
            options.error(f"argument --{name}: must be at least 1, got {getattr(chosen, name)}")
    start = time.perf_counter()
    table: dict[str, dict[str, Any]] = {}
    if not chosen.json:
        print(f"{'task':8} {'part':16} {'used':>6}" + "".join(f"{'clipped ' + driver:>17}" for driver in DRIVERS))
    for task in chosen.tasks:
        table[task] = measure(task, chosen.episodes, chosen.steps, chosen.seed)
        if not chosen.json:
            show(task, table[task])
    finish(
        {
            "benchmark": "observations",
            "passed": passed(table),
            "limits": {"used": LEAST_USED, "clipped": MOST_CLIPPED},
            "tasks": table,
            "seconds": time.perf_counter() - start,
        }
    )


if __name__ == "__main__":
    main()
