"""What does a picture cost? Observed pictures of many worlds in both styles, and against TinyRenderer on one scene.

worlds         Spatula/Press-v0 in `make_vec` with `obs_mode="rgb"` at 84 x 84, in contact: drawing all worlds in the
               plain and in the full style; what a control step with such pictures takes longer than one without; and
               what a second thread brings, beside what it brings to bare arithmetic on this machine now.
tinyrenderer   The same scene, seen by the same camera, at 64 to 512 pixels: the plain style, many worlds and one, and
               TinyRenderer as PyBullet has it, without shadows. Its organ is rigid, which spares it all that depends on
               the shape. Left out, with a message, if PyBullet is not installed.

All sides take turns; a time is the median over the turns, in milliseconds for one picture, of one thread's processor
time, so that other work on the machine matters little. What a second thread brings is a ratio of wall-clock times, the
shortest over the turns, and needs two cores that are free. "agree" is the share of pixels in whose middle TinyRenderer
has the same depth within 2 %.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numba
import numpy as np

import spatula_env
from benchmarks.measure import finish, load_average, output_file, parser
from spatula_env.engines import bullet_hint, bullet_is_there
from spatula_env.envs.pictures import EpisodePictures
from spatula_env.envs.plain_pictures import PlainPictures
from spatula_env.learning.threads import numba_threads
from spatula_env.threads import share_out

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from spatula_env.envs.episodes import Episodes
    from spatula_env.render.camera import Camera

gym.register_envs(spatula_env)

ENVIRONMENT = "Spatula/Press-v0"

SIZES = (64, 128, 256, 512)
"""Sides of the pictures that TinyRenderer draws too [pixels]."""

LEARNERS = 84
"""Side of observed pictures [pixels]."""

TOGETHER = {64: 64, 128: 64, 256: 16, 512: 8}
"""Number of worlds that are drawn together, by the side of a picture: as many as fit into a small memory."""

LIMITS = {"picture_ms": 0.4, "two_threads": 1.7, "of_tinyrenderer": 1.0}
"""Longest time of a plain picture with one thread [ms], least speed-up by a second thread, and longest time relative to
TinyRenderer's."""

AGREE = 0.02
"""Depths that differ by no more than this, relative to them, agree."""

PAUSE = 0.05
"""Time to wait before each turn with threads [s]."""

Work = Callable[[], object]


def take_turns(
    sides: Mapping[str, tuple[Work, int]], turns: int, clock: Callable[[], float] = time.thread_time, pause: float = 0.0
) -> dict[str, list[float]]:
    """Times of each side's work for one picture, turn by turn [ms].

    Args:
        sides: The work of a turn, and the number of pictures that it makes, by name.
        turns: Number of timed turns, after an untimed one.
        clock: The clock [s].
        pause: Time to wait before each turn, after which a busy machine gives cores sooner [s].
    """
    times: dict[str, list[float]] = {name: [] for name in sides}
    for turn in range(turns + 1):
        for name, (work, count) in sides.items():
            time.sleep(pause)
            start = clock()
            work()
            if turn:
                times[name].append(1e3 * (clock() - start) / count)
    return times


def medians(times: Mapping[str, list[float]]) -> dict[str, float]:
    """Median over the turns of each side."""
    return {name: float(np.median(of)) for name, of in times.items()}


def pressed(worlds: int, obs_mode: str = "state", steps: int = 12, **options: Any) -> Any:
    """An environment of many worlds, whose tools have gone down to the organ."""
    env: Any = gym.make_vec(ENVIRONMENT, num_envs=worlds, obs_mode=obs_mode, **options)
    env.reset(seed=0)
    down = np.zeros(env.action_space.shape, dtype=np.float32)
    down[:, 2] = -0.5
    for _ in range(steps):
        env.step(down)
    return env


def episodes_of(env: Any) -> Episodes:
    """The episodes of an environment."""
    episodes: Episodes = env.unwrapped._episodes
    return episodes


def measure_worlds(worlds: int, turns: int) -> dict[str, float]:
    """Times of observed pictures on one thread [ms], as the module's text says."""
    env = pressed(worlds)
    episodes, every = episodes_of(env), np.arange(worlds)
    plain = PlainPictures(episodes, LEARNERS, LEARNERS)
    full = EpisodePictures(episodes, LEARNERS, LEARNERS)
    sides: dict[str, tuple[Work, int]] = {
        "a plain picture": (partial(plain.draw, every, depth=False), worlds),
        "a plain picture with depth": (partial(plain.draw, every, depth=True), worlds),
        "a full picture with depth": (full.rgbd, worlds),
    }
    result = medians(take_turns(sides, turns))
    env.close()
    return {**result, **measure_steps(worlds, turns)}


