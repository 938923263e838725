"""The rigid motion that best takes points to their present positions.

Contact of organs with themselves discounts it: an organ that rolls as a whole gets no nearer to itself.
"""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import array_kernel, inline_kernel

ITERATIONS = 12
"""Most steps of Newton's method for the rotation; a few suffice."""

CONVERGED = 1e-9
"""Greatest change of an entry in the last of these steps."""

FITTED = 64
"""About how many of the points are fitted where there are many."""

DEGENERATE = 1e-6
"""Least determinant of the points' matrix, scaled to a greatest entry of 1, from which a rotation is found."""


@inline_kernel
def _polar(matrix: np.ndarray) -> bool:
    """Replace a matrix (3, 3) by the rotation in its polar decomposition. Returns whether there is one.

    N. J. Higham, SIAM Journal on Scientific and Statistical Computing 7(4), 1986.
    """
    size = 0.0
    for i in range(3):
        for k in range(3):
            size = max(size, abs(matrix[i, k]))
    if not size > 0.0:
        return False
    for i in range(3):
        for k in range(3):
            matrix[i, k] /= size
    cofactors = np.empty((3, 3))
    for iteration in range(ITERATIONS):
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for m in range(3):
                n, o = (m + 1) % 3, (m + 2) % 3
                cofactors[i, m] = matrix[j, n] * matrix[k, o] - matrix[j, o] * matrix[k, n]
        determinant = matrix[0, 0] * cofactors[0, 0] + matrix[0, 1] * cofactors[0, 1] + matrix[0, 2] * cofactors[0, 2]
        if iteration == 0 and not determinant > DEGENERATE:
            return False
        change = 0.0
        for i in range(3):
            for k in range(3):
                value = 0.5 * (matrix[i, k] + cofactors[i, k] / determinant)
                change = max(change, abs(value - matrix[i, k]))
                matrix[i, k] = value
        if change < CONVERGED:
            break
    return True


@array_kernel
def _sum_points(before: np.ndarray, now: np.ndarray, step: int) -> tuple[float, float, float, float, float, float]:
    """The sums of every `step`-th of points `before` (3, V) and of points `now` (V, 3)."""
    # Sums are scalars: in arrays each would be written and read again for every point.
    x, y, z, u, v, w = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(0, now.shape[0], step):
        x, y, z = x + before[0, i], y + before[1, i], z + before[2, i]
        u, v, w = u + now[i, 0], v + now[i, 1], w + now[i, 2]
    return x, y, z, u, v, w


@array_kernel
def _fill_products(
    before: np.ndarray, now: np.ndarray, step: int, first: tuple[float, float, float],
    second: tuple[float, float, float], sums: np.ndarray,
) -> None:  # fmt: skip
    """Write the sums of products (3, 3) of points `now` (V, 3), less `second`, and `before` (3, V), less `first`."""
    first_x, first_y, first_z = first
    second_x, second_y, second_z = second
    xx, xy, xz, yx, yy, yz, zx, zy, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(0, now.shape[0], step):
        x, y, z = before[0, i] - first_x, before[1, i] - first_y, before[2, i] - first_z
        p, q, r = now[i, 0] - second_x, now[i, 1] - second_y, now[i, 2] - second_z
        xx, xy, xz = xx + p * x, xy + p * y, xz + p * z
        yx, yy, yz = yx + q * x, yy + q * y, yz + q * z
        zx, zy, zz = zx + r * x, zy + r * y, zz + r * z
    sums[0, 0], sums[0, 1], sums[0, 2] = xx, xy, xz
    sums[1, 0], sums[1, 1], sums[1, 2] = yx, yy, yz
    sums[2, 0], sums[2, 1], sums[2, 2] = zx, zy, zz


@inline_kernel
def fit_motion(before: np.ndarray, now: np.ndarray, rotation: np.ndarray, shift: np.ndarray) -> None:
    """Write the rigid motion that takes points to their present positions in the sense of least squares.

    It is approximate, as only about `FITTED` of many points are used. If they determine no rotation, it is a
    translation.

    Args:
        before: (3, V) earlier positions [u].
        now: (V, 3) present positions [u].
        rotation: (3, 3) written.
        shift: (3,) written: a point x has moved to rotation x + shift [u].
    """
    step = max(1, now.shape[0] // FITTED)
    count = (now.shape[0] + step - 1) // step
    x, y, z, u, v, w = _sum_points(before, now, step)
    first, second = (x / count, y / count, z / count), (u / count, v / count, w / count)
    _fill_products(before, now, step, first, second, rotation)
    if not _polar(rotation):
        rotation[:] = 0.0
        for axis in range(3):
            rotation[axis, axis] = 1.0
    for axis in range(3):
        shift[axis] = second[axis] - (
            rotation[axis, 0] * first[0] + rotation[axis, 1] * first[1] + rotation[axis, 2] * first[2]
        )


@array_kernel
def move_points(points: np.ndarray, rotation: np.ndarray, shift: np.ndarray, moved: np.ndarray) -> None:
    """Apply a rigid motion to points (3, V) [u]; the result is written into `moved` (3, V)."""
    for axis in range(3):
        a, b, c, d = rotation[axis, 0], rotation[axis, 1], rotation[axis, 2], shift[axis]
        for i in range(points.shape[1]):
            moved[axis, i] = a * points[0, i] + b * points[1, i] + c * points[2, i] + d


@array_kernel
def move_back(points: np.ndarray, rotation: np.ndarray, shift: np.ndarray, moved: np.ndarray) -> None:
    """Apply the inverse of a rigid motion to points (V, 3) [u]; the result is written into `moved` (V, 3)."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0] - shift[0], points[i, 1] - shift[1], points[i, 2] - shift[2]
        for axis in range(3):
            moved[i, axis] = rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis] * z
