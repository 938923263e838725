"""A Novint Falcon emulated in software, down to the bytes on the USB.

`FalconEmulator` stands for everything at the far end of the cable: an FTDI chip, a boot loader, firmware, three
encoders and motors, a mechanism, and a simulated hand that holds the grip. The driver talks to it through the same
transfers as to the real device. Nothing here uses the driver's packets or kinematics, so that the two implementations
can be checked against each other::

    falcon     FalconEmulator: puts all parts together in time, and can be unplugged
    chip       the FTDI chip: control requests, baud rate, latency timer, status bytes
        boot       the boot loader and the conditions under which it accepts firmware
        program    the firmware that runs afterwards: packets, homing
        legs       the mechanism, computed from vectors along its links
        hand       the operator's hand, and an account of energy
        mechanism  weight, friction and elastic links; optional
        faults     failures that tests can switch on
    clock      simulated time
        wire       the whole emulator in a process of its own, at the other end of a socket
"""

from __future__ import annotations

from spatula_env.teleop.emulator.clock import Clock, RealClock, SimulatedClock
from spatula_env.teleop.emulator.falcon import EmulatedTransport, FalconEmulator
from spatula_env.teleop.emulator.faults import Faults, cut_short, lose_bytes, with_garbage
from spatula_env.teleop.emulator.hand import ElasticHand, Energies, GuidedHand, Hand, homing_motion
from spatula_env.teleop.emulator.mechanism import HandOnMechanism, Mechanism

__all__ = [
    "Clock",
    "ElasticHand",
    "EmulatedTransport",
    "Energies",
    "FalconEmulator",
    "Faults",
    "GuidedHand",
    "Hand",
    "HandOnMechanism",
    "Mechanism",
    "RealClock",
    "SimulatedClock",
    "cut_short",
    "homing_motion",
    "lose_bytes",
    "with_garbage",
]
