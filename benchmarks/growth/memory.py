"""What closed or dropped environments leave behind, and memory over long runs; each measured in a fresh process."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from typing import Any, TypeVar

import gymnasium
import numpy as np

from benchmarks.measure import resident_megabytes
from spatula_env import TASKS

Result = TypeVar("Result")

ENDINGS = ("closed", "dropped")
ENVIRONMENTS, SETTLED = 200, 20
"""Number of environments that are made, and interval at which memory is read [environments]."""
WORLDS = 64
"""Number of worlds of the batch engine in a long run."""
LONG_STEPS = {"batch": 1_000_000, "bullet": 100_000}
"""Environment steps of a long run, summed over all worlds, by engine."""
SAMPLES = 100
"""How often memory is read in a long run."""
WARM_UP = 0.1
"""Share of a long run after which memory must stay constant."""
MOST_GROWTH = 5.0
"""Greatest growth of memory [MB]."""


@dataclass(frozen=True)
class Left:
    """What environments leave behind.

    Attributes:
        memory: Memory after every `SETTLED` environments [MB].
        growth: Growth of memory from the first reading to the last [MB].
        clients: PyBullet clients that are still connected.
        descriptors: File descriptors in excess of the first reading.
        threads: Threads in excess of the first reading, those of compiled code included.
        files: Files in the temporary folder.
        seconds: Duration of the measurement [s].
    """

    memory: list[float]
    growth: float
    clients: int
    descriptors: int
    threads: int
    files: int
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether memory grows by no more than `MOST_GROWTH`, and nothing else is left behind."""
        return self.growth <= MOST_GROWTH and not (
            self.clients or self.descriptors > 0 or self.threads > 0 or self.files
        )


@dataclass(frozen=True)
class LongRun:
    """Memory over a long run.

    Attributes:
        steps: Environment steps, summed over all worlds.
        memory: Samples [MB].
        growth: Growth from the end of the warm-up to the end of the run [MB].
        peak_growth: Growth from the end of the warm-up to the greatest later sample [MB].
        seconds: Duration of the run [s].
    """

    steps: int
    memory: list[float]
    growth: float
    peak_growth: float
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether memory grows by no more than `MOST_GROWTH`."""
        return self.growth <= MOST_GROWTH


def in_fresh_process(work: Callable[..., Result], *arguments: Any) -> Result:
    """Call a function in a new process, and return its result."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(work, *arguments).result()


def leave_environments(engine: str, ending: str, count: int = ENVIRONMENTS, settled: int = SETTLED) -> Left:
    """Make environments of all tasks, single and vector ones, use each a little, and close or drop it.

    Args:
        engine: "batch" or "bullet".
        ending: "closed" or "dropped".
        count: Number of environments.
        settled: Interval at which memory is read [environments].
    """
    with tempfile.TemporaryDirectory() as folder:
        os.environ["TMPDIR"], tempfile.tempdir = folder, None
        start = time.perf_counter()
        held = []
        for number in range(count):
            _use(engine, ending, number)
            if (number + 1) % settled == 0 or number + 1 == count:
                held.append(_held())
        memory, descriptors, threads = (list(column) for column in zip(*held, strict=True))
        return Left(
            memory=memory,
            growth=memory[-1] - memory[0],
            clients=_clients(10 * count),
            descriptors=int(descriptors[-1] - descriptors[0]),
            threads=int(threads[-1] - threads[0]),
            files=len(os.listdir(folder)),
            seconds=time.perf_counter() - start,
        )


def _use(engine: str, ending: str, number: int) -> None:
    task = TASKS[number % len(TASKS)]
    several = number // len(TASKS) % 2 == 1
    env: Any = (
        gymnasium.make_vec(f"Spatula/{task}-v0", num_envs=2, engine=engine)
        if several
        else gymnasium.make(f"Spatula/{task}-v0", engine=engine)
    )
    env.reset(seed=number)
    for _ in range(3):
        env.step(env.action_space.sample())
    if ending == "closed":
        env.close()


def _held() -> tuple[float, int, int]:
    """Memory [MB], file descriptors and threads of this process; 0 where the system does not report them."""
    gc.collect()
    _trim()
    counts = [len(os.listdir(place)) if os.path.isdir(place) else 0 for place in ("/proc/self/fd", "/proc/self/task")]
    return resident_megabytes(), counts[0], counts[1]


def _trim() -> None:
    """Make the allocator return free memory; otherwise it sometimes keeps 10 to 30 MB that Bullet has used."""
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def _clients(most: int) -> int:
    """How many PyBullet clients are connected, of the first `most` ids."""
    if "pybullet" not in sys.modules:
        return 0
    import pybullet

    return sum(bool(pybullet.isConnected(client)) for client in range(most))


def run_long(engine: str, steps: int, show: bool = True) -> LongRun:
    """Make random steps, resets included, and watch the memory.

    Args:
        engine: "batch", with many worlds, or "bullet", with one.
        steps: Environment steps, summed over all worlds.
        show: Whether to report progress on standard error.
    """
    task, generator = "Spatula/Press-v0", np.random.default_rng(0)
    count = WORLDS if engine == "batch" else 1
    env: Any = (
        gymnasium.make_vec(task, num_envs=count, engine=engine) if count > 1 else gymnasium.make(task, engine=engine)
    )
    rounds = -(-steps // count)
    marks = {rounds * sample // SAMPLES for sample in range(1, SAMPLES + 1)}
    memory: list[float] = []
    start = time.perf_counter()
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    for number in range(1, rounds + 1):
        if number % 10 == 1:
            # Downwards more often than upwards, so that there is contact.
            action = generator.uniform(-1.0, 1.0, env.action_space.shape).astype(np.float32)
            action[..., 2] -= 0.3
            action = action.clip(-1.0, 1.0)
        _, _, terminated, truncated, _ = env.step(action)
        if count == 1 and (terminated or truncated):
            env.reset()
        if number in marks:
            gc.collect()
            memory.append(round(resident_megabytes(), 3))
            if show and len(memory) % 10 == 0:
                told = f"{engine}: {number * count} of {rounds * count} steps, {memory[-1]:.1f} MB"
                print(told, file=sys.stderr, flush=True)
    env.close()
    warm = memory[max(int(WARM_UP * len(memory)) - 1, 0)]
    after = memory[max(int(WARM_UP * len(memory)) - 1, 0) :]
    return LongRun(rounds * count, memory, memory[-1] - warm, max(after) - warm, time.perf_counter() - start)


def measure_left(engines: list[str], count: int = ENVIRONMENTS) -> dict[str, Any]:
    """Measure what environments leave behind, for each engine and each ending."""
    found: dict[str, Any] = {}
    for engine in engines:
        for ending in ENDINGS:
            print(f"{count} environments of {engine}, {ending}", file=sys.stderr, flush=True)
            left = in_fresh_process(leave_environments, engine, ending, count, min(SETTLED, count))
            found[f"{engine} {ending}"] = {**asdict(left), "passed": left.passed}
    return found


def measure_long(engines: list[str], share: float = 1.0) -> dict[str, Any]:
    """Measure memory over a long run, for each engine.

    Args:
        engines: The engines.
        share: Share of the full number of steps to make.
    """
    found: dict[str, Any] = {}
    for engine in engines:
        run = in_fresh_process(run_long, engine, int(share * LONG_STEPS[engine]))
        found[engine] = {**asdict(run), "passed": run.passed}
    return found
