"""`spatula play`, `record` and `replay`, with operators that are programs."""

from __future__ import annotations

import inspect
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from spatula_env import cli
from spatula_env.cli import devices
from spatula_env.teleop.device import DeviceLost
from spatula_env.teleop.scripted import ScriptedOperator

pytest.importorskip("minari")

ID = "spatula/press/my-v0"
SHORT = ["--engine", "batch", "--set", "max_episode_steps=8"]


def run(capsys: pytest.CaptureFixture[str], *words: str, status: int = 0) -> tuple[list[str], str]:
    """The lines that a command has printed, and what it has noted beside."""
    capsys.readouterr()
    assert cli.main(list(words)) == status
    said = capsys.readouterr()
    return said.out.splitlines(), said.err


def run_json(capsys: pytest.CaptureFixture[str], *words: str, status: int = 0) -> dict[str, Any]:
    lines, _ = run(capsys, *words, "--json", status=status)
    assert len(lines) == 1
    return json.loads(lines[0])


@pytest.fixture
def headless(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scripted episodes in Bullet."""
    folder = tmp_path_factory.mktemp("datasets")
    words = ["--device", "scripted-falcon", "--set", "max_episode_steps=8", "--view", "none"]
    assert cli.main(["record", "press", "--dataset", ID, "--episodes", "2", "--root", str(folder), *words]) == 0
    return folder


class TestPlay:
    def test_a_program_plays(self, capsys, headless) -> None:
        lines, noted = run(capsys, "play", "press", "--device", "scripted", "--seed", "4", *SHORT)
        assert len(lines) == 1
        assert lines[0].startswith("episode 1: no success after 8 steps")
        assert "seed 4" in lines[0]
        assert "nothing to see" not in noted

    def test_as_json(self, capsys) -> None:
        found = run_json(
            capsys, "play", "press", "--device", "scripted", "--policy", "random", "--episodes", "2", *SHORT
        )
        assert [each["seed"] for each in found["episodes"]] == [0, 1]
        assert [each["steps"] for each in found["episodes"]] == [8, 8]

    def test_a_film_of_it(self, capsys, tmp_path) -> None:
        file = tmp_path / "film.gif"
        words = ["--set", "width=64", "--set", "height=48", "--film", str(file)]
        run(capsys, "play", "press", "--device", "scripted", *SHORT, *words)
        with Image.open(file) as film:
            assert film.size == (64, 48)
            assert film.n_frames == 9

    def test_a_recording_is_done_again(self, capsys, root) -> None:
        words = ["--recording", ID, "--root", str(root)]
        found = run_json(
            capsys, "play", "press", "--device", "replay", *words, "--set", "max_episode_steps=8", "--view", "none"
        )
        (first,) = found["episodes"]
        assert first["steps"] == 8

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (["press"], "needs --recording"),
            (["press", "--recording", "spatula/no/such-v0"], "there is no dataset"),
            (["retract", "--recording", ID], "was recorded in Spatula/Press-v0"),
            (["press", "--recording", ID, "--episode", "2"], "has 2 episodes, there is no 2"),
            (["press", "--recording", ID, "--set", "control=velocity_6d"], "with other actions"),
        ],
    )
    def test_a_recording_that_does_not_fit(self, capsys, root, words, message) -> None:
        _, noted = run(
            capsys, "play", *words, "--device", "replay", "--root", str(root), "--view", "none", *SHORT, status=1
        )
        assert message in noted

    def test_who_holds_nothing_is_told_what_to_do(self, capsys, headless, monkeypatch) -> None:
        def missing(*_: Any, **__: Any) -> Any:
            raise ImportError("keyboard and gamepad need pygame-ce: pip install 'spatula-env[teleop]'")

        monkeypatch.setattr("spatula_env.teleop.registry.make_device", missing)
        _, noted = run(capsys, "play", "press", "--device", "keyboard", *SHORT, status=1)
        assert "There is nothing to see" in noted
        assert "--device web" in noted
        assert "pip install 'spatula-env[teleop]'" in noted

    def test_intervention_needs_somebody_to_intervene_with(self, capsys) -> None:
        _, noted = run(capsys, "play", "press", "--device", "keyboard", "--intervention", "button", status=1)
        assert "--intervention button needs --policy" in noted

    def test_options_reach_the_device_and_the_wrapper(self, capsys, monkeypatch) -> None:
        made: list[Any] = []

        def make(name: str, **options: Any) -> Any:
            made.append((name, options))
            return ScriptedOperator(lambda _: np.zeros(3))

        monkeypatch.setattr("spatula_env.teleop.registry.make_device", make)
        words = ["--firmware", "f.bin", "--index", "1", "--view", "none", "--episodes", "1", "--no-wait"]
        run(capsys, "play", "press", "--device", "falcon", *words, *SHORT)
        assert made == [("falcon", {"index": 1, "firmware": Path("f.bin")})]

    def test_all_devices_of_the_registry_can_be_named(self) -> None:
        from spatula_env.teleop.registry import DEVICES

        assert set(devices.DEVICES) == {*DEVICES, "replay", "web"}


class TestWeb:
    @pytest.fixture
    def served(self, monkeypatch):
        """A stand-in for the page."""
        calls: list[Any] = []

        def serve(env_id: str, **options: Any) -> None:
            options.pop("on_ready")("http://127.0.0.1:9/")
            calls.append((env_id, options))

        monkeypatch.setitem(sys.modules, "spatula_env.teleop.web", SimpleNamespace(serve=serve))
        return calls

    def test_the_page_is_served(self, capsys, served) -> None:
        words = ["--port", "9", "--token", "secret", "--seed", "3", "--set", "randomization=default"]
        _, noted = run(capsys, "play", "press", "--device", "web", *words)
        ((env_id, options),) = served
        assert env_id == "Spatula/Press-v0"
        assert options == {
            "host": "127.0.0.1",
            "port": 9,
            "token": "secret",
            "dataset": None,
            "seed": 3,
            "env_kwargs": {"randomization": "default"},
        }
        assert "Open http://127.0.0.1:9/ in a browser" in noted

    def test_it_records(self, capsys, served) -> None:
        run(capsys, "record", "press", "--device", "web", "--dataset", ID)
        assert served[0][1]["dataset"] == ID
        _, noted = run(capsys, "record", "press", "--device", "web", "--dataset", ID, "--root", "x", status=1)
        assert "MINARI_DATASETS_PATH" in noted

    def test_the_page_takes_what_is_given(self) -> None:
        pytest.importorskip("viser")
        pytest.importorskip("websockets")
        from spatula_env.teleop.web import serve

        names = set(inspect.signature(serve).parameters)
        assert names >= {"env_id", "host", "port", "token", "dataset", "seed", "env_kwargs", "on_ready"}


class TestRecord:
    def test_what_was_recorded(self, root, capsys) -> None:
        found = run_json(capsys, "datasets", "inspect", ID, "--root", str(root))
        assert (found["episodes"], found["operators"], found["devices"]) == (
            2,
            {"scripted": 2},
            {"emulated Falcon": 2},
        )
        assert [each["seed"] for each in found["list"]] == [0, 1]
        assert found["env_kwargs"]["engine"] == "bullet"
        assert found["env_kwargs"].get("render_mode") is None

    def test_it_goes_on(self, capsys, tmp_path) -> None:
        words = ["record", "press", "--dataset", ID, "--device", "scripted", "--root", str(tmp_path), *SHORT]
        assert run_json(capsys, *words)["total_episodes"] == 1
        found = run_json(capsys, *words, "--episodes", "2")
        assert (found["recorded"], found["total_episodes"]) == (2, 3)
        found = run_json(capsys, *words, "--total", "4")
        assert (found["recorded"], found["total_episodes"]) == (1, 4)
        assert run_json(capsys, *words, "--total", "4")["recorded"] == 0
        listed = run_json(capsys, "datasets", "inspect", ID, "--root", str(tmp_path))["list"]
        assert [each["seed"] for each in listed] == [0, 1, 2, 3]

    def test_failures_can_be_dropped(self, capsys, tmp_path) -> None:
        words = ["--drop-failures", "--attempts", "2", "--no-states", "--root", str(tmp_path)]
        found = run_json(capsys, "record", "press", "--dataset", ID, "--device", "scripted", *words, *SHORT)
        assert (found["recorded"], found["discarded"], found["total_episodes"]) == (0, 2, 0)

    @pytest.fixture
    def ending(self, monkeypatch):
        """A device that raises something in the second episode."""
        raised: list[BaseException] = []

        class Ending(ScriptedOperator):
            count = 0

            def watch(self, observation, env):
                super().watch(observation, env)
                self.count += 1
                if self.count > 12:
                    raise raised[0]

        def make(name: str, *, policy: Any, **_: Any) -> Any:
            return Ending(policy)

        monkeypatch.setattr("spatula_env.teleop.registry.make_device", make)
        return raised

    def test_a_lost_device(self, capsys, tmp_path, ending) -> None:
        ending.append(DeviceLost("the device does not answer any more"))
        words = ["--dataset", ID, "--device", "scripted", "--episodes", "3", "--root", str(tmp_path)]
        capsys.readouterr()
        assert cli.main(["record", "press", *words, *SHORT, "--json"]) == 1
        said = capsys.readouterr()
        assert json.loads(said.out)["total_episodes"] == 1
        assert "does not answer any more. What was recorded before is safe" in said.err

    def test_ctrl_c(self, capsys, tmp_path, ending) -> None:
        ending.append(KeyboardInterrupt())
        words = ["--dataset", ID, "--device", "scripted", "--episodes", "3", "--root", str(tmp_path)]
        _, noted = run(capsys, "record", "press", *words, *SHORT, status=130)
        assert "1 episodes were added" in noted
        assert "The same command goes on" in noted
        assert run_json(capsys, "datasets", "inspect", ID, "--root", str(tmp_path))["episodes"] == 1

    def test_a_malformed_name(self, capsys, tmp_path) -> None:
        words = ["--dataset", "mydata", "--device", "scripted", "--root", str(tmp_path)]
        _, noted = run(capsys, "record", "press", *words, *SHORT, status=1)
        assert "say 'mydata-v0'" in noted


class TestReplay:
    def test_by_actions(self, capsys, root) -> None:
        lines, _ = run(capsys, "replay", ID, "--root", str(root))
        assert lines[1].split()[:2] == ["0", "8"]
        assert lines[2].endswith("as recorded")
        assert lines[-1] == "greatest difference 0 u; 2 episodes, tolerance 1e-09 u"

    def test_as_json(self, capsys, root) -> None:
        found = run_json(capsys, "replay", ID, "--root", str(root), "--episodes", "1")
        assert found["matches"] is True
        assert found["difference"] <= 1e-9
        assert [each["episode"] for each in found["episodes"]] == [1]

    def test_what_differs_is_told(self, capsys, root, monkeypatch) -> None:
        from spatula_env.data import replaying

        states = replaying.physics_state
        monkeypatch.setattr(
            replaying, "physics_state", lambda made: {name: each + 1e-6 for name, each in states(made).items()}
        )
        lines, noted = run(capsys, "replay", ID, "--root", str(root), "--episodes", "0", status=1)
        assert lines[1].endswith("DIFFERS")
        assert "greatest difference 1e-06 u" in lines[-1]
        assert "1 of 1 episodes differ" in noted
        run(capsys, "replay", ID, "--root", str(root), "--episodes", "0", "--tolerance", "1e-5", status=0)

    def test_by_states(self, capsys, root, tmp_path) -> None:
        file = tmp_path / "states.gif"
        lines, _ = run(
            capsys, "replay", ID, "--root", str(root), "--by", "states", "--episodes", "1", "--film", str(file)
        )
        assert lines == ["episode 1: 9 states, as they were recorded"]
        with Image.open(file) as film:
            assert film.n_frames > 1
        found = run_json(capsys, "replay", ID, "--root", str(root), "--by", "states")
        assert found["episodes"] == [{"episode": 0, "states": 9}, {"episode": 1, "states": 9}]

    def test_an_episode_that_is_not_there(self, capsys, root) -> None:
        _, noted = run(capsys, "replay", ID, "--root", str(root), "--episodes", "7", status=1)
        assert "there is no 7" in noted
