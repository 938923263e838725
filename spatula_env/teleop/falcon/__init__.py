"""The Novint Falcon: a desktop haptic device with three motors, on a USB port.

`Falcon` is the driver. It speaks the device's own bytes, so it needs pyusb and nothing else; no vendor's library. How
the
parts fit together::

    driver      Falcon, a TeleopDevice: opening, homing, reading, forces
    servo       one exchange with the device, a thousand times a second
    velocity    velocities from encoder counts
    firmware    loading the device's program
    protocol    the 16-byte packets
    kinematics  encoder counts <-> position, force <-> motor counts
    frames      the Falcon's frame <-> the device frame of this package
    ftdi        the chip between USB and the device's serial line
    transport   USB transfers

Where the facts come from, what is measured and what is not: ``docs/falcon.md``.
"""

from __future__ import annotations

from spatula_env.teleop.falcon.driver import Falcon

__all__ = ["Falcon"]
