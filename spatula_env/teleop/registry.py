"""Devices by name, as used on the command line."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from spatula_env.teleop.device import TeleopDevice
from spatula_env.teleop.haptics.settings import HapticSettings

DEVICES = (
    "falcon",
    "forcedimension",
    "emulated-falcon",
    "keyboard",
    "gamepad",
    "spacemouse",
    "web",
    "scripted",
    "scripted-falcon",
)
"""Names of the devices."""
NEEDS_POLICY = ("scripted", "scripted-falcon")
"""Devices that are driven by a policy."""


def make_device(
    name: str,
    *,
    policy: Callable[[Any], Any] | None = None,
    firmware: str | Path | None = None,
    index: int = 0,
    settings: HapticSettings | None = None,
    **options: Any,
) -> TeleopDevice:
    """Make a device without opening it. Devices with force run their haptic loop in a process of its own.

    Args:
        name: One of `DEVICES`.
        policy: The policy of a scripted operator.
        firmware: File with the Falcon's firmware; None if the Falcon has it loaded already.
        index: Number of the device, if there are several.
        settings: Gains of the haptic loop.
        **options: Further arguments of the device: `reaction_delay`, `tremor`, `gain`, `generator` of a scripted
            operator, `keys` of a keyboard, `host`, `port`, `token` of the web device ….

    Returns:
        The device.

    Raises:
        ValueError: If the device does not exist, or a scripted operator has no policy.
    """
    if name not in DEVICES:
        raise ValueError(f"device must be one of {list(DEVICES)}, got {name!r}")
    if name in NEEDS_POLICY and policy is None:
        raise ValueError(f"device {name!r} needs a policy")
    # Imported on demand: each device has its own dependencies.
    if name in ("falcon", "forcedimension", "emulated-falcon"):
        return _haptic(name, firmware, index, settings, options)
    if name in NEEDS_POLICY:
        from spatula_env.teleop.scripted import ScriptedFalcon, ScriptedOperator

        assert policy is not None
        if name == "scripted":
            return ScriptedOperator(policy, **options)
        return ScriptedFalcon(policy, settings=settings, **options)
    if name == "keyboard":
        from spatula_env.teleop.keyboard import Keyboard

        return Keyboard(**options)
    if name == "gamepad":
        from spatula_env.teleop.gamepad import Gamepad

        return Gamepad(index, **options)
    if name == "web":
        from spatula_env.teleop.web.device import WebDevice

        return WebDevice(**options)
    from spatula_env.teleop.spacemouse import SpaceMouse

    return SpaceMouse(index, **options)


def _haptic(
    name: str, firmware: str | Path | None, index: int, settings: HapticSettings | None, options: dict[str, Any]
) -> TeleopDevice:
    from spatula_env.teleop.haptics.device import HapticDevice

    if name == "falcon":
        from spatula_env.teleop.falcon import Falcon

        return HapticDevice(
            partial(Falcon, index, firmware=firmware, threaded=False), settings, exchange=True, **options
        )
    if name == "forcedimension":
        from spatula_env.teleop.falcon.forcedimension import ForceDimensionDevice

        return HapticDevice(ForceDimensionDevice, settings, **options)
    return HapticDevice(_emulated_falcon, settings, exchange=True, **options)


def _emulated_falcon() -> TeleopDevice:
    from spatula_env.teleop.emulator import RealClock
    from spatula_env.teleop.scripted import EmulatedFalcon

    return EmulatedFalcon(clock=RealClock())
