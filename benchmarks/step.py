"""What a physics step costs with the Bullet engine, and what part of it the contact model is.

The contact model's share is everything but Bullet's own step: reading the nodes, detection, response, writing back.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks.measure import finish, parser
from spatula_env import Simulation, scenes


class _TimedBullet:
    """PyBullet, with the time spent in its step added up."""

    def __init__(self, bullet: Any) -> None:
        self._bullet = bullet
        self.seconds = 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bullet, name)

    def stepSimulation(self, client: int) -> None:
        start = time.perf_counter()
        self._bullet.stepSimulation(client)
        self.seconds += time.perf_counter() - start


def measure(faces: str, steps: int) -> dict[str, Any]:
    """Time steps of a press that moves gently, and of a tool in the air.

    Args:
        faces: Which faces of the spatula carry contact nodes.
        steps: How many of each.

    Returns:
        Microseconds and share, in contact and in the air.
    """
    simulation = Simulation(scenes.seed(faces=faces))
    timed = _TimedBullet(simulation._world._bullet)
    simulation._world._bullet = timed
    result: dict[str, Any] = {}
    for name in ("air", "contact"):
        if name == "contact":
            simulation.place_tool((0.0, 0.0, simulation.nodes[:, 2].max() + 0.1))
            for _ in range(80):
                simulation.step((0.0, 0.0, -4.0))
        timed.seconds = 0.0
        wholes = []
        for index in range(steps):
            start = time.perf_counter()
            simulation.step((0.0, 0.0, 0.05 * np.sin(0.1 * index)))
            wholes.append(time.perf_counter() - start)
        whole = float(np.sum(wholes))
        result[name] = {
            "step_us_median": 1e6 * float(np.median(wholes)),
            "bullet_us_mean": 1e6 * timed.seconds / steps,
            "contact_us_mean": 1e6 * (whole - timed.seconds) / steps,
            "contact_share": 1.0 - timed.seconds / whole,
        }
    simulation.close()
    return result


def main() -> None:
    """Measure and print."""
    options = parser(__doc__ or "")
    options.add_argument("--steps", type=int, default=2000)
    arguments = options.parse_args()
    result = {faces: measure(faces, arguments.steps) for faces in ("largest", "all")}
    if not arguments.json:
        for faces, rows in result.items():
            for name, row in rows.items():
                print(
                    f"faces {faces:8} {name:8} step {row['step_us_median']:7.0f} us, of it contact model"
                    f" {100 * row['contact_share']:4.1f} %"
                )
    finish({"benchmark": "step", **result})


if __name__ == "__main__":
    main()