def measure_steps(worlds: int, turns: int) -> dict[str, float]:
    """Times of control steps for one world [ms]: without pictures, and what pictures add in both styles."""
    envs = {
        "state": pressed(worlds),
        "plain": pressed(worlds, "rgb"),
        "full": pressed(worlds, "rgb", observation={"picture_style": "full"}),
    }
    still = np.zeros(envs["state"].action_space.shape, dtype=np.float32)
    steps = medians(take_turns({name: (partial(env.step, still), worlds) for name, env in envs.items()}, turns))
    for env in envs.values():
        env.close()
    return {
        "a control step without pictures": steps["state"],
        "what plain pictures add to it": steps["plain"] - steps["state"],
        "what full pictures add to it": steps["full"] - steps["state"],
    }


def second_thread(worlds: int, turns: int) -> dict[str, float]:
    """How many times as many plain pictures, and as much bare arithmetic, two threads do as one."""
    env = pressed(worlds)
    plain, every = PlainPictures(episodes_of(env), LEARNERS, LEARNERS), np.arange(worlds)

    def draw(threads: int) -> None:
        with numba_threads(threads):
            plain.draw(every, depth=False)

    def reckon(threads: int) -> None:
        sums = np.zeros(8)

        def work(piece: int) -> None:
            sums[piece] = _reckon(piece)

        share_out(work, 8, threads)

    gains = {}
    for name, work in (("pictures", draw), ("arithmetic", reckon)):
        sides: dict[str, tuple[Work, int]] = {str(threads): (partial(work, threads), 1) for threads in (1, 2)}
        times = take_turns(sides, turns, time.perf_counter, PAUSE)
        gains[name] = min(times["1"]) / min(times["2"])
    env.close()
    return gains


@numba.njit(nogil=True)
def _reckon(piece: int) -> float:
    total = float(piece)
    for i in range(200_000):
        total += np.sin(total + i)
    return total


class TinyRenderer:
    """Draws the scene of an environment's first world with TinyRenderer."""

    def __init__(self, plain: PlainPictures, camera: Camera, client: Any) -> None:
        """Load the scene.

        Args:
            plain: Plain pictures of the same episodes.
            camera: The camera.
            client: PyBullet's module, connected.
        """
        self._client, self._camera = client, camera
        moments = plain.moments(np.arange(1))
        scene, physics = plain.view.scene, plain.view.triangles
        self._add(moments.nodes[0] * moments.unit + moments.origin, physics, (0.83, 0.545, 0.53, 1.0))
        tool = scene.tools[0].tool
        self._tool = self._add(np.array(tool.vertices), np.array(tool.triangles), (0.8, 0.815, 0.83, 1.0))
        place = moments.tool_positions[0, 0] * moments.unit + moments.origin
        self._pose = place.tolist(), moments.tool_orientations[0, 0].tolist()
        if moments.ground_heights is not None:
            low = float(moments.ground_heights[0])
            plane = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
            corners = plane * 100.0 + [0.0, 0.0, low]
            self._add(corners, np.array([[0, 1, 2], [0, 2, 3]]), (0.9, 0.9, 0.9, 1.0))

    def _add(self, vertices: NDArray[Any], triangles: NDArray[Any], color: tuple[float, ...]) -> int:
        client = self._client
        shape = client.createVisualShape(
            client.GEOM_MESH,
            vertices=vertices.tolist(),
            indices=np.asarray(triangles).reshape(-1).tolist(),
            rgbaColor=color,
        )
        return int(client.createMultiBody(baseVisualShapeIndex=shape))

    def draw(self, size: int) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Move the tool to where it is, and draw: the picture (H, W, 4), and its depth (H, W) [u]."""
        client, camera = self._client, self._camera
        client.resetBasePositionAndOrientation(self._tool, *self._pose)
        image = client.getCameraImage(
            size,
            size,
            client.computeViewMatrix(camera.position, camera.target, camera.up),
            client.computeProjectionMatrixFOV(camera.vertical_field_of_view, 1.0, camera.near, camera.far),
            shadow=0,
            renderer=client.ER_TINY_RENDERER,
            flags=client.ER_NO_SEGMENTATION_MASK,
        )
        picture = np.asarray(image[2], dtype=np.uint8).reshape(size, size, 4)
        share = np.asarray(image[3], dtype=np.float64).reshape(size, size)
        depth = camera.far * camera.near / (camera.far - (camera.far - camera.near) * share)
        return picture, depth.astype(np.float32)


@contextmanager
def connected() -> Iterator[Any]:
    """PyBullet's module, connected without a window."""
    from spatula_env._bullet import pybullet

    pybullet.connect(pybullet.DIRECT)
    try:
        yield pybullet
    finally:
        pybullet.disconnect()


