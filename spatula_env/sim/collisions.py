"""Contact that an engine resolves itself, one of `OWN_CONTACTS`: engines have the tools, detectors only observe."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.contact import settings
from spatula_env.contact.flags import FlaggedDetector
from spatula_env.contact.step import measure_depth
from spatula_env.sim import step

if TYPE_CHECKING:
    from collections.abc import Sequence

    from spatula_env.arrays import IntArray
    from spatula_env.contact.world import World
    from spatula_env.scenes import PlacedTool, Scene
    from spatula_env.sim.engine import CollidingEngine


class Collisions:
    """The work before and after each step of an engine that has the tools itself; every block is one world."""

    def __init__(
        self,
        scene: Scene,
        engine: CollidingEngine,
        contacts: Sequence[World],
        coupling: Any,
        state: step.State,
        sums: step.Sums,
        last: step.LastStep,
    ) -> None:
        """Create the detectors.

        Args:
            scene: The scene with the organs and tools.
            engine: The engine, which has the scene's tools.
            contacts: Contact of each world; its memories are shared with the detectors.
            coupling: `step.Coupling` of the worlds.
            state: The state in `coupling`; written.
            sums: The sums in `coupling`; added to.
            last: The last step in `coupling`; written.
        """
        self._engine, self._contacts, self._coupling, self._dt = engine, contacts, coupling, scene.dt
        self._state, self._sums, self._last = state, sums, last
        starts = np.cumsum([0, *(len(placed.organ.vertices) for placed in scene.organs)])
        self._organs = [
            (slice(int(start), int(end)), np.array(placed.organ.triangles))
            for (start, end), placed in zip(pairwise(starts), scene.organs, strict=True)
        ]
        self._detectors = [self._watch(world, scene.tools) for world in range(len(contacts))]

    def _watch(self, world: int, tools: Sequence[PlacedTool]) -> list[FlaggedDetector]:
        """Create a detector for each tool (outer) and organ (inner) that uses the memory of the world's contact."""
        detectors = [FlaggedDetector(placed.tool) for placed in tools for _ in self._organs]
        for detector, memory in zip(detectors, self._contacts[world].memories, strict=True):
            detector.memory = memory
        return detectors

    def set_tools(self, tools: Sequence[PlacedTool], world: int) -> None:
        """Exchange the tools of a world; after that, the engine must be given a state."""
        self._engine.set_tools(tools, world)
        self._detectors[world] = self._watch(world, tools)

    def place(self, worlds: IntArray) -> None:
        """Put the engine's tools of some worlds (n,) where the state says they are."""
        state = self._state
        for w in worlds.tolist():
            self._engine.place_tools(state.tool_positions[w], state.tool_orientations[w], w)

    def begin(self, share: float) -> None:
        """Give the engine the tools' motion in the coming step, which is a fraction `share` of the control step."""
        step.drive_worlds(self._coupling, share)
        last = self._last
        for w in np.flatnonzero(~self._state.diverged).tolist():
            self._engine.move_tools(last.positions[w], last.orientations[w], last.linear[w], last.angular[w], w)

    def finish(self) -> None:
        """Read the impulses on the tools in a step, and observe how they overlap the organs."""
        state, sums, last = self._state, self._sums, self._last
        for w in np.flatnonzero(~state.diverged).tolist():
            impulses = self._engine.tool_impulses(last.linear[w], last.angular[w], w)
            # The coupling itself has no tools here, so it has written the ground's wrench first.
            last.wrenches[w, -1] = last.wrenches[w, 0]
            last.wrenches[w, :-1] = impulses
            last.impulses[w] = np.nan
            wrenches = impulses / self._dt
            sums.forces[w] += wrenches[:, :3]
            sums.torques[w] += wrenches[:, 3:]
            sums.peak_forces[w] = np.maximum(sums.peak_forces[w], np.sqrt((wrenches[:, :3] ** 2).sum(axis=1)))
            state.tool_forces[w] = wrenches[:, :3]
            state.tool_positions[w], state.tool_orientations[w] = last.positions[w], last.orientations[w]
            self._observe(w)

    def _observe(self, w: int) -> None:
        """Detect the contacts of a world at the end of a step, without resolving them."""
        last, nodes, deepest = self._last, self._state.nodes[w], 0.0
        for index, detector in enumerate(self._detectors[w]):
            tool, organ = divmod(index, len(self._organs))
            part, triangles = self._organs[organ]
            found = detector.detect(
                last.positions[w, tool],
                last.orientations[w, tool],
                nodes[part],
                triangles,
                last.linear[w, tool],
                last.angular[w, tool],
            )
            deepest = max(deepest, float(found.depth.max()))
        depth = measure_depth(self._contacts[w].structure, last.positions[w], last.orientations[w], nodes)
        result, sums = last.result[w], self._sums
        result[settings.QUERIES], result[settings.CONTACT_COUNT] = 1, 0
        result[settings.PENETRATION] = sums.penetrations[w] = deepest
        result[settings.RESIDUAL] = depth
        sums.residuals[w] = max(sums.residuals[w], depth)
