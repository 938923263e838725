"""Time stepping: engines that integrate the organs, and the simulation that couples them with tools."""

from __future__ import annotations

from spatula_env._warnings import SceneWarning
from spatula_env.sim.report import Report
from spatula_env.sim.simulation import Simulation, SimulationDiverged, SimulationState

__all__ = ["Report", "SceneWarning", "Simulation", "SimulationDiverged", "SimulationState"]
