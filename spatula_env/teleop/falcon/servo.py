"""The loop that exchanges packets with the Falcon a thousand times a second.

Safety is decided here and nowhere else. The motors get zeros unless all of these hold: all three legs are homed, the
Falcon has answered recently, and a force has been requested recently. Whatever ends the loop ends the forces.
"""

from __future__ import annotations

import math
import threading
from array import array
from collections.abc import Callable
from dataclasses import dataclass

from spatula_env.teleop.device import DeviceError, DeviceLost
from spatula_env.teleop.falcon import ftdi, kinematics
from spatula_env.teleop.falcon.protocol import Counts, DevicePacket, HostPacket, Lights, PacketStream
from spatula_env.teleop.falcon.transport import Transport
from spatula_env.teleop.falcon.vector import ZERO, Matrix, Vector, scale, solve
from spatula_env.teleop.falcon.velocity import CountVelocity

PERIOD = 1e-3
"""Period of the exchanges [s]."""
REPLY_WAIT = 5e-3
"""Time that an exchange waits for its answer before the next one is made [s]."""
WRITE_TIMEOUT = 0.05
"""Longest time that a write may take [s]."""
REPLY_TIMEOUT = 0.25
"""A Falcon that has not answered for this long is lost [s]."""
LATE = 1.5
"""An exchange is late if it starts more than this many periods after the one before."""
STATISTICS_LENGTH = 10_000
"""Number of periods that are kept for the statistics."""

GREATEST_COUNT_RATE = 200_000.0
"""Faster motion of a thigh is taken for a transmission error [counts/s]; the grip would move at 6 to 10 m/s."""

NO_MOTORS: Counts = (0, 0, 0)
ZERO_PACKETS = 3
"""Number of times that zeros are sent at the end, in case a packet is lost."""


@dataclass(frozen=True)
class ServoState:
    """The Falcon's last answer.

    Attributes:
        time: Time of the answer [s].
        sequence: Counts the states from 1; 0 before the first.
        homed: For each leg, whether it is homed.
        encoders: The encoders' counts.
        buttons: Names of the buttons that are held down.
        position: Position of the grip, Falcon's frame; meaningless until all legs are homed [m].
        velocity: Velocity of the grip, Falcon's frame [m/s].
        jacobian: Derivatives of the thighs' angles at that position [rad/m].
    """

    time: float
    sequence: int = 0
    homed: tuple[bool, bool, bool] = (False, False, False)
    encoders: Counts = (0, 0, 0)
    buttons: frozenset[str] = frozenset()
    position: Vector = ZERO
    velocity: Vector = ZERO
    jacobian: Matrix | None = None

    @property
    def is_homed(self) -> bool:
        """Whether all legs are homed, so that the position is meaningful."""
        return self.jacobian is not None


@dataclass(frozen=True)
class LoopStatistics:
    """Statistics of how regularly the exchanges were made.

    Periods are those of the last `STATISTICS_LENGTH` exchanges; the other numbers count from the opening of the device.

    Attributes:
        exchanges: Number of exchanges.
        mean_period: Mean period [s].
        late_period: 99th percentile of the periods [s].
        longest_period: Longest period [s].
        late: Number of periods that were longer than `LATE` times the nominal one.
        missed: Number of exchanges without an answer in time, or without a plausible one.
        discarded_bytes: Number of bytes that were part of no packet.
        implausible: Number of packets with encoder counts that are impossible for a Falcon.
        scaled: Number of times that forces were scaled down because a motor could not produce its share.
    """

    exchanges: int
    mean_period: float
    late_period: float
    longest_period: float
    late: int
    missed: int
    discarded_bytes: int
    implausible: int
    scaled: int


