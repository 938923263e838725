"""`spatula falcon`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spatula_env.cli.common import FAILURE, CommandError, add_json_option, at_least, new_parser, note, print_json

if TYPE_CHECKING:
    from spatula_env.cli.common import Parsers
    from spatula_env.teleop.emulator.hand import Motion
    from spatula_env.teleop.falcon import Falcon

DESCRIPTION = """Check a Novint Falcon step by step, from the cable to the motors.

  found      is one on the USB, and may this program open it?
  firmware   does it have its firmware, or can FILE be loaded?
  packets    does it answer a thousand times a second?
  homed      does it know where its grip is? You are told how to move it.
  frames     is right right, away away, and up up? You are asked to move the grip.
  force      does it push? It asks first, and pushes gently, six times.

--emulated does the same with a Falcon in software and a hand that does as it is told: nothing is
plugged in, and it tells nothing about a device."""


def add_parser(commands: Parsers) -> None:
    """Add the command."""
    parser = new_parser(commands, "falcon", "check a Novint Falcon step by step", DESCRIPTION)
    parser.add_argument("--emulated", action="store_true", help="a Falcon in software, to see what the check is like")
    parser.add_argument("--firmware", type=Path, metavar="FILE", help="the Falcon's firmware, if it has forgotten it")
    parser.add_argument(
        "--index", metavar="N", type=at_least(0), default=0, help="which one, if there are several (default: 0)"
    )
    parser.add_argument(
        "--weigh",
        metavar="GRAMS",
        type=float,
        help="afterwards, find out how great its forces are by a weight of 50 to 400 g that you hang to the grip",
    )
    force = parser.add_mutually_exclusive_group()
    force.add_argument("--yes", action="store_true", help="push without asking")
    force.add_argument("--no-force", action="store_true", help="do not push")
    add_json_option(parser)
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> int:
    """Run the check."""
    from spatula_env.teleop.falcon.check import check_falcon
    from spatula_env.teleop.falcon.transport import find_falcons

    say: Callable[[str], None] = note if chosen.json else lambda text: print(text, flush=True)
    falcon: Falcon
    find: Callable[[], Sequence[object]] = find_falcons
    hear: Callable[[str], None] = say
    if chosen.emulated:
        say("This Falcon is software; nothing is plugged in.")
        for option, given, why in (
            ("--firmware", chosen.firmware is not None, "it has its firmware"),
            ("--index", chosen.index != 0, "there is only one"),
            ("--yes", chosen.yes, "it asks nobody"),
            ("--weigh", chosen.weigh is not None, "nothing can be hung to it"),
        ):
            if given:
                say(f"{option} is ignored: {why}.")
        falcon, find, obey = _emulated()

        def hear(text: str) -> None:
            say(text)
            obey(text)
    else:
        from spatula_env.teleop.falcon import Falcon

        falcon = Falcon(chosen.index, firmware=chosen.firmware)
    steps = check_falcon(falcon, hear, lambda question: _consent(chosen, question, say), find)
    if chosen.weigh is not None and not chosen.emulated and all(step.passed for step in steps):
        _weigh(falcon, chosen, say)
    good = all(step.passed is not False for step in steps)
    left_out = [step.name for step in steps if step.passed is None]
    if chosen.json:
        print_json({"emulated": chosen.emulated, "passed": good, "steps": [asdict(step) for step in steps]})
    elif good:
        untried = f"; not tried: {', '.join(left_out)}" if left_out else ""
        print(f"All is well{untried}.")
    else:
        print(f"The check ended at {steps[-1].name!r}; see above for what to do.")
    return 0 if good else FAILURE


def _weigh(falcon: Falcon, chosen: argparse.Namespace, say: Callable[[str], None]) -> None:
    """Measure how great the forces are, and print the options that correct them."""
    from spatula_env.teleop.falcon.weighing import weigh

    with falcon:
        falcon.calibrate(say)
        try:
            found = weigh(falcon, 1e-3 * chosen.weigh, say, lambda question: _consent(chosen, question, say))
        except ValueError as error:
            raise CommandError(f"--weigh: {error}") from None
    say(
        f"Forces are {found.factor:.2f} times what they are asked to be, and the grip weighs "
        f"{found.grip * found.factor:.2f} N: give --force-scale {1.0 / found.factor:.2f} times what you want, and "
        f"--grip-weight {0.9 * found.grip:.2f}."
    )


def _consent(chosen: argparse.Namespace, question: str, say: Callable[[str], None]) -> bool:
    """Ask for consent, unless an option answers beforehand; without a terminal the answer is no."""
    if chosen.no_force:
        return False
    if chosen.yes or chosen.emulated:
        return True
    say(question)
    if not sys.stdin.isatty():
        say("Nobody is there to answer; --yes answers beforehand.")
        return False
    return input("yes or no: ").strip().lower() in ("y", "yes")


def _emulated() -> tuple[Any, Callable[[], Sequence[object]], Callable[[str], None]]:
    """A Falcon in software, a function that lists it, and one that tells its hand what the check asks for."""
    from spatula_env.teleop.emulator import ElasticHand, FalconEmulator, homing_motion
    from spatula_env.teleop.falcon import Falcon

    obedient = _Obedient(homing_motion(start=0.6))
    emulator = FalconEmulator(ElasticHand(obedient))
    clock = emulator.clock
    falcon = Falcon(transport=emulator.connect, clock=clock.now, sleep=clock.sleep, threaded=False)
    return falcon, lambda: [emulator.name], obedient.hear


class _Obedient:
    """Position at which an operator wants the grip: the homing motion, then wherever the check asks for."""

    def __init__(self, homing: Motion) -> None:
        self._homing = homing
        self._offset = (0.0, 0.0, 0.0)

    def __call__(self, time: float) -> tuple[float, float, float]:
        x, y, z = self._homing(time)
        return x + self._offset[0], y + self._offset[1], z + self._offset[2]

    def hear(self, text: str) -> None:
        """Follow a request of the check."""
        from spatula_env.teleop.falcon.check import MIDDLE_REQUEST, MOVES

        for request, direction in MOVES:
            if text == request:
                right, away, up = (0.025 * value for value in direction)
                # The Falcon's own frame: x to the right, y up, z towards the operator.
                x, y, z = self._offset
                self._offset = (x + right, y + up, z - away)
                return
        if text == MIDDLE_REQUEST:
            self._offset = (0.0, 0.0, 0.0)
