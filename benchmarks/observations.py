"""How much of the bounds of their observations do the tasks use, and how often is something clipped?

In each task act the scripted expert with randomised organs and tools, the same in haste without, uniform actions that
are each kept for a while, and violent ones: each number of an action is -1, 0 or 1, kept likewise, with randomised
organs and tools. For each part of the
observation that is measured: which share of the way between its bounds its numbers go through, and in which share of
the control steps one of them is at a bound. A number that no driver moves is constant: there must be none.

The parts of the pose and the velocity are not listed: their bounds are those of the workspace and of the control.
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
"""By how much the hasty driver is faster than the expert, up to what the control allows."""

KEPT_FOR = (5, 40)
"""Control steps for which chance keeps an action: this many, and fewer than that."""

MOVED = ("tool_position", "tool_velocity", "tool_orientation", "tool_rotation_rate", "jaw_opening", "jaw_speed")
"""Parts whose bounds the workspace and the control set."""

TOLD = ("goal", "error", "hold_progress")
"""Parts that follow from what is asked."""

FELT = ("contact_force", "contact_torque", "contact_depth", "normal_force")
"""Parts that no driver may leave the bounds of, or hardly any. Pressures of tissue that cannot give way, and places on
an organ that is pushed away, have no bounds that would be of use: how often they are clipped is told."""

LEAST_USED = 0.05
"""Of the way between the bounds of each measured part, by the expert or in haste."""

MOST_CLIPPED = 0.005
"""Of the control steps of those who keep random actions, in any of `FELT`."""


@dataclass(frozen=True)
class Seen:
    """What a driver saw in some episodes.

    Attributes:
        low: (D,) least of each number.
        high: (D,) greatest.
        clipped: (D,) in how many control steps each was at a bound that is not zero.
        any_clipped: By part, in how many control steps any of its numbers was.
        steps: Control steps, of all worlds.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    clipped: NDArray[np.int64]
    any_clipped: Mapping[str, int]
    steps: int


def chance(kind: str, shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float32]:
    """Actions (W, A) of "kept" or "violent"."""
    drawn = generator.uniform(-1.0, 1.0, shape) if kind == "kept" else generator.integers(-1, 2, shape)
    return np.asarray(drawn, dtype=np.float32)


def ranges_without_noise(env_id: str) -> dict[str, Any]:
    """What is drawn at random by default, but for errors of measurement, which would move every number."""
    entry_point = gymnasium.spec(env_id).vector_entry_point
    assert entry_point is not None
    definition: Any = load_env_creator(entry_point) if isinstance(entry_point, str) else entry_point
    return {name: each for name, each in definition.definition.randomization.items() if name != "sensor_noise"}


def drive(task: str, driver: str, worlds: int, steps: int, seed: int, **options: Any) -> tuple[Seen, Any]:
    """Let a driver act.

    Args:
        task: Its name.
        driver: One of `DRIVERS`.
        worlds: How many, each for one episode.
        steps: Control steps of an episode.
        seed: Of the first world.
        **options: Of the environment.

    Returns:
        What was seen, and the builder of the observations.
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
            # Nothing is clipped at a bound of zero, which is where there is no contact.
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
        "parts": by name, "used" by the one of the expert and the hasty driver that uses more, the share of the way
        between the bounds that the number which goes farthest does; "clipped" by driver, shares of the control steps.
        "constant": names and places of numbers that no driver moves.
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
    """Whether every part uses its bounds, is hardly ever clipped and no number is constant."""
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
