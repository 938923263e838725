"""A device and its haptic loop in a process of their own, with a safe end of the force if a process ends.

The loop's process has a session of its own, so that signals to the program's process group, as from a closed terminal,
Ctrl-Z or a service manager, do not reach it. It detects the end of the program by its pipe, and a program that is
suspended by the missing heartbeat of the simulation; a signal to the process itself ends it in an orderly way. In all
these cases the force fades out first. If the loop's process is killed, the program connects to the device itself and
sends zeros.
"""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection, wait
from types import FrameType
from typing import Any

import numpy as np

from spatula_env.teleop.device import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceSample,
    NotCalibrated,
    Progress,
    TeleopDevice,
)
from spatula_env.teleop.haptics.board import Board
from spatula_env.teleop.haptics.contact import ZERO, Contact, LoopStatistics, Vector
from spatula_env.teleop.haptics.loop import HapticLoop, pressed_bits
from spatula_env.teleop.haptics.runner import (
    END_TIMEOUT,
    Answer,
    Description,
    Factory,
    Runner,
    check_haptic,
    describe,
    pass_on,
)
from spatula_env.teleop.haptics.settings import HapticSettings
from spatula_env.teleop.haptics.track import HapticTrack

CONTACT = "dBB3d3dB3d3d3d"
"""Time; whether there is a contact, and a position; position, force; whether there are bounds; corners; shift."""
SILENT = (0.0, False, False, *ZERO, *ZERO, False, *ZERO, *ZERO, *ZERO)
"""Message for: nothing is to be felt."""
REPORT = "dq3d3dQ3dB"
"""Time, sequence, position, velocity, buttons as bits, force; whether the loop has ended."""
SILENCE = 0.5
"""A loop that has not reported for this long is lost [s]."""
CYCLES_PER_LOOK = 5
"""Number of cycles between two checks for a request."""
CYCLES_TO_END = 60
"""Number of cycles in which the force fades out when the loop is to end."""
WATCH = 0.05
"""Interval at which the program checks whether the loop is still running [s]."""
STANDSTILL = 0.25
"""A loop that has stood still for this long is killed, as it holds the device and its last force [s]."""
BUSY_TRIES, BUSY_WAIT = 200, 0.005
"""Attempts to connect after a process was killed, and their interval [s]: its connection is freed late."""
ENDINGS = ("SIGTERM", "SIGHUP", "SIGINT", "SIGQUIT", "SIGBREAK")
"""Signals that end a loop in an orderly way."""
PRIORITY = 10
"""Real-time priority of the process, where it may have one."""


