"""The interface of tasks: how they compute rewards, what was achieved, and whether the goal is fulfilled.

W counts worlds, G the numbers in a goal; units and frame are those of `situation`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.arrays import BoolArray, FloatArray, IntArray
from spatula_env.pressure_limits import COST_PRESSURE
from spatula_env.tasks.configuration import TaskConfig
from spatula_env.tasks.criteria import Criterion
from spatula_env.tasks.marks import Mark, Patch
from spatula_env.tasks.situation import Setting, Situation, Start

Memory = dict[str, NDArray[Any]]
"""Values that a task remembers within episodes: arrays (W, ...) by name."""


@dataclass(frozen=True, eq=False)
class PartSpec:
    """A named piece of an observation.

    Attributes:
        name: Key of the part in dictionary observations.
        unit: Unit of all its numbers.
        low: (k,) least values.
        high: (k,) greatest values.
        sensed: Whether a robot knows it from its own sensors or is told it: pose, velocity, force, torque, and the
            goal. Other parts are privileged: they are read from the simulated organ.
    """

    name: str
    unit: str
    low: NDArray[Any]
    high: NDArray[Any]
    sensed: bool = False

    @property
    def size(self) -> int:
        """How many numbers it holds."""
        return len(self.low)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A task's judgement of a situation.

    Attributes:
        terms: Reward terms before weighting, each (W,); the keys never change.
        achieved: (W, G) the goal that this situation would fulfil exactly.
        error: (W, G) goal minus achieved.
        within_tolerance: (W,) bool, whether the goal is fulfilled at present.
        measures: Further quantities worth reporting, each (W,); the keys never change.
        parts: The task's own pieces of the observation, each (W, k), by the names in `Task.extra_parts`.
    """

    terms: dict[str, FloatArray]
    achieved: FloatArray
    error: FloatArray
    within_tolerance: BoolArray
    measures: dict[str, FloatArray]
    parts: dict[str, FloatArray] = field(default_factory=dict)


