"""Time stepping: engines that integrate the organs, and the simulation that couples them with tools."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from spatula_env._warnings import SceneWarning
from spatula_env.sim.report import Report
from spatula_env.sim.simulation import Simulation, SimulationDiverged, SimulationState

if TYPE_CHECKING:
    from spatula_env.sim.calibration import calibrated

__all__ = ["Report", "SceneWarning", "Simulation", "SimulationDiverged", "SimulationState", "calibrated"]


def __getattr__(name: str) -> Any:
    """Import `calibrated`, and with it the batch engine, when it is first asked for."""
    if name == "calibrated":
        from spatula_env.sim.calibration import calibrated

        return calibrated
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
