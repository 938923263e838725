"""PyBullet's line about its build is left out of standard error, and nothing else."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from spatula_env.engines import import_bullet

PATIENCE = 120.0


def run(code, **options):
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE, check=False, **options
    )


@pytest.mark.bullet
def test_nothing_is_said_and_other_words_are_kept():
    done = run(
        "import os, sys\n"
        "from spatula_env.engines import import_bullet\n"
        "print('before', file=sys.stderr)\n"
        "bullet = import_bullet('a test')\n"
        "os.write(2, b'after\\n')\n"
        "print(bullet.DIRECT)\n"
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "2\n", "before\nafter\n")


@pytest.mark.bullet
def test_threads_that_write_meanwhile_are_heard_and_import_it_once():
    done = run(
        "import os, threading\n"
        "from spatula_env.engines import import_bullet\n"
        "end = threading.Event()\n"
        "def write():\n"
        "    for number in range(100000):\n"
        "        os.write(2, b'word %d\\n' % number)\n"
        "        if end.is_set():\n"
        "            break\n"
        "    print(number)\n"
        "writer = threading.Thread(target=write)\n"
        "writer.start()\n"
        "loaders = [threading.Thread(target=import_bullet, args=('a test',)) for _ in range(4)]\n"
        "for loader in loaders: loader.start()\n"
        "for loader in loaders: loader.join()\n"
        "end.set()\n"
        "writer.join()\n"
    )
    assert done.returncode == 0
    # What was caught is passed on while the thread goes on writing: nothing is lost, though a word may come first.
    said = sorted(done.stderr.splitlines(), key=lambda line: int(line.removeprefix("word ")))
    assert said == [f"word {number}" for number in range(int(done.stdout) + 1)]


@pytest.mark.bullet
def test_standard_error_may_be_closed():
    done = run("import os, sys\nos.close(2)\nfrom spatula_env import _bullet\nprint(_bullet.pybullet.DIRECT)\n")
    assert (done.returncode, done.stdout) == (0, "2\n")


@pytest.mark.bullet
def test_without_a_place_for_temporary_files_it_is_imported_all_the_same():
    done = run(
        "import tempfile\n"
        "def refuse(*_, **__): raise FileNotFoundError('no place')\n"
        "tempfile.TemporaryFile = refuse\n"
        "from spatula_env.engines import import_bullet\n"
        "print(import_bullet('a test').DIRECT)\n"
    )
    assert (done.returncode, done.stdout) == (0, "2\n")


@pytest.mark.bullet
def test_only_lines_that_begin_so_are_left_out(tmp_path):
    from spatula_env._bullet import without_lines

    with (tmp_path / "said").open("wb") as file:
        with pytest.raises(RuntimeError, match="broken"), without_lines(b"drop", file.fileno()):
            os.write(file.fileno(), b"keep this\ndrop that\nand drop\nno end")
            raise RuntimeError("broken")
        os.write(file.fileno(), b"\ndrop\n")
    assert (tmp_path / "said").read_bytes() == b"keep this\nand drop\nno end\ndrop\n"


@pytest.mark.bullet
def test_descriptors_are_given_back():
    before = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else None
    from spatula_env._bullet import without_lines

    for _ in range(5):
        with without_lines(b"drop"):
            import_bullet("a test")
    if before is not None:
        assert len(os.listdir("/proc/self/fd")) == before
