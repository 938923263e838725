"""Organs as `spatula organ prepare` writes them, for tests: made of formulas, without its libraries."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry import PreparedOrgan, icosphere
from spatula_env.geometry.prepared import UNIT_LENGTH, write_prepared

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import ArrayLike


def ellipsoid(axes: ArrayLike = (0.045, 0.035, 0.025), held_below: float = 0.008, divisions: int = 3) -> PreparedOrgan:
    """An ellipsoid with half axes [m] that stands on the plane z = 0 and is held below a height [m]."""
    ball = icosphere(1.0, divisions)
    vertices = np.asarray(ball.vertices) * np.asarray(axes) / UNIT_LENGTH
    vertices[:, 2] -= vertices[:, 2].min()
    held = np.flatnonzero(vertices[:, 2] < held_below / UNIT_LENGTH)
    return PreparedOrgan(vertices, ball.triangles, "ellipsoid", held=tuple(held.tolist()))


def bean(divisions: int = 3) -> PreparedOrgan:
    """An ellipsoid that is bent in the horizontal plane, as a kidney is; held at its bottom."""
    organ = ellipsoid((0.048, 0.032, 0.026), 0.01, divisions)
    x, y, z = np.asarray(organ.vertices).T * UNIT_LENGTH
    radius, angle = 0.06 + y, x / 0.06
    bent = np.column_stack([radius * np.sin(angle), radius * np.cos(angle) - 0.06, z]) / UNIT_LENGTH
    return PreparedOrgan(bent, organ.triangles, "bean", held=organ.held)


def written(organ: PreparedOrgan, folder: Path) -> str:
    """Path of a file with an organ."""
    path = folder / f"{organ.name}.npz"
    write_prepared(path, organ)
    return str(path)
