"""The cost of recording, listing, opening, reading and merging as datasets grow, in processor time unless stated.

Episodes are short copies of a few that a script has played, with other seeds, as only the dataset is timed.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from benchmarks.growth.fitting import cpu_seconds, growth, tell
from spatula_env import data
from spatula_env.data.replaying import open_dataset

ENVIRONMENT = "Spatula/Press-v0"
STEPS = 50
"""Steps of an episode."""
PLAYED = 8
"""Number of different episodes that are played."""
MILESTONES = (100, 300, 1_000, 3_000, 10_000)
"""Sizes of the dataset [episodes] at which it is summarised, opened and merged."""
COMPARED = 300
"""Number of episodes that are added, in turns, to the large dataset and to a new one."""
LARGE, SMALL, MERGED = "growth/large-v0", "growth/small-v0", "growth/merged-v0"

Played = list[tuple[Any, ...]]


def play(episodes: int = PLAYED, steps: int = STEPS) -> tuple[Any, list[Played]]:
    """Play some episodes by a script.

    Returns:
        The environment; and for each episode the result of its reset, then for each step the action and the results.
    """
    env = gymnasium.make(ENVIRONMENT, engine="batch", max_episode_steps=steps)
    generator = np.random.default_rng(0)
    played = []
    for seed in range(episodes):
        rows: Played = [env.reset(seed=seed)]
        for _ in range(steps):
            action = np.array([*generator.uniform(-0.3, 0.3, 2), -0.5], dtype=np.float32)
            rows.append((action, *env.step(action)))
        played.append(rows)
    return env, played


def episodes_of(env: Any, played: list[Played], first: int = 0) -> Iterator[data.Episode]:
    """Endless iterator of episodes, made by the recorder from played ones, with consecutive seeds.

    Args:
        env: The environment that was played in.
        played: The played episodes, which are repeated in turn.
        first: Seed of the first episode.
    """
    recorder = data.EpisodeRecorder(env, states=False)
    for seed in count(first):
        (observation, info), *rows = played[seed % len(played)]
        recorder.begin(observation, info, seed)
        for row in rows:
            recorder.add(*row)
        yield recorder.finish(operator="scripted", device="tape", success=seed % 2 == 0, engine="batch")


def payload(value: Any) -> int:
    """Size of the numbers and texts in a nested value [bytes]."""
    if isinstance(value, Mapping):
        return sum(map(payload, value.values()))
    return sum(map(len, value)) if isinstance(value, list) else int(np.asarray(value).nbytes)


def measure_datasets(root: Path, milestones: tuple[int, ...] = MILESTONES, compared: int = COMPARED) -> dict[str, Any]:
    """Let a dataset grow, and measure it at several sizes.

    Args:
        root: An empty folder.
        milestones: The sizes, ascending.
        compared: Number of episodes that are added in turns to the large dataset and to a new one.
    """
    env, played = play()
    episodes = episodes_of(env, played)
    first = next(episodes)
    arrays = (first.observations, first.actions, first.rewards, first.terminations, first.truncations, first.infos)
    writer = data.DatasetWriter(LARGE, env, root=root)
    appended: dict[int, float] = {}
    costs: dict[str, dict[int, float]] = {name: {} for name in ("summarized", "opened", "merged")}
    seconds, longest = 0.0, 0.0
    for size in milestones:
        while writer.total_episodes < size:
            episode = next(episodes)
            elapsed = cpu_seconds(partial(writer.add, episode))
            seconds, longest = seconds + elapsed, max(longest, elapsed)
        appended[size] = seconds
        repeats = 3 if size <= 1_000 else 1
        costs["summarized"][size] = cpu_seconds(lambda: data.summarize(LARGE, root), repeats)
        costs["opened"][size] = cpu_seconds(lambda: open_dataset(LARGE, root), repeats)
        target = MERGED.replace("-v0", f"_{size}-v0")
        costs["merged"][size] = cpu_seconds(partial(data.copy_episodes, [LARGE], target, root=root))
        tell(
            f"{size} episodes: {1e3 * seconds / size:.2f} ms to append one, summarized in "
            f"{costs['summarized'][size]:.3f} s, opened in {costs['opened'][size]:.3f} s, merged in "
            f"{costs['merged'][size]:.1f} s"
        )
    found = {name: growth(each, "s", "episodes") for name, each in costs.items()}
    size = (writer.path / "data" / "episodes" / "000000.hdf5").stat().st_size
    return {
        "appended": growth(appended, "s", "episodes"),
        **found,
        "longest_append": longest,
        "append": compare_appends(writer, data.DatasetWriter(SMALL, env, root=root), episodes, compared),
        "payload_bytes": payload(dict(enumerate(arrays))),
        "file_bytes": size,
        "payload_ratio": size / payload(dict(enumerate(arrays))),
        "list": time_list(root),
        "minari": read_with_minari(root, writer.total_episodes),
    }


def compare_appends(large: Any, small: Any, episodes: Iterator[data.Episode], number: int) -> dict[str, float]:
    """Add to a large dataset and to a small one in turns, so that disturbances of the machine affect both.

    Returns:
        Median wall-clock times [ms], their ratio, and the ratio of the median processor times.
    """
    wall: dict[str, list[float]] = {"large": [], "small": []}
    cpu: dict[str, list[float]] = {"large": [], "small": []}
    for _ in range(number):
        episode = next(episodes)
        for name, writer in (("small", small), ("large", large)):
            start = time.perf_counter()
            cpu[name].append(1e3 * cpu_seconds(partial(writer.add, episode)))
            wall[name].append(1e3 * (time.perf_counter() - start))
    medians = {name: float(np.median(values)) for name, values in wall.items()}
    return {
        **medians,
        "ratio": medians["large"] / medians["small"],
        "cpu_ratio": float(np.median(cpu["large"]) / np.median(cpu["small"])),
    }


def time_list(root: Path) -> dict[str, float]:
    """Wall-clock time of `spatula datasets list`, from start to end, and its processor time [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    command = [sys.executable, "-m", "spatula_env.cli", "datasets", "list", "--json", "--root", str(root)]
    subprocess.run(command, check=True, stdout=subprocess.PIPE)
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "seconds": wall,
        "cpu_seconds": after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime,
    }


def read_with_minari(root: Path, expected: int) -> dict[str, Any]:
    """Read all of the large dataset as users of Minari do, and check that it is complete."""
    import minari

    os.environ["MINARI_DATASETS_PATH"] = str(root)
    start = time.perf_counter()
    loaded = minari.load_dataset(LARGE)
    steps = sum(len(episode.rewards) for episode in loaded.iterate_episodes())
    return {
        "episodes": int(loaded.total_episodes),
        "steps": steps,
        "seconds": time.perf_counter() - start,
        "whole": loaded.total_episodes == expected and steps == loaded.total_steps == expected * STEPS,
    }
