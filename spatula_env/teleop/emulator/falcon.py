"""The emulated Falcon: its parts put together and advanced in time."""

from __future__ import annotations

import heapq
import itertools
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from spatula_env.teleop.device import DeviceBusy, DeviceError, DeviceLost, DeviceNotFound
from spatula_env.teleop.emulator.boot import BootLoader, Stage
from spatula_env.teleop.emulator.chip import FtdiChip, RefusedRequest
from spatula_env.teleop.emulator.clock import Clock, SimulatedClock
from spatula_env.teleop.emulator.faults import Faults
from spatula_env.teleop.emulator.hand import ElasticHand, Hand
from spatula_env.teleop.emulator.legs import Point, encoder_counts, grip_force, leg_angles
from spatula_env.teleop.emulator.mechanism import HandOnMechanism, Mechanism
from spatula_env.teleop.emulator.program import Counts, Program

STEP = 1e-3
"""Longest step of the hand [s]."""
REAL_TIME_STEP = 1e-3
"""Interval at which `FalconEmulator.running` advances the device [s]."""
HISTORY_LENGTH = 20_000
"""Number of motor commands that are kept."""

BUTTONS = {"plus": 1, "forward": 2, "center": 4, "minus": 8}

MADE_UP_FIRMWARE = bytes(index * 37 % 251 for index in range(1500))
"""The firmware that an emulated Falcon expects unless told otherwise: arbitrary bytes."""


