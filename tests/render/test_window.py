"""The window, on a virtual display: Xvfb, and Mesa's OpenGL on the processor."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import select
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spatula_env import scenes
from spatula_env.installing import install_hint

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PATIENCE = 240.0


def run(arguments: list[str], **variables: str | None) -> subprocess.CompletedProcess[str]:
    """Run Python with some environment variables set, or, where None, not set."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    for name, value in variables.items():
        environment.pop(name, None)
        if value is not None:
            environment[name] = value
    return subprocess.run(
        [sys.executable, *arguments], env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False
    )


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    """A display that nobody sees."""
    if importlib.util.find_spec("pyglet") is None:
        pytest.skip("pyglet is not installed")
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is not installed: apt-get install xvfb libgl1-mesa-dri libglx-mesa0 libgl1")
    reading, writing = os.pipe()
    # The server looks for a free number itself, and writes it down when it is ready.
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(writing), "-screen", "0", "800x600x24", "-nolisten", "tcp"],
        pass_fds=[writing],
        stderr=subprocess.DEVNULL,
    )
    os.close(writing)
    try:
        ready, _, _ = select.select([reading], [], [], 30.0)
        number = os.read(reading, 16).decode().strip() if ready else ""
        if not number:
            pytest.fail(f"Xvfb did not start; it ended with {server.poll()}")
        yield f":{number}"
    finally:
        os.close(reading)
        server.terminate()
        server.wait(30.0)


@pytest.fixture(scope="module")
def session(display: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What happened in `window_session.py`, and its pictures."""
    path = tmp_path_factory.mktemp("window") / "pictures.npz"
    done = run([str(HERE / "window_session.py"), str(path)], DISPLAY=display)
    if done.returncode != 0:
        pytest.fail(f"the session ended with {done.returncode}:\n{done.stderr[-4000:]}")
    with np.load(path) as pictures:
        return json.loads(done.stdout.splitlines()[-1]), {name: pictures[name] for name in pictures.files}


@pytest.mark.parametrize("name", ["seed", "fissure", "clamp"])
def test_the_window_shows_what_pictures_show(session: tuple[dict[str, Any], dict[str, np.ndarray]], name: str) -> None:
    seen, pictures = session
    window, picture = pictures[f"window_{name}"].astype(float), pictures[f"renderer_{name}"].astype(float)
    assert window.shape == picture.shape
    difference = np.abs(window - picture).mean(axis=-1)
    # The light is the same, but for the borders of shadows; so are all outlines.
    assert np.median(difference) < 4.0
    assert difference.mean() < 12.0
    red, _, blue = window[112, 80]
    assert red > blue + 30.0
    assert seen[f"closed_{name}"] is True


def test_the_mouse_turns_shifts_and_moves(session: tuple[dict[str, Any], dict[str, np.ndarray]]) -> None:
    seen, pictures = session
    first = pictures["first"].astype(int)
    for name in ("turned", "closer", "shifted"):
        assert (np.abs(pictures[name].astype(int) - first).max(axis=-1) > 30).mean() > 0.1, name
    before, after = np.array(seen["turned"])
    # Dragged to the right and up: the eye goes to the left and down.
    assert after[2] < before[2] - 0.1
    assert not np.allclose(after[:2], before[:2], atol=0.5)
    assert seen["home_again"] is True
    assert seen["resized"] == [160, 220, 3]


def test_nobody_waits_for_a_window_that_is_closed(session: tuple[dict[str, Any], dict[str, np.ndarray]]) -> None:
    seen, _ = session
    assert seen["open_until_then"] is True
    assert seen["closed_by_user"] is True
    assert seen["closed_by_escape"] is True
    assert "there is no picture" in seen["picture_of_closed"]


def test_moments_keep_their_distance(session: tuple[dict[str, Any], dict[str, np.ndarray]]) -> None:
    seen, _ = session
    assert seen["slept_first"] == 0.0
    assert seen["slept_second"] == pytest.approx(0.05)
    assert seen["slept_third"] == pytest.approx(0.07)
    assert seen["slept_late"] == seen["slept_third"]
    assert seen["slept_closed"] == seen["slept_late"]


def test_an_episode_can_be_watched(session: tuple[dict[str, Any], dict[str, np.ndarray]]) -> None:
    seen, pictures = session
    assert "human" in seen["modes"]
    assert (np.abs(pictures["episode"].astype(int) - pictures["episode_start"]).max(axis=-1) > 30).sum() > 100
    assert seen["returned"] is True
    assert seen["episode_closed"] is True
    assert seen["closed_with_env"] is True


DROP = """
import gc
import gymnasium
import pyglet
import spatula_env
for closed in (True, False, False):
    env = gymnasium.make("Spatula/Press-v0", engine="batch", render_mode="human", width=64, height=64)
    env.reset(seed=0)
    env.render()
    opened = len(list(pyglet.app.windows))
    if closed:
        env.close()
    del env
    gc.collect()
    print(opened, len(list(pyglet.app.windows)))
"""


def test_a_window_goes_with_an_environment_that_is_dropped(display: str) -> None:
    done = run(["-c", DROP], DISPLAY=display)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["1", "0"] * 3


OPEN = """
import numpy as np
from spatula_env import scenes
from spatula_env.render.window import Window
scene = scenes.seed()
try:
    Window(scene, np.array(scene.organs[0].organ.triangles))
except RuntimeError as error:
    print(error)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only on Linux a display has a name")
@pytest.mark.parametrize("name", [None, ":9999"])
def test_without_a_display_the_error_says_what_to_do(name: str | None) -> None:
    if importlib.util.find_spec("pyglet") is None:
        pytest.skip("pyglet is not installed")
    done = run(["-c", OPEN], DISPLAY=name)
    assert done.returncode == 0, done.stderr
    assert "a display is needed" in done.stdout
    assert "rgb_array" in done.stdout


def test_without_pyglet_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    from spatula_env.render.window import Window

    monkeypatch.setitem(sys.modules, "pyglet", None)
    scene = scenes.seed()
    with pytest.raises(ImportError, match=re.escape(install_hint("window"))):
        Window(scene, np.array(scene.organs[0].organ.triangles))


def test_importing_the_window_opens_nothing() -> None:
    done = run(["-c", "import sys, spatula_env.render.window; print('pyglet' in sys.modules)"], DISPLAY=None)
    assert done.stdout.strip() == "False", done.stderr
