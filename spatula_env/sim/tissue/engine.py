"""The engine "tissue": organs made of a material, in one world or in many.

Like the batch engine, it takes a block of worlds through all physics steps of a control step before the next block:
organs are integrated for the whole block at once, and what follows is done world by world.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from spatula_env._kernels import kernel
from spatula_env.sim.engine import PRECISIONS, Abilities, Strains
from spatula_env.sim.lanes import choose_lanes
from spatula_env.sim.scene_checks import warn_of_long_steps
from spatula_env.sim.step import couple_worlds
from spatula_env.sim.tissue.body import TissueBody
from spatula_env.sim.tissue.kernels import Blocks, advance_block, advance_blocks, read_block, write_block
from spatula_env.sim.tissue.signals import organ_strains

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.arrays import BoolArray, FloatArray, IntArray
    from spatula_env.scenes import Scene
    from spatula_env.sim.engine import EngineOptions


class Inner(NamedTuple):
    """The state of tissue in one world that the surface nodes do not contain.

    Attributes:
        positions: (N, 3) of all nodes [u].
        velocities: (N, 3) of all nodes [u/s].
        free_velocities: (N, 3) velocities of surface nodes that were passed to contact [u/s].
        holds: (N, 3) changes of velocity by which surface nodes were held, as contact held them before [u/s].
        debts: (N, 3) velocities that are still to be added gradually to surface nodes [u/s].
        histories: (N, R, 6) of R terms of relaxation; empty where nothing relaxes.
    """

    positions: FloatArray
    velocities: FloatArray
    free_velocities: FloatArray
    holds: FloatArray
    debts: FloatArray
    histories: FloatArray


# Compiled when first called, because a process rarely needs both precisions.
@kernel(nogil=True)
def run_block(block: int, blocks: Blocks, coupling: Any, steps: int, share: float) -> None:
    """Take the worlds of a block through physics steps.

    Args:
        block: Index of the block.
        blocks: Arrays of the tissue in all worlds.
        coupling: `Coupling` of the worlds; see `step.couple_worlds`.
        steps: Number of physics steps.
        share: Length of one of them as a fraction of the control step.
    """
    state, positions, velocities, finite = coupling.state, blocks.positions, blocks.velocities, blocks.finite
    nodes, node_velocities, diverged, surface = state.nodes, state.velocities, state.diverged, blocks.surface
    lanes, node_count = positions.shape[3], nodes.shape[1]
    first = block * lanes
    end = min(first + lanes, nodes.shape[0])
    free_nodes, free_velocities = np.empty((end - first, node_count, 3)), np.empty((end - first, node_count, 3))
    for _ in range(steps):
        advance_block(blocks, block)
        read_block(positions[block], surface, free_nodes)
        read_block(velocities[block], surface, free_velocities)
        for w in range(first, end):
            if finite[block, w - first] != 0.0:
                diverged[w] = True
        couple_worlds(coupling, block, first, end, share, free_nodes, free_velocities)
        write_block(positions[block], surface, nodes[first:end])
        write_block(velocities[block], surface, node_velocities[first:end])


class TissueEngine:
    """A `TissueBody` of the scene's organs; see `engine.BlockEngine` and `engine.VaryingEngine`.

    Attributes:
        body: The organs.
        lanes: Worlds in a block.
    """

    abilities = Abilities(varies=True, strains=True, materials=True)

    def __init__(self, scene: Scene, worlds: int, options: EngineOptions) -> None:
        """See `engine.Engine`.

        Raises:
            ImportError: If an organ is not one of the presets' and Netgen is not installed; says what to install.
            ValueError: If an organ cannot be filled.

        Warns:
            SceneWarning: If steps are too long for contact with an organ; see `warn_of_long_steps`.
        """
        self.lanes = choose_lanes(worlds, options.threads)
        self.body = TissueBody(scene, worlds, lanes=self.lanes, dtype=PRECISIONS[options.precision])
        for lump in self.body.lumps:
            warn_of_long_steps(lump.placed.organ, lump.wave_speed, scene.dt)

    @property
    def inverse_masses(self) -> FloatArray:
        """See `engine.Engine`."""
        return self.body.inverse_masses

    @property
    def gravity(self) -> FloatArray:
        """See `engine.VaryingEngine`."""
        return self.body.gravity

    def set_parameters(
        self,
        *,
        gravity: ArrayLike | None,
        stiffness: ArrayLike | None,
        mass_scale: ArrayLike | None,
        worlds: IntArray,
    ) -> None:
        """See `engine.VaryingEngine`."""
        self.body.set_parameters(gravity=gravity, stiffness=stiffness, mass_scale=mass_scale, worlds=worlds)

    def advance(self, positions: FloatArray, velocities: FloatArray, diverged: BoolArray) -> None:
        """See `engine.Engine`."""
        body, going = self.body, np.flatnonzero(~diverged)
        blocks, surface = body.blocks, body.blocks.surface
        for array, values in ((blocks.positions, positions), (blocks.velocities, velocities)):
            nodes = body.read(array, going)
            nodes[:, surface] = values[going]
            body.write(array, going, nodes)
        advance_blocks(0, len(blocks.positions), blocks)
        positions[going] = body.read(blocks.positions, going)[:, surface]
        velocities[going] = body.read(blocks.velocities, going)[:, surface]
        diverged |= ~body.finite

    def run_block(self, block: int, coupling: Any, steps: int, share: float) -> None:
        """See `engine.BlockEngine`."""
        run_block(block, self.body.blocks, coupling, steps, share)

    def halt(self, positions: FloatArray, worlds: IntArray) -> None:
        """See `engine.Engine`."""
        blocks = self.body.blocks
        nodes = self.body.read(blocks.positions, worlds)
        nodes[:, blocks.surface] = positions
        self.body.write(blocks.positions, worlds, nodes)
        # Contact continues: the changes of velocity by contact are kept.
        jumps = self.body.read(blocks.free_velocities, worlds) - self.body.read(blocks.velocities, worlds)
        self.body.write(blocks.free_velocities, worlds, jumps)
        self.body.write(blocks.velocities, worlds, 0.0)

    def strains(self, worlds: IntArray, threshold: float) -> Strains:
        """See `engine.StrainedEngine`."""
        return organ_strains(self.body, worlds, threshold)

    def save(self, worlds: IntArray) -> tuple[Inner, ...]:
        """See `engine.Engine`."""
        blocks = self.body.blocks
        arrays = [
            self.body.read(array, worlds)
            for array in (
                blocks.positions,
                blocks.velocities,
                blocks.free_velocities,
                blocks.holds,
                blocks.debts,
                blocks.histories,
            )
        ]
        return tuple(Inner(*rows) for rows in zip(*arrays, strict=True))

    def restore(self, positions: FloatArray, velocities: FloatArray, inner: Sequence[Any], worlds: IntArray) -> None:
        """See `engine.Engine`.

        Raises:
            ValueError: If an inner state is that of other organs; nothing has then changed.
        """
        body, blocks = self.body, self.body.blocks
        nodes = body.follow(positions)
        moving, told, holds, debts = (np.zeros_like(nodes) for _ in range(4))
        moving[:, blocks.surface] = told[:, blocks.surface] = velocities
        shape = (blocks.histories.shape[1], *blocks.histories.shape[2:-1])
        histories = np.zeros((len(worlds), *shape))
        for row, state in enumerate(inner):
            if state is not None:
                if state.positions.shape != nodes.shape[1:] or state.histories.shape != shape:
                    raise ValueError(
                        f"an inner state must be of {nodes.shape[1]} nodes and histories of shape {shape}, got "
                        f"{len(state.positions)} and {state.histories.shape}"
                    )
                nodes[row], moving[row], told[row], holds[row], debts[row], histories[row] = state
        nodes[:, blocks.surface], moving[:, blocks.surface] = positions, velocities
        body.write(blocks.positions, worlds, nodes)
        body.write(blocks.velocities, worlds, moving)
        body.write(blocks.free_velocities, worlds, told)
        body.write(blocks.holds, worlds, holds)
        body.write(blocks.debts, worlds, debts)
        body.write(blocks.histories, worlds, histories)
        body.write(blocks.finite, worlds, 0.0)

    def close(self) -> None:
        """See `engine.Engine`: there is nothing to free."""
