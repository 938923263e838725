"""An emulated Falcon in a process of its own, reached through a socket as a real one is through a cable.

Whether the motors stop when a program that drives the device is killed can only be observed from another process.
`serve` runs the device; `WireTransport` is a program's connection, which the operating system closes when the program
ends, in whatever way. `ask` reads the motor history without opening the device.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Client, Connection, Listener
from typing import Any

from spatula_env.teleop.device import DeviceError
from spatula_env.teleop.emulator.clock import RealClock
from spatula_env.teleop.emulator.falcon import EmulatedTransport, FalconEmulator
from spatula_env.teleop.emulator.hand import Hand

LOOK = "look"
DRIVE = "drive"
"""Purposes of a connection."""


def serve(address: str, hand: Hand | None = None, ready: Callable[[], None] | None = None) -> None:
    """Run a homed Falcon in real time until the process ends.

    Args:
        address: Address of the socket: the name of a file that does not exist yet.
        hand: What holds the grip; None for a hand at rest.
        ready: Called when the device can be reached.
    """
    emulator = FalconEmulator(hand, clock=RealClock(), homed=True)
    with Listener(address, family="AF_UNIX", backlog=8) as listener, emulator.running():
        if ready is not None:
            ready()
        while True:
            connection = listener.accept()
            threading.Thread(target=_attend, args=(emulator, connection), daemon=True).start()


def ask(address: str) -> list[tuple[float, tuple[int, int, int]]]:
    """Return the motor commands received so far, each with its time on the machine's monotonic clock [s]."""
    with Client(address, family="AF_UNIX") as connection:
        connection.send((LOOK,))
        history: list[tuple[float, tuple[int, int, int]]] = connection.recv()
    return history


class WireTransport:
    """A program's connection to the device: a `spatula_env.teleop.falcon.transport.Transport`.

    Attributes:
        name: Name of the device in messages.
    """

    def __init__(self, address: str) -> None:
        """Open and claim the device.

        Args:
            address: Address of the device's socket.

        Raises:
            DeviceBusy: If another program has it open.
        """
        self._connection: Connection[Any, Any] = Client(address, family="AF_UNIX")
        self._connection.send((DRIVE,))
        self.name = str(self._answer())

    def bulk_write(self, data: bytes, timeout: float) -> int:
        """See `Transport`."""
        return int(self._call("bulk_write", data, timeout))

    def bulk_read(self, size: int, timeout: float) -> bytes:
        """See `Transport`."""
        return bytes(self._call("bulk_read", size, timeout))

    def control_transfer(self, request_type: int, request: int, value: int, index: int) -> None:
        """See `Transport`."""
        self._call("control_transfer", request_type, request, value, index)

    def close(self) -> None:
        """See `Transport`."""
        self._connection.close()

    def _call(self, name: str, *arguments: Any) -> Any:
        self._connection.send((name, *arguments))
        return self._answer()

    def _answer(self) -> Any:
        answer = self._connection.recv()
        if isinstance(answer, Exception):
            raise answer
        return answer


def _attend(emulator: FalconEmulator, connection: Connection[Any, Any]) -> None:
    """Serve the requests of one connection until it ends."""
    transport: EmulatedTransport | None = None
    try:
        (purpose,) = connection.recv()
        if purpose == LOOK:
            connection.send(list(emulator.motor_history))
            return
        try:
            transport = emulator.connect(f"socket {connection.fileno()}")
        except DeviceError as error:
            connection.send(error)
            return
        connection.send(emulator.name)
        while True:
            name, *arguments = connection.recv()
            try:
                answer = getattr(transport, name)(*arguments)
            except DeviceError as error:
                answer = error
            connection.send(answer)
    except (EOFError, ConnectionError):
        # The program has ended; the device is free for the next one.
        pass
    finally:
        connection.close()
        if transport is not None:
            transport.close()


def wait_until(condition: Callable[[], bool], seconds: float) -> bool:
    """Wait until a condition holds.

    Args:
        condition: The condition.
        seconds: Longest time to wait [s].

    Returns:
        Whether it holds.
    """
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.002)
    return True
