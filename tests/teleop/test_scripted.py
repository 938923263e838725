from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import spatula_env
from spatula_env.teleop.registry import DEVICES, make_device
from spatula_env.teleop.scripted import ScriptedFalcon, ScriptedOperator, Tremor, device_position
from spatula_env.teleop.session import run_episode
from spatula_env.teleop.wrapper import FalconTeleop

assert spatula_env.TASKS


@pytest.fixture(scope="module")
def press():
    env = gym.make("Spatula/Press-v0", max_episode_steps=30)
    yield env
    env.close()


@pytest.fixture(scope="module")
def clamp():
    env = gym.make("Spatula/Clamp-v0", max_episode_steps=20)
    yield env
    env.close()


def sideways(_) -> np.ndarray:
    return np.array([0.5, 0.0, 0.0])


def actions(env, device, steps) -> np.ndarray:
    teleop = FalconTeleop(env, device, real_time=False)
    _, info = teleop.reset(seed=0)
    assert info["acted_by"] == "scripted"
    return np.stack([teleop.step()[-1]["action"] for _ in range(steps)])


def test_a_policy_acts_and_is_labelled_scripted(press):
    with ScriptedOperator(sideways) as device:
        np.testing.assert_allclose(actions(press, device, 3), [[0.5, 0.0, 0.0]] * 3)


def test_the_policy_sees_the_newest_observation(press):
    seen = []

    def look(observation):
        seen.append(observation)
        return np.zeros(3)

    with ScriptedOperator(look) as device:
        teleop = FalconTeleop(press, device, real_time=False)
        observations = [teleop.reset(seed=0)[0]] + [teleop.step()[0] for _ in range(2)]
    np.testing.assert_array_equal(seen, observations)


def test_an_operator_reacts_late(press):
    count = iter(range(100))
    with ScriptedOperator(lambda _: np.array([0.1 * (1 + next(count)), 0.0, 0.0]), reaction_delay=0.1) as device:
        found = actions(press, device, 5)
        np.testing.assert_allclose(found[:, 0], [0.0, 0.0, 0.1, 0.2, 0.3], atol=1e-6)
        # What was wanted in the last episode is not done in this one.
        assert actions(press, device, 1)[0, 0] == 0.0


def test_gain(press):
    with ScriptedOperator(sideways, gain=0.4) as device:
        assert actions(press, device, 1)[0, 0] == pytest.approx(0.2)


def test_tremor_is_that_of_the_generator_and_as_strong_as_asked():
    first, second, other = (Tremor(0.03, np.random.default_rng(seed)) for seed in (5, 5, 6))
    values = np.array([first.step(0.001) for _ in range(20_000)])
    np.testing.assert_array_equal(values[:50], [second.step(0.001) for _ in range(50)])
    assert not np.array_equal(values[0], other.step(0.001))
    assert values.std() == pytest.approx(0.03, rel=0.1)
    spectrum = np.abs(np.fft.rfft(values[:, 0])) ** 2
    frequencies = np.fft.rfftfreq(len(values), 0.001)
    near = (frequencies > 4.0) & (frequencies < 16.0)
    assert spectrum[near].sum() > 0.7 * spectrum.sum()


def test_further_numbers_of_an_action(clamp):
    with ScriptedOperator(lambda _: np.array([0.0, 0.0, 0.0, -0.3])) as device:
        np.testing.assert_allclose(actions(clamp, device, 1)[0], [0.0, 0.0, 0.0, -0.3], atol=1e-6)


def test_the_same_hand_moves_a_falcon(press):
    """The tool goes as far as the policy wants, by way of mechanism, packets, driver and loop."""
    found = []
    for _ in range(2):
        with ScriptedFalcon(sideways, np.random.default_rng(1), tremor=0.05) as device:
            teleop = FalconTeleop(press, device)
            teleop.reset(seed=0, options={"tool_position": (0.0, 0.0, 0.03)})
            for _ in range(12):
                teleop.step()
            found.append(press.unwrapped._episodes.situation.tool_position[0])
    np.testing.assert_array_equal(found[0], found[1])
    assert found[0][0] == pytest.approx(11 * 0.05 * 0.05, abs=0.006)


def test_a_falcon_goes_further_than_it_reaches_by_its_clutch(press):
    with ScriptedFalcon(lambda _: np.array([1.0, 0.0, 0.0])) as device:
        teleop = FalconTeleop(press, device)
        teleop.reset(seed=0, options={"tool_position": (-0.05, 0.0, 0.03)})
        clutched, reach = 0, 0.0
        for _ in range(30):
            teleop.step()
            clutched += "center" in teleop.pressed
            reach = max(reach, float(np.abs(device_position(device._falcon.emulator)).max()))
        assert 0 < clutched < 15
        assert reach < 0.045
        assert press.unwrapped._episodes.situation.tool_position[0, 0] > 0.02


def test_buttons_are_right_on_average(clamp):
    with ScriptedFalcon(lambda _: np.array([0.0, 0.0, 0.0, -0.3])) as device:
        found = actions(clamp, device, 20)[:, 3]
    # A button is seen a packet later, and so a physics step into the control step.
    assert ((found <= 0.0) & (found >= -1.0)).all()
    assert found.mean() == pytest.approx(-0.3, abs=0.06)


@pytest.mark.parametrize("options", [{"tremor": -1.0}, {"reaction_delay": np.inf}, {"gain": 0.0}])
def test_arguments(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        ScriptedOperator(sideways, **options)


@pytest.mark.parametrize("name", DEVICES)
def test_devices_by_name(name):
    device = make_device(name, policy=sideways)
    assert not device.is_open
    assert device.kind in ("position", "rate")


def test_unknown_devices_and_missing_policies():
    with pytest.raises(ValueError, match=r"device must be one of .*'falcon'"):
        make_device("omega")
    with pytest.raises(ValueError, match="needs a policy"):
        make_device("scripted")


def test_an_episode_with_a_policy_that_is_helped(press):
    """The session says how much was the operator's."""
    from teleop_helpers import Puppet

    device = Puppet("rate")
    teleop = FalconTeleop(press, device, real_time=False, intervention="motion", release_time=0.1)
    times = []

    def push(_, info):
        times.append(info["time"])
        device.value = np.full(3, 0.4 if 0.2 < info["time"] < 0.5 else 0.0)

    summary = run_episode(teleop, seed=4, policy=lambda _: np.zeros(3), after_step=push)
    assert (summary.steps, summary.seed, summary.kept) == (30, 4, True)
    assert 0.1 < summary.operator_share < 0.4
    assert len(times) == 31


def test_buttons_end_an_episode_once(press):
    from teleop_helpers import Puppet

    device = Puppet("rate")
    teleop = FalconTeleop(press, device, real_time=False)

    def discard(_, info):
        device.buttons = frozenset({"discard"} if info["time"] > 0.32 else ())

    first = run_episode(teleop, after_step=discard)
    assert (first.steps, first.kept, first.quit) == (8, False, False)
    # The button is still down when the next one begins.
    device.buttons = frozenset({"discard"})
    second = run_episode(teleop, after_step=lambda *_: None)
    assert (second.steps, second.kept) == (30, True)
