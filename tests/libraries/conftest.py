"""Tests that need a learning library are skipped by its name where it is not installed."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what is in this folder; libraries warn of much that is not ours."""
    for item in items:
        if HERE not in item.path.parents:
            continue
        item.add_marker(pytest.mark.filterwarnings("ignore"))
        for needed in item.iter_markers("libraries"):
            for name in needed.args:
                if find_spec(name) is None:
                    item.add_marker(pytest.mark.skip(f"{name} is not installed; `make test-libraries` installs it"))
