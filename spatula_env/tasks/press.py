"""The press: push the organ's surface to a depth at a place, and hold it there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.geometry.checks import check_positive
from spatula_env.tasks.base import (
    BoolArray,
    Evaluation,
    FloatArray,
    Setting,
    Situation,
    Start,
    check_range,
    closeness,
    config_from_mapping,
)
from spatula_env.tasks.surface import surface_heights

LEAST_DEPTH, GREATEST_DEPTH = -0.03, 0.06
"""Limits of a measured depth [m]: a surface that bulges, and one that has gone from under the tool."""


@dataclass(frozen=True)
class PressWeights:
    """Weights of the reward terms of `PressTask`.

    Attributes:
        reach: Of the closeness of the spatula's underside to where it has to go, 0..1.
        depth: Of the closeness of depth and place to the goal's, 0..1.
        hold: Of being within tolerance, 0 or 1.
        force: Of the contact force [1/N].
        action: Of the squared length of the action.
    """

    reach: float = 0.25
    depth: float = 0.25
    hold: float = 0.5
    force: float = -0.002
    action: float = -0.01

    def __post_init__(self) -> None:
        """Check the weights."""
        for name, value in asdict(self).items():
            if not np.isfinite(value):
                raise ValueError(f"weights.{name} must be finite, got {value!r}")


@dataclass(frozen=True)
class PressConfig:
    """What is asked in a press.

    Attributes:
        place_radius: Goals lie within this distance of the organ's axis [m].
        depth_range: Least and greatest depth asked for [m].
        place_tolerance: Allowed horizontal distance between spatula and place [m].
        depth_tolerance: Allowed difference of the depth from the goal's [m].
        hold_time: How long both must be kept without a break [s].
        start_radius: The spatula starts within this distance of the organ's axis [m].
        start_height_range: Least and greatest height of its underside above the organ's top at the start [m].
        reach_scale: Distance at which the reward term "reach" has fallen to 0.24 [m].
        depth_scale: Error of depth or of place at which the term "depth" has fallen to 0.24 [m].
        weights: Of the reward terms; a mapping of some of them is completed by the defaults.
    """

    place_radius: float = 0.015
    depth_range: tuple[float, float] = (0.005, 0.018)
    place_tolerance: float = 0.002
    depth_tolerance: float = 0.001
    hold_time: float = 0.5
    start_radius: float = 0.02
    start_height_range: tuple[float, float] = (0.01, 0.03)
    reach_scale: float = 0.02
    depth_scale: float = 0.003
    weights: PressWeights = field(default_factory=PressWeights)

    def __post_init__(self) -> None:
        """Check the values, and take lists and mappings as they come from a file."""
        for name in ("place_radius", "start_radius"):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise ValueError(f"{name} must be zero or more and finite, got {value!r}")
        for name in ("place_tolerance", "depth_tolerance", "hold_time", "reach_scale", "depth_scale"):
            check_positive(getattr(self, name), name)
        for name in ("depth_range", "start_height_range"):
            object.__setattr__(self, name, check_range(getattr(self, name), name))
        if self.depth_range[0] <= self.depth_tolerance:
            raise ValueError(
                f"depth_range must begin above depth_tolerance, {self.depth_tolerance}, or the organ at rest "
                f"would fulfil the goal; got {self.depth_range}"
            )
        if self.start_height_range[0] < 0.0:
            raise ValueError(f"start_height_range must not be negative, got {self.start_height_range}")
        object.__setattr__(self, "weights", config_from_mapping(PressWeights, self.weights, "weights"))


class PressTask:
    """Judges a press.

    A goal is (x, y, depth): a place in the horizontal plane and how far the organ's surface is to be below
    where it was at rest. What is achieved is measured at the spatula: the place is that of its centre, and
    the depth is the height of the organ's surface at rest at that place minus its height now. It is the organ
    that is measured: a spatula that has sunk into the organ without moving it has achieved nothing.

    Goals, achieved and desired, are rounded to single precision before they are compared, because that is
    what an agent sees and what a replay buffer stores: `compute_reward` gives the same verdict as `evaluate`.
    """

    goal_names = ("x", "y", "depth")

    def __init__(self, config: PressConfig, setting: Setting) -> None:
        """Prepare for a setting.

        Args:
            config: What is asked.
            setting: Where.

        Raises:
            ValueError: If the deepest goal or a start is out of the tool's reach.
        """
        self.config = config
        self._setting = setting
        self._rest_nodes = np.array(setting.rest_nodes[None])
        self._triangles = np.array(setting.triangles)
        self._top = float(setting.rest_nodes[:, 2].max())
        self._weights: dict[str, float] = asdict(config.weights)
        low, high = setting.workspace_low, setting.workspace_high
        self._low: NDArray[np.float32] = np.array([low[0], low[1], LEAST_DEPTH], dtype=np.float32)
        self._high: NDArray[np.float32] = np.array([high[0], high[1], GREATEST_DEPTH], dtype=np.float32)
        self._check_reach()

    @property
    def goal_low(self) -> NDArray[np.float32]:
        """(3,) least values of what can be achieved [m]."""
        return self._low.copy()

    @property
    def goal_high(self) -> NDArray[np.float32]:
        """(3,) greatest values of what can be achieved [m]."""
        return self._high.copy()

    @property
    def weights(self) -> Mapping[str, float]:
        """The weight of each reward term."""
        return self._weights

    @property
    def hold_time(self) -> float:
        """How long the goal must be held without a break for success [s]."""
        return self.config.hold_time

    def sample(self, generator: np.random.Generator, count: int) -> Start:
        """Draw the beginnings of episodes: places uniform in discs, depths and heights in their ranges.

        Args:
            generator: Where randomness comes from.
            count: Number of episodes, W.

        Returns:
            Goals (W, 3) and tool positions (W, 3) [m].
        """
        config = self.config
        depth = generator.uniform(*config.depth_range, size=count)
        place = _sample_disc(generator, config.place_radius, count)
        start = _sample_disc(generator, config.start_radius, count)
        height = generator.uniform(*config.start_height_range, size=count)
        underside = self._top + height
        return Start(
            goal=np.column_stack([place, depth]),
            tool_position=np.column_stack([start, underside - self._setting.tool_low[2]]),
        )

    def check_goal(self, goal: FloatArray) -> None:
        """Check a goal (3,) that was not drawn by `sample`.

        Raises:
            ValueError: If its place is outside the workspace, or its depth is outside the configured range.
        """
        least, greatest = self.config.depth_range
        if (goal[:2] < self._low[:2]).any() or (goal[:2] > self._high[:2]).any():
            raise ValueError(f"goal must be at a place from {self._low[:2]} to {self._high[:2]} m, got {goal[:2]}")
        if not least <= goal[2] <= greatest:
            raise ValueError(f"goal must have a depth from {least} to {greatest} m, got {goal[2]}")

    def evaluate(self, situation: Situation, goal: FloatArray) -> Evaluation:
        """Judge a situation.

        Args:
            situation: Of W worlds.
            goal: (W, 3) [m].

        Returns:
            Reward terms "reach", "depth", "hold", "force" and "action"; what was achieved; the measures
            "depth", "depth_error" and "place_error" [m].
        """
        config = self.config
        place = np.ascontiguousarray(situation.tool_position[:, :2])
        depth = self._rest_heights(place)
        depth -= surface_heights(situation.nodes, self._triangles, place, self._setting.ground_height)
        measured = np.concatenate([place, depth[:, None]], axis=1)
        # Not np.clip: it costs several times as much on a few numbers.
        achieved = _as_seen(np.minimum(np.maximum(measured, self._low), self._high))
        error = _as_seen(goal) - achieved
        place_error, depth_error, within = self._compare(error)

        target = self._rest_heights(np.array(goal[:, :2])) - goal[:, 2]
        underside = situation.tool_position[:, 2] + self._setting.tool_low[2]
        distance = np.hypot(place_error, underside - target)
        force = np.sqrt((situation.contact_force**2).sum(axis=1))
        return Evaluation(
            terms={
                "reach": closeness(distance, config.reach_scale),
                "depth": closeness(depth_error, config.depth_scale) * closeness(place_error, config.depth_scale),
                "hold": within.astype(np.float64),
                "force": force,
                "action": (situation.action**2).sum(axis=1),
            },
            achieved=achieved,
            error=error,
            within_tolerance=within,
            measures={"depth": achieved[:, 2], "depth_error": depth_error, "place_error": place_error},
        )

    def compute_reward(self, achieved: NDArray[Any], desired: NDArray[Any]) -> NDArray[np.float32]:
        """The sparse reward, from goals alone.

        Args:
            achieved: (..., 3) [m].
            desired: (..., 3) [m].

        Returns:
            (...) 0 where `achieved` is within tolerance of `desired`, -1 elsewhere.
        """
        _, _, within = self._compare(_as_seen(desired) - _as_seen(achieved))
        return np.asarray(within, dtype=np.float32) - np.float32(1.0)

    def target_points(self, goal: FloatArray) -> FloatArray:
        """(2, 3): the place on the surface at rest, and where that point of the surface is to go [m]."""
        height = self._rest_heights(np.array(goal[None, :2]))[0]
        return np.array([[*goal[:2], height], [*goal[:2], height - goal[2]]])

    def _rest_heights(self, places: FloatArray) -> FloatArray:
        """(W,) height of the surface at rest at places (W, 2) [m]."""
        ground = self._setting.ground_height
        heights: FloatArray = surface_heights(self._rest_nodes, self._triangles, places, ground)
        return heights

    def _compare(self, error: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Distance from the place, absolute error of the depth, whether both are tolerable, (...) each."""
        place_error, depth_error = np.hypot(error[..., 0], error[..., 1]), np.abs(error[..., 2])
        within = (place_error <= self.config.place_tolerance) & (depth_error <= self.config.depth_tolerance)
        return place_error, depth_error, within

    def _check_reach(self) -> None:
        config, setting = self.config, self._setting
        widest = min(float(setting.workspace_high[:2].min()), -float(setting.workspace_low[:2].max()))
        for name in ("place_radius", "start_radius"):
            if getattr(config, name) > widest:
                raise ValueError(
                    f"{name} must be {widest:.4f} m at most, where the workspace ends; got {getattr(config, name)!r}"
                )
        angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
        rim = config.place_radius * np.column_stack([np.cos(angle), np.sin(angle)])
        lowest = self._rest_heights(rim).min()
        deepest = lowest - (setting.workspace_low[2] + setting.tool_low[2])
        if config.depth_range[1] > deepest:
            raise ValueError(
                f"depth_range must end at {deepest:.4f} m at most, where the workspace ends; got {config.depth_range}"
            )
        highest = setting.workspace_high[2] + setting.tool_low[2] - self._top
        if config.start_height_range[1] > highest:
            raise ValueError(
                f"start_height_range must end at {highest:.4f} m at most, where the workspace ends; "
                f"got {config.start_height_range}"
            )


def _as_seen(goal: NDArray[Any]) -> FloatArray:
    """Goals as an agent sees them: rounded to single precision."""
    return np.asarray(goal, dtype=np.float32).astype(np.float64)


def _sample_disc(generator: np.random.Generator, radius: float, count: int) -> FloatArray:
    """(count, 2) points, uniform in a disc around the origin."""
    distance = radius * np.sqrt(generator.uniform(size=count))
    angle = generator.uniform(0.0, 2.0 * np.pi, size=count)
    return np.column_stack([distance * np.cos(angle), distance * np.sin(angle)])
