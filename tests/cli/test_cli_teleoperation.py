"""`spatula play`, `record` and `replay`, with operators that are programs."""

from __future__ import annotations

import errno
import inspect
import io
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from spatula_env import cli
from spatula_env.cli import devices
from spatula_env.engines import default_engine
from spatula_env.installing import install_hint
from spatula_env.teleop.device import DeviceLost
from spatula_env.teleop.scripted import ScriptedOperator
from spatula_env.teleop.web.recording import RecordingOptions

pytest.importorskip("minari")

ID = "spatula/press/my-v0"
SHORT = ["--engine", "batch", "--set", "max_episode_steps=8"]


def run(capsys: pytest.CaptureFixture[str], *words: str, status: int = 0) -> tuple[list[str], str]:
    """Run a command; returns the lines that it has printed, and its notes on standard error."""
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
    """Two scripted episodes."""
    folder = tmp_path_factory.mktemp("datasets")
    words = [
        "--device",
        "scripted-falcon",
        "--set",
        "max_episode_steps=8",
        "--view",
        "none",
        "--state-dtype",
        "float64",
    ]
    assert cli.main(["record", "press", "--dataset", ID, "--episodes", "2", "--root", str(folder), *words]) == 0
    return folder


class Ending(ScriptedOperator):
    """Something happens in the second episode."""

    count = 0

    def __init__(self, policy: Any, end: Any) -> None:
        super().__init__(policy)
        self._end = end

    def watch(self, observation: Any, env: Any) -> None:
        super().watch(observation, env)
        self.count += 1
        if self.count > 12:
            self._end()


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
            raise ImportError(f"keyboard and gamepad need pygame-ce: {install_hint('teleop')}")

        monkeypatch.setattr("spatula_env.teleop.registry.make_device", missing)
        _, noted = run(capsys, "play", "press", "--device", "keyboard", *SHORT, status=1)
        assert "There is nothing to see" in noted
        assert "--device web" in noted
        assert install_hint("teleop") in noted

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
        ((name, options),) = made
        assert options.pop("settings").force_scale == 4.0
        assert (name, options) == ("falcon", {"index": 1, "firmware": Path("f.bin")})

    def test_all_devices_of_the_registry_can_be_named(self) -> None:
        from spatula_env.teleop.registry import DEVICES

        assert set(devices.DEVICES) == {*DEVICES, "replay", "web"}


class TestOptions:
    """Options that would have no effect are refused before anything runs."""

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (
                ["--device", "keyboard", "--firmware", "f"],
                "--firmware does not go with --device keyboard, only",
            ),
            (["--device", "keyboard", "--tremor", "0.1"], "--tremor does not go with --device keyboard"),
            (["--device", "falcon", "--port", "9"], "--port does not go with --device falcon, only with web"),
            (["--device", "scripted", "--recording", ID], "--recording does not go with --device scripted"),
            (["--device", "keyboard", "--policy", "expert"], "needs --intervention button or motion"),
            (["--device", "keyboard", "--scale", "2"], "--scale is the way of the tool over the way of the grip"),
            (["--device", "falcon", "--mode", "rate", "--scale", "2"], "goes with --mode position"),
            (["--device", "falcon", "--scale", "-1"], "--scale must be positive"),
            (["--device", "gamepad", "--mode", "position"], "--mode position does not go with --device gamepad"),
            (["--device", "web", "--mode", "position"], "--mode position does not go with --device web"),
            (["--device", "web", "--scale", "2"], "--scale is the way of the tool"),
            (["--device", "web", "--policy", "expert"], "on the page the operator acts"),
            (["--device", "web", "--film", "x.gif"], "spatula replay DATASET --film FILE"),
            (["--device", "web", "--view", "window"], "the page shows what happens"),
        ],
    )
    @pytest.mark.parametrize("command", ["play", "record"])
    def test_what_does_not_go_with_the_device(self, capsys, monkeypatch, tmp_path, command, words, message) -> None:
        monkeypatch.setattr("gymnasium.make", lambda *_, **__: pytest.fail("an environment was made"))
        more = ["--dataset", ID, "--root", str(tmp_path / "new")] if command == "record" else []
        _, noted = run(capsys, command, "press", *words, *more, status=1)
        assert noted.startswith(f"spatula {command}: ")
        assert message in noted
        assert not (tmp_path / "new").exists()

    @pytest.mark.parametrize("words", [["--device", "keyboard", "--root", "x"], ["--device", "web", "--episodes", "2"]])
    def test_what_does_not_go_with_playing(self, capsys, words) -> None:
        _, noted = run(capsys, "play", "press", *words, status=1)
        assert "does not go with" in noted

    def test_there_is_no_such_port(self, capsys) -> None:
        with pytest.raises(SystemExit) as ended:
            cli.main(["play", "press", "--device", "web", "--port", "99999"])
        assert ended.value.code == 2
        assert "--port: must be from 0 to 65535, got 99999" in capsys.readouterr().err
        from spatula_env.teleop.web import WebDevice

        with pytest.raises(ValueError, match="port must be from 0 to 65535, got 99999"):
            WebDevice(port=99999)

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (["--dataset", "mydata"], "say 'mydata-v0'"),
            (["--dataset", "my data/{task}-v0", "--device", "web"], "say 'my_data/"),
            (["--dataset", "{task}-v0"], "say 'task-v0'"),
            (["--dataset", ID, "--root", "{file}"], "is no folder"),
            (["--dataset", ID, "--film", "{file}/film.gif"], "is no folder"),
            (["--dataset", ID, "--root", "{file}", "--device", "web"], "is no folder"),
        ],
    )
    def test_names_and_places_are_looked_at_first(self, capsys, monkeypatch, tmp_path, words, message) -> None:
        file = tmp_path / "file"
        file.write_text("")
        monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
        monkeypatch.setattr("spatula_env.teleop.recording.run_episode", lambda *_, **__: pytest.fail("it began"))
        device = [] if "--device" in words else ["--device", "scripted", *SHORT]
        words = [word.replace("{file}", str(file)) for word in words]
        _, noted = run(capsys, "record", "press", *words, *device, status=1)
        assert message in noted
        assert list(tmp_path.iterdir()) == [file]


