"""What a task needs of physics: some worlds of one scene, moved on together by one control step at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from spatula_env.engines import choose_engine
from spatula_env.sim.drive import restrain
from spatula_env.sim.simulation import Simulation, SimulationDiverged

if TYPE_CHECKING:
    from spatula_env.scenes import Scene
    from spatula_env.sim.batch import BatchContactName
    from spatula_env.sim.simulation import ContactName, SimulationState

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Steer = Callable[[int, int], tuple[FloatArray, FloatArray]]
"""Tells for a world and a physics step of a control step how its tools are to move: linear (N, 3) [u/s] and angular
(N, 3) [rad/s] velocities, contiguous."""
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Loads:
    """What the tools felt during a control step of several physics steps, in scene units.

    Rows of worlds that have diverged hold zeros.

    Attributes:
        forces: (W, N, 3) on each of the N tools, averaged over the control step [kg u/s2].
        torques: (W, N, 3) about each tool's origin, averaged [kg u2/s2].
        peak_forces: (W, N) greatest magnitude of the force in a physics step [kg u/s2].
        flags: (W, n) for each tool: which of its n contact nodes are in contact with any organ at the end.
        penetrations: (W,) greatest depth of a contact node in the last physics step, before correction [u].
        residuals: (W,) greatest depth left after correction, as in `Report`, at most in any physics step [u].
        ground_forces: (W, 3) what the ground does to the organs, averaged [kg u/s2].
        peak_pressures: (W,) greatest contact pressure on a node of a tool in a physics step [kg/(u s2)]. Zero with
            `contact="bullet"`, where Bullet does not tell; so are the next three.
        mean_pressures: (W,) greatest of the tools' faces: normal force on it by its area, averaged over the control
            step [kg/(u s2)].
        overpressures: (W,) integral over time of what the greatest pressure exceeds the limit by [kg/(u s)].
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


class Worlds(Protocol):
    """W worlds of a scene with N tools and V nodes in all."""

    @property
    def scene(self) -> Scene:
        """The scene that all of them show."""

    @property
    def count(self) -> int:
        """W."""

    @property
    def nodes(self) -> FloatArray:
        """(W, V, 3) positions of the organs' nodes (a copy) [u]."""

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(T, 3) of all organs, counter-clockwise from outside (a copy)."""

    @property
    def tool_positions(self) -> FloatArray:
        """(W, N, 3) (a copy) [u]."""

    @property
    def tool_orientations(self) -> FloatArray:
        """(W, N, 4) quaternions xyzw (a copy)."""

    @property
    def times(self) -> FloatArray:
        """(W,) since each world's reset (a copy) [s]."""

    def nodes_of(self, worlds: IntArray) -> FloatArray:
        """(n, V, 3) positions of the organs' nodes in some worlds (n,), others not being looked at (a copy) [u]."""

    def times_of(self, worlds: IntArray) -> FloatArray:
        """(n,) since the reset of each of some worlds (n,), others not being looked at (a copy) [s]."""

    def reset(self, worlds: IntArray) -> None:
        """Start some worlds again: organs at rest, tools where the scene has them, no contact, time zero.

        Args:
            worlds: (n,) which.
        """

    def place_tools(self, positions: FloatArray, orientations: FloatArray, worlds: IntArray) -> None:
        """Put the tools of some worlds somewhere at once; flags are cleared and organs feel nothing of the way.

        Args:
            positions: (n, N, 3) [u].
            orientations: (n, N, 4) unit quaternions xyzw.
            worlds: (n,) which.
        """

    def vary(self, friction: FloatArray, tool_size: FloatArray, worlds: IntArray) -> None:
        """Change the tools of some worlds. Flags are cleared.

        Args:
            friction: (n,) factor on the scene's coefficients between tools and organs.
            tool_size: (n,) factor on the lengths of the scene's tools.
            worlds: (n,) which.
        """

    def advance(
        self,
        linear_velocities: FloatArray,
        angular_velocities: FloatArray,
        steps: int,
        pressure_limits: FloatArray | None = None,
        force_limits: FloatArray | None = None,
    ) -> Loads:
        """Move all worlds on by some physics steps, the tools moving with constant velocity.

        Args:
            linear_velocities: (W, N, 3) [u/s].
            angular_velocities: (W, N, 3) world frame [rad/s].
            steps: How many.
            pressure_limits: (W,) what overpressure is counted from [kg/(u s2)]; None: none is counted.
            force_limits: (W,) tools that have met more in a physics step do not push on in the next one, see
                `drive.restrain` [kg u/s2]; None: they always do.

        Returns:
            What the tools felt. A world that diverges leaves the others alone; it waits to be reset.
        """

    def save(self, worlds: IntArray) -> Any:
        """The state of some worlds, as arrays of its own; it can be pickled.

        Args:
            worlds: (n,) which.

        Returns:
            A `batch.BatchState` of n worlds, or n states of simulations.
        """

    def restore(self, state: Any, worlds: IntArray) -> None:
        """Go back to a saved state, of these worlds or of others with the same tools.

        Args:
            state: What `save` returned for n worlds.
            worlds: (n,) which worlds get it.

        Raises:
            ValueError: If it does not fit the scene or is not finite.
        """

    def close(self) -> None:
        """Free what the engine holds. Closing twice is allowed."""


