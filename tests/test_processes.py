"""Work in other processes, and how they end."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from spatula_env.processes import WorkerDied, in_processes


def square(number: int) -> int:
    return number * number


def complain(number: int) -> int:
    if number == 2:
        raise LookupError("two")
    return number


def crash(number: int) -> None:
    os._exit(number)


def mark_and_wait(folder: Path, number: int) -> int:
    (folder / str(os.getpid())).touch()
    if number:
        time.sleep(600)
    return number


def remember(folder: Path) -> None:
    (folder / f"prepared-{os.getpid()}").touch()


def is_running(number: int) -> bool:
    try:
        state = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_results_come_with_their_numbers():
    assert dict(in_processes(square, [3, 1, 4, 1, 5], 2)) == {0: 9, 1: 1, 2: 16, 3: 1, 4: 25}
    assert list(in_processes(square, [], 2)) == []
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        next(in_processes(square, [1], 0))


def test_each_process_is_prepared(tmp_path):
    assert dict(in_processes(square, [1, 2], 2, partial(remember, tmp_path))) == {0: 1, 1: 4}
    assert len(list(tmp_path.glob("prepared-*"))) == 2


def test_an_exception_comes_back_with_its_traceback():
    with pytest.raises(LookupError, match="two") as caught:
        list(in_processes(complain, [1, 2, 3], 1))
    assert "in complain" in str(caught.value.__cause__)


def test_a_process_that_ends_is_told():
    with pytest.raises(WorkerDied, match="with the exit status 7, while it worked on 7"):
        list(in_processes(crash, [7], 1))


@pytest.mark.skipif(not Path("/proc").exists(), reason="processes are looked up in /proc")
def test_whoever_turns_away_ends_the_processes(tmp_path):
    with closing(in_processes(partial(mark_and_wait, tmp_path), [0, 1, 1], 2)) as stream:
        assert next(stream) == (0, 0)
    assert not any(is_running(int(file.name)) for file in tmp_path.iterdir())


@pytest.mark.skipif(not Path("/proc").exists(), reason="processes are looked up in /proc")
def test_processes_do_not_outlive_one_that_is_killed(tmp_path):
    code = (
        "from functools import partial; from pathlib import Path; from test_processes import mark_and_wait\n"
        "from spatula_env.processes import in_processes\n"
        f"if __name__ == '__main__': list(in_processes(partial(mark_and_wait, Path({str(tmp_path)!r})), [1, 1], 2))"
    )
    file = tmp_path / "main.py"
    file.write_text(code)
    here = str(Path(__file__).parent)
    process = subprocess.Popen(
        [sys.executable, str(file)], env={**os.environ, "PYTHONPATH": os.pathsep.join([here, *sys.path])}
    )
    try:
        while len(list(tmp_path.iterdir())) < 3:
            assert process.poll() is None
            time.sleep(0.05)
    finally:
        process.kill()
        process.wait()
    workers = [int(each.name) for each in tmp_path.iterdir() if each.name.isdigit()]
    while any(map(is_running, workers)):
        time.sleep(0.05)
