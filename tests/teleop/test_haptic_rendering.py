from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spatula_env.teleop.haptics import Contact, HapticSettings
from spatula_env.teleop.haptics.rendering import EnergyTank, ForceRenderer

PLAIN = HapticSettings(damping=0.0, tank_start=1.0)
"""A tank that is never empty, and no damper, so that the force can be foretold."""
ORIGIN = (0.0, 0.0, 0.0)


def settle(renderer: ForceRenderer, contact: Contact, position=ORIGIN, velocity=ORIGIN, start=0.0, cycles=400):
    """The force after some cycles with a heart that beats."""
    force = ORIGIN
    for index in range(cycles):
        now = start + 1e-3 * index
        force = renderer.step(now, position, velocity, dataclasses.replace(contact, time=now))
    return np.array(force)


def test_the_contact_force_is_felt_scaled_and_in_its_direction():
    renderer = ForceRenderer(dataclasses.replace(PLAIN, force_scale=2.0))
    np.testing.assert_allclose(settle(renderer, Contact(0.0, None, (0.3, -0.4, 1.2))), [0.6, -0.8, 2.4], atol=1e-9)


def test_a_force_is_filtered_at_the_cutoff():
    renderer = ForceRenderer(dataclasses.replace(PLAIN, cutoff=10.0))
    cycles = round(1e3 / (2.0 * math.pi * 10.0))
    assert settle(renderer, Contact(0.0, None, (0.0, 0.0, 1.0)), cycles=cycles)[2] == pytest.approx(
        1 - 1 / math.e, abs=0.01
    )


def test_a_hand_ahead_of_the_tool_meets_a_spring():
    contact = Contact(0.0, ORIGIN, (0.0, 0.0, 1.0))
    renderer = ForceRenderer(dataclasses.replace(PLAIN, stiffness=150.0))
    ahead = settle(renderer, contact, position=(0.0, 0.0, -0.004))
    behind = settle(ForceRenderer(dataclasses.replace(PLAIN, stiffness=150.0)), contact, position=(0.0, 0.0, 0.004))
    assert ahead[2] == pytest.approx(1.0 + 0.6)
    assert behind[2] == pytest.approx(1.0 - 0.6)


def test_the_spring_acts_along_the_force_only():
    renderer = ForceRenderer(PLAIN)
    force = settle(renderer, Contact(0.0, ORIGIN, (0.0, 0.0, 1.0)), position=(0.01, -0.02, 0.0))
    np.testing.assert_allclose(force, [0.0, 0.0, 1.0], atol=1e-9)


def test_nothing_drags_where_nothing_is_touched():
    renderer = ForceRenderer(HapticSettings(tank_start=1.0))
    moving = settle(renderer, Contact(0.0, ORIGIN, ORIGIN), position=(0.03, 0.0, 0.0), velocity=(0.2, 0.0, 0.0))
    np.testing.assert_array_equal(moving, 0.0)


def test_an_organ_does_not_pull():
    renderer = ForceRenderer(dataclasses.replace(PLAIN, stiffness=1000.0))
    np.testing.assert_array_equal(settle(renderer, Contact(0.0, ORIGIN, (0.0, 0.0, 0.5)), position=(0, 0, 0.05)), 0.0)


def test_the_damper_resists_the_hand():
    contact = Contact(0.0, None, (0.0, 0.0, 1.0))
    renderer = ForceRenderer(dataclasses.replace(PLAIN, damping=5.0))
    assert settle(renderer, contact, velocity=(0.0, 0.0, -0.1))[2] == pytest.approx(1.5)


@pytest.mark.parametrize(("greatest", "expected"), [(2.5, 2.5), (100.0, 8.0)])
def test_forces_are_limited_by_device_and_settings(greatest, expected):
    renderer = ForceRenderer(PLAIN, greatest_force=greatest)
    force = settle(renderer, Contact(0.0, None, (30.0, 0.0, 40.0)))
    np.testing.assert_allclose(force, np.array([0.6, 0.0, 0.8]) * expected)


def test_the_device_limits_stiffness_and_damping():
    renderer = ForceRenderer(HapticSettings(stiffness=900.0, force_scale=5.0, damping=50.0), 8.0, 3000.0, 20.0)
    assert (renderer.stiffness, renderer.damping) == (3000.0, 20.0)


