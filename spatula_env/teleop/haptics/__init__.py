"""What lets the hand feel what the tool feels.

Modules::

device         HapticDevice: a device with its loop
settings       the gains
rendering      from contact to force, by
local_contact  the organ between two physics steps
passivity      the account of energy
heartbeat      whether the simulation goes on, and how fast
loop           once a millisecond
histogram      of its periods
runner         the loop in this process
remote         the loop in a process of its own
board          shared memory between the two
tap            what the tool feels, from every physics step of an environment
"""

from __future__ import annotations

from spatula_env.teleop.haptics.contact import Contact, LoopStatistics
from spatula_env.teleop.haptics.device import HapticDevice
from spatula_env.teleop.haptics.settings import HapticSettings

__all__ = ["Contact", "HapticDevice", "HapticSettings", "LoopStatistics"]
