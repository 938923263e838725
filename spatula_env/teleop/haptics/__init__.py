"""Haptic feedback: renders what the tool feels to the operator's hand.

Modules::

device         HapticDevice: a device together with its loop
settings       gains and limits
rendering      converts contact to force, using
local_contact  a model of the organ between two physics steps
passivity      an energy account
heartbeat      whether the simulation is running, and how fast
loop           the loop, one cycle per millisecond
histogram      statistics of its periods
runner         runs the loop in this process
remote         runs the loop in a process of its own
board          shared memory between the two processes
tap            reads what the tool feels after every physics step of an environment
"""

from __future__ import annotations

from spatula_env.teleop.haptics.contact import Contact, LoopStatistics
from spatula_env.teleop.haptics.device import HapticDevice
from spatula_env.teleop.haptics.settings import HapticSettings

__all__ = ["Contact", "HapticDevice", "HapticSettings", "LoopStatistics"]
