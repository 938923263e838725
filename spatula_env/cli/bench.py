"""`spatula bench`."""

from __future__ import annotations

import argparse
import ast
import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from spatula_env.cli.common import CommandError, add_json_option, new_parser, note, print_json
from spatula_env.engines import bullet_hint, bullet_is_there

if TYPE_CHECKING:
    from collections.abc import Mapping

    from spatula_env.cli.common import Parsers

CORE: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "parity": (),
        "fidelity": (),
        "tunnelling": ("--cases", "100", "--subset", "20"),
        "step": ("--steps", "500"),
        "tasks": ("--episodes", "10", "--engines", "batch"),
    }
)
"""Benchmarks that `--core` runs, with their arguments: a few minutes in all."""

NEED_BULLET = ("parity", "step")
"""Core benchmarks that have nothing to measure without PyBullet."""

DESCRIPTION = """Run the measurements of speed and quality.

Without a name it lists them. What follows a name goes to the benchmark; --help there tells its
options. --core runs the core ones, made short: does the batch engine do what PyBullet does, do
forces mean something, does a thin tool ever get through, what does a step cost, are tasks solved.

examples:
  spatula bench
  spatula bench tunnelling --cases 200
  spatula bench --core --json"""


def add_parser(commands: Parsers) -> None:
    """Add the command."""
    parser = new_parser(commands, "bench", "list and run the benchmarks", DESCRIPTION)
    parser.add_argument("--core", action="store_true", help="run the core ones, made short")
    add_json_option(parser)
    parser.add_argument("name", nargs="?", metavar="NAME", help="which; lists them if it is not given")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, metavar="...", help="options of the benchmark")
    parser.set_defaults(run=run)


def run(chosen: argparse.Namespace) -> int:
    """List the benchmarks or run one, or the core ones."""
    known = benchmarks()
    if chosen.core:
        if chosen.name is not None:
            raise CommandError("--core runs its own; leave the name out")
        return _core(chosen.json)
    if chosen.name is None:
        if chosen.json:
            print_json({name: {"about": about, "core": name in CORE} for name, about in known.items()})
            return 0
        width = max(map(len, known))
        for name, about in known.items():
            print(f"{name:{width}}  {'core' if name in CORE else '    '}  {about}")
        return 0
    if chosen.name not in known:
        raise CommandError(f"there is no benchmark {chosen.name!r}; there are {', '.join(known)}")
    # In a process of its own, because some benchmarks start others, which import the main module.
    extra = ["--json"] if chosen.json and "--json" not in chosen.arguments else []
    return subprocess.run([*_command(chosen.name), *chosen.arguments, *extra], check=False).returncode


def benchmarks() -> dict[str, str]:
    """The first docstring lines of all benchmarks, by name. No benchmark is imported.

    Raises:
        CommandError: If this is not a checkout: benchmarks are not installed.
    """
    package = find_spec("benchmarks")
    folders = [] if package is None else [Path(place) for place in package.submodule_search_locations or ()]
    # Another package may have the same name.
    ours = [folder for folder in folders if all((folder / f"{name}.py").exists() for name in CORE)]
    found = {}
    for file in sorted(ours[0].glob("*.py")) if ours else ():
        text = file.read_text(encoding="utf-8")
        # Modules without a main part are helpers of the benchmarks.
        if 'if __name__ == "__main__"' in text:
            about = (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]
            found[file.stem] = about
    if not found:
        raise CommandError("the benchmarks are not installed: run this in a checkout of the repository")
    return found


def _core(as_json: bool) -> int:
    results: dict[str, Any] = {}
    failed = []
    for name, arguments in CORE.items():
        if name in NEED_BULLET and not bullet_is_there():
            note(f"{name} is left out: PyBullet is not installed. {bullet_hint()}")
            continue
        note(f"{name} {' '.join(arguments)}".rstrip())
        done = subprocess.run([*_command(name), *arguments, "--json"], stdout=subprocess.PIPE, text=True, check=False)
        lines = done.stdout.strip().splitlines()
        try:
            results[name] = json.loads(lines[-1])
        except (IndexError, ValueError):
            results[name] = None
        if done.returncode != 0 or results[name] is None:
            failed.append(name)
        if not as_json:
            print(f"{name}: {lines[-1] if lines else 'no result'}", flush=True)
    if as_json:
        print_json(results)
    if failed:
        raise CommandError(f"{', '.join(failed)} failed")
    return 0


def _command(name: str) -> list[str]:
    return [sys.executable, "-m", f"benchmarks.{name}"]
