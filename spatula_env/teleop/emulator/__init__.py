"""A Novint Falcon that exists in software only, down to the bytes on the USB.

`FalconEmulator` is what the cable leads to: an FTDI chip, a boot loader, firmware, three encoders and motors, a
mechanism, and a simulated hand that holds the grip. The driver talks to it through the same transfers as to the real
device. Nothing
here uses the driver's packets or kinematics, so that the two can be checked against each other::

    falcon     FalconEmulator: all parts, their time, the plug
    chip       the FTDI chip: control requests, baud rate, latency timer, status bytes
    boot       the boot loader and what firmware needs to get in
    program    what runs on the device afterwards: packets, homing
    legs       the mechanism, from vectors along its links
    hand       the operator's hand, and where the energy goes
    mechanism  weight, friction and bending links, on request
    faults     what can go wrong, for tests to switch on
    clock      simulated time
    wire       all of it in a process of its own, at the other end of a socket
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
