"""What does a physics step cost with the Bullet engine, and what share of it is the contact model?

The share of the contact model is everything but Bullet's own step: reading the nodes, detection, response, writing
back.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.measure import finish, parser, require_bullet
from spatula_env import Simulation, scenes

MOTIONS: dict[str, Callable[[int], tuple[float, float, float]]] = {
    "air": lambda index: (0.0, 0.0, 0.05 * np.sin(0.1 * index)),
    "held": lambda index: (0.0, 0.0, 0.0),
    "pressing": lambda index: (0.0, 0.0, 0.05 * np.sin(0.1 * index)),
    "sliding": lambda index: (0.5 * np.sin(0.02 * index), 0.0, 0.5 * np.sin(0.05 * index)),
}
"""Velocity of the tool [u/s] by step, for each motion. From "held" on, the tool is pressed about 1.2 u into the
organ."""


class _Watch:
    """Wraps PyBullet's step, and records the time of each call."""

    def __init__(self, bullet: Any) -> None:
        self._step = bullet.stepSimulation
        self.times: list[float] = []

    def __call__(self, client: int) -> None:
        start = time.perf_counter()
        self._step(client)
        self.times.append(time.perf_counter() - start)


def measure(faces: str, steps: int) -> dict[str, Any]:
    """Time steps of a tool in the air, and of one that is pressed into the organ.

    Args:
        faces: Which faces of the spatula carry contact nodes.
        steps: Number of steps of each motion.

    Returns:
        Times [us] and shares, by motion.
    """
    simulation = Simulation(scenes.seed(faces=faces), engine="bullet")
    engine: Any = simulation.worlds.engine
    world = engine.loaded[0]
    bullet = world._bullet
    watch = _Watch(bullet)
    world._bullet = SimpleNamespace(**{**vars(bullet), "stepSimulation": watch})
    result: dict[str, Any] = {}
    for name in MOTIONS:
        if name == "held":
            simulation.place_tool((0.0, 0.0, simulation.nodes[:, 2].max() + 0.1))
            for _ in range(80):
                simulation.step((0.0, 0.0, -4.0))
        watch.times.clear()
        wholes = []
        for index in range(steps):
            velocity = MOTIONS[name](index)
            start = time.perf_counter()
            simulation.step(velocity)
            wholes.append(time.perf_counter() - start)
        # The share is taken step by step before the median, as pauses of the machine affect a step and its part alike.
        shares = 1.0 - np.array(watch.times) / np.array(wholes)
        result[name] = {
            "step_us_median": 1e6 * float(np.median(wholes)),
            "bullet_us_median": 1e6 * float(np.median(watch.times)),
            "contact_us_median": 1e6 * float(np.median(np.array(wholes) - np.array(watch.times))),
            "contact_share_median": float(np.median(shares)),
            "contact_share_of_total": float(1.0 - np.sum(watch.times) / np.sum(wholes)),
        }
    simulation.close()
    return result


def main() -> None:
    """Measure and print."""
    options = parser(__doc__ or "")
    options.add_argument("--steps", type=int, default=2000)
    arguments = options.parse_args()
    require_bullet("step")
    result = {faces: measure(faces, arguments.steps) for faces in ("largest", "all")}
    if not arguments.json:
        for faces, rows in result.items():
            for name, row in rows.items():
                print(
                    f"faces {faces:8} {name:9} step {row['step_us_median']:5.0f} us, of it contact model"
                    f" {row['contact_us_median']:5.0f} us, {100 * row['contact_share_median']:4.1f} %"
                )
    finish({"benchmark": "step", **result})


if __name__ == "__main__":
    main()
