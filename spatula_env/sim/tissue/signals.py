"""How tissue is strained and stressed: what its nodes tell, and what is told of an organ."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from spatula_env.sim.engine import Strains
from spatula_env.sim.tissue.kernels import find_deformations
from spatula_env.sim.tissue.nodal import SYMMETRIC

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.arrays import FloatArray, IntArray
    from spatula_env.sim.tissue.body import Lump, TissueBody

Symmetric = dict[tuple[int, int], "FloatArray"]
"""The components of a symmetric tensor, each (...), by `SYMMETRIC`."""

HIGH = 0.95
"""The share of an organ's volume that does not exceed what is told as high: peaks are of single nodes, and depend on
how fine the mesh is where a tool's edge presses."""

LEAST_DETERMINANT = 0.05
"""Of F, by which stress is divided: of what is pressed to less it says little."""


class NodalStrains(NamedTuple):
    """Strain and stress at all nodes of a body, those within organs included.

    Attributes:
        strains: (n, N) greatest principal Green-Lagrange strain: half of the squared stretch less one.
        stresses: (n, N) greatest principal Cauchy stress, tension positive; viscous stress aside [kg/(u s2)].
    """

    strains: FloatArray
    stresses: FloatArray


def nodal_strains(body: TissueBody, worlds: IntArray) -> NodalStrains:
    """Strains and stresses at the nodes of some worlds.

    Args:
        body: The organs; what is left in its workspace is written.
        worlds: (n,) which.
    """
    blocks = body.blocks
    find_deformations(blocks)
    # Component by component, so that what follows goes through memory in order.
    flat = np.ascontiguousarray(np.moveaxis(body.read(blocks.stresses, worlds), 2, 0))
    f = [[flat[3 * i + j] for j in range(3)] for i in range(3)]
    right = {(i, j): f[0][i] * f[0][j] + f[1][i] * f[1][j] + f[2][i] * f[2][j] for i, j in SYMMETRIC}
    strains = 0.5 * (greatest_eigenvalue(right) - 1.0)
    stresses, relaxed = np.empty_like(strains), body.read(blocks.overstresses, worlds)
    first = 0
    for lump in body.lumps:
        nodes = slice(first, first + len(lump.masses))
        own = [[entry[:, nodes] for entry in row] for row in f]
        gone = relaxed[:, nodes] if lump.material.relaxation else None
        stresses[:, nodes] = greatest_eigenvalue(_cauchy_stress(lump, own, gone))
        first = nodes.stop
    return NodalStrains(strains, stresses * body.stiffness[worlds, None])


def _cauchy_stress(lump: Lump, f: list[list[FloatArray]], relaxed: FloatArray | None) -> Symmetric:
    """Cauchy stress where the deformation gradient is `f`, less what has relaxed of the stress at rest (n, N, 6)."""
    law = lump.law
    left = {(i, j): f[i][0] * f[j][0] + f[i][1] * f[j][1] + f[i][2] * f[j][2] for i, j in SYMMETRIC}

    def entry(i: int, j: int) -> FloatArray:
        return left[min(i, j), max(i, j)]

    squared = {(i, j): sum(entry(i, k) * entry(k, j) for k in range(3)) for i, j in SYMMETRIC}
    first = left[0, 0] + left[1, 1] + left[2, 2]
    second = 0.5 * (first**2 - (squared[0, 0] + squared[1, 1] + squared[2, 2]))
    volume = (
        f[0][0] * (f[1][1] * f[2][2] - f[1][2] * f[2][1])
        + f[0][1] * (f[1][2] * f[2][0] - f[1][0] * f[2][2])
        + f[0][2] * (f[1][0] * f[2][1] - f[1][1] * f[2][0])
    )
    slope = np.clip(2.0 * law.c3 * (first + second - 6.0 * volume), 0.0, law.greatest_slope)
    of_second = 2.0 * (law.c2 + slope)
    of_first = 2.0 * (law.c1 + slope) + of_second * first
    pressure = law.bulk * (volume - 1.0) - law.rest_pressure - 6.0 * slope
    divisor = np.maximum(volume, LEAST_DETERMINANT)
    stress: Symmetric = {}
    for i, j in SYMMETRIC:
        pulled = of_first * left[i, j] - of_second * squared[i, j]
        if relaxed is not None:
            for k, (a, b) in enumerate(SYMMETRIC):
                both = f[i][a] * f[j][b] + f[i][b] * f[j][a] if a != b else f[i][a] * f[j][a]
                pulled = pulled - relaxed[:, :, k] * both
        stress[i, j] = pulled / divisor + pressure if i == j else pulled / divisor
    return stress


def greatest_eigenvalue(tensor: Symmetric) -> FloatArray:
    """(...) of symmetric tensors, by the cosine (O. K. Smith, Eigenvalues of a symmetric 3 x 3 matrix, 1961)."""
    mean = (tensor[0, 0] + tensor[1, 1] + tensor[2, 2]) / 3.0
    a, b, c = (tensor[k, k] - mean for k in range(3))
    d, e, g = tensor[0, 1], tensor[1, 2], tensor[0, 2]
    size = np.sqrt((a**2 + b**2 + c**2 + 2.0 * (d**2 + e**2 + g**2)) / 6.0)
    determinant = a * (b * c - e**2) - d * (d * c - e * g) + g * (d * e - b * g)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.where(size > 0.0, determinant / (2.0 * size**3), 1.0)
    greatest: FloatArray = mean + 2.0 * size * np.cos(np.arccos(np.clip(cosine, -1.0, 1.0)) / 3.0)
    return greatest


def organ_strains(body: TissueBody, worlds: IntArray, threshold: float) -> Strains:
    """What is told of organs in some worlds; see `Strains`.

    Args:
        body: The organs.
        worlds: (n,) which.
        threshold: Of strain, for the share beyond it.
    """
    found = nodal_strains(body, worlds)
    shape = len(worlds), len(body.lumps)
    told = Strains(*(np.zeros(shape) for _ in Strains._fields))
    first = 0
    for organ, lump in enumerate(body.lumps):
        nodes = slice(first, first + len(lump.masses))
        shares = lump.solid.shares / lump.solid.shares.sum()
        strains, stresses = found.strains[:, nodes], found.stresses[:, nodes]
        told.peak_strains[:, organ], told.peak_stresses[:, organ] = strains.max(axis=1), stresses.max(axis=1)
        told.high_strains[:, organ] = _quantile(strains, shares)
        told.high_stresses[:, organ] = _quantile(stresses, shares)
        told.strained_shares[:, organ] = (strains > threshold) @ shares
        first = nodes.stop
    return told


def _quantile(values: FloatArray, shares: NDArray[np.float64]) -> FloatArray:
    """(n,) what `HIGH` of the volume does not exceed, of values (n, N) at nodes with shares (N,) of it."""
    order = np.argsort(values, axis=1)
    reached = np.cumsum(shares[order], axis=1) >= HIGH
    places = np.take_along_axis(order, np.argmax(reached, axis=1)[:, None], axis=1)
    quantile: FloatArray = np.take_along_axis(values, places, axis=1)[:, 0]
    return quantile
