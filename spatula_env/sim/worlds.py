"""W worlds of one scene: engines integrate the organs; tools, contact, loads, settling and states are handled here."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias, cast, get_args

import numba
import numpy as np

from spatula_env._warnings import warn
from spatula_env.arrays import BoolArray, FloatArray, IntArray
from spatula_env.contact import settings
from spatula_env.contact.flags import FIRST_STEP_CODES
from spatula_env.contact.structures import Memory, OrganRoom, surface_list, tool_shape, world_list
from spatula_env.contact.world import Workspace, World, scene_skin
from spatula_env.engines import choose_engine, load_engine
from spatula_env.geometry import Tool
from spatula_env.geometry.checks import as_tuple_of, check_count, check_kind
from spatula_env.geometry.transforms import as_quaternion
from spatula_env.scenes import Scene, lying_as_material
from spatula_env.scenes.material import INJURY_STRAIN
from spatula_env.sim import step
from spatula_env.sim.clock import later
from spatula_env.sim.collisions import Collisions
from spatula_env.sim.engine import OWN_CONTACTS, PRECISIONS, BlockEngine, ContactName, Engine, EngineOptions, Strains
from spatula_env.sim.report import LONGEST_CROSSED
from spatula_env.sim.scene_checks import (
    check_surfaces,
    is_creeping,
    organs_below_ground,
    tools_in_organs,
    warn_of_rest,
    warn_of_scene,
)
from spatula_env.sim.selection import check_speeds, one_each, refuse, rows_of, world_indices
from spatula_env.sim.states import WorldMemory, WorldsState
from spatula_env.sim.volumes import Volumes
from spatula_env.threads import share_out

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from spatula_env.contact.flags import FirstStep
    from spatula_env.scenes import PlacedTool
    from spatula_env.sim.engine import CollidingEngine, Precision, StrainedEngine, VaryingEngine

Steer: TypeAlias = Callable[[int, int], tuple[FloatArray, FloatArray]]
"""Function of the index of a world, and of a physics step in the control step, that returns the velocities of the
world's tools: linear (N, 3) [u/s] and angular (N, 3) [rad/s]."""

SETTLED_SPEED = 1e-3
"""An organ is at rest if none of its nodes is faster than this [u/s]."""

TOO_WEAK = (
    "gravity may be too strong for the springs at this time step, or the surface too fine for them: a smaller dt, less "
    "gravity or a coarser surface helps"
)
"""The likely cause if an organ has collapsed and nothing was wrong at the start."""

LONGEST_SETTLING = 4.0
"""Settling ends after this time even if something still moves [s]."""

NO_COPY = "a {} can be neither copied nor pickled: make another one of its scene, and restore there what save() gives"


class SimulationDiverged(RuntimeError):
    """Positions are no longer finite, or an organ has turned inside out; reset() or restore() makes it usable again."""


@dataclass(frozen=True, eq=False)
class Loads:
    """Loads on the tools during a control step of several physics steps, in scene units.

    Rows of worlds that have diverged hold zeros.

    Attributes:
        forces: (W, N, 3) on each of the N tools, averaged over the control step [kg u/s2].
        torques: (W, N, 3) about each tool's origin, averaged [kg u2/s2].
        peak_forces: (W, N) greatest magnitude of the force in a physics step [kg u/s2].
        flags: (W, n) for each tool: which of its n contact nodes are in contact with any organ at the end.
        penetrations: (W,) greatest depth of a contact node in the last physics step, before correction [u].
        residuals: (W,) greatest depth left after correction, as in `Report`, at most in any physics step [u].
        ground_forces: (W, 3) force of the ground on the organs, averaged [kg u/s2].
        peak_pressures: (W,) greatest contact pressure on a node of a tool in a physics step [kg/(u s2)]. Zero with
            contact of the engine's own, which does not report it; so are the next three.
        mean_pressures: (W,) greatest mean pressure on a face of a tool: its normal force divided by its area, averaged
            over the control step [kg/(u s2)].
        overpressures: (W,) integral over time of the greatest pressure's excess over the limit [kg/(u s)].
        node_pressures: (W, n) for each tool: on each of its contact nodes in the last physics step [kg/(u s2)].
        restrained: (W,) share of the physics steps in which too great a force kept tools from pushing on.
        tangled: (W,) whether organs have crossed themselves or each other for longer than `report.LONGEST_CROSSED`.
        diverged: (W,) whether positions are no longer finite, or an organ has turned inside out.
    """

    forces: FloatArray
    torques: FloatArray
    peak_forces: FloatArray
    flags: tuple[BoolArray, ...]
    penetrations: FloatArray
    residuals: FloatArray
    ground_forces: FloatArray
    peak_pressures: FloatArray
    mean_pressures: FloatArray
    overpressures: FloatArray
    node_pressures: tuple[FloatArray, ...]
    restrained: FloatArray
    tangled: BoolArray
    diverged: BoolArray


