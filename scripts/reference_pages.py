"""Writes the pages in docs/reference: `python scripts/reference_pages.py`, in the repository's root.

There is a page for each public module. `__all__` of the module decides what is on it. A name that several modules offer
is described once, on the page of the first of them in `MODULES`; the others lead there. GitHub shows the tables, and
the site, which `make docs` builds, puts the docstrings below them. With `--check` nothing is written, and the exit
status is 1 if a file is not current.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import re
import sys
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from itertools import groupby
from pathlib import Path
from types import GenericAlias, ModuleType
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]

PAGES = ROOT / "docs" / "reference"

COMMAND = "python scripts/reference_pages.py"

MODULES = {
    "spatula_env.envs": "make or change environments, for one agent or for many",
    "spatula_env.tasks": "change what a task asks, or read how it counts",
    "spatula_env.scenes": "set up organs, tools and the ground, and say what organs consist of",
    "spatula_env.geometry": "make or read surfaces of organs, and tools",
    "spatula_env.contact": "use the flags method without the simulation",
    "spatula_env.sim": "use the physics without Gymnasium",
    "spatula_env.sim.batch": "use the physics of many worlds without Gymnasium",
    "spatula_env.render": "draw scenes, or change how they look",
    "spatula_env.render.palette": "draw something beside the package's pictures, in their colours",
    "spatula_env.anatomy": "prepare organs by a program instead of the command",
    "spatula_env.data": "write, replay or export episodes by a program",
    "spatula_env.policies": "let policies act without torch",
    "spatula_env.learning.experts": "need an expert's actions, to clone or to compare with",
    "spatula_env.teleop": "write a driver for a device that moves the tool",
    "spatula_env.teleop.haptics": "write a driver for a device that the hand feels",
    "spatula_env.teleop.falcon": "use the Falcon's driver in a program of your own",
    "spatula_env.teleop.emulator": "test force feedback without a device",
    "spatula_env.teleop.web": "serve the page from a program of your own",
    "spatula_env.extending": "write a task of your own",
    "spatula_env": "want to know what `import spatula_env` gives you",
}
"""The public modules, and what the reader of each one's page does."""

LONGEST_VALUE = 70
"""Constants whose values take more characters than this are shown without them."""

INNER = {
    "spatula_env._bullet": "PyBullet's own module, imported in one place",
    "spatula_env.cli": "the command `spatula`, whose interface is the shell",
    "spatula_env.sim.simulation": "where the parts of `spatula_env.sim` are written",
}
"""Modules that have `__all__`, and are not public."""

PAGE = """# {module}

This page is for you if you {reader}.

*Written by `{command}` from the docstrings: change them there. [All modules](index.md).*

{introduction}

| Name | What it is |
| --- | --- |
{rows}
"""

INDEX = """# API reference

This page is for you if you write programs with the package: it lists the public modules. A name is public if the
`__all__` of its module has it; everything else may change without notice. [The pages of the tasks](../tasks.md) are
written from the docstrings of the environments.

*Written by `{command}`.*

| Module | What is in it |
| --- | --- |
{rows}
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write or check all files; returns the exit status, 1 if `--check` finds a file that is not current."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; the exit status is 1 if a file is old")
    options = parser.parse_args(arguments)
    if options.check:
        for path in (old := outdated()):
            print(f"{path.relative_to(ROOT)} is not current: run `{COMMAND}`", file=sys.stderr)
        return int(bool(old))
    PAGES.mkdir(parents=True, exist_ok=True)
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")
    for path in outdated():
        path.unlink()
    return 0


def outdated() -> list[Path]:
    """Files that are missing, differ from what would be written now, or are too many."""
    wanted = pages()
    old = [path for path, text in wanted.items() if not path.is_file() or path.read_text(encoding="utf-8") != text]
    return old + [path for path in sorted(PAGES.glob("*.md")) if path not in wanted]


@cache
def pages() -> dict[Path, str]:
    """The text of each page."""
    rows = [f"| [`{module}`]({page_name(module)}) | {summary(import_module(module))} |" for module in MODULES]
    index = INDEX.format(command=COMMAND, rows="\n".join(rows))
    return {PAGES / "index.md": index} | {PAGES / page_name(module): page(module) for module in MODULES}


def page_name(module: str) -> str:
    """The file of a module's page."""
    return f"{module.removeprefix('spatula_env.').replace('.', '-')}.md"


def page(module: str) -> str:
    """The text of a module's page."""
    loaded = import_module(module)
    rows, blocks = [], []
    for name in public_names(loaded):
        value = getattr(loaded, name)
        home = home_of(module, name, value)
        if isinstance(value, ModuleType):
            rows.append(f"| [`{name}`]({page_name(home)}) | {summary(value)} |")
        elif home == module:
            rows.append(f"| `{name}` | {first_sentence(docstring(module, name, value))} |")
            blocks.append(block(module, name, value))
        else:
            text = f"{first_sentence(docstring(home, name, value))} In [`{home}`]({page_name(home)})."
            rows.append(f"| `{name}` | {text} |")
    text = PAGE.format(
        reader=MODULES[module],
        module=module,
        command=COMMAND,
        introduction=introduction(inspect.getdoc(loaded) or ""),
        rows="\n".join(rows),
    )
    for directive, group in groupby(blocks, key=lambda each: each.startswith("..")):
        together = list(group)
        text += "\n" + ("\n".join(["```{eval-rst}", *together, "```"]) if directive else "\n\n".join(together)) + "\n"
    return text


