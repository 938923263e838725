"""Centre of pressure of a plate from the force and torque on it, as for a force sensor behind a foot or a finger."""

from __future__ import annotations

import numpy as np

from spatula_env.arrays import BoolArray, FloatArray
from spatula_env.geometry.rotations import conjugate, turn
from spatula_env.tasks.situation import Situation


def centre_of_pressure(
    situation: Situation, low: FloatArray, high: FloatArray, least_force: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Compute the centre of pressure on a plate's lower face.

    It is the point of the face about which the contact force has no moment along the face (P. Sardain and G. Bessonnet,
    Forces acting on a biped robot: center of pressure, zero moment point, IEEE Transactions on Systems, Man, and
    Cybernetics A 34:630, 2004).

    Args:
        situation: Situation of W worlds with one tool each.
        low: (3,) lower corner of the plate, in its own frame: its lower face is perpendicular to z [m].
        high: (3,) upper corner [m].
        least_force: Normal force below which nothing counts as touched [N].

    Returns:
        The centre (W, 3), or the middle of the face if nothing is touched [m]; the normal force (W,), positive if the
        organ pushes against the lower face [N]; and whether the plate touches the organ (W,).
    """
    back = conjugate(situation.tool_orientation)
    force, torque = turn(back, situation.contact_force), turn(back, situation.contact_torque)
    scale = situation.tool_scale
    height, normal = scale * low[2], force[:, 2]
    touching = normal >= least_force
    by = np.where(touching, normal, 1.0)
    across = np.stack([height * force[:, 0] - torque[:, 1], height * force[:, 1] + torque[:, 0]], axis=1) / by[:, None]
    # Friction at the plate's rims is not modelled, so keep the centre on the plate.
    across = np.clip(across, scale[:, None] * low[:2], scale[:, None] * high[:2])
    place = np.column_stack([np.where(touching[:, None], across, 0.0), height])
    return situation.tool_position + turn(situation.tool_orientation, place), normal, touching
