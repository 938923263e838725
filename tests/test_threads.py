"""Work distributed over threads: every piece is done exactly once, and nothing is left behind."""

from __future__ import annotations

import multiprocessing
import os
import threading

import numpy as np
import pytest

from spatula_env import scenes
from spatula_env.sim.batch import BatchSimulation
from spatula_env.threads import share_out


@pytest.mark.parametrize("count", [0, 1, 2, 9])
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_each_piece_is_done_once(count, threads):
    done: list[int] = []
    share_out(done.append, count, threads)
    assert sorted(done) == list(range(count))


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_so_many_threads_work_at_the_same_time(threads):
    together, seen = threading.Barrier(threads, timeout=30.0), set()

    def work(piece: int) -> None:
        # Passes when all threads have come here, and only then.
        together.wait()
        seen.add(threading.get_ident())

    share_out(work, threads, threads)
    assert len(seen) == threads and threading.get_ident() in seen


def test_no_thread_is_left():
    before = threading.active_count()
    share_out(lambda piece: None, 20, 4)
    assert threading.active_count() == before


def test_what_fails_is_raised_when_all_have_ended():
    before = threading.active_count()

    def work(piece: int) -> None:
        if piece == 3:
            raise FloatingPointError(f"piece {piece}")

    for threads in (1, 3):
        with pytest.raises(FloatingPointError, match="piece 3"):
            share_out(work, 10, threads)
        assert threading.active_count() == before


def advance(batch: BatchSimulation) -> np.ndarray:
    batch.reset()
    batch.advance(np.tile([0.0, 0.0, -20.0], (batch.count, 1, 1)), steps=6)
    return batch.nodes


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_worlds_on_many_threads_go_on_in_a_forked_process():
    batch = BatchSimulation(scenes.seed(), 20, parallel=True)
    expected = advance(batch)
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    child = context.Process(target=lambda: there.send(advance(batch)))
    child.start()
    try:
        assert here.poll(120.0), "the forked process does not go on"
        np.testing.assert_array_equal(here.recv(), expected)
    finally:
        child.join(10.0)
        child.kill()
