"""The Novint Falcon: a desktop haptic device with three motors, on a USB port.

`Falcon` is the driver. It implements the device's own byte protocol, so it needs only pyusb and no vendor library. The
parts fit together as follows::

    driver      Falcon, a TeleopDevice: opening, homing, reading, forces
    servo       one exchange with the device, a thousand times a second
    velocity    velocities from encoder counts
    firmware    loading the device's program
    protocol    the 16-byte packets
    kinematics  encoder counts <-> position, force <-> motor counts
    frames      the Falcon's frame <-> the device frame of this package
    ftdi        the chip between USB and the device's serial line
    transport   USB transfers

Sources, and which values are measured and which are not, are listed in ``docs/falcon.md``.
"""

from __future__ import annotations

from spatula_env.teleop.falcon.driver import Falcon

__all__ = ["Falcon"]
