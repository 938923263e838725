"""Plots of a dataset's statistics, with Matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env.data.statistics import Curve, DatasetStatistics
from spatula_env.files import check_can_write
from spatula_env.installing import install_hint
from spatula_env.pressure_limits import COST_PRESSURE, VIOLATION_PRESSURE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK = "#2b2d33"
FAINT = "#7c808a"
RULE = "#e4e5e8"
SUCCESS = "#2f7f86"
FAILURE = "#d0782f"
COURSE = "#9a3f4d"
LIMITS = ((1e-3 * COST_PRESSURE, "dose"), (1e-3 * VIOLATION_PRESSURE, "violation"))
"""Pressures from which dose and violations are counted [kPa]; see `SpatulaEnv`."""
BINS = 16
"""Greatest number of bins of a histogram."""
CELLS = 40
"""Number of cells along each edge of the workspace in a map."""
NOTHING = "not recorded"


def check_plot(path: Path) -> None:
    """Check that a plot can be written to a file, before it is computed.

    Args:
        path: Path of the file; it must end with .png, .svg or .pdf.

    Raises:
        ImportError: If Matplotlib is missing.
        OSError: If nothing can be written there.
        ValueError: If the ending is unknown.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise ImportError(f"plots need Matplotlib: {install_hint('viz')}", name=error.name) from error
    if path.suffix not in (".png", ".svg", ".pdf"):
        raise ValueError(f"path must end with .png, .svg or .pdf, got {path}")
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder")
    check_can_write(path.parent)


def plot_statistics(found: DatasetStatistics, path: str | Path) -> None:
    """Draw the statistics of a dataset on one page.

    Args:
        found: Result of `statistics`.
        path: Path of the file; its ending, .png, .svg or .pdf, gives the format.

    Raises:
        ImportError: If Matplotlib is missing.
        OSError: If nothing can be written there.
        ValueError: If the dataset is empty, or the ending is unknown.
    """
    file = Path(path)
    check_plot(file)
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    if not len(found.returns):
        raise ValueError(f"dataset {found.summary.dataset_id!r} has no episodes, there is nothing to draw")
    with rc_context(
        {
            "font.size": 9,
            "axes.edgecolor": FAINT,
            "axes.labelcolor": INK,
            "axes.titlesize": 10,
            "axes.titlelocation": "left",
            "axes.spines.top": False,
            "axes.spines.right": False,
            "text.color": INK,
            "xtick.color": FAINT,
            "ytick.color": FAINT,
            "legend.frameon": False,
        }
    ):
        figure = Figure(figsize=(15, 7), dpi=110)
        figure.set_layout_engine("constrained", w_pad=0.12, h_pad=0.1)
        axes: Any = figure.subplots(2, 4)
        _tell(axes[0, 0], found)
        _returns(axes[0, 1], found)
        _lengths(axes[0, 2], found)
        _peaks(axes[0, 3], found)
        _course(axes[1, 0], found.force, "Contact force", "force [N]", 1.0)
        _course(axes[1, 1], found.pressure, "Greatest contact pressure", "pressure [kPa]", 1e-3, LIMITS)
        _places(axes[1, 2], found, 1, "from above")
        _places(axes[1, 3], found, 2, "from the front")
        file.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(file)