class RemoteLoop(Runner):
    """The program's side, where the simulation runs."""

    def __init__(self, factory: Factory, settings: HapticSettings, exchange: bool) -> None:
        """Start the process and have it open the device.

        Args:
            factory: Makes the device; has to be picklable.
            settings: The gains.
            exchange: Whether the loop has to call the device's `exchange`.

        Raises:
            DeviceError: Any error that the device raises.
        """
        # Spawned, not forked: a fork would copy the threads and engines of this process in an undefined state.
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._inbox, self._outbox = Board(CONTACT), Board(REPORT)
        self._process = context.Process(
            target=_serve,
            args=(theirs, factory, settings, exchange, self._inbox.name, self._outbox.name),
            name="haptics",
            daemon=True,
        )
        self._factory = factory
        self._is_closed = False
        self._is_running = False
        self._asking = threading.Lock()
        self._watcher: threading.Thread | None = None
        self.description: Description = Description("haptic device", (), None, None, 0.0, 0.0, 0.0, False)
        try:
            self._process.start()
            theirs.close()
            self.description = self._request("open")
        except BaseException:
            self.close()
            raise
        if self.description.is_calibrated:
            self._run()

    @property
    def is_calibrated(self) -> bool:
        """See `Runner`."""
        return self._is_running

    @property
    def force(self) -> Vector:
        """See `Runner`."""
        report = self._outbox.read()
        return ZERO if report is None else report[9:12]

    def calibrate(self, progress: Progress | None) -> None:
        """See `Runner`."""
        self._request("calibrate", progress=progress)
        report = self._outbox.read()
        # Start again a loop that has ended, for example because the homing was lost.
        if not self._is_running or (report is not None and report[12]):
            self._run()

    def read(self) -> DeviceSample:
        """See `Runner`."""
        report = self._report()
        names = self.description.button_names
        return DeviceSample(
            kind="position",
            time=report[0],
            sequence=report[1],
            position=np.array(report[2:5]),
            rate=None,
            velocity=np.array(report[5:8]),
            buttons=frozenset(name for bit, name in enumerate(names) if report[8] >> bit & 1),
        )

    def tell(self, contact: Contact | None) -> None:
        """See `Runner`."""
        if contact is None:
            self._inbox.write(*SILENT)
            return
        self._report()
        place, low, high = contact.position, contact.low, contact.high
        self._inbox.write(
            contact.time,
            True,
            place is not None,
            *(place if place is not None else ZERO),
            *contact.force,
            low is not None and high is not None,
            *(low if low is not None else ZERO),
            *(high if high is not None else ZERO),
            *contact.shift,
        )

    def ask(self, question: Callable[[TeleopDevice], Answer]) -> Answer:
        """See `Runner`."""
        answer: Answer = self._request("ask", question)
        return answer

    def statistics(self) -> LoopStatistics:
        """See `Runner`."""
        answer: LoopStatistics = self._request("statistics")
        return answer

    def keep_track(self, seconds: float) -> None:
        """See `Runner`."""
        self._request("keep_track", seconds)

    def take_track(self) -> HapticTrack:
        """See `Runner`."""
        answer: HapticTrack = self._request("take_track")
        return answer

    def close(self) -> None:
        """See `Runner`."""
        if self._is_closed:
            return
        self._is_closed = True
        if self._watcher is not None:
            self._watcher.join(END_TIMEOUT)
        self._inbox.write(*SILENT)
        # Closing the pipe ends the loop; the pipe also closes when this process ends in any other way.
        self._pipe.close()
        if self._process.pid is not None:
            self._process.join(END_TIMEOUT)
            if self._process.is_alive():
                self._process.kill()
                self._process.join(END_TIMEOUT)
                stop_motors(self._factory)
        self._inbox.close()
        self._outbox.close()

    def now(self) -> float:
        """See `Runner`; the machine's monotonic clock, which is the same for all processes."""
        return time.monotonic()

    def _run(self) -> None:
        self._request("run")
        deadline = self.now() + END_TIMEOUT
        while (report := self._outbox.read()) is None or report[12]:
            if self.now() > deadline or not self._process.is_alive():
                raise DeviceLost(f"the haptic loop of the {self.description.name} did not start")
            time.sleep(0.001)
        self._is_running = True
        if self._watcher is not None:
            return
        self._watcher = threading.Thread(target=self._watch, name="haptics-watcher", daemon=True)
        self._watcher.start()

    def _watch(self) -> None:
        """End the force if the loop's process has died or stands still."""
        while not self._is_closed:
            if wait([self._process.sentinel], WATCH):
                if self._process.exitcode != 0 and not self._is_closed:
                    stop_motors(self._factory)
                return
            # While a request is being answered the loop may stand still legitimately, so skip this check.
            if self._asking.acquire(blocking=False):
                try:
                    report = self._outbox.read()
                    stands_still = report is not None and not report[12] and self.now() - report[0] > STANDSTILL
                finally:
                    self._asking.release()
                if stands_still and not self._is_closed:
                    self._process.kill()

    def _report(self) -> tuple[Any, ...]:
        """The newest report of the loop.

        Raises:
            DeviceLost: If there is no recent one.
        """
        report = self._outbox.read()
        if report is None:
            raise NotCalibrated(f"the {self.description.name} is not calibrated: call calibrate()")
        if report[12]:
            pass_on(self._request("error"), self.description.name)
        if self.now() - report[0] > SILENCE:
            raise DeviceLost(
                f"the haptic loop of the {self.description.name} does not go round any more; close it, then open it "
                "again"
            )
        return report

    def _request(self, verb: str, argument: Any = None, progress: Progress | None = None) -> Any:
        with self._asking:
            return self._answer_to(verb, argument, progress)

    def _answer_to(self, verb: str, argument: Any, progress: Progress | None) -> Any:
        try:
            self._pipe.send((verb, argument))
            while True:
                kind, payload = self._pipe.recv()
                if kind == "progress":
                    if progress is not None:
                        progress(payload)
                elif kind == "raise":
                    raise payload
                else:
                    return payload
        except (EOFError, BrokenPipeError, ConnectionResetError) as error:
            raise DeviceLost(
                f"the process of the {self.description.name} has ended; close it, then open it again"
            ) from error


def _serve(
    pipe: Connection, factory: Factory, settings: HapticSettings, exchange: bool, inbox: str, outbox: str
) -> None:
    """Main function of the process."""
    if hasattr(os, "setsid"):
        os.setsid()
    server = _Server(pipe, factory, settings, exchange, Board(CONTACT, inbox), Board(REPORT, outbox))
    server.handle_signals()
    # If the other process is gone, for whatever reason, nobody waits for an answer.
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        server.serve()
    server.close()


