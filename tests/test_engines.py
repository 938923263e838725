"""The default engine, and the messages where PyBullet is missing."""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
from gymnasium.envs.registration import EnvSpec

from spatula_env import Simulation, engines, scenes
from spatula_env.sim.worlds import Worlds

try:
    import tomllib
except ImportError:  # Python 3.10
    import tomli as tomllib

ROOT = Path(__file__).parents[1]


@pytest.fixture
def without_bullet(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    engines.default_engine.cache_clear()
    yield
    engines.default_engine.cache_clear()


@pytest.mark.bullet
def test_the_default_is_bullet() -> None:
    assert engines.default_engine() == engines.choose_engine() == "bullet"
    with gym.make("Spatula/Press-v0") as env:
        assert env.unwrapped.settings.engine == env.spec.kwargs["engine"] == "bullet"


def test_without_pybullet_the_default_is_batch_and_is_said_once(without_bullet: None) -> None:
    with pytest.warns(UserWarning, match="PyBullet is not installed, so .* use engine='batch'"):
        first = gym.make("Spatula/Press-v0")
    with warnings.catch_warnings(), first, gym.make("Spatula/Press-v0", engine=None) as second:
        warnings.simplefilter("error")
        simulation = Simulation(scenes.seed())
        for env in (first, second):
            assert env.unwrapped.settings.engine == env.spec.kwargs["engine"] == "batch"
        simulation.step((0.0, 0.0, -1.0))
        simulation.close()


@pytest.mark.parametrize(
    ("wanted", "options"), [("engine='bullet'", {"engine": "bullet"}), ("contact='bullet'", {"contact": "bullet"})]
)
def test_without_pybullet_asking_for_it_says_what_to_install(
    without_bullet: None, wanted: str, options: dict[str, Any]
) -> None:
    message = rf"^{wanted} needs PyBullet, .*\. {re.escape(engines.bullet_hint())}"
    for make in (
        lambda: gym.make("Spatula/Press-v0", **options),
        lambda: Simulation(scenes.seed(), **options),
        lambda: Worlds(scenes.seed(), 2, **{"engine": None, **options}),
    ):
        with pytest.raises(ImportError, match=message) as raised:
            make()
        assert raised.value.name == "pybullet"
    with pytest.raises(ImportError, match=r"engine='bullet' needs PyBullet"):
        gym.make_vec("Spatula/Press-v0", num_envs=2, engine="bullet")


def test_many_environments_have_batch_in_any_case(without_bullet: None) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for options in ({}, {"engine": None}):
            envs = gym.make_vec("Spatula/Press-v0", num_envs=2, **options)
            assert envs.unwrapped.settings.engine == "batch"
            envs.close()


def test_a_spec_names_the_engine_so_that_it_means_the_same_elsewhere(without_bullet: None) -> None:
    with pytest.warns(UserWarning), gym.make("Spatula/Press-v0") as env:
        written = env.spec.to_json()
    assert EnvSpec.from_json(written).kwargs["engine"] == "batch"


def test_an_unknown_engine_is_an_error_in_any_case(without_bullet: None) -> None:
    for make in (
        lambda: gym.make("Spatula/Press-v0", engine="mystery"),
        lambda: Simulation(scenes.seed(), engine="mystery"),
        lambda: Worlds(scenes.seed(), 1, engine="mystery"),
    ):
        with pytest.raises(ValueError, match=r"engine must be one of \['bullet', .*, 'mujoco'\], got 'mystery'"):
            make()


def test_the_dependencies_say_the_same_as_the_table() -> None:
    markers = pytest.importorskip("packaging.requirements", reason="comes with pytest")
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    requirements = [markers.Requirement(each) for each in stated]
    places = [
        ("linux", "x86_64"),
        ("linux", "aarch64"),
        ("darwin", "arm64"),
        ("darwin", "x86_64"),
        ("win32", "AMD64"),
        ("win32", "ARM64"),
    ]
    found = {}
    for system, machine in places:
        for minor in range(10, 15):
            here = {"sys_platform": system, "platform_machine": machine, "python_version": f"3.{minor}"}
            wanted = [each.name for each in requirements if each.marker is None or each.marker.evaluate(here)]
            (found[system, machine, minor],) = [name for name in wanted if "bullet" in name] or [None]
            assert wanted.count("numba") == 1
            assert found[system, machine, minor] == engines.bullet_distribution(system, machine, (3, minor)), here
    assert found["linux", "x86_64", 11] == "pybullet"
    assert found["linux", "x86_64", 13] == found["win32", "AMD64", 10] == "pybullet-arm64"
    assert found["linux", "aarch64", 11] is found["linux", "x86_64", 14] is None
