from __future__ import annotations

import math
import subprocess
import sys
import threading

import numpy as np
import pytest
from falcon_helpers import MIDDLE, exchange_for, held_at, make_driver, open_homed, workspace_points
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.teleop import DeviceError, NotCalibrated
from spatula_env.teleop.emulator import ElasticHand, FalconEmulator, GuidedHand, homing_motion
from spatula_env.teleop.falcon import Falcon, kinematics
from spatula_env.teleop.falcon.frames import (
    CENTRE,
    direction_to_device,
    direction_to_falcon,
    position_to_device,
)
from spatula_env.teleop.falcon.protocol import Lights
from spatula_env.teleop.falcon.velocity import LONGEST_WINDOW, CountVelocity


def test_homing_then_reading():
    emulator = FalconEmulator(ElasticHand(homing_motion()))
    told = []
    with make_driver(emulator) as falcon:
        assert falcon.is_open
        assert not falcon.is_calibrated
        with pytest.raises(NotCalibrated, match="not homed"):
            falcon.read()
        falcon.calibrate(told.append)
        assert falcon.is_calibrated
        exchange_for(falcon, 1.5)
        np.testing.assert_allclose(falcon.read().position, position_to_device(emulator.grip), atol=1e-4)
    assert told[0].startswith("Pull the grip all the way out")
    assert told[-1] == "The Falcon is homed."
    assert not falcon.is_open


def test_homing_gives_up_and_names_the_legs():
    emulator = FalconEmulator()
    with (
        make_driver(emulator, homing_timeout=0.5) as falcon,
        pytest.raises(NotCalibrated, match="missing: top, right, left"),
    ):
        falcon.calibrate()


def test_a_homed_falcon_needs_no_homing():
    _, falcon = open_homed()
    told = []
    falcon.calibrate(told.append)
    assert told == ["The Falcon is homed."]
    falcon.close()


def test_forces_are_zero_until_homed():
    emulator = FalconEmulator(ElasticHand(homing_motion()))
    falcon = make_driver(emulator)
    falcon.open()
    while not falcon.is_calibrated:
        falcon.send_force([3.0, 0.0, 0.0])
        falcon.exchange()
        assert emulator.program.motors == (0, 0, 0)
    assert {counts for _, counts in emulator.motor_history} == {(0, 0, 0)}
    falcon.send_force([3.0, 0.0, 0.0])
    falcon.exchange()
    assert emulator.program.motors != (0, 0, 0)
    falcon.close()


@pytest.mark.parametrize("position", workspace_points(60, seed=1))
def test_position_within_a_count_over_the_workspace(position):
    _, falcon = open_homed(hand=held_at(position))
    exchange_for(falcon, 0.003)
    found = falcon.state().position
    counts = kinematics.angles_to_counts(kinematics.inverse(found))
    exact = np.array(kinematics.inverse(position))
    assert np.abs(np.array(kinematics.inverse(found)) - exact).max() <= 0.5 * kinematics.COUNT_ANGLE * (1 + 1e-6)
    assert counts == falcon.state().encoders
    np.testing.assert_array_equal(falcon.read().position, position_to_device(found))
    falcon.close()


