"""UsbTransport on a pyusb that is made up."""

from __future__ import annotations

import array
import errno
import re
import sys
from types import ModuleType, SimpleNamespace

import pytest

from spatula_env.installing import install_hint
from spatula_env.teleop import DeviceBusy, DeviceError, DeviceLost, DeviceNotFound
from spatula_env.teleop.falcon import Falcon, ftdi
from spatula_env.teleop.falcon.transport import UsbTransport, find_falcons


class USBError(OSError):
    def __init__(self, message, number=None):
        super().__init__(number, message)


class USBTimeoutError(USBError):
    pass


class NoBackendError(ValueError):
    pass


class FakeDevice:
    def __init__(self, bus, address):
        self.bus, self.address = bus, address
        self.calls = []
        self.failure = None
        self.has_kernel_driver = True

    def _do(self, *call):
        self.calls.append(call)
        if self.failure is not None:
            raise self.failure

    def is_kernel_driver_active(self, interface):
        return self.has_kernel_driver

    def detach_kernel_driver(self, interface):
        self.has_kernel_driver = False

    def write(self, endpoint, data, timeout):
        self._do("write", endpoint, bytes(data), timeout)
        return len(data)

    def read(self, endpoint, size, timeout):
        self._do("read", endpoint, size, timeout)
        return array.array("B", b"\x01\x60abc")

    def ctrl_transfer(self, request_type, request, value, index, data, timeout):
        self._do("control", request_type, request, value, index, data, timeout)
        return 0


@pytest.fixture
def usb(monkeypatch):
    """Two Falcons on a made-up bus, in no order."""
    world = SimpleNamespace(devices=[FakeDevice(2, 7), FakeDevice(1, 4)], claim_failure=None, disposed=[], backend=True)

    def find(find_all, idVendor, idProduct):
        if not world.backend:
            raise NoBackendError("No backend available")
        assert (find_all, idVendor, idProduct) == (True, 0x0403, 0xCB48)
        return iter(world.devices)

    def claim_interface(device, interface):
        if world.claim_failure is not None:
            raise world.claim_failure

    core, util, package = ModuleType("usb.core"), ModuleType("usb.util"), ModuleType("usb")
    core.find, core.USBError, core.USBTimeoutError, core.NoBackendError = (
        find,
        USBError,
        USBTimeoutError,
        NoBackendError,
    )
    util.claim_interface, util.dispose_resources = claim_interface, world.disposed.append
    package.core, package.util = core, util
    for name, module in (("usb", package), ("usb.core", core), ("usb.util", util)):
        monkeypatch.setitem(sys.modules, name, module)
    return world


def test_transfers(usb):
    transport = UsbTransport()
    device = usb.devices[1]
    assert transport.name == "Novint Falcon at USB bus 1, device 4"
    assert not device.has_kernel_driver
    assert transport.bulk_write(b"hello", 0.25) == 5
    assert transport.bulk_read(64, 0.0001) == b"\x01\x60abc"
    transport.control_transfer(ftdi.REQUEST_TYPE, ftdi.SET_BAUD_RATE, ftdi.BAUD_NORMAL, 0)
    assert device.calls == [
        ("write", 0x02, b"hello", 250),
        # Never 0, which would mean to wait for ever.
        ("read", 0x81, 64, 1),
        ("control", 0x40, 3, 0x0002, 0, None, 1000),
    ]
    transport.close()
    transport.close()
    assert usb.disposed == [device]
    with pytest.raises(DeviceError, match="closed"):
        transport.bulk_write(b"", 0.1)


def test_which_device(usb):
    assert [str(found) for found in find_falcons()] == [
        "Novint Falcon at USB bus 1, device 4",
        "Novint Falcon at USB bus 2, device 7",
    ]
    assert UsbTransport(1).name.endswith("bus 2, device 7")
    with pytest.raises(DeviceNotFound, match=r"number 2: 2 found .*0403:cb48"):
        Falcon(index=2).open()


def test_time_outs_are_no_errors(usb):
    transport = UsbTransport()
    usb.devices[1].failure = USBTimeoutError("timed out", errno.ETIMEDOUT)
    assert transport.bulk_read(64, 0.1) == b""
    assert transport.bulk_write(b"x", 0.1) == 0
    with pytest.raises(DeviceLost):
        transport.control_transfer(0x40, 0, 0, 0)


@pytest.mark.parametrize("number", [errno.ENODEV, errno.EIO, errno.EPIPE])
def test_unplugged(usb, number):
    transport = UsbTransport()
    usb.devices[1].failure = USBError("No such device", number)
    for transfer in (
        lambda: transport.bulk_read(64, 0.1),
        lambda: transport.bulk_write(b"x", 0.1),
        lambda: transport.control_transfer(0x40, 0, 0, 0),
    ):
        with pytest.raises(DeviceLost, match="bus 1, device 4"):
            transfer()


@pytest.mark.parametrize(
    ("number", "error", "message"),
    [
        (errno.EBUSY, DeviceBusy, "another program has the Novint Falcon at USB bus 1, device 4 open"),
        (errno.EACCES, DeviceError, "udev rule"),
        (errno.EPERM, DeviceError, "udev rule"),
        (errno.ENODEV, DeviceLost, "does not answer"),
    ],
)
def test_cannot_be_claimed(usb, number, error, message):
    usb.claim_failure = USBError("no", number)
    with pytest.raises(error, match=message):
        UsbTransport()
    assert usb.disposed == [usb.devices[1]]


def test_libusb_is_missing(usb):
    usb.backend = False
    with pytest.raises(DeviceError, match="libusb"):
        find_falcons()


def test_pyusb_is_missing(monkeypatch):
    for name in ("usb", "usb.core"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError, match=re.escape(install_hint("teleop"))):
        Falcon().open()
