"""Nodes inside an organ that follow its surface as a rigid body."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray, IntArray


def follow_surface(rest: FloatArray, surface: IntArray, positions: FloatArray) -> FloatArray:
    """(n, N, 3) positions of all nodes of an organ for surface nodes at (n, V, 3): inner nodes follow as a rigid body.

    They get the rotation and the shift that bring the surface at rest closest to the given one (W. Kabsch, 1976).

    Args:
        rest: (N, 3) all nodes at rest [u].
        surface: (V,) indices of the surface nodes.
        positions: (n, V, 3) of the surface nodes [u].
    """
    here = rest[surface]
    middle, middles = here.mean(axis=0), positions.mean(axis=1, keepdims=True)
    u, _, vt = np.linalg.svd(np.einsum("nva,vb->nab", positions - middles, here - middle))
    u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
    nodes: FloatArray = np.einsum("nab,vb->nva", u @ vt, rest - middle) + middles
    nodes[:, surface] = positions
    return nodes