class TestWeb:
    @pytest.fixture
    def served(self, monkeypatch):
        """A stand-in for the page, on which two episodes are done."""
        from spatula_env.teleop import web
        from spatula_env.teleop.recording import RecordingSummary
        from spatula_env.teleop.session import EpisodeSummary

        calls: list[Any] = []

        def serve(env_id: str, *, on_ready: Any, progress: Any, **options: Any) -> RecordingSummary:
            on_ready("http://127.0.0.1:9/")
            calls.append((env_id, options))
            for fate in ("practice", "recorded"):
                progress(fate, EpisodeSummary(3, 7, True, 1.0, 0.5, 1.0))
            return RecordingSummary(ID, Path("there"), 1, 0, 1, 4)

        monkeypatch.setitem(vars(web), "serve", serve)
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
            "root": None,
            "seed": 3,
            "env_kwargs": {"randomization": "default"},
            "real_time": True,
            "recording": RecordingOptions(),
        }
        assert "Open http://127.0.0.1:9/ in a browser" in noted
        assert "1 episode recorded on the page" in noted

    def test_it_plays_as_it_is_told(self, capsys, served, tmp_path) -> None:
        words = ["--no-wait", "--end-on-success", "--root", str(tmp_path)]
        found = run_json(capsys, "play", "press", "--device", "web", *words)
        options = served[0][1]
        assert (options["real_time"], options["root"]) == (False, tmp_path)
        assert options["recording"] == RecordingOptions(end_on_success=True)
        assert [each["fate"] for each in found["episodes"]] == ["practice", "recorded"]

    def test_it_records_as_it_is_told(self, capsys, served, tmp_path) -> None:
        words = ["--author", "Ada", "--description", "Mine.", "--attempts", "9", "--drop-failures", "--no-states"]
        words += ["--end-on-success", "--root", str(tmp_path), "--state-dtype", "float64"]
        found = run_json(capsys, "record", "press", "--device", "web", "--dataset", ID, "--episodes", "2", *words)
        options = served[0][1]
        assert (options["dataset"], options["root"]) == (ID, tmp_path)
        assert options["recording"] == RecordingOptions(
            exclusive=True,
            author="Ada",
            description="Mine.",
            episodes=2,
            attempts=9,
            keep_failures=False,
            end_on_success=True,
            states=False,
            state_dtype="float64",
        )
        assert (found["dataset"], found["recorded"], found["total_episodes"]) == (ID, 1, 4)
        lines, noted = run(
            capsys, "record", "press", "--device", "web", "--dataset", ID, "--total", "5", "--root", str(tmp_path)
        )
        assert served[1][1]["recording"].total == 5
        assert lines == [f"1 episode added to {ID}, 1 of them with success; it has 4 now, in there"]
        assert "recorded: success after 3 steps" in noted
        assert "practice" not in noted

    def test_the_token_is_in_a_file(self, capsys, served, tmp_path) -> None:
        file = tmp_path / "token"
        file.write_text("a secret in a file\n")
        file.chmod(0o600)
        run(capsys, "play", "press", "--device", "web", "--token-file", str(file))
        assert served[0][1]["token"] == "a secret in a file"
        _, noted = run(capsys, "play", "press", "--device", "web", "--token-file", str(tmp_path / "missing"), status=1)
        assert "missing" in noted

    def test_the_page_takes_what_is_given(self) -> None:
        pytest.importorskip("viser")
        pytest.importorskip("websockets")
        from spatula_env.teleop.web import serve

        names = set(inspect.signature(serve).parameters)
        assert names >= {"env_id", "host", "port", "token", "dataset", "seed", "env_kwargs", "on_ready"}
        assert names >= {"root", "recording", "progress", "real_time"}


