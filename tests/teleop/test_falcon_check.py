from __future__ import annotations

from falcon_helpers import held_at, make_driver

from spatula_env.teleop.emulator import ElasticHand, FalconEmulator, homing_motion
from spatula_env.teleop.falcon.check import CONSENT, MOVES, check_falcon

HOMING = homing_motion(start=0.6, duration=0.5)


class Operator:
    """Where the hand wants to be: homing first, then where a test says, Falcon's frame."""

    def __init__(self):
        self.offset = [0.0, 0.0, 0.0]

    def __call__(self, time):
        return tuple(place + moved for place, moved in zip(HOMING(time), self.offset, strict=True))


def run(emulator, answer=True, find=None, obey=None, **options):
    asked = []

    class Said(list):
        def append(self, text):
            super().append(text)
            if obey is not None:
                obey(text)

    said = Said()

    def ask(question):
        asked.append(question)
        return answer

    driver = make_driver(emulator, **{"homing_timeout": 2.0, **options})
    steps = check_falcon(driver, said.append, ask, find, patience=1.5)
    return {step.name: step for step in steps}, said, asked


def test_everything_works():
    operator = Operator()
    emulator = FalconEmulator(ElasticHand(operator))
    greatest = 0.0
    # The Falcon's frame: x to the right, y up, z towards the operator.
    ways = dict(zip((request for request, _ in MOVES), ((0, 0.02), (2, -0.02), (1, 0.02)), strict=True))

    def obey(text):
        if text in ways:
            axis, way = ways[text]
            operator.offset[axis] += way

    advance = emulator.hand.advance

    def watched(time, step, force):
        nonlocal greatest
        greatest = max(greatest, sum(value * value for value in force) ** 0.5)
        advance(time, step, force)

    emulator.hand.advance = watched
    steps, said, asked = run(emulator, find=lambda: ["a Falcon"], obey=obey)
    assert list(steps) == ["found", "firmware", "packets", "homed", "frames", "force"]
    assert all(step.passed for step in steps.values())
    assert steps["packets"].message.startswith("1000 packets/s")
    assert asked == [CONSENT]
    # Gentle, though the hand comes fast from the homing. The motors hold a millisecond while it moves on.
    assert 0.9 < greatest < 1.6
    assert "Pull the grip all the way out towards you, then push it all the way in." in said
    assert emulator.owner is None


def test_a_direction_that_is_wrong():
    operator = Operator()

    def obey(text):
        if text == MOVES[0][0]:
            # Asked to move it to the right, as seen by somebody behind the Falcon.
            operator.offset[0] -= 0.02

    steps, _, asked = run(FalconEmulator(ElasticHand(operator)), obey=obey)
    assert list(steps)[-1] == "frames"
    assert steps["frames"].passed is False
    assert "to the right" in steps["frames"].message
    assert not asked


def test_without_consent_no_motor_moves():
    emulator = FalconEmulator(ElasticHand(HOMING))
    steps, _, _ = run(emulator, answer=False)
    assert steps["force"].passed is None
    assert steps["frames"].passed is None
    assert "not moved within 1.5 s" in steps["frames"].message
    assert {counts for _, counts in emulator.motor_history} == {(0, 0, 0)}


def test_motors_without_power():
    emulator = FalconEmulator(ElasticHand(HOMING))
    emulator.faults.motor_limit = 0
    steps, _, _ = run(emulator)
    assert steps["force"].passed is False
    assert "to the right" in steps["force"].message


def test_the_first_failure_is_the_last_step():
    steps, said, _ = run(FalconEmulator(), find=lambda: [])
    assert [(step.name, step.passed) for step in steps.values()] == [("found", False)]
    assert said[-1].startswith("FAILED: no Novint Falcon")

    steps, _, _ = run(FalconEmulator(loaded=False))
    assert list(steps) == ["firmware"]
    assert "firmware" in steps["firmware"].message

    steps, _, _ = run(FalconEmulator(held_at((0.0, 0.0, 0.12))), homing_timeout=0.1)
    assert list(steps) == ["firmware", "packets", "homed"]
    assert "not homed within 0.1 s" in steps["homed"].message


def test_a_missing_library_is_a_step_that_failed():
    def find():
        raise ImportError("pip install 'spatula-env[teleop]'")

    steps, _, _ = run(FalconEmulator(), find=find)
    assert "pip install" in steps["found"].message


def test_too_few_packets():
    emulator = FalconEmulator(homed=True)
    emulator.faults.reply_delay = 0.004
    steps, _, _ = run(emulator)
    assert steps["packets"].passed is False
    assert "too few" in steps["packets"].message
