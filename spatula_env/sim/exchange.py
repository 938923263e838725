"""Conversions for an engine that takes forces and returns positions: forces from displacements and velocity changes."""

from __future__ import annotations

import numpy as np
from numba import types

from spatula_env._kernels import ARRAYS, kernel

F8, F8_2, I8 = ARRAYS["f8"], ARRAYS["f8_2"], ARRAYS["i8"]


@kernel(types.int64(F8_2, F8_2, F8_2, F8, types.float64, I8, F8_2))
def forces_of_changes(
    velocity_changes: np.ndarray,
    displacements: np.ndarray,
    leftover: np.ndarray,
    masses: np.ndarray,
    dt: float,
    nodes: np.ndarray,
    forces: np.ndarray,
) -> int:
    """The forces that displace nodes, and change their velocities, within one step.

    A displacement is applied as a velocity for the length of a step. That velocity remains in the engine afterwards,
    and is removed with the next forces.

    Args:
        velocity_changes: (V, 3) [u/s].
        displacements: (V, 3) [u].
        leftover: (V, 3) displacements of the step before [u].
        masses: (V,) [kg].
        dt: Length of the step [s].
        nodes: (V,) written: which nodes get a force.
        forces: (V, 3) written, in that order [kg u/s2].

    Returns:
        How many nodes get one.
    """
    count = 0
    for i in range(velocity_changes.shape[0]):
        pushed = False
        for axis in range(3):
            change = velocity_changes[i, axis] + (displacements[i, axis] - leftover[i, axis]) / dt
            forces[count, axis] = change * masses[i] / dt
            pushed |= change != 0.0
        if pushed:
            nodes[count] = i
            count += 1
    return count


@kernel(types.boolean(F8_2, F8_2, F8_2, types.float64, F8_2))
def velocities_of_positions(
    before: np.ndarray, displacements: np.ndarray, after: np.ndarray, dt: float, velocities: np.ndarray
) -> bool:
    """Compute the nodes' velocities (V, 3) from their positions before and after a step, and their displacements.

    Returns whether all are finite.
    """
    finite = True
    for i in range(before.shape[0]):
        for axis in range(3):
            velocities[i, axis] = (after[i, axis] - (before[i, axis] + displacements[i, axis])) / dt
            finite &= abs(velocities[i, axis]) < np.inf
    return finite