class Task(ABC):
    """Base of all tasks. A task is stateless: what it has to remember is passed to it.

    Subclasses name the goal's numbers, and define how episodes begin, the reward, and when a goal is fulfilled.

    Attributes:
        description: Instruction to the agent in one sentence; "" if there is none.
        goal_names: Names of the G numbers of a goal.
        goal_units: Their units.
        hindsight: Whether what is achieved does not depend on the goal, so that a step may be replayed with another
            goal.
        definition: Version number of the task's goals, rewards and costs. Policies, data sets and results carry it:
            those with another number belong to another task.
        extra_parts: The task's own pieces of the observation.
        stop_height: Height above the ground below which no point of a tool gets [m]; None for that of the environment.
        setting: Setting of the task, without anything drawn at random.
    """

    description: ClassVar[str] = ""
    goal_names: ClassVar[tuple[str, ...]]
    goal_units: ClassVar[tuple[str, ...]]
    hindsight: ClassVar[bool] = True
    definition: ClassVar[int] = 1
    extra_parts: tuple[PartSpec, ...] = ()
    stop_height: float | None = None

    def __init__(self, config: TaskConfig, setting: Setting, goal_low: ArrayLike, goal_high: ArrayLike) -> None:
        """Prepare the task for a setting.

        Args:
            config: Configuration of the task.
            setting: Setting of the task.
            goal_low: (G,) least values of what can be achieved.
            goal_high: (G,) greatest values.

        Raises:
            ValueError: If the tools cannot start as high as configured.
        """
        self.setting = setting
        highest = float(setting.workspace_high[2] + setting.tool_low[2] - setting.rest_nodes[:, 2].max())
        if config.start_height_range[1] > highest:
            raise ValueError(
                f"start_height_range must end at {highest:.4f} m at most, where the workspace ends; "
                f"got {config.start_height_range}"
            )
        self._hold_time = float(config.hold_time)
        self._loading_limit, self._cost_budget = float(config.loading_limit), float(config.cost_budget)
        self._weights = {name: float(value) for name, value in vars(config.weights).items()}
        self._goal_low: NDArray[np.float32] = np.array(goal_low, dtype=np.float32)
        self._goal_high: NDArray[np.float32] = np.array(goal_high, dtype=np.float32)

    @property
    def goal_low(self) -> NDArray[np.float32]:
        """(G,) least values of what can be achieved."""
        return self._goal_low.copy()

    @property
    def goal_high(self) -> NDArray[np.float32]:
        """(G,) greatest values of what can be achieved."""
        return self._goal_high.copy()

    @property
    def weights(self) -> Mapping[str, float]:
        """The weight of each reward term."""
        return self._weights

    @property
    def best_reward(self) -> float:
        """Greatest dense reward of a step: the sum of the positive weights, whose terms are at most 1.

        The payments at the ends of episodes are based on it; a task whose terms can exceed 1 overrides it.
        """
        return sum(weight for weight in self._weights.values() if weight > 0.0)

    @property
    def hold_time(self) -> float:
        """Time for which the goal must be held without interruption for success [s]."""
        return self._hold_time

    @property
    def loading_limit(self) -> float:
        """Rate at which the force on a tool may grow without causing a cost [N/s]."""
        return self._loading_limit

    @property
    def cost_budget(self) -> float:
        """Greatest cost of an episode with which success counts as safe [s]."""
        return self._cost_budget

    def pressure_limit(self, goal: FloatArray) -> FloatArray:
        """Pressure that reaching goals (W, G) requires with care: pressures beyond it cause a cost (W,) [Pa].

        By default the pressure that tissue bears.
        """
        return np.full(len(goal), COST_PRESSURE)

    @abstractmethod
    def sample(self, generator: np.random.Generator, count: int, setting: Setting) -> Start:
        """Draw the beginnings of episodes.

        Args:
            generator: Source of randomness.
            count: Number of episodes, W.
            setting: Setting of these episodes; it may differ from the task's own.
        """

    def arrange(self, start: Start, settings: Sequence[Setting], chosen: Collection[str]) -> Start:
        """Complete the beginnings of episodes by what follows from their goals; nothing by default.

        Args:
            start: From `sample`, with the values that were chosen instead of drawn.
            settings: (W,) settings of the episodes.
            chosen: Names of the values that were chosen; they are not to be changed.
        """
        return start

    @abstractmethod
    def evaluate(self, situation: Situation, goal: FloatArray, memory: Memory) -> Evaluation:
        """Evaluate a situation for the goals (W, G), once per control step and once at the beginning of an episode.

        Args:
            situation: Situation of W worlds.
            goal: (W, G) goals.
            memory: Memory of these worlds; updated in place.
        """

    @abstractmethod
    def fulfils(self, achieved: FloatArray, desired: FloatArray) -> BoolArray:
        """Whether what is achieved (..., G) fulfils the desired goals (..., G) now: (...). Uses these numbers only."""

    def criteria(self, achieved: FloatArray, goal: FloatArray) -> tuple[Criterion, ...]:
        """The conditions of a goal, for display; all are met exactly when `fulfils` returns True.

        By default there is one for each number of the goal, all with the verdict on the whole goal; tasks override this
        to show their tolerances.

        Args:
            achieved: (G,) as for `fulfils`.
            goal: (G,) as for `fulfils`.
        """
        within = bool(self.fulfils(achieved, goal))
        return tuple(
            Criterion(name.replace("_", " "), unit, float(is_now), float(wanted), float(wanted), within)
            for name, unit, is_now, wanted in zip(self.goal_names, self.goal_units, achieved, goal, strict=True)
        )

    def check_goal(self, goal: FloatArray) -> None:
        """Raise ValueError if a goal (G,) is not allowed."""
        if (goal < self._goal_low).any() or (goal > self._goal_high).any():
            raise ValueError(f"goal must lie in {self._goal_low} to {self._goal_high}, got {goal}")

    def compare(self, measured: FloatArray, goal: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Compare measured values with the goals, both first rounded to single precision.

        Agents see them like this and replay buffers store them like this, so `compute_reward` comes to the same
        verdict.

        Args:
            measured: (W, G) measured values.
            goal: (W, G) goals.

        Returns:
            What was achieved (W, G), which is `measured` within its bounds; the goal minus that (W, G); and whether it
                fulfils the goal (W,).
        """
        # Instead of np.clip, which takes several times as long on a few numbers.
        achieved = np.minimum(np.maximum(measured, self._goal_low), self._goal_high)
        desired, seen = as_seen(goal), as_seen(achieved)
        return achieved, desired - seen, self.fulfils(seen, desired)

    def check_room(self, name: str, distance: float, middle: ArrayLike) -> None:
        """Check that the workspace extends at least a distance around a place.

        Args:
            name: Name of the distance in the configuration.
            distance: The distance [m].
            middle: (2,) the place [m].

        Raises:
            ValueError: If it does not.
        """
        room = self.setting.room_around(middle)
        if distance > room:
            raise ValueError(f"{name} must be {room:.4f} m at most, where the workspace ends; got {distance!r}")

    def new_memory(self, count: int) -> Memory:
        """Allocate the memory of `count` worlds; empty by default."""
        return {}

    def begin_memory(self, memory: Memory, rows: IntArray, start: Start, settings: Sequence[Setting]) -> None:
        """Reset the memory of some worlds at the beginning of episodes; does nothing by default.

        Args:
            memory: Memory of all worlds; the rows are written.
            rows: (n,) indices of the worlds.
            start: How the n episodes begin.
            settings: Settings of the n worlds.
        """
        return None

    def compute_reward(self, achieved: NDArray[Any], desired: NDArray[Any]) -> NDArray[np.float32]:
        """The sparse reward, computed from goals alone.

        Args:
            achieved: (..., G).
            desired: (..., G).

        Returns:
            (...) 0 where `achieved` fulfils `desired`, -1 elsewhere.
        """
        within = self.fulfils(as_seen(achieved), as_seen(desired))
        return np.asarray(within, dtype=np.float32) - np.float32(1.0)

    def marks(
        self, goal: FloatArray, situation: Situation | None = None, memory: Memory | None = None
    ) -> tuple[Mark, ...]:
        """Marks that show a goal in a picture.

        Args:
            goal: (G,) the goal.
            situation: Situation of the one world that is shown, W = 1; None before the episode has begun.
            memory: Memory of that world; None if it is unknown.
        """
        return ()

    def patches(self, goals: FloatArray, situation: Situation, memory: Memory) -> dict[str, BoolArray]:
        """Parts of the organ that are dyed in W worlds, which cameras see: the patches among the `marks`.

        This asks for the marks of each world; a task that knows its patches without them saves that time.

        Args:
            goals: (W, G) the goals.
            situation: Situation of the worlds.
            memory: Memory of the worlds.

        Returns:
            (W, V) whether each node of the organ is on a patch, by the patch's role.
        """
        dyed: dict[str, BoolArray] = {}
        for world, goal in enumerate(goals):
            row = np.array([world])
            rows = {name: values[row] for name, values in memory.items()}
            for mark in self.marks(goal, situation.rows(row), rows):
                if isinstance(mark, Patch):
                    whole = dyed.setdefault(mark.role, np.zeros(situation.nodes.shape[:2], dtype=np.bool_))
                    whole[world, mark.nodes] = True
        return dyed


def as_seen(goal: ArrayLike) -> FloatArray:
    """Round goals to single precision, as agents see them and replay buffers store them."""
    return np.asarray(goal, dtype=np.float32).astype(np.float64)


def sample_disc(generator: np.random.Generator, radius: float, count: int) -> FloatArray:
    """(count, 2) points, uniform in a disc around the origin."""
    distance = radius * np.sqrt(generator.uniform(size=count))
    angle = generator.uniform(0.0, 2.0 * np.pi, size=count)
    return np.column_stack([distance * np.cos(angle), distance * np.sin(angle)])


def closeness(distance: FloatArray, scale: float) -> FloatArray:
    """Closeness 1 - tanh(distance / scale): 1 at distance 0, 0.24 at `scale`, tending to 0."""
    return np.asarray(1.0 - np.tanh(distance / scale))


def weighted_sum(terms: Mapping[str, FloatArray], weights: Mapping[str, float]) -> FloatArray:
    """The dense reward (W,) of reward terms (W,)."""
    return np.asarray(sum(weight * terms[name] for name, weight in weights.items()))
