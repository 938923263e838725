from __future__ import annotations

import math

import numpy as np
import pytest
from falcon_helpers import exchange_for, make_driver, open_homed, workspace_points
from hypothesis import given
from hypothesis import strategies as st

from spatula_env.teleop import DeviceError, DeviceLost
from spatula_env.teleop.emulator import (
    ElasticHand,
    FalconEmulator,
    GuidedHand,
    RealClock,
    SimulatedClock,
    homing_motion,
    legs,
)
from spatula_env.teleop.emulator.chip import FtdiChip, LineSettings, RefusedRequest
from spatula_env.teleop.falcon.frames import direction_to_falcon


def test_links_have_their_lengths():
    """The legs close: from the hip along thigh and shin one arrives at the grip's joint."""
    for position in workspace_points(50, seed=3):
        for leg, angle in enumerate(legs.leg_angles(position)):
            azimuth = math.radians(legs.AZIMUTHS[leg])
            radial = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
            sideways = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
            up = np.array([0.0, 0.0, 1.0])
            hip = legs.HIP_FROM_AXIS * radial + legs.HIP_SIDEWAYS * sideways
            theta = math.radians(angle)
            knee = hip + legs.THIGH_LENGTH * (math.cos(theta) * radial + math.sin(theta) * up)
            joint = np.array(position) + legs.JOINT_FROM_MIDDLE * radial + legs.JOINT_SIDEWAYS * sideways
            shin = joint - knee
            in_plane = shin - (shin @ sideways) * sideways
            edge = shin - legs.SHIN_PIECES * in_plane / np.linalg.norm(in_plane)
            assert np.linalg.norm(edge) == pytest.approx(legs.SHIN_EDGE, abs=1e-12)


@given(st.tuples(*[st.floats(-legs.SURE_REACH, legs.SURE_REACH)] * 3))
def test_where_the_grip_is_sure_to_reach_it_does(place):
    grip = (place[0], place[1], place[2] + legs.SURE_MIDDLE)
    assert legs.is_within_reach(grip)
    legs.leg_angles(grip)


def test_where_no_leg_reaches_the_grip_does_not():
    assert not legs.is_within_reach((0.0, 0.0, 0.3))
    assert not legs.is_within_reach((0.2, 0.0, 0.12))


@given(st.tuples(*[st.integers(-2000, 2000)] * 3), st.sampled_from(workspace_points(20, seed=4)))
def test_motor_force_is_that_of_virtual_work(motors, position):
    force = legs.grip_force(position, motors)
    step = 1e-6
    for axis in range(3):
        ahead, behind = list(position), list(position)
        ahead[axis] += step
        behind[axis] -= step
        turned = np.radians(np.subtract(legs.leg_angles(tuple(ahead)), legs.leg_angles(tuple(behind))))
        work = legs.NEWTON_METRES_PER_COUNT * np.dot(motors, turned) / (2 * step)
        assert force[axis] == pytest.approx(work, rel=1e-4, abs=1e-4)


def test_known_forces_on_the_axis():
    """4095 counts on all motors push outwards with 16 N."""
    assert legs.grip_force((0.0, 0.0, 0.13), (-4095, -4095, -4095))[2] == pytest.approx(16.3, abs=0.1)


# The hand.


@given(
    st.tuples(*[st.floats(-5.0, 5.0)] * 3),
    st.floats(0.0, 2000.0),
    st.floats(0.0, 30.0),
    st.sampled_from([1e-4, 5e-4, 1e-3]),
)
def test_energy_balance_of_the_hand(force, stiffness, damping, step):
    hand = ElasticHand(
        lambda time: (0.02 * math.sin(9 * time), 0.0, 0.12 + 0.03 * math.sin(5 * time)),
        stiffness=stiffness,
        damping=damping,
    )
    for index in range(300):
        hand.advance(index * step, step, tuple(value * math.cos(0.05 * index) for value in force))
    energies = hand.energies
    balance = energies.motors + energies.arm - energies.dissipated - energies.stops
    assert hand.kinetic_energy == pytest.approx(balance, abs=1e-12)
    assert energies.dissipated >= -1e-12


def test_free_fall_of_the_hand():
    hand = ElasticHand(mass=0.5, stiffness=0.0, damping=0.0)
    for index in range(100):
        hand.advance(index * 1e-3, 1e-3, (0.5, 0.0, 0.0))
    assert hand.velocity[0] == pytest.approx(0.1)
    assert hand.position[0] == pytest.approx(0.005)
    assert hand.energies.motors == pytest.approx(hand.kinetic_energy)
    assert hand.energies.dissipated == pytest.approx(0.0, abs=1e-15)


def test_a_spring_swings_without_loss():
    hand = ElasticHand(lambda _: (0.0, 0.0, 0.12), position=(0.01, 0.0, 0.12), mass=0.3, stiffness=300.0, damping=0.0)
    period = 2 * math.pi * math.sqrt(0.3 / 300.0)
    greatest = 0.0
    for index in range(5000):
        hand.advance(index * 1e-3, 1e-3, (0.0, 0.0, 0.0))
        if index * 1e-3 > 4.0:
            greatest = max(greatest, abs(hand.position[0]))
    assert greatest == pytest.approx(0.01, rel=1e-3)
    assert 5.0 / period > 20


def test_stops_end_a_motion_and_take_its_energy():
    hand = ElasticHand(mass=0.3, stiffness=0.0, damping=0.0)
    for index in range(2000):
        hand.advance(index * 1e-3, 1e-3, (0.0, 0.0, 5.0))
    assert hand.position[2] < 0.2
    assert hand.velocity == (0.0, 0.0, 0.0)
    assert hand.energies.stops == pytest.approx(hand.energies.motors)
    assert hand.energies.stops > 0.0