def _tell(axes: Axes, found: DatasetStatistics) -> None:
    """Write the summary as text, and draw the success rate as a bar with its interval."""
    axes.axis("off")
    axes.set(xlim=(0, 1), ylim=(0, 1))
    summary, share = found.summary, float(found.successes.mean())
    low, high = found.success_interval
    operators = ", ".join(f"{count} {name}" for name, count in summary.operators.items())
    name = summary.dataset_id
    _write(axes, 1.0, name, va="top", weight="bold", size=11 if len(name) < 30 else 9)
    lines = [
        summary.env_id,
        f"{summary.episodes} episodes ({operators}), {summary.steps} steps",
        f"by {', '.join(summary.devices)}",
    ]
    if found.doses is not None:
        lines.append(f"dose {found.doses.mean():.0f} Pa s in an episode")
    if found.violations is not None:
        lines.append(f"a violation in {found.violations.sum()} of {summary.episodes} episodes")
    if found.coverage is not None:
        lines.append(f"tool in {100 * found.coverage:.1f} % of the workspace")
    _write(axes, 0.88, "\n".join(lines), va="top", linespacing=1.6)
    _write(axes, 0.27, f"success {100 * share:.0f} %  (95 %: {100 * low:.0f} to {100 * high:.0f} %)", weight="bold")
    axes.add_patch(_box(0.0, 1.0, RULE))
    axes.add_patch(_box(0.0, share, SUCCESS))
    axes.plot([low, high], [0.17, 0.17], color=INK, lw=1.5, marker="|", ms=9, clip_on=False)
    for row, (color, label) in enumerate(((SUCCESS, "episodes with success"), (FAILURE, "episodes without"))):
        axes.plot([0.02], [0.06 - 0.07 * row], "s", color=color, ms=7, clip_on=False)
        axes.text(0.05, 0.06 - 0.07 * row, label, va="center", color=FAINT)


def _write(axes: Axes, height: float, text: str, **style: Any) -> None:
    # Long lines may extend into the margin, but must not make the panels beside them smaller.
    axes.text(0.0, height, text, **style).set_in_layout(False)


def _box(left: float, right: float, color: str) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((left, 0.13), right - left, 0.08, color=color, lw=0)


def _returns(axes: Axes, found: DatasetStatistics) -> None:
    _histogram(axes, found, found.returns, "return")


def _lengths(axes: Axes, found: DatasetStatistics) -> None:
    if found.durations is not None:
        _histogram(axes, found, found.durations, "length [s]")
    else:
        _histogram(axes, found, found.lengths.astype(np.float64), "length [steps]")


def _histogram(axes: Axes, found: DatasetStatistics, values: Any, label: str) -> None:
    from matplotlib.ticker import MaxNLocator

    low, high = float(values.min()), float(values.max())
    if high - low < 1e-9 * max(1.0, abs(high)):
        # All values are equal, as with episodes truncated at their limit: draw a narrow bar, not one of full width.
        margin = max(0.5, 0.05 * abs(high))
        low, high = low - margin, high + margin
    groups = [values[found.successes], values[~found.successes]]
    bins = np.linspace(low, high, min(BINS, max(6, 2 * int(np.sqrt(len(values))))) + 1)
    axes.hist(groups, bins=bins.tolist(), stacked=True, color=[SUCCESS, FAILURE], rwidth=0.92)
    axes.axvline(float(np.median(values)), color=INK, lw=1, ls="--")
    name, _, unit = label.partition(" [")
    axes.set_title(f"{name.capitalize()}, median {np.median(values):.3g} {unit.removesuffix(']')}".rstrip())
    axes.set(xlabel=label, ylabel="episodes")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))


def _peaks(axes: Axes, found: DatasetStatistics) -> None:
    axes.set_title("Greatest force and pressure")
    if found.peak_forces is None or found.peak_pressures is None:
        _nothing(axes)
        return
    for chosen, color in ((found.successes, SUCCESS), (~found.successes, FAILURE)):
        axes.scatter(found.peak_forces[chosen], 1e-3 * found.peak_pressures[chosen], s=22, color=color, alpha=0.7, lw=0)
    axes.set(xlabel="force [N]", ylabel="pressure [kPa]")
    axes.set_xlim(0.0, 1.08 * max(float(found.peak_forces.max()), 1e-3))
    axes.set_ylim(0.0, 1.08 * max(1e-3 * float(found.peak_pressures.max()), LIMITS[-1][0]))
    _limits(axes, LIMITS)


