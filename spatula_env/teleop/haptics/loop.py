"""The haptic loop: reads the hand, computes a force, sends it, a thousand times a second."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from spatula_env.teleop.device import DeviceError, DeviceSample, FloatArray, TeleopDevice
from spatula_env.teleop.haptics.contact import ZERO, Contact, LoopStatistics, Vector
from spatula_env.teleop.haptics.histogram import PeriodHistogram
from spatula_env.teleop.haptics.rendering import ForceRenderer
from spatula_env.teleop.haptics.settings import PERIOD, HapticSettings
from spatula_env.teleop.haptics.track import HapticTrack, TrackRecorder

Take = Callable[[], Contact | None]
"""Returns the last report of the simulation without waiting."""
Give = Callable[[DeviceSample, Vector], None]
"""Takes the measurement and the force that was sent."""


class HapticLoop:
    """Reads a device, computes a force and sends it, again and again.

    It ends on request or by any exception; in both cases the last force that it sends is zero.

    Attributes:
        renderer: Makes the forces.
        error: The exception that ended `run`; None while it runs or after a regular end.
    """

    def __init__(self, device: TeleopDevice, settings: HapticSettings, take: Take, give: Give, exchange: bool) -> None:
        """Prepare the loop.

        Args:
            device: A position device, open and calibrated.
            settings: The gains.
            take: Returns the last report of the simulation.
            give: Takes the measurement and the force that was sent.
            exchange: Whether the device has no thread of its own, so that every cycle has to call its `exchange`.
        """
        self.renderer = ForceRenderer(
            settings,
            device.greatest_force,
            device.greatest_stiffness,
            device.greatest_damping,
            _corner(device.workspace_low),
            _corner(device.workspace_high),
        )
        self.error: BaseException | None = None
        self._device = device
        self._take, self._give = take, give
        self._exchange: Callable[[], object] | None = getattr(device, "exchange", None) if exchange else None
        if exchange and self._exchange is None:
            raise DeviceError(f"the {device.name} has no method exchange()")
        self._periods = PeriodHistogram()
        self._cycles = 0
        self._names = tuple(device.button_names)
        self._track: TrackRecorder | None = None
        self._last: float | None = None
        self._stopping = False

    def cycle(self) -> None:
        """Run one cycle.

        Raises:
            DeviceLost: If the device no longer answers. The force is then set to zero, if the device still allows it.
        """
        now = self._device.now()
        if self._last is not None:
            self._periods.add(now - self._last)
        self._last = now
        self._cycles += 1
        try:
            if self._exchange is not None:
                self._exchange()
            sample = self._device.read()
            assert sample.position is not None
            position = cast("Vector", tuple(sample.position.tolist()))
            velocity = cast("Vector", tuple(sample.velocity.tolist()))
            contact = self._take()
            force = self.renderer.step(self._device.now(), position, velocity, contact)
            self._device.send_force(force)
            self._give(sample, force)
            if self._track is not None:
                told = ZERO if contact is None else contact.force
                self._track.add(now, position, velocity, told, force, pressed_bits(sample, self._names))
        except BaseException:
            self.release()
            raise

    def run(self, sleep: Callable[[float], None], between: Callable[[], bool] | None = None) -> None:
        """Run cycles until `stop` is called or something fails; the exception is then kept in `error`.

        Args:
            sleep: Waits by the device's clock.
            between: Called after every cycle; False ends the loop.
        """
        try:
            due = self._device.now()
            while not self._stopping:
                self.cycle()
                if between is not None and not between():
                    break
                due += PERIOD
                ahead = due - self._device.now()
                if ahead > 0.0:
                    sleep(ahead)
                else:
                    # Missed cycles are not made up for.
                    due -= ahead
        except BaseException as error:
            # Exceptions in a thread go unnoticed: keep it for the next caller who asks for a sample.
            self.error = error
        finally:
            self.release()

    def keep_track(self, seconds: float) -> None:
        """Record every cycle from now on, for this long at most [s]; 0 stops the recording."""
        self._track = TrackRecorder(round(seconds / PERIOD)) if seconds > 0.0 else None

    def take_track(self) -> HapticTrack:
        """The samples recorded since the last call."""
        recorder = self._track if self._track is not None else TrackRecorder(0)
        return recorder.take(self._names)

    def stop(self) -> None:
        """Make `run` end."""
        self._stopping = True

    def release(self) -> None:
        """Send a force of zero, if the device still allows it."""
        try:
            self._device.send_force(ZERO)
            if self._exchange is not None:
                self._exchange()
        except Exception:
            # The device is lost or closed, and produces no force any more.
            pass

    def statistics(self) -> LoopStatistics:
        """Statistics of how regularly the loop has run so far."""
        periods, renderer = self._periods, self.renderer
        return LoopStatistics(
            cycles=self._cycles,
            median_period=periods.quantile(0.5),
            late_period=periods.quantile(0.99),
            longest_period=periods.longest,
            stalls=renderer.heartbeat.stalls,
            limited=renderer.limited,
            balance=renderer.account.balance,
            pulse=renderer.heartbeat.pulse,
            is_slow=renderer.heartbeat.is_slow,
        )


def pressed_bits(sample: DeviceSample, names: tuple[str, ...]) -> int:
    """The buttons that are held down, as bits."""
    return sum(1 << names.index(name) for name in sample.buttons) if sample.buttons else 0


def _corner(place: FloatArray | None) -> Vector | None:
    return None if place is None else cast("Vector", tuple(place.tolist()))
