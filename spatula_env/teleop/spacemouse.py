"""A SpaceMouse of 3Dconnexion as a teleoperation device: six rates at once."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from spatula_env.installing import install_hint
from spatula_env.teleop.device import DeviceBusy, DeviceError, DeviceLost, DeviceNotFound
from spatula_env.teleop.keys import RateDevice

BUTTONS: Mapping[int, str] = MappingProxyType({0: "minus", 1: "plus"})
"""Names of the buttons by number: left and right."""
DEAD_ZONE = 0.05
"""Deflection up to which the cap counts as centred."""
MOST_READS = 64
"""Number of reports that are processed at once; more can be queued after a long pause."""
JAW_BUTTONS = ("minus", "plus")


class SpaceMouse(RateDevice):
    """A SpaceMouse, through pyspacemouse.

    Opened in the convention ``HID_Z_UP``, whose axes are those of the device frame: x to the right, y away from the
    operator, z up, and right-handed rotations about them. pyspacemouse's default is inconsistent, and has changed. The
    two buttons close and open jaws.
    """

    def __init__(self, index: int = 0, *, buttons: Mapping[int, str] = BUTTONS, dead_zone: float = DEAD_ZONE) -> None:
        """Store the settings of the device; `open` opens it.

        Args:
            index: Number of the device, if there are several.
            buttons: Names of buttons by number.
            dead_zone: Deflection up to which the cap counts as centred; larger deflections are measured from there.

        Raises:
            ValueError: If `dead_zone` is not in [0, 1).
        """
        if not 0.0 <= dead_zone < 1.0:
            raise ValueError(f"dead_zone must be 0 or more and less than 1, got {dead_zone!r}")
        super().__init__("SpaceMouse", tuple(buttons.values()))
        self._index = index
        self._button_map = dict(buttons)
        self._dead_zone = dead_zone
        self._mouse: Any = None

    def _start(self) -> None:
        try:
            import pyspacemouse
            from pyspacemouse.types import AxisConvention
        except ImportError as error:
            raise ImportError(f"a SpaceMouse needs pyspacemouse: {install_hint('teleop')}") from error
        try:
            found = pyspacemouse.get_connected_devices()
        except Exception as error:
            # pyspacemouse raises an error without a class of its own for this.
            raise DeviceError(
                f"a SpaceMouse needs the system's HIDAPI, which does not work here ({error}): apt-get install "
                "libhidapi-hidraw0, or brew install hidapi"
            ) from error
        if not found:
            raise DeviceNotFound(
                "there is no SpaceMouse: connect one, and let users open it with the udev rule "
                'KERNEL=="hidraw*", ATTRS{idVendor}=="256f", MODE="0660", GROUP="plugdev"'
            )
        try:
            self._mouse = pyspacemouse.open(
                device_index=self._index, nonblocking=True, axis_convention=AxisConvention.HID_Z_UP
            )
        except Exception as error:
            # Catch everything: pyspacemouse's errors have no common class.
            raise DeviceBusy(f"the SpaceMouse could not be opened: {error}") from error

    def _poll(self) -> tuple[dict[str, float], frozenset[str]]:
        mouse = self._mouse
        try:
            state = mouse.read()
            for _ in range(MOST_READS):
                last, state = state.t, mouse.read()
                if state.t == last:
                    break
        except Exception as error:
            raise DeviceLost(f"the SpaceMouse does not answer any more ({error}); open it again") from error
        names = {"roll": "rotation_x", "pitch": "rotation_y", "yaw": "rotation_z"}
        rates = {name: self._beyond(getattr(state, name)) for name in ("x", "y", "z")}
        rates |= {ours: self._beyond(getattr(state, theirs)) for theirs, ours in names.items()}
        pressed = {
            name for number, name in self._button_map.items() if number < len(state.buttons) and state.buttons[number]
        }
        less, more = (float(name in pressed) for name in JAW_BUTTONS)
        return {**rates, "jaw_speed": more - less}, frozenset(pressed)

    def _beyond(self, deflection: float) -> float:
        beyond = max(0.0, abs(deflection) - self._dead_zone) / (1.0 - self._dead_zone)
        return beyond if deflection > 0.0 else -beyond

    def _stop(self) -> None:
        self._mouse.close()
        self._mouse = None
