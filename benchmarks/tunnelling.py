"""Does a thin tool ever get through the organ's surface? Thousands of random plunges, inspected step by step.

Each case drives the seed's spatula, with contact nodes on all its faces, into the seed's organ: from any direction,
tilted by up to 20 degrees and turned at random, any of its 6 faces or 12 edges first, at 0.1 to 2000 u/s, 0.02 to 0.5 u
thick, with 60 to 480 physics steps a second, 0.2 to 2 u deep, and holds it there for a quarter of a second. A case can
be repeated from its number. Faults are found by `benchmarks.inspection`, not by the contact model that is judged:

    missed      a contact node deeper than 0.01 u, or the tool's centre, inside the organ, and no flag set
    enclosed    the tool's centre, or a column through its whole thickness, inside the organ
    passages    the organ's surface went right through the tool, from one face to the opposite one
    pairs       both nodes of an opposite pair flagged
    residual    a depth of tool in organ or organ in tool above 0.01 u, a third of a per cent of the organ's radius
    non-finite  the simulation diverged

A case has failed if one of these happened in any of its steps. The flags method runs all cases, Bullet's own contact
and the second step alone only the first few of them.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any, NoReturn, get_args

import numpy as np

from benchmarks import plunges
from benchmarks.inspection import ALLOWED, Inspection
from benchmarks.measure import finish, output_file, parser
from benchmarks.parallel import WorkerDied, available_cores, results
from benchmarks.plunges import Outcome
from spatula_env.engines import DEFAULT, ENGINES, choose_engine, load_engine
from spatula_env.sim import Report, Simulation
from spatula_env.sim.simulation import ContactName

SEED = 20261122
"""Default seed of the cases."""

WORST = 10
"""Number of the worst cases that are listed."""


@dataclass(frozen=True)
class Job:
    """A case to run.

    Attributes:
        seed: Seed of the benchmark.
        number: Number of the case.
        contact: The contact model.
        engine: Engine that integrates the organ; None for the default.
    """

    seed: int
    number: int
    contact: ContactName
    engine: str | None = None


def run_job(job: Job) -> Outcome:
    """Run one case; errors name the case."""
    try:
        return plunges.run(plunges.draw(job.seed, job.number), job.contact, None, job.engine)
    except Exception as error:
        raise RuntimeError(f"case {job.number} of seed {job.seed} with contact {job.contact!r}: {error}") from error


def summarise(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Summarise the outcomes of one contact model.

    Args:
        outcomes: Outcomes of the cases, at least one.

    Returns:
        Numbers of failed cases by kind of failure, quantiles of residual and shaking, and the worst cases.
    """
    finite = [outcome for outcome in outcomes if not outcome.non_finite]
    failed = sum(outcome.failed for outcome in outcomes)
    worst = sorted(outcomes, key=_badness, reverse=True)[:WORST]
    return {
        "cases": len(outcomes),
        "failed": failed,
        "failure_rate": failed / len(outcomes),
        "missed": sum(outcome.missed > 0 for outcome in outcomes),
        "wrong_side": sum(outcome.wrong_side for outcome in outcomes),
        "enclosed": sum(outcome.enclosed > 0 for outcome in outcomes),
        "passages": sum(outcome.passages > 0 for outcome in outcomes),
        "pairs": sum(outcome.pairs > 0 for outcome in outcomes),
        "pair_steps": sum(outcome.pairs for outcome in outcomes),
        "residual_too_large": sum(outcome.residual > ALLOWED for outcome in finite),
        "non_finite": len(outcomes) - len(finite),
        "turned": sum(outcome.turned > 0 for outcome in outcomes),
        "trailing": sum(outcome.trailing > 0 for outcome in outcomes),
        "steps": sum(outcome.steps for outcome in outcomes),
        "residual": _quantiles([outcome.residual for outcome in finite]),
        "final_residual": _quantiles([outcome.final_residual for outcome in finite]),
        "shaking": _quantiles([outcome.shaking for outcome in finite]),
        "failed_cases": sorted(outcome.plunge.number for outcome in outcomes if outcome.failed),
        "worst": [outcome.as_dict() for outcome in worst],
    }


def _badness(outcome: Outcome) -> tuple[bool, bool, bool, float, int]:
    """Sort key of cases by severity: failure, divergence, missed contact or enclosure, depth, then other faults."""
    return (
        outcome.failed,
        outcome.non_finite,
        outcome.missed > 0 or outcome.enclosed > 0,
        outcome.residual,
        outcome.passages + outcome.pairs,
    )


