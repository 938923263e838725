"""Nodes that contact holds, between two of its resolutions: the method of the engine "tissue", for NumPy's arrays.

Contact is resolved once in a step, after all substeps. A node that it changed the velocity of is held in that direction
through the substeps of the next step, for as long as tissue pushes against it, and is given to contact as it would be
without; see `docs/tissue.md`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.sim.tissue.held import GIVEN_BACK, LEAST_JUMP, LONGEST_THROW

if TYPE_CHECKING:
    from spatula_env.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Held:
    """What is known of contact with S surface nodes of a world; the arrays are written to.

    Attributes:
        free_velocities: (S, 3) velocities that were passed to contact [u/s].
        holds: (S, 3) changes of velocity by which nodes have been held [u/s].
        debts: (S, 3) velocities that are still to be given back gradually [u/s].
    """

    free_velocities: FloatArray
    holds: FloatArray
    debts: FloatArray

    @classmethod
    def zeros(cls, count: int) -> Held:
        """Nodes at rest that nothing touches."""
        return cls(*(np.zeros((count, 3)) for _ in range(3)))

    def take_contact(self, positions: FloatArray, velocities: FloatArray, dt: float) -> FloatArray:
        """Find the directions in which contact has changed velocities, and release the nodes that it left alone.

        Args:
            positions: (S, 3) after contact; written [u].
            velocities: (S, 3) after contact; written [u/s].
            dt: Length of a step [s].

        Returns:
            (S, 3) directions; zero for a node that is free.
        """
        jumps = velocities - self.free_velocities
        squared = np.einsum("sa,sa->s", jumps, jumps)[:, None]
        is_free = squared < LEAST_JUMP
        # A node that is released was held for one step too long: it keeps the motion, and owes the difference.
        owed = np.where(is_free, self.holds, 0.0)
        positions += owed * self._throw_times(dt)
        velocities += owed
        self.debts[:] = (1.0 - GIVEN_BACK) * self.debts - owed
        self.holds[:] = 0.0
        directions: FloatArray = np.where(is_free, 0.0, jumps / np.sqrt(np.maximum(squared, LEAST_JUMP)))
        return directions

    def hold(
        self,
        directions: FloatArray,
        before: FloatArray,
        positions: FloatArray,
        velocities: FloatArray,
        length: float,
        share: float,
    ) -> None:
        """Correct a substep, so that no node gains velocity against the direction in which it is held.

        Args:
            directions: (S, 3) what `take_contact` returned.
            before: (S, 3) velocities before the substep [u/s].
            positions: (S, 3) after it; written [u].
            velocities: (S, 3) after it; written [u/s].
            length: Length of the substep [s].
            share: The same as a fraction of the step.
        """
        change = GIVEN_BACK * share * self.debts
        gains = velocities - before + change
        against = np.minimum(np.einsum("sa,sa->s", gains, directions), 0.0)[:, None] * directions
        self.holds[:] -= against
        change -= against
        velocities += change
        positions += length * change

    def give_free(self, positions: FloatArray, velocities: FloatArray, dt: float) -> None:
        """Move nodes to where they would be if nothing had held them, so that contact may hold them again.

        Args:
            positions: (S, 3) written [u].
            velocities: (S, 3) written [u/s].
            dt: Length of a step [s].
        """
        velocities -= self.holds
        positions -= self.holds * self._throw_times(dt)
        self.free_velocities[:] = velocities

    def _throw_times(self, dt: float) -> FloatArray:
        """(S, 1) times for which nodes are moved on freely: a step, or until `LONGEST_THROW`."""
        squared = np.einsum("sa,sa->s", self.holds, self.holds)[:, None]
        times: FloatArray = np.minimum(LONGEST_THROW / np.sqrt(np.maximum(squared, LEAST_JUMP)), dt)
        return times
