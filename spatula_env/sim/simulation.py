"""Simulation of one world: a `Worlds` with a single world, and a report of every step."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.contact import settings
from spatula_env.contact.flags import Contacts
from spatula_env.contact.motion import Motions
from spatula_env.contact.pressure import contact_table
from spatula_env.geometry.checks import as_floats, as_seed, as_tuple_of, check_kind
from spatula_env.geometry.transforms import as_quaternion, as_vector3
from spatula_env.scenes import PlacedTool
from spatula_env.sim.engine import OWN_CONTACTS, ContactName
from spatula_env.sim.report import Pressures, Report
from spatula_env.sim.selection import check_speeds
from spatula_env.sim.states import SimulationState
from spatula_env.sim.worlds import NO_COPY, SimulationDiverged, Worlds

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike, NDArray

    from spatula_env.arrays import FloatArray
    from spatula_env.contact.flags import FirstStep
    from spatula_env.scenes import Scene
    from spatula_env.sim.engine import Precision, Strains

__all__ = ["ContactName", "Simulation", "SimulationDiverged", "SimulationState"]


class Simulation:
    """Soft organs, rigid tools with prescribed motion, and contact between them.

    Everything is in scene units: lengths in u, masses in kg, seconds; `scene.scale` converts to SI.

    Example:
        >>> from spatula_env import Simulation, scenes
        >>> simulation = Simulation(scenes.seed())
        >>> simulation.reset(seed=0)
        >>> report = simulation.step(linear_velocity=(0.0, 0.0, -5.0))
        >>> simulation.close()

    Attributes:
        worlds: The underlying `Worlds`, which has this one world.
        contact: The method that resolves contact.
        listeners: Functions that are called with the report of every physics step, in order. If one raises an
            exception, the step has been made nevertheless.
    """

    def __init__(
        self,
        scene: Scene,
        engine: str | None = None,
        contact: ContactName = "flags",
        first_step: FirstStep = "inside",
        precision: Precision = "single",
    ) -> None:
        """Load a scene and let its organs come to rest.

        Args:
            scene: The organs, tools and ground.
            engine: Name of the engine that integrates the organs, one of `engines.ENGINES`. "bullet": PyBullet's soft
                body. "batch": this package's own, which computes the same, faster. None: "bullet" where PyBullet is
                installed, else "batch".
            contact: "flags": the flags method with both its steps; organs are kept apart from themselves and each other
                too, which the other methods do not do. "second_step": without the first step, so that both faces of a
                thin tool push. "bullet", "mujoco": the own algorithm of the engine of that name; the detector only
                observes.
            first_step: What the flags method's first step looks for, "inside" or "any_hit"; see `FlaggedDetector`.
            precision: Precision in which an engine that offers both integrates, "single" or "double". Bullet's is
                always double, as is all contact.

        Raises:
            TypeError: If `scene` is not a `Scene`.
            ValueError: If an argument is not one of those, or the engine does not support that contact, or an organ's
                surface crosses itself.
            ImportError: If PyBullet is asked for and is not installed; says what to install.
            SimulationDiverged: If an organ collapses under its own weight.

        Warns:
            SceneWarning: If an organ does not keep its shape under its own weight or does not come to rest, and about
                anything else in the scene that is probably not intended.
        """
        self.worlds = Worlds(
            scene, 1, engine=engine, contact=contact, first_step=first_step, precision=precision, parallel=False
        )
        self.contact: ContactName = contact
        self.listeners: list[Callable[[Report], None]] = []
        self._scene = scene
        self._closed = False

    @property
    def scene(self) -> Scene:
        """The scene, with the present tools."""
        tools = self.worlds.tools_of(0)
        if tools is not self._scene.tools:
            self._scene = replace(self._scene, tools=tools)
        return self._scene

    def reset(self, seed: int | None = None) -> None:
        """Start again: organs at rest, tools where the scene has them, no contact, time zero.

        Args:
            seed: Accepted so that callers can pass theirs on. Nothing in a simulation is random: after two resets, and
                in two simulations of one scene, results are identical to the last bit.

        Raises:
            ValueError: If the seed is neither None nor an integer that is not negative; nothing has then changed.
        """
        self._check_open()
        as_seed(seed)
        self.worlds.reset()

    def place_tool(self, position: ArrayLike, orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0), index: int = 0) -> None:
        """Move a tool to a pose at once. Its flags are cleared, and the organs feel nothing of the motion.

        Args:
            position: (3,) [u].
            orientation: (4,) unit quaternion xyzw.
            index: Index of the tool, from 0.

        Raises:
            ValueError: If an argument is malformed or not finite, or there is no such tool; all tools then stay where
                they were.
        """
        self._check_open()
        self.worlds.place_tool(index, as_vector3(position, "position"), as_quaternion(orientation, "orientation"))

    def set_tools(self, tools: Sequence[PlacedTool]) -> None:
        """Exchange the tools, with their shapes, friction and initial poses. Everything starts again, as after `reset`.

        Args:
            tools: As many as there are; organs stay at rest as they were.

        Raises:
            TypeError: If one of them is not a `PlacedTool`.
            ValueError: If there is another number of tools.
        """
        self._check_open()
        tools = as_tuple_of(tools, "tools", PlacedTool)
        if len(tools) != len(self.scene.tools):
            raise ValueError(f"tools must be {len(self.scene.tools)}, as in the scene, got {len(tools)}")
        if tools == self.scene.tools:
            self.worlds.reset()
        else:
            self.worlds.exchange_tools(tools)

    def step(
        self, linear_velocity: ArrayLike = (0.0, 0.0, 0.0), angular_velocity: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Report:
        """Advance by one physics step of `dt`, the tools moving with constant velocity.

        Args:
            linear_velocity: (3,) for all tools, or (N, 3) for each [u/s].
            angular_velocity: (3,) or (N, 3), world frame [rad/s].

        Returns:
            What happened.

        Raises:
            ValueError: If a velocity is malformed, not finite or beyond `selection.GREATEST_SPEED`; nothing has then
                changed.
            SimulationDiverged: If positions are no longer finite, or an organ has turned inside out.
        """
        self._check_open()
        shape = self.worlds.state.tool_positions.shape[1:]
        linear = _as_velocities(linear_velocity, "linear_velocity", shape)
        angular = _as_velocities(angular_velocity, "angular_velocity", shape)
        check_speeds(linear, "linear_velocity", "u/s")
        check_speeds(angular, "angular_velocity", "rad/s")
        self.worlds.move(linear, angular)
        if self.worlds.state.diverged[0]:
            raise SimulationDiverged(self.worlds.why_diverged(0))
        return self.tell()

    def tell(self) -> Report:
        """Report the last step, also to the listeners. Code that steps `worlds` itself calls this after each step.

        Returns:
            What happened.
        """
        report = self._report()
        # A copy, because a listener may remove itself.
        for listener in tuple(self.listeners):
            listener(report)
        return report

    def _report(self) -> Report:
        worlds, scene = self.worlds, self.scene
        contact, result = worlds.contacts[0], worlds.last.result[0]
        wrenches, organs = worlds.last.wrenches[0] / self.dt, len(scene.organs)
        found = [Contacts(memory.states, memory.triangle, memory.record) for memory in contact.memories]
        count = int(result[settings.CONTACT_COUNT])
        return Report(
            scene=scene,
            motions=Motions(*(values[0].copy() for values in worlds.last[:6])),
            loads=wrenches[:-1],
            nodal_impulses=worlds.last.impulses[0].copy(),
            ground_force=-wrenches[-1, :3],
            all_contacts=tuple(tuple(found[k : k + organs]) for k in range(0, len(found), organs)),
            table=None if self.contact in OWN_CONTACTS else contact_table(contact.workspace.constraints, count),
            penetration=float(result[settings.PENETRATION]),
            residual=float(result[settings.RESIDUAL]),
            queries=int(result[settings.QUERIES]),
            reach=float(contact.settings[settings.MEAN_EDGE]),
            crossings=int(result[settings.CROSSINGS]),
            crossed_for=float(result[settings.CROSSED_FOR]),
            stopped=bool(result[settings.STOPPED] > 0.0),
        )

    def pressures(self) -> Pressures:
        """The contact pressures of the last step; zero with contact of the engine's own.

        They are the same as in the step's report, but computed all at once and in a fraction of the time.

        Raises:
            RuntimeError: If no step has been made since the last `reset`, `restore` or exchange of tools.
        """
        if not self.worlds.has_stepped[0]:
            raise RuntimeError("there are no pressures before the first step")
        pressures = [values[0].copy() for values in self.worlds.node_pressures]
        faces = []
        for placed, values in zip(self.scene.tools, pressures, strict=True):
            face, areas = placed.tool.face, placed.tool.areas
            faces.append(np.bincount(face, values * areas) / np.bincount(face, areas))
        return Pressures(float(max(map(np.max, pressures))), np.concatenate(faces), tuple(pressures))

    def strains(self) -> Strains:
        """How organs are strained and stressed now, (1, O) each; see `Worlds.strains`.

        Raises:
            RuntimeError: If the engine does not report strains.
        """
        self._check_open()
        return self.worlds.strains()

    def save(self) -> SimulationState:
        """Everything needed to continue from here later, as copies.

        What follows `restore` is the same each time to the last bit. With the engine "bullet" it differs at first by
        1e-13 u from the run without `restore`: Bullet's velocities hold rounding errors that cannot be read.
        """
        self._check_open()
        return SimulationState.of_world(self.worlds.save())

    def restore(self, state: SimulationState) -> None:
        """Go back to a saved state, of this simulation or another of the same scene.

        Args:
            state: What `save` returned.

        Raises:
            TypeError: If `state` is not a `SimulationState`.
            ValueError: If the state is of a scene with other nodes or tools, or not finite; nothing has then changed.
        """
        self._check_open()
        check_kind(state, "state", SimulationState)
        self.worlds.restore(SimulationState.joined([state]))

    def close(self) -> None:
        """Free the engine. Closing twice is allowed; anything else afterwards is a RuntimeError."""
        self.worlds.close()
        self._closed = True

    @property
    def nodes(self) -> FloatArray:
        """(V, 3) positions of all organs' nodes (a copy) [u]."""
        nodes: FloatArray = self.worlds.state.nodes[0].copy()
        return nodes

    @property
    def node_velocities(self) -> FloatArray:
        """(V, 3) velocities of all organs' nodes, contact impulses included (a copy) [u/s]."""
        velocities: FloatArray = self.worlds.state.velocities[0].copy()
        return velocities

    @property
    def node_masses(self) -> FloatArray:
        """(V,) masses of all organs' nodes [kg]; infinite for a fixed node."""
        masses: FloatArray = self.worlds.node_masses[0]
        return masses

    @property
    def volume(self) -> float:
        """Volume that all organs together enclose now [u3]."""
        return float(self.worlds.volumes.sum())

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(T, 3) of all organs, counter-clockwise from outside (a copy)."""
        return self.worlds.triangles

    @property
    def tool_position(self) -> FloatArray:
        """(3,) of the first tool (a copy) [u]."""
        value: FloatArray = self.tool_positions[0]
        return value

    @property
    def tool_orientation(self) -> FloatArray:
        """(4,) of the first tool, quaternion xyzw (a copy)."""
        value: FloatArray = self.tool_orientations[0]
        return value

    @property
    def tool_positions(self) -> FloatArray:
        """(N, 3) of all tools (a copy) [u]."""
        values: FloatArray = self.worlds.tool_positions[0]
        return values

    @property
    def tool_orientations(self) -> FloatArray:
        """(N, 4) of all tools (a copy)."""
        values: FloatArray = self.worlds.tool_orientations[0]
        return values

    @property
    def tool_forces(self) -> FloatArray:
        """(N, 3) on all tools in the last step (a copy) [kg u/s2]."""
        forces: FloatArray = self.worlds.state.tool_forces[0].copy()
        return forces

    @property
    def dt(self) -> float:
        """Length of a step [s]."""
        return self.worlds.dt

    def __reduce__(self) -> Any:
        raise TypeError(NO_COPY.format(type(self).__name__))

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return float(self.worlds.times[0])

    def _check_open(self) -> None:
        if self._closed:
            raise RuntimeError("this simulation is closed; make a new one")


def _as_velocities(value: ArrayLike, name: str, shape: tuple[int, ...]) -> FloatArray:
    """(N, 3) a velocity for each tool, from one for all (3,) or one for each (N, 3)."""
    try:
        array = np.ascontiguousarray(as_floats(value))
    except ValueError as error:
        raise ValueError(f"{name} must be numbers, got {value!r}") from error
    if array.shape not in ((3,), shape):
        raise ValueError(f"{name} must have shape (3,) or {shape}, got {array.shape}")
    if not all(map(math.isfinite, array.ravel().tolist())):
        raise ValueError(f"{name} must be finite, got {array.tolist()}")
    return array if array.ndim == 2 else array.reshape(1, 3).repeat(shape[0], axis=0) if shape[0] > 1 else array[None]
