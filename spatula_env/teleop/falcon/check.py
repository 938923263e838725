"""Check step by step whether a Falcon works, with results in plain words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from spatula_env.teleop.device import DeviceError, FloatArray, limit_force
from spatula_env.teleop.falcon.driver import Falcon
from spatula_env.teleop.falcon.servo import PERIOD
from spatula_env.teleop.falcon.transport import find_falcons

Say = Callable[[str], None]
Ask = Callable[[str], bool]

LISTENING_TIME = 0.5
"""Time over which packets are counted [s]."""
LEAST_SHARE = 0.5
"""Least share of packets answered, relative to the number possible at 1 kHz."""

FAR_ENOUGH_MOVED = 0.015
"""Least distance that the operator has to move the grip for its direction to be judged [m]."""
LEAST_ALONG = 0.7
"""Least component of that motion in the requested direction, as a share of the distance moved."""
STILL = 0.002
STILL_TIME = 0.3
"""The grip counts as still when it has moved less than the first [m] for as long as the second [s]."""
PATIENCE = 20.0
"""Time that the operator has for each move [s]."""
MIDDLE_REQUEST = "Bring the grip to about the middle of its range, and hold it still."
MOVES = (
    ("Move the grip 2 cm to the right.", (1.0, 0.0, 0.0)),
    ("Move the grip 2 cm away from you.", (0.0, 1.0, 0.0)),
    ("Move the grip 2 cm up.", (0.0, 0.0, 1.0)),
)

TEST_FORCE = 1.0
"""Force of the gentle test, about the weight of an apple [N]."""
TEST_RISE = 0.2
TEST_DURATION = 0.6
"""Rise time of the force, and its total duration [s]."""
TEST_DAMPING = 10.0
"""Damping that keeps a grip that is not held from speeding up [N s/m]."""
GREATEST_TEST_FORCE = 1.5
"""Greatest force in the test, damping included, as the hand may be moving fast [N]."""
FAR_ENOUGH = 0.010
"""A push ends when the grip has moved this far [m]."""
LEAST_MOTION = 0.0005
"""Least motion that counts as a reaction to a push [m]."""
REST = 0.3
"""Pause between two pushes [s]."""

PUSHES = (
    ("to the right", (1.0, 0.0, 0.0)),
    ("to the left", (-1.0, 0.0, 0.0)),
    ("away from you", (0.0, 1.0, 0.0)),
    ("towards you", (0.0, -1.0, 0.0)),
    ("up", (0.0, 0.0, 1.0)),
    ("down", (0.0, 0.0, -1.0)),
)
CONSENT = (
    f"May the Falcon push your hand gently, with {TEST_FORCE:g} N, six times? Hold the grip loosely, "
    "in the middle of its range."
)


@dataclass(frozen=True)
class CheckStep:
    """One step of the check.

    Attributes:
        name: ``"found"``, ``"firmware"``, ``"packets"``, ``"homed"``, ``"frames"`` or ``"force"``.
        passed: Whether it passed; None if it was left out.
        message: The result, for the operator.
    """

    name: str
    passed: bool | None
    message: str


def check_falcon(
    falcon: Falcon,
    say: Say,
    ask: Ask,
    find: Callable[[], Sequence[object]] | None = find_falcons,
    patience: float = PATIENCE,
) -> list[CheckStep]:
    """Check a Falcon from the cable to the motors, stopping after the first step that fails.

    Args:
        falcon: The device, not open yet; it is closed at the end.
        say: Receives messages for the operator.
        ask: Receives a question for the operator and returns whether the answer was yes. Without a yes, no motor moves.
        find: Lists the devices on the USB; None to leave that step out.
        patience: Time that the operator has for each requested move of the grip [s].

    Returns:
        Results of the steps that were carried out.
    """
    steps: list[CheckStep] = []

    def make(name: str, step: Callable[[], tuple[bool | None, str]]) -> bool:
        try:
            passed, message = step()
        except (DeviceError, ImportError) as error:
            passed, message = False, str(error)
        steps.append(CheckStep(name, passed, message))
        say(f"{'skipped' if passed is None else 'ok' if passed else 'FAILED'}: {message}")
        return passed is not False

    try:
        if find is not None and not make("found", lambda: _look(find())):
            return steps
        _ = (
            make("firmware", lambda: _open(falcon))
            and make("packets", lambda: _listen(falcon))
            and make("homed", lambda: _home(falcon, say))
            and make("frames", lambda: _look_at_frames(falcon, say, patience))
            and make("force", lambda: _push(falcon, say, ask))
        )
    finally:
        falcon.close()
    return steps


def _look(found: Sequence[object]) -> tuple[bool, str]:
    if not found:
        return False, "no Novint Falcon on the USB; check the cable and the power supply"
    return True, f"found {', '.join(map(str, found))}"


def _open(falcon: Falcon) -> tuple[bool, str]:
    falcon.open()
    return True, f"the {falcon.name} is open and its firmware runs"


def _listen(falcon: Falcon) -> tuple[bool, str]:
    first = falcon.state()
    until = falcon.now() + LISTENING_TIME
    while falcon.now() < until:
        falcon.wait_for_sample()
    last = falcon.state()
    rate = (last.sequence - first.sequence) / max(last.time - first.time, PERIOD)
    statistics = falcon.statistics()
    message = (
        f"{rate:.0f} packets/s; 99 of 100 came within {1000.0 * statistics.late_period:.1f} ms, all within "
        f"{1000.0 * statistics.longest_period:.1f} ms; {statistics.missed} not answered, "
        f"{statistics.discarded_bytes} bytes of noise"
    )
    if rate * PERIOD < LEAST_SHARE:
        return False, f"too few packets: {message}. Is the machine busy, or the Falcon behind a USB hub?"
    return True, message


def _home(falcon: Falcon, say: Say) -> tuple[bool, str]:
    falcon.calibrate(say)
    x, y, z = (1000.0 * value for value in _position(falcon).tolist())
    return True, f"homed; the grip is {x:.1f} mm right of the middle, {y:.1f} mm beyond it, {z:.1f} mm above it"


def _look_at_frames(falcon: Falcon, say: Say, patience: float) -> tuple[bool | None, str]:
    """Check whether the grip's measured motion agrees with the motion that the operator was asked to make."""
    told = []
    say(MIDDLE_REQUEST)
    for request, direction in MOVES:
        if not _wait_until_still(falcon, patience):
            return None, f"the grip was not still within {patience:g} s; directions were not checked"
        say(request)
        origin, until = _position(falcon), falcon.now() + patience
        moved = np.zeros(3)
        while (distance := float(np.linalg.norm(moved))) < FAR_ENOUGH_MOVED:
            if falcon.now() >= until:
                return None, f"the grip was not moved within {patience:g} s; directions were not checked"
            falcon.wait_for_sample()
            moved = _position(falcon) - origin
        x, y, z = (1000.0 * moved).tolist()
        told.append(f"{x:.0f}, {y:.0f}, {z:.0f} mm")
        if float(moved @ np.array(direction)) < LEAST_ALONG * distance:
            return False, (
                f"asked to: {request.lower()[:-1]!r}, and saw it move {told[-1]} (right, away, up). If it was moved as "
                "asked, stand the Falcon upright, with the grip towards you"
            )
    return True, f"directions are right: {'; '.join(told)} (right, away, up)"


