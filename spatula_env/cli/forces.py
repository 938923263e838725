"""Options of force feedback, and the report on it after a session."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING, Any

from spatula_env.cli.common import CommandError, note

if TYPE_CHECKING:
    import gymnasium

    from spatula_env.teleop.device import TeleopDevice
    from spatula_env.teleop.haptics.contact import LoopStatistics
    from spatula_env.teleop.haptics.settings import HapticSettings

HELD = ("falcon", "forcedimension")
"""Devices that a human holds."""
HAPTIC = (*HELD, "emulated-falcon", "scripted-falcon")
"""Devices with force feedback."""
ROLES = ("center", "forward", "plus", "minus", "finish", "discard", "quit")
"""Functions that can be assigned to a button."""
GRIP_WEIGHT = 0.7
"""Weight of a Falcon's grip that the motors bear by default: less than the 0.9 N that others have found, so that it
sinks [N]."""


def add_force_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of force feedback."""
    group = parser.add_argument_group("what the hand feels")
    scale = group.add_mutually_exclusive_group()
    scale.add_argument(
        "--force-scale",
        type=float,
        metavar="FACTOR",
        help="force on the hand over force on the tool (default: so that the task's usual peak is 2 to 3 N; "
        "1 for a program that holds the device)",
    )
    scale.add_argument("--no-force", action="store_true", help="nothing is felt")
    group.add_argument(
        "--coupling",
        type=float,
        metavar="N/M",
        help="with which stiffness an organ is felt until its own is known (default: 60)",
    )
    group.add_argument(
        "--grip-weight",
        type=float,
        metavar="N",
        help=f"of the grip, which the motors bear (default: {GRIP_WEIGHT:g} with --device falcon, else 0)",
    )
    group.add_argument(
        "--buttons",
        metavar="NAME=AS,...",
        help="what a button is to be taken for: center (clutch), forward, plus, minus, finish, discard or quit; as "
        "forward=finish,minus=discard",
    )
    group.add_argument(
        "--no-centring",
        action="store_true",
        help="do not ask for the grip to be brought to the middle before an episode",
    )


def read_buttons(chosen: argparse.Namespace) -> dict[str, str] | None:
    """Read the functions assigned to buttons.

    Raises:
        CommandError: If the option is malformed.
    """
    if chosen.buttons is None:
        return None
    pairs = [word.split("=") for word in chosen.buttons.split(",")]
    if any(len(pair) != 2 or not all(pair) for pair in pairs):
        raise CommandError(f"--buttons must be NAME=AS,NAME=AS..., got {chosen.buttons!r}")
    buttons = {name.strip(): role.strip() for name, role in pairs}
    for role in buttons.values():
        if role not in ROLES:
            raise CommandError(f"--buttons must take a button for one of {', '.join(ROLES)}, got {role!r}")
    return buttons


def force_settings(chosen: argparse.Namespace, env: gymnasium.Env[Any, Any]) -> HapticSettings:
    """The gains that the command line asks for; prints the force scale if a human feels it.

    Args:
        chosen: Arguments of `add_force_options`.
        env: The environment, whose task has a force scale.

    Raises:
        CommandError: If a number is not allowed.
    """
    from spatula_env.teleop.haptics.scales import force_scale
    from spatula_env.teleop.haptics.settings import HapticSettings

    if chosen.no_force:
        return HapticSettings(force_scale=0.0, wall_stiffness=0.0)
    held = chosen.device in HELD
    changes: dict[str, float] = {"force_scale": force_scale(env) if held else 1.0}
    if chosen.device == "falcon":
        changes["weight"] = GRIP_WEIGHT
    for name, option in (("force_scale", "force_scale"), ("stiffness", "coupling"), ("weight", "grip_weight")):
        value = getattr(chosen, option)
        if value is not None:
            if not 0.0 <= value < math.inf:
                raise CommandError(f"--{option.replace('_', '-')} must be zero or more and finite, got {value:g}")
            changes[name] = value
    try:
        settings = HapticSettings(**changes)
    except ValueError as error:
        raise CommandError(str(error)) from None
    if held:
        note(f"The hand feels {settings.force_scale:g} times the force on the tool (--force-scale).")
    return settings


def tell_loop(device: TeleopDevice) -> None:
    """Print how a device's haptic loop went, if it has one and still answers."""
    from spatula_env.teleop.device import DeviceError
    from spatula_env.teleop.haptics.device import HapticDevice

    if not isinstance(device, HapticDevice) or not device.is_open:
        return
    try:
        note(loop_in_words(device.statistics()))
    except DeviceError:
        # The reason for the loss of the device has been reported already.
        pass


def loop_in_words(found: LoopStatistics) -> str:
    """Describe a haptic loop in a line."""
    rate = 1.0 / found.median_period if found.median_period > 0.0 else 0.0
    held_back = found.limited / found.cycles if found.cycles else 0.0
    return (
        f"haptic loop: {rate:.0f} Hz, 99 of 100 periods within {1e3 * found.late_period:.2f} ms, longest "
        f"{1e3 * found.longest_period:.1f} ms; let go {found.stalls} times because the simulation stood still; felt "
        f"softer than the organ {held_back:.1%} of the time, so that the loop stays stable (passivity)"
    )
