"""How much processor time does it take to start up?

Each script runs in new processes, with the kernels compiled already. The cost of a process is its CPU time, which other
work on the machine hardly changes; the least of several runs counts. Scripts are compared with the imports that they
cannot do without.
"""

from __future__ import annotations

import subprocess
import sys
from typing import Any

from benchmarks.measure import finish, parser

MAKE = "import gymnasium, spatula_env; env = gymnasium.make('Spatula/Press-v0', engine='batch')"

SCRIPTS = {
    "import gymnasium": "import gymnasium",
    "import numba, gymnasium": "import numba, gymnasium",
    "a kernel of one line": (
        "import numba, gymnasium\nfrom spatula_env.sim import volumes\nvolumes.enclosed_volumes.compile()"
    ),
    "spatula envs": "from spatula_env.cli import main; main(['envs'])",
    "make": MAKE,
    "make, reset, step": f"{MAKE}; env.reset(seed=0); env.step(env.action_space.sample())",
    "make_vec, 64 worlds, reset, step": (
        "import gymnasium, spatula_env; envs = gymnasium.make_vec('Spatula/Press-v0', 64)\n"
        "envs.reset(seed=0); envs.step(envs.action_space.sample())"
    ),
}
"""The scripts, by name."""

RATIOS = {
    "spatula envs": "import gymnasium",
    "make": "import numba, gymnasium",
    "make, reset, step": "import numba, gymnasium",
}
"""For each script that is compared, the script of the imports that it cannot do without."""


def main() -> None:
    """Run the benchmark."""
    arguments = parser(__doc__ or "")
    arguments.add_argument("--repeats", type=int, default=7, help="processes for each script; default: %(default)s")
    chosen = arguments.parse_args()
    if chosen.repeats < 1:
        arguments.error(f"--repeats must be 1 or more, got {chosen.repeats}")
    finish(measure(chosen.repeats, quiet=chosen.json))


def measure(repeats: int, quiet: bool = True) -> dict[str, Any]:
    """Measure all scripts in turn, so that changes of the machine's state affect all of them.

    Args:
        repeats: Number of processes for each script.
        quiet: Whether to print nothing.

    Returns:
        "seconds" of CPU time by script, and "ratios".
    """
    for script in SCRIPTS.values():
        _run(script)
    seconds = dict.fromkeys(SCRIPTS, float("inf"))
    for _ in range(repeats):
        for name, script in SCRIPTS.items():
            seconds[name] = min(seconds[name], _run(script))
    ratios = {f"{one} / {other}": seconds[one] / seconds[other] for one, other in RATIOS.items()}
    if not quiet:
        for name, value in seconds.items():
            print(f"{name:34} {value:6.2f} s")
        for name, value in ratios.items():
            print(f"{name:50} {value:5.2f}")
    return {"seconds": seconds, "ratios": ratios}


def _run(script: str) -> float:
    """CPU time of a process that runs a script, from its start to the end of the script [s]."""
    code = f"{script}\nimport sys, time\nprint(time.process_time(), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return float(done.stderr.splitlines()[-1])


if __name__ == "__main__":
    main()
