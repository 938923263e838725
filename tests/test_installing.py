"""Installation hints name a command that works where the package is used from."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import pytest

from spatula_env import installing
from spatula_env.installing import install_hint, origin_of

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    ("direct_url", "told"),
    [
        (None, "pip install 'spatula-env[train,data]'"),
        (
            {"url": "https://example.org/spatula.git", "vcs_info": {"vcs": "git", "commit_id": "abc"}},
            "pip install 'spatula-env[train,data] @ git+https://example.org/spatula.git@abc'",
        ),
        (
            {
                "url": "https://example.org/spatula.git",
                "vcs_info": {"vcs": "git", "commit_id": "abc", "requested_revision": "main"},
            },
            "pip install 'spatula-env[train,data] @ git+https://example.org/spatula.git@main'",
        ),
        (
            {"url": "https://example.org/spatula_env-0.1.0.tar.gz", "archive_info": {}},
            "pip install 'spatula-env[train,data] @ https://example.org/spatula_env-0.1.0.tar.gz'",
        ),
        ({"url": "file:///nowhere/any%20more", "dir_info": {}}, "pip install 'spatula-env[train,data]'"),
    ],
)
def test_the_words_follow_from_where_the_package_came_from(
    direct_url: dict[str, Any] | None, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(installing, "_origin", lambda: origin_of(direct_url, tmp_path))
    monkeypatch.setattr(installing, "QUOTE", "'")
    assert install_hint("train", "data") == told
    monkeypatch.setattr(installing, "QUOTE", '"')
    assert install_hint("train", "data") == told.replace("'", '"')


@pytest.mark.skipif(sys.platform == "win32", reason="paths of file URLs are others on Windows")
def test_a_checkout_is_named_by_its_folder(tmp_path: Path) -> None:
    folder = tmp_path / "a folder"
    folder.mkdir()
    url = f"file://{tmp_path}/a%20folder"
    assert origin_of({"url": url, "dir_info": {}}, tmp_path) == ("", str(folder), "")
    # What is imported lies in a checkout, whether it is installed from there or only on the path.
    assert (
        origin_of(None, ROOT) == origin_of({"url": url, "dir_info": {"editable": True}}, ROOT) == ("-e ", str(ROOT), "")
    )


def test_no_other_words_are_in_the_code() -> None:
    """Only one function makes installation hints, because their wording depends on how the package is installed."""
    for folder in ("spatula_env", "agents", "benchmarks", "scripts"):
        for file in (ROOT / folder).rglob("*.py"):
            if file.name != "installing.py":
                found = re.search(r"pip install '?(spatula-env|\.)\[", file.read_text(encoding="utf-8"))
                assert found is None, file.relative_to(ROOT)
