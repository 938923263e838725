"""Teleoperation: hand-held devices that move the tool and, some of them, let the hand feel what the tool feels.

Every device is a :class:`TeleopDevice`. Importing this package loads no driver and no library of any device.
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
