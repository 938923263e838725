"""The fissure between the hemispheres of a brain is found, and the expert retracts one of them there."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
NEEDED = [
    name for name in ("nilearn", "nibabel", "trimesh", "fast_simplification") if not importlib.util.find_spec(name)
]
pytestmark = pytest.mark.skipif(bool(NEEDED), reason=f"not installed: {', '.join(NEEDED)}")


@pytest.fixture(scope="module")
def script() -> Iterator[ModuleType]:
    spec = importlib.util.spec_from_file_location("brain_example", ROOT / "scripts" / "brain_example.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["brain_example"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["brain_example"]


@pytest.mark.parametrize(
    "engine",
    [
        "batch",
        pytest.param("tissue", marks=pytest.mark.skipif(not importlib.util.find_spec("netgen"), reason="needs Netgen")),
    ],
)
@pytest.mark.filterwarnings("ignore::spatula_env._warnings.SceneWarning")
def test_a_hemisphere_is_retracted_at_the_fissure(script: ModuleType, engine: str, tmp_path: Path) -> None:
    organ = script.prepared_brain(script.data_folder(), fill="yes" if engine == "tissue" else "no")
    file = tmp_path / "brain.npz"
    script.write_prepared(file, organ)
    told, _ = script.retract(file, engine, 4)
    assert told["between"] >= 1
    assert told["successes"] >= 3
    assert told["force"] < 1.5
