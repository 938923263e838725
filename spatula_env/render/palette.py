"""Colours: the scene's palette, colour maps, and the conversion between sRGB and linear light.

Colours in this package are triples in 0..1 with the sRGB transfer curve, as colour pickers show them; the renderer
computes in linear light and encodes once, at the end.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatula_env.pressure_limits import COST_PRESSURE, VIOLATION_PRESSURE

Color = tuple[float, float, float]
"""Red, green and blue in 0..1, sRGB-encoded."""

TISSUE: Color = (0.83, 0.545, 0.53)
"""Outside of the organ."""
TISSUE_INSIDE: Color = (0.82, 0.43, 0.40)
"""Inside of the organ, seen where it is cut away."""
STEEL: Color = (0.80, 0.815, 0.83)
"""The spatula."""
FORCE: Color = (0.13, 0.42, 0.80)
"""Arrows of forces."""
GOAL: Color = (0.10, 0.62, 0.47)
"""Goals and targets."""
MARKER: Color = (0.34, 0.20, 0.62)
"""Gentian violet, with which surgeons mark tissue: parts of the organ that a task is about."""
CAUTION: Color = (0.62, 0.07, 0.10)
"""Parts of the organ that must be spared."""
FEASIBLE: Color = (0.16, 0.65, 0.35)
"""Contact nodes whose contact counts."""
UNFEASIBLE: Color = (0.84, 0.20, 0.22)
"""Contact nodes whose contact is rejected."""
IDLE: Color = (0.45, 0.48, 0.53)
"""Contact nodes without contact."""


def to_color(value: ArrayLike, name: str = "color") -> Color:
    """Check one colour.

    Args:
        value: three numbers in 0..1.
        name: the name that an error shows.

    Returns:
        The colour as a tuple of floats.

    Raises:
        ValueError: if `value` is not three finite numbers in 0..1.
    """
    numbers = np.asarray(value, dtype=np.float64)
    if numbers.shape == (3,):
        red, green, blue = numbers.tolist()
        if 0.0 <= red <= 1.0 and 0.0 <= green <= 1.0 and 0.0 <= blue <= 1.0:
            return (red, green, blue)
    raise ValueError(f"{name} must be three numbers in 0..1, got {value!r}")


def linear_color(color: Color) -> Color:
    """One colour in linear light (IEC 61966-2-1)."""
    red, green, blue = (value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4 for value in color)
    return (red, green, blue)


def srgb_to_linear(color: ArrayLike) -> NDArray[np.float64]:
    """Decode sRGB values (any shape, 0..1) to linear light (IEC 61966-2-1)."""
    value = np.asarray(color, dtype=np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((np.maximum(value, 0.04045) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(light: ArrayLike) -> NDArray[np.float64]:
    """Encode linear light (any shape) as sRGB values (IEC 61966-2-1), clipped to 0..1."""
    value = np.clip(np.asarray(light, dtype=np.float64), 0.0, 1.0)
    return np.where(value <= 0.0031308, value * 12.92, 1.055 * np.maximum(value, 0.0031308) ** (1 / 2.4) - 0.055)


# Linear sRGB -> cone responses -> Oklab: B. Ottosson, "A perceptual color space for image processing", 2020.
_LINEAR_TO_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_CONES_TO_OKLAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


def srgb_to_oklab(color: ArrayLike) -> NDArray[np.float64]:
    """Colours (..., 3) in sRGB to Oklab (..., 3): lightness, green-red, blue-yellow."""
    return np.asarray(np.cbrt(srgb_to_linear(color) @ _LINEAR_TO_CONES.T) @ _CONES_TO_OKLAB.T)


def oklab_to_srgb(color: ArrayLike) -> NDArray[np.float64]:
    """Colours (..., 3) in Oklab to sRGB (..., 3), clipped to what a display can show."""
    cones = (np.asarray(color, dtype=np.float64) @ np.linalg.inv(_CONES_TO_OKLAB).T) ** 3
    return linear_to_srgb(cones @ np.linalg.inv(_LINEAR_TO_CONES).T)


@dataclass(frozen=True)
class ColorMap:
    """A colour map in which equal steps of the value are equal perceived steps.

    The stops are joined by straight lines in Oklab and the path is walked at constant speed, so no part of the range
    looks flatter than another and none shows an edge that the data does not have. If the lightness of the stops is
    monotonic, so is the map's, and it can be read in grey as well. If positions of the stops are given, the speed is
    constant between two stops.

    Attributes:
        stops: two or more colours, from the lowest value to the highest.
        positions: position of each stop in the range, from 0 to 1, ascending; None: those that follow from constant
            speed.
    """

    stops: tuple[Color, ...]
    positions: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if len(self.stops) < 2:
            raise ValueError(f"stops must be two colours or more, got {len(self.stops)}")
        object.__setattr__(self, "stops", tuple(to_color(stop, "stops") for stop in self.stops))
        if self.positions is None:
            return
        at = tuple(float(position) for position in self.positions)
        if len(at) != len(self.stops) or at[0] != 0.0 or at[-1] != 1.0 or any(b <= a for a, b in pairwise(at)):
            raise ValueError(f"positions must ascend from 0 to 1, {len(self.stops)} of them, got {self.positions}")
        object.__setattr__(self, "positions", at)

    @cached_property
    def table(self) -> NDArray[np.float64]:
        """The map at 256 equally spaced values, (256, 3), read-only."""
        stops = srgb_to_oklab(self.stops)
        lengths = np.linalg.norm(np.diff(stops, axis=0), axis=1)
        if not bool(np.all(lengths > 0.0)):
            raise ValueError(f"stops must differ from one to the next, got {self.stops}")
        at = np.concatenate([[0.0], np.cumsum(lengths)]) / lengths.sum()
        if self.positions is not None:
            at = np.array(self.positions)
        wanted = np.linspace(0.0, 1.0, 256)
        table = oklab_to_srgb(np.stack([np.interp(wanted, at, stops[:, k]) for k in range(3)], axis=1))
        table.flags.writeable = False
        return table

    def __call__(self, values: ArrayLike, low: float = 0.0, high: float = 1.0) -> NDArray[np.float64]:
        """Colours of values.

        Args:
            values: any shape; below `low` and above `high` the end colours are used.
            low: the value of the first stop.
            high: the value of the last stop, above `low`.

        Returns:
            sRGB colours in 0..1, the shape of `values` + (3,).

        Raises:
            ValueError: if `high` is not above `low`, or a value is not a number.
        """
        if not high > low:
            raise ValueError(f"high must be above low, got low={low}, high={high}")
        value = (np.asarray(values, dtype=np.float64) - low) / (high - low)
        if bool(np.any(np.isnan(value))):
            raise ValueError("values must be numbers, got NaN")
        position = np.clip(value, 0.0, 1.0) * 255.0
        index = np.minimum(position.astype(np.intp), 254)
        part = (position - index)[..., None]
        return np.asarray(self.table[index] * (1.0 - part) + self.table[index + 1] * part)


PRESSURE_LIMITS = (COST_PRESSURE, VIOLATION_PRESSURE)
"""Contact pressures at which the colours change as a warning [Pa]."""

HIGHEST_PRESSURE = 8000.0
"""Pressure at the upper end of the colour map [Pa]."""

PRESSURE = ColorMap(
    (TISSUE, (0.89, 0.48, 0.02), (0.70, 0.07, 0.13), (0.27, 0.0, 0.16)),
    positions=(0.0, PRESSURE_LIMITS[0] / HIGHEST_PRESSURE, PRESSURE_LIMITS[1] / HIGHEST_PRESSURE, 1.0),
)
"""Contact pressure on the organ from zero to `HIGHEST_PRESSURE`: bare tissue, amber at the lower limit, crimson at the
upper one, nearly black at the end. Lightness only falls, so the map can be read in grey too; between the limits it
falls fastest."""

SPEED = ColorMap(((0.80, 0.86, 0.95), (0.30, 0.55, 0.85), (0.08, 0.20, 0.50)))
"""Motion, for trails and speeds: pale to deep blue."""
