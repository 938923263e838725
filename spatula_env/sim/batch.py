"""Many worlds of a scene, stepped by compiled code: the soft body of Bullet, and the contact model of `Simulation`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numba
import numpy as np

from spatula_env._warnings import warn
from spatula_env.contact import step as contact_step
from spatula_env.contact.flags import FIRST_STEP_CODES
from spatula_env.contact.structures import Memory, OrganRoom, surface_list, tool_shape, world_list
from spatula_env.contact.world import Workspace, World, scene_skin
from spatula_env.geometry.transforms import as_quaternion
from spatula_env.sim import batch_step
from spatula_env.sim.batch_body import NARROW, WIDE, BatchBody
from spatula_env.sim.clock import later
from spatula_env.sim.report import LONGEST_CROSSED
from spatula_env.sim.simulation import LONGEST_SETTLING, NO_COPY, SETTLED_SPEED, Simulation, SimulationDiverged
from spatula_env.sim.soft_body import join, soft_body
from spatula_env.sim.threads import share_out
from spatula_env.sim.volumes import Volumes
from spatula_env.sim.worlds import Loads

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, DTypeLike, NDArray

    from spatula_env.contact.flags import FirstStep
    from spatula_env.contact.world import Multipliers, NearMemory
    from spatula_env.geometry import Tool
    from spatula_env.scenes import Scene

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.int64]

BatchContactName = Literal["flags", "second_step"]
"""What resolves contact between tools and organs; see `Simulation`."""


@dataclass(frozen=True)
class WorldMemory:
    """What the contact model remembers of one world from step to step.

    Attributes:
        flags: Of each tool (outer) and organ (inner).
        multipliers: From which solves start.
        ledger: Of the energy that the tools put in.
        near: Of organs that are near themselves or each other.
    """

    flags: tuple[NDArray[np.bool_], ...]
    multipliers: Multipliers
    ledger: FloatArray
    near: NearMemory


@dataclass(frozen=True)
class BatchState:
    """All that decides how n worlds go on; made by `BatchSimulation.save`.

    Attributes:
        nodes: (n, V, 3) [u].
        node_velocities: (n, V, 3) [u/s].
        tool_positions: (n, N, 3) of the N tools [u].
        tool_orientations: (n, N, 4).
        tool_forces: (n, N, 3) on each tool in the last physics step [kg u/s2].
        times: (n,) [s].
        memories: Of the contact model, of each world.
    """

    nodes: FloatArray
    node_velocities: FloatArray
    tool_positions: FloatArray
    tool_orientations: FloatArray
    tool_forces: FloatArray
    times: FloatArray
    memories: tuple[WorldMemory, ...]


class BatchSimulation:
    """W worlds of one scene, which differ in state, gravity, stiffness, mass, friction and tools.

    Everything is in scene units; what happens in a world does not depend on which others there are.

    Example:
        >>> import numpy as np
        >>> from spatula_env import scenes
        >>> from spatula_env.sim.batch import BatchSimulation
        >>> worlds = BatchSimulation(scenes.seed(), 16)
        >>> loads = worlds.advance(np.tile([0.0, 0.0, -5.0], (16, 1, 1)), steps=12)
        >>> loads.forces.shape
        (16, 1, 3)
    """

    def __init__(
        self,
        scene: Scene,
        worlds: int,
        *,
        contact: BatchContactName = "flags",
        first_step: FirstStep = "inside",
        dtype: DTypeLike = np.float32,
        parallel: bool | None = None,
    ) -> None:
        """Load a scene into every world, its organs at rest.

        Args:
            scene: What is in it.
            worlds: Number of worlds W.
            contact: "flags" or "second_step"; see `Simulation`.
            first_step: What the flags method's first step looks for; see `FlaggedDetector`.
            dtype: In which organs are integrated, float32 or float64. Contact is always float64.
            parallel: Whether worlds are shared out among threads, in blocks; by default if Numba has more than one.
                `numba.set_num_threads` says how many are used.

        Raises:
            ValueError: If an argument is not as it should be.
        """
        if contact not in get_args(BatchContactName):
            raise ValueError(f"contact must be one of {list(get_args(BatchContactName))}, got {contact!r}")
        if first_step not in FIRST_STEP_CODES:
            raise ValueError(f"first_step must be one of {list(FIRST_STEP_CODES)}, got {first_step!r}")
        threads = numba.get_num_threads()
        self._parallel = threads > 1 if parallel is None else bool(parallel)
        self._scene = scene
        body = join([soft_body(placed) for placed in scene.organs])
        lanes = None
        if worlds > 1:
            lanes = WIDE if worlds >= WIDE * (threads if self._parallel else 1) else NARROW
        self._body = BatchBody(body, worlds, dt=scene.dt, gravity=scene.gravity, dtype=dtype, lanes=lanes)
        single = Simulation(
            scene,
            engine="batch",
            contact=contact,
            first_step=first_step,
            precision="single" if np.dtype(dtype) == np.float32 else "double",
        )
        self._rest = np.repeat(single.nodes[None], worlds, axis=0)
        self._volumes = Volumes(scene)
        self._triangles = single.triangles
        single.close()
        self._make_contacts(first_step if contact == "flags" else "off")
        shape = (worlds, len(body.vertices), 3)
        self._nodes, self._velocities = np.zeros(shape), np.zeros(shape)
        count = len(scene.tools)
        self._tool_positions, self._tool_orientations = np.zeros((worlds, count, 3)), np.zeros((worlds, count, 4))
        self._tool_forces = np.zeros((worlds, count, 3))
        self._loads = np.zeros((worlds, count, batch_step.LOAD_LENGTH))
        self._summaries = np.zeros((worlds, batch_step.SUMMARY_LENGTH))
        tools = [placed.tool for placed in scene.tools]
        self._pressures = np.zeros((worlds, count, max(len(tool.nodes) for tool in tools)))
        self._face_pressures = np.zeros((worlds, count, max(len(tool.face_normals) for tool in tools)))
        self._no_limits = np.full(worlds, np.inf)
        self._diverged = np.zeros(worlds, dtype=np.bool_)
        self._times = np.zeros(worlds)
        self.reset()

    def _make_contacts(self, first_step: FirstStep) -> None:
        """Prepare the contact model of every world; worlds of a block share their workspace."""
        scene, lanes = self._scene, self._body.arrays["positions"].shape[3]
        surfaces = surface_list([np.array(placed.organ.triangles) for placed in scene.organs])
        skin = scene_skin(scene)
        shapes = [tool_shape(placed.tool) for placed in scene.tools]
        self._contacts: list[World] = []
        for world in range(self.count):
            if world % lanes == 0:
                workspace = Workspace()
                rooms = [
                    [OrganRoom(len(placed.organ.vertices), len(placed.organ.triangles)) for placed in scene.organs]
                    for _ in scene.tools
                ]
            memories = [
                Memory(len(placed.tool.nodes), room)
                for placed, row in zip(scene.tools, rooms, strict=True)
                for room in row
            ]
            inverse_masses = self._body.body.inverse_masses
            self._contacts.append(
                World(scene, shapes, memories, surfaces, skin, inverse_masses, workspace, first_step != "off")
            )
        self._structures = world_list([contacts.structure for contacts in self._contacts])
        self._mode = contact_step.SECOND_STEP if first_step == "off" else contact_step.FLAGS
        self._first_step = FIRST_STEP_CODES[first_step]

    @property
    def scene(self) -> Scene:
        """The scene that all worlds show; parameters may have been changed since."""
        return self._scene

    @property
    def count(self) -> int:
        """W."""
        return self._body.worlds

    @property
    def dt(self) -> float:
        """Length of a physics step [s]."""
        return self._scene.dt

    @property
    def nodes(self) -> FloatArray:
        """(W, V, 3) positions of the organs' nodes (a copy) [u]."""
        return self._nodes.copy()

    @property
    def node_velocities(self) -> FloatArray:
        """(W, V, 3) (a copy) [u/s]."""
        return self._velocities.copy()

    @property
    def node_masses(self) -> FloatArray:
        """(W, V) of the organs' nodes [kg]; infinite for a fixed node."""
        with np.errstate(divide="ignore"):
            return 1.0 / self._body.inverse_masses

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(T, 3) of all organs, counter-clockwise from outside (a copy)."""
        return self._triangles.copy()

    @property
    def tool_positions(self) -> FloatArray:
        """(W, N, 3) (a copy) [u]."""
        return self._tool_positions.copy()

    @property
    def tool_orientations(self) -> FloatArray:
        """(W, N, 4) quaternions xyzw (a copy)."""
        return self._tool_orientations.copy()

    @property
    def times(self) -> FloatArray:
        """(W,) since each world's reset (a copy) [s]."""
        return self._times.copy()

    def nodes_of(self, worlds: ArrayLike) -> FloatArray:
        """(n, V, 3) positions of the organs' nodes in some worlds (n,), or where a mask (W,) is true (a copy) [u]."""
        return self._nodes[self._body.indices(worlds)]

    def times_of(self, worlds: ArrayLike) -> FloatArray:
        """(n,) since the reset of each of some worlds (n,), or of those where a mask (W,) is true (a copy) [s]."""
        return self._times[self._body.indices(worlds)]

    def reset(self, worlds: ArrayLike | None = None) -> None:
        """Start some worlds again: organs at rest, tools where the scene has them, no contact, time zero.

        Args:
            worlds: (n,) which, or (W,) a mask; all by default.

        Raises:
            ValueError: If there is no such world, or one is named twice.
        """
        indices = self._each_once(worlds)
        self._set_nodes(indices, self._rest[indices], 0.0)
        for index, placed in enumerate(self._scene.tools):
            self._tool_positions[indices, index] = placed.position
            self._tool_orientations[indices, index] = placed.orientation
        self._forget(indices)
        self._times[indices] = 0.0

    def settle(self, worlds: ArrayLike | None = None) -> None:
        """Let the organs of some worlds come to rest under their present parameters, and reset these worlds.

        From then on `reset` puts the organs there.

        Args:
            worlds: (n,) which, or (W,) a mask; all by default.

        Raises:
            SimulationDiverged: If positions are no longer finite, or an organ collapses; nothing has then changed.

        Warns:
            SceneWarning: If organs do not come to rest.
        """
        indices = self._body.indices(worlds)
        state = self.save()
        masses = 1.0 / np.where(self._body.inverse_masses > 0.0, self._body.inverse_masses, np.inf)
        nothing = np.zeros_like(self._tool_positions)
        others = np.setdiff1d(np.arange(self.count), indices)
        settled, energy_before = np.zeros(self.count, dtype=np.bool_), np.zeros(self.count)
        settled[others] = True
        self.reset(indices)
        # As `Simulation` does it: kinetic damping.
        for _ in range(math.ceil(LONGEST_SETTLING / self.dt)):
            self._advance(nothing, nothing, 1, self._no_limits, self._no_limits, with_tools=False)
            self._check_settling(indices[self._diverged[indices]], state)
            energy = np.einsum("wv,wva,wva->w", masses, self._velocities, self._velocities)
            past = (energy < energy_before) & ~settled
            settled |= past & (np.abs(self._velocities).max(axis=(1, 2)) < SETTLED_SPEED)
            if settled.all():
                break
            stopped = np.flatnonzero(past)
            self._set_nodes(stopped, self._nodes[stopped], 0.0)
            energy[stopped] = 0.0
            energy_before = energy
        else:
            moving = np.flatnonzero(~settled)
            fastest = float(np.abs(self._velocities[moving]).max())
            warn(
                f"the organs of {len(moving)} of {len(indices)} worlds, world {moving[0]} the first, have not come to "
                f"rest: they still moved at up to {fastest:.2g} u/s when settling was ended"
            )
        self._check_settling(indices[self._volumes.collapsed(self._nodes)[indices].any(axis=1)], state)
        self._rest[indices] = self._nodes[indices]
        self.restore(state)
        self.reset(indices)

    def place_tools(
        self, positions: ArrayLike, orientations: ArrayLike | None = None, worlds: ArrayLike | None = None
    ) -> None:
        """Put the tools of some worlds somewhere at once; flags are cleared and organs feel nothing of the way.

        Args:
            positions: (n, N, 3) [u].
            orientations: (n, N, 4) unit quaternions xyzw; as they are by default.
            worlds: (n,) which, or (W,) a mask; all by default.

        Raises:
            ValueError: If an argument is malformed, not finite or not a unit quaternion; nothing has then changed.
        """
        indices, count = self._body.indices(worlds), len(self._scene.tools)
        new_positions = self._rows(positions, "positions", (len(indices), count, 3), indices)
        if orientations is None:
            new_orientations = self._tool_orientations[indices]
        else:
            new_orientations = self._rows(orientations, "orientations", (len(indices), count, 4), indices)
            for row, world in zip(new_orientations, indices.tolist(), strict=True):
                row[:] = [as_quaternion(orientation, f"orientations of world {world}") for orientation in row]
        self._tool_positions[indices], self._tool_orientations[indices] = new_positions, new_orientations
        self._tool_forces[indices] = 0.0
        for world in indices.tolist():
            for memory in self._contacts[world].memories:
                memory.states[:] = False

    def set_parameters(
        self,
        *,
        gravity: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        mass_scale: ArrayLike | None = None,
        friction: ArrayLike | None = None,
        worlds: ArrayLike | None = None,
    ) -> None:
        """Change in what some worlds differ from others. Organs stay where they are; see also `settle`.

        Args:
            gravity: Downward acceleration [u/s2].
            stiffness: Factor on the stiffness of all links, from 0 to less than 2.
            mass_scale: Factor on all masses of the organs.
            friction: Coefficient of all tools.
            worlds: (n,) which, or (W,) a mask; all by default. Values are one for all of them or (n,).

        Raises:
            ValueError: If a value is not allowed; nothing has then changed.
        """
        indices = self._body.indices(worlds)
        new_friction = None
        if friction is not None:
            new_friction = self._body.values(friction, "friction", indices)
            if (new_friction < 0.0).any():
                first = int(np.argmax(new_friction < 0.0))
                raise ValueError(
                    f"friction must be zero or more, in world {indices[first]} it is {new_friction[first]:g}"
                )
        self._body.set_parameters(gravity=gravity, stiffness=stiffness, mass_scale=mass_scale, worlds=indices)
        gravities, inverse_masses = self._body.gravity, self._body.inverse_masses
        for row, world in enumerate(indices.tolist()):
            contacts = self._contacts[world]
            if new_friction is not None:
                contacts.friction[:] = new_friction[row]
            if gravity is not None:
                contacts.settings[contact_step.GRAVITY] = gravities[world]
            if mass_scale is not None:
                contacts.set_inverse_masses(inverse_masses[world])

    def set_tools(self, tools: Sequence[Tool], worlds: ArrayLike | None = None, index: int = 0) -> None:
        """Give some worlds another tool, where the old one was. Its flags are cleared.

        Args:
            tools: One for all of these worlds, or one each; with as many contact nodes as the scene's.
            worlds: (n,) which, or (W,) a mask; all by default.
            index: Which of the scene's tools.

        Raises:
            ValueError: If a tool does not fit; nothing has then changed.
        """
        indices = self._body.indices(worlds)
        if len(tools) not in (1, len(indices)):
            raise ValueError(f"tools must be 1 or {len(indices)}, one for each world; got {len(tools)}")
        wanted = len(self._scene.tools[index].tool.nodes)
        for tool in tools:
            if len(tool.nodes) != wanted:
                raise ValueError(f"tools must have {wanted} contact nodes, as the scene's; got {len(tool.nodes)}")
        shapes = [tool_shape(tool) for tool in tools]
        organs = len(self._scene.organs)
        for row, world in enumerate(indices.tolist()):
            contacts = self._contacts[world]
            chosen = row if len(shapes) > 1 else 0
            contacts.set_tool(index, shapes[chosen])
            for memory in contacts.memories[index * organs : (index + 1) * organs]:
                memory.states[:] = False

    def vary(self, friction: FloatArray, tool_size: FloatArray, worlds: ArrayLike | None = None) -> None:
        """Change the tools of some worlds: see `Worlds`.

        Args:
            friction: (n,) factor on the scene's coefficients between tools and organs.
            tool_size: (n,) factor on the lengths of the scene's tools.
            worlds: (n,) which, or (W,) a mask; all by default.
        """
        indices = self._body.indices(worlds)
        for index, placed in enumerate(self._scene.tools):
            self.set_tools([placed.tool.scaled(size) for size in tool_size.tolist()], indices, index)
        coefficients = np.array([placed.friction for placed in self._scene.tools])
        for row, world in enumerate(indices.tolist()):
            self._contacts[world].friction[:] = coefficients * friction[row]

    def advance(
        self,
        linear_velocities: ArrayLike,
        angular_velocities: ArrayLike | None = None,
        steps: int = 1,
        pressure_limits: ArrayLike | None = None,
        force_limits: ArrayLike | None = None,
    ) -> Loads:
        """Move all worlds on by some physics steps, the tools moving with constant velocity.

        Args:
            linear_velocities: (W, N, 3) [u/s].
            angular_velocities: (W, N, 3) world frame [rad/s]; none by default.
            steps: How many.
            pressure_limits: (W,) what overpressure is counted from [kg/(u s2)]; by default none is counted.
            force_limits: (W,) tools that have met more in a physics step do not push on in the next one, see
                `drive.restrain` [kg u/s2]; by default they always do.

        Returns:
            What the tools felt. A world that diverges, as an organ in it has turned inside out or
            positions are not finite, leaves the others alone; it waits to be reset.

        Raises:
            ValueError: If a velocity is malformed or not finite; nothing has then changed.
        """
        shape = self._tool_positions.shape
        every = np.arange(self.count)
        linear = self._rows(linear_velocities, "linear_velocities", shape, every)
        angular = np.zeros(shape)
        if angular_velocities is not None:
            angular = self._rows(angular_velocities, "angular_velocities", shape, every)
        if not isinstance(steps, int | np.integer) or steps < 1:
            raise ValueError(f"steps must be an integer, 1 or more, got {steps!r}")
        limits = [
            self._no_limits if value is None else self._rows(value, name, (self.count,), every)
            for name, value in (("pressure_limits", pressure_limits), ("force_limits", force_limits))
        ]
        self._advance(linear, angular, int(steps), limits[0], limits[1], with_tools=True)
        ok = ~self._diverged
        self._times[ok] = later(self._times[ok], int(steps), self.dt)
        loads, summaries = self._loads * ok[:, None, None], self._summaries * ok[:, None]
        return Loads(
            forces=loads[:, :, batch_step.FORCE : batch_step.TORQUE],
            torques=loads[:, :, batch_step.TORQUE : batch_step.PEAK],
            peak_forces=loads[:, :, batch_step.PEAK],
            flags=self._flags(),
            penetrations=summaries[:, batch_step.DEEPEST],
            residuals=summaries[:, batch_step.WORST_RESIDUAL],
            ground_forces=summaries[:, batch_step.GROUND_FORCE : batch_step.PEAK_PRESSURE],
            peak_pressures=summaries[:, batch_step.PEAK_PRESSURE],
            mean_pressures=self._face_pressures.max(axis=(1, 2)) * ok,
            overpressures=summaries[:, batch_step.OVERPRESSURE],
            node_pressures=tuple(
                self._pressures[:, index, : len(placed.tool.nodes)] * ok[:, None]
                for index, placed in enumerate(self._scene.tools)
            ),
            restrained=summaries[:, batch_step.RESTRAINED],
            tangled=summaries[:, batch_step.CROSSED_FOR] > LONGEST_CROSSED,
            diverged=self._diverged.copy(),
        )

    def _advance(
        self,
        linear: FloatArray,
        angular: FloatArray,
        steps: int,
        pressure_limits: FloatArray,
        force_limits: FloatArray,
        *,
        with_tools: bool,
    ) -> None:
        arguments = (
            *self._body.arrays.values(),
            self._structures,
            with_tools,
            self._mode,
            self._first_step,
            self.dt,
            steps,
            self._nodes,
            self._velocities,
            self._tool_positions,
            self._tool_orientations,
            linear,
            angular,
            pressure_limits,
            force_limits,
            self._tool_forces,
            self._loads,
            self._summaries,
            self._face_pressures,
            self._pressures,
            self._diverged,
        )
        blocks, threads = len(self._body.arrays["positions"]), numba.get_num_threads() if self._parallel else 1
        if min(blocks, threads) == 1:
            batch_step.advance_blocks(0, blocks, *arguments)
        else:
            share_out(lambda block: batch_step.advance_blocks(block, block + 1, *arguments), blocks, threads)
        self._diverged |= self._volumes.inside_out(self._nodes).any(axis=1)

    def _check_settling(self, bad: IntArray, state: BatchState) -> None:
        """Give settling up, and go back to a state, if something has gone wrong in a world."""
        if not len(bad):
            return
        nodes = self._nodes[bad[:1]]
        finite = bool(np.isfinite(nodes).all())
        why = self._volumes.tell(self._volumes.measure(nodes)[0]) if finite else "positions are no longer finite"
        self.restore(state)
        raise SimulationDiverged(f"organs do not come to rest in worlds {bad.tolist()}: in world {bad[0]} {why}")

    def _flags(self) -> tuple[NDArray[np.bool_], ...]:
        organs = len(self._scene.organs)
        return tuple(
            np.array(
                [
                    np.any([memory.states[0] for memory in contacts.memories[k * organs : (k + 1) * organs]], axis=0)
                    & (not diverged)
                    for contacts, diverged in zip(self._contacts, self._diverged.tolist(), strict=True)
                ]
            )
            for k in range(len(self._scene.tools))
        )

    def save(self, worlds: ArrayLike | None = None) -> BatchState:
        """Everything needed to go on from here later, as arrays of its own.

        Args:
            worlds: (n,) which, or (W,) a mask; all by default.
        """
        indices = self._body.indices(worlds)
        return BatchState(
            nodes=self._nodes[indices],
            node_velocities=self._velocities[indices],
            tool_positions=self._tool_positions[indices],
            tool_orientations=self._tool_orientations[indices],
            tool_forces=self._tool_forces[indices],
            times=self._times[indices],
            memories=tuple(
                WorldMemory(
                    flags=tuple(memory.states[0].copy() for memory in contacts.memories),
                    multipliers=contacts.copy_multipliers(),
                    ledger=contacts.ledger.copy(),
                    near=contacts.copy_near(),
                )
                for contacts in (self._contacts[world] for world in indices.tolist())
            ),
        )

    def restore(self, state: BatchState, worlds: ArrayLike | None = None) -> None:
        """Go back to a saved state, of these worlds or others of the same scene. Parameters stay as they are.

        Args:
            state: What `save` returned for n worlds.
            worlds: (n,) which worlds get it, or (W,) a mask; all by default.

        Raises:
            ValueError: If the state is of another number of worlds, or does not fit the scene or is not finite, or a
                world is named twice; nothing has then changed.
        """
        indices = self._each_once(worlds)
        for name in ("nodes", "node_velocities", "tool_positions", "tool_orientations", "tool_forces"):
            mine = (len(indices), *getattr(self, f"_{name}" if name != "node_velocities" else "_velocities").shape[1:])
            self._rows(getattr(state, name), f"state.{name}", mine, indices)
        wanted = [memory.states[0].shape for memory in self._contacts[0].memories]
        for memory in state.memories:
            if [flags.shape for flags in memory.flags] != wanted:
                raise ValueError(f"state must have flags of shapes {wanted}, got {[f.shape for f in memory.flags]}")
        self._set_nodes(indices, state.nodes, state.node_velocities)
        self._tool_positions[indices] = state.tool_positions
        self._tool_orientations[indices] = state.tool_orientations
        self._times[indices] = state.times
        self._forget(indices)
        self._tool_forces[indices] = state.tool_forces
        for world, remembered in zip(indices.tolist(), state.memories, strict=True):
            contacts = self._contacts[world]
            for memory, flags in zip(contacts.memories, remembered.flags, strict=True):
                memory.states[0] = flags
            contacts.restore_multipliers(remembered.multipliers)
            contacts.restore_near(remembered.near, self._nodes[world])
            contacts.ledger[:] = remembered.ledger
            contacts.admit_energy(self._nodes[world], self._velocities[world])

    def close(self) -> None:
        """There is nothing to free; for the sake of those who close what they open."""

    def _set_nodes(self, indices: IntArray, nodes: FloatArray, velocities: FloatArray | float) -> None:
        self._nodes[indices], self._velocities[indices] = nodes, velocities
        self._body.set_state(self._nodes[indices], self._velocities[indices], indices)

    def _forget(self, indices: IntArray) -> None:
        """Forget all contacts of some worlds, and that they diverged."""
        for world in indices.tolist():
            self._contacts[world].forget_solves()
            for memory in self._contacts[world].memories:
                memory.states[:] = False
        self._tool_forces[indices] = 0.0
        self._diverged[indices] = False

    def _each_once(self, worlds: ArrayLike | None) -> IntArray:
        """Indices of worlds that are written to: what was to become of one that is named twice?"""
        indices = self._body.indices(worlds)
        if len(np.unique(indices)) < len(indices):
            raise ValueError(f"worlds must be named once each, got {indices.tolist()}")
        return indices

    def __reduce__(self) -> Any:
        raise TypeError(NO_COPY.format(type(self).__name__))

    def _rows(self, value: ArrayLike, name: str, shape: tuple[int, ...], worlds: IntArray) -> FloatArray:
        """Finite numbers of a shape, a row for each of some worlds."""
        try:
            array = np.array(value, dtype=np.float64, order="C")
        except (TypeError, ValueError) as error:
            raise ValueError(f"{name} must be numbers of shape {shape}, got {value!r}") from error
        if array.shape != shape:
            raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
        bad = ~np.isfinite(array).reshape(len(array), -1).all(axis=1)
        if bad.any():
            raise ValueError(f"{name} must be finite, in world {worlds[int(np.argmax(bad))]} they are not")
        return array
