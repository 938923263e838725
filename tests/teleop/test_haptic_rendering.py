from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spatula_env.teleop.haptics import Contact, HapticSettings
from spatula_env.teleop.haptics.heartbeat import Heartbeat
from spatula_env.teleop.haptics.histogram import WIDTH, PeriodHistogram
from spatula_env.teleop.haptics.local_contact import LocalContact
from spatula_env.teleop.haptics.passivity import SEED, EnergyAccount
from spatula_env.teleop.haptics.rendering import ForceRenderer

PLAIN = HapticSettings(damping=0.0)
"""No damper, so that the force can be foretold."""
ORIGIN = (0.0, 0.0, 0.0)


def settle(renderer: ForceRenderer, contact: Contact, position=ORIGIN, velocity=ORIGIN, start=0.0, cycles=400):
    """The force after some cycles with a regular heartbeat."""
    force = ORIGIN
    for index in range(cycles):
        now = start + 1e-3 * index
        force = renderer.step(now, position, velocity, dataclasses.replace(contact, time=now))
    return np.array(force)


def test_the_contact_force_is_felt_scaled_and_in_its_direction():
    renderer = ForceRenderer(dataclasses.replace(PLAIN, force_scale=2.0))
    np.testing.assert_allclose(settle(renderer, Contact(0.0, None, (0.3, -0.4, 1.2))), [0.6, -0.8, 2.4], atol=1e-9)


def test_a_hand_ahead_of_the_tool_meets_a_spring_that_is_bounded_and_does_not_last():
    contact = Contact(0.0, ORIGIN, (0.0, 0.0, 1.0))
    # A hand that jumps gets more than the organ has stored: the account is to bear that.
    gains = dataclasses.replace(PLAIN, stiffness=60.0, energy_allowance=0.01)

    def after(height: float, cycles: int) -> float:
        renderer = ForceRenderer(gains)
        settle(renderer, contact)
        return float(settle(renderer, contact, position=(0.0, 0.0, height), start=0.4, cycles=cycles)[2])

    assert after(-0.001, 4) == pytest.approx(1.0 + 0.06, abs=0.002)
    assert after(-0.02, 4) == pytest.approx(1.0 + gains.lead + gains.least_lead)
    assert after(-0.001, 2000) == pytest.approx(1.0, abs=0.001)
    assert after(0.004, 4) == pytest.approx(1.0 - 0.24)
    assert after(0.004, 2000) == pytest.approx(1.0 - 0.24)


def test_to_the_side_there_is_a_spring_of_its_own():
    contact = Contact(0.0, ORIGIN, (0.0, 0.0, 1.0))
    renderer = ForceRenderer(PLAIN)
    force = settle(renderer, contact, position=(0.001, 0.0, 0.0))
    np.testing.assert_allclose(force, [-1e-3 * renderer.contact.side_stiffness, 0.0, 1.0], atol=1e-9)


def test_nothing_drags_where_nothing_is_touched():
    renderer = ForceRenderer(HapticSettings())
    moving = settle(renderer, Contact(0.0, ORIGIN, ORIGIN), position=(0.03, 0.0, 0.0), velocity=(0.2, 0.0, 0.0))
    np.testing.assert_array_equal(moving, 0.0)


def test_an_organ_does_not_pull():
    renderer = ForceRenderer(dataclasses.replace(PLAIN, stiffness=1000.0))
    found = settle(renderer, Contact(0.0, ORIGIN, (0.0, 0.0, 0.5)), position=(0, 0, 0.05))
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


def test_the_damper_resists_what_is_quick_and_not_what_goes_on():
    renderer = ForceRenderer(dataclasses.replace(PLAIN, damping=2.0, lead=10.0))
    contact = Contact(0.0, None, (0.0, 0.0, 1.0))
    settle(renderer, contact)
    first = renderer.step(0.4, ORIGIN, (0.0, 0.0, -0.02), dataclasses.replace(contact, time=0.4))
    assert first[2] == pytest.approx(1.0 + 0.04, abs=0.002)
    assert settle(renderer, contact, velocity=(0.0, 0.0, -0.02), start=0.401)[2] == pytest.approx(1.0, abs=1e-3)


