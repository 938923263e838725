"""What `test_window.py` runs in a process of its own, on a display of its own: a few minutes of somebody's work.

Run as a script, with the name of a file to write pictures to; the last line it writes is what happened, as JSON.
"""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np

from spatula_env import scenes
from spatula_env.render import Moment
from spatula_env.render import window as window_module
from spatula_env.render.scene_view import SceneView
from spatula_env.render.window import Window
from spatula_env.tasks.marks import Patch, Path, Ring

SIZE = 160


class Clock:
    """Time that passes only while somebody sleeps."""

    def __init__(self) -> None:
        self.now, self.slept = 100.0, 0.0

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        self.slept += seconds


def pose_of(scene: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return (
        scene.organs[0].vertices,
        np.array([placed.position for placed in scene.tools]),
        np.array([placed.orientation for placed in scene.tools]),
    )


def look(pictures: dict[str, np.ndarray], seen: dict[str, Any]) -> None:
    """Every kind of scene, beside the picture that the processor draws."""
    for name in ("seed", "fissure", "clamp"):
        scene = getattr(scenes, name)()
        triangles, pose = np.array(scene.organs[0].organ.triangles), pose_of(scene)
        top = float(pose[0][:, 2].max())
        line = np.array([[-1.0, 0.0, top + 0.3], [1.0, 0.0, top + 0.3]])
        what = {
            "forces": np.full((len(scene.tools), 3), 0.2),
            "marks": (Ring(np.array([0.0, 0.0, top - 0.5]), 0.7), Path(line), Patch(np.arange(20), "target")),
        }
        shown = Window(scene, triangles, SIZE, SIZE, frames_per_second=None)
        shown.show(Moment(*pose, **what))
        pictures[f"window_{name}"] = shown.picture()
        shown.close()
        shown.close()
        seen[f"closed_{name}"] = shown.closed
        pictures[f"renderer_{name}"] = SceneView(scene, triangles, SIZE, SIZE).draw(Moment(*pose, **what))


def handle(pictures: dict[str, np.ndarray], seen: dict[str, Any]) -> None:
    """Mouse and keyboard."""
    from pyglet.window import key, mouse

    scene = scenes.clamp()
    triangles, pose = np.array(scene.organs[0].organ.triangles), pose_of(scene)
    shown = Window(scene, triangles, SIZE, SIZE, frames_per_second=None)
    shown.show(Moment(*pose))
    pictures["first"] = shown.picture()
    home = shown.camera
    pane = shown._window
    pane.dispatch_event("on_mouse_drag", 10, 10, 60, 20, mouse.LEFT, 0)
    shown.listen()
    pictures["turned"] = shown.picture()
    seen["turned"] = [home.position, shown.camera.position]
    pane.dispatch_event("on_key_press", key.R, 0)
    shown.listen()
    seen["home_again"] = shown.camera == home
    pane.dispatch_event("on_mouse_scroll", 10, 10, 0, 3)
    shown.listen()
    pictures["closer"] = shown.picture()
    pane.dispatch_event("on_key_press", key.R, 0)
    pane.dispatch_event("on_mouse_drag", 10, 10, 50, 0, mouse.RIGHT, 0)
    shown.listen()
    pictures["shifted"] = shown.picture()
    pane.set_size(SIZE + 60, SIZE)
    shown.show(Moment(*pose))
    seen["resized"] = list(shown.picture().shape)
    # pyglet queues events until the window listens.
    pane.dispatch_event("on_close")
    seen["open_until_then"] = not shown.closed
    shown.listen()
    seen["closed_by_user"] = shown.closed
    shown.show(Moment(*pose))
    shown.listen()
    try:
        shown.picture()
    except RuntimeError as error:
        seen["picture_of_closed"] = str(error)
    second = Window(scene, triangles, SIZE, SIZE, frames_per_second=None)
    second.show(Moment(*pose))
    second._window.dispatch_event("on_key_press", key.ESCAPE, 0)
    second.show(Moment(*pose))
    seen["closed_by_escape"] = second.closed


def wait(seen: dict[str, Any]) -> None:
    """How long a window waits to keep its frame rate."""
    scene = scenes.seed()
    triangles, pose = np.array(scene.organs[0].organ.triangles), pose_of(scene)
    clock = Clock()
    real = window_module.time
    window_module.time = SimpleNamespace(perf_counter=clock.perf_counter, sleep=clock.sleep)
    try:
        shown = Window(scene, triangles, SIZE, SIZE, frames_per_second=20.0)
        shown.show(Moment(*pose))
        seen["slept_first"] = clock.slept
        shown.show(Moment(*pose))
        seen["slept_second"] = clock.slept
        # What the environment itself takes counts.
        clock.now += 0.03
        shown.show(Moment(*pose))
        seen["slept_third"] = clock.slept
        clock.now += 1.0
        shown.show(Moment(*pose))
        seen["slept_late"] = clock.slept
        shown.close()
        shown.show(Moment(*pose))
        seen["slept_closed"] = clock.slept
    finally:
        window_module.time = real


def watch(pictures: dict[str, np.ndarray], seen: dict[str, Any]) -> None:
    """Episodes, shown as Gymnasium does."""
    env = gym.make("Spatula/Press-v0", render_mode="human", width=SIZE, height=SIZE)
    made: Any = env.unwrapped
    seen["modes"] = list(env.metadata["render_modes"])
    env.reset(seed=0)
    shown = made._pictures._window
    shown._period = 0.0
    pictures["episode_start"] = shown.picture()
    for _ in range(6):
        env.step(np.array([0.0, 0.0, -0.6], dtype=np.float32))
    pictures["episode"] = shown.picture()
    seen["returned"] = env.render() is None
    # Somebody closes the window in the middle of an episode, and it goes on.
    shown._window.dispatch_event("on_close")
    env.step(np.array([0.0, 0.0, 0.6], dtype=np.float32))
    seen["episode_closed"] = shown.closed
    env.step(np.array([0.0, 0.0, 0.6], dtype=np.float32))
    env.reset()
    env.close()
    other = gym.make("Spatula/Press-v0", render_mode="human", width=SIZE, height=SIZE)
    other.reset(seed=0)
    second: Any = other.unwrapped
    other.close()
    seen["closed_with_env"] = second._pictures._window.closed


def main() -> None:
    pictures: dict[str, np.ndarray] = {}
    seen: dict[str, Any] = {}
    look(pictures, seen)
    handle(pictures, seen)
    wait(seen)
    watch(pictures, seen)
    np.savez(sys.argv[1], **pictures)
    sys.stdout.write(json.dumps(seen) + "\n")


if __name__ == "__main__":
    main()