def _course(
    axes: Axes, curve: Curve | None, title: str, label: str, factor: float, limits: tuple[tuple[float, str], ...] = ()
) -> None:
    axes.set_title(f"{title} over time", pad=18)
    if curve is None:
        _nothing(axes)
        return
    highest = factor * float(curve.greatest.max())
    axes.plot(curve.times, factor * curve.greatest, color=FAINT, lw=0.8, ls=":", label=f"greatest, up to {highest:.3g}")
    axes.fill_between(
        curve.times, factor * curve.low, factor * curve.high, color=COURSE, alpha=0.25, lw=0, label="middle half"
    )
    axes.plot(curve.times, factor * curve.median, color=COURSE, lw=1.6, label="median")
    axes.set(xlabel="time [s]", ylabel=label)
    axes.set_xlim(0.0, max(float(curve.times[-1]), 1e-3))
    # A single spike must not flatten everything else.
    usual = 2.5 * factor * float(curve.high.max())
    axes.set_ylim(0.0, 1.1 * max([min(highest, usual), 1e-3, *(value for value, _ in limits)]))
    few = curve.episodes < 0.5 * curve.episodes[0]
    if few.any():
        since = float(curve.times[few.argmax()])
        axes.axvspan(since, float(curve.times[-1]), color=INK, alpha=0.05, lw=0)
        axes.text(
            since,
            0.02,
            " fewer than half of the episodes",
            transform=axes.get_xaxis_transform(),
            size=7,
            color=FAINT,
            rotation=90,
            va="bottom",
        )
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=3,
        fontsize=7,
        handlelength=1.2,
        columnspacing=1.0,
        borderpad=0.0,
        borderaxespad=0.3,
    )
    _limits(axes, limits)


def _limits(axes: Axes, limits: tuple[tuple[float, str], ...]) -> None:
    """Draw horizontal lines, the lower labelled below and the upper above, as they may be close together."""
    for number, (value, label) in enumerate(limits):
        below = number == 0
        axes.axhline(value, color=INK, lw=0.7, ls="--")
        axes.annotate(
            label,
            (1.0, value),
            xycoords=("axes fraction", "data"),
            xytext=(-2, -2 if below else 2),
            textcoords="offset points",
            ha="right",
            va="top" if below else "bottom",
            size=7,
            color=FAINT,
        )


def _places(axes: Axes, found: DatasetStatistics, axis: int, label: str) -> None:
    """Draw a map of how long the tool was at each place, seen along an axis."""
    axes.set_title(f"Where the tool was, {label}")
    if found.positions is None or found.workspace is None:
        _nothing(axes)
        return
    low, high = 1e3 * found.workspace
    positions = 1e3 * found.positions
    bins = [np.linspace(low[side], high[side], CELLS + 1).tolist() for side in (0, axis)]
    counts, _, _ = np.histogram2d(positions[:, 0], positions[:, axis], bins=bins)
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap, LogNorm
    from matplotlib.ticker import FormatStrFormatter

    # The colour map without its lightest colours, which look like an empty cell.
    colors = ListedColormap(colormaps["YlGnBu"](np.linspace(0.25, 1.0, 128)))
    picture = axes.pcolormesh(
        bins[0], bins[1], np.ma.masked_equal(counts.T, 0), cmap=colors, norm=LogNorm(1, max(float(counts.max()), 2.0))
    )
    axes.set_aspect("equal")
    axes.spines[["top", "right"]].set_visible(True)
    axes.set(xlabel="x [mm], right", ylabel="y [mm], away" if axis == 1 else "z [mm], up")
    bar = axes.figure.colorbar(picture, ax=axes, shrink=0.75, pad=0.02)
    bar.set_label("control steps", color=FAINT)
    bar.ax.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    bar.outline.set_visible(False)


def _nothing(axes: Axes) -> None:
    axes.axis("off")
    axes.text(0.5, 0.5, NOTHING, ha="center", va="center", color=FAINT, transform=axes.transAxes)
