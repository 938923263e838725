"""Does the batch engine do what PyBullet does?

free_body      The seed's sphere, pulled by twenty nodal forces as it falls. How far any node is from where PyBullet has
               it, at most, in any step: in double precision, which must follow PyBullet, and in single precision, which
               is for learning. A soft body magnifies what it starts with. The row of PyBullet itself tells how much:
               it starts from vertices rounded to single precision.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.measure import finish, parser
from spatula_env import scenes
from spatula_env.scenes import PlacedOrgan, Scene
from spatula_env.sim.batch_body import BatchBody
from spatula_env.sim.bullet import BulletWorld
from spatula_env.sim.soft_body import soft_body

FREE_BODY_LIMIT = 1e-6
"""Greatest difference of a free body in double precision [u]."""

PULLED_NODES = 20
PULL = 5.0
"""Standard deviation of each component of the forces [kg u/s2]: a twentieth of the organ's weight."""

SHOWN_STEPS = (1, 10, 50, 100, 200)


def free_body(scene: Scene, steps: int, seed: int = 0) -> dict[str, Any]:
    """Pull a free body by constant nodal forces, in PyBullet and in the batch engine.

    Args:
        scene: Its first organ is pulled.
        steps: How many steps.
        seed: Of the nodes and forces.

    Returns:
        Greatest difference of a node in any step [u], by engine; the same by step; how far PyBullet's nodes move apart
        from falling, at most [u].
    """
    generator = np.random.default_rng(seed)
    placed = scene.organs[0]
    scene = dataclasses.replace(scene, organs=(placed,))
    body = soft_body(placed)
    forces = np.zeros_like(body.vertices)
    nodes = generator.choice(len(forces), PULLED_NODES, replace=False)
    forces[nodes] = generator.normal(scale=PULL, size=(PULLED_NODES, 3))
    changes = forces * body.inverse_masses[:, None] * float(np.float32(scene.dt))

    reference = _in_bullet(scene, changes, steps)
    paths = {"bullet_rounded": _in_bullet(scene, changes, steps, rounded=True)}
    for name, dtype in (("float64", np.float64), ("float32", np.float32)):
        paths[name] = _in_batch(placed, scene, changes, steps, dtype)
    differences = {name: np.abs(path - reference).max(axis=(1, 2)) for name, path in paths.items()}
    strain = reference - reference.mean(axis=1, keepdims=True)
    return {
        "steps": steps,
        "difference_u": {name: float(values.max()) for name, values in differences.items()},
        "difference_by_step_u": {
            name: {str(step): float(values[step - 1]) for step in SHOWN_STEPS if step <= steps}
            for name, values in differences.items()
        },
        "deformation_u": float(np.abs(strain - strain[0]).max()),
        "limit_u": FREE_BODY_LIMIT,
        "passed": bool(differences["float64"].max() <= FREE_BODY_LIMIT),
    }


def _in_bullet(scene: Scene, changes: np.ndarray, steps: int, *, rounded: bool = False) -> np.ndarray:
    """Positions (steps, V, 3) in PyBullet."""
    world = BulletWorld(scene)
    try:
        positions, velocities = scene.organs[0].vertices, np.zeros_like(changes)
        if rounded:
            positions = positions.astype(np.float32).astype(np.float64)
            world.set_state(positions, velocities)

        def step() -> np.ndarray:
            nonlocal positions, velocities
            positions, velocities = world.step(positions, velocities + changes)
            return positions

        return _record(step, steps)
    finally:
        world.close()


def _in_batch(placed: PlacedOrgan, scene: Scene, changes: np.ndarray, steps: int, dtype: type) -> np.ndarray:
    """Positions (steps, V, 3) in the batch engine."""
    batch = BatchBody(soft_body(placed), dt=scene.dt, gravity=scene.gravity, dtype=dtype)

    def step() -> np.ndarray:
        batch.step(changes[None])
        return batch.positions[0]

    return _record(step, steps)


def _record(step: Callable[[], np.ndarray], steps: int) -> np.ndarray:
    return np.array([step() for _ in range(steps)])


def main() -> None:
    """Measure and print."""
    options = parser(__doc__ or "")
    options.add_argument("--steps", type=int, default=200)
    arguments = options.parse_args()
    result = free_body(scenes.seed(), arguments.steps)
    if not arguments.json:
        print(f"free body, {result['steps']} steps, deformed by up to {result['deformation_u']:.2f} u")
        for name, difference in result["difference_u"].items():
            by_step = ", ".join(f"{step}: {value:.0e}" for step, value in result["difference_by_step_u"][name].items())
            print(f"  {name:14} at most {difference:.1e} u from PyBullet   (by step {by_step})")
        print(f"  float64 must be within {result['limit_u']:.0e} u: {'passed' if result['passed'] else 'FAILED'}")
    finish({"benchmark": "parity", "free_body": result})


if __name__ == "__main__":
    main()
