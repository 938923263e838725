"""One exchange with the Falcon, made a thousand times a second.

Safety is decided here and nowhere else. Motors get zeros unless all of this holds: the Falcon has homed all three
legs, it has answered lately, and somebody has asked for a force lately. Whatever ends the loop ends the forces.
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
"""From one exchange to the next [s]."""
REPLY_WAIT = 5e-3
"""How long an exchange waits for its answer before the next one is made [s]."""
WRITE_TIMEOUT = 0.05
"""How long a write may take [s]."""
REPLY_TIMEOUT = 0.25
"""A Falcon that has not answered for so long is lost [s]."""
LATE = 1.5
"""An exchange is late if it starts more than so many periods after the one before."""
STATISTICS_LENGTH = 10_000
"""How many periods are kept for the statistics."""

GREATEST_COUNT_RATE = 200_000.0
"""A thigh that turns faster is a transmission error [counts/s]; the grip would move at 6 to 10 m/s."""

NO_MOTORS: Counts = (0, 0, 0)
ZERO_PACKETS = 3
"""How often zeros are sent at the end, in case one is lost."""


@dataclass(frozen=True)
class ServoState:
    """The Falcon's last answer.

    Attributes:
        time: When [s].
        sequence: Counts the states from 1; 0 before the first.
        homed: For each leg, whether it is homed.
        encoders: The encoders' counts.
        buttons: Names of the buttons that are held down.
        position: The grip, Falcon's frame; meaningless until all legs are homed [m].
        velocity: Its velocity, Falcon's frame [m/s].
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
        """Whether the position means something."""
        return self.jacobian is not None


@dataclass(frozen=True)
class LoopStatistics:
    """How regularly the exchanges were made.

    Periods are those of the last `STATISTICS_LENGTH` exchanges; the other numbers count from the opening.

    Attributes:
        exchanges: How many there were.
        mean_period: From one to the next, on average [s].
        late_period: 99 of 100 periods are not longer [s].
        longest_period: The longest [s].
        late: How many of the periods were longer than `LATE` times the nominal one.
        missed: How many exchanges had no answer in time, or none that can be true.
        discarded_bytes: Bytes that were part of no packet.
        implausible: Packets whose encoders a Falcon cannot show.
        scaled: How often forces were scaled down because a motor could not make its share.
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

    Call `exchange` as often as there is time, or `run` in a thread. The other methods may be called from any thread.

    Attributes:
        error: What ended `run`; None while it runs or after a regular end.
    """

    def __init__(self, transport: Transport, clock: Callable[[], float], force_timeout: float) -> None:
        """Prepare, without sending anything.

        Args:
            transport: The connection, in normal mode.
            clock: The time [s].
            force_timeout: A force ends when nobody has asked for one for so long [s].
        """
        self.error: BaseException | None = None
        self._transport = transport
        self._clock = clock
        self._force_timeout = force_timeout
        self._stream = PacketStream()
        self._velocity = CountVelocity()
        self._state = ServoState(time=clock())
        self._command: tuple[Vector, float] = (ZERO, -math.inf)
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
        """Ask for a force.

        Args:
            force: What the grip does to the hand, Falcon's frame [N].
        """
        # One assignment, so that the loop never sees a force with another one's time.
        self._command = (force, self._clock())

    def set_lights(self, lights: Lights | None) -> None:
        """Choose the lights.

        Args:
            lights: Which; None for red until the Falcon is homed, then green.
        """
        self._lights = lights

    def exchange(self) -> bool:
        """Send one packet and take what the Falcon answers.

        Returns:
            Whether it answered with something new.

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
            sleep: Waits for some seconds.
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
                    # What was missed is not made up for: two packets in one millisecond would help nobody.
                    due -= ahead
        except BaseException as error:
            # Also one that no device raises: the operator's next call has to see it, as nobody looks into a thread.
            self.error = error
        finally:
            self.send_zeros()
            with self._progressed:
                self._progressed.notify_all()

    def stop(self) -> None:
        """Let `run` come to its end."""
        self._stopping.set()

    def wait(self, timeout: float) -> None:
        """Wait until another exchange has been made, or the loop has ended.

        Args:
            timeout: How long at most, in real time [s].
        """
        with self._progressed:
            self._progressed.wait(timeout)

    def check(self) -> None:
        """Pass on what has ended the loop.

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
        """Turn motors and lights off, as far as the device can still hear it."""
        self._command = (ZERO, -math.inf)
        try:
            send_zeros(self._transport)
        except Exception:
            # The device is gone, and what else went wrong is in `error`. Nothing more can be done for the motors.
            pass

    def statistics(self) -> LoopStatistics:
        """How regularly the exchanges were made.

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
        """The motor counts to send now: zeros unless everything speaks for a force."""
        force, asked = self._command
        jacobian = self._state.jacobian
        # The packet takes its time, and so does the next one, which could be the first to carry zeros: a force must end
        # before its time is over, not after.
        too_old = now - self._force_timeout + 2.0 * PERIOD
        if jacobian is None or force == ZERO or asked < too_old or self._state.time < too_old:
            return NO_MOTORS
        try:
            counts, share = kinematics.torques_to_counts(kinematics.torques(force, jacobian))
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
        """Read until the Falcon has answered, or it is too late."""
        answered = False
        while not answered:
            left = deadline - self._clock()
            if left <= 0.0:
                break
            received = self._transport.bulk_read(ftdi.PACKET_SIZE, left)
            # Answers that were late come together with newer ones, in one IN packet, and the newest counts: none lags
            # behind for longer than an exchange.
            for packet in self._stream.feed(ftdi.strip_status(received)):
                answered = self._take(packet) or answered
        return answered

    def _take(self, packet: DevicePacket) -> bool:
        """Make a state of a packet.

        Returns:
            Whether the packet can be true.
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
    """Whether the thighs can have turned so far since the last state.

    The longer ago that was the more is believed, so that a wrong belief cannot last.
    """
    most = GREATEST_COUNT_RATE * (now - last.time + PERIOD)
    return all(abs(new - old) <= most for new, old in zip(encoders, last.encoders, strict=True))