class _Server:
    """The device's side, in the loop's process."""

    def __init__(
        self, pipe: Connection, factory: Factory, settings: HapticSettings, exchange: bool, inbox: Board, outbox: Board
    ) -> None:
        self._pipe = pipe
        self._factory = factory
        self._settings, self._exchange = settings, exchange
        self._inbox, self._outbox = inbox, outbox
        self._device: TeleopDevice | None = None
        self._loop: HapticLoop | None = None
        self._last: tuple[Any, ...] = (0.0, 0, *ZERO, *ZERO, 0, *ZERO, 0)
        self._cycles = 0
        self._ended = self._ending = self._paused = False
        self._cycles_to_end = CYCLES_TO_END

    def serve(self) -> None:
        """Answer requests; while the loop runs, between its cycles."""
        while not self._ended:
            if not self._pipe.poll(WATCH):
                if self._ending:
                    return
                continue
            self._answer()
            if self._loop is not None and self._loop.error is None and not self._ended:
                self._loop.run(time.sleep, self._between)
                if self._loop.error is not None:
                    self._outbox.write(time.monotonic(), *self._last[1:9], *ZERO, 1)

    def close(self) -> None:
        """End the force and close the device."""
        if self._loop is not None:
            self._loop.release()
        if self._device is not None:
            self._device.close()
        self._inbox.close()
        self._outbox.close()

    def handle_signals(self) -> None:
        """On a signal to end, let the force fade out first; between SIGTSTP and SIGCONT, render no force."""

        def end(number: int, frame: FrameType | None) -> None:
            self._ending = True

        def pause(number: int, frame: FrameType | None) -> None:
            self._paused = True

        def resume(number: int, frame: FrameType | None) -> None:
            self._paused = False

        handlers = {**dict.fromkeys(ENDINGS, end), "SIGTSTP": pause, "SIGCONT": resume}
        for name, handler in handlers.items():
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), handler)

    def _between(self) -> bool:
        self._cycles += 1
        if self._ending:
            self._cycles_to_end -= 1
            if self._cycles_to_end <= 0 or self._last[9:12] == ZERO:
                self._ended = True
        elif self._cycles % CYCLES_PER_LOOK == 0:
            try:
                if self._pipe.poll(0):
                    self._answer()
            except (EOFError, BrokenPipeError, ConnectionResetError):
                self._ending = True
        return not self._ended

    def _answer(self) -> None:
        verb, argument = self._pipe.recv()
        try:
            answer = getattr(self, f"_{verb}")(argument)
            # Pickle here, so that an answer that cannot be pickled is reported like other errors.
            pickle.dumps(answer)
        except Exception as error:
            self._pipe.send(("raise", _portable(error)))
        else:
            self._pipe.send(("done", answer))

    # The requests.

    def _open(self, _: None) -> Description:
        device = self._factory()
        check_haptic(device)
        device.open()
        self._device = device
        return describe(device)

    def _calibrate(self, _: None) -> None:
        self._opened().calibrate(lambda text: self._pipe.send(("progress", text)))

    def _run(self, _: None) -> None:
        _hurry()
        self._loop = HapticLoop(self._opened(), self._settings, self._take, self._give, self._exchange)

    def _ask(self, question: Callable[[TeleopDevice], Any]) -> Any:
        return question(self._opened())

    def _statistics(self, _: None) -> LoopStatistics:
        return self._running_loop().statistics()

    def _keep_track(self, seconds: float) -> None:
        self._running_loop().keep_track(seconds)

    def _take_track(self, _: None) -> HapticTrack:
        return self._running_loop().take_track()

    def _running_loop(self) -> HapticLoop:
        if self._loop is None:
            raise NotCalibrated(f"the {self._opened().name} is not calibrated: call calibrate()")
        return self._loop

    def _error(self, _: None) -> BaseException | None:
        return None if self._loop is None or self._loop.error is None else _portable(self._loop.error)

    def _opened(self) -> TeleopDevice:
        if self._device is None:
            raise DeviceError("the device is not open")
        return self._device

    # The loop's input and output.

    def _take(self) -> Contact | None:
        message = self._inbox.read()
        if message is None or not message[1] or self._ending or self._paused:
            return None
        low, high = (message[10:13], message[13:16]) if message[9] else (None, None)
        return Contact(message[0], message[3:6] if message[2] else None, message[6:9], low, high, message[16:19])

    def _give(self, sample: DeviceSample, force: Vector) -> None:
        assert sample.position is not None
        pressed = pressed_bits(sample, self._opened().button_names)
        self._last = (sample.time, sample.sequence, *sample.position, *sample.velocity, pressed, *force, 0)
        self._outbox.write(*self._last)


def stop_motors(factory: Factory) -> None:
    """Turn off the motors of a device whose process has died, if the device can be reached.

    Args:
        factory: Makes the device.
    """
    device = factory()
    for _ in range(BUSY_TRIES):
        try:
            device.stop_motors()
        except DeviceBusy:
            time.sleep(BUSY_WAIT)
        except Exception:
            # The device is gone. This thread has no caller to tell: the next read or tell reports the dead process.
            return
        else:
            return


def _hurry() -> None:
    """Make this process run as regularly as possible."""
    # The loop creates no reference cycles, and a garbage collection would take longer than a period.
    gc.collect()
    gc.freeze()
    gc.disable()
    # Real-time priority needs a permission that few users have; without it the loop has normal priority.
    with contextlib.suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


def _portable(error: BaseException) -> BaseException:
    """An exception that can be pickled."""
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:
        return DeviceError(repr(error))
    return error if isinstance(copy, BaseException) else DeviceError(repr(error))