@pytest.mark.parametrize("position", workspace_points(12, seed=2))
@pytest.mark.parametrize("force", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_the_hand_feels_the_force_that_was_sent(position, force):
    emulator, falcon = open_homed(hand=held_at(position))
    falcon.exchange()
    falcon.send_force(force)
    falcon.exchange()
    # Motors have whole counts, and the driver knows the position to half a count.
    np.testing.assert_allclose(direction_to_device(emulator.motor_force), force, atol=0.02)
    falcon.close()


def test_force_moves_the_hand_in_its_direction():
    _, falcon = open_homed()
    for axis in range(3):
        before = falcon.read().position[axis]
        push = np.zeros(3)
        push[axis] = 1.5
        for _ in range(600):
            falcon.send_force(push)
            falcon.exchange()
        # The arm's spring of 300 N/m yields 5 mm.
        assert falcon.read().position[axis] - before == pytest.approx(0.005, abs=0.0001)
        exchange_for(falcon, 0.6)
    falcon.close()


@given(st.tuples(*[st.floats(-1e6, 1e6)] * 3).filter(lambda force: max(map(abs, force)) > 1e-3))
def test_saturated_forces_keep_their_direction(force):
    emulator, falcon = open_homed(hand=held_at(MIDDLE))
    falcon.send_force(force)
    falcon.exchange()
    felt = np.array(direction_to_device(emulator.motor_force))
    assert max(map(abs, emulator.program.demanded)) <= kinematics.MOTOR_LIMIT
    assert np.linalg.norm(felt) <= falcon.greatest_force * (1 + 1e-3)
    expected = np.array(force) / np.linalg.norm(force)
    assert np.linalg.norm(felt - np.linalg.norm(felt) * expected) <= 0.005
    falcon.close()


def test_greatest_force_is_a_limit_of_the_magnitude():
    emulator, falcon = open_homed(hand=held_at(MIDDLE), greatest_force=2.0)
    falcon.send_force([0.0, 0.0, 100.0])
    falcon.exchange()
    np.testing.assert_allclose(direction_to_device(emulator.motor_force), [0.0, 0.0, 2.0], atol=0.01)
    falcon.close()
    assert Falcon(greatest_force=50.0).greatest_force == 8.0


@pytest.mark.parametrize("phase", [0.0, 0.0003, 0.0007])
def test_watchdog_ends_a_force_in_time(phase):
    emulator, falcon = open_homed(hand=held_at(MIDDLE))
    exchange_for(falcon, 0.01)
    emulator.advance(phase)
    sent = emulator.clock.now()
    falcon.send_force([2.0, 0.0, 0.0])
    exchange_for(falcon, 0.05)
    commands = [(time - sent, counts) for time, counts in emulator.motor_history if time > sent]
    pushing = [time for time, counts in commands if counts != (0, 0, 0)]
    silent = [time for time, counts in commands if time > pushing[-1]]
    assert pushing[0] < 0.001
    assert 0.015 < pushing[-1] < silent[0] <= 0.020
    falcon.close()


def test_renewed_forces_last():
    emulator, falcon = open_homed(hand=held_at(MIDDLE))
    for _ in range(10):
        falcon.send_force([2.0, 0.0, 0.0])
        exchange_for(falcon, 0.010)
        assert emulator.program.motors != (0, 0, 0)
    falcon.close()


@pytest.mark.parametrize("force", [[math.nan, 0.0, 0.0], [math.inf, 0.0, 0.0], [1.0, 2.0], "strong"])
def test_a_wrong_force_ends_the_one_before(force):
    emulator, falcon = open_homed()
    falcon.send_force([2.0, 0.0, 0.0])
    falcon.exchange()
    assert emulator.program.motors != (0, 0, 0)
    with pytest.raises(ValueError):
        falcon.send_force(force)
    falcon.exchange()
    assert emulator.program.motors == (0, 0, 0)
    falcon.close()


def test_close_ends_the_force_and_lets_go():
    emulator, falcon = open_homed()
    falcon.send_force([2.0, 0.0, 0.0])
    falcon.exchange()
    falcon.close()
    falcon.close()
    emulator.advance(0.002)
    assert emulator.program.motors == (0, 0, 0)
    assert emulator.program.lights == 0
    assert emulator.owner is None
    with pytest.raises(DeviceError, match="not open"):
        falcon.read()
    falcon.open()
    assert falcon.is_calibrated
    falcon.close()


def test_an_exception_in_the_with_block_ends_the_force():
    emulator = FalconEmulator(homed=True)
    with pytest.raises(RuntimeError, match="operator"), make_driver(emulator) as falcon:
        falcon.send_force([2.0, 0.0, 0.0])
        falcon.exchange()
        raise RuntimeError("operator")
    emulator.advance(0.002)
    assert emulator.program.motors == (0, 0, 0)


def test_a_forgotten_falcon_ends_its_force():
    emulator, falcon = open_homed()
    falcon.send_force([2.0, 0.0, 0.0])
    falcon.exchange()
    del falcon
    emulator.advance(0.002)
    assert emulator.program.motors == (0, 0, 0)
    assert emulator.owner is None


def test_the_interpreter_s_end_ends_the_force():
    program = """
import atexit
from spatula_env.teleop.emulator import FalconEmulator
from spatula_env.teleop.falcon import Falcon
emulator = FalconEmulator(homed=True)
atexit.register(lambda: (emulator.advance(0.002), print(emulator.program.motors, emulator.owner)))
falcon = Falcon(transport=emulator.connect, clock=emulator.clock.now, sleep=emulator.clock.sleep, force_timeout=1e9)
falcon.open()
while emulator.program.motors == (0, 0, 0):
    falcon.send_force([2.0, 0.0, 0.0])
    falcon.wait_for_sample()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "(0, 0, 0) None\n"


def test_buttons_by_name():
    emulator, falcon = open_homed()
    for pressed in ({"center"}, {"plus", "minus"}, set()):
        emulator.press(pressed)
        falcon.exchange()
        assert falcon.read().buttons == pressed
    assert set(falcon.button_names) == {"plus", "forward", "center", "minus"}
    falcon.close()


def test_lights_tell_whether_it_is_homed():
    emulator = FalconEmulator(ElasticHand(homing_motion()))
    falcon = make_driver(emulator)
    falcon.open()
    assert emulator.program.lights == Lights.RED
    falcon.calibrate()
    falcon.exchange()
    assert emulator.program.lights == Lights.GREEN
    falcon.set_lights(Lights.BLUE | Lights.RED)
    falcon.exchange()
    assert emulator.program.lights == Lights.BLUE | Lights.RED
    falcon.set_lights(None)
    falcon.exchange()
    assert emulator.program.lights == Lights.GREEN
    falcon.close()


def test_samples_are_counted_and_stamped():
    _, falcon = open_homed()
    first = falcon.read()
    assert falcon.read().sequence == first.sequence
    falcon.exchange()
    second = falcon.read()
    assert second.sequence == first.sequence + 1
    assert second.time > first.time
    assert second.age(falcon.now()) == pytest.approx(0.0, abs=1e-9)
    assert second.kind == "position"
    assert second.rate is None
    with pytest.raises(ValueError, match="read-only"):
        second.position[0] = 0.0
    falcon.close()


def test_thousand_exchanges_a_second():
    emulator, falcon = open_homed()
    exchange_for(falcon, 1.0)
    statistics = falcon.statistics()
    assert statistics.exchanges == pytest.approx(1000, abs=5)
    assert statistics.mean_period == pytest.approx(1e-3, rel=1e-3)
    assert statistics.late == statistics.missed == statistics.implausible == statistics.discarded_bytes == 0
    assert emulator.program.packets == statistics.exchanges
    falcon.close()


def test_thread_exchanges_by_itself():
    emulator = FalconEmulator(ElasticHand(homing_motion()))
    with make_driver(emulator, threaded=True) as falcon:
        falcon.calibrate()
        before = falcon.read().sequence
        while falcon.read().sequence < before + 50:
            falcon.wait_for_sample()
        assert "falcon" in {thread.name for thread in threading.enumerate()}
        with pytest.raises(DeviceError, match="threaded=False"):
            falcon.exchange()
    assert "falcon" not in {thread.name for thread in threading.enumerate()}


# Velocity.


def drive(motion, duration, period=1e-3):
    """The filter's estimates for one encoder that follows a motion in counts."""
    estimator = CountVelocity()
    estimates = []
    for step in range(round(duration / period)):
        time = 1.0 + step * period
        estimates.append(estimator.update(time, (round(motion(step * period)), 0, 0))[0])
    return np.array(estimates)


@given(st.floats(-20_000.0, 20_000.0), st.floats(0.0, 1.0))
def test_constant_velocity_within_a_count_over_the_window(speed, offset):
    estimates = drive(lambda time: speed * time + offset, 0.1)
    # One count over the window, of which the period that is not full may be missing.
    assert np.abs(estimates[40:] - speed).max() <= 1.0 / (LONGEST_WINDOW - 1e-3) * (1 + 1e-6)


def test_velocity_of_a_sine_is_neither_noisy_nor_late():
    # A hand that shakes at 3 Hz by 20 mm, about 400 counts.
    amplitude, rate = 400.0, 2 * math.pi * 3.0
    estimates = drive(lambda time: amplitude * math.sin(rate * time), 1.0)
    times = np.arange(1000) * 1e-3
    truth = amplitude * rate * np.cos(rate * times)
    error = (estimates - truth)[50:]
    assert np.sqrt(np.mean(error**2)) < 0.06 * amplitude * rate
    # The lag that explains the estimate best.
    lags = np.arange(0.0, 0.02, 0.0005)
    late = [np.mean((estimates - amplitude * rate * np.cos(rate * (times - lag)))[50:] ** 2) for lag in lags]
    assert lags[int(np.argmin(late))] <= 0.005
    # A plain difference is far worse at low speed.
    slow = drive(lambda time: 40.0 * time, 0.5)[50:]
    assert np.std(slow) < 0.1 * np.std(np.diff(np.round(40.0 * np.arange(500) * 1e-3)) / 1e-3)


def test_velocity_at_rest_is_zero_and_stops_at_once():
    assert (drive(lambda _: 17.0, 0.1) == 0.0).all()
    stopping = drive(lambda time: 5000.0 * min(time, 0.1), 0.2)
    assert stopping[90] == pytest.approx(5000.0, rel=0.02)
    assert abs(stopping[105]) < 500.0
    assert abs(stopping[135]) < 1.0


def test_velocity_of_a_known_motion_in_the_device_frame():
    speed = np.array([0.03, -0.05, 0.04])

    def motion(time):
        travelled = direction_to_falcon(tuple((speed * (time - 0.1)).tolist()))
        return travelled[0], travelled[1], CENTRE + travelled[2]

    _, falcon = open_homed(hand=GuidedHand(motion))
    exchange_for(falcon, 0.2)
    np.testing.assert_allclose(falcon.read().velocity, speed, atol=0.003)
    falcon.close()


# LeRobot's names.


def test_lerobot_names():
    emulator = FalconEmulator(ElasticHand(homing_motion()))
    falcon = make_driver(emulator)
    falcon.connect()
    assert falcon.is_connected
    assert falcon.is_calibrated
    emulator.press({"forward"})
    falcon.exchange()
    action = falcon.get_action()
    assert set(action) == set(falcon.action_features)
    assert action["position.y"] == falcon.read().position[1]
    assert action["button.forward"] is True
    assert action["button.plus"] is False
    falcon.send_feedback({"force.x": 1.0, "force.y": 0.0, "force.z": 0.0})
    falcon.exchange()
    assert direction_to_device(emulator.motor_force)[0] == pytest.approx(1.0, abs=0.02)
    with pytest.raises(ValueError, match=r"force\.z"):
        falcon.send_feedback({"force.x": 1.0, "force.y": 0.0})
    falcon.disconnect()
    assert not falcon.is_connected


@pytest.mark.parametrize("option", [{"greatest_force": -1.0}, {"force_timeout": 0.001}, {"homing_timeout": math.nan}])
def test_wrong_options(option):
    with pytest.raises(ValueError, match=next(iter(option))):
        Falcon(**option)


def test_importing_loads_no_library_of_a_device():
    program = (
        "import sys, spatula_env.teleop, spatula_env.teleop.falcon, spatula_env.teleop.emulator;"
        "print(sorted({'usb', 'pygame', 'numba', 'pybullet', 'forcedimension_core'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