class ServoLoop:
    """Exchanges packets with a Falcon in normal mode.

    Call `exchange` as often as possible, or `run` in a thread. The other methods may be called from any thread.

    Attributes:
        error: The exception that ended `run`; None while it runs or after a regular end.
    """

    def __init__(self, transport: Transport, clock: Callable[[], float], force_timeout: float) -> None:
        """Prepare the loop without sending anything.

        Args:
            transport: The connection, in normal mode.
            clock: Returns the time [s].
            force_timeout: A force ends when it has not been requested again for this long [s].
        """
        self.error: BaseException | None = None
        self._transport = transport
        self._clock = clock
        self._force_timeout = force_timeout
        self._stream = PacketStream()
        self._velocity = CountVelocity()
        self._state = ServoState(time=clock())
        self._command: tuple[Vector, float] = (ZERO, -math.inf)
        self._owed: Vector = ZERO
        self._lights: Lights | None = None
        self._stopping = threading.Event()
        self._progressed = threading.Condition()
        self._periods = array("d")
        self._last_start: float | None = None
        self._exchanges = self._missed = self._implausible = self._scaled = 0

    @property
    def state(self) -> ServoState:
        """The Falcon's last answer."""
        return self._state

    def command(self, force: Vector) -> None:
        """Request a force.

        Args:
            force: Force of the grip on the hand, Falcon's frame [N].
        """
        # A single assignment, so that the loop never sees a force with the time of another one.
        self._command = (force, self._clock())

    def set_lights(self, lights: Lights | None) -> None:
        """Select the lights.

        Args:
            lights: Lights to turn on; None for red until the Falcon is homed, then green.
        """
        self._lights = lights

    def exchange(self) -> bool:
        """Send one packet and receive the Falcon's answer.

        Returns:
            Whether it answered with a plausible packet.

        Raises:
            DeviceLost: If it is not there any more, or has not answered for `REPLY_TIMEOUT`.
        """
        start = self._clock()
        self._record_period(start)
        packet = HostPacket(self._motors(start), self._current_lights(), homing=True)
        self._transport.bulk_write(packet.encode(), WRITE_TIMEOUT)
        answered = self._receive(start + REPLY_WAIT)
        now = self._clock()
        if not answered:
            self._missed += 1
            if now - self._state.time > REPLY_TIMEOUT:
                raise DeviceLost(
                    f"the {self._transport.name} has not answered for {now - self._state.time:.2f} s; "
                    "check its power supply and cable, then open it again"
                )
        with self._progressed:
            self._progressed.notify_all()
        return answered

    def run(self, sleep: Callable[[float], None]) -> None:
        """Exchange packets until `stop` is called or something fails; then send zeros to the motors.

        Args:
            sleep: Waits for the given time [s].
        """
        try:
            due = self._clock()
            while not self._stopping.is_set():
                self.exchange()
                due += PERIOD
                ahead = due - self._clock()
                if ahead > 0.0:
                    sleep(ahead)
                else:
                    # Missed exchanges are not made up for: two packets in one millisecond are of no use.
                    due -= ahead
        except BaseException as error:
            # Keep every exception, not only the device's own: the operator's next call raises it, as it would be lost
            # here.
            self.error = error
        finally:
            self.send_zeros()
            with self._progressed:
                self._progressed.notify_all()

    def stop(self) -> None:
        """Make `run` end."""
        self._stopping.set()

    def wait(self, timeout: float) -> None:
        """Wait until another exchange has been made or the loop has ended.

        Args:
            timeout: Longest time to wait, in real time [s].
        """
        with self._progressed:
            self._progressed.wait(timeout)

    def check(self) -> None:
        """Raise the error that ended the loop, if there is one.

        Raises:
            DeviceLost: If the device is lost.
            DeviceError: If something else went wrong.
        """
        if self.error is None:
            return
        if isinstance(self.error, DeviceLost):
            raise DeviceLost(str(self.error)) from self.error
        raise DeviceError(
            f"the exchange with the {self._transport.name} has ended because of {self.error!r}; close it, then open it "
            "again"
        ) from self.error

    def send_zeros(self) -> None:
        """Turn motors and lights off, if the device still answers."""
        self._command = (ZERO, -math.inf)
        try:
            send_zeros(self._transport)
        except Exception:
            # The device is gone; other errors are kept in `error`. Nothing more can be done about the motors.
            pass

    def statistics(self) -> LoopStatistics:
        """Statistics of how regularly the exchanges were made.

        Returns:
            The statistics.
        """
        periods = sorted(self._periods)
        count = len(periods)
        return LoopStatistics(
            exchanges=self._exchanges,
            mean_period=sum(periods) / count if count else 0.0,
            late_period=periods[min(count - 1, int(0.99 * count))] if count else 0.0,
            longest_period=periods[-1] if count else 0.0,
            late=sum(period > LATE * PERIOD for period in periods),
            missed=self._missed,
            discarded_bytes=self._stream.discarded,
            implausible=self._implausible,
            scaled=self._scaled,
        )

    def _motors(self, now: float) -> Counts:
        """The motor counts to send now: zeros unless all conditions for a force hold."""
        force, asked = self._command
        jacobian = self._state.jacobian
        # This packet and the next one, which could be the first to carry zeros, take time to transmit: subtract two
        # periods, so that a force ends before its timeout, not after it.
        too_old = now - self._force_timeout + 2.0 * PERIOD
        if jacobian is None or force == ZERO or asked < too_old or self._state.time < too_old:
            self._owed = ZERO
            return NO_MOTORS
        try:
            torques = kinematics.torques(force, jacobian)
            counts, share, self._owed = kinematics.torques_to_counts(torques, owed=self._owed)
        except kinematics.UnreachableError:
            return NO_MOTORS
        if share < 1.0:
            self._scaled += 1
        return counts

    def _current_lights(self) -> Lights:
        if self._lights is not None:
            return self._lights
        return Lights.GREEN if self._state.is_homed else Lights.RED

    def _receive(self, deadline: float) -> bool:
        """Read until the Falcon has answered or the deadline has passed."""
        answered = False
        while not answered:
            left = deadline - self._clock()
            if left <= 0.0:
                break
            received = self._transport.bulk_read(ftdi.PACKET_SIZE, left)
            # Late answers arrive together with newer ones in one IN packet, and the newest counts, so no state lags
            # behind by more than one exchange.
            for packet in self._stream.feed(ftdi.strip_status(received)):
                answered = self._take(packet) or answered
        return answered

    def _take(self, packet: DevicePacket) -> bool:
        """Update the state from a packet.

        Returns:
            Whether the packet is plausible.
        """
        now = self._clock()
        last = self._state
        if not all(packet.homed):
            self._velocity.clear()
            self._state = ServoState(now, last.sequence + 1, packet.homed, packet.encoders, packet.button_names)
            return True
        if last.is_homed and not _can_follow(last, packet.encoders, now):
            self._implausible += 1
            return False
        try:
            angles = kinematics.counts_to_angles(packet.encoders)
            position, jacobian = kinematics.forward_with_jacobian(angles, last.position if last.is_homed else None)
            rates = self._velocity.update(now, packet.encoders)
            velocity = solve(jacobian, scale(kinematics.COUNT_ANGLE, rates))
        except (kinematics.UnreachableError, ZeroDivisionError):
            self._implausible += 1
            return False
        self._state = ServoState(
            now, last.sequence + 1, packet.homed, packet.encoders, packet.button_names, position, velocity, jacobian
        )
        return True

    def _record_period(self, start: float) -> None:
        if self._last_start is not None:
            period = start - self._last_start
            if len(self._periods) < STATISTICS_LENGTH:
                self._periods.append(period)
            else:
                self._periods[self._exchanges % STATISTICS_LENGTH] = period
        self._last_start = start
        self._exchanges += 1


def send_zeros(transport: Transport) -> None:
    """Turn motors and lights off.

    Args:
        transport: A connection in normal mode.
    """
    for _ in range(ZERO_PACKETS):
        transport.bulk_write(HostPacket(homing=True).encode(), WRITE_TIMEOUT)


def _can_follow(last: ServoState, encoders: Counts, now: float) -> bool:
    """Whether the thighs can have turned this far since the last state.

    The bound grows with the time since then, so that a wrong state cannot be kept for ever.
    """
    most = GREATEST_COUNT_RATE * (now - last.time + PERIOD)
    return all(abs(new - old) <= most for new, old in zip(encoders, last.encoders, strict=True))
