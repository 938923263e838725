"""How tissue is strained and stressed: values at nodes, and the summary that is reported for an organ."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from spatula_env.sim.engine import Strains
from spatula_env.sim.tissue.kernels import find_deformations
from spatula_env.sim.tissue.nodal import SYMMETRIC

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.arrays import FloatArray, IntArray
    from spatula_env.sim.tissue.body import TissueBody
    from spatula_env.sim.tissue.hyperelastic import Hyperelastic

Symmetric = dict[tuple[int, int], "FloatArray"]
"""The components of a symmetric tensor, each (...), by `SYMMETRIC`."""

HIGH = 0.95
"""Share of an organ's volume in which the values reported as high are not exceeded. Peaks, in contrast, are those of
single nodes, and depend on how fine the mesh is where a tool's edge presses."""

LEAST_DETERMINANT = 0.05
"""Least determinant of F by which stress is divided: where tissue is compressed further, the stress says little."""


THIRD_OF_A_TURN = 2.0 * math.pi / 3.0


class NodalStrains(NamedTuple):
    """Strain and stress at all nodes of a body, including those inside organs.

    Attributes:
        strains: (n, N) greatest principal Green-Lagrange strain: half of (squared stretch less one).
        stresses: (n, N) greatest principal Cauchy stress, tension positive, without viscous stress [kg/(u s2)].
    """

    strains: FloatArray
    stresses: FloatArray


def nodal_strains(body: TissueBody, worlds: IntArray) -> NodalStrains:
    """Strains and stresses at the nodes of some worlds.

    Args:
        body: The organs; its workspace is overwritten.
        worlds: (n,) which worlds.
    """
    blocks = body.blocks
    find_deformations(blocks)
    # Components first, so that the following operations access memory in order.
    flat = np.ascontiguousarray(np.moveaxis(body.read(blocks.stresses, worlds), 2, 0))
    relaxed = body.read(blocks.overstresses, worlds)
    strains, stresses = np.empty(flat.shape[1:]), np.empty(flat.shape[1:])
    first = 0
    for lump in body.lumps:
        nodes = slice(first, first + len(lump.masses))
        f = [[flat[3 * i + j][:, nodes] for j in range(3)] for i in range(3)]
        # The left Cauchy-Green tensor has the squared stretches as eigenvalues too, and the directions of the stress.
        left = {(i, j): f[i][0] * f[j][0] + f[i][1] * f[j][1] + f[i][2] * f[j][2] for i, j in SYMMETRIC}
        squares = eigenvalues(left)
        state = _State.of(lump.law, f, squares)
        strains[:, nodes] = 0.5 * (squares[0] - 1.0)
        if lump.material.relaxation:
            stresses[:, nodes] = eigenvalues(_relaxed_stress(state, f, left, relaxed[:, nodes]))[0]
        else:
            of_each = [square * (state.of_first - state.of_second * square) for square in squares]
            stresses[:, nodes] = np.maximum(np.maximum(*of_each[:2]), of_each[2]) / state.divisor + state.pressure
        first = nodes.stop
    return NodalStrains(strains, stresses * body.stiffness[worlds, None])


class _State(NamedTuple):
    """Cauchy stress is (of_first B - of_second B B) / divisor + pressure, B being the left Cauchy-Green tensor."""

    of_first: FloatArray
    of_second: FloatArray
    pressure: FloatArray
    divisor: FloatArray

    @classmethod
    def of(cls, law: Hyperelastic, f: list[list[FloatArray]], squares: list[FloatArray]) -> _State:
        """The state for deformation gradients with these squared stretches."""
        a, b, c = squares
        first, second = a + b + c, a * b + b * c + c * a
        volume = (
            f[0][0] * (f[1][1] * f[2][2] - f[1][2] * f[2][1])
            + f[0][1] * (f[1][2] * f[2][0] - f[1][0] * f[2][2])
            + f[0][2] * (f[1][0] * f[2][1] - f[1][1] * f[2][0])
        )
        slope = np.clip(2.0 * law.c3 * (first + second - 6.0 * volume), 0.0, law.greatest_slope)
        of_second = 2.0 * (law.c2 + slope)
        return cls(
            of_first=2.0 * (law.c1 + slope) + of_second * first,
            of_second=of_second,
            pressure=law.bulk * (volume - 1.0) - law.rest_pressure - 6.0 * slope,
            divisor=np.maximum(volume, LEAST_DETERMINANT),
        )


def _relaxed_stress(state: _State, f: list[list[FloatArray]], left: Symmetric, relaxed: FloatArray) -> Symmetric:
    """Cauchy stress, less the relaxed part (n, N, 6) of the stress in the reference configuration."""
    stress: Symmetric = {}
    for i, j in SYMMETRIC:
        squared = sum(left[min(i, k), max(i, k)] * left[min(k, j), max(k, j)] for k in range(3))
        pulled = state.of_first * left[i, j] - state.of_second * squared
        for component, (a, b) in enumerate(SYMMETRIC):
            both = f[i][a] * f[j][b] + f[i][b] * f[j][a] if a != b else f[i][a] * f[j][a]
            pulled = pulled - relaxed[:, :, component] * both
        stress[i, j] = pulled / state.divisor + state.pressure if i == j else pulled / state.divisor
    return stress


def eigenvalues(tensor: Symmetric) -> list[FloatArray]:
    """The three eigenvalues of symmetric tensors, each (...), the greatest first.

    Trigonometric solution (O. K. Smith, Eigenvalues of a symmetric 3 x 3 matrix, Communications of the ACM 4, 1961).
    """
    mean = (tensor[0, 0] + tensor[1, 1] + tensor[2, 2]) / 3.0
    a, b, c = (tensor[k, k] - mean for k in range(3))
    d, e, g = tensor[0, 1], tensor[1, 2], tensor[0, 2]
    size = np.sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + g * g)) / 6.0)
    determinant = a * (b * c - e * e) - d * (d * c - e * g) + g * (d * e - b * g)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.where(size > 0.0, determinant / (2.0 * size * size * size), 1.0)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0)) / 3.0
    greatest = mean + 2.0 * size * np.cos(angle)
    least = mean + 2.0 * size * np.cos(angle + THIRD_OF_A_TURN)
    return [greatest, 3.0 * mean - greatest - least, least]


def organ_strains(body: TissueBody, worlds: IntArray, threshold: float) -> Strains:
    """Summarise strains and stresses of organs in some worlds; see `Strains`.

    Args:
        body: The organs.
        worlds: (n,) which worlds.
        threshold: Strain beyond which volume counts in `Strains.strained_shares`.
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
    """(n,) value that is not exceeded in `HIGH` of the volume, from values (n, N) at nodes with shares (N,) of it."""
    order = np.argsort(values, axis=1)
    reached = np.cumsum(shares[order], axis=1) >= HIGH
    places = np.take_along_axis(order, np.argmax(reached, axis=1)[:, None], axis=1)
    quantile: FloatArray = np.take_along_axis(values, places, axis=1)[:, 0]
    return quantile
