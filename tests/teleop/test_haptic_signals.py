"""Whatever ends a program ends the force: real signals, real processes, an emulated device at the end of a socket."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from spatula_env.teleop.emulator.wire import ask, wait_until

if sys.platform == "win32":
    pytest.skip("signals and sockets of Unix", allow_module_level=True)

from benchmarks.haptics_signals import end_of_force, running


@pytest.mark.parametrize(
    ("name", "target"),
    [("SIGTERM", "group"), ("SIGKILL", "group"), ("SIGHUP", "loop"), ("SIGKILL", "loop"), ("SIGSTOP", "loop")],
)
def test_a_signal_ends_the_force(name, target):
    with running() as program:
        end_of_force(program, name, target)


def test_a_program_that_is_stopped_pushes_no_more_and_goes_on_afterwards():
    with running() as program:
        end_of_force(program, "SIGTSTP", "group")
        os.killpg(program.main, signal.SIGCONT)
        assert wait_until(lambda: any(ask(program.address)[-1][1]), 20.0)
        end_of_force(program, "SIGTSTP", "loop")
        os.kill(program.loop, signal.SIGCONT)
        assert wait_until(lambda: any(ask(program.address)[-1][1]), 20.0)
