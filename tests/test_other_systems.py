"""The package does not depend on features that only some systems have, as far as that can be tested on one of them.

The modules of this package see `os` and `signal` as they are on Windows, and cannot import modules that are missing
there. All other modules see the real system.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

ELSEWHERE = """
import builtins, importlib, os, pkgutil, signal, sys, types

OURS = ("spatula_env", "agents")
MISSING = {"fcntl", "grp", "pty", "pwd", "readline", "resource", "syslog", "termios", "tty", "_posixsubprocess"}
HIDDEN = {
    "signal": {
        "SIGALRM", "SIGCHLD", "SIGCONT", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGQUIT", "SIGSTOP", "SIGTSTP", "SIGUSR1",
        "SIGUSR2", "SIG_BLOCK", "SIG_SETMASK", "SIG_UNBLOCK", "alarm", "pause", "pthread_kill", "pthread_sigmask",
        "setitimer", "sigwait",
    },
    "os": {
        "O_CLOEXEC", "O_DIRECTORY", "O_NONBLOCK", "SCHED_FIFO", "WNOHANG", "chown", "fchmod", "fork", "forkpty",
        "getegid", "geteuid", "getgid", "getloadavg", "getpgid", "getpgrp", "getsid", "getuid", "killpg", "mkfifo",
        "nice", "posix_spawn", "pread", "pwrite", "register_at_fork", "sched_getaffinity", "sched_param",
        "sched_setscheduler", "setpgid", "setsid", "statvfs", "sync", "sysconf", "uname", "wait", "wait3",
    },
}

def with_less(module, hidden):
    shown = types.ModuleType(module.__name__)
    shown.__dict__.update({key: value for key, value in vars(module).items() if key not in hidden})
    return shown

SHOWN = {"os": with_less(os, HIDDEN["os"]), "signal": with_less(signal, HIDDEN["signal"])}
real = builtins.__import__

def importing(name, globals=None, locals=None, fromlist=(), level=0):
    asks = (globals or {}).get("__name__", "").partition(".")[0]
    if asks in OURS and level == 0:
        if name.partition(".")[0] in MISSING:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        if name in SHOWN:
            return SHOWN[name]
    return real(name, globals, locals, fromlist, level)

builtins.__import__ = importing
"""

IMPORT_ALL = """
count = 0
for top in OURS:
    package = importlib.import_module(top)
    names = [found.name for found in pkgutil.walk_packages(package.__path__, f"{top}.", onerror=lambda name: None)]
    for name in names:
        if name.endswith("__main__"):
            continue
        try:
            importlib.import_module(name)
            count += 1
        except ImportError as error:
            # An extra that is not installed here.
            root = (error.name or "").partition(".")[0]
            assert root and root not in OURS and root not in MISSING and root not in HIDDEN, (name, error)
        except Exception as error:
            # Where there is no display.
            assert type(error).__module__.startswith("pyglet"), (name, error)
print(count)
"""

USE = """
import pathlib, tempfile
import gymnasium as gym
from spatula_env.cli import main
from spatula_env.cli.interrupting import endings_like_ctrl_c
from spatula_env.processes import available_cores, _interrupts_held
from spatula_env.learning.folders import occupied

try:
    from spatula_env.learning.checks import memory
except ModuleNotFoundError as error:
    # The extra "train" is not installed.
    assert error.name in ("torch", "stable_baselines3"), error
    memory = lambda: None

with endings_like_ctrl_c(), gym.make("spatula_env:Spatula/Press-v0", engine="batch") as env:
    env.reset(seed=0)
    env.step(env.action_space.sample())
with _interrupts_held():
    assert available_cores() >= 1
assert memory() is None
with tempfile.TemporaryDirectory() as folder:
    place = pathlib.Path(folder)
    with occupied(place / "run"):
        pass
    try:
        import filelock
    except ImportError:
        pass
    else:
        from spatula_env.data import files
        from spatula_env.files import check_can_write

        check_can_write(place)
        files.write_file(place / "file", b"content")
        with files.recording_lock(place / "data", "mine-v0"), files.write_lock(place / "data"):
            files.append_to_file(place / "data" / "file", 0, b"content")
assert main(["envs"]) == 0
print("used")
"""


@pytest.mark.parametrize(("code", "least"), [(IMPORT_ALL, 150), (USE, None)], ids=["import", "use"])
def test_nothing_that_one_system_has_is_taken_for_granted(code: str, least: int | None) -> None:
    done = subprocess.run(
        [sys.executable, "-c", ELSEWHERE + code], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    last = done.stdout.split()[-1]
    assert last == "used" if least is None else int(last) >= least


def test_the_benchmarks_do_not_ask_for_what_one_system_has() -> None:
    wanted = ("os.getloadavg", "signal.SIGKILL", "os.fork", "import resource", "import fcntl")
    for file in (ROOT / "benchmarks").glob("*.py"):
        text = file.read_text(encoding="utf-8")
        # In one place, where it is looked whether there is such a thing.
        assert file.name == "measure.py" or not [name for name in wanted if name in text], file.name
