from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from teleop_helpers import Puppet, SixPuppet

import spatula_env
from spatula_env.teleop import DeviceLost
from spatula_env.teleop.emulator import GuidedHand
from spatula_env.teleop.falcon.frames import position_to_falcon
from spatula_env.teleop.haptics import HapticDevice, HapticSettings
from spatula_env.teleop.scripted import EmulatedFalcon
from spatula_env.teleop.wrapper import FalconTeleop

gym.register_envs(spatula_env)

PERIOD = 0.05


@pytest.fixture(scope="module")
def press():
    env = gym.make("Spatula/Press-v0", max_episode_steps=10_000)
    yield env
    env.close()


@pytest.fixture(scope="module")
def fissure():
    env = gym.make("Spatula/Fissure-v0", control="velocity_6d")
    yield env
    env.close()


@pytest.fixture(scope="module")
def clamp():
    env = gym.make("Spatula/Clamp-v0")
    yield env
    env.close()


def grip(env) -> np.ndarray:
    return env.unwrapped._episodes.situation.tool_position[0]


def begin(env, device, position=(0.0, 0.0, 0.03), **options) -> FalconTeleop:
    teleop = FalconTeleop(env, device, real_time=False, **options)
    teleop.reset(seed=0, options={"tool_position": position})
    return teleop


def test_the_tool_goes_where_the_hand_goes_one_to_one(press):
    device = Puppet()
    teleop = begin(press, device, (0.01, 0.0, 0.03))
    teleop.step()
    np.testing.assert_allclose(grip(press), [0.01, 0.0, 0.03], atol=1e-8)
    for move in ([0.003, 0.0, 0.0], [0.003, -0.004, 0.002], [0.0, 0.0, 0.0]):
        device.value = np.array(move)
        teleop.step()
        np.testing.assert_allclose(grip(press), np.array([0.01, 0.0, 0.03]) + move, atol=1e-8)


def test_scale(press):
    device = Puppet()
    teleop = begin(press, device, scale=0.5)
    teleop.step()
    device.value = np.array([0.004, 0.0, 0.0])
    teleop.step()
    np.testing.assert_allclose(grip(press)[0], 0.002, atol=1e-8)


