"""Playing and recording on a page, by a script that holds keys as a page's does; no browser is needed."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from urllib.parse import urlsplit

import gymnasium as gym
import numpy as np
import pytest
from web_helpers import Script, until

import spatula_env
from spatula_env.data import DatasetWriteError, DatasetWriter
from spatula_env.data.files import DatasetBusy, recording_lock
from spatula_env.engines import default_engine
from spatula_env.installing import install_hint
from spatula_env.teleop import DeviceBusy, DeviceError, NotCalibrated
from spatula_env.teleop.recording import record
from spatula_env.teleop.registry import make_device
from spatula_env.teleop.web import WebDevice, WebSession, serve
from spatula_env.teleop.web.recording import RecordingOptions
from spatula_env.teleop.web.session import task_ids
from spatula_env.teleop.wrapper import FalconTeleop

gym.register_envs(spatula_env)

pytest.importorskip("viser", reason="the extra web is not installed")
minari = pytest.importorskip("minari", reason="the extra data is not installed")

TASK = "Spatula/Press-v0"


@pytest.fixture(autouse=True)
def datasets(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


@pytest.fixture
def session(tmp_path):
    with WebSession(TASK, port=0, dataset=tmp_path, seed=5, real_time=False) as made:
        yield made


def height(session):
    return session.device._grip[2]


def steps(session):
    return session.device._sequence


def load(dataset_id="spatula/press/web-v0"):
    return minari.load_dataset(dataset_id)


def attributes(dataset, number):
    return next(dataset.storage.get_episode_metadata([number]))


def start_recording(session, script):
    script.hold()
    until(lambda: session._status.text == "Practice" and not session.device.page.operator_input.keys, "practice")
    session._ask("record")
    until(lambda: session._status.text == "Ready", "recording")
    script.hold("KeyQ")
    until(lambda: session._status.text.startswith("Recording"), "an episode")


def test_nothing_happens_while_nobody_looks(session):
    until(lambda: session._status.text == "Paused", "standing still")
    before = steps(session)
    with Script(session.url) as script:
        until(lambda: steps(session) > before + 3, "steps")
        top = height(session)
        script.hold("KeyQ")
        until(lambda: height(session) < top - 0.003, "the tool goes down")
        script.hold()
        until(lambda: session.device._rates == {}, "no command")
    # The page is gone, the tool stays where it is, and nothing is lost when somebody comes back.
    until(lambda: session._status.text == "Paused", "standing still")
    place, count = session.device._grip.copy(), steps(session)
    with Script(session.url):
        until(lambda: steps(session) > count + 3, "steps")
        assert session.device._grip == pytest.approx(place, abs=1e-12)


def test_a_page_that_vanishes_while_a_key_is_held_stops_the_tool(session):
    with Script(session.url) as script:
        top = until(lambda: session.device._env is not None and height(session), "an episode")
        script.hold("KeyQ")
        until(lambda: height(session) < top - 0.003, "the tool goes down")
    until(lambda: session._status.text == "Paused", "standing still")
    # One step more at most, and that commands nothing.
    assert session.device.read().rate.tolist() == [0.0, 0.0, 0.0]


def test_practice_has_no_limit_of_time(tmp_path):
    limit = 1.0
    options = {"real_time": False, "env_kwargs": {"episode_time": limit}}
    with WebSession(TASK, port=0, dataset=tmp_path, seed=5, **options) as session, Script(session.url):
        until(lambda: session.env is not None and session.env.unwrapped._episodes.info, "an episode")
        until(lambda: session.env.unwrapped._episodes.info["time"][0] > limit + 0.5, "more than an episode's time")


def test_what_is_asked_for_again_at_once_ends_an_episode_too(session):
    # Before the first step of an episode, the button that ended the last one is still down.
    taken = []
    take = session._asked.take

    def take_and_ask_again():
        what = take()
        if what == "reset" and len(taken) < 3:
            taken.append(what)
            session._asked.put("reset")
        return what

    session._asked.take = take_and_ask_again
    with Script(session.url):
        until(lambda: session._status.text == "Practice", "practice")
        session._ask("reset")
        until(lambda: len(taken) == 3, "three new episodes")


def test_an_episode_is_recorded(session):
    with Script(session.url) as script:
        start_recording(session, script)
        until(lambda: session.device._grip[2] < -0.01, "contact")
        session._ask("success")
        until(lambda: session.saved == 1, "saving")
        start_recording(session, script)
        session._ask("save")
        until(lambda: session.saved == 2, "saving")
    dataset = load()
    assert dataset.total_episodes == 2
    first, second = attributes(dataset, 0), attributes(dataset, 1)
    assert [first[name] for name in ("operator", "device", "engine")] == ["human", "web", default_engine()]
    assert first["operator_success"] and not second["operator_success"]
    assert not first["interrupted"]
    assert (first["seed"], second["seed"]) == (5, 6)
    episode = dataset[0]
    # It began with the first motion, and keys move at a fraction of the greatest speed.
    assert episode.actions[0].tolist() == pytest.approx([0.0, 0.0, -0.3])
    assert len(episode.observations) == len(episode.actions) + 1
    assert set(episode.infos["acted_by"]) == {b"human"}
    assert (np.diff(episode.infos["state"]["tools"][:, 0, 2]) <= 1e-9).all()


def test_a_discarded_episode_counts_for_nothing(session):
    with Script(session.url) as script:
        start_recording(session, script)
        session._ask("discard")
        until(lambda: session._said.startswith("The episode was not kept"), "discarding")
        assert session.saved == 0
        # An operator who has not moved has done nothing that could be kept.
        script.hold()
        until(lambda: session._status.text == "Practice" and not session.device.page.operator_input.keys, "practice")
        session._ask("record")
        until(lambda: session._status.text == "Ready", "recording")
        session._said = ""
        session._ask("save")
        until(lambda: session._said.startswith("The episode was not kept"), "discarding")
    assert load().total_episodes == 0


def test_after_the_last_step_the_operator_is_asked(tmp_path):
    options = {"real_time": False, "env_kwargs": {"episode_time": 2.0}}
    with WebSession(TASK, port=0, dataset=tmp_path, seed=5, **options) as session, Script(session.url) as script:
        start_recording(session, script)
        until(lambda: session._status.text == "The episode is over", "the end of the time")
        # Buttons that mean nothing now do nothing.
        session._ask("record")
        session._ask("reset")
        assert session.saved == 0
        session._on_enter()
        until(lambda: session.saved == 1, "saving")
    assert load()[0].actions.shape[0] == 40


def test_a_page_that_goes_away_while_it_records_loses_nothing(session):
    with Script(session.url) as script:
        start_recording(session, script)
    until(lambda: session._status.text == "Paused", "standing still")
    assert session._status.recording
    with Script(session.url):
        until(lambda: session._status.text.startswith("Recording"), "recording goes on")
        session._ask("save")
        until(lambda: session.saved == 1, "saving")
    assert load().total_episodes == 1


def test_what_is_recorded_when_the_session_ends_is_saved(tmp_path):
    with WebSession(TASK, port=0, dataset=tmp_path, real_time=False) as session, Script(session.url) as script:
        start_recording(session, script)
    session.stop()
    dataset = load()
    assert dataset.total_episodes == 1
    assert attributes(dataset, 0)["interrupted"]


def test_another_task(session):
    assert set(task_ids()) >= {f"Spatula/{name}-v0" for name in spatula_env.TASKS}
    with Script(session.url) as script:
        until(lambda: session.env is not None, "a task")
        session._choice.value = "Spatula/Clamp-v0"
        session._ask("task")
        until(lambda: session.env is not None and session.env.spec.id == "Spatula/Clamp-v0", "another task")
        until(lambda: session.device._env is session.env.unwrapped, "another stage")
        script.hold("Comma")
        until(lambda: session.device.extra_rates().get("jaw_speed", 0.0) < 0.0, "closing jaws")
        start_recording(session, script)
        session._ask("save")
        until(lambda: session.saved == 1, "saving")
    assert load("spatula/clamp/web-v0").total_episodes == 1


def test_names_of_datasets(tmp_path):
    named = WebSession(TASK, port=0, dataset="mine/press-v3")
    assert named.dataset_id(TASK) == "mine/press-v3"
    assert named.dataset_id("Spatula/Clamp-v0") == "spatula/clamp/web-v0"
    assert WebSession(TASK, dataset="mine/{task}-v3").dataset_id("Spatula/Clamp-v0") == "mine/clamp-v3"
    assert WebSession(f"spatula_env:{TASK}", dataset=tmp_path).dataset_id(TASK) == "spatula/press/web-v0"


def test_what_is_wrong_is_said(tmp_path):
    with pytest.raises(ValueError, match=r"env_id must be one of .*Press-v0.*, got 'Spatula/Nothing-v0'"):
        WebSession("Spatula/Nothing-v0")
    with pytest.raises(ValueError, match="token must be given"):
        serve(TASK, host="0.0.0.0", port=0)
    with WebSession(TASK, port=0, env_kwargs={"engine": "steam"}) as session:
        with pytest.raises(ValueError, match="steam"):
            session.wait(60.0)


def test_serving_blocks_until_it_is_interrupted(capfd):
    seen = []

    def ready(url):
        seen.append(urllib.request.urlopen(url).status)
        raise KeyboardInterrupt

    serve(TASK, port=0, on_ready=ready)
    assert seen == [200]
    # The address of viser's own server is nobody's business.
    assert "127.0.0.1" not in capfd.readouterr().out


def test_ctrl_c_ends_it():
    program = (
        "import os, signal, threading\n"
        "from spatula_env.teleop.web import serve\n"
        # Tests may run in the background, where a shell has Ctrl-C ignored.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def ready(url):\n"
        "    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()\n"
        f"serve({TASK!r}, port=0, on_ready=ready)\n"
        "print('ended')\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=200, check=False)
    assert done.stdout.split()[-1:] == ["ended"], done.stderr


def test_a_page_cannot_name_a_module(session, tmp_path, monkeypatch):
    import msgspec.msgpack
    import viser
    from websockets.sync.client import connect

    (tmp_path / "named_by_a_page.py").write_text(f"open({str(tmp_path / 'it-ran')!r}, 'w')")
    monkeypatch.syspath_prepend(tmp_path)
    address = f"ws://{urlsplit(session.url).netloc}/"
    camera = {
        "type": "ViewerCameraMessage",
        "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 1.0), "fov": 1.0, "near": 0.1, "far": 9.0,
        "image_height": 10, "image_width": 10, "look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 1.0, 0.0),
    }  # fmt: skip
    choice = {"type": "GuiUpdateMessage", "uuid": session._choice._impl.uuid}
    options = {"subprotocols": [f"viser-v{viser.__version__}"], "max_size": None, "max_queue": None, "proxy": None}
    with Script(session.url), connect(address, **options) as line:
        line.send(msgspec.msgpack.encode(camera))
        until(lambda: session.device.page.server.get_clients(), "a page")
        until(lambda: session._status.text == "Practice", "practice")
        # It looked straight down; it is given the first view all the same.
        (client,) = session.device.page.server.get_clients().values()
        until(lambda: client.camera.position[2] > 2.0 and client.camera.up_direction[2] == 1.0, "the first view")
        for name in ("named_by_a_page:Spatula/Press-v0", "CartPole-v1", ""):
            before = session.device.page.messages.dropped
            line.send(msgspec.msgpack.encode({**choice, "updates": {"value": name}}))
            until(lambda before=before: session.device.page.messages.dropped > before, "a refusal")
            assert session.env_id == TASK == session._choice.value
        assert not (tmp_path / "it-ran").exists()
        line.send(msgspec.msgpack.encode({**choice, "updates": {"value": "Spatula/Fissure-v0"}}))
        until(lambda: session.env_id == "Spatula/Fissure-v0", "another task")


# The device without a session.


def test_a_device_for_the_wrapper_and_for_record(tmp_path):
    said = []
    with make_device("web", port=0) as device, Script(device.url) as script:
        assert device.is_open and device.kind == "rate" and not device.has_force
        device.calibrate(said.append)
        assert said == [f"open {device.url}"]
        env = gym.make(TASK)
        teleop = FalconTeleop(env, device, real_time=False)
        teleop.reset(seed=0)
        script.hold("KeyD", "KeyE", "ShiftLeft")
        until(lambda: device.page.operator_input.rates(), "keys")
        *_, info = teleop.step()
        assert info["action"].tolist() == pytest.approx([0.075, 0.0, 0.075])
        assert info["acted_by"] == "human"
        # The mouse wins, and takes the grip where it is.
        place = np.array([0.01, -0.015, 0.02])
        device.page.operator_input.drag(place)
        for _ in range(40):
            *_, info = teleop.step()
        assert device._grip == pytest.approx(place, abs=1e-4)
        device.page.operator_input.drag(None)
        script.hold("Enter")
        until(lambda: "finish" in device._pressed, "the button")
        assert device.read().buttons == {"finish"}
        assert device.read().buttons == frozenset()

        def finish(observation, info):
            if info["time"] > 0.3:
                device.press("finish")

        summary = record(env, device, "mine/press-v0", root=tmp_path, after_step=finish, real_time=False)
        assert (summary.recorded, summary.total_episodes) == (1, 1)
        assert attributes(load("mine/press-v0"), 0)["operator"] == "human"
        env.close()


def test_a_page_that_is_busy_drawing_is_shown_no_more(monkeypatch):
    monkeypatch.setattr("spatula_env.teleop.web.device.LONGEST", np.inf)
    with WebDevice(port=0) as device, Script(device.url) as script:
        env = gym.make(TASK)
        teleop = FalconTeleop(env, device, real_time=False)
        teleop.reset(seed=0)
        shown = []
        monkeypatch.setattr(device._display, "show", shown.append)
        for _ in range(3):
            teleop.step()
        assert len(shown) == 3
        for count in (7, 8):
            script.frames = count
            until(lambda count=count: count in device.page.operator_input.frames.values(), "frames")
            shown.clear()
            for _ in range(3):
                teleop.step()
            assert len(shown) == 1
        # What was left out is shown in the end.
        device.refresh()
        device.refresh()
        assert len(shown) == 2
        env.close()


def test_a_closed_device():
    device = WebDevice(port=0, patience=0.01)
    with pytest.raises(DeviceError, match="not open"):
        device.read()
    device.open()
    device.open()
    with pytest.raises(NotCalibrated, match="nobody opened"):
        device.calibrate()
    assert device.read().rate.tolist() == [0.0, 0.0, 0.0]
    device.close()
    device.close()
    assert not device.is_open


def test_a_port_that_is_taken():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        device = WebDevice(port=port)
        with pytest.raises(DeviceBusy, match=f"port {port} of host '127.0.0.1' is in use"):
            device.open()
        assert not device.is_open


def test_without_viser_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ImportError, match=re.escape(install_hint("web"))):
        WebDevice(port=0).open()


# The gate.


@pytest.fixture(scope="module")
def locked():
    with WebDevice(port=0, token="a long enough token") as device:
        yield device


def get(url, **headers):
    # Redirections are looked at, not followed.
    class Stay(urllib.request.HTTPRedirectHandler):
        def redirect_request(self, *_):
            return None

    opener = urllib.request.build_opener(Stay, urllib.request.ProxyHandler({}))
    try:
        with opener.open(urllib.request.Request(url, headers=headers), timeout=30) as answer:
            return answer.status, answer.headers, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.headers, error.read().decode()


def test_the_gate_hands_out_the_page_to_who_knows_the_token(locked):
    base = locked.url.partition("?")[0]
    status, headers, text = get(base)
    assert status == 401 and "needs its token" in text and "viser" not in text
    status, headers, _ = get(locked.url)
    assert status == 303 and headers["Location"] == "/"
    cookie = headers["Set-Cookie"].partition(";")[0]
    status, headers, text = get(base, Cookie=cookie)
    assert status == 200 and headers["X-Frame-Options"] == "DENY"
    assert text.index('src="/spatula/page.js"') < text.index("<script ", text.index("page.js") + 10)
    assert get(base + "spatula/page.js", Cookie=cookie)[0] == 200
    assert get(base + "spatula/../../etc/passwd", Cookie=cookie)[0] == 404
    assert get(base + "spatula/page.js")[0] == 401


@pytest.mark.parametrize("path", ["/", "/spatula/hand", "/anything"])
def test_no_line_without_the_token(locked, path):
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    with pytest.raises(InvalidStatus, match="401"):
        connect(f"ws://{urlsplit(locked.url).netloc}{path}", proxy=None)


def test_no_line_for_another_site(session):
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    for path in ("/", "/spatula/hand"):
        with pytest.raises(InvalidStatus, match="403"):
            connect(f"ws://{urlsplit(session.url).netloc}{path}", origin="http://evil.example", proxy=None)


def test_messages_pass_the_gate_as_they_are(session):
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    address = f"ws://{urlsplit(session.url).netloc}/"
    with connect(address, subprotocols=["viser-v0.0.0"], proxy=None) as line:
        assert line.subprotocol == "viser-v0.0.0"
        # Another version of viser's page is refused by viser itself, and told why.
        with pytest.raises(ConnectionClosed, match="Version mismatch"):
            for _ in line:
                pass


def test_a_page_that_talks_nonsense_is_hung_up_on(session):
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    with connect(f"ws://{urlsplit(session.url).netloc}/spatula/hand", proxy=None) as line:
        assert "KeyQ" in json.loads(line.recv())["keys"]
        line.send("{}")
        with pytest.raises(ConnectionClosed, match="1008"):
            line.recv(timeout=30)


def test_nobody_is_shown_to_the_whole_world(locked):
    assert locked.page.server.request_share_url() is None


class TestRecording:
    """What `spatula record --device web` asks for."""

    def record(self, session, script, verdict="save"):
        start_recording(session, script)
        session._ask(verdict)

    def test_it_ends_when_all_is_recorded(self, datasets):
        told = []
        options = RecordingOptions(
            exclusive=True, episodes=2, author="Ada", description="Mine.", state_dtype="float64", attempts=5
        )
        with (
            make_session(dataset="mine/press-v0", root=datasets / "other", recording=options, progress=told) as session,
            Script(session.url) as script,
        ):
            until(lambda: session.recording.claimed, "the dataset")
            with (
                pytest.raises(DatasetBusy, match="is recording into 'mine/press-v0'"),
                recording_lock(datasets / "other" / "mine" / "press-v0", "mine/press-v0"),
            ):
                pass
            self.record(session, script, "discard")
            until(lambda: session.recording.discarded == 1, "discarding")
            self.record(session, script)
            until(lambda: session.saved == 1, "saving")
            assert not session.recording.done
            self.record(session, script, "success")
            session.wait(200)
            assert session._ended.is_set()
        assert [fate for fate in told if fate != "practice"] == ["discarded", "recorded", "recorded"]
        summary = session.recording.summary()
        assert (summary.recorded, summary.discarded, summary.total_episodes) == (2, 1, 2)
        assert summary.path == datasets / "other" / "mine" / "press-v0"
        dataset = minari.MinariDataset(summary.path / "data")
        assert [attributes(dataset, number)["author"] for number in (0, 1)] == ["Ada", "Ada"]
        assert dataset.storage.metadata["description"] == "Mine."
        assert dataset[0].infos["state"]["nodes"].dtype == np.float64

    def test_failures_are_dropped_states_left_out_and_tries_counted(self, datasets):
        options = RecordingOptions(exclusive=True, attempts=1, keep_failures=False, states=False)
        with make_session(dataset="mine/press-v0", recording=options) as session, Script(session.url) as script:
            self.record(session, script)
            session.wait(200)
            assert session._ended.is_set()
        assert (session.recording.discarded, session.saved) == (1, 0)
        assert "did not reach its goal" in session._said or "All is recorded" in session._said
        assert load("mine/press-v0").total_episodes == 0

    def test_success_ends_an_episode(self, monkeypatch):
        options = RecordingOptions(exclusive=True, total=1, end_on_success=True, states=False)
        with (
            make_session(dataset="mine/press-v0", recording=options, env_kwargs=EASY) as session,
            Script(session.url) as script,
        ):
            start_recording(session, script)
            until(lambda: session._status.text == "The episode is over", "success")
            session._ask("save")
            session.wait(200)
        episode = load("mine/press-v0")[0]
        assert episode.infos["is_success"].tolist() == [False] * len(episode.actions) + [True]
        assert session.recording.successes == 1

    @pytest.mark.parametrize(
        ("options", "error", "message"),
        [
            ({"dataset": "mydata"}, ValueError, "say 'mydata-v0'"),
            ({"dataset": "mine/{task}"}, ValueError, "say 'mine/press-v0'"),
        ],
    )
    def test_names_are_checked_before_anything_is_served(self, options, error, message):
        with pytest.raises(error, match=message):
            WebSession(TASK, port=0, **options)
        with pytest.raises(ValueError, match="attempts must be None, or 1 or more, got 0"):
            RecordingOptions(attempts=0)

    def test_what_does_not_fit_ends_it_at_the_start(self, datasets):
        """Nobody has to look at the page for that."""
        first = gym.make(TASK, engine="batch")
        DatasetWriter("mine/press-v0", first)
        first.close()
        told = []
        with pytest.raises(ValueError, match=r"differ in control_frequency \(10.0 here, 20.0 there\)"):
            serve(
                TASK,
                port=0,
                dataset="mine/press-v0",
                env_kwargs={"engine": "batch", "control_frequency": 10.0},
                recording=RecordingOptions(exclusive=True),
                on_ready=told.append,
            )
        assert len(told) == 1
        (datasets / "file").write_text("")
        with pytest.raises(OSError, match="is no folder"):
            serve(TASK, port=0, root=datasets / "file", recording=RecordingOptions(exclusive=True))

    def test_what_cannot_be_saved_at_the_end_is_told(self, monkeypatch):
        """Nobody may look at the page any more."""

        def full(*_):
            raise DatasetWriteError(28, "no space left")

        session = make_session(dataset="mine/press-v0", recording=RecordingOptions(exclusive=True))
        with session, Script(session.url) as script:
            start_recording(session, script)
            monkeypatch.setattr(DatasetWriter, "add", full)
        with pytest.raises(DatasetWriteError, match="no space left"):
            session.wait(0.0)


EASY = {
    "engine": "batch",
    "task": {
        "depth_range": (0.0061, 0.007),
        "depth_tolerance": 0.006,
        "place_radius": 0.001,
        "place_tolerance": 0.05,
        "start_radius": 0.001,
        "hold_time": 0.1,
    },
}
"""Whoever goes down into the organ has success."""


def make_session(progress=None, **options):
    tell = None if progress is None else lambda fate, _: progress.append(fate)
    return WebSession(TASK, port=0, real_time=False, progress=tell, **{"env_kwargs": {"engine": "batch"}, **options})


SERVED = """
import sys
from spatula_env import cli
from spatula_env.data.episode import EpisodeRecorder
add = EpisodeRecorder.add
def told(self, *step):
    add(self, *step)
    if len(self) == 3:
        print("three steps", file=sys.stderr, flush=True)
EpisodeRecorder.add = told
sys.exit(cli.main(["record", "press", "--device", "web", "--port", "0", "--engine", "batch", "--no-wait",
    "--dataset", "mine/press-v0"]))
"""


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="another system")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_what_ends_the_program_saves_what_is_recorded(name, datasets):
    program = subprocess.Popen(
        [sys.executable, "-c", SERVED], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        url = until(lambda: next((word for word in program.stderr.readline().split() if "http" in word), ""), "a page")
        with Script(url) as script:
            script.hold("Enter")
            # An episode begins when the tool is moved.
            script.hold("KeyQ")
            until(lambda: program.stderr.readline() == "three steps\n", "an episode")
            program.send_signal(getattr(signal, name))
            out, noted = program.communicate(timeout=200)
    finally:
        program.kill()
    assert program.returncode == 0
    assert "recorded: no success" in noted
    assert out.startswith("1 episode added to mine/press-v0")
    dataset = load("mine/press-v0")
    assert dataset.total_episodes == 1
    assert attributes(dataset, 0)["interrupted"]
