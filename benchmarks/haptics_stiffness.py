"""The greatest stiffness with which a hand is stable: the force renderer alone, on an organ that is a massless spring.

The tool follows the hand at a given rate and with an additional delay, no faster than 0.1 m/s; the encoders have steps
of 0.04 mm. The hand leans on the organ, is kicked, and has to be still again within a quarter of a millimetre. The
energy limit is in effect switched off, as it would hide an instability by softening the contact.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import replace

from benchmarks.haptics_closed_loop import HANDS, HandModel
from spatula_env.teleop.haptics import Contact, HapticSettings
from spatula_env.teleop.haptics.rendering import ForceRenderer

RATES = (240.0, 60.0, 20.0)
"""Rates at which the tool follows the hand [Hz]."""
DELAYS = (0.0, 0.01, 0.05)
"""Additional delays until the renderer learns of the tool and its force [s]."""
MOST = 3000.0
"""A Falcon's own limit [N/m]."""
STEP = 1e-3
"""Period of the loop and of the integration [s]."""
ENCODER = 4e-5
"""Step of the encoders, as a position [m]."""
TOOL_SPEED = 0.1
"""Greatest speed of the tool [m/s]."""
LEAN, KICK = 1.0, 0.05
"""Force with which the hand leans on the organ [N], and change of its velocity by the kick [m/s]."""
SECONDS, KICKED, LOOKED = 4.0, 1.5, 3.2
"""Duration of a trial, time of the kick, and time from which on the hand has to be still [s]."""
STILL = 2.5e-4
"""Greatest peak-to-peak motion of a hand that counts as still [m]."""
GAINS = HapticSettings(energy_allowance=1e3, slew=1e4)
"""Settings whose limits on energy and rate of change of force are too wide to take effect."""


def table(hands: Iterable[str] = tuple(HANDS)) -> dict[str, dict[str, float]]:
    """The greatest stable stiffness by hand, rate and delay [N/m]."""
    return {
        hand: {
            f"{rate:g} Hz, {1e3 * delay:g} ms": greatest_stiffness(HANDS[hand], rate, delay)
            for rate in RATES
            for delay in DELAYS
        }
        for hand in hands
    }


def greatest_stiffness(hand: HandModel, rate: float, delay: float) -> float:
    """The greatest stable stiffness, by bisection of its logarithm to 5 %, between 10 N/m and `MOST` [N/m]."""
    low, high = 10.0, MOST
    if is_stable(hand, high, rate, delay):
        return high
    while high > 1.05 * low:
        middle = math.sqrt(low * high)
        if is_stable(hand, middle, rate, delay):
            low = middle
        else:
            high = middle
    return low


def is_stable(hand: HandModel, stiffness: float, rate: float, delay: float) -> bool:
    """Simulate a trial: whether the hand is still again after the kick."""
    renderer = ForceRenderer(replace(GAINS, longest_stall=0.3, stall_time=0.3), 8.0, MOST, 20.0)
    depth = LEAN / stiffness
    target = -depth - LEAN / hand.stiffness
    place, speed, force = -depth, 0.0, LEAN
    tool, told = place, deque([(place, LEAN)] * (1 + round(delay / STEP)))
    heights: list[float] = []
    seen = [round(place / ENCODER) * ENCODER] * 4
    next_step, beat = 0.0, 0.0
    for index in range(round(SECONDS / STEP)):
        now = index * STEP
        if index == round(KICKED / STEP):
            speed += KICK
        seen = [*seen[1:], round(place / ENCODER) * ENCODER]
        if now >= next_step - 1e-9:
            next_step += 1.0 / rate
            beat = now
            most = TOOL_SPEED / rate
            tool += min(most, max(-most, seen[-1] - tool))
        told.append((tool, stiffness * max(0.0, -tool)))
        there, pushed = told.popleft()
        velocity = (seen[-1] - seen[0]) / (3.0 * STEP)
        contact = Contact(beat, (0.0, 0.0, there), (0.0, 0.0, pushed))
        felt = renderer.step(now, (0.0, 0.0, seen[-1]), (0.0, 0.0, velocity), contact)[2]
        # A computed force acts from the next packet on.
        acceleration = (force + hand.stiffness * (target - place) - hand.damping * speed) / hand.mass
        speed += STEP * acceleration
        place += STEP * speed
        force = felt
        if now >= LOOKED:
            heights.append(place)
        if abs(place) > 0.2:
            return False
    return max(heights) - min(heights) < STILL
