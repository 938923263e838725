"""The command that makes the page of results: `python -m agents.results`."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import yaml

from spatula_env.files import write_text
from spatula_env.installing import install_hint
from spatula_env.learning.commands.common import fail
from spatula_env.learning.configuration import ENGINES, find_config
from spatula_env.learning.results.gather import gather, read_machines
from spatula_env.learning.results.page import write_page
from spatula_env.learning.results.plan import ResultsPlan, planned_references, planned_runs, read_plan
from spatula_env.learning.results.runs import evaluate_agent, is_finished, make_agents

PROGRAM = "python -m spatula_env.learning.commands.results"


def main(arguments: Sequence[str] | None = None, program: str = PROGRAM) -> int:
    """Run the part of a plan that is not done yet, and write its page.

    Args:
        arguments: Arguments after the module's name; None takes them from the command line.
        program: The command as the user typed it.

    Returns:
        Exit status: 0 on success.
    """
    parser = argparse.ArgumentParser(
        prog=program,
        description="Train and evaluate what is planned, and write the page of results.",
    )
    parser.add_argument("--plan", default="results", metavar="NAME", help="a YAML file, or the name of one in configs")
    parser.add_argument("--tasks", nargs="+", metavar="TASK", help="some of the plan's only")
    parser.add_argument("--algorithms", nargs="+", metavar="ALGORITHM", help="some of the plan's only")
    parser.add_argument("--seeds", nargs="+", type=int, metavar="SEED", help="some of the plan's only")
    parser.add_argument("--engines", nargs="+", choices=ENGINES, help="evaluate in some of the plan's only")
    parser.add_argument("--jobs", type=int, default=1, help="runs at once; default: %(default)s")
    parser.add_argument("--again", action="store_true", help="evaluate also what has been evaluated")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--runs", action="store_true", help="train only")
    what.add_argument("--page", action="store_true", help="write the page only, of what there is")
    chosen = parser.parse_args(arguments)
    if chosen.jobs < 1:
        parser.error(f"--jobs must be 1 or more, got {chosen.jobs}")
    given = sys.argv[1:] if arguments is None else arguments
    try:
        return _run(chosen, program, shlex.join([*program.split(), *given]))
    except (FileNotFoundError, ValueError, yaml.YAMLError) as error:
        return fail(program, str(error))
    except ImportError as error:
        hint = str(error) if "pip install" in str(error) else f"needs {error.name}: {install_hint('results')}"
        return fail(program, hint)
    except KeyboardInterrupt:
        return fail(program, "interrupted; the same command goes on", 130)


def _run(chosen: argparse.Namespace, program: str, command: str) -> int:
    plan = _with_engines(read_plan(find_config(chosen.plan, "tasks")), chosen.engines)
    runs = planned_runs(plan, chosen.tasks, chosen.algorithms, chosen.seeds)
    failures: list[str] = []
    if not chosen.page:
        failures = make_agents(runs, chosen.jobs, _say)
        for failure in failures:
            fail(program, failure)
    if not chosen.page and not chosen.runs:
        for run in [*planned_references(plan, chosen.tasks), *runs]:
            for engine in plan.evaluation.engines if is_finished(run) else ():
                if evaluate_agent(run, plan.evaluation, engine, again=chosen.again):
                    _say(f"{run.title}: evaluated in the {engine} engine")
    if not chosen.runs:
        from spatula_env.learning.results.pictures import draw_pictures

        rows = gather(plan)
        if not rows:
            return fail(program, f"there is nothing to write of yet in {plan.runs}")
        pictures = draw_pictures(plan, rows)
        write_text(Path(plan.page), write_page(plan, rows, read_machines(plan), command))
        for file in (*pictures, plan.page):
            print(file)
    return 1 if failures else 0


def _with_engines(plan: ResultsPlan, engines: Sequence[str] | None) -> ResultsPlan:
    """A plan reduced to some of its engines.

    Raises:
        ValueError: If the plan lacks one of them.
    """
    if engines is None:
        return plan
    unknown = [name for name in engines if name not in plan.evaluation.engines]
    if unknown:
        raise ValueError(f"engines must be some of {list(plan.evaluation.engines)}, got {unknown}")
    kept = tuple(name for name in plan.evaluation.engines if name in engines)
    return replace(plan, evaluation=replace(plan.evaluation, engines=kept))


def _say(text: str) -> None:
    print(text, flush=True)


if __name__ == "__main__":
    sys.exit(main())