def _wait_until_still(falcon: Falcon, patience: float) -> bool:
    """Wait until the grip is held still; False if it does not come to rest in time."""
    until = falcon.now() + patience
    place, since = _position(falcon), falcon.now()
    while falcon.now() - since < STILL_TIME:
        if falcon.now() >= until:
            return False
        falcon.wait_for_sample()
        position = _position(falcon)
        if float(np.linalg.norm(position - place)) > STILL:
            place, since = position, falcon.now()
    return True


def _push(falcon: Falcon, say: Say, ask: Ask) -> tuple[bool | None, str]:
    if not ask(CONSENT):
        return None, "no force was tried"
    weak = []
    moved = []
    for label, direction in PUSHES:
        say(f"Pushing {label}.")
        distance = _push_once(falcon, np.array(direction))
        moved.append(f"{label} {1000.0 * distance:.1f} mm")
        if distance < LEAST_MOTION:
            weak.append(label)
        _rest(falcon)
    message = f"the grip moved {', '.join(moved)}"
    if weak:
        return False, (
            f"not pushed {', '.join(weak)}: {message}. Was the grip held tight? Otherwise check the power supply, "
            "and that it was homed by pulling and pushing all the way"
        )
    return True, message


def _push_once(falcon: Falcon, direction: FloatArray) -> float:
    """Push the grip until it has moved far enough or the time is over.

    Returns:
        How far it moved in that direction [m].
    """
    start = falcon.now()
    origin = _position(falcon)
    distance = 0.0
    try:
        while (elapsed := falcon.now() - start) < TEST_DURATION and distance < FAR_ENOUGH:
            sample = falcon.read()
            assert sample.position is not None
            distance = float((sample.position - origin) @ direction)
            strength = TEST_FORCE * min(1.0, elapsed / TEST_RISE)
            force = strength * direction - TEST_DAMPING * sample.velocity
            falcon.send_force(limit_force(force, GREATEST_TEST_FORCE))
            falcon.wait_for_sample()
    finally:
        falcon.send_force(np.zeros(3))
    return distance


def _rest(falcon: Falcon) -> None:
    until = falcon.now() + REST
    while falcon.now() < until:
        falcon.wait_for_sample()


def _position(falcon: Falcon) -> FloatArray:
    position = falcon.read().position
    assert position is not None
    return position
