"""The engine "mujoco": organs as MuJoCo's flexes, one world after the other.

MuJoCo computes forces and integrates, with contact of its own switched off; what holds the surface is this package's
contact model, as with all engines. With `contact="mujoco"`, MuJoCo has the tools too, and does all of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from spatula_env.sim.engine import Abilities
from spatula_env.sim.follow import follow_surface
from spatula_env.sim.mujoco.held import Held
from spatula_env.sim.mujoco.loading import import_mujoco
from spatula_env.sim.mujoco.model import FlexModel
from spatula_env.sim.mujoco.tools import FlexTools, silent
from spatula_env.sim.scene_checks import warn_of_long_steps

if TYPE_CHECKING:
    from spatula_env.arrays import BoolArray, FloatArray, IntArray
    from spatula_env.scenes import PlacedTool, Scene
    from spatula_env.sim.engine import EngineOptions


class Inner(NamedTuple):
    """The state of a world that the surface nodes do not contain.

    Attributes:
        positions: (I, 3) of the inner nodes [u].
        velocities: (I, 3) of the inner nodes [u/s].
        free_velocities: (S, 3) see `Held`.
        holds: (S, 3) see `Held`.
        debts: (S, 3) see `Held`.
    """

    positions: FloatArray
    velocities: FloatArray
    free_velocities: FloatArray
    holds: FloatArray
    debts: FloatArray


class MujocoEngine:
    """A `FlexModel` of the scene's organs, and the state of each world in MuJoCo; see `engine.CollidingEngine`.

    Attributes:
        flexes: The model; worlds share it, but for those with other tools that MuJoCo collides with.
    """

    abilities = Abilities(contacts=("flags", "second_step", "mujoco"), materials=True)

    def __init__(self, scene: Scene, worlds: int, options: EngineOptions) -> None:
        """See `engine.Engine`. MuJoCo integrates in double precision, whatever the options say.

        Raises:
            ImportError: If MuJoCo is not installed, or Netgen where it is needed; says what to install.
            ValueError: If MuJoCo has no counterpart of a material, or an organ cannot be filled.

        Warns:
            SceneWarning: If steps are too long for contact with an organ; see `warn_of_long_steps`.
        """
        self._mujoco = import_mujoco()
        self.flexes = FlexModel.of(scene, collides=options.contact == "mujoco")
        for organ in self.flexes.organs:
            warn_of_long_steps(organ.placed.organ, organ.wave_speed, scene.dt)
        self._scene, self._dt = scene, scene.dt
        self._models = [self.flexes.model] * worlds
        self._data = [self._mujoco.MjData(model) for model in self._models]
        self._tools = [self._find_tools(world, scene.tools) for world in range(worlds)]
        self._moved = [False] * worlds
        self._held = [Held.zeros(len(self.flexes.moving)) for _ in range(worlds)]

    @property
    def inverse_masses(self) -> FloatArray:
        """See `engine.Engine`."""
        return np.tile(self.flexes.inverse_masses, (len(self._data), 1))

    def _state(self, world: int) -> tuple[FloatArray, FloatArray]:
        """Views (S + I, 3) of the positions [u] and velocities [u/s] of a world's moving nodes, the surface's first."""
        data, count = self._data[world], 3 * (len(self.flexes.moving) + len(self.flexes.inner))
        return data.qpos[:count].reshape(-1, 3), data.qvel[:count].reshape(-1, 3)

    def advance(self, positions: FloatArray, velocities: FloatArray, diverged: BoolArray) -> None:
        """See `engine.Engine`."""
        moving = self.flexes.moving
        for world in np.flatnonzero(~diverged).tolist():
            all_positions, all_velocities = self._state(world)
            nodes, node_velocities = all_positions[: len(moving)], all_velocities[: len(moving)]
            nodes[:], node_velocities[:] = positions[world, moving], velocities[world, moving]
            if self.flexes.collides:
                self._collide(world)
            else:
                self._substeps(world, nodes, node_velocities)
            positions[world, moving], velocities[world, moving] = nodes, node_velocities
            diverged[world] = not (np.isfinite(all_positions).all() and np.isfinite(all_velocities).all())

    def _collide(self, world: int) -> None:
        """Take a world through a step as MuJoCo's users do, with tools if `move_tools` has just said where they are."""
        tools = self._tools[world]
        if not self._moved[world]:
            tools.park()
        with silent(self._mujoco):
            self._mujoco.mj_step(self._models[world], self._data[world])
        self._moved[world] = False

    def _substeps(self, world: int, nodes: FloatArray, velocities: FloatArray) -> None:
        """Take a world through a step, its surface nodes given as views of its state."""
        data, held, count = self._data[world], self._held[world], self.flexes.substeps
        directions = held.take_contact(nodes, velocities, self._dt)
        for _ in range(count):
            before = velocities.copy()
            self.flexes.advance(self._mujoco, data)
            held.hold(directions, before, nodes, velocities, self._dt / count, 1.0 / count)
        held.give_free(nodes, velocities, self._dt)

    def halt(self, positions: FloatArray, worlds: IntArray) -> None:
        """See `engine.Engine`."""
        moving = self.flexes.moving
        for nodes, world in zip(positions, worlds.tolist(), strict=True):
            all_positions, velocities = self._state(world)
            all_positions[: len(moving)] = nodes[moving]
            # Contact continues: the changes of velocity by contact are kept.
            self._held[world].free_velocities[:] -= velocities[: len(moving)]
            velocities[:] = 0.0

    def save(self, worlds: IntArray) -> tuple[Inner, ...]:
        """See `engine.Engine`."""
        count = len(self.flexes.moving)
        saved = []
        for world in worlds.tolist():
            inner = [array[count:].copy() for array in self._state(world)]
            held = self._held[world]
            saved.append(Inner(*inner, *(getattr(held, field.name).copy() for field in fields(Held))))
        return tuple(saved)

    def restore(self, positions: FloatArray, velocities: FloatArray, inner: Sequence[Any], worlds: IntArray) -> None:
        """See `engine.Engine`.

        Raises:
            ValueError: If an inner state is that of other organs; nothing has then changed.
        """
        flexes, count = self.flexes, len(self.flexes.moving)
        wanted = (len(flexes.inner), count)
        for state in inner:
            if state is not None and (len(state.positions), len(state.holds)) != wanted:
                raise ValueError(
                    f"an inner state must be of {wanted[0]} inner and {wanted[1]} surface nodes, got "
                    f"{len(state.positions)} and {len(state.holds)}"
                )
        for row, world in enumerate(worlds.tolist()):
            data, held, state = self._data[world], self._held[world], inner[row]
            self._mujoco.mj_resetData(self._models[world], data)
            nodes, node_velocities = self._state(world)
            nodes[:count], node_velocities[:count] = positions[row, flexes.moving], velocities[row, flexes.moving]
            if state is None:
                nodes[count:] = self._follow(positions[row])
                held.free_velocities[:], held.holds[:], held.debts[:] = node_velocities[:count], 0.0, 0.0
            else:
                nodes[count:], node_velocities[count:] = state.positions, state.velocities
                for field in fields(Held):
                    getattr(held, field.name)[:] = getattr(state, field.name)

    def _follow(self, surface: FloatArray) -> FloatArray:
        """(I, 3) inner nodes for surface nodes at (V, 3): those of each organ follow as a rigid body."""
        nodes, start = [], 0
        for organ in self.flexes.organs:
            end = start + len(organ.placed.organ.vertices)
            vertices = np.arange(end - start)
            nodes.append(follow_surface(organ.nodes, vertices, surface[None, start:end])[0])
            start = end
        inner: FloatArray = np.concatenate(nodes)[self.flexes.inner]
        return inner

    def close(self) -> None:
        """See `engine.Engine`: MuJoCo frees what it holds when it is no longer referred to."""

    def set_tools(self, tools: Sequence[PlacedTool], world: int) -> None:
        """See `engine.CollidingEngine`."""
        self._models[world] = FlexModel.of(replace(self._scene, tools=tuple(tools)), collides=True).model
        self._data[world] = self._mujoco.MjData(self._models[world])
        self._tools[world] = self._find_tools(world, tuple(tools))

    def place_tools(self, positions: FloatArray, orientations: FloatArray, world: int) -> None:
        """See `engine.CollidingEngine`."""
        self._tools[world].place(positions, orientations)

    def move_tools(
        self, positions: FloatArray, orientations: FloatArray, linear: FloatArray, angular: FloatArray, world: int
    ) -> None:
        """See `engine.CollidingEngine`."""
        self._tools[world].move(positions, orientations, linear, angular)
        self._moved[world] = True

    def tool_impulses(self, linear: FloatArray, angular: FloatArray, world: int) -> FloatArray:
        """See `engine.CollidingEngine`."""
        return self._tools[world].impulses()

    def _find_tools(self, world: int, tools: tuple[PlacedTool, ...]) -> FlexTools:
        has = tools if self.flexes.collides else ()
        return FlexTools(self._models[world], self._data[world], has, self._scene.gravity)
