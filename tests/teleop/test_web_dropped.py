"""A device that is dropped takes its page along: no socket and no thread is left."""

from __future__ import annotations

import gc
import os
import socket
import threading
import weakref

import gymnasium as gym
import pytest

import spatula_env
from spatula_env.teleop.web import WebDevice
from spatula_env.teleop.web.device import weakly

pytest.importorskip("viser", reason="the extra web is not installed")
assert spatula_env.TASKS


def listens(port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex(("127.0.0.1", port)) == 0


@pytest.mark.parametrize("watched", [False, True])
@pytest.mark.parametrize("closed", [True, False])
def test_nothing_is_left(closed: bool, watched: bool) -> None:
    threads = threading.active_count()
    files = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0
    device = WebDevice(port=0)
    device.open()
    port = device.page._page_server.port
    env = gym.make("Spatula/Press-v0", engine="batch")
    if watched:
        observation, _ = env.reset(seed=0)
        device.watch(observation, env)
    assert listens(port)
    if closed:
        device.close()
    gone = weakref.ref(device)
    env.close()
    del device, env
    gc.collect()
    assert gone() is None
    assert not listens(port)
    assert threading.active_count() <= threads
    if files:
        assert len(os.listdir("/proc/self/fd")) <= files + 1


def test_what_is_gone_is_not_called() -> None:
    class Counter:
        count = 0

        def add(self, number: int) -> None:
            self.count += number

    counter = Counter()
    call = weakly(counter.add)
    call(2)
    assert counter.count == 2
    del counter
    gc.collect()
    call(2)
