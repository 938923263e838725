"""Two programs write into one dataset, and one of them is killed again and again: are all confirmed episodes there?

A program prints the number of each episode after `DatasetWriter.add` has returned, which confirms it. After each kill
another program takes the killed one's place. In the end every confirmed episode must be in the dataset exactly once,
whole and readable. Each program may have added one more episode that it had no time to confirm.
"""

from __future__ import annotations

import itertools
import pickle
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.growth.datasets import episodes_of, play
from benchmarks.growth.fitting import tell
from spatula_env import data
from spatula_env.data.dataset import dataset_folder
from spatula_env.data.replaying import open_dataset, read_entries

KILLED = "growth/killed-v0"
STEPS = 20
"""Steps of an episode."""
BLOCK = 100_000
"""Number of seeds reserved for each program; more than it can use up."""
TAPE = "tape.pickle"
"""File in the folder of the datasets with the episode that the programs write."""
LONGEST_WAIT = 0.3
"""Longest time from a program's first episode to the kill [s]."""


@dataclass(frozen=True)
class Killing:
    """Result of the measurement.

    Attributes:
        kills: Number of programs that were killed while others went on.
        told: Number of episodes that were confirmed.
        found: Number of episodes in the dataset.
        lost: Confirmed episodes that are not in the dataset.
        twice: Surplus copies of episodes.
        damaged: Episodes that differ from what was written.
        left_behind: Temporary files that are still there after another writer has opened the dataset.
        seconds: Duration of the measurement [s].
    """

    kills: int
    told: int
    found: int
    lost: int
    twice: int
    damaged: int
    left_behind: int
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether nothing is lost, doubled, damaged or left, and each program has at most one unconfirmed episode."""
        untold = self.found - self.told
        return not (self.lost or self.twice or self.damaged or self.left_behind) and untold <= self.kills + 2


def write(root: Path, first: int) -> None:
    """Act as one of the programs: add episodes, and confirm each, until the process is killed."""
    env, episode = pickle.loads((root / TAPE).read_bytes())
    writer = data.DatasetWriter(KILLED, env, root=root)
    for seed in itertools.count(first):
        # The rewards identify the episode later.
        writer.add(replace(episode, seed=seed, rewards=np.full(len(episode), float(seed))))
        print(seed, flush=True)


def measure_killing(kills: int, seed: int = 0) -> dict[str, Any]:
    """Kill programs at random moments, and examine the dataset.

    Args:
        kills: Number of kills.
        seed: Seed of the random moments.
    """
    generator = np.random.default_rng(seed)
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        env, played = play(1, STEPS)
        episode = next(episodes_of(env, played))
        # All that a writer needs of an environment. Without physics, programs start fast and spend their time writing.
        known = SimpleNamespace(spec=env.spec, observation_space=env.observation_space, action_space=env.action_space)
        (root / TAPE).write_bytes(pickle.dumps((known, episode)))
        told: set[int] = set()
        programs = [_begin(root, block) for block in range(2)]
        try:
            for kill in range(kills):
                which = int(generator.integers(2))
                told.update(_first_of(programs[which]))
                time.sleep(generator.uniform(0.0, LONGEST_WAIT))
                told.update(_end(programs[which]))
                programs[which] = _begin(root, kill + 2)
                if (kill + 1) % 10 == 0:
                    tell(f"killed {kill + 1} of {kills}; {len(told)} episodes told")
            for program in programs:
                # Wait until the last two programs have written an episode, too.
                told.update(_first_of(program))
        finally:
            for program in programs:
                told.update(_end(program))
        found = _look(root, episode, kills, told, start)
    return {**asdict(found), "passed": found.passed}


def _begin(root: Path, block: int) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "benchmarks.growth.killing", str(root), str(block * BLOCK)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def _first_of(program: subprocess.Popen[str]) -> list[int]:
    """Wait until a program confirms an episode, and return its number in a list."""
    assert program.stdout is not None
    line = program.stdout.readline()
    if not line:
        raise RuntimeError(f"a program that should write until it is killed has ended with {program.wait()}")
    return [int(line)]


def _end(program: subprocess.Popen[str]) -> list[int]:
    """Kill a program, and return the numbers of all further episodes that it has confirmed."""
    program.kill()
    rest, _ = program.communicate()
    return [int(line) for line in rest.splitlines(keepends=True) if line.endswith("\n")]


def _look(root: Path, episode: Any, kills: int, told: set[int], start: float) -> Killing:
    env, _ = pickle.loads((root / TAPE).read_bytes())
    # Opening the dataset once more removes files that were left incomplete.
    data.DatasetWriter(KILLED, env, root=root)
    seeds = [entry.seed for entry in read_entries(KILLED, root)]
    damaged = 0
    for seed, found in zip(seeds, open_dataset(KILLED, root).iterate_episodes(), strict=True):
        damaged += not (np.all(found.rewards == seed) and np.array_equal(found.actions, episode.actions))
    return Killing(
        kills=kills,
        told=len(told),
        found=len(seeds),
        lost=len(told - set(seeds)),
        twice=len(seeds) - len(set(seeds)),
        damaged=damaged,
        left_behind=len(list(dataset_folder(KILLED, root).rglob("*.new"))),
        seconds=time.perf_counter() - start,
    )


if __name__ == "__main__":
    write(Path(sys.argv[1]), int(sys.argv[2]))
