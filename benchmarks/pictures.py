"""Pictures of the benchmarks' results, drawn with Matplotlib, which the benchmarks need for nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.inspection import ALLOWED
from benchmarks.plunges import SPEEDS, THICKNESSES
from spatula_env import scenes
from spatula_env.installing import install_hint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from benchmarks.curves import Curve
    from benchmarks.plunges import Outcome

CONTACTS = {"bullet": "Bullet's own contact", "second_step": "second step alone", "flags": "flags method"}
"""Contact models in the order of their panels, from left to right, and the panels' titles."""

CELLS = (7, 5)
"""Number of cells along speed and thickness."""

RESIDUALS = (1e-4, 2.0)
"""Ends of the colour scale of residuals [u]."""

COLOURS = "cividis"
"""A colour map that looks nearly the same with and without colour vision deficiency, and is ordered by lightness."""

LINES = (
    ("#0072b2", "o", "-"),
    ("#d55e00", "s", "--"),
    ("#009e73", "^", ":"),
    ("#cc79a7", "D", "-."),
    ("#000000", "x", "-"),
)
"""Colour, marker and dash of each curve: M. Okabe and K. Ito's colours, for all kinds of colour vision."""


def require_matplotlib() -> None:
    """Raise an ImportError that says what to install if Matplotlib is not installed."""
    try:
        import_module("matplotlib")
    except ImportError as error:
        raise ImportError(f"pictures need Matplotlib; install it with: {install_hint('viz')}") from error


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of a size in inches, which opens no window."""
    require_matplotlib()
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=150, layout="constrained")


def draw_failures(outcomes: Mapping[str, Sequence[Outcome]], path: Path) -> None:
    """Draw how many plunges failed, and how deep the worst was, over speed and thickness.

    Args:
        outcomes: Outcomes of the plunges, by contact model.
        path: File to write; its suffix determines the format.

    Raises:
        ImportError: If Matplotlib is not installed.
    """
    figure = new_figure(12.5, 7.0)
    from matplotlib.colors import LogNorm, Normalize

    axes = figure.subplots(2, len(CONTACTS), sharex=True, sharey=True)
    speeds, thicknesses = (
        np.geomspace(*limits, cells + 1) for limits, cells in zip((SPEEDS, THICKNESSES), CELLS, strict=True)
    )
    scales = (Normalize(0.0, 1.0), LogNorm(*RESIDUALS))
    images: list[Any] = [None, None]
    for column, (contact, title) in enumerate(CONTACTS.items()):
        done = outcomes.get(contact, ())
        cells = _sort_into_cells(done, speeds, thicknesses)
        for row, (scale, count) in enumerate(zip(scales, (_count_failed, _find_deepest), strict=True)):
            panel = axes[row, column]
            values, texts = np.full(CELLS[::-1], np.nan), {}
            for place, members in cells.items():
                values[place], texts[place] = count(members)
            images[row] = panel.pcolormesh(
                speeds, thicknesses, values, cmap=COLOURS, norm=scale, edgecolors="white", linewidth=0.7
            )
            _write_into_cells(panel, texts, values, scale, speeds, thicknesses)
            _set_up_panel(panel, first=column == 0, last=column == len(CONTACTS) - 1, top=row == 0, bottom=row == 1)
        failed = sum(outcome.failed for outcome in done)
        rate = f"{failed} of {len(done)} plunges failed" if done else "not run"
        axes[0, column].set_title(
            f"{title}\n{rate}", fontsize=11, fontweight="bold" if contact == "flags" else "normal"
        )
    share_bar = figure.colorbar(images[0], ax=axes[0, :].tolist(), pad=0.01)
    share_bar.set_label("share of plunges that failed")
    share_bar.ax.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
    worst_bar = figure.colorbar(images[1], ax=axes[1, :].tolist(), pad=0.01, extend="max")
    worst_bar.set_label(f"greatest residual [u], 1 u = {1e3 * scenes.seed().scale.length:g} mm")
    worst_bar.ax.axhline(ALLOWED, color="white", linewidth=2.0)
    worst_bar.ax.text(-0.25, ALLOWED, "allowed", ha="right", va="center", fontsize=7, rotation=90)
    figure.suptitle("Random plunges of a thin spatula into a soft organ: failed of all (above), greatest depth (below)")
    figure.savefig(path)


def _sort_into_cells(
    outcomes: Sequence[Outcome], speeds: np.ndarray, thicknesses: np.ndarray
) -> dict[tuple[int, int], list[Outcome]]:
    """Outcomes by the indices of thickness and speed of the cell they belong to."""
    cells: dict[tuple[int, int], list[Outcome]] = {}
    for outcome in outcomes:
        row = int(np.clip(np.searchsorted(thicknesses, outcome.plunge.thickness) - 1, 0, CELLS[1] - 1))
        column = int(np.clip(np.searchsorted(speeds, outcome.plunge.speed) - 1, 0, CELLS[0] - 1))
        cells.setdefault((row, column), []).append(outcome)
    return cells


def _count_failed(members: Sequence[Outcome]) -> tuple[float, str]:
    """Share of a cell's plunges that failed, and the text to write into the cell."""
    failed = sum(member.failed for member in members)
    return failed / len(members), f"{failed}/{len(members)}"


