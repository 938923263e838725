"""The engine "batch": Bullet's soft body for many worlds, in this package's compiled code.

A block of worlds is taken through all physics steps of a control step before the next block, so that its state stays in
the processor's cache. Organs are integrated for the whole block at once (see `batch_body`); what follows is done world
by world, by the code that all engines share (see `step`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env._kernels import kernel
from spatula_env.sim.batch_body import BatchBody, Blocks, advance_block, read_block, write_block
from spatula_env.sim.engine import PRECISIONS, Abilities
from spatula_env.sim.lanes import choose_lanes
from spatula_env.sim.soft_body import SWEEPS, join, soft_body
from spatula_env.sim.step import couple_worlds

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.arrays import BoolArray, FloatArray, IntArray
    from spatula_env.scenes import Scene
    from spatula_env.sim.engine import EngineOptions


# Compiled when first called, because a process rarely needs both precisions.
@kernel(nogil=True)
def run_block(block: int, blocks: Blocks, coupling: Any, steps: int, share: float) -> None:
    """Take the worlds of a block through physics steps.

    Args:
        block: Index of the block.
        blocks: Arrays of the body in all worlds.
        coupling: `Coupling` of the worlds; see `step.couple_worlds`.
        steps: Number of physics steps.
        share: Length of one of them as a fraction of the control step.
    """
    state, positions, velocities, finite = coupling.state, blocks.positions, blocks.velocities, blocks.finite
    nodes, node_velocities, diverged = state.nodes, state.velocities, state.diverged
    lanes, node_count = positions.shape[3], nodes.shape[1]
    first = block * lanes
    end = min(first + lanes, nodes.shape[0])
    free_nodes, free_velocities = np.empty((end - first, node_count, 3)), np.empty((end - first, node_count, 3))
    for _ in range(steps):
        advance_block(blocks, block)
        # All worlds of the block at once, because the worlds are adjacent in memory.
        read_block(positions[block], free_nodes)
        read_block(velocities[block], free_velocities)
        for w in range(first, end):
            if finite[block, w - first] != 0.0:
                diverged[w] = True
        couple_worlds(coupling, block, first, end, share, free_nodes, free_velocities)
        write_block(positions[block], nodes[first:end])
        write_block(velocities[block], node_velocities[first:end])


class BatchEngine:
    """A `BatchBody` of the scene's organs; see `engine.BlockEngine` and `engine.VaryingEngine`.

    Attributes:
        lanes: Worlds in a block.
    """

    abilities = Abilities(springs=True, varies=True, sweeps=SWEEPS)

    def __init__(self, scene: Scene, worlds: int, options: EngineOptions) -> None:
        """See `engine.Engine`."""
        self._body = BatchBody(
            join([soft_body(placed) for placed in scene.organs]),
            worlds,
            dt=scene.dt,
            gravity=scene.gravity,
            dtype=PRECISIONS[options.precision],
            lanes=choose_lanes(worlds, options.threads),
        )
        self.lanes: int = self._body.blocks.positions.shape[3]

    @property
    def inverse_masses(self) -> FloatArray:
        """See `engine.Engine`."""
        return self._body.inverse_masses

    @property
    def gravity(self) -> FloatArray:
        """See `engine.VaryingEngine`."""
        return self._body.gravity

    def set_parameters(
        self,
        *,
        gravity: ArrayLike | None,
        stiffness: ArrayLike | None,
        mass_scale: ArrayLike | None,
        worlds: IntArray,
    ) -> None:
        """See `engine.VaryingEngine`."""
        self._body.set_parameters(gravity=gravity, stiffness=stiffness, mass_scale=mass_scale, worlds=worlds)

    def advance(self, positions: FloatArray, velocities: FloatArray, diverged: BoolArray) -> None:
        """See `engine.Engine`."""
        going = np.flatnonzero(~diverged)
        self._body.set_state(positions[going], velocities[going], going)
        self._body.step()
        positions[going], velocities[going] = self._body.get_state(going)
        diverged |= ~self._body.finite

    def run_block(self, block: int, coupling: Any, steps: int, share: float) -> None:
        """See `engine.BlockEngine`."""
        run_block(block, self._body.blocks, coupling, steps, share)

    def halt(self, positions: FloatArray, worlds: IntArray) -> None:
        """See `engine.Engine`."""
        self._body.set_state(positions, 0.0, worlds)

    def save(self, worlds: IntArray) -> tuple[None, ...]:
        """See `engine.Engine`: all nodes are surface nodes, so there is nothing else to save."""
        return (None,) * len(worlds)

    def restore(self, positions: FloatArray, velocities: FloatArray, inner: Sequence[Any], worlds: IntArray) -> None:
        """See `engine.Engine`."""
        self._body.set_state(positions, velocities, worlds)

    def close(self) -> None:
        """See `engine.Engine`: there is nothing to free."""