def public_names(module: ModuleType) -> list[str]:
    """The names in `__all__`; without it, those of constants that have a docstring."""
    return list(getattr(module, "__all__", None) or constants(module.__name__))


def introduction(text: str) -> str:
    """A module's docstring as Markdown: its example as a block of code, without the list of inner modules."""
    text = re.sub(r"\nModules::\n\n(?: +.*\n)+", "", text)
    lines = re.sub(r"(?m)^Example:$", "", text).splitlines()
    out: list[str] = []
    for code, group in groupby(lines, key=lambda line: line.lstrip().startswith((">>>", "..."))):
        together = list(group)
        out += ["```python", *(line.strip() for line in together), "```"] if code else together
    return re.sub(r"\n{3,}", "\n\n", "\n".join(out))


def home_of(module: str, name: str, value: Any) -> str:
    """The module on whose page a name of `module` is described: the first that offers the same object by this name."""
    if isinstance(value, ModuleType):
        return value.__name__
    for other in MODULES:
        loaded = import_module(other)
        if name in public_names(loaded) and getattr(loaded, name) is value:
            return other
    return module


def block(module: str, name: str, value: Any) -> str:
    """The directive that puts an object's description on the site."""
    full = f"{module}.{name}"
    if is_class(value):
        kind = "exception" if issubclass(value, BaseException) else "class"
        return "\n".join([f".. auto{kind}:: {full}", *(f"   {option}" for option in class_options(value))])
    if inspect.isroutine(value):
        return f".. autofunction:: {full}"
    shown = constants(module)[name].source
    options = f":value: {shown}\n" if len(shown) <= LONGEST_VALUE else ""
    return f"```{{py:data}} {full}\n{options}\n{docstring(module, name, value)}\n```"


def class_options(cls: type) -> list[str]:
    """Options of a class's directive: what it inherits from classes that are not public is described with it."""
    public = [base for base in cls.__mro__[1:] if base in public_classes()]
    above = {base for each in public for base in each.__mro__}
    inner = [base for base in cls.__mro__ if base is cls or (is_inner(base) and base not in above)]
    options = []
    if len(inner) > 1:
        others = sorted({base.__name__ for base in cls.__mro__ if base not in inner and base is not object})
        options.append(f":inherited-members: {', '.join(others)}".rstrip())
    if any("__call__" in vars(base) for base in inner):
        options.append(":special-members: __call__")
    return options


def is_inner(cls: type) -> bool:
    """Whether a class is of this package, and not public."""
    return cls.__module__.partition(".")[0] == "spatula_env" and cls not in public_classes()


@cache
def public_classes() -> frozenset[type]:
    """All public classes."""
    values = [getattr(loaded, name) for loaded in map(import_module, MODULES) for name in public_names(loaded)]
    return frozenset(value for value in values if is_class(value))


def is_class(value: Any) -> bool:
    """Whether this is a class, and not an alias such as `dict[str, int]`, which Python 3.10 takes for one."""
    return inspect.isclass(value) and not isinstance(value, GenericAlias)


def docstring(module: str, name: str, value: Any) -> str:
    """The docstring of a class or a function, or the one that follows the assignment of anything else."""
    if is_class(value) or inspect.isroutine(value):
        return inspect.getdoc(value) or ""
    return constants(module)[name].docstring if name in constants(module) else ""


class Constant(NamedTuple):
    """An assignment: the expression as it is written, on one line, and the docstring below."""

    source: str
    docstring: str


@cache
def constants(module: str) -> dict[str, Constant]:
    """Assignments with a docstring in a module, and in those modules that it takes names from."""
    text = inspect.getsource(import_module(module))
    tree = ast.parse(text)
    told: dict[str, Constant] = {}
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(f"{module}."):
            there = constants(str(node.module))
            told |= {name.asname or name.name: there[name.name] for name in node.names if name.name in there}
    for node, following in zip(tree.body, tree.body[1:], strict=False):
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        if (
            isinstance(node, ast.Assign | ast.AnnAssign)
            and isinstance(target, ast.Name)
            and node.value is not None
            and isinstance(following, ast.Expr)
            and isinstance(following.value, ast.Constant)
            and isinstance(following.value.value, str)
        ):
            source = re.sub(r"\s+", " ", ast.get_source_segment(text, node.value) or "")
            told[target.id] = Constant(source, inspect.cleandoc(following.value.value))
    return told


def summary(module: ModuleType) -> str:
    """What a module says of itself in a sentence."""
    return first_sentence(inspect.getdoc(module) or "")


def first_sentence(text: str) -> str:
    """The first sentence of a docstring, on one line, for a cell of a table."""
    paragraph = re.sub(r"\s+", " ", text.partition("\n\n")[0])
    sentence = re.match(r".*?\.(?= [A-Z`]|$)", paragraph)
    return (sentence[0] if sentence else paragraph).replace("|", r"\|")


if __name__ == "__main__":
    sys.exit(main())
