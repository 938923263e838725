"""The plan of results: tasks, algorithms and seeds, read from YAML."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

from spatula_env.learning.configuration import (
    ENGINES,
    USUAL_ENGINES,
    Engine,
    TrainingConfig,
    find_config,
    from_mapping,
    load_yaml,
    read_training,
)
from spatula_env.learning.ranges import Checked, Count, Natural, Rule
from spatula_env.naming import find_environment, same_environment

REFERENCES = ("expert", "proportional", "random", "pretrained")
"""Existing policies, for comparison."""


@dataclass(frozen=True)
class AlgorithmPlan(Checked):
    """How agents of one kind are made.

    Attributes:
        config: Name or path of a configuration of training.
        clone: Number of demonstrations to imitate instead of training; 0 to train.
        rounds: Number of rounds in which a clone acts and is corrected; see `cloning.correct`.
        changes: Changes of the configuration, each "key=value".
        label: Label on the page; None for the algorithm's name.
    """

    config: str
    clone: Natural = 0
    rounds: Natural = 0
    changes: tuple[str, ...] = ()
    label: str | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        if self.rounds and not self.clone:
            raise ValueError(f"rounds must be 0 without clone, got {self.rounds}")

    def read(self, seed: int) -> TrainingConfig:
        """Read the configuration for one seed."""
        return read_training(find_config(self.config), [*self.changes, f"seeds=[{seed}]"])


@dataclass(frozen=True)
class TaskPlan:
    """The agents to train on one task.

    Attributes:
        environment: Id of the environment.
        algorithms: Plans of the algorithms, by name.
        note: A sentence to show on the page.
    """

    environment: str
    algorithms: dict[str, AlgorithmPlan]
    note: str = ""


@dataclass(frozen=True)
class ScoringPlan(Checked):
    """How finished agents are evaluated.

    Attributes:
        episodes: Number of episodes in each engine.
        seed: Seed of the first episode; no agent is trained or selected on these episodes.
        engines: Engines to evaluate in; the first one is that of training.
    """

    section: ClassVar[str] = "evaluation"

    episodes: Count = 100
    seed: Natural = 0
    engines: tuple[Engine, ...] = USUAL_ENGINES

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        if not self.engines:
            raise ValueError(f"evaluation.engines must be some of {list(ENGINES)}, got none")


@dataclass(frozen=True)
class BootstrapPlan(Checked):
    """How confidence intervals are computed.

    Attributes:
        resamples: Number of resamples.
        confidence: Confidence level of the intervals.
        seed: Seed of the resampling.
    """

    section: ClassVar[str] = "bootstrap"

    resamples: Count = 2_000
    confidence: Annotated[float, Rule("between 0 and 1", lambda value: 0.0 < value < 1.0)] = 0.95
    seed: Natural = 0


@dataclass(frozen=True)
class ResultsPlan:
    """Everything that the page is made of.

    Attributes:
        tasks: Plans of the tasks, by name.
        runs: Folder of the runs.
        page: File of the page.
        pictures: Folder of its pictures.
        seeds: Seeds; one agent is made for each.
        evaluation: How finished agents are evaluated.
        thresholds: Success rates for which the page says when training first reached them.
        bootstrap: How intervals are computed.
        references: Existing policies for comparison.
    """

    tasks: dict[str, TaskPlan]
    runs: str = "runs/results"
    page: str = "docs/results.md"
    pictures: str = "docs/images"
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    evaluation: ScoringPlan = field(default_factory=ScoringPlan)
    thresholds: tuple[float, ...] = (0.8, 0.95)
    bootstrap: BootstrapPlan = field(default_factory=BootstrapPlan)
    references: tuple[str, ...] = ("expert", "random")

    def __post_init__(self) -> None:
        """Check the values."""
        if not self.seeds or len(set(self.seeds)) < len(self.seeds) or min(self.seeds) < 0:
            raise ValueError(f"seeds must be different integers, zero or more, got {list(self.seeds)}")
        unknown = [name for name in self.references if name not in REFERENCES]
        if unknown:
            raise ValueError(f"references must be some of {list(REFERENCES)}, got {list(self.references)}")
        for threshold in self.thresholds:
            if not 0.0 < threshold <= 1.0:
                raise ValueError(f"thresholds must be in (0, 1], got {threshold}")


@dataclass(frozen=True)
class Run:
    """One agent to make, or one reference policy.

    Attributes:
        task: Name of the task.
        environment: Id of the environment.
        name: Name of the algorithm or of the policy.
        seed: Seed; None for a reference policy.
        plan: How it is made; None for a reference policy.
        folder: Folder of its files.
    """

    task: str
    environment: str
    name: str
    seed: int | None
    plan: AlgorithmPlan | None
    folder: Path

    @property
    def title(self) -> str:
        """Title for display."""
        return f"{self.task} {self.name}" + ("" if self.seed is None else f" seed {self.seed}")


def read_plan(path: str | os.PathLike[str]) -> ResultsPlan:
    """Read a plan of results.

    Args:
        path: Path of a YAML file.

    Raises:
        FileNotFoundError: If there is no such file, or a configuration that it names is missing.
        ValueError: If a key is unknown or missing, or a value is not allowed.
    """
    file = Path(path)
    content = load_yaml(file)
    try:
        if not isinstance(content, Mapping) or not isinstance(content.get("tasks"), Mapping):
            raise ValueError("it must be a mapping with the key 'tasks', a mapping from names to tasks")
        tasks = {str(name): _read_task(str(name), task) for name, task in content["tasks"].items()}
        return from_mapping(ResultsPlan, {**content, "tasks": tasks}, "")
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None


def _read_task(name: str, content: Any) -> TaskPlan:
    where = f"tasks.{name}"
    if not isinstance(content, Mapping) or not isinstance(content.get("algorithms"), Mapping):
        raise ValueError(f"{where} must be a mapping with the keys 'environment' and 'algorithms'")
    algorithms = {
        str(key): from_mapping(AlgorithmPlan, value, f"{where}.algorithms.{key}")
        for key, value in content["algorithms"].items()
    }
    task = from_mapping(TaskPlan, {**content, "algorithms": algorithms}, where)
    try:
        env_id = find_environment(task.environment)
    except (ImportError, ValueError) as error:
        raise ValueError(f"{where}.environment must be the id of an environment: {error}") from error
    for key, algorithm in algorithms.items():
        trained = find_environment(algorithm.read(0).environment.id)
        if not same_environment(trained, env_id):
            raise ValueError(f"{where}.algorithms.{key}: {algorithm.config} is for {trained}, not {task.environment}")
    return replace(task, environment=env_id)


def planned_runs(
    plan: ResultsPlan,
    tasks: Iterable[str] | None = None,
    algorithms: Iterable[str] | None = None,
    seeds: Sequence[int] | None = None,
) -> list[Run]:
    """List the agents of a plan seed by seed, so that an interrupted plan has a few seeds of everything.

    Args:
        plan: The plan.
        tasks: Restrict to these tasks; None for all.
        algorithms: Restrict to these algorithms; None for all.
        seeds: Restrict to these seeds; None for all of the plan.

    Raises:
        ValueError: If a task, algorithm or seed does not exist.
    """
    known = {name for task in plan.tasks.values() for name in task.algorithms}
    for what, chosen, allowed in (
        ("tasks", tasks, set(plan.tasks)),
        ("algorithms", algorithms, known),
        ("seeds", seeds, set(plan.seeds)),
    ):
        unknown = [each for each in chosen or () if each not in allowed]
        if unknown:
            raise ValueError(f"{what} must be some of {sorted(allowed)}, got {unknown}")
    return [
        Run(name, task.environment, key, seed, algorithm, Path(plan.runs) / f"{name}-{key}-{seed}")
        for seed in plan.seeds
        if seeds is None or seed in seeds
        for name, task in plan.tasks.items()
        if tasks is None or name in tasks
        for key, algorithm in task.algorithms.items()
        if algorithms is None or key in algorithms
    ]


def planned_references(plan: ResultsPlan, tasks: Iterable[str] | None = None) -> list[Run]:
    """List the reference policies, of all tasks or of some."""
    return [
        Run(name, task.environment, reference, None, None, Path(plan.runs) / f"{name}-{reference}")
        for name, task in plan.tasks.items()
        if tasks is None or name in tasks
        for reference in plan.references
    ]
