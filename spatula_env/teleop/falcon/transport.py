"""USB transfers to a Falcon: the interface that the driver needs, and its implementation with pyusb."""

from __future__ import annotations

import errno
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

from spatula_env.installing import install_hint
from spatula_env.teleop.device import DeviceBusy, DeviceError, DeviceLost, DeviceNotFound
from spatula_env.teleop.falcon.ftdi import ENDPOINT_IN, ENDPOINT_OUT, PRODUCT_ID, VENDOR_ID

INTERFACE = 0
CONTROL_TIMEOUT = 1.0
"""Longest time that a control transfer may take [s]."""


class Transport(Protocol):
    """An open, exclusive connection to one device."""

    @property
    def name(self) -> str:
        """Name of the device, for messages."""

    def bulk_write(self, data: bytes, timeout: float) -> int:
        """Write to the device.

        Args:
            data: The bytes.
            timeout: Longest time that it may take [s].

        Returns:
            Number of bytes that the device accepted; fewer than given if the time is over.

        Raises:
            DeviceLost: If the device is not there any more.
        """

    def bulk_read(self, size: int, timeout: float) -> bytes:
        """Read IN packets, with their status bytes, as they come.

        Args:
            size: Greatest number of bytes, a multiple of `ftdi.PACKET_SIZE`.
            timeout: Longest time to wait [s].

        Returns:
            The bytes; empty if the time is over.

        Raises:
            DeviceLost: If the device is not there any more.
        """

    def control_transfer(self, request_type: int, request: int, value: int, index: int) -> None:
        """Make a control transfer without data.

        Args:
            request_type: bmRequestType.
            request: bRequest.
            value: wValue.
            index: wIndex.

        Raises:
            DeviceLost: If the device is not there any more, or does not accept the request.
        """

    def close(self) -> None:
        """Release the device. Closing twice is allowed."""


@dataclass(frozen=True)
class UsbAddress:
    """Where on the USB a Falcon is plugged in.

    Attributes:
        bus: Number of the bus.
        address: Number on the bus; changes whenever a device is plugged in.
    """

    bus: int
    address: int

    def __str__(self) -> str:
        return f"Novint Falcon at USB bus {self.bus}, device {self.address}"


def find_falcons() -> list[UsbAddress]:
    """List the Falcons on the USB. Opens nothing and sends nothing.

    Returns:
        Their addresses, ordered by bus and number.

    Raises:
        ImportError: If pyusb is missing.
        DeviceError: If the system's USB library, libusb, is missing.
    """
    return sorted((UsbAddress(found.bus, found.address) for found in _find()), key=lambda at: (at.bus, at.address))


class UsbTransport:
    """A connection to a Falcon on the USB, by pyusb.

    Attributes:
        name: Name of the device in messages.
    """

    def __init__(self, index: int = 0) -> None:
        """Open a Falcon and claim it.

        Args:
            index: Number of the device, in the order of `find_falcons`.

        Raises:
            ImportError: If pyusb is missing.
            DeviceNotFound: If there are fewer devices.
            DeviceBusy: If another program has it.
            DeviceError: If the user lacks permission to open it, or libusb is missing.
        """
        found = sorted(_find(), key=lambda device: (device.bus, device.address))
        if not 0 <= index < len(found):
            raise DeviceNotFound(
                f"there is no Novint Falcon number {index}: {len(found)} found on the USB "
                f"({VENDOR_ID:04x}:{PRODUCT_ID:04x}); check the cable and the power supply"
            )
        self._device = found[index]
        self._core = import_module("usb.core")
        self._util = import_module("usb.util")
        self._closed = False
        self.name = str(UsbAddress(self._device.bus, self._device.address))
        try:
            self._claim()
        except BaseException:
            self.close()
            raise

    def bulk_write(self, data: bytes, timeout: float) -> int:
        """See `Transport`."""
        try:
            return int(self._open_device().write(ENDPOINT_OUT, data, _milliseconds(timeout)))
        except self._core.USBTimeoutError:
            return 0
        except self._core.USBError as error:
            raise self._lost(error) from error

    def bulk_read(self, size: int, timeout: float) -> bytes:
        """See `Transport`."""
        try:
            return bytes(self._open_device().read(ENDPOINT_IN, size, _milliseconds(timeout)))
        except self._core.USBTimeoutError:
            return b""
        except self._core.USBError as error:
            raise self._lost(error) from error

    def control_transfer(self, request_type: int, request: int, value: int, index: int) -> None:
        """See `Transport`."""
        try:
            self._open_device().ctrl_transfer(request_type, request, value, index, None, _milliseconds(CONTROL_TIMEOUT))
        except self._core.USBError as error:
            raise self._lost(error) from error

    def close(self) -> None:
        """See `Transport`."""
        if not self._closed:
            self._closed = True
            try:
                self._util.dispose_resources(self._device)
            except self._core.USBError:
                # The device is gone already.
                pass

    def _claim(self) -> None:
        try:
            try:
                if self._device.is_kernel_driver_active(INTERFACE):
                    self._device.detach_kernel_driver(INTERFACE)
            except NotImplementedError:
                # Some systems have no kernel driver that could be detached.
                pass
            self._util.claim_interface(self._device, INTERFACE)
        except self._core.USBError as error:
            if error.errno == errno.EBUSY:
                raise DeviceBusy(f"another program has the {self.name} open; close it and try again") from error
            if error.errno in (errno.EACCES, errno.EPERM):
                raise DeviceError(
                    f"this user may not open the {self.name}; install the udev rule of docs/falcon.md and plug it "
                    "in again"
                ) from error
            raise self._lost(error) from error

    def _open_device(self) -> Any:
        # Without this check, pyusb would silently reopen a device that has been closed.
        if self._closed:
            raise DeviceError(f"the connection to the {self.name} is closed")
        return self._device

    def _lost(self, error: Exception) -> DeviceLost:
        return DeviceLost(
            f"the {self.name} does not answer any more ({error}); check its cable and power, then open it again"
        )


def _find() -> list[Any]:
    try:
        core = import_module("usb.core")
    except ImportError as error:
        raise ImportError(f"the Novint Falcon needs pyusb: {install_hint('teleop')}") from error
    try:
        return list(core.find(find_all=True, idVendor=VENDOR_ID, idProduct=PRODUCT_ID))
    except core.NoBackendError as error:
        raise DeviceError("pyusb finds no libusb; install it, on Debian with: apt install libusb-1.0-0") from error


def _milliseconds(seconds: float) -> int:
    """A timeout in libusb's unit, at least 1 because 0 would mean to wait for ever."""
    return max(1, round(1000.0 * seconds))
