"""The reference describes all that is public, once, and nothing else."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import sys
from collections import Counter
from pathlib import Path
from types import GenericAlias, ModuleType
from typing import Any

import pytest

import spatula_env

ROOT = Path(__file__).parents[2]

PAGES = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "reference").glob("*.md")}

DESCRIBED = re.findall(
    r"^(?:\.\. auto(?:class|exception|function)::|```\{py:data\}) (\S+)$", "\n".join(PAGES.values()), re.MULTILINE
)


@pytest.fixture(scope="module")
def script():
    folder = str(ROOT / "scripts")
    sys.path.insert(0, folder)
    yield importlib.import_module("reference_pages")
    sys.path.remove(folder)
    sys.modules.pop("reference_pages", None)


def with_all() -> list[str]:
    """The modules whose source assigns `__all__`."""
    names = [spatula_env.__name__, *(each.name for each in pkgutil.walk_packages(spatula_env.__path__, "spatula_env."))]
    return [name for name in names if re.search(r"^__all__ = ", source(name), re.MULTILINE)]


def source(name: str) -> str:
    place = ROOT.joinpath(*name.split("."))
    return (place / "__init__.py" if place.is_dir() else place.with_suffix(".py")).read_text(encoding="utf-8")


def value_of(name: str) -> Any:
    module, _, last = name.rpartition(".")
    return getattr(importlib.import_module(module), last)


def is_class(value: Any) -> bool:
    return inspect.isclass(value) and not isinstance(value, GenericAlias)


def test_pages_are_current(script) -> None:
    old = [str(path.relative_to(ROOT)) for path in script.outdated()]
    assert not old, f"not current: {', '.join(old)}; run `{script.COMMAND}`"


def test_modules_with_public_names_are_public_or_said_to_be_inner(script) -> None:
    assert not set(script.MODULES) & set(script.INNER)
    assert set(with_all()) <= set(script.MODULES) | set(script.INNER)
    assert set(script.INNER) <= set(with_all())


def test_all_that_is_public_is_described_once(script) -> None:
    described = [value_of(name) for name in DESCRIBED]
    times = Counter(map(id, described))
    for name in set(with_all()) - set(script.INNER):
        module = importlib.import_module(name)
        for public in module.__all__:
            value = getattr(module, public)
            if isinstance(value, ModuleType):
                assert value.__name__ in script.MODULES, f"{name}.{public}"
                continue
            last = [full for full in DESCRIBED if full.rpartition(".")[2] == public and value_of(full) is value]
            assert len(last) == 1, f"{name}.{public} is described as {last or 'nothing'}"
            assert times[id(value)] == 1 or not is_class(value)
            row = rf"^\| \[?`{re.escape(public)}`.* \| \S.* \|$"
            assert re.search(row, PAGES[Path(script.page_name(name)).stem], re.MULTILINE), f"{name}.{public}"


def test_nothing_private_is_described(script) -> None:
    assert len(set(DESCRIBED)) == len(DESCRIBED)
    for name in DESCRIBED:
        module, _, last = name.rpartition(".")
        assert module in script.MODULES and module not in script.INNER, name
        assert last in script.public_names(importlib.import_module(module)), name
        assert last == "__version__" or not any(part.startswith("_") for part in name.split(".")), name


def test_every_public_name_says_what_it_is(script) -> None:
    for name in DESCRIBED:
        module, _, last = name.rpartition(".")
        assert script.docstring(module, last, value_of(name)), name


def test_every_public_method_says_what_it_does() -> None:
    silent = []
    for name in DESCRIBED:
        if is_class(value_of(name)):
            for attribute, member in vars(value_of(name)).items():
                told = isinstance(member, property | classmethod | staticmethod) or inspect.isfunction(member)
                if told and not attribute.startswith("_") and not inspect.getdoc(getattr(value_of(name), attribute)):
                    silent.append(f"{name}.{attribute}")
    assert silent == []


def test_a_page_leads_to_where_a_name_is_described(script) -> None:
    assert "| `Task` | Base of all tasks. In [`spatula_env.tasks`](tasks.md). |" in PAGES["extending"]
    assert "spatula_env.extending.Task" not in DESCRIBED and "spatula_env.tasks.Task" in DESCRIBED


def test_only_what_is_inherited_from_inner_classes_is_repeated(script) -> None:
    from spatula_env.envs import PressEnv, SpatulaEnv
    from spatula_env.learning.experts import PressExpert

    assert script.class_options(PressEnv) == []
    assert script.class_options(SpatulaEnv) == [":inherited-members: Env, Generic"]
    assert ":special-members: __call__" in script.class_options(PressExpert)


def test_a_sentence_ends_with_its_point(script) -> None:
    assert (
        script.first_sentence("Forces of 0.2 N, as e.g. here.\nMore.\n\nA paragraph.")
        == "Forces of 0.2 N, as e.g. here."
    )
    assert script.first_sentence("A | B") == r"A \| B"


def test_what_is_written_is_current_until_it_is_changed(script, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(script, "ROOT", tmp_path)
    monkeypatch.setattr(script, "PAGES", tmp_path / "docs" / "reference")
    script.pages.cache_clear()
    assert script.main(["--check"]) == 1
    assert script.main([]) == 0
    (script.PAGES / "gone.md").write_text("# Gone\n")
    capsys.readouterr()
    assert script.main(["--check"]) == 1
    assert "docs/reference/gone.md is not current" in capsys.readouterr().err.replace("\\", "/")
    assert script.main([]) == 0
    assert script.main(["--check"]) == 0
    script.pages.cache_clear()
