"""Marks that show a goal in a picture, independent of how they are drawn.

Lengths are in metres and points in the workspace frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spatula_env.arrays import FloatArray

ROLES = ("goal", "target", "caution")
"""Meanings of a patch's colour: what is asked for, what is acted on, what must be spared."""


@dataclass(frozen=True, eq=False)
class Ring:
    """A ring.

    Attributes:
        point: (3,) centre [m].
        radius: Radius [m].
        normal: (3,) unit vector across its plane; upwards by default.
    """

    point: FloatArray
    radius: float
    normal: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True, eq=False)
class Path:
    """A polyline.

    Attributes:
        points: (K, 3) its points [m].
    """

    points: FloatArray


@dataclass(frozen=True, eq=False)
class Points:
    """A set of points.

    Attributes:
        points: (K, 3) the points [m].
    """

    points: FloatArray


@dataclass(frozen=True, eq=False)
class Patch:
    """A part of the organ's surface that moves with the organ.

    Attributes:
        nodes: (K,) indices of the organ's nodes; a triangle all of whose corners are among them belongs to it.
        role: Meaning of its colour, one of `ROLES`.
    """

    nodes: NDArray[np.int64]
    role: str = "target"

    def __post_init__(self) -> None:
        """Check the role."""
        if self.role not in ROLES:
            raise ValueError(f"role must be one of {list(ROLES)}, got {self.role!r}")


Mark = Ring | Path | Points | Patch
"""Any of the marks that show a goal."""
