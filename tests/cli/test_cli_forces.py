"""Options of the command line about forces, and its output about them."""

from __future__ import annotations

import argparse

import gymnasium as gym
import pytest

import spatula_env
from spatula_env.cli.common import CommandError
from spatula_env.cli.devices import add_device_options, check_applicable, teleop_options
from spatula_env.cli.forces import force_settings, loop_in_words, read_buttons
from spatula_env.cli.main import main
from spatula_env.envs.press import PRESS
from spatula_env.teleop.haptics import LoopStatistics
from spatula_env.teleop.haptics.scales import FORCE_SCALES

assert spatula_env.TASKS


class FakePress(gym.Env):
    """Stands in for an environment, with the attributes that the options read."""

    definition = PRESS


def parsed(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_device_options(parser)
    return parser.parse_args(words)


def test_every_task_has_a_scale_and_it_is_told(capsys):
    assert set(FORCE_SCALES) == {task.lower() for task in ("Press", "Retract", "Palpate", "Fissure", "Clamp")}
    settings = force_settings(parsed("--device", "falcon"), FakePress())
    assert (settings.force_scale, settings.weight) == (FORCE_SCALES["press"], 0.7)
    assert "4 times the force" in capsys.readouterr().err


def test_gains_can_be_chosen():
    chosen = parsed("--device", "emulated-falcon", "--force-scale", "2", "--coupling", "90", "--grip-weight", "0.5")
    settings = force_settings(chosen, FakePress())
    assert (settings.force_scale, settings.stiffness, settings.weight) == (2.0, 90.0, 0.5)
    silent = force_settings(parsed("--device", "falcon", "--no-force"), FakePress())
    assert (silent.force_scale, silent.weight, silent.wall_stiffness) == (0.0, 0.0, 0.0)
    assert force_settings(parsed("--device", "scripted-falcon"), FakePress()).force_scale == 1.0


@pytest.mark.parametrize(
    ("words", "message"),
    [(("--force-scale", "-1"), "--force-scale must be"), (("--coupling", "0"), "stiffness must be")],
)
def test_gains_are_checked(words, message):
    with pytest.raises(CommandError, match=message):
        force_settings(parsed("--device", "falcon", *words), FakePress())


def test_buttons():
    chosen = parsed("--device", "falcon", "--buttons", "forward=finish,minus=discard")
    options = teleop_options(chosen)
    assert options["buttons"] == {"forward": "finish", "minus": "discard"}
    assert options["centring"]
    assert not teleop_options(parsed("--device", "falcon", "--no-centring"))["centring"]
    with pytest.raises(CommandError, match="NAME=AS"):
        read_buttons(parsed("--device", "falcon", "--buttons", "forward"))
    with pytest.raises(CommandError, match="center, forward, plus, minus, finish, discard, quit, got 'clutch'"):
        read_buttons(parsed("--device", "falcon", "--buttons", "forward=clutch"))


def test_what_means_nothing_is_refused():
    with pytest.raises(CommandError, match="--force-scale does not go with --device keyboard"):
        check_applicable(parsed("--device", "keyboard", "--force-scale", "2"))


def test_a_session_ends_with_a_line_about_its_loop(capsys):
    words = ["play", "press", "--device", "scripted-falcon", "--episodes", "1", "--set", "max_episode_steps=3"]
    assert main([*words, "--force-scale", "2", "--view", "none"]) == 0
    assert "haptic loop: 1000 Hz, 99 of 100 periods within" in capsys.readouterr().err


def test_the_line():
    line = loop_in_words(LoopStatistics(2000, 1.04e-3, 1.2e-3, 3e-3, 2, 20, 0.0))
    assert "962 Hz" in line
    assert "let go 2 times" in line
    assert "1.0% of the time" in line
