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


def test_a_long_wait_is_explained_once(impatient):
    with _kernels.announce_compilation(), _kernels.announce_compilation():
        time.sleep(0.2)
    assert [record.getMessage() for record in impatient.records] == [
        "spatula_env is compiling kernels, once after installation. This can take a minute."
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
    with _kernels.announce_compilation():
        time.sleep(0.2)
    assert len(impatient.records) == 1
