"""Trains and evaluates the agents of a plan, each once."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from spatula_env.definitions import definition_number
from spatula_env.learning.configuration import read_training, to_mapping
from spatula_env.learning.evaluation import MEASURES, Plan, evaluate, summarize
from spatula_env.learning.finding import find_policy
from spatula_env.learning.folders import differences
from spatula_env.learning.policies import PolicySource
from spatula_env.learning.results.plan import Run, ScoringPlan
from spatula_env.learning.saving import MODEL, NORMALIZER, definition_of, find_saved, provenance, write_json
from spatula_env.policies import pretrained_path

LOG = "log.txt"

SPATULA = (sys.executable, "-m", "spatula_env.cli")
"""Command line that runs `spatula` in a process of its own."""

Say = Callable[[str], None]


def is_finished(run: Run) -> bool:
    """Whether an agent is finished; reference policies always are."""
    if run.plan is None:
        return True
    # The file that is written last is written atomically, so its presence shows that the run is complete.
    if not run.plan.clone:
        return (run.folder / "summary.json").exists()
    provenance = run.folder / "provenance.json"
    return provenance.exists() and len(json.loads(provenance.read_text())["rounds"]) == run.plan.rounds


def command_of(run: Run) -> list[str]:
    """Command line that makes an agent, or continues it.

    Raises:
        ValueError: If its folder holds a run that was begun with another configuration.
    """
    assert run.plan is not None and run.seed is not None
    changes = [argument for change in run.plan.changes for argument in ("--set", change)]
    common = ["--config", run.plan.config, *changes, "--seed", str(run.seed), "--output", str(run.folder)]
    if run.plan.clone:
        rounds = ("--rounds", str(run.plan.rounds)) if run.plan.rounds else ()
        # An unfinished clone in the folder was interrupted between two rounds: start again.
        more = (*rounds, "--overwrite")
        return [*SPATULA, "clone", "--expert", str(run.plan.clone), *more, *common]
    begun = run.folder / "config.yaml"
    if begun.exists():
        check_same_configuration(run)
        named = ("--env", run.environment) if ":" in run.environment else ()
        return [*SPATULA, "train", "--resume", str(run.folder), *named, "--quiet"]
    return [*SPATULA, "train", *common, "--quiet"]


def check_same_configuration(run: Run) -> None:
    """Check that a run was begun with the configuration that the plan has now.

    Raises:
        ValueError: If the configurations differ; the message says where.
    """
    assert run.plan is not None and run.seed is not None
    begun, planned = run.folder / "config.yaml", to_mapping(run.plan.read(run.seed))
    there = to_mapping(read_training(begun))
    differing = sorted(differences(there, planned))
    if differing:
        raise ValueError(f"{run.folder} was begun with other values of {', '.join(differing)}: remove it to begin anew")


def make_agents(runs: Sequence[Run], jobs: int, say: Say) -> list[str]:
    """Make the agents that are not finished.

    Args:
        runs: All agents that are wanted.
        jobs: Number of processes at once.
        say: Receives progress messages.

    Returns:
        One line for each agent that failed.

    Raises:
        ValueError: See `command_of`; raised before any work begins.
    """
    todo = [run for run in runs if not is_finished(run)]
    commands = [command_of(run) for run in todo]
    say(f"{len(runs) - len(todo)} of {len(runs)} runs are finished")
    processes: list[subprocess.Popen[bytes]] = []
    lock, stopped = Lock(), False

    def make(run: Run, command: list[str]) -> str | None:
        start = time.perf_counter()
        run.folder.parent.mkdir(parents=True, exist_ok=True)
        log = run.folder.with_name(f"{run.folder.name}.{LOG}")
        with log.open("ab") as stream:
            with lock:
                if stopped:
                    return None
                say(f"{run.title}: {'goes on' if '--resume' in command else 'begins'}")
                process = subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT)
                processes.append(process)
            status = process.wait()
        if status:
            return f"{run.title}: failed with status {status}, see {log}"
        say(f"{run.title}: finished after {time.perf_counter() - start:.0f} s")
        return None

    with ThreadPoolExecutor(max_workers=jobs) as pool:
        futures = [pool.submit(make, run, command) for run, command in zip(todo, commands, strict=True)]
        try:
            results = [future.result() for future in futures]
        except BaseException:
            # An interrupted run keeps its checkpoint; the next start resumes it.
            with lock:
                stopped = True
                for process in processes:
                    process.terminate()
            raise
    return [result for result in results if result is not None]


def evaluation_file(run: Run, engine: str) -> Path:
    """File of an agent's evaluation."""
    return run.folder / f"evaluation-{engine}.json"


def evaluate_agent(run: Run, scoring: ScoringPlan, engine: str, *, again: bool = False) -> bool:
    """Evaluate an agent, if that has not been done yet.

    Args:
        run: A finished agent.
        scoring: How to evaluate it.
        engine: "batch", "tissue", "mujoco" or "bullet".
        again: Whether to repeat an existing evaluation.

    Returns:
        Whether an evaluation was made.

    Raises:
        ValueError: If the agent was made for another definition of the task, so that its results would not be
            comparable.
    """
    source = _source_of(run)
    present = definition_number(run.environment)
    if run.plan is not None and (number := definition_of(find_saved(run.folder))) != present:
        raise ValueError(
            f"{run.folder} was made for definition {number} of the task, the present one is {present}: remove it to "
            "begin anew"
        )
    key = {
        "policy": _fingerprint(run),
        "kwargs": dict(source.kwargs),
        "engine": engine,
        "episodes": scoring.episodes,
        "seed": scoring.seed,
        "definition": present,
    }
    file = evaluation_file(run, engine)
    if not again and file.exists() and json.loads(file.read_text(encoding="utf-8"))["key"] == key:
        return False
    plan = Plan(run.environment, source.kwargs, engine, scoring.episodes, scoring.seed)
    # End at success, as in practice, where a tool does not go on acting after that.
    episodes, rate = evaluate(source, plan, end_at_success=True)
    write_json(
        file,
        {
            "key": key,
            "summary": {**summarize(episodes), "steps_per_second": rate},
            # JSON has no NaN, which is the time of success of an episode that has not succeeded.
            "episodes": {name: _as_list(episodes[name]) for name in MEASURES},
            "provenance": provenance(run.environment),
        },
    )
    return True


def _as_list(values: Any) -> list[Any]:
    return [None if isinstance(value, float) and np.isnan(value) else value for value in values.tolist()]


def _source_of(run: Run) -> PolicySource:
    return find_policy(run.name if run.plan is None else str(run.folder), run.environment)


def _fingerprint(run: Run) -> str:
    """A value that identifies a policy, to detect changes."""
    if run.plan is not None:
        folder = find_saved(run.folder)
        files = [folder / name for name in (MODEL, NORMALIZER)]
    else:
        files = [pretrained_path(run.environment)] if run.name == "pretrained" else []
    digest = hashlib.sha256(run.name.encode())
    for file in files:
        if file.exists():
            digest.update(file.read_bytes())
    return digest.hexdigest()
