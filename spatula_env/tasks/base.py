"""What a task is, and what it answers: rewards, what was achieved, and whether that is what was asked for.

W counts worlds, G the numbers in a goal; units and frame are those of `situation`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.arrays import BoolArray, FloatArray, IntArray
from spatula_env.tasks.configuration import TaskConfig
from spatula_env.tasks.criteria import Criterion
from spatula_env.tasks.limits import COST_PRESSURE
from spatula_env.tasks.marks import Mark
from spatula_env.tasks.situation import Setting, Situation, Start

Memory = dict[str, NDArray[Any]]
"""What a task remembers within episodes: arrays (W, ...) by name."""


@dataclass(frozen=True, eq=False)
class PartSpec:
    """A named piece of an observation.

    Attributes:
        name: Its key where observations are dictionaries.
        unit: Of all its numbers.
        low: (k,) least values.
        high: (k,) greatest values.
        sensed: Whether a robot knows it by its own sensors or is told it: pose, velocity, force, torque, and the goal.
            What is not is privileged: it is read off the simulated organ.
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
        within_tolerance: (W,) bool, what is achieved is the goal, for now.
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
    """What is asked of the agent. A task is not changed by being asked: what it remembers is handed to it.

    Subclasses name their goal, and say how episodes begin, what a situation is worth and when a goal is fulfilled.

    Attributes:
        description: What is asked, as a sentence that instructs; "" where nobody wrote one.
        goal_names: Names of the G numbers in a goal.
        goal_units: Their units.
        hindsight: Whether what is achieved is the same whatever is asked for, so that a step may be replayed as if
            something else had been asked.
        definition: The number of what is asked, rewarded and counted. Policies, data sets and results carry it: with
            another number they are of another task.
        extra_parts: The task's own pieces of the observation.
        setting: Where it is asked, as far as nothing of it is drawn at random.
    """

    description: ClassVar[str] = ""
    goal_names: ClassVar[tuple[str, ...]]
    goal_units: ClassVar[tuple[str, ...]]
    hindsight: ClassVar[bool] = True
    definition: ClassVar[int] = 1
    extra_parts: tuple[PartSpec, ...] = ()

    def __init__(self, config: TaskConfig, setting: Setting, goal_low: ArrayLike, goal_high: ArrayLike) -> None:
        """Prepare for a setting.

        Args:
            config: What is asked.
            setting: Where.
            goal_low: (G,) least values of what can be achieved.
            goal_high: (G,) greatest values.

        Raises:
            ValueError: If the tools cannot start as high as is asked for.
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
        """The greatest dense reward of a step: the sum of the positive weights, whose terms are 1 at most.

        What ends of episodes pay is reckoned by it; a task with other terms overrides it.
        """
        return sum(weight for weight in self._weights.values() if weight > 0.0)

    @property
    def hold_time(self) -> float:
        """How long the goal must be held without a break for success [s]."""
        return self._hold_time

    @property
    def loading_limit(self) -> float:
        """How fast the force on a tool may grow without being counted as a cost [N/s]."""
        return self._loading_limit

    @property
    def cost_budget(self) -> float:
        """Up to which cost of an episode success counts as safe [s]."""
        return self._cost_budget

    def pressure_limit(self, goal: FloatArray) -> FloatArray:
        """Which pressure goals (W, G) need, with care: what is beyond is counted as a cost (W,) [Pa].

        By default no more than what tissue bears.
        """
        return np.full(len(goal), COST_PRESSURE)

    @abstractmethod
    def sample(self, generator: np.random.Generator, count: int, setting: Setting) -> Start:
        """Draw the beginnings of episodes.

        Args:
            generator: Where randomness comes from.
            count: Number of episodes, W.
            setting: Where the organ is, and the tools: it may differ from the task's own.
        """

    @abstractmethod
    def evaluate(self, situation: Situation, goal: FloatArray, memory: Memory) -> Evaluation:
        """Judge a situation by the goals (W, G), once in each control step and once at the beginning.

        Args:
            situation: Of W worlds.
            goal: (W, G).
            memory: Of these worlds; changed in place.
        """

    @abstractmethod
    def fulfils(self, achieved: FloatArray, desired: FloatArray) -> BoolArray:
        """Whether what is achieved (..., G) is what is desired (..., G), for now: (...). From these numbers alone."""

    def criteria(self, achieved: FloatArray, goal: FloatArray) -> tuple[Criterion, ...]:
        """The conditions that make up a goal, for a person to read; all are fulfilled exactly when `fulfils` says so.

        By default one for each number of the goal, with the whole goal's verdict: a task that knows what it tolerates
        tells it here.

        Args:
            achieved: (G,) what `fulfils` would be given.
            goal: (G,) likewise.
        """
        within = bool(self.fulfils(achieved, goal))
        return tuple(
            Criterion(name.replace("_", " "), unit, float(is_now), float(wanted), float(wanted), within)
            for name, unit, is_now, wanted in zip(self.goal_names, self.goal_units, achieved, goal, strict=True)
        )

    def check_goal(self, goal: FloatArray) -> None:
        """Raise ValueError if a goal (G,) cannot be asked for."""
        if (goal < self._goal_low).any() or (goal > self._goal_high).any():
            raise ValueError(f"goal must lie in {self._goal_low} to {self._goal_high}, got {goal}")

    def compare(self, measured: FloatArray, goal: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Compare what was measured with the goals, both rounded to single precision first.

        That is how an agent sees them and a replay buffer stores them: `compute_reward` then gives the same verdict.

        Args:
            measured: (W, G).
            goal: (W, G).

        Returns:
            What was achieved (W, G), `measured` within its bounds; the goal minus that (W, G); and whether it is
            fulfilled (W,).
        """
        # Not np.clip: it costs several times as much on a few numbers.
        achieved = np.minimum(np.maximum(measured, self._goal_low), self._goal_high)
        desired, seen = as_seen(goal), as_seen(achieved)
        return achieved, desired - seen, self.fulfils(seen, desired)

    def check_room(self, name: str, distance: float, middle: ArrayLike) -> None:
        """Check that a distance is not farther than the workspace reaches around a place.

        Args:
            name: Of the distance in the configuration.
            distance: [m].
            middle: (2,) the place [m].

        Raises:
            ValueError: If it is.
        """
        room = self.setting.room_around(middle)
        if distance > room:
            raise ValueError(f"{name} must be {room:.4f} m at most, where the workspace ends; got {distance!r}")

    def new_memory(self, count: int) -> Memory:
        """Room for what is remembered in `count` worlds within an episode; nothing by default."""
        return {}

    def begin_memory(self, memory: Memory, rows: IntArray, start: Start, settings: Sequence[Setting]) -> None:
        """Forget the last episode in some worlds; by default there is nothing to forget.

        Args:
            memory: Of all worlds; the rows are written.
            rows: (n,) which worlds.
            start: How their episodes begin, n of them.
            settings: Where, n of them.
        """
        return None

    def compute_reward(self, achieved: NDArray[Any], desired: NDArray[Any]) -> NDArray[np.float32]:
        """The sparse reward, from goals alone.

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
        """Marks that show a goal (G,) in a picture.

        Args:
            goal: (G,).
            situation: Of the one world that is shown, W = 1; None: before anything has happened.
            memory: Of that world; None: nobody knows.
        """
        return ()


def as_seen(goal: ArrayLike) -> FloatArray:
    """Goals as an agent sees them and a replay buffer stores them: rounded to single precision."""
    return np.asarray(goal, dtype=np.float32).astype(np.float64)


def sample_disc(generator: np.random.Generator, radius: float, count: int) -> FloatArray:
    """(count, 2) points, uniform in a disc around the origin."""
    distance = radius * np.sqrt(generator.uniform(size=count))
    angle = generator.uniform(0.0, 2.0 * np.pi, size=count)
    return np.column_stack([distance * np.cos(angle), distance * np.sin(angle)])


def closeness(distance: FloatArray, scale: float) -> FloatArray:
    """From 1 at distance 0 towards 0: 1 - tanh(distance / scale), which is 0.24 at `scale`."""
    return np.asarray(1.0 - np.tanh(distance / scale))


def weighted_sum(terms: Mapping[str, FloatArray], weights: Mapping[str, float]) -> FloatArray:
    """The dense reward (W,) of reward terms (W,)."""
    return np.asarray(sum(weight * terms[name] for name, weight in weights.items()))
