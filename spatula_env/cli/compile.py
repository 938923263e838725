"""`spatula compile`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from spatula_env.cli.common import new_parser

if TYPE_CHECKING:
    from spatula_env.cli.common import Parsers
    from spatula_env.sim.engine import ContactName


def add_parser(commands: Parsers) -> None:
    """Add the command."""
    parser = new_parser(
        commands,
        "compile",
        "compile all kernels",
        "Compile all numerical kernels and keep them, so that nothing has to be compiled later. It takes a few "
        "minutes, and seconds if it has been done. The environment variable NUMBA_CACHE_DIR says where they are kept.",
    )
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> int:
    """Compile everything."""
    import logging

    from numba.core import event

    from spatula_env._compilation import COMPILE, Counter
    from spatula_env._kernels import CACHE

    if not CACHE.kept:
        print(f"what is compiled here is lost with this process: kernels are compiled {CACHE.told}", file=sys.stderr)
    counter, logger = Counter(), logging.getLogger("spatula_env")
    level = logger.level
    # This command reports its progress itself; the caller's log level is restored afterwards.
    logger.setLevel(logging.ERROR)
    event.register(COMPILE, counter)  # type: ignore[no-untyped-call]
    try:
        with _progress(len(STEPS)) as begin:
            for name, step in STEPS.items():
                begin(name)
                step()
    finally:
        event.unregister(COMPILE, counter)  # type: ignore[no-untyped-call]
        logger.setLevel(level)
    where = "" if CACHE.folder is None else f", kept in {CACHE.folder}"
    print(f"{counter.count} functions compiled{where}" if counter.count else "everything was compiled already")
    return 0


@contextmanager
def _progress(count: int) -> Iterator[Callable[[str], None]]:
    """Show progress: a bar with Rich in a terminal, otherwise a line for each step.

    Args:
        count: Number of steps.

    Yields:
        A function to call with the name of each step when it begins.
    """
    try:
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
    except ImportError:
        bar = None
    else:
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
        bar = Progress(*columns, TimeElapsedColumn()) if sys.stdout.isatty() else None
    start, done = time.monotonic(), 0
    if bar is None:

        def tell(name: str) -> None:
            nonlocal done
            done += 1
            print(f"[{done}/{count}] {name} ({time.monotonic() - start:.0f} s)", flush=True)

        yield tell
        return
    with bar:
        task = bar.add_task("", total=count)

        def move(name: str) -> None:
            nonlocal done
            bar.update(task, description=name, completed=done)
            done += 1

        yield move
        bar.update(task, description="done", completed=count)


def _contact() -> None:
    from spatula_env.contact import FlaggedDetector
    from spatula_env.geometry import Tool, icosphere

    organ = icosphere()
    FlaggedDetector(Tool.box((0.5, 0.5, 0.1))).detect(
        (0.0, 0.0, 2.0), (0.0, 0.0, 0.0, 1.0), organ.vertices, organ.triangles
    )


def _simulation() -> None:
    from spatula_env import Simulation, scenes
    from spatula_env.engines import bullet_is_there

    for precision in ("single", "double"):
        simulation = Simulation(scenes.seed(), engine="batch", precision=precision)
        simulation.place_tool((0.0, 0.0, 6.0))
        simulation.step()
        simulation.pressures()
        simulation.close()
    contacts: tuple[ContactName, ...] = ("flags", "bullet")
    for contact in contacts if bullet_is_there() else ():
        simulation = Simulation(scenes.seed(), engine="bullet", contact=contact)
        simulation.step()
        simulation.close()


def _tissue() -> None:
    import numpy as np

    from spatula_env import scenes
    from spatula_env.sim.worlds import Worlds

    materials = (scenes.Material(), scenes.Material(relaxation=((0.3, 2.0),)), scenes.Material.brain("cortex"))
    for precision in ("single", "double"):
        for material in materials:
            worlds = Worlds(scenes.seed(material=material), 1, engine="tissue", precision=precision)
            worlds.advance(np.zeros((1, 1, 3)))
            worlds.strains()
            worlds.close()


def _worlds() -> None:
    import numpy as np

    from spatula_env import scenes
    from spatula_env.sim.batch import BatchSimulation

    for dtype in (np.float32, np.float64):
        worlds = BatchSimulation(scenes.seed(), 2, dtype=dtype)
        worlds.set_parameters(stiffness=0.9)
        worlds.settle()
        worlds.advance(np.zeros((2, 1, 3)))


def _environments() -> None:
    import gymnasium

    from spatula_env.naming import env_ids

    for env_id in env_ids():
        env = gymnasium.make(env_id, engine="batch")
        env.reset(seed=0)
        env.step(env.action_space.sample())
        env.close()
        envs = gymnasium.make_vec(env_id, num_envs=2, randomization="default")
        envs.reset(seed=0)
        envs.step(envs.action_space.sample())
        envs.close()


def _pictures() -> None:
    import gymnasium

    from spatula_env.naming import env_ids

    for env_id in env_ids():
        env = gymnasium.make(env_id, engine="batch", render_mode="rgb_array")
        env.reset(seed=0)
        env.step(env.action_space.sample())
        env.render()
        env.close()


def _picture_observations() -> None:
    import gymnasium

    for mode in ("rgb", "rgbd", "pointcloud"):
        envs = gymnasium.make_vec("Spatula/Press-v0", num_envs=2, obs_mode=mode)
        envs.reset(seed=0)
        envs.step(envs.action_space.sample())
        envs.close()


def _what_is_left() -> None:
    """Compile the kernels that no other step has called; all modules with kernels are imported by now."""
    from spatula_env._kernels import Kernel

    for name, module in list(sys.modules.items()):
        if name.startswith("spatula_env."):
            for value in list(vars(module).values()):
                if isinstance(value, Kernel):
                    value.compile()


STEPS: dict[str, Callable[[], None]] = {
    "the contact model": _contact,
    "simulations": _simulation,
    "many worlds at once": _worlds,
    "organs of tissue": _tissue,
    "environments": _environments,
    "pictures": _pictures,
    "observations in pictures and points": _picture_observations,
    "what is left": _what_is_left,
}
"""The steps that compile everything, by name; each is done once, in this order."""
