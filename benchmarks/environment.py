"""How many control steps does an environment make in a second, with random actions, and how long does a reset take?"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import finish, parser
from spatula_env.learning.configuration import make_environment

DEFAULT = Path(__file__).parents[1] / "configs" / "press.yaml"


def main() -> None:
    """Measure and print."""
    options = parser(__doc__ or "")
    options.add_argument("--config", type=Path, default=DEFAULT)
    options.add_argument("--steps", type=int, default=400)
    arguments = options.parse_args()
    env: Any = make_environment(arguments.config)
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    low, high = env.action_space.low, env.action_space.high
    resets, steps = [], []
    for _ in range(arguments.steps):
        action = generator.uniform(low, high).astype(np.float32)
        start = time.perf_counter()
        _, _, terminated, truncated, _ = env.step(action)
        steps.append(time.perf_counter() - start)
        if terminated or truncated:
            start = time.perf_counter()
            env.reset()
            resets.append(time.perf_counter() - start)
    base = env.unwrapped
    period = base.steps_per_action * base.simulation.dt
    env.close()
    median = float(np.median(steps))
    result = {
        "benchmark": "environment",
        "config": arguments.config.name,
        "steps_per_second": 1.0 / median,
        "simulated_seconds_per_second": period / median,
        "step_ms_median": 1e3 * median,
        "reset_ms_median": 1e3 * float(np.median(resets)) if resets else None,
    }
    if not arguments.json:
        print(
            f"{result['steps_per_second']:.1f} control steps/s,"
            f" {result['simulated_seconds_per_second']:.2f} simulated seconds per second"
        )
    finish(result)


if __name__ == "__main__":
    main()
