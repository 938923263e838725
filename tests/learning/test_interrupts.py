"""Ctrl-C, and a signal to the first process alone, end a command with all of its processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("stable_baselines3")
pytest.importorskip("tensorboard")

from training_helpers import write_small

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/task").exists(), reason="processes are looked up in /proc, and groups of them interrupted"
)

ROOT = Path(__file__).parents[2]

# An interruption is handled within a second or two; a busy machine may need more. Waiting for the work takes minutes.
PATIENCE = 30.0

EVALUATE = ["-m", "spatula_env.cli", "evaluate", "--env", "press", "--policy", "random", "--engine", "batch"]
EVALUATE += ["--episodes", "40000", "--processes", "2"]


def descendants(number):
    """Processes that a process has started, and those that these have."""
    found = []
    for file in Path(f"/proc/{number}/task").glob("*/children"):
        try:
            children = [int(word) for word in file.read_text().split()]
        except (FileNotFoundError, ProcessLookupError):
            continue
        for child in children:
            found += [child, *descendants(child)]
    return found


def is_alive(number):
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def start(words, folder):
    return subprocess.Popen(
        [sys.executable, *words], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_NUM_THREADS": "1"}, start_new_session=True,
    )  # fmt: skip


def wait_for_end(family):
    """Wait until no process is left: the last one to go, which watches over shared memory, goes after its parents."""
    deadline = time.monotonic() + PATIENCE
    while any(map(is_alive, family)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_alive, family))


def interrupt(process, *, group):
    """Send the signal, and return what the command says then; nothing may be left."""
    family = descendants(process.pid)
    (os.killpg if group else os.kill)(process.pid, signal.SIGINT)
    try:
        _, said = process.communicate(timeout=PATIENCE)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    wait_for_end(family)
    assert process.returncode == 130, said
    assert "Traceback" not in said and "Exception" not in said, said
    return said


@pytest.mark.parametrize(
    ("after", "group"),
    [(0.0, False), (0.3, True), (2.0, False), (2.0, True)],
    ids=lambda value: {False: "the first process", True: "the group"}.get(value) if isinstance(value, bool) else None,
)
def test_an_evaluation_in_processes_is_ended(after, group, tmp_path):
    process = start(EVALUATE, tmp_path)
    # From the moment when the processes begin, to that in which they are at work.
    while len(descendants(process.pid)) < 2:
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    time.sleep(after)
    assert "spatula evaluate: interrupted" in interrupt(process, group=group)


def test_training_is_ended(tmp_path):
    file = write_small(tmp_path / "c.yaml", top_total_steps=1_000_000, top_checkpoint_every=100)
    words = ["-m", "agents.train", "--config", str(file), "--set", "evaluation.every=1_000_000", "--output", "run"]
    process = start([*words, "--quiet"], tmp_path)
    while not list((tmp_path / "run").glob("seed-0/checkpoints/step-*")):
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    said = interrupt(process, group=False)
    assert "seed 0 is saved as it was at" in said
    assert "go on with: python -m agents.train --resume run" in said
    assert not list(tmp_path.rglob("*.tmp*"))


def test_a_benchmark_in_processes_is_ended(tmp_path):
    process = start(["-m", "benchmarks.tunnelling", "--cases", "5000", "--subset", "0", "--workers", "2"], tmp_path)
    while len(descendants(process.pid)) < 2:
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    time.sleep(1.0)
    os.kill(process.pid, signal.SIGINT)
    family = descendants(process.pid)
    _, said = process.communicate(timeout=PATIENCE)
    assert "not all cases were run: interrupted" in said and "Traceback" not in said
    wait_for_end(family)
