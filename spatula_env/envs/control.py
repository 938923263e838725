"""Velocity control: converts an agent's action to the tools' motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray
from spatula_env.geometry.checks import as_floats, check_positive
from spatula_env.geometry.rotations import conjugate, from_rotation_vector, multiply, to_rotation_vector, turn
from spatula_env.tasks.base import PartSpec

if TYPE_CHECKING:
    from spatula_env.tasks.situation import Setting, Situation, ToolShape


@dataclass(frozen=True)
class ControlLayout:
    """The degrees of freedom that an action controls, besides translation of the grip along x, y and z.

    Attributes:
        rotations: Axes of the workspace frame about which it turns the tools; a subset of "xyz".
        jaws: Whether it opens and closes two tools along the line from one to the other.
        max_turn: Greatest angle by which tools can be turned from their orientation in the scene [rad].
        opening_range: Least and greatest free width between the jaws [m].
    """

    rotations: str = ""
    jaws: bool = False
    max_turn: float = 0.5 * np.pi
    opening_range: tuple[float, float] = (0.0, 0.04)

    def __post_init__(self) -> None:
        """Check the values."""
        if "".join(axis for axis in "xyz" if axis in self.rotations) != self.rotations:
            raise ValueError(f"rotations must be some of 'xyz', in this order, got {self.rotations!r}")
        if not 0.0 < self.max_turn <= np.pi:
            raise ValueError(f"max_turn must be positive and pi at most, got {self.max_turn!r}")
        low, high = self.opening_range
        if not 0.0 <= low < high < np.inf:
            raise ValueError(f"opening_range must be two lengths, zero or more and ascending, got {self.opening_range}")


TRANSLATION = ControlLayout()
"""Three translational velocities."""

ALL_SIX = ControlLayout(rotations="xyz")
"""Three translational velocities and three rates of rotation."""


class VelocityControl:
    """The action is the grip's velocity, its rates of rotation and the jaws' speed, as fractions of the greatest.

    Tools turn about the grip like a rigid body; jaws move along the line between them, with the grip staying in the
    middle. Every motion stops at a limit: the grip at the workspace's faces, a turn at `max_turn`, jaws where they are
    fully open or closed. A motion that would exceed a limit is reduced so that it just reaches it at the end of the
    control step. No point of a tool gets below a stop above the ground, as if a guard were attached to it: turning
    lifts a tool that stands on it.

    Attributes:
        layout: Degrees of freedom of an action.
        max_speed: Greatest speed of the grip along each axis [m/s].
        max_rotation_rate: Greatest rate of rotation about each axis [rad/s].
        max_jaw_speed: Greatest rate of change of the free width between jaws [m/s].
        names: Names of the A components of an action.
        units: Units of the quantities that the components stand for.
        parts: Parts of the observation that describe the tools' rotation and the jaws' opening.
    """

    def __init__(
        self,
        layout: ControlLayout,
        setting: Setting,
        max_speed: float,
        max_rotation_rate: float = 1.0,
        max_jaw_speed: float = 0.05,
        stop_height: float = 0.0,
    ) -> None:
        """Set up the control.

        Args:
            layout: Degrees of freedom of an action.
            setting: The tools, and the region in which they may move.
            max_speed: Greatest speed of the grip along each axis [m/s].
            max_rotation_rate: Greatest rate of rotation about each axis [rad/s].
            max_jaw_speed: Greatest rate of change of the free width between jaws [m/s].
            stop_height: Height of the stop above the ground, below which no point of a tool gets [m].

        Raises:
            ValueError: If a number is not positive and finite, or jaws are configured without two tools.
        """
        for name, value in (
            ("max_speed", max_speed),
            ("max_rotation_rate", max_rotation_rate),
            ("max_jaw_speed", max_jaw_speed),
        ):
            check_positive(value, name)
        tools = setting.tools
        if layout.jaws and len(tools) != 2:
            raise ValueError(f"jaws need two tools, the scene has {len(tools)}")
        self.layout = layout
        self.max_speed, self.max_rotation_rate = float(max_speed), float(max_rotation_rate)
        self.max_jaw_speed = float(max_jaw_speed)
        self.names = (
            *(f"velocity_{axis}" for axis in "xyz"),
            *(f"rotation_{axis}" for axis in layout.rotations),
            *(("jaw_speed",) if layout.jaws else ()),
        )
        self.units = ("m/s",) * 3 + ("rad/s",) * len(layout.rotations) + ("m/s",) * layout.jaws
        self._low, self._high = setting.workspace_low, setting.workspace_high
        self._stop = setting.ground_height + stop_height
        self._corners = [np.asarray(tool.vertices) for tool in tools]
        self._axes = ["xyz".index(axis) for axis in layout.rotations]
        self._orientations = np.stack([tool.orientation for tool in tools])
        self._offsets = np.stack([tool.offset for tool in tools])
        self._away, self._reach = _line_between(tools) if layout.jaws else (np.zeros(3), 0.0)
        self.parts = self._make_parts()

    @property
    def size(self) -> int:
        """Number A of components of an action."""
        return len(self.names)

    @property
    def coordinates(self) -> int:
        """Number K of further coordinates: 1 with jaws, the free width between them [m]."""
        return int(self.layout.jaws)

    def place(
        self,
        grip: FloatArray,
        orientation: FloatArray | None = None,
        coordinates: FloatArray | None = None,
        tool_scale: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Poses of the tools at the beginning of episodes.

        Args:
            grip: (W, 3) positions of the grip [m].
            orientation: (W, 4) orientation of the first tool; None for that of the scene.
            coordinates: (W, K) further coordinates; None for those of the scene.
            tool_scale: (W,) factor on the tools' lengths; ones by default.

        Returns:
            Positions (W, N, 3) [m] and orientations (W, N, 4).
        """
        count = len(grip)
        offsets = np.repeat(self._offsets[None], count, axis=0)
        if self.layout.jaws and coordinates is not None:
            scale = np.ones(count) if tool_scale is None else tool_scale
            distance = coordinates[:, 0] + self._reach * scale
            middle = offsets.mean(axis=1, keepdims=True)
            offsets = middle + 0.5 * distance[:, None, None] * np.stack([-self._away, self._away])
        if orientation is None:
            return grip[:, None] + offsets, np.repeat(self._orientations[None], count, axis=0)
        turned = self._turned(orientation)[:, None]
        return grip[:, None] + turn(turned, offsets), multiply(turned, self._orientations)

    def opening(self, positions: FloatArray, tool_scale: FloatArray) -> FloatArray:
        """(W, K) further coordinates of tools at positions (W, N, 3) with scale `tool_scale` (W,) [m]."""
        if not self.layout.jaws:
            return np.zeros((len(positions), 0))
        apart = np.sqrt(((positions[:, 1] - positions[:, 0]) ** 2).sum(axis=1))
        return np.asarray(apart - self._reach * tool_scale)[:, None]

    def height_above_stop(self, positions: FloatArray, orientations: FloatArray, tool_scale: FloatArray) -> FloatArray:
        """Height of the tools' lowest point above the stop (W,); negative below it [m].

        Args:
            positions: (W, N, 3) positions of the tools [m].
            orientations: (W, N, 4) orientations of the tools.
            tool_scale: (W,) factor on the tools' lengths.
        """
        return self._lowest(positions, orientations, tool_scale) - self._stop

    def reach(
        self, grip: FloatArray, positions: FloatArray, orientations: FloatArray, tool_scale: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Region that the grip can reach with the tools' present rotation and opening: two corners (W, 3) of boxes [m].

        Args:
            grip: (W, 3) positions of the grip [m].
            positions: (W, N, 3) positions of the tools [m].
            orientations: (W, N, 4) orientations of the tools.
            tool_scale: (W,) factor on the tools' lengths.
        """
        low, high = (np.repeat(corner[None], len(grip), axis=0) for corner in (self._low, self._high))
        low[:, 2] = np.maximum(
            low[:, 2], self._stop - self._lowest(positions - grip[:, None], orientations, tool_scale)
        )
        return low, high

    def motion(
        self,
        actions: FloatArray,
        grip: FloatArray,
        positions: FloatArray,
        orientations: FloatArray,
        period: float,
        tool_scale: FloatArray | None = None,
        bed: FloatArray | None = None,
    ) -> Motion:
        """Motion of the tools in the coming control step.

        Args:
            actions: (W, A) actions in [-1, 1].
            grip: (W, 3) positions of the grip [m].
            positions: (W, N, 3) positions of the tools [m].
            orientations: (W, N, 4) orientations of the tools.
            period: Length of a control step [s].
            tool_scale: (W,) factor on the tools' lengths; ones by default.
            bed: (W,) velocities with which the beds of the organs rise [m/s]; None if they never move.

        Returns:
            Constant velocities that bring the tools to their target poses at the end of the step.
        """
        count = len(grip)
        rate = np.zeros((count, 3))
        if self._axes:
            rate[:, self._axes] = actions[:, 3 : 3 + len(self._axes)] * self.max_rotation_rate
            rate = self._kept_within_limits(rate, orientations[:, 0], period)
        scale = np.ones(count) if tool_scale is None else tool_scale
        arms = ends = positions - grip[:, None]
        angular = np.repeat(rate[:, None], positions.shape[1], axis=1)
        coordinate_rate = np.zeros((count, self.coordinates))
        if positions.shape[1] > 1:
            ends = turn(from_rotation_vector(rate * period)[:, None], arms) if self._axes else arms
            if self.layout.jaws:
                opening = self.opening(positions, scale)[:, 0]
                wanted = opening + actions[:, -1] * self.max_jaw_speed * period
                low, high = self.layout.opening_range
                # Jaws that are beyond a limit already must not jump back to it.
                wanted = np.minimum(np.maximum(wanted, np.minimum(low, opening)), np.maximum(high, opening))
                away = ends[:, 1] - ends[:, 0]
                away /= np.sqrt((away**2).sum(axis=1, keepdims=True))
                change = 0.5 * (wanted - opening)[:, None] * away
                ends = ends + np.stack([-change, change], axis=1)
                coordinate_rate[:, 0] = (wanted - opening) / period
        turned = multiply(from_rotation_vector(rate * period)[:, None], orientations) if self._axes else orientations
        least = np.repeat(self._low[None], count, axis=0)
        least[:, 2] = np.maximum(least[:, 2], self._stop - self._lowest(ends, turned, scale))
        fastest, slowest = (self._high - grip) / period, np.minimum((least - grip) / period, self.max_speed)
        wanted_velocity = actions[:, :3] * self.max_speed
        if bed is not None:
            # The robot stands still while the bed rises: relative to the bed, its tools sink.
            wanted_velocity[:, 2] -= bed
        velocity = np.minimum(np.maximum(wanted_velocity, slowest), fastest)
        linear = velocity[:, None] + (ends - arms) / period
        if bed is not None:
            velocity[:, 2] += bed
        return Motion(linear, angular, velocity, rate, coordinate_rate)

    def carried_out(
        self,
        motion: Motion,
        restrained: FloatArray,
        before: FloatArray,
        after: FloatArray,
        period: float,
        tool_scale: FloatArray,
        held: NDArray[np.bool_] | None = None,
        bed: FloatArray | None = None,
    ) -> Motion:
        """The motion carried out where tools did not follow the requested motion all the time.

        Args:
            motion: The requested motion.
            restrained: (W,) share of the time in which the tools were kept from it.
            before: (W, N, 3) positions of the tools before the control step [m].
            after: (W, N, 3) positions after it [m].
            period: Length of a control step [s].
            tool_scale: (W,) factor on the tools' lengths.
            held: (W,) where to replace the motion; None: where too great a force kept the tools from moving on.
            bed: As for `motion`.

        Returns:
            Mean velocities of the control step in these worlds; the requested motion in the others.
        """
        held = restrained > 0.0 if held is None else held
        linear = np.where(held[:, None, None], (after - before) / period, motion.linear)
        # In each physics step, tools turn as requested or not at all.
        turning = 1.0 - restrained
        coordinate_rate = motion.coordinate_rate.copy()
        if self.layout.jaws:
            opened = self.opening(after, tool_scale) - self.opening(before, tool_scale)
            coordinate_rate[held] = opened[held] / period
        velocity = linear.mean(axis=1)
        if bed is not None:
            velocity[:, 2] += bed
        return Motion(
            linear,
            motion.angular * turning[:, None, None],
            np.where(held[:, None], velocity, motion.velocity),
            motion.rate * turning[:, None],
            coordinate_rate,
        )

    def observe(self, situation: Situation) -> list[FloatArray]:
        """The values (W, k) of each of `parts`."""
        values = []
        if self._axes:
            turned = to_rotation_vector(self._turned(situation.tool_orientation))
            values += [turned[:, self._axes], situation.tool_rotation_rate[:, self._axes]]
        if self.layout.jaws:
            values += [situation.control, situation.control_rate]
        return values

    def _lowest(self, arms: FloatArray, orientations: FloatArray, scale: FloatArray) -> FloatArray:
        """(W,) height above the grip of the lowest point of tools at `arms` (W, N, 3) from it [m]."""
        heights = [
            arms[:, tool, 2]
            + (turn(orientations[:, tool, None], corners[None]) * scale[:, None, None])[..., 2].min(axis=1)
            for tool, corners in enumerate(self._corners)
        ]
        return np.asarray(np.min(heights, axis=0))

    def _turned(self, orientation: FloatArray) -> FloatArray:
        """Rotation (W, 4) of the tools from the scene's orientation, given the first tool's orientation (W, 4)."""
        return multiply(orientation, conjugate(self._orientations[0]))

    def _kept_within_limits(self, rate: FloatArray, orientation: FloatArray, period: float) -> FloatArray:
        """Reduce rates of rotation (W, 3) so that they do not exceed the greatest turn."""
        now = self._turned(orientation)
        after = to_rotation_vector(multiply(from_rotation_vector(rate * period), now))
        angle = np.sqrt((after**2).sum(axis=1))
        beyond = np.flatnonzero(angle > self.layout.max_turn)
        if len(beyond):
            target = from_rotation_vector(after[beyond] * (self.layout.max_turn / angle[beyond])[:, None])
            # Rotate only about the axes that the control has.
            allowed = np.zeros((len(beyond), 3))
            back = to_rotation_vector(multiply(target, conjugate(now[beyond]))) / period
            allowed[:, self._axes] = back[:, self._axes]
            # Scale all components together: a part of the way to an allowed rotation is allowed, too.
            fastest = np.abs(allowed).max(axis=1, keepdims=True)
            rate[beyond] = allowed * np.minimum(1.0, self.max_rotation_rate / np.maximum(fastest, 1e-12))
        return rate

    def _make_parts(self) -> tuple[PartSpec, ...]:
        parts = []
        if self._axes:
            ones = np.ones(len(self._axes))
            limit, rate = self.layout.max_turn * ones, self.max_rotation_rate * ones
            parts += [
                PartSpec("tool_orientation", "rad", -limit, limit, sensed=True),
                PartSpec("tool_rotation_rate", "rad/s", -rate, rate, sensed=True),
            ]
        if self.layout.jaws:
            low, high = self.layout.opening_range
            speed = np.full(1, self.max_jaw_speed)
            parts += [
                PartSpec("jaw_opening", "m", np.full(1, low), np.full(1, high), sensed=True),
                PartSpec("jaw_speed", "m/s", -speed, speed, sensed=True),
            ]
        return tuple(parts)


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of the tools during a control step.

    Attributes:
        linear: (W, N, 3) velocities of the tools relative to the bed [m/s].
        angular: (W, N, 3) rates of rotation of the tools [rad/s].
        velocity: (W, 3) velocity of the grip, of the robot that holds it [m/s].
        rate: (W, 3) rate of rotation about the grip [rad/s].
        coordinate_rate: (W, K) rates of change of the further coordinates [m/s].
    """

    linear: FloatArray
    angular: FloatArray
    velocity: FloatArray
    rate: FloatArray
    coordinate_rate: FloatArray


def _line_between(tools: tuple[ToolShape, ...]) -> tuple[FloatArray, float]:
    """Direction (3,) from the first of two tools to the second, and how far they extend towards each other [m]."""
    away = tools[1].offset - tools[0].offset
    away = away / np.sqrt(away @ away)
    first, second = ((turn(tool.orientation, tool.vertices) @ away) for tool in tools)
    return away, float(first.max() - second.min())


def as_action(value: Any, size: int) -> FloatArray:
    """Validate an action.

    Args:
        value: The agent's action.
        size: Number of components that it must have.

    Returns:
        (size,) the action clipped to [-1, 1], as an actuator would do.

    Raises:
        ValueError: If it is not `size` finite numbers.
    """
    action = _as_numbers(value, (size,), "action", f"{size} numbers")
    if not np.isfinite(action).all():
        raise ValueError(f"action must be finite, got {action.tolist()}")
    return np.minimum(np.maximum(action, -1.0), 1.0)


def as_actions(value: Any, count: int, size: int, ignored: NDArray[np.bool_] | None = None) -> FloatArray:
    """Validate the actions of many worlds.

    Args:
        value: The agents' actions.
        count: Number of worlds, W.
        size: Number of components that an action must have.
        ignored: (W,) worlds whose actions are ignored; they become zero, whatever was given.

    Returns:
        (W, size) the actions clipped to [-1, 1].

    Raises:
        ValueError: If they are not that many finite numbers.
    """
    actions = _as_numbers(value, (count, size), "actions", f"{count} times {size} numbers")
    if ignored is not None:
        actions[ignored] = 0.0
    wrong = np.flatnonzero(~np.isfinite(actions).all(axis=1))
    if len(wrong):
        raise ValueError(f"actions must be finite, got {actions[wrong[0]].tolist()} for world {wrong[0]}")
    return np.minimum(np.maximum(actions, -1.0), 1.0)


def _as_numbers(value: Any, shape: tuple[int, ...], name: str, wanted: str) -> FloatArray:
    try:
        numbers = as_floats(value)
    except ValueError as error:
        raise ValueError(f"{name} must be {wanted} in [-1, 1], got {value!r}") from error
    if numbers.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {numbers.shape}")
    return numbers
