"""Python access to the kernels that find which features of organs are near each other."""

from __future__ import annotations

import numpy as np
from numba import njit

from spatula_env.contact.self_contact import keep_uncrossed
from spatula_env.contact.skin import make_near, make_skin
from spatula_env.contact.structures import copy_constraints, make_constraints


@njit
def edges_of(skin):
    return skin.edges.copy()


@njit
def triangles_of(skin):
    return skin.triangles.copy()


@njit
def pairs_of(near):
    counts = near.counts
    return (
        near.vertex_pairs[: counts[0]].copy(),
        near.edge_pairs[: counts[1]].copy(),
        near.cross_pairs[: counts[2]].copy(),
    )


@njit
def patches_of(skin):
    return (
        skin.triangle_starts.copy(), skin.triangle_order.copy(), skin.edge_starts.copy(), skin.edge_order.copy(),
        skin.vertex_starts.copy(), skin.vertex_order.copy(),
    )  # fmt: skip


@njit
def _uncross(skin, near, none, held, vertices, mean_edge):
    return keep_uncrossed(skin, near, np.ones(len(vertices)), 0, none.table, held, vertices, mean_edge)


def uncrossed(skin, near, held, vertices, mean_edge=1.0):
    """Positions to which vertices of equal mass are held back by `keep_uncrossed`, and its result."""
    points = vertices.copy()
    return points, _uncross(skin, near, make_constraints(1), held, points, mean_edge)


def skin_of(*organs):
    """A `Skin` of some organs, and a `Near` of it."""
    skin = make_skin([np.array(organ.triangles) for organ in organs], [len(organ.vertices) for organ in organs])
    return skin, make_near(skin)


def gathered(gather_organs, skin, near, held, vertices, mean_edge=1.0, friction=0.0):
    """Names, features and rows of the constraints between organs."""
    constraints = make_constraints(16)
    count = gather_organs(constraints, 0, skin, near, held, vertices, vertices, held, mean_edge, friction, True)
    return copy_constraints(constraints, count)
