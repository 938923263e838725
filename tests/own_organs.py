"""Organs as `spatula organ prepare` writes them, for tests: made of formulas, without its libraries."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry import PreparedOrgan, fissured_block, icosphere, ridged_block
from spatula_env.geometry.prepared import UNIT_LENGTH, write_prepared

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import ArrayLike

    from spatula_env.arrays import FloatArray


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


def mound(depth: float = 0.026, width: float = 0.0045) -> PreparedOrgan:
    """A bumpy mound with a slightly bent fissure in it, which says where the floor is; held at its bottom."""
    block = fissured_block(
        (5.6, 4.6, 2.6), depth / UNIT_LENGTH, 2.8, width / UNIT_LENGTH, 0.25, base_edge_length=0.6, lip=0.15
    )
    vertices = _domed(block.vertices)
    floor = block.floor[np.argsort(vertices[block.floor, 0])]
    line = floor[np.abs(np.asarray(block.vertices)[floor, 1]) < 1e-9]
    held = np.flatnonzero(vertices[:, 2] < 0.006 / UNIT_LENGTH)
    return PreparedOrgan(
        vertices, block.triangles, "mound", held=tuple(held.tolist()), lines={"fissure": tuple(line.tolist())}
    )


def fold(width: float = 0.013, height: float = 0.024) -> PreparedOrgan:
    """A bumpy mound with a slightly bent ridge on it, which says where the crest is; it lies free."""
    block = ridged_block((3.6, 3.0, 1.0), height / UNIT_LENGTH, 2.2, width / UNIT_LENGTH, 0.22, base_edge_length=0.5)
    vertices = _domed(block.vertices, 0.03)
    line = block.crest[np.abs(np.asarray(block.vertices)[block.crest, 1]) < 1e-9]
    line = line[np.asarray(block.vertices)[line, 2] > block.vertices[:, 2].max() - 0.02]
    line = line[np.argsort(vertices[line, 0])]
    return PreparedOrgan(vertices, block.triangles, "fold", lines={"ridge": tuple(line.tolist())})


def _domed(vertices: FloatArray, bumps: float = 0.06) -> FloatArray:
    """A block on the ground with its rim lowered, bent in the horizontal plane, and with bumps."""
    x, y, z = np.asarray(vertices).T
    high = z / z.max()
    away = (x / x.max()) ** 2 + (y / y.max()) ** 2
    z = z * (1.0 - 0.2 * away) + bumps * high * np.sin(2.1 * x + 0.4) * np.cos(1.7 * y)
    radius, angle = 14.0 + y, x / 14.0
    return np.column_stack([radius * np.sin(angle), radius * np.cos(angle) - 14.0, z - z.min()])


def written(organ: PreparedOrgan, folder: Path) -> str:
    """Path of a file with an organ."""
    path = folder / f"{organ.name}.npz"
    write_prepared(path, organ)
    return str(path)
