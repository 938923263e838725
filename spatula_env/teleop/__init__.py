"""Teleoperation: hand-held devices that move the tool; some of them also render the tool's forces to the hand.

Every device is a :class:`TeleopDevice`. Importing this package loads neither drivers nor device libraries.
"""

from __future__ import annotations

from spatula_env.teleop.device import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceSample,
    FirmwareError,
    NotCalibrated,
    TeleopDevice,
)

__all__ = [
    "DeviceBusy",
    "DeviceError",
    "DeviceLost",
    "DeviceNotFound",
    "DeviceSample",
    "FirmwareError",
    "NotCalibrated",
    "TeleopDevice",
]
