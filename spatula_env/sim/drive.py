"""The protective stop of a robot, applied in every physics step: a tool that meets too great a force stops pushing.

A rigid tool with prescribed motion has no limit of force: driven against nodes that are held, it would squeeze the
tissue between to nothing, which no device does. The force in one physics step decides about the motion in the next, as
in a robot's inner loop; a limit that is checked once per control step would act many physics steps too late.
"""

from __future__ import annotations

import numpy as np

from spatula_env._kernels import ARRAYS, kernel

F8_2 = ARRAYS["f8_2"]


@kernel((F8_2, F8_2, F8_2, F8_2, ARRAYS["f8"].dtype, F8_2, F8_2))
def restrain(
    positions: np.ndarray,
    linear: np.ndarray,
    angular: np.ndarray,
    forces: np.ndarray,
    limit: float,
    restrained_linear: np.ndarray,
    restrained_angular: np.ndarray,
) -> bool:
    """Remove the part of a hand's motion that pushes on against too great a force. Its tools keep their arrangement.

    Args:
        positions: (N, 3) of the hand's tools [u].
        linear: (N, 3) requested velocities [u/s].
        angular: (N, 3) requested angular velocities [rad/s].
        forces: (N, 3) on the tools in the last physics step [kg u/s2].
        limit: Greatest force on a tool that does not restrain the motion [kg u/s2].
        restrained_linear: (N, 3) written. The common motion of all tools loses its component against each force beyond
            the limit. Two jaws go on opening or closing along the line between them unless one of those forces resists.
        restrained_angular: (N, 3) written: zero if a force is beyond the limit.

    Returns:
        Whether a force is beyond the limit; if not, the requested motion is written unchanged.
    """
    count = positions.shape[0]
    stopped = False
    for k in range(count):
        squared = 0.0
        for axis in range(3):
            squared += forces[k, axis] * forces[k, axis]
            restrained_linear[k, axis], restrained_angular[k, axis] = linear[k, axis], angular[k, axis]
        stopped |= squared > limit * limit
    if not stopped:
        return False
    common = np.zeros(3)
    for k in range(count):
        for axis in range(3):
            common[axis] += linear[k, axis] / count
            restrained_angular[k, axis] = 0.0
    # For two jaws: half the speed at which they move apart, along the line from the first to the second.
    away, parting = np.zeros(3), 0.0
    if count == 2:
        distance = 0.0
        for axis in range(3):
            away[axis] = positions[1, axis] - positions[0, axis]
            distance += away[axis] * away[axis]
        for axis in range(3):
            away[axis] /= np.sqrt(distance)
            parting += 0.5 * (linear[1, axis] - linear[0, axis]) * away[axis]
    for k in range(count):
        squared, onward, parts = 0.0, 0.0, 0.0
        for axis in range(3):
            squared += forces[k, axis] * forces[k, axis]
            onward += common[axis] * forces[k, axis]
            parts += away[axis] * forces[k, axis]
        if squared <= limit * limit:
            continue
        if onward < 0.0:
            for axis in range(3):
                common[axis] -= onward / squared * forces[k, axis]
        if (parts if k == 1 else -parts) * parting < 0.0:
            parting = 0.0
    for k in range(count):
        for axis in range(3):
            restrained_linear[k, axis] = common[axis] + (parting if k == 1 else -parting) * away[axis]
    return True