def test_a_stall_ends_the_force_and_counts_once():
    renderer = ForceRenderer(PLAIN)
    contact = Contact(0.399, None, (0.0, 0.0, 2.0))
    settle(renderer, contact)
    forces = [renderer.step(0.4 + 1e-3 * index, ORIGIN, ORIGIN, contact)[2] for index in range(40)]
    silent = [0.001 + 1e-3 * index for index in range(40)]
    stall = PLAIN.stall_time
    assert all(
        force == pytest.approx(2.0, rel=1e-6) for force, age in zip(forces, silent, strict=True) if age < stall / 2
    )
    assert all(force == 0.0 for force, age in zip(forces, silent, strict=True) if age >= stall)
    assert (np.diff(forces) <= 1e-9).all()
    assert stall < 0.02
    assert renderer.stalls == 1


def test_after_a_stall_the_force_comes_back_smoothly():
    renderer = ForceRenderer(PLAIN)
    settle(renderer, Contact(0.0, None, (0.0, 0.0, 2.0)))
    for index in range(30):
        renderer.step(0.4 + 1e-3 * index, ORIGIN, ORIGIN, Contact(0.399, None, (0.0, 0.0, 2.0)))
    first = renderer.step(0.43, ORIGIN, ORIGIN, Contact(0.43, None, (0.0, 0.0, 2.0)))
    assert 0.0 < first[2] < 0.5
    assert settle(renderer, Contact(0.0, None, (0.0, 0.0, 2.0)), start=0.431)[2] == pytest.approx(2.0, rel=1e-6)


def test_without_a_simulation_there_is_no_force():
    assert ForceRenderer(PLAIN).step(0.0, (0.01, 0.0, 0.0), (1.0, 0.0, 0.0), None) == ORIGIN


def test_the_tank_gives_back_what_it_got_and_no_more():
    tank = EnergyTank(HapticSettings(tank_soft=1e-3, tank_size=0.01, tank_margin=0.5))
    assert tank.share() == 0.0
    tank.exchange(0.0005)
    assert tank.share() == pytest.approx(0.5)
    tank.exchange(1.0)
    assert tank.content == 0.01
    tank.exchange(-0.02)
    assert tank.share() == 0.0
    tank.begin()
    assert tank.content == pytest.approx(0.01 - 1.5 * 0.02)
    assert tank.balance == pytest.approx(1.0005 - 0.02)


@settings(max_examples=30, deadline=None)
@given(
    delay=st.integers(0, 80),
    stiffness=st.floats(20.0, 1500.0),
    amplitude=st.floats(0.002, 0.02),
    half_period=st.integers(84, 1667),
)
def test_a_late_organ_gives_no_energy_to_the_hand(delay, stiffness, amplitude, half_period):
    """A spring whose force is told late gives a guided hand energy in every cycle; the loop must not."""
    # In milliseconds. An even number of them to the period makes the sum below exact.
    period = 2 * half_period
    cycles = math.ceil(2000 / period)
    frequency = 1e3 / period
    gains = HapticSettings(stiffness=0.0, damping=0.0)
    renderer = ForceRenderer(gains)
    given_energy = greatest_energy = late_energy = 0.0
    force, acting = 0.0, 0.0
    largest = min(stiffness * amplitude, gains.greatest_force)

    def position(index):
        return -amplitude * math.sin(2.0 * math.pi * index / period)

    for index in range(cycles * period):
        now = 1e-3 * index
        told = stiffness * max(0.0, -position(index - delay))
        here, last = position(index), position(index - 1)
        given_energy += acting * (here - last)
        greatest_energy = max(greatest_energy, given_energy)
        late_energy += told * (here - last)
        velocity = (here - last) / 1e-3
        acting = force
        force = renderer.step(now, (0, 0, here), (0, 0, velocity), Contact(now, None, (0.0, 0.0, told)))[2]
    # What the last millisecond's force can do before the account knows of it.
    assert greatest_energy <= largest * 2e-3 * 2 * math.pi * frequency * amplitude + 1e-9
    # The integral of k max(0, A sin(w t - w d)) times -A w cos(w t) over a period is k A^2 sin(w d) pi / 2. In steps of
    # a millisecond, with the force at the end of each, it is what follows, and tends to that: energy is lost without a
    # delay, and won with a delay between half a step and half a period.
    per_cycle = stiffness * amplitude**2 * 0.5 * period * math.sin(math.pi / period)
    per_cycle *= math.sin(2.0 * math.pi * (delay - 0.5) / period)
    assert late_energy == pytest.approx(cycles * per_cycle, rel=1e-9)
    assert (late_energy > 0.0) == (delay > 0)


@pytest.mark.parametrize(
    ("name", "value"),
    [("stiffness", -1.0), ("damping", math.nan), ("cutoff", 600.0), ("stall_time", 0.001), ("tank_soft", 0.0)],
)
def test_settings_name_what_is_wrong(name, value):
    with pytest.raises(ValueError, match=name):
        HapticSettings(**{name: value})