def test_motors_work_on_a_guided_hand():
    emulator, falcon = open_homed(hand=GuidedHand(lambda time: (0.05 * min(time, 0.5), 0.0, 0.12)))
    while falcon.now() < 0.5:
        falcon.send_force([2.0, 0.0, 0.0])
        falcon.exchange()
    # 2 N over 25 mm, but for the milliseconds before the first force.
    assert emulator.hand.energies.motors == pytest.approx(0.05, rel=0.02)
    falcon.close()


def test_a_spring_and_damper_rendered_on_the_device_give_no_energy():
    emulator, falcon = open_homed(hand=ElasticHand(position=(0.02, 0.01, 0.13), stiffness=0.0, damping=0.0))
    start = falcon.read().position
    while falcon.now() < 1.0:
        sample = falcon.read()
        falcon.send_force(-300.0 * sample.position - 5.0 * sample.velocity)
        falcon.exchange()
    # The motors gave no more than was in their spring at first, and the damper took most of that back.
    assert emulator.hand.energies.motors < 0.5 * 300.0 * (start @ start)
    assert np.linalg.norm(falcon.read().position) < 0.1 * np.linalg.norm(start)
    falcon.close()


@pytest.mark.parametrize(
    ("options", "name"), [({"mass": 0.0}, "mass"), ({"stiffness": -1.0}, "stiffness"), ({"damping": -1.0}, "damping")]
)
def test_wrong_hands(options, name):
    with pytest.raises(ValueError, match=name):
        ElasticHand(**options)


# Homing.


def test_pulling_out_alone_does_not_home():
    emulator = FalconEmulator(ElasticHand(lambda time: (0.0, 0.0, 0.12 + 0.05 * min(time, 1.0))))
    falcon = make_driver(emulator)
    falcon.open()
    exchange_for(falcon, 1.5)
    assert falcon.state().homed == (False, False, False)
    falcon.close()


def test_encoders_count_from_power_up_until_homed():
    emulator = FalconEmulator(GuidedHand(homing_motion()))
    falcon = make_driver(emulator)
    falcon.open()
    assert falcon.state().encoders == (0, 0, 0)
    falcon.calibrate()
    exchange_for(falcon, 0.5)
    assert falcon.state().encoders == legs.encoder_counts(emulator.grip)
    falcon.close()


# The chip.


def test_chip_sends_when_full_or_when_the_latency_timer_runs_out():
    chip = FtdiChip(0.0)
    chip.control(0x40, 9, 4, 0)
    assert chip.ready_at(0.001) == pytest.approx(0.004)
    chip.receive(b"x" * 70)
    assert chip.ready_at(0.001) == 0.001
    assert len(chip.take_packet(0.001)) == 64
    assert chip.ready_at(0.001) == pytest.approx(0.005)
    assert chip.take_packet(0.005)[2:] == b"x" * 8
    assert chip.take_packet(0.009)[2:] == b""


@pytest.mark.parametrize(("divisor", "baud"), [(0x4138, 9600.0), (0x0015, 3e6 / 21), (0x0002, 1.5e6)])
def test_divisors(divisor, baud):
    assert 10.0 / LineSettings(divisor=divisor).byte_time == pytest.approx(baud, rel=1e-4)


@pytest.mark.parametrize("call", [(0xC0, 0, 0, 0), (0x40, 0, 0, 1), (0x40, 7, 0, 0), (0x40, 9, 0, 0), (0x40, 1, 0, 0)])
def test_requests_that_the_chip_refuses(call):
    with pytest.raises(RefusedRequest):
        FtdiChip(0.0).control(*call)
    with pytest.raises(DeviceLost, match="does not accept"):
        FalconEmulator().connect().control_transfer(*call)


def test_every_packet_starts_with_status_bytes_and_reading_takes_time():
    emulator = FalconEmulator()
    transport = emulator.connect()
    transport.control_transfer(0x40, 0, 1, 0)
    assert transport.bulk_read(64, 0.1) == b"\x11\x60"
    assert emulator.clock.now() == pytest.approx(0.016)
    assert transport.bulk_read(64, 0.005) == b""
    assert emulator.clock.now() == pytest.approx(0.021)
    transport.close()
    with pytest.raises(DeviceError, match="closed"):
        transport.bulk_read(64, 0.1)


# Time.


def test_runs_are_the_same_every_time():
    def run():
        emulator = FalconEmulator(ElasticHand(homing_motion()))
        with make_driver(emulator) as falcon:
            falcon.calibrate()
            for _ in range(200):
                falcon.send_force(-100.0 * falcon.read().position)
                falcon.exchange()
            return [*emulator.grip, *falcon.read().position, emulator.hand.energies.motors]

    assert run() == run()


def test_real_time():
    emulator = FalconEmulator(ElasticHand(homing_motion(duration=0.3)), clock=RealClock())
    with emulator.running(), make_driver(emulator, threaded=True) as falcon:
        falcon.calibrate()
        for _ in range(20):
            falcon.send_force(direction_to_falcon((0.5, 0.0, 0.0)))
            falcon.wait_for_sample()
        assert falcon.statistics().exchanges > 20


def test_simulated_time_does_not_run_in_a_thread():
    with pytest.raises(DeviceError, match="RealClock"), FalconEmulator().running():
        pass


def test_simulated_clock_always_moves_on():
    clock = SimulatedClock(1e6)
    clock.sleep(1e-15)
    assert clock.now() > 1e6
    clock.sleep(-1.0)
    clock.sleep(0.0)
    assert clock.now() < 1e6 + 1e-6
