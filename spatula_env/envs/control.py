"""From an agent's action to the tool's motion: the workspace, and control by velocity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spatula_env.geometry.checks import check_positive

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

FloatArray = NDArray[np.float64]

FALCON_WORKSPACE = 0.1016
"""Edge of the cube in which the Novint Falcon's grip moves, 4 inches [m]."""


@dataclass(frozen=True)
class Workspace:
    """A cube that the tool's position is kept in, and the frame whose origin is the cube's middle.

    The axes are those of the scene: x to the right, y away from the operator, z up. A Falcon's own axes are x
    to the right, y up, z towards the operator, so x = x_F, y = -z_F and z = y_F.

    Attributes:
        center: (3,) the cube's middle in the scene [u].
        length: Metres in a scene unit of length.
        size: Edge of the cube [m].
    """

    center: tuple[float, float, float]
    length: float
    size: float = FALCON_WORKSPACE

    def __post_init__(self) -> None:
        """Check the values."""
        check_positive(self.length, "length")
        check_positive(self.size, "size")

    @property
    def low(self) -> FloatArray:
        """(3,) lower corner [m]."""
        return np.full(3, -0.5 * self.size)

    @property
    def high(self) -> FloatArray:
        """(3,) upper corner [m]."""
        return np.full(3, 0.5 * self.size)

    def from_scene(self, points: ArrayLike) -> FloatArray:
        """Points (..., 3) of the scene [u] in the workspace frame [m]."""
        return (np.asarray(points, dtype=np.float64) - self.center) * self.length

    def to_scene(self, points: ArrayLike) -> FloatArray:
        """Points (..., 3) of the workspace frame [m] in the scene [u]."""
        return np.asarray(points, dtype=np.float64) / self.length + self.center


class VelocityControl:
    """The action is the tool's velocity, as a fraction of the greatest speed along each axis.

    The tool is stopped at the workspace's faces: the component of the velocity that would lead out of it is
    cut to what just reaches the face by the end of the control step.

    Attributes:
        max_speed: Along each axis [m/s].
        size: Numbers in an action.
    """

    size = 3

    def __init__(self, workspace: Workspace, max_speed: float, period: float) -> None:
        """Set up the control.

        Args:
            workspace: Where the tool may move.
            max_speed: Along each axis [m/s].
            period: Length of a control step [s].

        Raises:
            ValueError: If a number is not positive and finite.
        """
        check_positive(max_speed, "max_speed")
        check_positive(period, "period")
        self.max_speed = float(max_speed)
        self._rate = 1.0 / period
        self._low, self._high = workspace.low, workspace.high

    def velocity(self, action: FloatArray, position: FloatArray) -> FloatArray:
        """The velocity of the coming control step.

        Args:
            action: (W, 3) in [-1, 1].
            position: (W, 3) of the tool [m].

        Returns:
            (W, 3) [m/s].
        """
        fastest = (self._high - position) * self._rate
        slowest = (self._low - position) * self._rate
        return np.asarray(np.minimum(np.maximum(action * self.max_speed, slowest), fastest))


def as_action(value: Any, size: int) -> FloatArray:
    """Check an action.

    Args:
        value: What the agent gave.
        size: How many numbers it must hold.

    Returns:
        (size,) clipped to [-1, 1], as an actuator would.

    Raises:
        ValueError: If it is not `size` finite numbers.
    """
    action = _as_numbers(value, (size,), "action", f"{size} numbers")
    if not np.isfinite(action).all():
        raise ValueError(f"action must be finite, got {action.tolist()}")
    return np.minimum(np.maximum(action, -1.0), 1.0)


def as_actions(value: Any, count: int, size: int, ignored: NDArray[np.bool_] | None = None) -> FloatArray:
    """Check the actions of many worlds.

    Args:
        value: What the agents gave.
        count: How many worlds there are, W.
        size: How many numbers an action must hold.
        ignored: (W,) whose action does not count; it becomes zero, whatever it is.

    Returns:
        (W, size) clipped to [-1, 1].

    Raises:
        ValueError: If it is not that many finite numbers.
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
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be {wanted} in [-1, 1], got {value!r}") from error
    if numbers.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {numbers.shape}")
    return numbers
