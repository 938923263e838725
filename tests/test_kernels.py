"""Where compiled kernels are cached, and the messages while they are compiled."""

from __future__ import annotations

import importlib
import logging
import os
import pkgutil
import shutil
import subprocess
import sys
import threading
from itertools import product
from pathlib import Path

import gymnasium
import numba
import numpy as np
import pytest
from numba.core import event
from numba.core.runtime import _nrt_python, rtsys

import spatula_env
from spatula_env import _compilation, scenes
from spatula_env._compilation import COMPILE, Announcer, Cache, find_cache
from spatula_env._kernels import Kernel
from spatula_env.cli import main
from spatula_env.cli.compile import STEPS
from spatula_env.sim.batch import BatchSimulation

PATIENCE = 300.0


@pytest.fixture
def log(caplog):
    """Messages of an announcer of this test's own; the package's may have printed its message before."""
    caplog.set_level(logging.WARNING, logger="spatula_env")
    listener = Announcer(Cache(kept=True))
    event.register(COMPILE, listener)
    yield lambda: list(dict.fromkeys(record.getMessage() for record in caplog.records))
    event.unregister(COMPILE, listener)


def function_of(module):
    def double(number):
        return 2.0 * number

    double.__module__ = module
    return numba.njit(double)


# What is said ------------------------------------------------------------------------------------------------------


def test_compiling_is_announced_once_for_a_part(log):
    made = [
        function_of(name) for name in ("spatula_env.render.made", "spatula_env.render.other", "spatula_env.sim.made")
    ]
    assert not log()
    assert [function(2.0) for function in made] == [4.0, 4.0, 4.0]
    assert log()[:1] == [
        "spatula_env is compiling what draws pictures, once after installation. This can take a minute; "
        "`spatula compile` compiles all of it beforehand."
    ]
    assert [each.partition(",")[0] for each in log()[1:]] == ["spatula_env is compiling the simulation"]
    assert made[0](2) == 4.0
    assert len(log()) == 2


@pytest.mark.parametrize("module", ["benchmarks.made", "spatula_environment.sim", None])
def test_what_others_compile_is_not_announced(log, module):
    assert function_of(module)(2.0) == 4.0
    assert not log()


def test_steps_are_not_spoken_of_however_slow_they_are_and_start_no_thread(log, monkeypatch):
    batch = BatchSimulation(scenes.seed(), 2, parallel=False)
    still = np.zeros((2, 1, 3))
    batch.advance(still)
    before = log()

    def refuse(self):
        raise AssertionError("a thread was started")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    for _ in range(3):
        batch.advance(still, steps=100)
    assert log() == before


MADE = """
from spatula_env._kernels import inline_kernel

@inline_kernel
def double(number):
    return 2.0 * number
"""

SCRIPT = """
import logging, sys
logging.basicConfig(format="%(message)s", stream=sys.stdout)
from spatula_env._kernels import CACHE
from spatula_env.made import double
print(double(2.0), CACHE.kept, CACHE.folder)
"""


def run_copy(site, *prefix, script=SCRIPT, **environment):
    """What a process says that compiles a kernel of a copy of the package."""
    kept = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [*prefix, sys.executable, "-c", script],
        env={**kept, "PYTHONPATH": str(site), **environment},
        cwd=site,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture
def site(tmp_path):
    """A folder with a copy of the package that has a kernel more."""
    folder = tmp_path / "site"
    package = Path(spatula_env.__file__).parent
    shutil.copytree(package, folder / "spatula_env", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "spatula_env" / "made.py").write_text(MADE, encoding="utf-8")
    return folder


def test_loading_is_not_announced(site):
    first = run_copy(site)
    assert first[0].startswith("spatula_env is compiling kernels, once after installation.")
    assert first[1] == "4.0 True None"
    assert run_copy(site) == first[1:]


HELPER = """
from spatula_env._kernels import inline_kernel

STEP = {step}

@inline_kernel
def next_number(number):
    return {factor} * number + STEP
"""

