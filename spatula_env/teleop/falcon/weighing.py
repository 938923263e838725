"""Measure a Falcon's forces by a known weight, as the factor between counts and newtons was found by feel.

The motors hold the grip in place, first alone and then with a weight hung on it. The increase of the commanded force is
compared with the weight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from spatula_env.teleop.device import DeviceError
from spatula_env.teleop.falcon.driver import Falcon

GRAVITY = 9.81
"""Acceleration of gravity [m/s2]."""
STIFFNESS, DAMPING, INTEGRAL = 150.0, 4.0, 300.0
"""Gains of the controller that holds the grip [N/m], [N s/m], [N/(m s)]."""
GREATEST = 5.0
"""Greatest commanded force [N]."""
SETTLING, LOOKING = 2.0, 1.0
"""Time for the grip to settle, and time over which the force is averaged afterwards [s]."""
FARTHEST = 0.03
"""If the grip is farther than this from its initial position, it is not held [m]."""
LEAST_SHARE = 0.2
"""If the commanded force grows by less than this share of the weight, the motors do not bear it."""
LIGHTEST, HEAVIEST = 0.05, 0.4
"""Range of weights that are heavy enough to measure and that the motors can bear in addition to the grip [kg]."""
REQUEST = "Hold the grip in the middle of its range, level, and let go of it slowly when it bears itself."
HANG = "Hang the weight of {grams:g} g to the grip now, and let it come to rest. Ready?"


@dataclass(frozen=True)
class Weighing:
    """The result of weighing.

    Attributes:
        grip: Commanded force that bears the grip alone [N].
        loaded: Commanded force that bears the grip with the weight [N].
        factor: Ratio of actual to commanded forces.
    """

    grip: float
    loaded: float
    factor: float


def weigh(falcon: Falcon, mass: float, say: Callable[[str], None], ask: Callable[[str], bool]) -> Weighing:
    """Measure the ratio of actual to commanded forces.

    Args:
        falcon: The device, open and homed.
        mass: Mass of the weight, 0.05 to 0.4 kg.
        say: Receives a message for the operator.
        ask: Receives a question for the operator; returning False ends the weighing.

    Returns:
        The result.

    Raises:
        ValueError: If the mass is out of its range.
        DeviceError: If the grip was not held, or if the operator did not want to go on.
    """
    if not LIGHTEST <= mass <= HEAVIEST:
        raise ValueError(f"mass must be {LIGHTEST:g} to {HEAVIEST:g} kg, got {mass!r}")
    say(REQUEST)
    alone = _hold(falcon, 0.0)
    if not ask(HANG.format(grams=1e3 * mass)):
        raise DeviceError("the weighing was ended before the weight was hung to the grip")
    loaded = _hold(falcon, alone)
    if loaded - alone < LEAST_SHARE * mass * GRAVITY:
        raise DeviceError(f"the motors bear no more with the weight ({loaded:.2f} N) than without ({alone:.2f} N)")
    return Weighing(alone, loaded, mass * GRAVITY / (loaded - alone))


def _hold(falcon: Falcon, force: float) -> float:
    """Hold the grip in place; return the mean upward force commanded at the end [N]."""
    place = falcon.read().position
    assert place is not None
    goal, last = float(place[2]), falcon.now()
    start, total, count = last, 0.0, 0
    try:
        while falcon.now() - start < SETTLING + LOOKING:
            falcon.wait_for_sample()
            sample = falcon.read()
            assert sample.position is not None
            now = falcon.now()
            away = goal - float(sample.position[2])
            if abs(away) > FARTHEST:
                raise DeviceError(f"the grip is {1e3 * abs(away):.0f} mm from where it was: it is not held")
            force = min(GREATEST, max(0.0, force + INTEGRAL * away * (now - last)))
            last = now
            asked = min(GREATEST, max(0.0, force + STIFFNESS * away - DAMPING * float(sample.velocity[2])))
            falcon.send_force((0.0, 0.0, asked))
            if now - start > SETTLING:
                total, count = total + asked, count + 1
    finally:
        falcon.send_force((0.0, 0.0, 0.0))
    return total / max(1, count)
