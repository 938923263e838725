"""The haptic loop: hand, contact, force, a thousand times a second."""

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
"""Gives the last that is known of the simulation, at once."""
Give = Callable[[DeviceSample, Vector], None]
"""Takes what was measured, and the force that was sent."""


class HapticLoop:
    """Reads a device, makes a force, sends it; over and over.

    It ends when it is told to, and by any exception; either way the last force that it sends is zero.

    Attributes:
        renderer: Makes the forces.
        error: What ended `run`; None while it runs or after a regular end.
    """

    def __init__(self, device: TeleopDevice, settings: HapticSettings, take: Take, give: Give, exchange: bool) -> None:
        """Prepare.

        Args:
            device: Open, calibrated, a position device.
            settings: The gains.
            take: Gives the last that is known of the simulation.
            give: Takes what was measured and sent.
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
        """Go round once.

        Raises:
            DeviceLost: If the device does not answer any more. The force is zero then, as far as can be.
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
        """Go round until `stop` is called, or something fails, which is then in `error`.

        Args:
            sleep: Waits, by the device's clock.
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
                    # What was missed is not made up for.
                    due -= ahead
        except BaseException as error:
            # Nobody looks into a thread: whoever next asks for a sample has to be told.
            self.error = error
        finally:
            self.release()

    def keep_track(self, seconds: float) -> None:
        """Keep what happens in every cycle from now on, for so long at most [s]; 0: keep nothing any more."""
        self._track = TrackRecorder(round(seconds / PERIOD)) if seconds > 0.0 else None

    def take_track(self) -> HapticTrack:
        """The samples kept since the last call."""
        recorder = self._track if self._track is not None else TrackRecorder(0)
        return recorder.take(self._names)

    def stop(self) -> None:
        """Let `run` come to its end."""
        self._stopping = True

    def release(self) -> None:
        """Send a force of zero, as far as the device can still hear it."""
        try:
            self._device.send_force(ZERO)
            if self._exchange is not None:
                self._exchange()
        except Exception:
            # The device is gone, or closed, and makes no force any more.
            pass

    def statistics(self) -> LoopStatistics:
        """How regularly it went round, so far."""
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
    """The buttons that are held down, bit by bit."""
    return sum(1 << names.index(name) for name in sample.buttons) if sample.buttons else 0


def _corner(place: FloatArray | None) -> Vector | None:
    return None if place is None else cast("Vector", tuple(place.tolist()))
