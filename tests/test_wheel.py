"""The wheel: it installs one import name, and everything that the commands need."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

pytest.importorskip("hatchling", reason="builds the wheel")

ROOT = Path(__file__).parents[1]

BUILD = "import sys; from hatchling.build import build_wheel; build_wheel(sys.argv[1])"

COMMANDS = """
import sys
from pathlib import Path
import spatula_env
from spatula_env.cli import main
from spatula_env.learning.configuration import find_config, read_training

there = Path(spatula_env.__file__).parent
assert there.parent == Path(sys.argv[1]), there
assert find_config("press_sac") == there / "learning" / "configs" / "press_sac.yaml"
assert read_training(find_config("press_sac")).algorithm == "sac"
assert main(["train", "--config", "none"]) == 1
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the wheel has in it."""
    place = tmp_path_factory.mktemp("wheel")
    subprocess.run([sys.executable, "-c", BUILD, str(place)], cwd=ROOT, check=True, capture_output=True, timeout=120)
    (wheel,) = place.glob("*.whl")
    folder = place / "installed"
    with ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def test_there_is_one_import_name(installed: Path) -> None:
    names = {path.name for path in installed.iterdir() if path.suffix != ".dist-info"}
    assert names == {"spatula_env"}


def test_everything_of_the_package_is_in_it(installed: Path) -> None:
    files = [path for path in (ROOT / "spatula_env").rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    assert [path for path in files if not (installed / path.relative_to(ROOT)).is_file()] == []
    there = installed / "spatula_env" / "learning" / "configs"
    configs = [path.relative_to(ROOT / "configs") for path in (ROOT / "configs").rglob("*") if path.is_file()]
    assert configs
    assert [name for name in configs if not (there / name).is_file()] == []


def test_the_commands_find_what_they_need_from_anywhere(installed: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS, str(installed)], cwd=tmp_path, capture_output=True, text=True, timeout=120,
        env={**os.environ, "PYTHONPATH": str(installed)}, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "spatula train: config must be a file or one of" in done.stderr and "press_sac" in done.stderr
    assert list(tmp_path.iterdir()) == []
