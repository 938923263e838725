"""`spatula organ`."""

from __future__ import annotations

import argparse
import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spatula_env.cli.common import CommandError, add_json_option, at_least, new_parser, note, print_json, say
from spatula_env.files import check_can_write, check_free

if TYPE_CHECKING:
    from spatula_env.anatomy import PrepareOptions, Report
    from spatula_env.cli.common import Parsers

FLAGS = {"hold_boxes": "hold-box", "fill": "tetrahedra"}
"""Options that are named otherwise than the arguments of `PrepareOptions`."""

NAMED = (
    re.compile(r"^(units|label|nodes|widest_hole|hold|hold_boxes|hold_nodes|fissure|ridge|fill)( must )"),
    re.compile(r"(?<=; )(widest_hole)( allows )"),
    re.compile(r"(?<=: )(units)(=(?:mm|m)\?)$"),
)
"""Where errors of `prepare_organ` name its arguments."""

PICTURES = (".png", ".svg", ".pdf")

DESCRIPTION = """Make an organ of the surface or the labelled volume of a segmentation.

examples:
  spatula organ prepare liver.stl --units mm -o liver.npz
  spatula organ prepare segmentation.nii.gz --label 3 --up z --hold "z<0.01" -o liver.npz
  spatula organ prepare brain.gii --nodes 1300 --hold "z<0.02" --picture brain.png -o brain.npz"""


def add_parser(commands: Parsers) -> None:
    """Add the command and its subcommand."""
    parser = new_parser(commands, "organ", "make organs of segmentations", DESCRIPTION)
    inner = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    each = new_parser(
        inner,
        "prepare",
        "an organ of a surface or a labelled volume",
        "Mend, decimate, turn and hold a surface (STL, OBJ, PLY, VTK, VTP, GIFTI) or a label of a volume (NIfTI,\n"
        "NRRD), and write it as an organ that load_organ reads.",
    )
    each.add_argument("file", type=Path, metavar="FILE")
    each.add_argument("-o", "--output", type=Path, required=True, metavar="ORGAN.npz", help="the file of the organ")
    each.add_argument("--overwrite", action="store_true", help="replace what is there already; else it is an error")
    each.add_argument("--units", choices=("mm", "m"), help="unit of the file; needed if the file does not say it")
    each.add_argument("--label", type=at_least(1), metavar="N", help="of a volume; needed if it has several")
    each.add_argument(
        "--nodes", type=at_least(50, 20_000), default=650, metavar="N", help="of the surface (default: %(default)s)"
    )
    each.add_argument("--islands", choices=("largest", "keep"), default="largest", help="(default: %(default)s)")
    each.add_argument("--cavities", choices=("fill", "keep"), default="fill", help="(default: %(default)s)")
    each.add_argument(
        "--widest-hole",
        type=float,
        default=0.1,
        metavar="PART",
        help="of the organ's diagonal: wider holes are an error (default: %(default)s)",
    )
    each.add_argument("--up", choices=("x", "y", "z", "-x", "-y", "-z"), default="z", help="write --up=-z for -z")
    each.add_argument(
        "--place", choices=("ground", "center", "keep"), default="ground", help="where it stands (default: %(default)s)"
    )
    each.add_argument("--hold", action="append", default=[], metavar="'z<0.01'", help="half space that is held [m]")
    each.add_argument(
        "--hold-box",
        action="append",
        nargs=6,
        type=float,
        default=[],
        metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="box that is held [m]",
    )
    each.add_argument("--hold-nodes", type=Path, metavar="FILE", help="text with the indices of held nodes")
    for name, what in (("fissure", "floor"), ("ridge", "crest")):
        each.add_argument(
            f"--{name}",
            metavar="'X,Y,Z X,Y,Z'",
            help=f"the two ends of a {name}'s {what}, or more points along it [m], or a text file of them",
        )
    each.add_argument(
        "--tetrahedra", choices=("auto", "yes", "no"), default="auto", help="auto: if Netgen is installed"
    )
    each.add_argument("--picture", type=Path, metavar="FILE", help="before and after, .png, .svg or .pdf")
    add_json_option(each)
    each.set_defaults(run=_prepare)


def _prepare(chosen: argparse.Namespace) -> int:
    from spatula_env.anatomy import prepare_organ
    from spatula_env.anatomy.pictures import before_after
    from spatula_env.files import write_bytes
    from spatula_env.geometry.prepared import PREPARED_SUFFIX, write_prepared

    _check_writable(chosen.output, "--output", (PREPARED_SUFFIX,), chosen.overwrite)
    if chosen.picture is not None:
        _check_writable(chosen.picture, "--picture", PICTURES, chosen.overwrite)
    try:
        organ, report, before = prepare_organ(chosen.file, _options(chosen), note)
    except ValueError as error:
        raise CommandError(_with_flags(str(error))) from error
    picture = None
    if chosen.picture is not None:
        note("drawing")
        picture = before_after(before, organ, chosen.picture.suffix.lower()[1:])
    write_prepared(chosen.output, organ)
    if picture is not None:
        write_bytes(chosen.picture, picture)
    _tell(report, chosen.output)
    if chosen.json:
        print_json(asdict(report))
    return 0