class FalconEmulator:
    """A Falcon and the hand that holds its grip.

    It lives in the time of its clock. With a `SimulatedClock`, time passes only while a caller waits for the device or
    calls `advance`, so that every run is the same. With a `RealClock`, time passes by itself: the device catches up
    whenever it is accessed, and `running` keeps it moving in between. All methods may be called from any thread.

    Positions, velocities and forces are in the Falcon's own frame (:mod:`spatula_env.teleop.falcon.frames`).

    Example:
        >>> from spatula_env.teleop.emulator import ElasticHand, FalconEmulator, homing_motion
        >>> from spatula_env.teleop.falcon import Falcon
        >>> emulator = FalconEmulator(ElasticHand(homing_motion()))
        >>> falcon = Falcon(
        ...     transport=emulator.connect, clock=emulator.clock.now, sleep=emulator.clock.sleep, threaded=False
        ... )
        >>> falcon.open()
        >>> falcon.calibrate()
        >>> falcon.read().position.round(3).tolist()
        [0.0, 0.035, 0.0]
        >>> falcon.close()

    Attributes:
        name: Name of the device in messages.
        clock: The clock that the device lives by.
        hand: What holds the grip, the mechanism included. Its time begins when the emulator is made.
        faults: Failures to simulate; may be changed at any time.
        motor_history: The last motor commands: arrival time [s] and the counts after clipping.
    """

    def __init__(
        self,
        hand: Hand | None = None,
        *,
        clock: Clock | None = None,
        firmware: bytes = MADE_UP_FIRMWARE,
        loaded: bool = True,
        homed: bool = False,
        faults: Faults | None = None,
        mechanism: Mechanism | None = None,
        name: str = "emulated Falcon",
    ) -> None:
        """Plug in a Falcon.

        Args:
            hand: What holds the grip; None for a hand at rest in the middle.
            clock: The clock that the device lives by; None for a `SimulatedClock`.
            firmware: The firmware that has to be loaded.
            loaded: Whether the firmware is loaded already.
            homed: Whether the encoders have found their zeros already; needs ``loaded``.
            faults: Failures to simulate.
            mechanism: Weight, friction and elasticity of the links; None for an ideal mechanism.
            name: Name of the device in messages.
        """
        self.name = name
        self.clock: Clock = clock if clock is not None else SimulatedClock()
        self.hand: Hand = hand if hand is not None else ElasticHand()
        if mechanism is not None:
            self.hand = HandOnMechanism(self.hand, mechanism)
        self.faults = faults if faults is not None else Faults()
        self.motor_history: deque[tuple[float, Counts]] = deque(maxlen=HISTORY_LENGTH)
        self._firmware = firmware
        self._lock = threading.RLock()
        self._connection: EmulatedTransport | None = None
        self._is_plugged = True
        self._start = self._time = self.clock.now()
        self._events: list[tuple[float, int, Callable[[float], None]]] = []
        self._order = itertools.count()
        self._line_free = self._time
        self._power_up()
        if loaded:
            self._boot.stage = Stage.STARTED
            self._program = Program(self.faults, homed)

    def connect(self, program: str = "this program") -> EmulatedTransport:
        """Open and claim the device, as `UsbTransport` does.

        Args:
            program: Name of the program that opens it.

        Returns:
            The connection.

        Raises:
            DeviceNotFound: If it is not plugged in.
            DeviceBusy: If a program has it open already.
        """
        with self._lock:
            if not self._is_plugged:
                raise DeviceNotFound(f"there is no {self.name}: it is not plugged in")
            if self._connection is not None:
                raise DeviceBusy(f"another program has the {self.name} open ({self.owner}); close it and try again")
            self._connection = EmulatedTransport(self, program)
            return self._connection

    def unplug(self) -> None:
        """Pull the USB and power cables. The motors go limp and the firmware is lost."""
        with self._lock:
            self._catch_up()
            self._is_plugged = False
            self._power_up()

    def plug_in(self) -> None:
        """Reconnect the cables. A program that had the device open has to open it again."""
        with self._lock:
            self._is_plugged = True
            self._connection = None

    def press(self, buttons: Iterable[str]) -> None:
        """Hold down the given buttons and release all others.

        Args:
            buttons: Of ``"plus"``, ``"forward"``, ``"center"``, ``"minus"``.

        Raises:
            KeyError: If there is no such button.
        """
        with self._lock:
            self._program.buttons = sum(BUTTONS[button] for button in set(buttons))

    def advance(self, duration: float) -> None:
        """Wait by the device's clock.

        Args:
            duration: How long [s].
        """
        self.clock.sleep(duration)
        with self._lock:
            self._catch_up()

    @contextmanager
    def running(self) -> Iterator[None]:
        """Advance the device in a thread of its own while a ``with`` block lasts; for a `RealClock`.

        Raises:
            DeviceError: If the clock is simulated: the thread would advance it without limit.
        """
        if isinstance(self.clock, SimulatedClock):
            raise DeviceError("running() is for a RealClock; simulated time moves on by itself when somebody waits")
        done = threading.Event()

        def run() -> None:
            while not done.wait(REAL_TIME_STEP):
                with self._lock:
                    self._catch_up()

        thread = threading.Thread(target=run, name="falcon-emulator", daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()

    @property
    def owner(self) -> str | None:
        """Name of the program that has the device open; None if there is none."""
        connection = self._connection
        return None if connection is None else connection.program

    @property
    def is_loaded(self) -> bool:
        """Whether the firmware runs."""
        return self._boot.stage is Stage.STARTED

    @property
    def chip(self) -> FtdiChip:
        """The FTDI chip."""
        return self._chip

    @property
    def program(self) -> Program:
        """The firmware's program: motors, lights, buttons, homing."""
        return self._program

    @property
    def motor_force(self) -> Point:
        """Force of the grip on the hand now [N]."""
        with self._lock:
            self._catch_up()
            return self._motor_force()

    @property
    def grip(self) -> Point:
        """Current position of the grip [m]."""
        with self._lock:
            self._catch_up()
            return self.hand.position

    # The transport's operations, in the device's time.

    def _write(self, connection: EmulatedTransport, data: bytes) -> int:
        with self._lock:
            self._check_plug(connection)
            now = self._happen()
            settings = self._chip.settings
            # Bytes follow one another on the line, each taking its transmission time.
            self._line_free = max(self._line_free, now) + len(data) * settings.byte_time
            self._at(self._line_free, lambda when: self._hear(data, when))
            return len(data)

    def _read(self, connection: EmulatedTransport, size: int, timeout: float) -> bytes:
        deadline = self.clock.now() + timeout
        while True:
            with self._lock:
                self._check_plug(connection)
                now = self._happen()
                ready = self._chip.ready_at(now)
                if ready <= now:
                    return self._chip.take_packet(now)[:size]
                if now >= deadline:
                    return b""
                if self._events:
                    ready = min(ready, self._events[0][0])
            self.clock.sleep(min(ready, deadline) - now)

    def _control(self, connection: EmulatedTransport, request_type: int, request: int, value: int, index: int) -> None:
        with self._lock:
            self._check_plug(connection)
            self._catch_up()
            try:
                was_reset = self._chip.control(request_type, request, value, index)
            except RefusedRequest as refusal:
                raise DeviceLost(f"the {self.name} does not accept a control transfer: {refusal}") from refusal
            if was_reset:
                self._boot.reset()
                self._program = Program(self.faults)

    def _release(self, connection: EmulatedTransport) -> None:
        with self._lock:
            if self._connection is connection:
                self._connection = None

    # Time.

    def _catch_up(self) -> float:
        """Advance everything, the hand included, to the clock's time.

        Returns:
            That time [s].
        """
        now = self._happen()
        self._move_hand(now)
        return now

    def _happen(self) -> float:
        """Process all events that are due by now, moving the hand no further than they need.

        Returns:
            The clock's time [s].
        """
        now = self.clock.now()
        while self._events and self._events[0][0] <= now:
            when, _, happen = heapq.heappop(self._events)
            happen(when)
        return now

    def _move_hand(self, until: float) -> None:
        left = until - self._time
        while left > 0.0:
            step = min(STEP, left)
            self.hand.advance(self._time - self._start, step, self._motor_force())
            self._time += step
            left -= step
        # Accumulated steps may differ from the end time by rounding.
        self._time = max(self._time, until)

    def _motor_force(self) -> Point:
        motors = self._program.motors
        return grip_force(self.hand.position, motors) if any(motors) else (0.0, 0.0, 0.0)

    def _at(self, when: float, happen: Callable[[float], None]) -> None:
        heapq.heappush(self._events, (when, next(self._order), happen))

    # The device.

    def _power_up(self) -> None:
        # The chip may have been used before, so its buffer starts with stale bytes that answer no request.
        self._chip = FtdiChip(self.clock.now(), leftover=b"\x00<AAAA")
        self._boot = BootLoader(self._firmware, self.faults)
        self._program = Program(self.faults)
        self._events.clear()

    def _hear(self, data: bytes, when: float) -> None:
        """Process data of which the last byte has just arrived."""
        self._move_hand(when)
        settings = self._chip.settings
        if self.is_loaded:
            position = self.hand.position
            packets = self._program.packets
            answer = self._program.receive(data, settings, leg_angles(position), encoder_counts(position))
            if self._program.packets > packets:
                self.motor_history.append((when, self._program.motors))
            if answer and self.faults.mangle is not None:
                answer = self.faults.mangle(answer)
            delay = self.faults.reply_delay
        else:
            answer = self._boot.receive(data, settings)
            delay = 0.0
        if answer:
            self._at(when + delay + len(answer) * settings.byte_time, lambda _: self._chip.receive(answer))

    def _check_plug(self, connection: EmulatedTransport) -> None:
        # A connection that was open when the cable was pulled stays lost when the cable is put back.
        if not self._is_plugged or self._connection is not connection:
            raise DeviceLost(f"the {self.name} does not answer any more (unplugged); plug it in, then open it again")


class EmulatedTransport:
    """A program's connection to an emulated Falcon: a `spatula_env.teleop.falcon.transport.Transport`.

    Attributes:
        program: Name of the program that holds the connection.
    """

    def __init__(self, emulator: FalconEmulator, program: str) -> None:
        """Store the device and the program; called by `FalconEmulator.connect`.

        Args:
            emulator: The device.
            program: Name of the program that holds the connection.
        """
        self.program = program
        self._emulator = emulator
        self._is_open = True

    @property
    def name(self) -> str:
        """Name of the device."""
        return self._emulator.name

    def bulk_write(self, data: bytes, timeout: float) -> int:
        """See `Transport`."""
        return self._device()._write(self, bytes(data))

    def bulk_read(self, size: int, timeout: float) -> bytes:
        """See `Transport`."""
        return self._device()._read(self, size, timeout)

    def control_transfer(self, request_type: int, request: int, value: int, index: int) -> None:
        """See `Transport`."""
        self._device()._control(self, request_type, request, value, index)

    def close(self) -> None:
        """See `Transport`."""
        if self._is_open:
            self._is_open = False
            self._emulator._release(self)

    def _device(self) -> FalconEmulator:
        if not self._is_open:
            raise DeviceError(f"the connection to the {self.name} is closed")
        return self._emulator