class SeparateWorlds:
    """Simulations of one scene, stepped one after the other.

    Attributes:
        simulations: The W simulations.
    """

    def __init__(self, simulations: Sequence[Simulation]) -> None:
        """Take over simulations of one scene.

        Args:
            simulations: At least one; `close` closes them.
        """
        self.simulations = tuple(simulations)
        self._scene = self.simulations[0].scene
        self._diverged = np.zeros(len(self.simulations), dtype=np.bool_)

    @property
    def scene(self) -> Scene:
        """See `Worlds`; simulations may have got other tools since."""
        return self._scene

    @property
    def count(self) -> int:
        """See `Worlds`."""
        return len(self.simulations)

    @property
    def nodes(self) -> FloatArray:
        """See `Worlds`."""
        return np.stack([simulation.nodes for simulation in self.simulations])

    @property
    def triangles(self) -> NDArray[np.int32]:
        """See `Worlds`."""
        return self.simulations[0].triangles

    @property
    def tool_positions(self) -> FloatArray:
        """See `Worlds`."""
        return np.stack([simulation.tool_positions for simulation in self.simulations])

    @property
    def tool_orientations(self) -> FloatArray:
        """See `Worlds`."""
        return np.stack([simulation.tool_orientations for simulation in self.simulations])

    @property
    def times(self) -> FloatArray:
        """See `Worlds`."""
        return np.array([simulation.time for simulation in self.simulations])

    def nodes_of(self, worlds: IntArray) -> FloatArray:
        """See `Worlds`."""
        return np.stack([self.simulations[world].nodes for world in worlds.tolist()])

    def times_of(self, worlds: IntArray) -> FloatArray:
        """See `Worlds`."""
        return np.array([self.simulations[world].time for world in worlds.tolist()])

    def reset(self, worlds: IntArray) -> None:
        """See `Worlds`."""
        for world in worlds.tolist():
            self.simulations[world].reset()
            self._diverged[world] = False

    def place_tools(self, positions: FloatArray, orientations: FloatArray, worlds: IntArray) -> None:
        """See `Worlds`."""
        for row, world in enumerate(worlds.tolist()):
            for index, (position, orientation) in enumerate(zip(positions[row], orientations[row], strict=True)):
                self.simulations[world].place_tool(position, orientation, index=index)

    def vary(self, friction: FloatArray, tool_size: FloatArray, worlds: IntArray) -> None:
        """See `Worlds`."""
        for row, world in enumerate(worlds.tolist()):
            tools = tuple(
                replace(placed, tool=placed.tool.scaled(tool_size[row]), friction=placed.friction * friction[row])
                for placed in self.scene.tools
            )
            self.simulations[world].set_tools(tools)

    def advance(
        self,
        linear_velocities: FloatArray,
        angular_velocities: FloatArray,
        steps: int,
        pressure_limits: FloatArray | None = None,
        force_limits: FloatArray | None = None,
        steer: Steer | None = None,
    ) -> Loads:
        """See `Worlds`; with `steer` the velocities are asked anew before every physics step."""
        tools = self._scene.tools
        count = (self.count, len(tools))
        loads = Loads(
            forces=np.zeros((*count, 3)),
            torques=np.zeros((*count, 3)),
            peak_forces=np.zeros(count),
            flags=tuple(np.zeros((self.count, len(placed.tool.nodes)), dtype=np.bool_) for placed in tools),
            penetrations=np.zeros(self.count),
            residuals=np.zeros(self.count),
            ground_forces=np.zeros((self.count, 3)),
            peak_pressures=np.zeros(self.count),
            mean_pressures=np.zeros(self.count),
            overpressures=np.zeros(self.count),
            node_pressures=tuple(np.zeros((self.count, len(placed.tool.nodes))) for placed in tools),
            restrained=np.zeros(self.count),
            tangled=np.zeros(self.count, dtype=np.bool_),
            diverged=self._diverged,
        )
        endless = np.full(self.count, np.inf)
        pressure_limits = endless if pressure_limits is None else pressure_limits
        force_limits = endless if force_limits is None else force_limits
        for world in np.flatnonzero(~self._diverged).tolist():
            try:
                self._advance(
                    world,
                    linear_velocities[world],
                    angular_velocities[world],
                    steps,
                    pressure_limits[world],
                    force_limits[world],
                    loads,
                    steer,
                )
            except SimulationDiverged:
                self._diverged[world] = True
                for name, values in vars(loads).items():
                    if name != "diverged":
                        for array in values if isinstance(values, tuple) else (values,):
                            array[world] = 0
        return Loads(**{**vars(loads), "diverged": self._diverged.copy()})

    def _advance(
        self,
        world: int,
        asked_linear: FloatArray,
        asked_angular: FloatArray,
        steps: int,
        pressure_limit: float,
        force_limit: float,
        loads: Loads,
        steer: Steer | None,
    ) -> None:
        simulation = self.simulations[world]
        reports, pressures = [], []
        asked_linear, asked_angular = np.ascontiguousarray(asked_linear), np.ascontiguousarray(asked_angular)
        linear, angular = np.empty_like(asked_linear), np.empty_like(asked_angular)
        restrained = 0
        for step in range(steps):
            if steer is not None:
                asked_linear, asked_angular = steer(world, step)
            restrained += restrain(
                simulation.tool_positions,
                asked_linear,
                asked_angular,
                simulation.tool_forces,
                force_limit,
                linear,
                angular,
            )
            reports.append(simulation.step(linear, angular))
            pressures.append(simulation.pressures())
        # Reduced all at once: a little of NumPy after every step adds up.
        wrenches = np.array([report.loads for report in reports])
        mean = wrenches.mean(axis=0)
        loads.forces[world], loads.torques[world] = mean[:, :3], mean[:, 3:]
        loads.peak_forces[world] = np.sqrt((wrenches[:, :, :3] ** 2).sum(axis=2).max(axis=0))
        loads.ground_forces[world] = np.array([report.ground_force for report in reports]).mean(axis=0)
        loads.residuals[world] = max(report.residual for report in reports)
        peaks = np.array([pressure.peak for pressure in pressures])
        loads.peak_pressures[world] = peaks.max()
        loads.mean_pressures[world] = np.array([pressure.faces for pressure in pressures]).mean(axis=0).max()
        loads.overpressures[world] = np.maximum(peaks - pressure_limit, 0.0).sum() * simulation.dt
        loads.restrained[world] = restrained / steps
        report = reports[-1]
        loads.tangled[world] = report.tangled
        loads.penetrations[world] = report.penetration
        for flags, contacts in zip(loads.flags, report.all_contacts, strict=True):
            flags[world] = np.any([found.flags for found in contacts], axis=0)
        for on_nodes, last in zip(loads.node_pressures, pressures[-1].nodes, strict=True):
            on_nodes[world] = last

    def save(self, worlds: IntArray) -> tuple[SimulationState, ...]:
        """See `Worlds`."""
        return tuple(self.simulations[world].save() for world in worlds.tolist())

    def restore(self, state: tuple[SimulationState, ...], worlds: IntArray) -> None:
        """See `Worlds`."""
        for world, saved in zip(worlds.tolist(), state, strict=True):
            self.simulations[world].restore(saved)
            self._diverged[world] = False

    def close(self) -> None:
        """See `Worlds`."""
        for simulation in self.simulations:
            simulation.close()


def make_worlds(scene: Scene, count: int, engine: str | None = "batch", contact: ContactName = "flags") -> Worlds:
    """Load many worlds of a scene, all at rest.

    Args:
        scene: What is in each.
        count: How many.
        engine: "batch": all of them in compiled code, in step. "bullet": as many simulations with PyBullet. None: that
            of `Simulation`.
        contact: What resolves contact; see `Simulation`.

    Returns:
        The worlds.

    Raises:
        ValueError: If `engine` is not one of those, or `contact` is not one of the engine's.
        ImportError: If PyBullet is asked for and is not installed; says what to install.
    """
    engine = choose_engine(engine, contact)
    if engine == "batch":
        from spatula_env.sim.batch import BatchSimulation

        # It says itself what it does not have.
        return BatchSimulation(scene, count, contact=cast("BatchContactName", contact))
    simulations: list[Simulation] = []
    try:
        for _ in range(count):
            simulations.append(Simulation(scene, engine="bullet", contact=contact))
    except BaseException:
        for simulation in simulations:
            simulation.close()
        raise
    return SeparateWorlds(simulations)