def _with_flags(message: str) -> str:
    """An error about an option of `prepare_organ` in the words of the command line."""
    for pattern in NAMED:
        message = pattern.sub(lambda match: f"--{FLAGS.get(match[1], match[1].replace('_', '-'))}{match[2]}", message)
    return re.sub(r"(--units)=(mm|m)\?$", r"\1 \2?", message)


def _options(chosen: argparse.Namespace) -> PrepareOptions:
    from spatula_env.anatomy import PrepareOptions

    return PrepareOptions(
        units=chosen.units,
        label=chosen.label,
        nodes=chosen.nodes,
        keep_islands=chosen.islands == "keep",
        keep_cavities=chosen.cavities == "keep",
        widest_hole=chosen.widest_hole,
        up=chosen.up,
        place=chosen.place,
        hold=tuple(chosen.hold),
        hold_boxes=tuple(map(tuple, chosen.hold_box)),
        hold_nodes=_read_nodes(chosen.hold_nodes),
        fissure=_read_points(chosen.fissure, "--fissure"),
        ridge=_read_points(chosen.ridge, "--ridge"),
        fill=chosen.tetrahedra,
    )


def _read_nodes(path: Path | None) -> tuple[int, ...]:
    if path is None:
        return ()
    try:
        nodes = tuple(map(int, path.read_text(encoding="utf-8").replace(",", " ").split()))
    except OSError as error:
        raise CommandError(f"--hold-nodes: {path} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise CommandError(f"--hold-nodes must be a file of whole numbers, {path.name} is not: {error}") from None
    if not nodes:
        raise CommandError(f"--hold-nodes must be a file of whole numbers, {path.name} holds none")
    return nodes


def _read_points(text: str | None, option: str) -> tuple[tuple[float, ...], ...]:
    """Points of an option, which has them itself or names a file of them; commas and spaces separate numbers."""
    if text is None:
        return ()
    path = Path(text)
    words = (path.read_text(encoding="utf-8") if path.is_file() else text).replace(",", " ").split()
    try:
        numbers = tuple(map(float, words))
    except ValueError:
        numbers = ()
    if len(numbers) < 6 or len(numbers) % 3:
        raise CommandError(
            f"{option} must be like '0.01,-0.02,0.03 0.01,0.02,0.03', two points or more in metres, or a text file of "
            f"them, got {text!r}"
        )
    return tuple(numbers[first : first + 3] for first in range(0, len(numbers), 3))


def _check_writable(path: Path, option: str, endings: tuple[str, ...], overwrite: bool) -> None:
    """Check before any work that a file can be written without losing an existing one.

    Raises:
        CommandError: If it cannot.
    """
    if path.suffix.lower() not in endings:
        raise CommandError(f"{option} must end in {' or '.join(endings)}, got {path.name}")
    try:
        check_free(path, overwrite)
        check_can_write(path.parent)
    except OSError as error:
        raise CommandError(f"{option}: {error}") from error


def _change(result: dict[str, Any]) -> str:
    """How much the volume has changed, in words."""
    change = result["volume_change"]
    return "" if change is None else f", {change:+.1%} of the segmentation's"


def _tell(report: Report, output: Path) -> None:
    """Print what was done, and what came out."""
    say(f"{report.source}, read in {report.units}: {report.read[0]} vertices, {report.read[1]} triangles")
    for change in report.changes:
        say(f"  {change}")
    for step in report.steps:
        closed = "closed" if step.closed else "open"
        say(
            f"  {step.name}: {step.nodes} nodes, {closed}, {step.crossings} crossings, "
            f"angles from {step.least_angle:g} degrees (5% below {step.low_angle:g}), {step.volume:.4g} cm3"
        )
    result = report.result
    say(f"{output}: {result['nodes']} nodes, {result['triangles']} triangles, {result['tetrahedra']} tetrahedra")
    size = " x ".join(f"{value:.4g}" for value in result["size_mm"])
    say(f"  {size} mm, {result['volume_cm3']:.4g} cm3{_change(result)}, up to {result['distance_mm']:.3g} mm from it")
    say("  edges {:.3g} / {:.3g} / {:.3g} mm (least, median, greatest)".format(*result["edges_mm"]))
    say("  angles {:.3g} / {:.3g} / {:.3g} degrees (least, 5%, greatest)".format(*result["angles_deg"]))
    say(f"  {result['held']} nodes held")
    for name, line in result["lines"].items():
        say(f"  {name}: {line['nodes']} nodes, {line['length_mm']:.4g} mm long")
    for warning in report.warnings:
        note(f"warning: {warning}")