def test_a_tremor_across_a_light_touch_does_not_push_on_average():
    """Along the force, the tremor makes and breaks contact; to the side it has another phase."""
    renderer = ForceRenderer(HapticSettings())
    shown, told = np.zeros(3), np.zeros(3)
    for index in range(4000):
        now = 1e-3 * index
        phase = 2.0 * math.pi * 10.0 * now
        x, z = 3e-4 * math.sin(phase + 2.1), 3e-4 * math.sin(phase)
        velocity = (3e-4 * 62.8 * math.cos(phase + 2.1), 0.0, 3e-4 * 62.8 * math.cos(phase))
        force = (-5.0 * x, 0.0, max(0.0, 0.004 - 15.0 * z))
        felt = renderer.step(now, (x, 0.0, z), velocity, Contact(now, (x, 0.0, z), force))
        if index >= 1000:
            shown += felt
            told += force
    np.testing.assert_allclose(shown, told, atol=0.05 * told[2])


@pytest.mark.parametrize(("greatest", "expected"), [(2.5, 2.5), (100.0, 8.0)])
def test_forces_are_limited_by_device_and_settings(greatest, expected):
    renderer = ForceRenderer(PLAIN, greatest_force=greatest)
    force = settle(renderer, Contact(0.0, None, (30.0, 0.0, 40.0)))
    np.testing.assert_allclose(force, np.array([0.6, 0.0, 0.8]) * expected)


def test_nothing_is_a_kick():
    """A force that comes and goes at once, and a release, never change by more than a limit in a millisecond."""
    renderer = ForceRenderer(PLAIN)
    forces = [ORIGIN]
    for index in range(900):
        now = 1e-3 * index
        told = (0.0, 0.0, 5.0 if 100 <= index % 300 < 200 else 0.0)
        contact = None if index >= 750 else Contact(now, None, told)
        forces.append(renderer.step(now, ORIGIN, ORIGIN, contact))
    steps = np.abs(np.diff(np.array(forces)[:, 2]))
    assert steps.max() <= renderer.greatest_force / PLAIN.ramp * 1e-3 + 1e-9
    assert steps[:750].max() <= PLAIN.slew * 1e-3 + 1e-9
    assert forces[200][2] == pytest.approx(5.0)
    assert 0.0 < forces[250][2] < 1.0
    assert forces[-1] == ORIGIN


def test_a_stall_ends_the_force_and_counts_once():
    renderer = ForceRenderer(PLAIN)
    contact = Contact(0.399, None, (0.0, 0.0, 2.0))
    settle(renderer, contact)
    forces = [renderer.step(0.4 + 1e-3 * index, ORIGIN, ORIGIN, contact)[2] for index in range(60)]
    assert all(force == pytest.approx(2.0, rel=1e-3) for force in forces[: int(1e3 * PLAIN.stall_time) - 2])
    assert all(force == 0.0 for force in forces[36:])
    assert (np.diff(forces) <= 1e-9).all()
    assert PLAIN.longest_stall + PLAIN.ramp < 0.05
    assert renderer.heartbeat.stalls == 1
    # And it comes back smoothly.
    first = renderer.step(0.46, ORIGIN, ORIGIN, Contact(0.46, None, (0.0, 0.0, 2.0)))
    assert 0.0 < first[2] < 0.1
    assert settle(renderer, Contact(0.0, None, (0.0, 0.0, 2.0)), start=0.461)[2] == pytest.approx(2.0, rel=1e-6)


def beat(heart: Heartbeat, pulse: float, seconds: float, start: float = 0.0) -> list[float]:
    """Results of `Heartbeat.listen`, once a millisecond, to a simulation with heartbeats of period `pulse` [s]."""
    return [
        heart.listen(now, 1e-3, start + math.floor((now - start) / pulse + 1e-9) * pulse)
        for now in start + 1e-3 * np.arange(round(1e3 * seconds))
    ]


def test_the_patience_follows_the_pulse_and_what_is_too_slow_is_not_felt():
    gains = HapticSettings()
    heart = Heartbeat(gains)
    assert beat(heart, 1.0 / 240.0, 1.0)[-1] == 1.0
    assert heart.pulse == pytest.approx(1.0 / 240.0, rel=0.1)
    # A third of real time is a pulse that the loop gets used to.
    lives = beat(heart, 0.0139, 2.0, start=1.0)
    assert min(lives[500:]) == 1.0
    assert not heart.is_slow
    slow = beat(heart, 0.05, 2.0, start=3.0)
    assert heart.is_slow
    assert max(slow[500:]) == 0.0
    assert beat(heart, 1.0 / 240.0, 1.0, start=5.0)[-1] == 1.0
    assert not heart.is_slow


def test_without_a_simulation_there_is_no_force():
    assert ForceRenderer(PLAIN).step(0.0, (0.01, 0.0, 0.0), (1.0, 0.0, 0.0), None) == ORIGIN


