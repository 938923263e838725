"""A device with weight, friction and compliant links, and the loop's compensation of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from spatula_env.teleop.emulator import ElasticHand, HandOnMechanism, Mechanism
from spatula_env.teleop.falcon.frames import direction_to_device
from spatula_env.teleop.haptics import HapticDevice, HapticSettings
from spatula_env.teleop.scripted import EmulatedFalcon

RIGID = Mechanism(weight=0.0, coulomb=0.0, viscous=0.0, mode=0.0)


def free_hand() -> ElasticHand:
    return ElasticHand(stiffness=0.0, damping=0.0, mass=0.1)


def test_a_grip_falls_and_friction_slows_it():
    falling = HandOnMechanism(free_hand(), Mechanism(weight=0.5, coulomb=0.0, viscous=0.0, mode=0.0))
    rubbing = HandOnMechanism(free_hand(), Mechanism(weight=0.5, coulomb=0.0, viscous=5.0, mode=0.0))
    held = HandOnMechanism(free_hand(), Mechanism(weight=0.1, coulomb=0.3, viscous=0.0, mode=0.0))
    for index in range(60):
        for hand in (falling, rubbing, held):
            hand.advance(1e-3 * index, 1e-3, (0.0, 0.0, 0.0))
    assert falling.velocity[1] == pytest.approx(-5.0 * 0.06, rel=1e-6)
    assert -0.11 < rubbing.velocity[1] < -0.05
    assert abs(held.velocity[1]) < 2e-3


def test_links_swing_at_their_mode():
    mechanism = Mechanism(weight=0.0, coulomb=0.0, viscous=0.0, mode=60.0, damping_ratio=0.02)
    # A hand that stands still, nearly.
    hand = HandOnMechanism(ElasticHand(mass=1e6, stiffness=0.0, damping=0.0), mechanism)
    places = []
    for index in range(400):
        hand.advance(1e-3 * index, 1e-3, (0.0, 0.0, 1.0 if index < 5 else 0.0))
        places.append(hand.position[2] - 0.12)
    spectrum = np.abs(np.fft.rfft(np.array(places)[5:] * np.hanning(395)))
    assert np.fft.rfftfreq(395, 1e-3)[spectrum.argmax()] == pytest.approx(60.0, abs=4.0)


def test_a_mechanism_that_does_nothing_changes_nothing():
    plain, wrapped = ElasticHand(), HandOnMechanism(ElasticHand(), RIGID)
    for index in range(100):
        force = (0.0, math.sin(0.1 * index), 0.0)
        plain.advance(1e-3 * index, 1e-3, force)
        wrapped.advance(1e-3 * index, 1e-3, force)
    np.testing.assert_allclose(wrapped.position, plain.position, atol=1e-5)
    assert wrapped.energies.motors == pytest.approx(plain.energies.motors, rel=0.05)


@pytest.mark.parametrize(("name", "value"), [("weight", -1.0), ("mode", math.inf), ("mass", 0.0)])
def test_values_are_checked(name, value):
    with pytest.raises(ValueError, match=name):
        Mechanism(**{name: value})


def test_the_motors_bear_the_grip_while_the_simulation_goes_on():
    falcon = EmulatedFalcon(ElasticHand(stiffness=0.0, damping=1.0), mechanism=Mechanism(weight=0.8))
    settings = HapticSettings(weight=0.8, friction=0.1)
    device = HapticDevice(lambda: falcon, settings, where="here", exchange=True)
    with device:
        for _ in range(240):
            device.tell((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
            device.sleep(1.0 / 240.0)
        np.testing.assert_allclose(direction_to_device(falcon.emulator.motor_force), [0.0, 0.0, 0.8], atol=0.06)
        assert np.linalg.norm(falcon.emulator.hand.velocity) < 0.02
        # It is no part of the account of energy.
        assert device.statistics().balance == 0.0
        assert device.renderer is not None
        assert device.renderer.support[2] == pytest.approx(0.8, abs=0.05)
        device.release()
        device.sleep(0.04)
        assert not any(falcon.emulator.program.motors)
