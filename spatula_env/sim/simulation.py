"""One physics step: move the tools, step the organs, detect contacts, respond."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from spatula_env.contact.model import ContactMemory, ContactModel, Motions, Pressures
from spatula_env.contact.motion import turned_by
from spatula_env.engines import ENGINES, choose_engine
from spatula_env.geometry.transforms import as_quaternion, as_vector3
from spatula_env.sim.batch_world import BatchWorld
from spatula_env.sim.bullet import BulletWorld
from spatula_env.sim.clock import later
from spatula_env.sim.report import Report
from spatula_env.sim.scene_checks import warn_of_rest, warn_of_scene
from spatula_env.sim.volumes import Volumes

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike, NDArray

    from spatula_env.contact.flags import FirstStep
    from spatula_env.scenes import PlacedTool, Scene
    from spatula_env.sim.bullet import BulletTools
    from spatula_env.sim.world import SoftWorld

    FloatArray = NDArray[np.float64]

ContactName = Literal["flags", "second_step", "bullet"]
"""What resolves contact between tools and organs; see `Simulation`."""

PRECISIONS = {"single": np.float32, "double": np.float64}
"""Of the batch engine."""

SETTLED_SPEED = 1e-3
"""An organ none of whose nodes is faster is at rest [u/s]."""

NO_COPY = "a {} can be neither copied nor pickled: make another one of its scene, and restore there what save() gives"

LONGEST_SETTLING = 4.0
"""Settling ends after this time even if something still moves [s]."""


class SimulationDiverged(RuntimeError):
    """Positions are no longer finite, or an organ has turned inside out; reset() or restore() makes it usable again."""


@dataclass(frozen=True)
class SimulationState:
    """All that decides how a simulation goes on; made by `Simulation.save`.

    Attributes:
        nodes: (V, 3) [u].
        node_velocities: (V, 3) [u/s].
        tool_positions: (N, 3) of the N tools [u].
        tool_orientations: (N, 4).
        contact: What the contact model remembers.
        time: [s].
    """

    nodes: FloatArray
    node_velocities: FloatArray
    tool_positions: FloatArray
    tool_orientations: FloatArray
    contact: ContactMemory
    time: float

    @property
    def flags(self) -> tuple[tuple[NDArray[np.bool_], ...], ...]:
        """Contact flags of each tool (outer) and organ (inner)."""
        return self.contact.flags


class Simulation:
    """Soft organs, rigid tools that move as they are told, and contact between them.

    Everything is in scene units: lengths in u, masses in kg, seconds; `scene.scale` leads to SI.

    Example:
        >>> from spatula_env import Simulation, scenes
        >>> simulation = Simulation(scenes.seed())
        >>> simulation.reset(seed=0)
        >>> report = simulation.step(linear_velocity=(0.0, 0.0, -5.0))
        >>> simulation.close()

    Attributes:
        scene: What is in it.
        contact: What resolves contact.
        listeners: Called with the report of every `step`, in order, before it returns. When one raises, the step has
            been done all the same.
    """

    def __init__(
        self,
        scene: Scene,
        engine: str | None = None,
        contact: ContactName = "flags",
        first_step: FirstStep = "inside",
        precision: Literal["single", "double"] = "single",
    ) -> None:
        """Load a scene and let its organs come to rest.

        Args:
            scene: What is in it.
            engine: What integrates the organs. "bullet": PyBullet's soft body. "batch": this package's own, which
                computes the same, faster; `BatchSimulation` steps many worlds with it. None: "bullet" where PyBullet
                is installed, else "batch".
            contact: "flags": the flags method with both its steps; organs are kept apart from themselves and each other
                too, which the others do not do. "second_step": without the first step, so that both faces of a thin
                tool push. "bullet": PyBullet's own collision algorithm; the detector only watches.
            first_step: What the flags method's first step looks for, "inside" or "any_hit"; see `FlaggedDetector`.
            precision: In which the batch engine integrates, "single" or "double". Bullet's is always double, as is all
                contact.

        Raises:
            ValueError: If an argument is not one of those, or the batch engine is asked for Bullet's contact.
            ImportError: If PyBullet is asked for and is not installed; says what to install.
            SimulationDiverged: If an organ collapses under its own weight.

        Warns:
            SceneWarning: If an organ does not keep its shape under its own weight or does not come to rest, and of what
                else in the scene is not as it is likely to be meant.
        """
        if engine is not None and engine not in ENGINES:
            raise ValueError(f"engine must be one of {list(ENGINES)}, got {engine!r}")
        if contact not in get_args(ContactName):
            raise ValueError(f"contact must be one of {list(get_args(ContactName))}, got {contact!r}")
        if precision not in PRECISIONS:
            raise ValueError(f"precision must be one of {list(PRECISIONS)}, got {precision!r}")
        if engine == "batch" and contact == "bullet":
            raise ValueError("contact must be 'flags' or 'second_step' with engine 'batch', got 'bullet'")
        engine = choose_engine(engine, contact)
        self.scene = scene
        self.contact: ContactName = contact
        self.listeners: list[Callable[[Report], None]] = []
        self._closed = False
        warn_of_scene(scene)
        self._tools: BulletTools | None = None
        self._world: SoftWorld
        if engine == "bullet":
            self._world = bullet = BulletWorld(scene, with_tools=contact == "bullet")
            self._tools = bullet.tools
        else:
            self._world = BatchWorld(scene, PRECISIONS[precision])
        self._first_step: FirstStep = "off" if contact == "second_step" else first_step
        self._model = ContactModel(scene, self._world.inverse_masses, self._first_step, keeps_apart=contact == "flags")
        starts = np.cumsum([0, *(len(placed.organ.vertices) for placed in scene.organs)])
        self._triangles = np.concatenate(
            [placed.organ.triangles + start for placed, start in zip(scene.organs, starts, strict=False)]
        ).astype(np.int32)
        self._nodes: FloatArray = np.concatenate([placed.vertices for placed in scene.organs])
        self._velocities: FloatArray = np.zeros_like(self._nodes)
        self._tool_positions: FloatArray = np.zeros((len(scene.tools), 3))
        self._tool_orientations: FloatArray = np.zeros((len(scene.tools), 4))
        self._motions: Motions | None = None
        self._time = 0.0
        self._volumes = Volumes(scene)
        self._rest: FloatArray | None = None
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Start again: organs at rest, tools where the scene has them, no contact, time zero.

        Args:
            seed: Accepted so that callers can pass theirs on. Nothing in a simulation is random: two resets, and
                two simulations of one scene, go on identically to the last bit.
        """
        self._check_open()
        if self._rest is None:
            self._rest = self._settle()
        self._set_nodes(self._rest, np.zeros_like(self._rest))
        for index, placed in enumerate(self.scene.tools):
            self.place_tool(placed.position, placed.orientation, index=index)
        self._model.reset()
        self._motions = None
        self._time = 0.0

    def place_tool(self, position: ArrayLike, orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0), index: int = 0) -> None:
        """Put a tool somewhere at once. Its flags are cleared and the organs feel nothing of the way.

        Args:
            position: (3,) [u].
            orientation: (4,) unit quaternion xyzw.
            index: Which tool.

        Raises:
            ValueError: If an argument is malformed or not finite; the tool then stays where it was.
        """
        self._check_open()
        new_position, new_orientation = (
            as_vector3(position, "position"),
            as_quaternion(orientation, "orientation"),
        )
        self._tool_positions, self._tool_orientations = self._tool_positions.copy(), self._tool_orientations.copy()
        self._tool_positions[index] = new_position
        self._tool_orientations[index] = new_orientation
        self._model.forget(index)
        if self._tools is not None:
            self._tools.place(index, new_position, new_orientation)

    def set_tools(self, tools: Sequence[PlacedTool]) -> None:
        """Exchange the tools' shapes and friction. Everything starts again, as after `reset`.

        Args:
            tools: As many as there are; organs stay at rest as they were.

        Raises:
            ValueError: If there is another number of tools.
        """
        self._check_open()
        if len(tools) != len(self.scene.tools):
            raise ValueError(f"tools must be {len(self.scene.tools)}, as in the scene, got {len(tools)}")
        if tuple(tools) != self.scene.tools:
            self.scene = replace(self.scene, tools=tuple(tools))
            if self._tools is not None:
                # Bullet cannot exchange the shape of a body.
                self._world.close()
                self._world = bullet = BulletWorld(self.scene, with_tools=True)
                self._tools = bullet.tools
            self._model = ContactModel(
                self.scene, self._world.inverse_masses, self._first_step, keeps_apart=self.contact == "flags"
            )
        self.reset()

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
            ValueError: If a velocity is malformed or not finite; nothing has then changed.
            SimulationDiverged: If positions are no longer finite, or an organ has turned inside out.
        """
        self._check_open()
        shape = self._tool_positions.shape
        linear = _as_velocities(linear_velocity, "linear_velocity", shape)
        angular = _as_velocities(angular_velocity, "angular_velocity", shape)
        motions = self._move_tools(linear, angular)
        tools, model = self._tools, self._model
        if tools is not None:
            for index in range(shape[0]):
                tools.move(index, motions.positions[index], motions.orientations[index], linear[index], angular[index])
        self._advance(motions, respond=tools is None)
        if tools is not None:
            impulses = [tools.impulse(index, linear[index], angular[index]) for index in range(shape[0])]
            model.wrenches = np.array([np.concatenate(pair) for pair in impulses]) / self.dt
            model.nodal_impulses = np.full_like(self._nodes, np.nan)
        self._tool_positions, self._tool_orientations = motions.positions, motions.orientations
        self._motions = motions
        self._time = float(later(self._time, 1, self.dt))
        report = Report(
            scene=self.scene,
            motions=motions,
            loads=model.wrenches,
            nodal_impulses=model.nodal_impulses,
            ground_force=model.ground_force,
            all_contacts=tuple(tuple(detector.contacts for detector in row) for row in model.detectors),
            table=model.contact_table() if tools is None else None,
            penetration=model.penetration,
            residual=model.residual,
            queries=model.queries,
            reach=model.reach,
            crossings=model.crossings,
            crossed_for=model.crossed_for,
        )
        # A copy: who listens may stop listening.
        for listener in tuple(self.listeners):
            listener(report)
        return report

    def pressures(self) -> Pressures:
        """The contact pressures of the last step; zero with `contact="bullet"`.

        They are those of the step's report, all at once and in a fraction of the time.

        Raises:
            RuntimeError: If no step has been made since the last `reset`, `restore` or exchange of tools.
        """
        if self._motions is None:
            raise RuntimeError("there are no pressures before the first step")
        return self._model.pressures(self._motions)

    def save(self) -> SimulationState:
        """Everything needed to go on from here later, as arrays of its own."""
        self._check_open()
        return SimulationState(
            nodes=self._nodes.copy(),
            node_velocities=self._velocities.copy(),
            tool_positions=self._tool_positions.copy(),
            tool_orientations=self._tool_orientations.copy(),
            contact=self._model.save(),
            time=self._time,
        )

    def restore(self, state: SimulationState) -> None:
        """Go back to a saved state, of this simulation or another of the same scene.

        Args:
            state: What `save` returned.

        Raises:
            ValueError: If the state is of a scene with other nodes or tools, or not finite; nothing has then changed.
        """
        self._check_open()
        for name, mine in (
            ("nodes", self._nodes),
            ("node_velocities", self._velocities),
            ("tool_positions", self._tool_positions),
            ("tool_orientations", self._tool_orientations),
        ):
            theirs = getattr(state, name)
            if theirs.shape != mine.shape:
                raise ValueError(f"state must have {name} of shape {mine.shape}, got {theirs.shape}")
            if not np.isfinite(theirs).all():
                raise ValueError(f"state must have finite {name}")
        mine_flags = [[detector.flags.shape for detector in row] for row in self._model.detectors]
        their_flags = [[flags.shape for flags in row] for row in state.flags]
        if their_flags != mine_flags:
            raise ValueError(f"state must have flags of shapes {mine_flags}, got {their_flags}")
        self._model.reset()
        for index in range(len(self._tool_positions)):
            self.place_tool(state.tool_positions[index], state.tool_orientations[index], index=index)
        self._set_nodes(state.nodes, state.node_velocities)
        self._model.restore(state.contact, self._nodes, self._velocities)
        self._motions = None
        self._time = state.time

    def close(self) -> None:
        """Free the engine. Closing twice is allowed; anything else afterwards is a RuntimeError."""
        self._world.close()
        self._closed = True

    @property
    def nodes(self) -> FloatArray:
        """(V, 3) positions of all organs' nodes (a copy) [u]."""
        return self._nodes.copy()

    @property
    def node_velocities(self) -> FloatArray:
        """(V, 3) velocities of all organs' nodes, contact impulses included (a copy) [u/s]."""
        return self._velocities.copy()

    @property
    def node_masses(self) -> FloatArray:
        """(V,) masses of all organs' nodes [kg]; infinite for a fixed node."""
        with np.errstate(divide="ignore"):
            return 1.0 / self._world.inverse_masses

    @property
    def volume(self) -> float:
        """What all organs together enclose now [u3]."""
        return float(self._volumes.measure(self._nodes[None]).sum())

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(T, 3) of all organs, counter-clockwise from outside (a copy)."""
        return self._triangles.copy()

    @property
    def tool_position(self) -> FloatArray:
        """(3,) of the first tool (a copy) [u]."""
        position: FloatArray = self._tool_positions[0].copy()
        return position

    @property
    def tool_orientation(self) -> FloatArray:
        """(4,) of the first tool, quaternion xyzw (a copy)."""
        orientation: FloatArray = self._tool_orientations[0].copy()
        return orientation

    @property
    def tool_positions(self) -> FloatArray:
        """(N, 3) of all tools (a copy) [u]."""
        return self._tool_positions.copy()

    @property
    def tool_orientations(self) -> FloatArray:
        """(N, 4) of all tools (a copy)."""
        return self._tool_orientations.copy()

    @property
    def tool_forces(self) -> FloatArray:
        """(N, 3) on all tools in the last step (a copy) [kg u/s2]."""
        return self._model.wrenches[:, :3].copy()

    @property
    def dt(self) -> float:
        """Length of a step [s]."""
        return self.scene.dt

    def __reduce__(self) -> Any:
        raise TypeError(NO_COPY.format(type(self).__name__))

    @property
    def time(self) -> float:
        """Since the reset [s]."""
        return self._time

    def _check_open(self) -> None:
        if self._closed:
            raise RuntimeError("this simulation is closed; make a new one")

    def _move_tools(self, linear: FloatArray, angular: FloatArray) -> Motions:
        positions, orientations = self._tool_positions, self._tool_orientations
        turned = orientations
        if any(map(any, angular.tolist())):
            turned = turned_by(orientations, angular, self.dt)
        return Motions(positions, orientations, positions + linear * self.dt, turned, linear, angular)

    def _advance(self, motions: Motions | None, *, respond: bool) -> None:
        """Step the organs and resolve contact with the ground and, if `respond`, with the tools."""
        try:
            nodes, velocities = self._world.step(self._nodes, self._velocities)
        except FloatingPointError:
            raise SimulationDiverged(f"positions are not finite after {self._time + self.dt:.4f} s") from None
        resolved = self._model.resolve(self._nodes, nodes, velocities, motions if respond else None)
        if motions is not None and not respond:
            self._model.observe(resolved[0], motions)
        self._nodes, self._velocities = resolved
        if self._volumes.inside_out(self._nodes[None]).any():
            raise SimulationDiverged(self._volumes.tell(self._volumes.measure(self._nodes[None])[0]))

    def _set_nodes(self, nodes: FloatArray, velocities: FloatArray) -> None:
        # Kernels take one type of array.
        self._nodes = np.array(nodes, dtype=np.float64, order="C")
        self._velocities = np.array(velocities, dtype=np.float64, order="C")
        self._world.set_state(self._nodes, self._velocities)

    def _settle(self) -> FloatArray:
        """Let the organs come to rest on the ground, and return where their nodes are then.

        Kinetic damping: whenever the kinetic energy has passed a maximum, all velocities are set to zero. That takes
        the energy out of every mode of motion near its passage through equilibrium, slow ones and fast ones alike.
        """
        masses = np.where(np.isfinite(self.node_masses), self.node_masses, 0.0)
        energy_before, speeds = 0.0, None
        for _ in range(math.ceil(LONGEST_SETTLING / self.dt)):
            try:
                self._advance(None, respond=True)
            except SimulationDiverged as error:
                raise SimulationDiverged(f"organs do not come to rest: {error}") from None
            energy = float(masses @ (self._velocities**2).sum(axis=1))
            if energy < energy_before:
                if np.abs(self._velocities).max() < SETTLED_SPEED:
                    break
                self._set_nodes(self._nodes, np.zeros_like(self._nodes))
                energy = 0.0
            energy_before = energy
        else:
            speeds = np.abs(self._velocities).max(axis=1)
        volumes = self._volumes.measure(self._nodes[None])[0]
        if self._volumes.collapsed(self._nodes[None]).any():
            raise SimulationDiverged(f"organs do not come to rest: {self._volumes.tell(volumes)}")
        warn_of_rest(self.scene, self._nodes, volumes, self._volumes.initial, speeds)
        return self._nodes


def _as_velocities(value: ArrayLike, name: str, shape: tuple[int, ...]) -> FloatArray:
    """A velocity for each tool (N, 3), from one for all (3,) or one for each."""
    try:
        array = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be numbers, got {value!r}") from error
    if array.shape not in ((3,), shape):
        raise ValueError(f"{name} must have shape (3,) or {shape}, got {array.shape}")
    if not all(map(math.isfinite, array.ravel().tolist())):
        raise ValueError(f"{name} must be finite, got {array.tolist()}")
    return array if array.ndim == 2 else array.reshape(1, 3).repeat(shape[0], axis=0) if shape[0] > 1 else array[None]
