"""A known weight tells how great the forces are."""

from __future__ import annotations

import dataclasses

import pytest

from spatula_env.teleop import DeviceError
from spatula_env.teleop.emulator import ElasticHand, Mechanism
from spatula_env.teleop.falcon.weighing import GRAVITY, weigh
from spatula_env.teleop.scripted import EmulatedFalcon

GRIP = Mechanism(weight=0.9, coulomb=0.0, viscous=1.0, mode=0.0)


def hanging(strength: float) -> EmulatedFalcon:
    mechanism = dataclasses.replace(GRIP, strength=strength)
    return EmulatedFalcon(ElasticHand(stiffness=0.0, damping=1.0, mass=0.2), mechanism=mechanism)


def test_a_weight_tells_the_factor():
    falcon = hanging(0.8)

    def hang(_: str) -> bool:
        hand = falcon.emulator.hand
        hand.mechanism = dataclasses.replace(hand.mechanism, weight=GRIP.weight + 0.15 * GRAVITY)
        return True

    said = []
    with falcon:
        falcon.exchange()
        found = weigh(falcon, 0.15, said.append, hang)
    assert found.factor == pytest.approx(0.8, rel=0.04)
    assert found.grip == pytest.approx(GRIP.weight / 0.8, rel=0.05)
    assert len(said) == 1


def test_what_tells_nothing_is_refused():
    with hanging(1.0) as falcon:
        falcon.exchange()
        with pytest.raises(ValueError, match="mass"):
            weigh(falcon, 2.0, print, lambda _: True)
        with pytest.raises(DeviceError, match="no more with the weight"):
            weigh(falcon, 0.1, print, lambda _: True)