CALLER = """
from spatula_env._kernels import kernel
from spatula_env.helper import next_number

@kernel("f8(f8)")
def twice(number):
    return next_number(next_number(number))
"""


def test_what_is_compiled_into_a_kernel_from_another_file_may_change(site):
    package = site / "spatula_env"
    (package / "made.py").write_text(CALLER.replace("twice", "double"), encoding="utf-8")
    # A constant, then a function, then nothing.
    for step, factor, changes in ((1.0, 1.0, True), (0.5, 1.0, True), (0.5, 3.0, True), (0.5, 3.0, False)):
        (package / "helper.py").write_text(HELPER.format(step=step, factor=factor), encoding="utf-8")
        # Python looks at whole seconds.
        for stale in (package / "__pycache__").glob("helper.*.pyc"):
            stale.unlink()
        said = run_copy(site)
        assert said[-1].split()[0] == str(factor * (factor * 2.0 + step) + step)
        # The kernel is recompiled if something has changed, and only then.
        assert (len(said) > 1) == changes


RECORD = """
from typing import NamedTuple
import numpy as np
from spatula_env._kernels import inline_kernel

class Pair(NamedTuple):
    {first}: np.ndarray
    {second}: np.ndarray

@inline_kernel
def left_of(pair: "Pair") -> float:
    return pair.left[0]
"""

READER = """
from __future__ import annotations
import numpy as np
from spatula_env._kernels import kernel
from spatula_env.record import Pair, left_of

@kernel()
def read(pair: Pair) -> float:
    return left_of(pair)

def double(number):
    return read(Pair(left=np.array([2.0 * number]), right=np.zeros(1)))
"""


def test_the_order_of_a_records_fields_may_change(site):
    package = site / "spatula_env"
    (package / "made.py").write_text(READER, encoding="utf-8")
    for first, second in (("left", "right"), ("right", "left")):
        (package / "record.py").write_text(RECORD.format(first=first, second=second), encoding="utf-8")
        for stale in (package / "__pycache__").glob("record.*.pyc"):
            stale.unlink()
        assert run_copy(site)[-1].split()[0] == "4.0"


DAMAGE = (bytes(400), b"garbage\n", b"\x80\x05\x95\xff\xfe\xfd", b"")
ENDINGS = ("nbi", "nbc")


def test_what_is_damaged_is_compiled_anew(site):
    cases = {f"kernel_{k}": case for k, case in enumerate(product(DAMAGE, ENDINGS))}
    whole = "kernel_whole"
    names = [*cases, whole]
    (site / "spatula_env" / "made.py").write_text("".join(MADE.replace("double", name) for name in names))
    script = f"""
from spatula_env import made
for name in {names}:
    kernel = getattr(made, name)
    print(name, kernel(2.0), "loaded" if kernel.dispatcher.stats.cache_hits else "compiled")
"""

    def run():
        return [line.split() for line in run_copy(site, script=script)]

    assert run() == [[name, "4.0", "compiled"] for name in names]
    for name, (damage, ending) in cases.items():
        (kept,) = (site / "spatula_env" / "__pycache__").glob(f"made.{name}-*.{ending}")
        kept.write_bytes(damage)
    assert run() == [[name, "4.0", "loaded" if name == whole else "compiled"] for name in names]
    assert run() == [[name, "4.0", "loaded"] for name in names]