@pytest.mark.parametrize(("stiffness", "side"), [(45.0, 250.0), (200.0, 60.0)])
def test_stiffnesses_are_found_while_the_hand_trembles(stiffness, side):
    local = LocalContact(HapticSettings())
    for index in range(720):
        now = index / 240.0
        z = -0.01 + 3e-4 * math.sin(60.0 * now)
        x = 3e-4 * math.sin(71.0 * now + 1.0)
        local.hear(Contact(now, (x, 0.0, z), (-side * x, 0.0, -stiffness * z)))
    assert local.stiffness == pytest.approx(stiffness, rel=0.1)
    assert local.side_stiffness == pytest.approx(side, rel=0.15)


def test_what_is_matched_anew_teaches_nothing_about_the_organ():
    local, brought = LocalContact(HapticSettings()), 0.0
    for index in range(720):
        now = index / 240.0
        z = -0.01 + 3e-4 * math.sin(60.0 * now)
        # The hand was 20 mm farther in, once: its place jumps, and the tool's does not.
        shift = -0.02 if index >= 480 else 0.0
        brought += local.hear(Contact(now, (0.0, 0.0, z + shift), (0.0, 0.0, -45.0 * z), shift=(0.0, 0.0, shift)))
        local.follow(1.0 / 240.0, 60.0)
    assert local.stiffness == pytest.approx(45.0, rel=0.1)
    assert local.work - brought == pytest.approx(0.0, abs=3e-4)
    assert brought == pytest.approx(0.5 * 0.45**2 / HapticSettings().stiffness)
    assert abs(local.ahead((0.0, 0.0, z + shift))[2]) < 3e-4


def test_after_a_pause_in_which_the_hand_went_on_the_whole_force_is_back_with_the_ramp():
    renderer = ForceRenderer(PLAIN)
    contact = Contact(0.0, ORIGIN, (0.0, 0.0, 1.0))
    assert settle(renderer, contact)[2] == pytest.approx(1.0)
    farther = (0.0, 0.0, -0.02)
    for index in range(300):
        force = renderer.step(0.4 + 1e-3 * index, farther, ORIGIN, dataclasses.replace(contact, time=0.399))
    assert force == ORIGIN
    matched = dataclasses.replace(contact, position=farther, shift=farther)
    back = settle(renderer, matched, position=farther, start=0.7, cycles=round(1e3 * PLAIN.resume) + 2)
    assert back[2] == pytest.approx(1.0)


def give(account: EnergyAccount, energy: float):
    """Let the hand give energy, by one clear motion of 1 mm."""
    account.exchange(ORIGIN, ORIGIN, 0.0)
    account.exchange((0.0, 0.0, 1e3 * energy), (0.0, 0.0, -1e-3), 1e-3)
    account.exchange(ORIGIN, ORIGIN, 0.0)


def test_the_account_lets_go_what_it_cannot_bear():
    gains = HapticSettings(energy_allowance=1e-3, energy_leak=0.0, energy_hoard=1e-3)
    account = EnergyAccount(gains)
    assert account.allow(5e-4, 1e-3) == 1.0
    give(account, 2e-3)
    assert account.allow(3e-3, 1e-3) == 1.0
    give(account, -1e-3)
    for _ in range(10):
        share = account.allow(4e-3, 1e-3)
    assert share == pytest.approx((2e-3 + SEED) / 4e-3, rel=0.02)
    # Held on, it comes back slowly.
    for _ in range(3000):
        share = account.allow(4e-3, 1e-3)
    assert share == 1.0
    give(account, -2e-3)
    for _ in range(10):
        share = account.allow(4e-3, 1e-3)
    assert share <= 2.0 * SEED / 4e-3 + 1e-9
    assert account.balance == pytest.approx(-1e-3)
    # Nothing is hoarded, and a debt is no one's to forget at once.
    give(account, 1.0)
    account.allow(0.0, 1e-3)
    assert account.content <= 2.0 * 4e-3 + 1e-3
    give(account, -1.0)
    debt = account.content
    account.begin()
    assert account.content == debt < 0.0


@pytest.mark.parametrize("lag", [0, 1, 2])
def test_an_encoder_between_two_counts_exchanges_no_energy(lag):
    """A force that follows the count late seems to do work on a hand that rests."""
    account = EnergyAccount(HapticSettings(energy_leak=0.0))
    give(account, 1e-3)
    balance = account.balance
    counts = [index // 3 % 2 for index in range(5000)]
    for index, count in enumerate(counts):
        force = 1.0 - 0.02 * (counts[max(0, index - lag)])
        account.exchange((0.0, 0.0, force), (0.0, 0.0, 3e-5 * count), 1e-3)
    # At most what a single count holds.
    assert abs(account.balance - balance) <= 3.1e-5


@given(
    steps=st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3), st.integers(-2, 2)), min_size=1, max_size=60),
    force=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
)
def test_the_account_of_a_constant_force_depends_on_the_ends_alone(steps, force):
    account, place = EnergyAccount(HapticSettings(energy_leak=0.0)), (0.0, 0.0, 0.0)
    account.exchange(force, place, 1e-3)
    for step in steps:
        place = tuple(np.add(place, 3e-5 * np.array(step)).tolist())
        account.exchange(force, place, 1e-3)
    assert account.balance == pytest.approx(-np.dot(force, place), abs=1e-12)


