"""Time of impact of two moving features: a vertex and a triangle, or two edges, whose vertices move on straight lines.

Four points are in one plane when the volume that they span is zero, which is a cubic in time (Provot, Graphics
Interface 1997). Each of its roots is a time at which the features may meet; whether they do depends on where they then
are on each other.
"""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import array_kernel

ROOT_STEPS = 24
"""Most steps to close in on a root."""

ROOT_PRECISION = 1e-6
"""Precision to which times of meeting are found, as a fraction of the time between the two positions."""


@array_kernel
def fill_volume(before: np.ndarray, now: np.ndarray, volume: np.ndarray) -> None:
    """Write the volume u x v . w as a cubic in time.

    Args:
        before: (9,) u, v and w at time zero.
        now: (9,) u, v and w at time one.
        volume: (4,) written: its Bernstein coefficients. The first and the last are its values at times zero and one;
            if all have the same sign, it has no root in between.
    """
    ux, uy, uz, vx, vy, vz = before[0], before[1], before[2], before[3], before[4], before[5]
    px, py, pz, qx, qy, qz = now[0], now[1], now[2], now[3], now[4], now[5]
    ax, ay, az = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    cx, cy, cz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    bx = uy * qz - uz * qy + py * vz - pz * vy
    by = uz * qx - ux * qz + pz * vx - px * vz
    bz = ux * qy - uy * qx + px * vy - py * vx
    x, y, z, r, s, t = before[6], before[7], before[8], now[6], now[7], now[8]
    volume[0] = ax * x + ay * y + az * z
    volume[1] = (bx * x + by * y + bz * z + ax * r + ay * s + az * t) / 3.0
    volume[2] = (cx * x + cy * y + cz * z + bx * r + by * s + bz * t) / 3.0
    volume[3] = cx * r + cy * s + cz * t


@array_kernel
def has_no_root(volume: np.ndarray) -> bool:
    """Whether a cubic is known to keep its sign."""
    low = min(min(volume[0], volume[1]), min(volume[2], volume[3]))
    high = max(max(volume[0], volume[1]), max(volume[2], volume[3]))
    return bool(low > 0.0 or high < 0.0)


@array_kernel
def _value(volume: np.ndarray, time: float) -> float:
    """The value of a cubic with Bernstein coefficients `volume` (4,) at a time."""
    rest = 1.0 - time
    first = rest * rest * (rest * volume[0] + 3.0 * time * volume[1])
    value: float = first + time * time * (3.0 * rest * volume[2] + time * volume[3])
    return value


@array_kernel
def find_roots(volume: np.ndarray, roots: np.ndarray) -> int:
    """Write the times from 0 to 1 at which a cubic changes its sign (3,), ascending. Returns how many there are."""
    # Between its extrema the cubic is monotonic.
    first, second, third = volume[1] - volume[0], volume[2] - volume[1], volume[3] - volume[2]
    a, b, c = first - 2.0 * second + third, second - first, first
    one, two, inner = 1.0, 1.0, 0
    square = b * b - a * c
    if square > 0.0:
        # The roots of the derivative, a t^2 + 2 b t + c, without cancellation.
        q = -b - np.sqrt(square) if b > 0.0 else -b + np.sqrt(square)
        first, second = q / a if a != 0.0 else -1.0, c / q if q != 0.0 else -1.0
        if 0.0 < max(first, second) < 1.0:
            one, inner = max(first, second), 1
        if 0.0 < min(first, second) < 1.0:
            one, two, inner = min(first, second), one, inner + 1
    found = 0
    for k in range(inner + 1):
        low = 0.0 if k == 0 else (one if k == 1 else two)
        high = 1.0 if k == inner else (one if k == 0 else two)
        at_low, at_high = _value(volume, low), _value(volume, high)
        if (at_low > 0.0) == (at_high > 0.0):
            continue
        for _ in range(ROOT_STEPS):
            if high - low <= ROOT_PRECISION:
                break
            # False position, kept at least 5 % of the interval away from both ends.
            middle = low + (high - low) * min(max(at_low / (at_low - at_high), 0.05), 0.95)
            value = _value(volume, middle)
            if (value > 0.0) == (at_low > 0.0):
                low, at_low = middle, value
            else:
                high, at_high = middle, value
        roots[found] = 0.5 * (low + high)
        found += 1
    return found