class Worlds:
    """W worlds of one scene, which differ in state, tools, friction and, if the engine can do it, in parameters.

    Everything is in scene units. Results in a world do not depend, to the last bit, on the other worlds.

    Example:
        >>> import numpy as np
        >>> from spatula_env import scenes
        >>> from spatula_env.sim.worlds import Worlds
        >>> worlds = Worlds(scenes.seed(), 16)
        >>> loads = worlds.advance(np.tile([0.0, 0.0, -5.0], (16, 1, 1)), steps=12)
        >>> loads.forces.shape
        (16, 1, 3)

    Attributes:
        engine: The engine that integrates the organs.
        contact: The method that resolves contact.
        contacts: The contact of each world.
        state: Arrays that kernels work on: positions and velocities of nodes and tools, W first; not to be written.
        last: Results of the last physics step; see `step.LastStep`.
    """

    def __init__(
        self,
        scene: Scene,
        count: int,
        *,
        engine: str | None = "batch",
        contact: ContactName = "flags",
        first_step: FirstStep = "inside",
        precision: Precision = "single",
        parallel: bool | None = None,
    ) -> None:
        """Load a scene into every world, its organs at rest.

        Args:
            scene: The organs, tools and ground.
            count: Number of worlds W.
            engine: Name of the engine that integrates the organs, one of `engines.ENGINES`. None: that of `Simulation`.
            contact: The method that resolves contact; see `Simulation`.
            first_step: What the flags method's first step looks for; see `FlaggedDetector`.
            precision: Precision in which an engine that offers both integrates, "single" or "double". Contact is always
                double.
            parallel: Whether worlds are distributed over threads, in blocks; by default if Numba has more than one
                thread. `numba.set_num_threads` says how many are used.

        Raises:
            TypeError: If `scene` is not a `Scene`.
            ValueError: If an argument is not allowed, the engine does not support that contact, or an organ's surface
                crosses itself.
            ImportError: If PyBullet is asked for and is not installed; says what to install.
            SimulationDiverged: If an organ collapses under its own weight.

        Warns:
            SceneWarning: If an organ does not keep its shape under its own weight or does not come to rest, and about
                anything else in the scene that is probably not intended.
        """
        for name, value, allowed in (
            ("contact", contact, get_args(ContactName)),
            ("precision", precision, PRECISIONS),
            ("first_step", first_step, FIRST_STEP_CODES),
        ):
            if value not in allowed:
                raise ValueError(f"{name} must be one of {list(allowed)}, got {value!r}")
        check_kind(scene, "scene", Scene)
        check_count(count, "worlds", 1)
        name = choose_engine(engine, contact)
        kind = load_engine(name)
        if contact not in kind.abilities.contacts:
            had = " or ".join(map(repr, kind.abilities.contacts))
            raise ValueError(f"contact must be {had} with engine {name!r}, got {contact!r}")
        if kind.abilities.materials:
            scene = lying_as_material(scene)
        check_surfaces(scene)
        warn_of_scene(scene, kind.abilities.sweeps)
        self._scene, self.contact, self._first_step = scene, contact, first_step
        threads = numba.get_num_threads()
        self._parallel = threads > 1 if parallel is None else bool(parallel)
        self.engine: Engine = kind(scene, count, EngineOptions(contact, precision, threads if self._parallel else 1))
        try:
            self._put_together(count)
        except BaseException:
            self.engine.close()
            raise

    def _put_together(self, count: int) -> None:
        scene, engine = self._scene, self.engine
        self._blocks: BlockEngine | None = engine if isinstance(engine, BlockEngine) else None
        self._lanes = 1 if self._blocks is None else self._blocks.lanes
        self._volumes = Volumes(scene)
        vertices = np.concatenate([placed.vertices for placed in scene.organs])
        nodes, tools = (count, len(vertices), 3), (count, len(scene.tools), 3)
        self.state = step.State(
            nodes=np.zeros(nodes),
            velocities=np.zeros(nodes),
            tool_positions=np.zeros(tools),
            tool_orientations=np.zeros((*tools[:2], 4)),
            tool_forces=np.zeros(tools),
            diverged=np.zeros(count, dtype=np.bool_),
        )
        self._times = np.zeros(count)
        self._has_stepped = np.zeros(count, dtype=np.bool_)
        # Poses of the tools before the first step, with organs at rest; NaN where they are not known.
        self._start_positions, self._start_orientations = np.full(tools, np.nan), np.full((*tools[:2], 4), np.nan)
        self._skin = scene_skin(scene)
        self._equip(scene.tools)
        # All worlds are alike, so one settles for all; but an engine's own contact keeps traces of earlier steps.
        first = np.arange(1 if self._collisions is None else count)
        self._rest = np.repeat(vertices[None], count, axis=0)
        self._set_nodes(first, self._rest[first], np.zeros_like(self._rest[first]), (None,) * len(first))
        speeds, moving = self._come_to_rest(first, ":")
        self._rest[:] = self.state.nodes[:1]
        self._rest_inner = list(self.engine.save(first[:1]) * count)
        volumes = self._volumes.measure(self._rest[:1])[0]
        warn_of_rest(scene, self._rest[0], volumes, self._volumes.initial, speeds[0] if moving[0] else None)
        self.reset()

    def _equip(self, tools: Sequence[PlacedTool]) -> None:
        """Set up contact with some tools in every world; the worlds of a block share a workspace."""
        scene, count = self._scene, self.count
        organs = [placed.organ for placed in scene.organs]
        surfaces = surface_list([np.array(organ.triangles) for organ in organs])
        shapes, inverse_masses = [tool_shape(placed.tool) for placed in tools], self.engine.inverse_masses
        self._tools = [tuple(tools)] * count
        self.contacts: list[World] = []
        for w in range(count):
            if w % self._lanes == 0:
                workspace = Workspace()
                rooms = [[OrganRoom(len(organ.vertices), len(organ.triangles)) for organ in organs] for _ in tools]
            memories = [
                Memory(len(placed.tool.nodes), room) for placed, row in zip(tools, rooms, strict=True) for room in row
            ]
            apart = self.contact == "flags"
            self.contacts.append(
                World(scene, shapes, memories, surfaces, self._skin, inverse_masses[w], workspace, apart)
            )
            self.contacts[w].friction[:] = [placed.friction for placed in tools]
        if self.engine.abilities.varies:
            for contact, gravity in zip(self.contacts, cast("VaryingEngine", self.engine).gravity, strict=True):
                contact.settings[settings.GRAVITY] = gravity
        nodes, (_, tool_count, _) = self.state.nodes.shape[1:], self.state.tool_positions.shape
        most_nodes, most_faces = (
            max(len(getattr(placed.tool, name)) for placed in tools) for name in ("nodes", "face_normals")
        )
        of_tools, blocks = (count, tool_count), (-(-count // self._lanes),)
        self._sums = step.Sums(
            forces=np.zeros((*of_tools, 3)),
            torques=np.zeros((*of_tools, 3)),
            peak_forces=np.zeros(of_tools),
            penetrations=np.zeros(count),
            residuals=np.zeros(count),
            ground_forces=np.zeros((count, 3)),
            peak_pressures=np.zeros(count),
            overpressures=np.zeros(count),
            restrained=np.zeros(count),
            crossed_for=np.zeros(count),
            face_pressures=np.zeros((*of_tools, most_faces)),
            node_pressures=np.zeros((*of_tools, most_nodes)),
        )
        self.last = step.LastStep(
            start_positions=np.zeros((*blocks, tool_count, 3)),
            start_orientations=np.zeros((*blocks, tool_count, 4)),
            positions=np.zeros((*blocks, tool_count, 3)),
            orientations=np.zeros((*blocks, tool_count, 4)),
            linear=np.zeros((*blocks, tool_count, 3)),
            angular=np.zeros((*blocks, tool_count, 3)),
            nodes=np.zeros((*blocks, *nodes)),
            impulses=np.zeros((*blocks, *nodes)),
            wrenches=np.zeros((*blocks, tool_count + 1, 6)),
            result=np.zeros((*blocks, settings.RESULT_LENGTH)),
        )
        first_step = "off" if self.contact == "second_step" else self._first_step
        self._drive = step.Drive(
            linear=np.zeros((*of_tools, 3)),
            angular=np.zeros((*of_tools, 3)),
            pressure_limits=np.zeros(count),
            force_limits=np.zeros(count),
        )
        contacts = world_list([contact.structure for contact in self.contacts])
        parts = (FIRST_STEP_CODES[first_step], self.dt, self.state, self._drive, self._sums, self.last)
        self._coupling = step.make_coupling(contacts, self.contact not in OWN_CONTACTS, *parts)
        self._settling = step.make_coupling(contacts, False, *parts)
        self._collisions: Collisions | None = None
        if self.contact in OWN_CONTACTS:
            colliding = cast("CollidingEngine", self.engine)
            self._collisions = Collisions(
                scene, colliding, self.contacts, self._coupling, self.state, self._sums, self.last
            )

    @property
    def scene(self) -> Scene:
        """The scene of all worlds; parameters and tools of some worlds may have been changed since."""
        return self._scene

    @property
    def count(self) -> int:
        """Number of worlds W."""
        return len(self._times)

    @property
    def dt(self) -> float:
        """Length of a physics step [s]."""
        return self._scene.dt

    @property
    def nodes(self) -> FloatArray:
        """(W, V, 3) positions of the organs' nodes (a copy) [u]."""
        return self.state.nodes.copy()

    @property
    def node_velocities(self) -> FloatArray:
        """(W, V, 3) of the organs' nodes, contact impulses included (a copy) [u/s]."""
        return self.state.velocities.copy()

    @property
    def node_masses(self) -> FloatArray:
        """(W, V) of the organs' nodes [kg]; infinite for a fixed node."""
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / self.engine.inverse_masses)

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(T, 3) of all organs, counter-clockwise from outside (a copy)."""
        return self._volumes.triangles.copy()

    @property
    def volumes(self) -> FloatArray:
        """(W, O) volume that each organ encloses now [u3]."""
        return self._volumes.measure(self.state.nodes)

    @property
    def tool_positions(self) -> FloatArray:
        """(W, N, 3) (a copy) [u]."""
        return self.state.tool_positions.copy()

    @property
    def tool_orientations(self) -> FloatArray:
        """(W, N, 4) quaternions xyzw (a copy)."""
        return self.state.tool_orientations.copy()

    @property
    def times(self) -> FloatArray:
        """(W,) time since each world's reset (a copy) [s]."""
        return self._times.copy()

    @property
    def node_pressures(self) -> tuple[FloatArray, ...]:
        """For each tool, (W, n) pressures on its contact nodes in the last physics step [kg/(u s2)]."""
        pressures = self._sums.node_pressures * ~self.state.diverged[:, None, None]
        return tuple(pressures[:, k, : len(placed.tool.nodes)] for k, placed in enumerate(self._scene.tools))

    def strains(self, worlds: ArrayLike | None = None, *, threshold: float = INJURY_STRAIN) -> Strains:
        """How organs are strained and stressed now, with an engine that reports it: "tissue".

        Args:
            worlds: (n,) which, or (W,) a mask; all by default.
            threshold: Strain beyond which volume counts in `Strains.strained_shares`.

        Returns:
            (n, O) of each organ; zero in worlds that have diverged.

        Raises:
            ValueError: If there is no such world.
            RuntimeError: If the engine does not report strains.
        """
        indices = world_indices(worlds, self.count)
        if not self.engine.abilities.strains:
            raise RuntimeError("strains are of organs that are a material: use engine='tissue'")
        found = cast("StrainedEngine", self.engine).strains(indices, threshold)
        going = ~self.state.diverged[indices, None]
        return Strains(*(np.where(going, values, 0.0) for values in found))

    @property
    def has_stepped(self) -> BoolArray:
        """(W,) whether a step has been made since the last `reset` or `restore` (a copy)."""
        return self._has_stepped.copy()

    def why_diverged(self, world: int) -> str:
        """Describe in words what has happened to a world that has diverged, with the likely cause."""
        poses = self._start_positions[world], self._start_orientations[world]
        return self._why(world, tools_in_organs(self._scene.organs, self._rest[world], self._tools[world], *poses))

    def _why(self, world: int, cause: str) -> str:
        """Describe what has happened to a world, as `why_diverged`, with a cause, which is empty if it is not known."""
        nodes = self.state.nodes[world : world + 1]
        if np.isfinite(nodes).all() and self._volumes.collapsed(nodes).any():
            return f"{self._volumes.tell(self._volumes.measure(nodes)[0])}; {cause or TOO_WEAK}"
        told = f"positions are not finite after {self._times[world] + self.dt:.4f} s"
        return f"{told}; {cause}" if cause else told

    def nodes_of(self, worlds: ArrayLike) -> FloatArray:
        """(n, V, 3) positions of the organs' nodes in some worlds (n,), or where a mask (W,) is true (a copy) [u]."""
        return self.state.nodes[world_indices(worlds, self.count)]

    def times_of(self, worlds: ArrayLike) -> FloatArray:
        """(n,) time since the reset in some worlds (n,), or where a mask (W,) is true (a copy) [s]."""
        return self._times[world_indices(worlds, self.count)]

    def tools_of(self, world: int) -> tuple[PlacedTool, ...]:
        """(N,) the tools of a world, with its friction; placed as they are after a reset."""
        return self._tools[world]

    def reset(self, worlds: ArrayLike | None = None) -> None:
        """Start some worlds again: organs at rest, tools where the scene has them, no contact, time zero.

        Args:
            worlds: (n,) which, or (W,) a mask; all by default.

        Raises:
            ValueError: If there is no such world, or one is named twice.
        """
        indices = world_indices(worlds, self.count, once=True)
        inner = [self._rest_inner[w] for w in indices.tolist()]
        self._set_nodes(indices, self._rest[indices], np.zeros_like(self._rest[indices]), inner)
        placed = self._scene.tools
        self._put_tools(indices, [tool.position for tool in placed], [tool.orientation for tool in placed])
        self._forget(indices)
        self._times[indices] = 0.0

    def settle(self, worlds: ArrayLike | None = None) -> None:
        """Let the organs of some worlds come to rest under their present parameters, and reset these worlds.

        From then on, `reset` puts the organs into that state.

        Args:
            worlds: (n,) which, or (W,) a mask; all by default.

        Raises:
            SimulationDiverged: If positions are no longer finite, or an organ collapses; nothing has then changed.

        Warns:
            SceneWarning: If organs do not come to rest.
        """
        indices = world_indices(worlds, self.count)
        before = self.save()
        self.reset(indices)
        try:
            speeds, moving = self._come_to_rest(indices, " in worlds {worlds}: in world {world}")
            self._rest[indices] = self.state.nodes[indices]
            for w, inner in zip(indices.tolist(), self.engine.save(indices), strict=True):
                self._rest_inner[w] = inner
        finally:
            self.restore(before)
        self.reset(indices)
        moving &= is_creeping(self._scene, speeds)
        if moving.any():
            warn(
                f"the organs of {moving.sum()} of {len(indices)} worlds, world {indices[moving][0]} the first, have "
                f"not come to rest: they still moved at up to {speeds[moving].max():.2g} u/s when settling was ended"
            )

    def _come_to_rest(self, indices: IntArray, where: str) -> tuple[FloatArray, BoolArray]:
        """Let the organs of some worlds (n,) come to rest on the ground, from where they are.

        Kinetic damping: whenever the kinetic energy has passed a maximum, all velocities are set to zero. That takes
        the energy out of every mode of motion near its passage through equilibrium, slow ones and fast ones alike.

        Args:
            indices: Which worlds.
            where: Text for an error, a format string with the fields `worlds` and `world`.

        Returns:
            (n, V) how fast nodes moved when settling was ended [u/s], and (n,) whether they had not come to rest.

        Raises:
            SimulationDiverged: If organs do not come to rest.
        """
        state = self.state
        masses = 1.0 / np.where(self.engine.inverse_masses > 0.0, self.engine.inverse_masses, np.inf)[indices]
        energy_before, settled = np.zeros(len(indices)), np.zeros(len(indices), dtype=np.bool_)
        # Meanwhile the other worlds are skipped, as if they had diverged.
        waiting = np.setdiff1d(np.arange(self.count), indices)
        state.diverged[waiting] = True
        for _ in range(math.ceil(LONGEST_SETTLING / self.dt)):
            self._advance(1, 1.0, with_tools=False)
            self._check_settling(indices[state.diverged[indices]], where)
            velocities = state.velocities[indices]
            energy = np.einsum("wv,wva,wva->w", masses, velocities, velocities)
            past = (energy <= energy_before) & ~settled
            settled |= past & (np.abs(velocities).max(axis=(1, 2)) < SETTLED_SPEED)
            if settled.all():
                break
            stopped = indices[past]
            state.velocities[stopped] = 0.0
            self.engine.halt(state.nodes[stopped], stopped)
            energy[past] = 0.0
            energy_before = energy
        self._check_settling(indices[self._volumes.collapsed(state.nodes[indices]).any(axis=1)], where)
        state.diverged[waiting] = False
        return np.abs(state.velocities[indices]).max(axis=2), ~settled

    def _check_settling(self, bad: IntArray, where: str) -> None:
        """Raise SimulationDiverged if settling has failed in any worlds, which are given by their indices."""
        if len(bad):
            told = where.format(worlds=bad.tolist(), world=bad[0])
            why = self._why(int(bad[0]), organs_below_ground(self._scene))
            raise SimulationDiverged(f"organs do not come to rest{told} {why}")

    def place_tools(
        self, positions: ArrayLike, orientations: ArrayLike | None = None, worlds: ArrayLike | None = None
    ) -> None:
        """Move the tools of some worlds to poses at once; flags are cleared and organs feel nothing of the motion.

        Args:
            positions: (n, N, 3) [u].
            orientations: (n, N, 4) unit quaternions xyzw; unchanged by default.
            worlds: (n,) which, or (W,) a mask; all by default.

        Raises:
            ValueError: If an argument is malformed, not finite or not a unit quaternion; nothing has then changed.
        """
        indices, count = world_indices(worlds, self.count), len(self._scene.tools)
        new_positions = rows_of(positions, "positions", (len(indices), count, 3), indices)
        new_orientations = self.state.tool_orientations[indices]
        if orientations is not None:
            new_orientations = rows_of(orientations, "orientations", (len(indices), count, 4), indices)
            for row, world in zip(new_orientations, indices.tolist(), strict=True):
                row[:] = [as_quaternion(orientation, f"orientations of world {world}") for orientation in row]
        self._put_tools(indices, new_positions, new_orientations)
        self._clear_flags(indices)

    def place_tool(self, index: int, position: FloatArray, orientation: FloatArray) -> None:
        """Move one tool to a pose in all worlds, as `place_tools` does with all tools.

        Args:
            index: Index of the tool in the scene, from 0.
            position: (3,) [u].
            orientation: (4,) unit quaternion xyzw.

        Raises:
            ValueError: If there is no such tool; nothing has then changed.
        """
        check_count(index, "index", 0, len(self._scene.tools) - 1)
        every, positions, orientations = np.arange(self.count), self.tool_positions, self.tool_orientations
        positions[:, index], orientations[:, index] = position, orientation
        self._put_tools(every, positions, orientations)
        self._clear_flags(every, [index])

    def set_parameters(
        self,
        *,
        gravity: ArrayLike | None = None,
        stiffness: ArrayLike | None = None,
        mass_scale: ArrayLike | None = None,
        friction: ArrayLike | None = None,
        worlds: ArrayLike | None = None,
    ) -> None:
        """Change parameters of some worlds. Organs stay where they are; see also `settle`.

        Args:
            gravity: Downward acceleration [u/s2].
            stiffness: Factor on the stiffness of all links, from 0 to less than 2.
            mass_scale: Factor on all masses of the organs.
            friction: Coefficient of all tools.
            worlds: (n,) which, or (W,) a mask; all by default. A parameter is one number for all of them, or (n,).

        Raises:
            ValueError: If a value is not allowed, or the engine's worlds cannot differ in it; nothing has then changed.
        """
        indices = world_indices(worlds, self.count)
        new_friction = None
        if friction is not None:
            new_friction = one_each(friction, "friction", indices)
            refuse(new_friction < 0.0, indices, "friction", "zero or more", new_friction)
        if any(value is not None for value in (gravity, stiffness, mass_scale)):
            if not self.engine.abilities.varies:
                raise ValueError(f"gravity, stiffness and mass_scale must be None with {type(self.engine).__name__}")
            varying = cast("VaryingEngine", self.engine)
            varying.set_parameters(gravity=gravity, stiffness=stiffness, mass_scale=mass_scale, worlds=indices)
            gravities, inverse_masses = varying.gravity, self.engine.inverse_masses
            for w in indices.tolist():
                if gravity is not None:
                    self.contacts[w].settings[settings.GRAVITY] = gravities[w]
                if mass_scale is not None:
                    self.contacts[w].set_inverse_masses(inverse_masses[w])
        if new_friction is not None:
            for row, w in enumerate(indices.tolist()):
                self._change_tools(w, [replace(placed, friction=float(new_friction[row])) for placed in self._tools[w]])

    def set_tools(self, tools: Sequence[Tool], worlds: ArrayLike | None = None, index: int = 0) -> None:
        """Replace a tool in some worlds; the new one has the pose of the old one. Its flags are cleared.

        Args:
            tools: One for all of these worlds, or one each; with as many contact nodes as the scene's.
            worlds: (n,) which, or (W,) a mask; all by default.
            index: Index of the tool in the scene, from 0.

        Raises:
            TypeError: If one of them is not a `Tool`.
            ValueError: If a tool does not fit, or there is none of that index; nothing has then changed.
        """
        indices = world_indices(worlds, self.count)
        tools = as_tuple_of(tools, "tools", Tool)
        check_count(index, "index", 0, len(self._scene.tools) - 1)
        if len(tools) not in (1, len(indices)):
            raise ValueError(f"tools must be 1 or {len(indices)}, one for each world; got {len(tools)}")
        wanted = len(self._scene.tools[index].tool.nodes)
        for tool in tools:
            if len(tool.nodes) != wanted:
                raise ValueError(f"tools must have {wanted} contact nodes, as the scene's; got {len(tool.nodes)}")
        for row, w in enumerate(indices.tolist()):
            changed = list(self._tools[w])
            changed[index] = replace(changed[index], tool=tools[row if len(tools) > 1 else 0])
            self._change_tools(w, changed)
        self._clear_flags(indices, [index])

    def vary(self, friction: FloatArray, tool_size: FloatArray, worlds: ArrayLike | None = None) -> None:
        """Scale the friction and the size of the tools of some worlds. Flags are cleared.

        Args:
            friction: (n,) factor on the scene's coefficients between tools and organs.
            tool_size: (n,) factor on the lengths of the scene's tools.
            worlds: (n,) which, or (W,) a mask; all by default.
        """
        indices = world_indices(worlds, self.count)
        for row, w in enumerate(indices.tolist()):
            size, factor = float(tool_size[row]), float(friction[row])
            changed = [
                replace(placed, tool=placed.tool.scaled(size), friction=placed.friction * factor)
                for placed in self._scene.tools
            ]
            self._change_tools(w, changed)
        self._clear_flags(indices)

    def exchange_tools(self, tools: Sequence[PlacedTool]) -> None:
        """Give all worlds other tools, of any shape, where these are placed. All starts again, as after `reset`.

        Args:
            tools: As many as there are.
        """
        self._scene = replace(self._scene, tools=tuple(tools))
        self._equip(tools)
        if self._collisions is not None:
            for w in range(self.count):
                self._collisions.set_tools(tools, w)
        self.reset()

    def _change_tools(self, world: int, tools: Sequence[PlacedTool]) -> None:
        """Give a world other tools, with their friction, in the poses of the old ones."""
        before, self._tools[world] = self._tools[world], tuple(tools)
        for index, (old, new) in enumerate(zip(before, tools, strict=True)):
            if new.tool != old.tool:
                self.contacts[world].set_tool(index, tool_shape(new.tool))
        self.contacts[world].friction[:] = [placed.friction for placed in tools]
        if self._collisions is not None and self._tools[world] != before:
            at, state = np.array([world]), self.state
            inner = self.engine.save(at)
            self._collisions.set_tools(tools, world)
            self._set_nodes(at, state.nodes[at], state.velocities[at], inner)
            self._put_tools(at, state.tool_positions[at], state.tool_orientations[at])

    def advance(
        self,
        linear_velocities: ArrayLike,
        angular_velocities: ArrayLike | None = None,
        steps: int = 1,
        pressure_limits: ArrayLike | None = None,
        force_limits: ArrayLike | None = None,
        steer: Steer | None = None,
        after_step: Callable[[], object] | None = None,
    ) -> Loads:
        """Advance all worlds by some physics steps, the tools moving with constant velocity.

        Args:
            linear_velocities: (W, N, 3) [u/s].
            angular_velocities: (W, N, 3) world frame [rad/s]; none by default.
            steps: Number of physics steps.
            pressure_limits: (W,) pressure beyond which overpressure is counted [kg/(u s2)]; by default none is counted.
            force_limits: (W,) a tool that has met a greater force in a physics step does not push on in the next one,
                see `drive.restrain` [kg u/s2]; by default there is no limit.
            steer: Called before every physics step for the velocities of the tools, in place of the given ones.
            after_step: Called after every physics step. An exception that it raises ends the control step.

        Returns:
            The loads on the tools. A world that diverges, because an organ in it has turned inside out or positions are
            not finite, does not affect the others; it waits to be reset.

        Raises:
            ValueError: If a velocity is malformed, not finite or beyond `selection.GREATEST_SPEED`; nothing has then
                changed.
        """
        shape, every = self.state.tool_positions.shape, np.arange(self.count)
        linear = rows_of(linear_velocities, "linear_velocities", shape, every)
        angular = np.zeros(shape)
        if angular_velocities is not None:
            angular = rows_of(angular_velocities, "angular_velocities", shape, every)
        check_speeds(linear, "linear_velocities", "u/s")
        check_speeds(angular, "angular_velocities", "rad/s")
        if not isinstance(steps, int | np.integer) or steps < 1:
            raise ValueError(f"steps must be an integer, 1 or more, got {steps!r}")
        pressures, forces = (
            np.inf if value is None else rows_of(value, name, (self.count,), every)
            for name, value in (("pressure_limits", pressure_limits), ("force_limits", force_limits))
        )
        self.move(linear, angular, int(steps), pressures, forces, steer, after_step)
        return self._loads(int(steps))

    def move(
        self,
        linear: FloatArray,
        angular: FloatArray,
        steps: int = 1,
        pressure_limits: FloatArray | float = np.inf,
        force_limits: FloatArray | float = np.inf,
        steer: Steer | None = None,
        after_step: Callable[[], object] | None = None,
    ) -> None:
        """Do what `advance` does, without checking arguments and without returning loads."""
        drive, state = self._drive, self.state
        self._note_starts()
        drive.linear[:], drive.angular[:] = linear, angular
        drive.pressure_limits[:], drive.force_limits[:] = pressure_limits, force_limits
        for array in self._sums:
            array[:] = 0.0
        # An engine that can do so runs all steps at once, unless a function must be called in between.
        alone = self._blocks is not None and steer is None and after_step is None
        for index in range(1 if alone else steps):
            if steer is not None:
                for w in np.flatnonzero(~state.diverged).tolist():
                    drive.linear[w], drive.angular[w] = steer(w, index)
            count = steps if alone else 1
            self._advance(count, 1.0 / steps)
            going = ~state.diverged
            self._times[going] = later(self._times[going], count, self.dt)
            self._has_stepped |= going
            if not going.any():
                break
            if after_step is not None:
                after_step()

    def _note_starts(self) -> None:
        """Remember the poses of the tools in worlds that have not been stepped since a reset."""
        fresh = ~(self._has_stepped | self.state.diverged)
        if fresh.any():
            at_rest = (fresh & (self._times == 0.0))[:, None, None]
            self._start_positions[fresh] = np.where(at_rest, self.state.tool_positions, np.nan)[fresh]
            self._start_orientations[fresh] = self.state.tool_orientations[fresh]

    def _advance(self, steps: int, share: float, *, with_tools: bool = True) -> None:
        """Take all worlds through physics steps, each a fraction `share` of a control step, with tools or without."""
        state, lanes = self.state, self._lanes
        coupling = self._coupling if with_tools else self._settling
        collisions = self._collisions if with_tools else None
        if self._blocks is not None:
            engine = self._blocks

            def work(block: int) -> None:
                engine.run_block(block, coupling, steps, share)

        else:
            free_nodes, free_velocities = state.nodes.copy(), state.velocities.copy()
            if collisions is not None:
                collisions.begin(share)
            self.engine.advance(free_nodes, free_velocities, state.diverged)

            def work(block: int) -> None:
                step.couple_block(block, lanes, coupling, share, free_nodes, free_velocities)

        going = range(-(-self.count // lanes))
        if state.diverged.any():
            going = np.unique(np.flatnonzero(~state.diverged) // lanes).tolist()
        threads = numba.get_num_threads() if self._parallel else 1
        if min(len(going), threads) <= 1:
            for block in going:
                work(block)
        else:
            share_out(lambda index: work(going[index]), len(going), threads)
        if collisions is not None:
            collisions.finish()
        state.diverged[:] |= self._volumes.inside_out(state.nodes).any(axis=1)

    def _loads(self, steps: int) -> Loads:
        """The loads on the tools, from the sums over a number of steps."""
        sums, ok = self._sums, ~self.state.diverged
        told = {name: values * ok.reshape(-1, *[1] * (values.ndim - 1)) for name, values in sums._asdict().items()}
        for name in ("forces", "torques", "ground_forces", "face_pressures"):
            told[name] /= steps
        del told["node_pressures"]
        return Loads(
            mean_pressures=told.pop("face_pressures").max(axis=(1, 2)),
            tangled=told.pop("crossed_for") > LONGEST_CROSSED,
            flags=self._flags(),
            node_pressures=self.node_pressures,
            diverged=~ok,
            **told,
        )

    def _flags(self) -> tuple[BoolArray, ...]:
        """For each tool, (W, n) which of its contact nodes are in contact with any organ."""
        organs, ok = len(self._scene.organs), ~self.state.diverged
        found = [[memory.states[0] for memory in contact.memories] for contact in self.contacts]
        return tuple(
            np.array([np.any(flags[k : k + organs], axis=0) for flags in found]) & ok[:, None]
            for k in range(0, organs * len(self._scene.tools), organs)
        )

    def save(self, worlds: ArrayLike | None = None) -> WorldsState:
        """Everything needed to continue from here later, as copies.

        Args:
            worlds: (n,) which, or (W,) a mask; all by default.
        """
        indices, state = world_indices(worlds, self.count), self.state
        return WorldsState(
            nodes=state.nodes[indices],
            node_velocities=state.velocities[indices],
            tool_positions=state.tool_positions[indices],
            tool_orientations=state.tool_orientations[indices],
            tool_forces=state.tool_forces[indices],
            times=self._times[indices],
            memories=tuple(
                WorldMemory(
                    flags=tuple(memory.states[0].copy() for memory in contact.memories),
                    multipliers=contact.copy_multipliers(),
                    ledger=contact.ledger.copy(),
                    near=contact.copy_near(),
                    pace=float(contact.pace[0]),
                )
                for contact in (self.contacts[w] for w in indices.tolist())
            ),
            inner=self.engine.save(indices),
        )

    def restore(self, state: WorldsState, worlds: ArrayLike | None = None) -> None:
        """Go back to a saved state, of these worlds or others of the same scene. Parameters stay as they are.

        Args:
            state: What `save` returned for n worlds.
            worlds: (n,) which worlds get it, or (W,) a mask; all by default.

        Raises:
            TypeError: If `state` is not a `WorldsState`.
            ValueError: If the state is of another number of worlds, or does not fit the scene or is not finite, or a
                world is named twice; nothing has then changed.
        """
        check_kind(state, "state", WorldsState)
        indices, mine = world_indices(worlds, self.count, once=True), self.state
        for name, array in (
            ("nodes", mine.nodes),
            ("node_velocities", mine.velocities),
            ("tool_positions", mine.tool_positions),
            ("tool_orientations", mine.tool_orientations),
            ("tool_forces", mine.tool_forces),
        ):
            rows_of(getattr(state, name), f"state.{name}", (len(indices), *array.shape[1:]), indices)
        wanted = [memory.states[0].shape for memory in self.contacts[0].memories]
        for remembered in state.memories:
            if [flags.shape for flags in remembered.flags] != wanted:
                raise ValueError(f"state must have flags of shapes {wanted}, got {[f.shape for f in remembered.flags]}")
        self._put_tools(indices, state.tool_positions, state.tool_orientations)
        self._set_nodes(indices, state.nodes, state.node_velocities, state.inner or (None,) * len(indices))
        self._forget(indices)
        self._times[indices] = state.times
        mine.tool_forces[indices] = state.tool_forces
        for w, remembered in zip(indices.tolist(), state.memories, strict=True):
            contact = self.contacts[w]
            for memory, flags in zip(contact.memories, remembered.flags, strict=True):
                memory.states[0] = flags
            contact.restore_multipliers(remembered.multipliers)
            contact.restore_near(remembered.near, mine.nodes[w])
            contact.ledger[:] = remembered.ledger
            contact.pace[0] = remembered.pace
            contact.admit_energy(mine.nodes[w], mine.velocities[w])

    def close(self) -> None:
        """Free what the engine holds. Closing twice is allowed."""
        self.engine.close()

    def _set_nodes(self, indices: IntArray, nodes: FloatArray, velocities: FloatArray, inner: Sequence[Any]) -> None:
        self.state.nodes[indices], self.state.velocities[indices] = nodes, velocities
        self.engine.restore(self.state.nodes[indices], self.state.velocities[indices], inner, indices)

    def _put_tools(self, indices: IntArray, positions: ArrayLike, orientations: ArrayLike) -> None:
        self.state.tool_positions[indices], self.state.tool_orientations[indices] = positions, orientations
        if self._collisions is not None:
            self._collisions.place(indices)

    def _clear_flags(self, indices: IntArray, tools: Sequence[int] | None = None) -> None:
        """Clear the contact flags of some tools in some worlds, and the forces on them; all tools by default."""
        organs = len(self._scene.organs)
        for tool in range(len(self._scene.tools)) if tools is None else tools:
            self.state.tool_forces[indices, tool] = 0.0
            for w in indices.tolist():
                for memory in self.contacts[w].memories[tool * organs : (tool + 1) * organs]:
                    memory.states[:] = False

    def _forget(self, indices: IntArray) -> None:
        """Forget all contacts of some worlds, and that they diverged."""
        self._clear_flags(indices)
        for w in indices.tolist():
            self.contacts[w].forget_solves()
        self.state.diverged[indices] = self._has_stepped[indices] = False

    def __reduce__(self) -> Any:
        raise TypeError(NO_COPY.format(type(self).__name__))