def test_what_moves_clearly_and_comes_back_is_booked():
    account = EnergyAccount(HapticSettings(energy_leak=0.0))
    account.exchange(ORIGIN, ORIGIN, 1e-3)
    for index in range(1, 11):
        account.exchange((0.0, 0.0, 1.0), (0.0, 0.0, -2e-5 * index), 1e-3)
    for index in reversed(range(10)):
        account.exchange((0.0, 0.0, 3.0), (0.0, 0.0, -2e-5 * index), 1e-3)
    assert account.balance == pytest.approx(-4e-4)


def test_an_organ_that_swings_against_the_tool_gives_no_more_than_the_allowance():
    """An organ that returns faster than it was pressed does work that nobody gave it."""
    gains = HapticSettings(damping=0.0)
    renderer = ForceRenderer(gains)
    energy, place = 0.0, 0.0
    for index in range(400):
        pushed = min(1.0, index / 20)
        moved = 4e-5 * min(index, 20) if index < 20 else 0.0
        last, place = place, place - moved if index < 20 else place + 1e-4
        told = Contact(1e-3 * index, (0.0, 0.0, place), (0.0, 0.0, pushed))
        force = renderer.step(1e-3 * index, (0.0, 0.0, place), ORIGIN, told)
        energy += force[2] * (place - last)
    assert energy <= gains.energy_allowance + 1.5e-4