def _quantiles(values: Sequence[float]) -> dict[str, float | None]:
    """Median, 95th percentile and maximum of some values; None if there are no values."""
    if not values:
        return {"p50": None, "p95": None, "max": None}
    p50, p95, greatest = np.percentile(values, (50, 95, 100)).tolist()
    return {"p50": p50, "p95": p95, "max": greatest}


def describe(contact: str, summary: dict[str, Any]) -> str:
    """A summary in words and columns."""
    lines = [
        f"{contact}: {summary['failed']} of {summary['cases']} plunges failed ({100 * summary['failure_rate']:.1f} %)",
        f"  missed {summary['missed']}, enclosed {summary['enclosed']}, passages {summary['passages']},"
        f" pairs {summary['pairs']}, residual above {ALLOWED} u {summary['residual_too_large']},"
        f" non-finite {summary['non_finite']}",
        f"  no failures by themselves: organ turned inside out {summary['turned']}, flags on a face that looks back"
        f" {summary['trailing']}",
    ]
    for key, name, unit in (
        ("residual", "greatest residual of a case", "u"),
        ("final_residual", "residual at its end", "u"),
        ("shaking", "shaking at its end", "u/s"),
    ):
        values = summary[key]
        if values["max"] is not None:
            lines.append(
                f"  {name}: {values['p50']:.4f} (median) {values['p95']:.4f} (95 %) {values['max']:.4f} {unit}"
            )
    if summary["worst"]:
        lines.append(
            "  worst:  case  entry      speed thickness steps/s depth | residual  at end missed enclosed passages pairs"
        )
    for case in summary["worst"]:
        plunge = case["plunge"]
        entry = "".join("0+-"[sign] for sign in plunge["entry"])
        lines.append(
            f"         {plunge['number']:5d}  {entry:5} {plunge['speed']:10.4g} {plunge['thickness']:9.3f}"
            f" {1.0 / plunge['dt']:7.0f} {plunge['depth']:5.2f} |"
            + (
                " diverged"
                if case["non_finite"]
                else f" {case['residual']:8.4f} {case['final_residual']:7.4f} {case['missed']:6d} {case['enclosed']:8d}"
                f" {case['passages']:8d} {case['pairs']:5d}"
            )
        )
    return "\n".join(lines)


def show_case(job: Job) -> Outcome:
    """Run one case and print every step of it."""
    plunge = plunges.draw(job.seed, job.number)
    for key, value in plunge.as_dict().items():
        print(f"{key:12} {value}")
    print(f"{plunge.moving_steps} steps of moving, {plunge.held_steps} of holding; flags are counted by face")
    print(
        " step     node   corner     edge  surface centre columns passages turned pairs queries    force  fastest flags"
    )
    watch = partial(_print_step, moving_steps=plunge.moving_steps)
    outcome = plunges.run(plunge, job.contact, watch, job.engine)
    for key, value in outcome.as_dict().items():
        if key != "plunge":
            print(f"{key:15} {value}")
    return outcome


def _print_step(step: int, simulation: Simulation, report: Report, seen: Inspection, *, moving_steps: int) -> None:
    tool, flags = simulation.scene.tools[0].tool, report.contacts.flags
    by_face = np.bincount(tool.face, weights=flags, minlength=len(tool.face_normals)).astype(int).tolist()
    fastest = np.linalg.norm(simulation.node_velocities, axis=1).max()
    print(
        f"{step:5d} {seen.node_depth:8.5f} {seen.corner_depth:8.5f} {seen.edge_depth:8.5f} {seen.surface_depth:8.5f}"
        f" {seen.centre_inside:6d} {seen.enclosed:7d} {seen.passages:8d} {seen.turned:6d}"
        f" {(flags & flags[tool.opposite]).sum() // 2:5d} {report.queries:7d} {np.linalg.norm(report.force):8.1f}"
        f" {fastest:8.1f} {by_face}" + ("  held" if step >= moving_steps else "")
    )