def test_a_hand_that_is_too_quick_is_followed_at_full_speed(press):
    device = Puppet()
    teleop = begin(press, device)
    teleop.step()
    device.value = np.array([0.0, 0.012, 0.0])
    _, _, _, _, info = teleop.step()
    np.testing.assert_allclose(info["action"], [0.0, 1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(grip(press)[1], 0.1 * PERIOD, atol=1e-8)
    for _ in range(2):
        teleop.step()
    np.testing.assert_allclose(grip(press)[1], 0.012, atol=1e-8)


def test_the_clutch_uncouples_hand_and_tool(press):
    device = Puppet()
    teleop = begin(press, device)
    teleop.step()
    device.buttons = {"center"}
    for x in (0.01, 0.02, 0.03):
        device.value = np.array([x, 0.0, 0.0])
        teleop.step()
    np.testing.assert_allclose(grip(press), [0.0, 0.0, 0.03], atol=1e-8)
    device.buttons = set()
    teleop.step()
    np.testing.assert_allclose(grip(press), [0.0, 0.0, 0.03], atol=1e-8)
    device.value = np.array([0.031, 0.0, 0.0])
    teleop.step()
    np.testing.assert_allclose(grip(press), [0.001, 0.0, 0.03], atol=1e-8)


def test_rates_are_fractions_of_the_greatest_speed(press):
    device = Puppet("rate")
    teleop = begin(press, device)
    device.value = np.array([0.5, -1.0, 0.0])
    _, _, _, _, info = teleop.step()
    np.testing.assert_allclose(info["action"], device.value)
    np.testing.assert_allclose(grip(press), [0.0025, -0.005, 0.03], atol=1e-8)


def test_a_position_device_as_a_stick(press):
    device = Puppet()
    teleop = begin(press, device, mode="rate")
    device.value = np.array([0.003, -0.04, 0.022])
    _, _, _, _, info = teleop.step()
    np.testing.assert_allclose(info["action"], [0.0, -1.0, 0.5], atol=1e-6)


def test_buttons_turn_about_one_axis_after_the_other(fissure):
    device = Puppet()
    teleop = begin(fissure, device, (0.0, 0.0, 0.045))
    names = fissure.unwrapped.control.names
    device.buttons = {"plus"}
    _, _, _, _, info = teleop.step()
    assert dict(zip(names, info["action"], strict=True))["rotation_x"] == 1.0
    device.buttons = {"forward", "minus"}
    for _ in range(2):
        _, _, _, _, info = teleop.step()
        assert dict(zip(names, info["action"], strict=True))["rotation_y"] == -1.0
    np.testing.assert_allclose(info["action"][[3, 5]], 0.0)


def test_buttons_move_the_jaws(clamp):
    device = Puppet()
    teleop = FalconTeleop(clamp, device, real_time=False)
    teleop.reset(seed=0)
    opening = clamp.unwrapped._episodes.situation.control[0, 0]
    device.buttons = {"minus"}
    _, _, _, _, info = teleop.step()
    assert info["action"][-1] == -1.0
    assert clamp.unwrapped._episodes.situation.control[0, 0] < opening


def test_devices_with_more_than_three_rates(fissure):
    device = SixPuppet("rate")
    device.extras = {"rotation_x": 0.25, "rotation_z": -0.5, "jaw_speed": 1.0}
    teleop = begin(fissure, device, (0.0, 0.0, 0.045))
    _, _, _, _, info = teleop.step()
    np.testing.assert_allclose(info["action"][3:], [0.25, 0.0, -0.5])


def test_a_button_takes_over_from_a_policy_and_gives_back(press):
    device = Puppet()
    teleop = begin(press, device, intervention="button")
    action = np.array([0.2, 0.0, 0.0], dtype=np.float32)
    _, _, _, _, info = teleop.step(action)
    assert (info["acted_by"], info["intervened"]) == ("policy", False)
    np.testing.assert_array_equal(info["action"], action)
    before = grip(press)
    device.value = np.array([0.0, 0.02, 0.0])
    device.buttons = {"center"}
    _, _, _, _, info = teleop.step(action)
    assert (info["acted_by"], info["intervened"]) == ("human", True)
    # Nothing jumps: hand and tool are matched where they are.
    np.testing.assert_allclose(grip(press), before, atol=1e-8)
    device.value = np.array([0.0, 0.023, 0.0])
    teleop.step(action)
    np.testing.assert_allclose(grip(press), before + np.array([0.0, 0.003, 0.0]), atol=1e-8)
    device.buttons = set()
    _, _, _, _, info = teleop.step(action)
    assert info["acted_by"] == "policy"


def test_motion_takes_over_until_the_hand_is_still(press):
    device = Puppet()
    teleop = begin(press, device, intervention="motion", motion_threshold=0.05, release_time=0.1)
    action = np.zeros(3, dtype=np.float32)
    acted = []
    for speed in (0.0, 0.04, 0.06, 0.0, 0.0, 0.0):
        device.velocity = np.array([0.0, speed, 0.0])
        acted.append(teleop.step(action)[-1]["acted_by"])
    assert acted == ["policy", "policy", "human", "human", "policy", "policy"]


def test_a_policy_is_needed_where_nobody_intervenes(press):
    teleop = begin(press, Puppet(), intervention="button")
    with pytest.raises(ValueError, match="action must be given"):
        teleop.step()


def test_the_force_is_sent_after_every_physics_step_and_ends_with_the_episode(press):
    device = Puppet(has_force=True)
    teleop = begin(press, device, (0.0, 0.0, -0.02))
    device.forces.clear()
    device.value = np.zeros(3)
    teleop.step()
    assert len(device.forces) == 12
    for depth in np.arange(0.002, 0.016, 0.002):
        device.value = np.array([0.0, 0.0, -depth])
        device.forces.clear()
        _, _, _, _, info = teleop.step()
    assert info["force"] > 0.1
    np.testing.assert_allclose(np.linalg.norm(np.mean(device.forces, axis=0)), info["force"], rtol=1e-6)
    assert np.mean(device.forces, axis=0)[2] > 0.0
    teleop.reset(seed=1)
    np.testing.assert_array_equal(device.forces[-1], 0.0)


def test_an_exception_in_the_environment_ends_the_force(press, monkeypatch):
    device = Puppet(has_force=True)
    teleop = begin(press, device)
    monkeypatch.setattr(press.unwrapped._episodes, "_judge", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        teleop.step()
    np.testing.assert_array_equal(device.forces[-1], 0.0)
    assert "step" not in vars(press.unwrapped.simulation)


def test_a_lost_device_loses_nothing_of_the_episode(press):
    device = Puppet(has_force=True)
    teleop = begin(press, device)
    teleop.step()
    before, time = grip(press), press.unwrapped.simulation.time
    device.lost = True
    with pytest.raises(DeviceLost):
        teleop.step()
    assert press.unwrapped.simulation.time == time
    device.lost = False
    device.value = np.array([0.03, 0.0, 0.0])
    _, _, _, _, info = teleop.step()
    # Matched anew: the hand may be anywhere by then.
    np.testing.assert_allclose(grip(press), before, atol=1e-8)
    assert info["time"] == pytest.approx(2 * PERIOD)


def test_a_device_lost_within_a_step_lets_the_step_be_finished(press, monkeypatch):
    device = Puppet(has_force=True)
    teleop = begin(press, device)
    send = device.send_force

    def fail(force):
        device.lost = len(device.forces) > 4
        send(force)

    monkeypatch.setattr(device, "send_force", fail)
    _, _, _, _, info = teleop.step()
    assert info["time"] == pytest.approx(PERIOD)
    with pytest.raises(DeviceLost):
        teleop.step()


def test_the_hand_on_a_falcon_feels_the_organ(press):
    """From the organ to the grip: simulation, loop, driver, packets, motors. In simulated time."""
    height = {"z": 0.01}
    hand = GuidedHand(lambda _: position_to_falcon((0.0, 0.0, height["z"])))
    falcon = EmulatedFalcon(hand)
    device = HapticDevice(lambda: falcon, HapticSettings(), where="here", exchange=True)
    with device:
        teleop = FalconTeleop(press, device)
        teleop.reset(seed=0, options={"tool_position": (0.0, 0.0, -0.02)})
        start = device.now()
        for _ in range(20):
            height["z"] -= 0.0008
            teleop.step()
        assert device.now() - start == pytest.approx(20 * PERIOD, abs=0.02)
        for _ in range(15):
            _, _, _, _, info = teleop.step()
        assert info["force"] > 0.05
        x, y, z = falcon.emulator.motor_force
        assert np.linalg.norm([x, y, z]) == pytest.approx(info["force"], rel=0.1)
        assert y > 0.0
        assert device.statistics().stalls == 0
        teleop.reset(seed=1)
        device.sleep(0.03)
        assert not any(falcon.emulator.program.motors)


def test_hand_and_tool_are_coupled_where_they_are_and_not_while_the_clutch_is_held(press, monkeypatch):
    falcon = EmulatedFalcon(GuidedHand(lambda _: position_to_falcon((0.01, 0.0, 0.0))))
    device = HapticDevice(lambda: falcon, where="here", exchange=True)
    places = []
    monkeypatch.setattr(device, "tell", lambda position, force, shift: places.append(position))
    with device:
        teleop = FalconTeleop(press, device)
        teleop.reset(seed=0, options={"tool_position": (0.0, 0.02, 0.03)})
        teleop.step()
        np.testing.assert_allclose(places, [[0.01, 0.0, 0.0]] * 12, atol=1e-4)
        falcon.emulator.press(["center"])
        device.sleep(0.005)
        places.clear()
        teleop.step()
        assert places == [None] * 12


def test_after_a_pause_the_tool_goes_no_deeper_until_the_force_is_back(press):
    class Timed(Puppet):
        time = 0.0

        def now(self):
            return self.time

        def read(self):
            self.time += 1.0 / 240.0
            return super().read()

    device = Timed(has_force=True)
    teleop = begin(press, device, (0.0, 0.0, -0.02))
    for depth in np.arange(0.002, 0.012, 0.002):
        device.value = np.array([0.0, 0.0, -depth])
        teleop.step()
    before = grip(press).copy()
    device.time += 0.3
    for _ in range(2):
        device.value = device.value - np.array([0.0, 0.0, 0.004])
        teleop.step()
    np.testing.assert_allclose(grip(press)[2], before[2], atol=3e-4)
    # Out of it the hand leads at once, and farther in as soon as the force is back.
    device.value = device.value + np.array([0.0, 0.0, 0.002])
    teleop.step()
    assert grip(press)[2] > before[2] + 0.0015
    device.value = device.value - np.array([0.0, 0.0, 0.003])
    teleop.step()
    assert grip(press)[2] < before[2] - 5e-4


@pytest.mark.parametrize("task", ["Retract", "Palpate"])
def test_the_other_tasks(task):
    env = gym.make(f"Spatula/{task}-v0")
    device = Puppet(has_force=True)
    teleop = FalconTeleop(env, device, real_time=False)
    teleop.reset(seed=0)
    before = grip(env)
    teleop.step()
    device.value = np.array([0.001, -0.001, 0.0005])
    teleop.step()
    np.testing.assert_allclose(grip(env), before + device.value, atol=1e-7)
    assert len(device.forces) >= 24
    teleop.close()


def test_observations_and_actions_fit_their_spaces(press):
    teleop = begin(press, Puppet())
    observation, reward, terminated, truncated, info = teleop.step()
    assert teleop.observation_space.contains(observation)
    assert teleop.action_space.contains(info["action"])
    assert isinstance(reward, float)
    assert not terminated
    assert not truncated


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mode": "pose"}, "mode"),
        ({"intervention": "never"}, "intervention"),
        ({"scale": 0.0}, "scale"),
        ({"release_time": -1.0}, "release_time"),
    ],
)
def test_arguments_are_checked(press, options, message):
    with pytest.raises(ValueError, match=message):
        FalconTeleop(press, Puppet(), **options)


def test_position_mode_needs_a_position(press):
    with pytest.raises(ValueError, match="mode"):
        FalconTeleop(press, Puppet("rate"), mode="position")


def test_other_environments_are_refused():
    env = gym.make("CartPole-v1")
    with pytest.raises(TypeError, match="Spatula"):
        FalconTeleop(env, Puppet())
    env.close()


def test_buttons_are_taken_for_what_they_are_to_be(press):
    device = Puppet()
    teleop = begin(press, device, buttons={"forward": "center", "center": "finish"})
    device.buttons = {"center"}
    teleop.step()
    assert teleop.pressed == {"finish"}
    device.buttons = {"forward"}
    before = grip(press)
    for x in (0.01, 0.02):
        device.value = np.array([x, 0.0, 0.0])
        teleop.step()
    np.testing.assert_allclose(grip(press), before, atol=1e-8)


def test_a_button_that_a_device_does_not_have_is_refused(press):
    device = Puppet()
    device.button_names = ("center", "forward")
    with pytest.raises(ValueError, match=r"buttons of the puppet \(center, forward\), got \['front'\]"):
        FalconTeleop(press, device, buttons={"front": "finish"})


def test_the_operator_is_told_where_to_bring_the_grip_and_waited_for(press):
    device = Puppet()
    device.value = np.array([0.02, 0.0, -0.01])
    told, clock = [], {"now": 0.0}

    def sleep(duration):
        clock["now"] += duration
        device.value = 0.9 * device.value + 0.1 * np.array([0.01, -0.01, 0.03])

    teleop = FalconTeleop(
        press, device, real_time=False, centring=True, tell=told.append, now=lambda: clock["now"], sleep=sleep
    )
    teleop.reset(seed=0, options={"tool_position": (0.01, -0.01, 0.03)})
    assert told == [
        "Bring the grip 10 mm to the left and 10 mm towards you and 40 mm up; any button goes on from where it is."
    ]
    assert np.linalg.norm(device.value - [0.01, -0.01, 0.03]) < 0.006
    # Nothing jumps, and from there the whole workspace is in reach.
    before = grip(press)
    teleop.step()
    np.testing.assert_allclose(grip(press), before, atol=1e-8)


def test_a_slow_simulation_is_told_and_not_over_and_over(press):
    device = Puppet()
    told, clock = [], {"now": 0.0}

    def now():
        # Every look takes as long as three physics steps.
        clock["now"] += 3.0 / 240.0
        return clock["now"]

    teleop = FalconTeleop(press, device, tell=told.append, now=now, sleep=lambda _: None)
    teleop.reset(seed=0)
    for _ in range(10):
        teleop.step()
    assert len(told) == 1 + int(clock["now"] > 5.0)
    assert "0.17 of real time" in told[0]


def test_a_haptic_device_is_told_where_the_tool_follows(press):
    falcon = EmulatedFalcon(GuidedHand(lambda _: position_to_falcon((0.01, 0.0, 0.0))))
    device = HapticDevice(lambda: falcon, where="here", exchange=True)
    with device:
        teleop = FalconTeleop(press, device)
        teleop.reset(seed=0, options={"tool_position": (0.0, 0.0, 0.03)})
        teleop.step()
        low, high = press.unwrapped.reach
        offset = np.array([0.01, 0.0, -0.03])
        np.testing.assert_allclose(device._room, [low + offset, high + offset], atol=1e-4)
        assert low[2] < -0.02
        assert high[2] == pytest.approx(0.0508)


def test_a_policy_confines_no_hand(press):
    falcon = EmulatedFalcon(GuidedHand(lambda _: position_to_falcon((0.01, 0.0, 0.0))))
    device = HapticDevice(lambda: falcon, where="here", exchange=True)
    with device:
        teleop = FalconTeleop(press, device, intervention="button")
        teleop.reset(seed=0, options={"tool_position": (0.0, 0.0, 0.03)})
        action = np.zeros(3, dtype=np.float32)
        falcon.emulator.press(["center"])
        device.sleep(0.01)
        teleop.step(action)
        assert device._room is not None
        falcon.emulator.press([])
        device.sleep(0.01)
        teleop.step(action)
        assert device._room is None
