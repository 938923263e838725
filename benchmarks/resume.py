"""Can training that is killed at any moment be resumed as if nothing had happened?

A small run of `python -m agents.train` is killed with SIGKILL at random moments, and continued each time with
`--resume`. After every kill all files of the run are read. In the end the run must be complete, with exactly the
planned evaluations, in order, and without temporary files left behind.
"""

from __future__ import annotations

import io
import itertools
import json
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.measure import finish, parser
from spatula_env.learning.saving import MODEL, checkpoints_in, read_curve

STEPS, EVALUATE_EVERY, CHECKPOINT_EVERY = 8_000, 800, 320
"""Length of the run and intervals of its evaluations and checkpoints, in environment steps."""

CONFIG: dict[str, Any] = {
    "environment": {
        "id": "Spatula/Press-v0",
        "kwargs": {"max_episode_steps": 50},
        "parts": ["tool_position", "tool_velocity", "contact_force", "goal", "error"],
        "num_envs": 16,
    },
    "algorithm": "sac",
    "hyperparameters": {"learning_starts": 320, "batch_size": 64, "gradient_steps": 2, "buffer_size": 20_000},
    "network": {"layers": [32, 32]},
    "total_steps": STEPS,
    "evaluation": {"every": EVALUATE_EVERY, "episodes": 2},
    "checkpoint_every": CHECKPOINT_EVERY,
    "success_target": None,
}

PATIENCE = 1800.0
"""Longest wait for a checkpoint [s]."""


def main() -> None:
    """Run the benchmark."""
    arguments = parser(__doc__ or "")
    arguments.add_argument("--kills", type=int, default=3, help="default: %(default)s")
    arguments.add_argument("--seed", type=int, default=0, help="of the moments; default: %(default)s")
    chosen = arguments.parse_args()
    if chosen.kills < 0:
        arguments.error(f"--kills must be 0 or more, got {chosen.kills}")
    with tempfile.TemporaryDirectory() as folder:
        result = measure(Path(folder), chosen.kills, np.random.default_rng(chosen.seed), quiet=chosen.json)
    finish(result)
    sys.exit(0 if result["passed"] else 1)


def measure(folder: Path, kills: int, generator: np.random.Generator, *, quiet: bool) -> dict[str, Any]:
    """Train with interruptions.

    Args:
        folder: An empty folder to work in.
        kills: How often the run is killed.
        generator: Source of random numbers for the moments of the kills.
        quiet: Whether to print no progress.

    Returns:
        The figures, with "passed".
    """
    config, run = folder / "config.yaml", folder / "run"
    config.write_text(yaml.safe_dump(CONFIG), encoding="utf-8")
    begin = [sys.executable, "-m", "agents.train", "--config", str(config), "--output", str(run), "--quiet"]
    go_on = [sys.executable, "-m", "agents.train", "--resume", str(run), "--quiet"]
    moments, unreadable, read = [], [], 0
    for kill in range(kills):
        moment = _kill_in_the_middle(go_on if kill else begin, run, generator)
        files = readable(run)
        read += len(files)
        unreadable += [str(file.relative_to(run)) for file, problem in files.items() if problem]
        moments.append(moment)
        if not quiet:
            print(f"killed {moment['seconds']:.1f} s after its start, at step {moment['step']} or later")
    done = subprocess.run(go_on if kills else begin, stdout=subprocess.DEVNULL, check=False)
    files = readable(run)
    read += len(files)
    unreadable += [str(file.relative_to(run)) for file, problem in files.items() if problem]
    curve = read_curve(run / "seed-0" / "curve.jsonl")
    steps = [line["step"] for line in curve]
    summary = run / "summary.json"
    result = {
        "kills": moments,
        "status": done.returncode,
        "steps": json.loads(summary.read_text(encoding="utf-8"))["steps"][0] if summary.exists() else None,
        "files_read": read,
        "unreadable": unreadable,
        "evaluations": steps,
        "seconds_grow": all(one["seconds"] < other["seconds"] for one, other in itertools.pairwise(curve)),
        "left_behind": [str(file.relative_to(run)) for file in run.rglob(".*.tmp")],
    }
    result["passed"] = bool(
        result["status"] == 0
        and result["steps"] == STEPS
        and not unreadable
        and steps == list(range(EVALUATE_EVERY, STEPS + 1, EVALUATE_EVERY))
        and result["seconds_grow"]
        and not result["left_behind"]
    )
    if not quiet:
        print(f"{read} files read, {len(unreadable)} unreadable; evaluations at {steps}")
    return result


def _kill_in_the_middle(command: list[str], run: Path, generator: np.random.Generator) -> dict[str, float]:
    """Start training, and kill it at a random moment after it has written one to five further checkpoints."""
    place = run / "seed-0" / "checkpoints"
    wanted = _last_step(place) + CHECKPOINT_EVERY * int(generator.integers(1, 6))
    wait = generator.uniform(0.0, 2.0)
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        first: float | None = None
        while process.poll() is None and time.perf_counter() - start < PATIENCE:
            if first is None and _last_step(place) >= wanted:
                first = time.perf_counter()
            # The random wait is long enough for the kill to fall into steps, gradients, an evaluation or a checkpoint.
            if first is not None and time.perf_counter() - first >= wait:
                break
            time.sleep(0.005)
    finally:
        process.kill()
        process.wait()
    return {"seconds": time.perf_counter() - start, "step": _last_step(place)}


def _last_step(place: Path) -> int:
    saved = checkpoints_in(place)
    return int(saved[-1].name.partition("-")[2]) if saved else 0


def readable(run: Path) -> dict[Path, str]:
    """Try to read every file of a run; hidden files were still being written and do not count.

    Args:
        run: Folder of the run.

    Returns:
        For each file a description of the problem with it, empty if there is none.
    """
    files = [file for file in sorted(run.rglob("*")) if file.is_file() and not _is_hidden(file, run)]
    return {file: _problem(file) for file in files}


def _is_hidden(file: Path, run: Path) -> bool:
    return any(part.startswith(".") for part in file.relative_to(run).parts)


def _problem(file: Path) -> str:
    try:
        content = file.read_bytes()
        if file.suffix == ".json":
            json.loads(content)
        elif file.suffix == ".jsonl":
            for line in content.decode("utf-8").splitlines():
                json.loads(line)
        elif file.suffix == ".yaml":
            yaml.safe_load(content)
        elif file.suffix == ".npz":
            with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
                for name in arrays.files:
                    arrays[name]
        elif file.name == MODEL:
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                if broken := archive.testzip():
                    return f"{broken} in it is broken"
        elif file.name.startswith("events.out.tfevents"):
            _read_events(file)
        else:
            return "nobody knows what it is"
    except Exception as error:
        # Any exception means that the file cannot be read.
        return f"{type(error).__name__}: {error}"
    return ""


def _read_events(file: Path) -> None:
    from tensorboard.backend.event_processing.event_file_loader import EventFileLoader

    for _ in EventFileLoader(str(file)).Load():
        pass


if __name__ == "__main__":
    main()
