"""Pose of an organ that lies free: its surface at rest, moved rigidly to where the organ is now."""

from __future__ import annotations

import numpy as np

from spatula_env.arrays import FloatArray


def moved_as_a_whole(nodes: FloatArray, rest_nodes: FloatArray) -> FloatArray:
    """Rotate and shift organs at rest to where they lie now.

    Rotation and horizontal shift are those that bring the nodes at rest closest to the present ones (W. Kabsch, A
    solution for the best rotation to relate two sets of vectors, Acta Crystallographica A 32:922, 1976). The height is
    not fitted, as an organ that is pressed has not sunk: its lowest point stays as low as at rest.

    Args:
        nodes: (W, V, 3) present nodes [m].
        rest_nodes: (W, V, 3) nodes at rest, or (1, V, 3) if they are the same for all [m].

    Returns:
        (W, V, 3) moved nodes [m].
    """
    middle, rest_middle = nodes.mean(axis=1, keepdims=True), rest_nodes.mean(axis=1, keepdims=True)
    away, rest_away = nodes - middle, rest_nodes - rest_middle
    left, _, right = np.linalg.svd(np.swapaxes(rest_away, 1, 2) @ away)
    # Ensure a rotation, not a reflection.
    left[:, :, 2] *= np.sign(np.linalg.det(left) * np.linalg.det(right))[:, None]
    moved = rest_away @ (left @ right)
    moved[:, :, :2] += middle[:, :, :2]
    moved[:, :, 2] += (rest_nodes[:, :, 2].min(axis=1) - moved[:, :, 2].min(axis=1))[:, None]
    return np.ascontiguousarray(moved)