class TestRecord:
    def test_what_was_recorded(self, root, capsys) -> None:
        found = run_json(capsys, "datasets", "inspect", ID, "--root", str(root))
        assert (found["episodes"], found["operators"], found["devices"]) == (
            2,
            {"scripted": 2},
            {"emulated Falcon": 2},
        )
        assert [each["seed"] for each in found["list"]] == [0, 1]
        assert found["env_kwargs"]["engine"] == default_engine()
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

        def make(name: str, *, policy: Any, **_: Any) -> Any:
            return Ending(policy, end)

        def end() -> None:
            raise raised[0]

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
        assert "spatula record: stopped; 1 episode was added" in noted
        assert "The same command goes on" in noted
        assert run_json(capsys, "datasets", "inspect", ID, "--root", str(tmp_path))["episodes"] == 1

    @pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="another system")
    @pytest.mark.parametrize(("name", "status"), [("SIGTERM", 143), ("SIGHUP", 129)])
    def test_what_ends_programs_is_like_ctrl_c(self, capsys, tmp_path, monkeypatch, name, status) -> None:
        number = getattr(signal, name)
        monkeypatch.setattr(
            "spatula_env.teleop.registry.make_device", lambda _, *, policy, **__: Ending(policy, lambda: kill(number))
        )

        def kill(number: int) -> None:
            # Once more: the second one does not interrupt what the first one has begun.
            os.kill(os.getpid(), number)
            os.kill(os.getpid(), number)

        before = signal.getsignal(number)
        words = ["--dataset", ID, "--device", "scripted", "--episodes", "3", "--root", str(tmp_path)]
        _, noted = run(capsys, "record", "press", *words, *SHORT, status=status)
        assert "stopped; 1 episode was added" in noted
        assert signal.getsignal(number) == before
        assert run_json(capsys, "datasets", "inspect", ID, "--root", str(tmp_path))["episodes"] == 1

    def test_what_is_ignored_stays_ignored(self) -> None:
        from spatula_env.cli.interrupting import endings_like_ctrl_c

        before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
        try:
            with endings_like_ctrl_c():
                os.kill(os.getpid(), signal.SIGTERM)
            assert signal.getsignal(signal.SIGTERM) == signal.SIG_IGN
        finally:
            signal.signal(signal.SIGTERM, before)

    def test_nobody_is_left_to_hear_it(self, monkeypatch) -> None:
        from spatula_env.cli.common import fail

        class Closed(io.StringIO):
            def write(self, _: str) -> int:
                raise OSError(errno.EIO, "Input/output error")

        monkeypatch.setattr(sys, "stderr", Closed())
        assert fail("stopped", 129) == 129

    def test_other_options_are_refused_by_name(self, capsys, tmp_path) -> None:
        words = ["record", "press", "--dataset", ID, "--device", "scripted", "--root", str(tmp_path), *SHORT]
        run(capsys, *words)
        _, noted = run(capsys, *words, "--set", "randomization=default", "--set", "control_frequency=10", status=1)
        assert "differ in control_frequency (10 here, 20.0 there); randomization (default here, none there)" in noted
        lines, _ = run(capsys, "replay", ID, "--root", str(tmp_path))
        assert lines[-1] == "greatest difference 0 u; 1 episodes, tolerance 1e-09 u"

    def test_authors_are_kept_with_their_episodes(self, capsys, tmp_path) -> None:
        root = ["--root", str(tmp_path)]
        for author in ("Ada", "Ben"):
            words = ["--dataset", ID, "--device", "scripted", "--author", author, *root, *SHORT]
            run(capsys, "record", "press", *words)
        run(capsys, "datasets", "merge", ID, "--into", "spatula/press/copy-v0", *root)
        found = run_json(capsys, "datasets", "inspect", "spatula/press/copy-v0", *root)
        assert [each["author"] for each in found["list"]] == ["Ada", "Ben"]
        assert found["author"] == ["Ada", "Ben"]
        assert found["authors"] == {"Ada": 1, "Ben": 1}

    def test_a_keyboard_without_a_display(self, capsys, tmp_path, headless, monkeypatch) -> None:
        pytest.importorskip("pygame")
        monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
        words = ["--dataset", ID, "--device", "keyboard", "--root", str(tmp_path), "--no-wait"]
        _, noted = run(capsys, "record", "press", *words, *SHORT, status=1)
        assert "the keyboard needs a window, and there is no display" in noted
        assert list(tmp_path.iterdir()) == []

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
        lines, noted = run(capsys, "replay", ID, "--root", str(root), "--episodes", "0", "--mean-actions")
        assert lines[1].endswith("by means")
        assert lines[-1].endswith(" u; 1 episodes, how far means of the actions lead from it")
        assert noted == ""

    def test_ctrl_c(self, capsys, root, monkeypatch) -> None:
        from spatula_env.data import replaying

        repeat, count = replaying._repeat, iter(range(9))

        def interrupted(*given: Any) -> Any:
            if next(count) == 1:
                raise KeyboardInterrupt
            return repeat(*given)

        monkeypatch.setattr(replaying, "_repeat", interrupted)
        _, noted = run(capsys, "replay", ID, "--root", str(root), status=130)
        assert noted.endswith("spatula replay: stopped after 1 episode of 2, 1 of them as recorded\n")

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