def compare(size: int, turns: int, client: Any) -> dict[str, float]:
    """Times of the plain style and of TinyRenderer at one size [ms], as the module's text says, and how they agree."""
    env = pressed(TOGETHER[size])
    plain = PlainPictures(episodes_of(env), size, size)
    tiny = TinyRenderer(plain, plain.view.camera, client)
    every, first = np.arange(TOGETHER[size]), np.arange(1)
    times = take_turns(
        {
            "plain, many worlds": (lambda: plain.draw(every, depth=True), len(every)),
            "plain, one world": (lambda: plain.draw(first, depth=True), 1),
            "TinyRenderer": (lambda: tiny.draw(size), 1),
        },
        turns,
    )
    _, mine = plain.draw(first, depth=True)
    assert mine is not None
    seen, theirs = mine[0] / episodes_of(env).workspace.length, tiny.draw(size)[1]
    env.close()
    client.resetSimulation()
    return {**medians(times), "agree": float((np.abs(seen - theirs) <= AGREE * seen).mean())}


def draw_styles(path: Path) -> None:
    """Draw the tasks at the size of observed pictures, enlarged: in the full style above, in the plain style below."""
    from PIL import Image

    columns = []
    for task in ("Press", "Retract", "Fissure", "Clamp", "Palpate"):
        env: Any = gym.make_vec(f"Spatula/{task}-v0", num_envs=1)
        env.reset(seed=1)
        env.step(np.zeros(env.action_space.shape, dtype=np.float32))
        episodes = episodes_of(env)
        full, _ = EpisodePictures(episodes, LEARNERS, LEARNERS).rgbd()
        plain, _ = PlainPictures(episodes, LEARNERS, LEARNERS).draw(np.arange(1), depth=False)
        columns.append(np.concatenate([full[0], plain[0]]))
        env.close()
    page = np.concatenate(columns, axis=1).repeat(2, axis=0).repeat(2, axis=1)
    Image.fromarray(page).save(path, "PNG", optimize=True)


def main() -> None:
    """Run the benchmark from the command line."""
    options = parser(__doc__ or "")
    options.add_argument("--worlds", type=int, default=64, help="number of worlds (default %(default)s)")
    options.add_argument("--picture", type=output_file, help="PNG to write: five tasks in the full and plain styles")
    options.add_argument("--turns", type=int, default=15, help="timed turns of each side (default %(default)s)")
    arguments = options.parse_args()
    tell = (lambda *_: None) if arguments.json else print
    if arguments.picture is not None:
        draw_styles(arguments.picture)
    with numba_threads(1):
        worlds = measure_worlds(arguments.worlds, arguments.turns)
    for name, value in worlds.items():
        tell(f"{name:32} {value:8.3f} ms")
    limits = {"picture_ms": worlds["what plain pictures add to it"] <= LIMITS["picture_ms"]}
    gains: dict[str, float] = {}
    if numba.config.NUMBA_NUM_THREADS >= 2:  # type: ignore[attr-defined]
        gains = second_thread(arguments.worlds, 3 * arguments.turns)
        tell("two threads over one: " + ", ".join(f"{name} {value:.2f}" for name, value in gains.items()))
        limits["two_threads"] = gains["pictures"] >= LIMITS["two_threads"]
    else:
        print("two threads are left out: NUMBA_NUM_THREADS is 1", file=sys.stderr)
    rows: dict[int, dict[str, float]] = {}
    if bullet_is_there():
        with numba_threads(1), connected() as client:
            for size in SIZES:
                rows[size] = compare(size, arguments.turns, client)
                tell(f"{size} x {size}: " + ", ".join(f"{name} {value:.3f}" for name, value in rows[size].items()))
        limits["of_tinyrenderer"] = all(
            max(row["plain, many worlds"], row["plain, one world"]) <= LIMITS["of_tinyrenderer"] * row["TinyRenderer"]
            for row in rows.values()
        )
    else:
        print(f"TinyRenderer is left out: PyBullet is not installed. {bullet_hint()}", file=sys.stderr)
    finish(
        {
            "benchmark": "cameras",
            "worlds": arguments.worlds,
            "observed_ms": worlds,
            "second_thread": gains,
            "tinyrenderer_ms": rows,
            "limits": LIMITS,
            "within_limits": limits,
            "load": load_average(),
        }
    )


if __name__ == "__main__":
    main()
