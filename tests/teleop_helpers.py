"""Devices that do as they are told, for tests."""

from __future__ import annotations

import numpy as np

from spatula_env.teleop import DeviceError, DeviceLost, DeviceSample, TeleopDevice


class Puppet(TeleopDevice):
    """A device whose position or rate, buttons and failures are set by a test; it records the forces."""

    def __init__(self, kind="position", has_force=False):
        self.name = "puppet"
        self.kind = kind
        self.has_force = has_force
        self.workspace_low, self.workspace_high = np.full(3, -0.04), np.full(3, 0.04)
        self.value = np.zeros(3)
        self.velocity = np.zeros(3)
        self.buttons = frozenset()
        self.extras = {}
        self.lost = False
        self.forces = []
        self._open = True
        self._count = 0

    @property
    def is_open(self):
        return self._open

    def open(self):
        self._open = True

    def close(self):
        self._open = False

    def now(self):
        return 0.0

    def read(self):
        self._check()
        self._count += 1
        position = self.value if self.kind == "position" else None
        rate = self.value if self.kind == "rate" else None
        return DeviceSample(self.kind, 0.0, self._count, position, rate, self.velocity, frozenset(self.buttons))

    def send_force(self, force):
        super().send_force(force)
        self._check()
        self.forces.append(np.array(force))

    def _check(self):
        if self.lost:
            raise DeviceLost("the puppet does not answer any more")
        if not self._open:
            raise DeviceError("the puppet is not open")


class SixPuppet(Puppet):
    """One with more than three rates."""

    def extra_rates(self):
        return self.extras
