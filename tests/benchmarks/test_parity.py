"""The tools that compare the batch engine with PyBullet: do they detect differences, and only where there are any?"""

from __future__ import annotations

import dataclasses
import functools
import json

import numpy as np
import pytest

from benchmarks import parity
from spatula_env import scenes

pytestmark = pytest.mark.bullet

SCENE = scenes.seed()
short_press = functools.partial(parity.press, depth=0.1, hold=0.05, worlds=3)


def heavier(scene, factor):
    (placed,) = scene.organs
    return dataclasses.replace(scene, organs=(dataclasses.replace(placed, mass=factor * placed.mass),))


def test_a_free_body_follows_bullet():
    result = parity.free_body(SCENE, 12)
    assert result["passed"] and 0.0 < result["difference_u"]["double"] < 1e-8
    assert (
        result["difference_u"]["double"] < result["difference_u"]["bullet_rounded"] < result["difference_u"]["single"]
    )
    assert list(result["difference_by_step_u"]["single"]) == ["1", "10"]
    assert result["deformation_u"] > 1e-3


def test_a_fall_follows_bullet_onto_the_ground():
    result = parity.rest(SCENE, 45, 0.1)
    assert result["passed"] and result["difference_u"]["double"] < 1e-7
    # It falls for 0.14 s of 0.19 s.
    assert 0.1 < result["ground_share"] < 0.4
    assert result["greatest_ground_force"] > 100.0
    assert 0.1 < result["speed_at_end"] < 2.0
    for name, greatest in result["difference_u"].items():
        assert 0.0 < result["difference_at_end_u"][name] <= greatest


def test_who_lies_stays():
    result = parity.rest(SCENE, 5, 0.0)
    assert result["passed"] and result["ground_share"] == 1.0
    assert result["greatest_ground_force"] == pytest.approx(100.0, rel=0.01)
    assert result["speed_at_end"] < 0.01


def test_another_gravity_shows_in_a_fall():
    result = parity.rest(SCENE, 30, 0.1, batch_scene=dataclasses.replace(SCENE, gravity=1.02 * SCENE.gravity))
    assert not result["passed"]
    # 2 % of what a body falls in 30 steps.
    expected = 0.5 * 0.02 * SCENE.gravity * (30 * SCENE.dt) ** 2
    assert result["difference_at_end_u"]["double"] == pytest.approx(expected, rel=0.1)


@pytest.fixture(scope="module")
def pressed():
    return short_press(SCENE)


def test_a_press_follows_bullet(pressed):
    assert pressed["passed"]
    assert pressed["steps"] == 60 and 0.3 < pressed["contact_share"] < 1.0
    assert pressed["greatest_force"] > 100.0
    for name in ("bullet_rounded", "double", "single"):
        assert 0.0 < pressed["force_difference_mean"][name] < pressed["force_difference"][name] < 0.02
        assert pressed["force_difference_hold"][name] <= pressed["force_difference"][name]
        assert 0.0 < pressed["difference_u"][name] < 0.02


def test_a_world_among_others_is_a_simulation(pressed):
    for name in ("double", "single"):
        assert pressed["batch_simulation"][name]["equal"]


def test_another_mass_shows_in_a_press():
    result = short_press(SCENE, batch_scene=heavier(SCENE, 1.1))
    assert not result["passed"]
    assert result["force_difference"]["double"] > parity.FORCE_LIMIT
    # The worlds of the batch engine have the same mass as its simulation.
    assert all(row["passed"] for row in result["batch_simulation"].values())


def test_the_last_bit_shows():
    velocities = parity.press_velocities(SCENE.dt, 0.12, 0.0)[:4]
    place = np.array([0.0, 0.0, 7.0])
    simulation = parity.Simulation(SCENE, engine="batch", precision="double")
    simulation.place_tool(place)
    path = parity._follow(simulation, velocities)
    compare = functools.partial(parity._compare_world, SCENE, place, velocities, 2, np.float64)
    assert compare(path)["equal"]
    path.nodes[2, 17, 1] = np.nextafter(path.nodes[2, 17, 1], np.inf)
    row = compare(path)
    assert not row["equal"] and not row["passed"]


def test_a_press_goes_down_and_up_again():
    velocities = parity.press_velocities(0.01, 0.5, 0.1)
    assert velocities.shape == (60, 3) and not velocities[:, :2].any()
    heights = 0.01 * np.cumsum(velocities[:, 2])
    assert heights.min() == pytest.approx(-0.5) and heights[-1] == pytest.approx(0.0)
    assert (velocities[:, 2] == 0.0).sum() == 10


def test_what_is_not_finite_is_infinitely_far():
    path = np.zeros((2, 3, 3))
    path[1, 0, 0] = np.nan
    np.testing.assert_array_equal(parity._distances(path, np.zeros((2, 3, 3))), [0.0, np.inf])


@pytest.mark.parametrize("force_limit", [parity.FORCE_LIMIT, 0.0])
def test_last_line_is_json(monkeypatch, capsys, force_limit):
    monkeypatch.setattr(parity, "press", short_press)
    monkeypatch.setattr(parity, "FORCE_LIMIT", force_limit)
    parity.main(["--steps", "2", "--rest-steps", "2"])
    lines = capsys.readouterr().out.splitlines()
    result = json.loads(lines[-1])
    assert result["benchmark"] == "parity"
    assert result["free_body"]["passed"] and result["rest"]["passed"]
    assert result["passed"] == result["press"]["passed"] == (force_limit > 0.0)
    assert result["rest"].keys() == {"falling", "lying", "passed"}
    assert f"all: {'passed' if force_limit else 'FAILED'}" in lines
