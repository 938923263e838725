"""Two programs that write into one dataset, one of which is killed again and again: is all there that was told?

A program says the number of each episode when `DatasetWriter.add` has returned. After each kill another program takes
the killed one's place. In the end every episode that was told must be there once, whole and readable by Minari; of each
program one may be there that it had no time to tell.
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
"""Of the episodes."""
BLOCK = 100_000
"""Seeds of a program, which it does not get through."""
TAPE = "tape.pickle"
"""In the folder of the datasets: what the programs write."""
LONGEST_WAIT = 0.3
"""Longest time from a program's first episode to the kill [s]."""


@dataclass(frozen=True)
class Killing:
    """The result.

    Attributes:
        kills: How many programs were killed.
        told: Episodes that were said to be there.
        found: Episodes that are there.
        lost: Of those told, how many are not.
        twice: How many are there more than once.
        damaged: How many are not what was written.
        left_behind: Files that were being written, after the next program has begun to write.
        seconds: How long it took.
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
        """Whether nothing is lost, nothing is there twice, and all is whole."""
        untold = self.found - self.told
        return not (self.lost or self.twice or self.damaged or self.left_behind) and untold <= self.kills + 2


def write(root: Path, first: int) -> None:
    """What the programs do: add episodes, and tell each when it is there, until they are killed."""
    env, episode = pickle.loads((root / TAPE).read_bytes())
    writer = data.DatasetWriter(KILLED, env, root=root)
    for seed in itertools.count(first):
        # It is known again by its rewards.
        writer.add(replace(episode, seed=seed, rewards=np.full(len(episode), float(seed))))
        print(seed, flush=True)


def measure_killing(kills: int, seed: int = 0) -> dict[str, Any]:
    """Kill programs at random moments.

    Args:
        kills: How often.
        seed: Of the moments.
    """
    generator = np.random.default_rng(seed)
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        env, played = play(1, STEPS)
        episode = next(episodes_of(env, played))
        # What a writer wants to know of an environment, without the physics: programs are to write, not to start.
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
                # The two that write at last write whole episodes, too.
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
    """Wait for an episode, and return its number."""
    assert program.stdout is not None
    line = program.stdout.readline()
    if not line:
        raise RuntimeError(f"a program that should write until it is killed has ended with {program.wait()}")
    return [int(line)]


def _end(program: subprocess.Popen[str]) -> list[int]:
    """Kill a program, and return what else it has told."""
    program.kill()
    rest, _ = program.communicate()
    return [int(line) for line in rest.splitlines(keepends=True) if line.endswith("\n")]


def _look(root: Path, episode: Any, kills: int, told: set[int], start: float) -> Killing:
    env, _ = pickle.loads((root / TAPE).read_bytes())
    # The next program finds, and clears away, what was left half written.
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
