"""Drives a simulation through motions that the tests of this folder share, and records the results."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

CLEARANCE = 0.3
"""How high above the organ a press begins [u]."""


@dataclass
class Record:
    """Record of a run, with one entry per step."""

    forces: list = field(default_factory=list)
    flags: list = field(default_factory=list)
    penetrations: list = field(default_factory=list)
    residuals: list = field(default_factory=list)
    given_and_taken: list = field(default_factory=list)
    """Sum of the impulses on the organ and on the tool, relative to the impulses' sizes; ideally zero."""
    torque_errors: list = field(default_factory=list)
    """Sum of the tool's angular impulse and the moment of the nodes' impulses, relative to the moments' sizes."""
    momentum_errors: list = field(default_factory=list)
    """Change of the organ's momentum less all impulses on it, relative to their sizes."""
    excess_energies: list = field(default_factory=list)
    """The organ's kinetic and potential energy, less the work that the tool has done so far."""
    work: float = 0.0


class Driver:
    """Steps a simulation of one organ and one tool, and records."""

    def __init__(self, simulation, record=None):
        self.simulation = simulation
        self.record = Record() if record is None else record
        self.masses = simulation.node_masses
        self.height = self._height()

    def _height(self):
        return float(self.masses @ self.simulation.nodes[:, 2])

    def step(self, linear=(0.0, 0.0, 0.0), angular=(0.0, 0.0, 0.0)):
        simulation, record, masses = self.simulation, self.record, self.masses
        dt, gravity = simulation.dt, simulation.scene.gravity
        weight = np.array([0.0, 0.0, -masses.sum() * gravity])
        before = masses @ simulation.node_velocities
        report = simulation.step(linear, angular)
        velocities = simulation.node_velocities
        impulses = report.nodal_impulses
        # A scale that is never zero, not even for a weightless organ that nothing touches.
        size = np.abs(impulses).sum() + masses.sum() * max(gravity, 1.0) * dt
        taken = impulses.sum(axis=0) + report.force * dt
        record.given_and_taken.append(np.abs(taken).max() / size)
        arms = simulation.nodes - simulation.tool_position
        moments = np.cross(arms, impulses)
        twist = moments.sum(axis=0) + report.torque * dt
        record.torque_errors.append(np.abs(twist).max() / (np.abs(moments).sum() + size))
        gained = masses @ velocities - before
        expected = impulses.sum(axis=0) + (report.ground_force + weight) * dt
        record.momentum_errors.append(np.abs(gained - expected).max() / size)
        record.work -= float(report.force @ np.asarray(linear) + report.torque @ np.asarray(angular)) * dt
        energy = 0.5 * float(masses @ (velocities**2).sum(axis=1)) + gravity * (self._height() - self.height)
        record.excess_energies.append(energy - record.work)
        record.forces.append(report.force)
        record.flags.append(report.contacts.flags)
        record.penetrations.append(report.penetration)
        record.residuals.append(report.residual)
        return report

    def to_height(self, height, speed):
        """Move the tool straight up or down until its origin is at a height."""
        simulation = self.simulation
        while abs(height - simulation.tool_position[2]) > 1e-9:
            way = height - simulation.tool_position[2]
            velocity = np.sign(way) * min(speed, abs(way) / simulation.dt)
            self.step((0.0, 0.0, velocity))

    def hold(self, seconds):
        for _ in range(round(seconds / self.simulation.dt)):
            self.step()


def start_above(simulation):
    """Reset, and put the tool above the organ's middle. Returns how high the organ is."""
    simulation.reset()
    top = simulation.nodes[:, 2].max()
    simulation.place_tool((0.0, 0.0, top + CLEARANCE + half_thickness(simulation)))
    return top


def half_thickness(simulation):
    return 0.5 * simulation.scene.tools[0].tool.size[2]


def press(simulation, depth, speed, seconds=0.0):
    """Press the organ of a fresh reset down by `depth` at a speed, hold, and return the driver."""
    top = start_above(simulation)
    driver = Driver(simulation)
    driver.to_height(top - depth + half_thickness(simulation), speed)
    driver.hold(seconds)
    return driver


def everything(simulation):
    """All that can be asked of a simulation's state, in one array."""
    return np.concatenate(
        [
            simulation.nodes.ravel(),
            simulation.node_velocities.ravel(),
            simulation.tool_positions.ravel(),
            simulation.tool_orientations.ravel(),
            [simulation.time],
        ]
    )