def _find_deepest(members: Sequence[Outcome]) -> tuple[float, str]:
    """Greatest residual of a cell, clipped to the colour scale, and the text to write into the cell."""
    deepest = max(math.inf if member.non_finite else member.residual for member in members)
    colour = min(max(deepest, RESIDUALS[0]), RESIDUALS[1])
    if math.isinf(deepest):
        return colour, "inf"
    if deepest < 0.0005:
        return colour, "0"
    return colour, f"{deepest:.3f}".lstrip("0") if deepest < 1.0 else f"{deepest:.1f}"


def _write_into_cells(
    panel: Axes,
    texts: Mapping[tuple[int, int], str],
    values: np.ndarray,
    scale: Any,
    speeds: np.ndarray,
    thicknesses: np.ndarray,
) -> None:
    """Write a text into the middle of each cell, light on dark cells and dark on light ones."""
    for (row, column), text in texts.items():
        panel.text(
            math.sqrt(speeds[column] * speeds[column + 1]),
            math.sqrt(thicknesses[row] * thicknesses[row + 1]),
            text,
            ha="center",
            va="center",
            fontsize=7,
            color="black" if scale(values[row, column]) > 0.55 else "white",
        )


def _set_up_panel(panel: Axes, *, first: bool, last: bool, top: bool, bottom: bool) -> None:
    """Set up logarithmic axes in scene units, with scales in millimetres on the opposite sides."""
    millimetres = 1e3 * scenes.seed().scale.length
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_facecolor("0.9")

    def plain(value: float, _: float) -> str:
        return f"{value:g}"

    panel.set_yticks([0.02, 0.05, 0.1, 0.2, 0.5])
    panel.yaxis.set_major_formatter(plain)
    panel.yaxis.set_minor_formatter(lambda value, _: "")
    panel.xaxis.set_major_formatter(plain)
    if bottom:
        panel.set_xlabel("speed [u/s]")
    if first:
        panel.set_ylabel("thickness [u]")
    if top:
        above = _add_scale(panel.secondary_xaxis, "top", millimetres, "speed [mm/s]")
        above.xaxis.set_major_formatter(plain)
    if last:
        right = _add_scale(panel.secondary_yaxis, "right", millimetres, "thickness [mm]")
        right.set_yticks([0.5, 1.0, 2.0, 5.0, 10.0])
        right.yaxis.set_major_formatter(plain)
        right.yaxis.set_minor_formatter(lambda value, _: "")


def draw_curves(curves: Mapping[str, Curve], mean: Curve, path: Path) -> None:
    """Draw force against depth, and how far the curves are from the first one.

    Args:
        curves: Curves by name; the first is the reference that the others are compared with.
        mean: Mean curve over several orientations of the organ.
        path: File to write; its suffix determines the format.

    Raises:
        ImportError: If Matplotlib is not installed.
    """
    figure = new_figure(7.0, 6.5)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.4, 1.0))
    scale = scenes.seed().scale
    name, reference = next(iter(curves.items()))
    upper.plot(mean.depths, mean.forces, color="0.65", linewidth=1.5, linestyle="--", label="organ turned: mean")
    upper.plot(reference.depths, reference.forces, color="0.8", linewidth=5.0, label=name)
    others = list(curves.items())[1:]
    for (name, curve), (colour, marker, dash) in zip(others, LINES, strict=False):
        style: dict[str, Any] = {"color": colour, "marker": marker, "linestyle": dash, "markerfacecolor": "none"}
        upper.plot(curve.depths, curve.forces, label=name, **style)
        lower.plot(curve.depths, 100.0 * (curve.forces / reference.forces - 1.0), **style)
    lower.axhspan(-5.0, 5.0, color="0.95", zorder=0)
    lower.axhline(0.0, color="0.8", linewidth=5.0, zorder=1)
    lower.set_xlabel("depth [u]")
    lower.set_ylabel("difference from\nthe reference [%]")
    upper.set_ylabel("force on the tool [kg u/s²]")
    upper.set_ylim(bottom=0.0)
    upper.legend(frameon=False)
    upper.set_title("Force of a slow press; stiffness and weight kept where the time step changes", fontsize=10)
    _add_scale(upper.secondary_xaxis, "top", 1e3 * scale.length, "depth [mm]")
    _add_scale(upper.secondary_yaxis, "right", scale.force, "force on the tool [N]")
    for panel in (upper, lower):
        panel.grid(color="0.92")
        panel.set_axisbelow(True)
    figure.savefig(path)


def _add_scale(add: Callable[..., Any], side: str, factor: float, label: str) -> Any:
    """Add a scale in another unit, on the opposite side of a panel; `add` is the panel's method for that axis."""

    def there(value: Any) -> Any:
        return np.asarray(value) * factor

    def back(value: Any) -> Any:
        return np.asarray(value) / factor

    axis = add(side, functions=(there, back))
    (axis.set_xlabel if side == "top" else axis.set_ylabel)(label)
    return axis
