"""A ledger of momentum and energy, kept while a tool works on an organ."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env import Simulation
    from spatula_env.arrays import FloatArray
    from spatula_env.sim import Report


class Ledger:
    """Steps a simulation of one tool and of organs without fixed nodes, and balances what they exchange.

    Attributes:
        simulation: The simulation.
        work: Work of the tool on the organs since the start [kg u2/s2].
        greatest_work: Greatest value that `work` has had [kg u2/s2].
        excess: Greatest amount by which the organs' kinetic energy plus gain in potential energy has exceeded the work
            done until then [kg u2/s2]. The energy of the springs is not available. It would only add to the organs'
            energy, so that, but for what the springs stored at the start, an excess is energy from nothing.
        exchange_error: Greatest difference between what the tool gave and what the organs' nodes received in a step, in
            impulse and moment, relative to the sum of the impulses' (moments') sizes.
        momentum_error: Greatest difference between the change of the organs' momentum in a step and the impulses of
            tool, ground and gravity, relative to the sum of the impulses' sizes.
        forces: Force on the tool in each step [kg u/s2].
    """

    def __init__(self, simulation: Simulation) -> None:
        """Begin at the present state, with all sums at zero."""
        self.simulation = simulation
        self.work = 0.0
        self.greatest_work = 0.0
        self.excess = 0.0
        self.exchange_error = 0.0
        self.momentum_error = 0.0
        self.forces: list[FloatArray] = []
        self._masses = simulation.node_masses
        self._start = self._height_energy()

    def step(self, linear: ArrayLike = (0.0, 0.0, 0.0), angular: ArrayLike = (0.0, 0.0, 0.0)) -> Report:
        """Make one physics step with the tool at these velocities, and record it.

        Args:
            linear: (3,) [u/s].
            angular: (3,) [rad/s].

        Returns:
            The simulation's report.
        """
        simulation, masses = self.simulation, self._masses
        dt, gravity = simulation.dt, simulation.scene.gravity
        momentum = masses @ simulation.node_velocities
        report = simulation.step(linear, angular)
        nodes, velocities, impulses = simulation.nodes, simulation.node_velocities, report.nodal_impulses
        # The weight keeps the scale above zero when nothing is touched; without gravity, an acceleration of 1 does.
        size = float(np.abs(impulses).sum() + masses.sum() * max(abs(gravity), 1.0) * dt)
        difference = impulses.sum(axis=0) + report.force * dt
        moments = np.cross(nodes - simulation.tool_position, impulses)
        twist = moments.sum(axis=0) + report.torque * dt
        self.exchange_error = max(
            self.exchange_error,
            float(np.abs(difference).max()) / size,
            float(np.abs(twist).max()) / (float(np.abs(moments).sum()) + size),
        )
        weight = np.array([0.0, 0.0, -masses.sum() * gravity])
        gained = masses @ velocities - momentum
        expected = impulses.sum(axis=0) + (report.ground_force + weight) * dt
        self.momentum_error = max(self.momentum_error, float(np.abs(gained - expected).max()) / size)
        self.work -= float(report.force @ np.asarray(linear) + report.torque @ np.asarray(angular)) * dt
        self.greatest_work = max(self.greatest_work, self.work)
        kinetic = 0.5 * float(masses @ (velocities**2).sum(axis=1))
        self.excess = max(self.excess, kinetic + self._height_energy() - self._start - self.work)
        self.forces.append(report.force)
        return report

    def move_to(self, height: float, speed: float) -> None:
        """Move the tool straight up or down until its origin is at `height` [u], at most at `speed` [u/s]."""
        simulation = self.simulation
        while abs(height - simulation.tool_position[2]) > 1e-9:
            way = height - simulation.tool_position[2]
            self.step((0.0, 0.0, float(np.sign(way)) * min(speed, abs(way) / simulation.dt)))

    def hold(self, seconds: float) -> None:
        """Let time pass, the tool at rest."""
        for _ in range(round(seconds / self.simulation.dt)):
            self.step()

    def mean_force(self, seconds: float) -> FloatArray:
        """(3,) mean force on the tool over the last steps [kg u/s2].

        Args:
            seconds: Length of the time to average over, up to now [s].
        """
        mean: FloatArray = np.mean(self.forces[-max(round(seconds / self.simulation.dt), 1) :], axis=0)
        return mean

    def _height_energy(self) -> float:
        return self.simulation.scene.gravity * float(self._masses @ self.simulation.nodes[:, 2])