@pytest.mark.parametrize("stiffness", [40.0, 90.0])
def test_jumps_of_a_count_teach_nothing_about_the_organ(stiffness):
    """An organ answers a jump several times as stiffly as a slow motion, by its inertia and the contact's friction."""
    model = LocalContact(PLAIN)
    for index in range(2000):
        depth = 1e-5 * min(index, 500)
        model.hear(Contact(index / 240, (0.0, 0.0, -depth), (0.0, 0.0, stiffness * depth)))
    known = model.stiffness
    assert known == pytest.approx(stiffness, rel=0.05)
    for index in range(2000, 9000):
        jump = 3e-5 * (index // 4 % 2)
        told = stiffness * 5e-3 + 5.0 * stiffness * jump
        model.hear(Contact(index / 240, (0.0, 0.0, -5e-3 - jump), (0.0, 0.0, told)))
    assert model.stiffness == pytest.approx(known, rel=1e-6)


@settings(max_examples=30, deadline=None)
@given(
    delay=st.integers(0, 80),
    stiffness=st.floats(20.0, 1500.0),
    amplitude=st.floats(0.002, 0.02),
    half_period=st.integers(84, 1667),
)
def test_a_late_organ_gives_no_energy_to_the_hand(delay, stiffness, amplitude, half_period):
    """A spring whose force is told late gives a guided hand energy in every cycle; the loop must not."""
    period = 2 * half_period
    cycles = math.ceil(2000 / period)
    gains = HapticSettings(damping=0.0)
    renderer = ForceRenderer(gains)
    given_energy = greatest_energy = 0.0
    acting = force = 0.0
    fastest = 2.0 * math.pi * amplitude / (1e-3 * period)

    def position(index):
        return -amplitude * math.sin(2.0 * math.pi * index / period)

    for index in range(cycles * period):
        now = 1e-3 * index
        place = position(index - delay)
        told = min(gains.greatest_force, stiffness * max(0.0, -place))
        here, last = position(index), position(index - 1)
        given_energy += acting * (here - last)
        greatest_energy = max(greatest_energy, given_energy)
        acting = force
        velocity = (here - last) / 1e-3
        contact = Contact(now, (0.0, 0.0, place), (0.0, 0.0, told))
        force = renderer.step(now, (0, 0, here), (0, 0, velocity), contact)[2]
    # The allowances, and what a force does on its way to zero: it does not end at once, so that nothing is a kick.
    largest = min(stiffness * amplitude, gains.greatest_force)
    to_zero = largest / (gains.greatest_force / gains.ramp) + 3e-3
    assert greatest_energy <= gains.energy_allowance + 2.5e-5 * cycles + largest * fastest * to_zero


@pytest.mark.parametrize("mass, spring, damper", [(0.15, 100.0, 2.0), (0.29, 300.0, 6.0), (1.0, 1000.0, 20.0)])
def test_who_is_coupled_to_a_loaded_tool_feels_it_and_gets_no_more_than_the_organ_has_stored(mass, spring, damper):
    organ, scale, depth, step = 60.0, 4.0, 0.01, 1e-3
    renderer, time = ForceRenderer(HapticSettings(force_scale=scale)), 0.0

    def hold(cycles: int, place: float, velocity: float, coupled: bool) -> tuple[float, float, float, float]:
        """Hand's place, velocity, the energy that it was given and the last force, with the tool `depth` below it."""
        nonlocal time
        given, felt = 0.0, 0.0
        for cycle in range(cycles):
            tool = place - depth
            force = (0.0, 0.0, organ * max(0.0, -tool))
            told = Contact(time - step * (cycle % 4), (0.0, 0.0, place), force, shift=(0.0, 0.0, depth))
            if not coupled:
                told = Contact(time, None, ORIGIN)
            felt = renderer.step(time, (0.0, 0.0, place), (0.0, 0.0, velocity), told)[2]
            velocity += step / mass * (felt - spring * place - damper * velocity)
            place, time, given = place + step * velocity, time + step, given + felt * velocity * step
        return place, velocity, given, felt

    place, velocity = 0.0, 0.0
    for _ in range(3):
        place, velocity, given, felt = hold(800, place, velocity, True)
        assert felt == pytest.approx(scale * organ * (depth - place), rel=0.05)
        assert given <= 0.5 * scale * organ * depth**2 + renderer.settings.energy_allowance
        place, velocity, _, felt = hold(800, place, velocity, False)
        assert felt == 0.0


@pytest.mark.parametrize("size", [1e5, 1e160, 1e308])
def test_an_absurd_force_is_the_greatest_and_passes(size):
    renderer = ForceRenderer(HapticSettings(force_scale=4.0))
    force = settle(renderer, Contact(0.0, ORIGIN, (0.0, 0.0, size)))
    assert np.linalg.norm(force) <= renderer.greatest_force + 1e-9
    assert np.isfinite(renderer.account.content)
    np.testing.assert_array_equal(settle(renderer, Contact(0.0, ORIGIN, ORIGIN), start=0.4), ORIGIN)


def test_periods_are_counted_in_a_place_that_does_not_grow():
    histogram = PeriodHistogram()
    assert histogram.quantile(0.5) == 0.0
    for period in [1.04e-3] * 98 + [3e-3, 0.4]:
        histogram.add(period)
    histogram.add(-1.0)
    assert histogram.count == 101
    assert histogram.longest == 0.4
    assert histogram.quantile(0.5) == pytest.approx(1.04e-3, abs=1.01 * WIDTH)
    assert histogram.quantile(0.99) == pytest.approx(3e-3, abs=1.01 * WIDTH)
    assert histogram.quantile(1.0) == 0.4


@pytest.mark.parametrize(
    ("name", "value"),
    [("stiffness", -1.0), ("damping", math.nan), ("cutoff", 600.0), ("stall_time", 0.001), ("slew", 0.0)],
)
def test_settings_name_what_is_wrong(name, value):
    with pytest.raises(ValueError, match=name):
        HapticSettings(**{name: value})


def test_soft_walls_where_the_workspace_and_the_tool_end():
    gains = dataclasses.replace(PLAIN, wall_stiffness=200.0, wall_force=2.0)
    box = ((-0.04, -0.04, -0.04), (0.04, 0.04, 0.04))
    contact = Contact(0.0, None, ORIGIN, (-0.1, -0.1, -0.01), (0.1, 0.1, 0.1))

    def at(place, told=contact):
        return settle(ForceRenderer(gains, 8.0, 3000.0, 20.0, *box), told, position=place)

    np.testing.assert_array_equal(at((0.03, -0.03, 0.02)), 0.0)
    np.testing.assert_allclose(at((0.045, 0.0, 0.0)), [-1.0, 0.0, 0.0])
    # The tool's own room is smaller below, and the walls yield in the end.
    np.testing.assert_allclose(at((0.0, 0.0, -0.014)), [0.0, 0.0, 0.8])
    np.testing.assert_allclose(at((0.0, 0.0, -0.039)), [0.0, 0.0, 2.0])
    np.testing.assert_array_equal(at((0.0, 0.0, -0.014), Contact(0.0, None, ORIGIN)), 0.0)
