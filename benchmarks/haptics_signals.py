"""How soon the force ends when a signal arrives at the program, at its process group, or at the loop's process.

A program sends a force of 1 N through the haptic loop, which runs in a process of its own, to an emulated Falcon in a
third process, at the other end of a socket. After each signal, the motor commands that have arrived over that socket
are examined.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from spatula_env.teleop.emulator.wire import WireTransport, ask, serve, wait_until
from spatula_env.teleop.falcon import Falcon
from spatula_env.teleop.haptics import HapticDevice

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP", "SIGSTOP", "SIGKILL")
KILL = "SIGKILL"
TARGETS = ("group", "main", "loop")
FORCE = (0.0, 0.0, 1.0)
"""Force that the program sends all the time [N]."""
PATIENCE = 20.0
"""Longest wait for anything [s]."""
WATCHED = 0.2
"""The force counts as ended after it has been zero for this long [s]."""
ROOT = str(Path(__file__).parents[1])


class Program(NamedTuple):
    """A running program that makes an emulated Falcon push.

    Attributes:
        main: Id of its main process, and of its process group.
        loop: Id of the process of its haptic loop.
        address: Address of the device's socket.
    """

    main: int
    loop: int
    address: str


def make_falcon(address: str) -> Falcon:
    """Make a driver for a device behind a socket."""
    return Falcon(transport=partial(WireTransport, address), threaded=False)


def push(address: str) -> None:
    """Act as the program: print the loop's process id, then push until something ends the process."""
    device = HapticDevice(partial(make_falcon, address), where="process", exchange=True)
    with device:
        print(device.ask(_own_process), flush=True)
        while True:
            device.tell(None, FORCE)
            time.sleep(1.0 / 240.0)


@contextmanager
def running() -> Iterator[Program]:
    """Context manager that starts the device and a program that pushes, and kills them at the end of the block."""
    with tempfile.TemporaryDirectory() as folder:
        address = str(Path(folder) / "falcon")
        environment = {**os.environ, "PYTHONPATH": ROOT}
        command = [sys.executable, "-m", "benchmarks.haptics_signals"]
        device = subprocess.Popen([*command, "serve", address], env=environment)
        main = loop = None
        try:
            _check(wait_until(lambda: Path(address).exists(), PATIENCE), "the device does not start")
            main = subprocess.Popen(
                [*command, "push", address],
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                # A process group but no session of its own: SIGTSTP has no effect on an orphaned process group.
                preexec_fn=os.setpgrp,
            )
            assert main.stdout is not None
            loop = int(main.stdout.readline())
            _check(wait_until(lambda: any(ask(address)[-1][1]), PATIENCE), "there is no force")
            # Wait until the force has its full size, and has had it for some time.
            time.sleep(0.3)
            yield Program(main.pid, loop, address)
        finally:
            if main is not None:
                _kill(main.pid)
                main.wait()
                if main.stdout is not None:
                    main.stdout.close()
            if loop is not None:
                _kill(loop)
            device.kill()
            device.wait()


def end_of_force(program: Program, name: str, target: str) -> float:
    """Send a signal, and wait until the force has ended.

    Args:
        program: The program that pushes.
        name: Name of the signal.
        target: "group", "main" or "loop".

    Returns:
        Time from the signal to the first command of zeros after the last push [s].

    Raises:
        RuntimeError: If the force does not end within `PATIENCE`.
    """
    number = getattr(signal, name)
    sent = time.monotonic()
    if target == "group":
        os.killpg(program.main, number)
    else:
        os.kill(program.main if target == "main" else program.loop, number)

    def ended() -> bool:
        history = ask(program.address)
        pushes = [when for when, motors in history if any(motors)]
        return not any(history[-1][1]) and time.monotonic() - pushes[-1] > WATCHED

    _check(wait_until(ended, PATIENCE), f"the force goes on after {name} to the {target}")
    # The last pushing command acts until the next command arrives.
    history = ask(program.address)
    last = max(index for index, (_, motors) in enumerate(history) if any(motors))
    return max(0.0, history[last + 1][0] - sent)


def measure_signals() -> dict[str, float]:
    """Time from each signal to each target until zeros arrive [ms]; empty on systems without process groups."""
    found: dict[str, float] = {}
    if not hasattr(os, "killpg"):
        return found
    for target in TARGETS:
        for name in SIGNALS:
            with running() as program:
                found[f"{name} to the {target}"] = 1e3 * end_of_force(program, name, target)
    return found


def _own_process(_: Any) -> int:
    return os.getpid()


def _check(holds: bool, otherwise: str) -> None:
    if not holds:
        raise RuntimeError(otherwise)


def _kill(process: int) -> None:
    try:
        os.kill(process, getattr(signal, KILL))
    except ProcessLookupError:
        pass


if __name__ == "__main__":
    {"serve": serve, "push": push}[sys.argv[1]](sys.argv[2])