def plan(
    seed: int,
    numbers: Sequence[int],
    subset: int,
    contacts: Sequence[ContactName] = get_args(ContactName),
    engine: str | None = None,
) -> list[Job]:
    """Plan which cases to run with which contact model.

    Args:
        seed: Seed of the benchmark.
        numbers: Numbers of the cases.
        subset: Number of cases, the first ones, that all contact models run; only the flags method runs the rest.
        contacts: The contact models.
        engine: Engine that integrates the organ; None for the default.

    Returns:
        The jobs, case by case, so that an interrupted run has results of each contact model.
    """
    return [
        Job(seed, number, contact, engine)
        for index, number in enumerate(numbers)
        for contact in contacts
        if contact == "flags" or index < subset
    ]


def measure(jobs: Sequence[Job], workers: int, outcomes: dict[str, list[Outcome]]) -> None:
    """Run cases and collect their outcomes, which are kept even if the run is interrupted.

    Args:
        jobs: The cases to run.
        workers: Number of processes.
        outcomes: By contact model; each outcome is appended as soon as it is known.
    """
    with closing(results(run_job, jobs, workers, "plunges")) as stream:
        for job, outcome in stream:
            outcomes.setdefault(job.contact, []).append(outcome)


def main() -> None:
    """Measure and print."""
    options = parser(__doc__ or "")
    options.add_argument("--cases", type=int, default=2000, help="how many plunges the flags method makes")
    options.add_argument("--first", type=int, default=0, help="number of the first")
    options.add_argument("--subset", type=int, default=200, help="how many of them the other contact models make")
    options.add_argument("--seed", type=int, default=SEED, help="other seeds give other cases")
    options.add_argument("--workers", type=int, default=available_cores(), help="processes")
    options.add_argument("--engine", choices=tuple(ENGINES), help=f"what integrates the organ (default: {DEFAULT})")
    options.add_argument("--picture", type=output_file, help="draw failures over speed and thickness into this file")
    options.add_argument("--case", type=int, help="run only the case of this number, and print every step")
    options.add_argument("--contact", choices=get_args(ContactName), default="flags", help="contact model of --case")
    arguments = options.parse_args()
    for name in ("cases", "workers"):
        if getattr(arguments, name) < 1:
            options.error(f"--{name} must be at least 1, got {getattr(arguments, name)}")
    for name in ("first", "subset", "seed"):
        if getattr(arguments, name) < 0:
            options.error(f"--{name} must not be negative, got {getattr(arguments, name)}")
    if arguments.case is not None:
        outcome = show_case(Job(arguments.seed, arguments.case, arguments.contact, arguments.engine))
        finish({"benchmark": "tunnelling", **outcome.as_dict()})
        return
    if arguments.picture is not None:
        from benchmarks import pictures

        pictures.require_matplotlib()
    _run_all(arguments)


def _run_all(arguments: argparse.Namespace) -> None:
    """Run the cases of all contact models and print the results, also after an interruption."""
    numbers = range(arguments.first, arguments.first + arguments.cases)
    outcomes: dict[str, list[Outcome]] = {}
    stopped: str | None = None
    had = load_engine(choose_engine(arguments.engine)).abilities.contacts
    contacts: list[ContactName] = [each for each in had if arguments.subset or each == "flags"]
    start = time.perf_counter()
    # SIGTERM, as from `timeout`, ends the run like Ctrl-C: the results so far are printed.
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        measure(
            plan(arguments.seed, numbers, arguments.subset, contacts, arguments.engine), arguments.workers, outcomes
        )
    except KeyboardInterrupt:
        stopped = "interrupted"
    except (WorkerDied, RuntimeError) as error:
        stopped = str(error)
    finally:
        signal.signal(signal.SIGTERM, before)
    seconds = time.perf_counter() - start
    summaries = {contact: summarise(outcomes[contact]) for contact in get_args(ContactName) if contact in outcomes}
    if not arguments.json:
        for contact, summary in summaries.items():
            print(describe(contact, summary))
        print(f"{seconds:.0f} s with {arguments.workers} processes")
    if stopped is not None:
        print(f"not all cases were run: {stopped}", file=sys.stderr)
    if arguments.picture is not None and summaries:
        from benchmarks import pictures

        pictures.draw_failures(outcomes, arguments.picture)
    finish(
        {
            "benchmark": "tunnelling",
            "engine": choose_engine(arguments.engine),
            "seed": arguments.seed,
            "first": arguments.first,
            "complete": stopped is None,
            "passed": stopped is None and not any(outcome.failed for outcome in outcomes["flags"]),
            "allowed_residual": ALLOWED,
            "seconds": seconds,
            "contact": summaries,
        }
    )


def _interrupt(signal_number: int, frame: object) -> NoReturn:
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
