"""What is said while kernels are compiled."""

from __future__ import annotations

import logging
import time

import pytest

from spatula_env import _kernels


@pytest.fixture
def impatient(monkeypatch, caplog):
    monkeypatch.setattr(_kernels, "PATIENCE", 0.01)
    caplog.set_level(logging.WARNING, logger="spatula_env")
    return caplog


def wait_for_a_word(log, patience=10.0):
    """Take long, until something is said; a busy machine needs a while for that."""
    end = time.monotonic() + patience
    while not log.records and time.monotonic() < end:
        time.sleep(0.02)


def test_a_long_wait_is_explained_once(impatient):
    with _kernels.announce_compilation(), _kernels.announce_compilation():
        wait_for_a_word(impatient)
        time.sleep(0.05)
    assert [record.getMessage() for record in impatient.records] == [
        "spatula_env is compiling the contact model, once after installation. This can take half a minute."
    ]


def test_what_is_quick_is_not_spoken_of(impatient, monkeypatch):
    monkeypatch.setattr(_kernels, "PATIENCE", 0.5)
    for _ in range(3):
        with _kernels.announce_compilation():
            pass
    time.sleep(0.7)
    assert not impatient.records


def test_after_an_error_it_is_announced_again(impatient):
    with pytest.raises(ValueError, match="broken"), _kernels.announce_compilation():
        raise ValueError("broken")
    impatient.clear()
    with _kernels.announce_compilation():
        wait_for_a_word(impatient)
    assert len(impatient.records) == 1