def test_a_fingerprint_is_the_same_in_every_process():
    script = """
from spatula_env._kernel_cache import fingerprint
from spatula_env.contact.step import resolve_step
from spatula_env.sim.batch_engine import run_block
print(fingerprint(resolve_step), fingerprint(run_block))
"""
    said = {
        subprocess.run(
            [sys.executable, "-c", script],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(said) == 1


# Where it is kept --------------------------------------------------------------------------------------------------


@pytest.fixture
def unwritable(site, tmp_path):
    """The copy and a home that nobody can write to: how to run a process that cannot, and its environment."""
    prefix = []
    if os.geteuid() == 0:
        # The system's administrator may write everywhere, unless that capability is given up.
        if shutil.which("setpriv") is None:
            pytest.skip("the tests run as root, and setpriv is not installed")
        prefix = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]
    (tmp_path / "home").mkdir()
    folders = [site, tmp_path / "home", *(path for path in site.rglob("*") if path.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    yield prefix, {"HOME": str(tmp_path / "home"), "PYTHONDONTWRITEBYTECODE": "1"}
    for folder in folders:
        folder.chmod(0o755)


def test_where_neither_package_nor_home_can_be_written_a_temporary_folder_is_used(unwritable, site, tmp_path):
    prefix, environment = unwritable
    (tmp_path / "tmp").mkdir()
    said = run_copy(site, *prefix, TMPDIR=str(tmp_path / "tmp"), **environment)
    (folder,) = (tmp_path / "tmp").iterdir()
    assert said[0].startswith(f"spatula_env is compiling kernels, once for as long as {folder} is there")
    assert "set the environment variable NUMBA_CACHE_DIR to a folder that lasts" in said[0]
    assert said[1] == f"4.0 True {folder}"
    assert folder.stat().st_mode & 0o777 == 0o700
    # And it is loaded from there.
    assert run_copy(site, *prefix, TMPDIR=str(tmp_path / "tmp"), **environment) == said[1:]


def test_the_environment_variable_is_what_counts(unwritable, site, tmp_path):
    prefix, environment = unwritable
    said = run_copy(site, *prefix, NUMBA_CACHE_DIR=str(tmp_path / "cache"), **environment)
    assert said[1] == "4.0 True None"
    assert list((tmp_path / "cache").iterdir())


@pytest.fixture
def without_a_place(monkeypatch, tmp_path):
    """Numba finds no place but those in a folder for temporary files."""
    monkeypatch.setattr(_compilation.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(_compilation, "_is_kept", lambda: bool(numba.config.CACHE_DIR))
    return tmp_path


def test_a_folder_of_ones_own_is_made_and_found_again(without_a_place):
    first = find_cache()
    assert first.kept
    assert first.folder is not None
    assert first.folder.parent == without_a_place
    numba.config.CACHE_DIR = ""
    assert find_cache() == first


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="there are no modes here")
@pytest.mark.parametrize("kind", ["writable by others", "a link", "a file"])
def test_a_folder_that_others_may_have_filled_is_not_loaded_from(without_a_place, kind):
    folder = without_a_place / f"spatula_env-kernels-{os.getuid()}"
    if kind == "a file":
        folder.write_text("", encoding="utf-8")
    elif kind == "a link":
        (without_a_place / "elsewhere").mkdir()
        folder.symlink_to(without_a_place / "elsewhere")
    else:
        folder.mkdir()
        folder.chmod(0o777)
    found = find_cache()
    assert found == Cache(kept=False)
    assert numba.config.CACHE_DIR == ""
    assert "in every process anew" in found.told
    assert "NUMBA_CACHE_DIR" in found.told


# The command -------------------------------------------------------------------------------------------------------


def test_the_command_does_every_step_and_tells(monkeypatch, capsys):
    done = []
    for name in STEPS:
        monkeypatch.setitem(STEPS, name, lambda name=name: done.append(name))
    level = logging.getLogger("spatula_env").level
    assert main(["compile"]) == 0
    assert logging.getLogger("spatula_env").level == level
    assert done == list(STEPS)
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition("] ")[2].partition(" (")[0] for line in lines[:-1]] == done
    assert lines[-1] == "everything was compiled already"
    monkeypatch.setitem(STEPS, "pictures", lambda: function_of("spatula_env.render.made")(2.0))
    assert main(["compile"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "1 functions compiled"


EVERYTHING = """
import sys
from pathlib import Path
import spatula_env
from spatula_env._kernels import Kernel
from spatula_env.cli.compile import STEPS
for step in STEPS.values():
    step()
package = Path(spatula_env.__file__).parent
for file in package.rglob("*.py"):
    name = ".".join(("spatula_env", *file.relative_to(package).with_suffix("").parts))
    if "from spatula_env._kernels import" in file.read_text(encoding="utf-8") and name not in sys.modules:
        print("not imported:", name)
count = 0
for name, module in list(sys.modules.items()):
    for value in list(vars(module).values()) if name.startswith("spatula_env.") else ():
        if isinstance(value, Kernel):
            count += 1
            if "dispatcher" not in vars(value) and value._signatures:
                print("not compiled:", name, value.__name__)
print(count > 50)
"""


def test_the_command_reaches_every_kernel():
    done = subprocess.run(
        [sys.executable, "-c", EVERYTHING], capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert done.returncode == 0, done.stderr
    # The command itself looks at the cache without being imported as one of its steps.
    assert set(done.stdout.splitlines()) <= {"True", "not imported: spatula_env.cli.compile"}
    assert "True" in done.stdout


STARTING = """
import sys
{}
found = {{name.partition(".")[0] for name in sys.modules}} & set({})
assert not found, found
"""


@pytest.mark.parametrize(
    ("what", "without"),
    [
        ("import spatula_env", ("numba", "scipy", "pybullet", "torch")),
        ("from spatula_env.cli import main; main(['envs'])", ("numba", "scipy", "pybullet", "torch")),
        ("import spatula_env.envs.press", ("pybullet", "torch", "trimesh")),
    ],
)
def test_what_is_not_needed_is_not_imported(what, without):
    script = STARTING.format(what, without)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr


def test_importing_environments_loads_no_kernel():
    script = """
import sys
import spatula_env.envs.press, spatula_env.envs.retract, spatula_env.sim.batch
from spatula_env._kernels import Kernel
kernels = [v for n, m in list(sys.modules.items()) if n.startswith("spatula_env.") for v in list(vars(m).values())
           if isinstance(v, Kernel)]
assert len(kernels) > 50
assert not [kernel.__name__ for kernel in kernels if "dispatcher" in vars(kernel)]
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr


def array_kernels():
    """All helpers that count no references, of all modules."""
    names = ("contact", "sim", "tasks")
    modules = [
        importlib.import_module(module.name)
        for name in names
        for module in pkgutil.iter_modules([str(Path(spatula_env.__file__).parent / name)], f"spatula_env.{name}.")
    ]
    found = {id(each): each for module in modules for each in vars(module).values() if isinstance(each, Kernel)}
    return [each for each in found.values() if not each.counts]


def test_helpers_that_count_no_references_give_and_are_given_none():
    # One that returned an array, or was returned one, would free it too early, or never.
    helpers = array_kernels()
    assert len(helpers) > 50
    for helper in helpers:
        called = [helper.py_func.__globals__.get(name) for name in helper.py_func.__code__.co_names]
        assert not [each for each in called if isinstance(each, Kernel) and each.counts], helper.py_func.__name__
        assert "ndarray" not in str(helper.py_func.__annotations__.get("return")), helper.py_func.__name__


@pytest.fixture
def counted_arrays():
    """Numba counts the arrays that it makes and frees, which it does not by default."""
    _nrt_python.memsys_enable_stats()
    yield
    _nrt_python.memsys_disable_stats()


@pytest.mark.parametrize("task", ["Press", "Retract"])
@pytest.mark.usefixtures("counted_arrays")
def test_steps_leave_no_array_behind(task):
    envs = gymnasium.make_vec(f"Spatula/{task}-v0", num_envs=2)
    envs.reset(seed=5)
    down = np.zeros(envs.action_space.shape, dtype=np.float32)
    down[:, 2] = -1.0

    def kept():
        """How many arrays more have been made than freed."""
        made = rtsys.get_allocation_stats()
        return made.mi_alloc - made.mi_free

    for _ in range(10):
        envs.step(down)
    before = kept()
    for _ in range(20):
        envs.step(down)
    # Workspaces grow, but are few.
    assert abs(kept() - before) < 8
    envs.close()
