"""An organ's tetrahedra at rest: averages around nodes, and the greatest frequency of vibration.

Strains and stresses are those of nodes, averaged over the tetrahedra around each by their volumes: with values of their
own, linear tetrahedra would lock where tissue hardly changes its volume, and are far too stiff where they are few
(Bonet and Burton, 1998; Puso and Solberg, 2006; see `docs/tissue.md`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray, Int32Array, IntArray

FASTEST_NODE = 4.0
"""Upper bound of a node's squared frequency, by that of the median node. Where the mesh is so fine that a node would
exceed it, the node is given mass of the others: about a thousandth of an organ's mass, which changes no force at rest
and spares all its nodes many substeps."""

POWER_STEPS = 120
"""Steps of power iteration, after which the greatest eigenvalue is found to a few per cent, from below."""


@dataclass(frozen=True, eq=False)
class Solid:
    """Tetrahedra at rest, and averages around their nodes.

    Two nodes of a tetrahedron are neighbours. There is a pair for each node and each of its neighbours, K in all, by
    nodes and then by neighbours.

    Attributes:
        nodes: (N, 3) at rest [u].
        tetrahedra: (M, 4) of positive volume, int32.
        volumes: (M,) [u3].
        shares: (N,) of the volume: a quarter of that of each tetrahedron around a node [u3].
        masses: (N,) of the nodes, at unit density: their shares, adjusted by `FASTEST_NODE` [u3].
        starts: (N + 1,) where each node's pairs begin.
        neighbours: (K,) the neighbour of each pair.
        gradients: (K, 3) of the neighbour's shape function, averaged around the node [1/u].
        reversed_gradients: (K, 3) of the node's shape function, averaged around the neighbour [1/u].
        own_gradients: (N, 3) of a node's shape function, averaged around itself [1/u].
        weights: (K,) integral of the scalar product of the gradients of both shape functions, negative [u].
    """

    nodes: FloatArray
    tetrahedra: Int32Array
    volumes: FloatArray = field(init=False)
    shares: FloatArray = field(init=False)
    masses: FloatArray = field(init=False)
    starts: IntArray = field(init=False)
    neighbours: IntArray = field(init=False)
    gradients: FloatArray = field(init=False)
    reversed_gradients: FloatArray = field(init=False)
    own_gradients: FloatArray = field(init=False)
    weights: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Derive all other attributes from nodes and tetrahedra."""
        count, corners = len(self.nodes), self.nodes[self.tetrahedra]
        edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
        volumes, inverses = np.linalg.det(edges) / 6.0, np.linalg.inv(edges)
        shapes = np.concatenate([-inverses.sum(axis=1, keepdims=True), inverses], axis=1)
        shares = np.bincount(self.tetrahedra.ravel(), np.repeat(0.25 * volumes, 4), count)
        # All sixteen ordered pairs of a tetrahedron's nodes, those of a node with itself among them.
        of = np.repeat(self.tetrahedra, 4, axis=1).ravel().astype(np.int64)
        to = np.tile(self.tetrahedra, (1, 4)).ravel().astype(np.int64)
        keys, places = np.unique(of * count + to, return_inverse=True)
        averaged = np.tile(shapes, (1, 4, 1)).reshape(-1, 3) * (0.25 * np.repeat(volumes, 16) / shares[of])[:, None]
        gradients = np.column_stack([np.bincount(places, averaged[:, k]) for k in range(3)])
        weights = np.bincount(places, np.einsum("mak,mbk,m->mab", shapes, shapes, volumes).ravel())
        of, to = np.divmod(keys, count)
        apart = of != to
        # The key of the reversed pair is made of the same two nodes in reversed order.
        backwards = np.searchsorted(keys, to * count + of)
        for name, value in (
            ("volumes", volumes),
            ("shares", shares),
            ("starts", np.searchsorted(of[apart], np.arange(count + 1))),
            ("neighbours", to[apart]),
            ("gradients", gradients[apart]),
            ("reversed_gradients", gradients[backwards][apart]),
            ("own_gradients", gradients[~apart]),
            ("weights", -weights[apart]),
        ):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "masses", self._spread_mass())

    def _spread_mass(self) -> FloatArray:
        """(N,) masses of the nodes, at unit density.

        By Gershgorin's theorem no squared frequency exceeds the greatest row sum of stiffness over mass; here the
        stiffness is that of a unit of resistance to volume change.
        """
        of, to, count = self.pair_nodes, self.neighbours, len(self.nodes)
        others, own = (np.linalg.norm(rows, axis=1) for rows in (self.gradients, self.own_gradients))
        rows = self.shares * (np.bincount(of, others, count) + own)
        stiffness = np.bincount(to, rows[of] * others, count) + rows * own
        fastest = FASTEST_NODE * float(np.median(stiffness / self.shares))
        masses = np.maximum(self.shares, stiffness / fastest)
        spread: FloatArray = masses * (self.shares.sum() / masses.sum())
        return spread

    @property
    def pair_nodes(self) -> IntArray:
        """(K,) the node of each pair."""
        return np.repeat(np.arange(len(self.nodes)), np.diff(self.starts))

    def deformations(self, positions: FloatArray) -> FloatArray:
        """(N, 3, 3) deformation gradients F at the nodes, for positions (N, 3)."""
        apart = positions[self.neighbours] - positions[self.pair_nodes]
        pulled = np.einsum("ka,kb->kab", apart, self.gradients)
        deformations: FloatArray = np.add.reduceat(pulled, self.starts[:-1], axis=0)
        return deformations

    def forces(self, stresses: FloatArray, positions: FloatArray, stabiliser: float) -> FloatArray:
        """(N, 3) forces on the nodes.

        Args:
            stresses: (N, 3, 3) first Piola-Kirchhoff stresses at the nodes.
            positions: (N, 3) of the nodes.
            stabiliser: Modulus that resists deformations of elements which the averages at their nodes do not see.
        """
        of, to = self.pair_nodes, self.neighbours
        loads = self.shares[:, None, None] * (stresses - stabiliser * self.deformations(positions))
        pulls = stabiliser * self.weights[:, None] * (positions[to] - positions[of])
        pulls -= np.einsum("kab,kb->ka", loads[to], self.reversed_gradients)
        forces: FloatArray = np.add.reduceat(pulls, self.starts[:-1], axis=0)
        forces -= np.einsum("nab,nb->na", loads, self.own_gradients)
        return forces

    def fastest(self, shear: float, bulk: float, stabiliser: float) -> float:
        """The greatest squared angular frequency of small motions, at unit density [1/s2].

        Args:
            shear: Shear modulus.
            bulk: Resistance to volume change: Lamé's first parameter.
            stabiliser: See `forces`.
        """
        # A fixed starting vector, so that the result is deterministic.
        shape, value = np.cos(np.arange(3.0 * len(self.nodes)) ** 2).reshape(-1, 3), 0.0
        for _ in range(POWER_STEPS):
            gradients = self.deformations(shape)
            stresses = shear * (gradients + np.swapaxes(gradients, 1, 2))
            stresses += bulk * np.trace(gradients, axis1=1, axis2=2)[:, None, None] * np.eye(3)
            shape = -self.forces(stresses, shape, stabiliser) / self.masses[:, None]
            value = float(np.sqrt((shape**2).sum()))
            shape /= value
        return value
