from __future__ import annotations

import importlib
import os
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# No deadline: the machine may be busy, and the first example of a test may load kernels. Tests whose cases come from a
# seed sort out those in which nothing meets, and chance may make that many at a time.
settings.register_profile(
    "spatula_env",
    deadline=None,
    suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow],
)
settings.load_profile("spatula_env")

ROOT = Path(__file__).parents[1]

OWN_PRESS = dedent('''
    """Press under other names."""

    import gymnasium
    from spatula_env.envs import PressEnv, SpatulaEnv, SpatulaVectorEnv

    class MyEnv(PressEnv):
        """Press, in one's own words."""

    class MyVectorEnv(SpatulaVectorEnv):
        """Many."""
        definition = PressEnv.definition

    class AloneEnv(SpatulaEnv):
        """Press without a class for many worlds."""
        definition = PressEnv.definition

    class MoreEnv(AloneEnv):
        """One that does more than its definition says."""
        def step(self, action):
            return super().step(action)

    MINE = (("Press", "MyEnv", "MyVectorEnv"), ("Alone", "AloneEnv", None), ("More", "MoreEnv", None))
    for name, maker, many in MINE:
        gymnasium.register(
            id=f"Mine/{name}-v0", entry_point=f"{__name__}:{maker}",
            vector_entry_point=None if many is None else f"{__name__}:{many}", max_episode_steps=200,
        )
''')  # fmt: skip


@pytest.fixture
def own_press(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Name of a user's module, in `tmp_path`, that registers "Mine/Press-v0" when it is imported.

    It has not been imported yet, neither here nor in processes that are started. At the end, everything that it has
    registered is removed.
    """
    import gymnasium

    name = "own_press"
    (tmp_path / f"{name}.py").write_text(OWN_PRESS, encoding="utf-8")
    ids = set(gymnasium.registry)
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    yield name
    sys.modules.pop(name, None)
    for added in set(gymnasium.registry) - ids:
        del gymnasium.registry[added]


WITHOUT_BULLET = "SPATULA_TESTS_WITHOUT_BULLET"
"""Environment variable: if it is "1", PyBullet cannot be imported in the tests and the processes that they start."""

if os.environ.get(WITHOUT_BULLET) == "1":
    stand_in = str(Path(__file__).parent / "without_bullet")
    sys.path.insert(0, stand_in)
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [stand_in, os.environ.get("PYTHONPATH")]))


def no_bullet() -> str | None:
    """The reason why PyBullet cannot be imported; None if it can."""
    try:
        import_module("pybullet")
    except ImportError as error:
        return str(error)
    return None


NO_BULLET = no_bullet()


def pytest_configure(config: pytest.Config) -> None:
    # In the background, or under nohup, a shell starts the tests with signals ignored, which child processes inherit.
    for name, default in (("SIGINT", signal.default_int_handler), ("SIGHUP", signal.SIG_DFL)):
        if hasattr(signal, name) and signal.getsignal(getattr(signal, name)) is signal.SIG_IGN:
            signal.signal(getattr(signal, name), default)
    if NO_BULLET is not None:
        # The warning that another engine is then the default is tested elsewhere.
        config.addinivalue_line("filterwarnings", "ignore:PyBullet is not installed, so environments:UserWarning")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Number of workers: one more than cores, as tests of pages and of other processes wait much of their time.

    In the first run, in which all workers compile the same kernels, it is the number of cores.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return cores + any((ROOT / "spatula_env").glob("*/__pycache__/*.nbi"))


def _names_bullet(value: Any) -> bool:
    values = value.values() if isinstance(value, dict) else (value,)
    return any(isinstance(one, str) and one == "bullet" for one in values)


def read_slow() -> dict[str, float]:
    """Tests that `make test-fast` leaves out, and the total time of each over all its parameters [s]."""
    lines = (Path(__file__).parent / "slow.txt").read_text(encoding="utf-8").splitlines()
    return {name: float(seconds) for name, seconds in map(str.split, lines)}


SLOW = read_slow()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark slow tests and tests of PyBullet, skip the latter where it is not installed, and sort long files first.

    A test is one of PyBullet if "bullet" is one of its parameters, as an engine or a contact model. A file stays on one
    worker: if a long one began last, the other workers would wait for it.
    """
    lengths: Counter[Path] = Counter()
    for name, seconds in SLOW.items():
        lengths[ROOT / name.partition("::")[0]] += seconds
    items.sort(key=lambda item: -lengths[item.path])
    for item in items:
        if item.nodeid.partition("[")[0] in SLOW:
            item.add_marker(pytest.mark.slow)
        parameters = item.callspec.params if isinstance(item, pytest.Function) and hasattr(item, "callspec") else {}
        if any(_names_bullet(value) for value in parameters.values()):
            item.add_marker(pytest.mark.bullet)
        if NO_BULLET is not None and item.get_closest_marker("bullet"):
            item.add_marker(pytest.mark.skip(reason=f"needs PyBullet: {NO_BULLET}"))
