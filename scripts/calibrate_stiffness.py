"""How stiff are the organs of the preset scenes? `python scripts/calibrate_stiffness.py`, JSON last.

In every scene the tool moves slowly into the organ, as it is used there, and waits at each depth; the force is averaged
over half a second. The effective Young's modulus is that of a nearly incompressible linear-elastic solid of the same
shape which is as stiff against the same tool. It is computed from the slope of force against depth, in a window where
the tool is in full contact and the strain is small. The constants `STIFFNESS` of the scenes' modules follow from it,
with which `scale="stiffness"` gives organs the modulus of brain tissue. docs/calibration.md explains the method; this
script also draws its figure, which needs Matplotlib.

Each depth is a world of one batch, so every press starts from the organ at rest. As a check, Bullet repeats one place
of each scene. It takes about two minutes.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spatula_env import scenes
from spatula_env.engines import bullet_hint, bullet_is_there
from spatula_env.geometry import FissuredBlock, RidgedBlock
from spatula_env.geometry.transforms import random_quaternion
from spatula_env.installing import install_hint
from spatula_env.sim.worlds import Worlds

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from spatula_env.arrays import FloatArray
    from spatula_env.scenes import Scene


SQUARE_PUNCH = 1.012
"""A square plate on a half-space is this much stiffer than a round one of the same area (R. B. King, International
Journal of Solids and Structures 23(12), 1987)."""

POISSON = 0.5

SPEED = 0.5
"""Greatest speed of the tools [u/s]: 10 mm/s."""

CHUNK = 0.05
"""Interval at which the tools' speed is updated [s]."""

REST = 0.5
"""How long the tools wait at their depth, and then for how long the force is averaged [s]."""

ORIENTATIONS = 6
"""Number of orientations in which the seed's sphere is pressed."""

SOURCES = (1400.0, 9000.0)
"""Least and greatest Young's modulus of brain tissue in the sources [Pa]."""

TABLE_DEPTHS = (2.0, 5.0, 10.0)
"""Depths whose moduli are printed [mm]."""


@dataclass(frozen=True)
class Indentation:
    """One way to press an organ.

    Attributes:
        name: Name of the scene.
        how: Description of the press.
        variants: The scene, and variants of it whose curves are averaged with its own.
        begin: Maps a scene and the organ's nodes at rest (V, 3) to start positions of the tools (p, N, 3) at p places,
            just off the surface; directions of motion (p, N, 3); and distances to the surface (p,) [u].
        factor: Force over modulus and depth of the elastic solid [u].
        window: Least and greatest depth of the fit [mm].
        deepest: Greatest depth of the curve [mm].
    """

    name: str
    how: str
    variants: tuple[Scene, ...]
    begin: Callable[[Scene, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
    factor: float
    window: tuple[float, float]
    deepest: float

    @property
    def depths(self) -> FloatArray:
        """(k,) depths of the curve [mm]."""
        few = np.array([0.5, *range(1, 7), 8, 10, 12, 15, 18], dtype=np.float64)
        many = np.arange(0.5, 4.01, 0.5)
        return many if self.deepest < few[5] else few[few <= self.deepest]

    def in_window(self, depths: FloatArray) -> NDArray[np.bool_]:
        """Which of the given depths [mm] are in the window of the fit."""
        return (depths >= self.window[0] - 1e-9) & (depths <= self.window[1] + 1e-9)


def on_top(scene: Scene, nodes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Start of a plate above the top of an organ; see `Indentation.begin`."""
    tool = scene.tools[0].tool
    gap = 0.02
    under = (np.abs(nodes[:, :2]) <= 0.5 * tool.size[:2]).all(axis=1)
    height = float(nodes[under, 2].max()) + 0.5 * float(tool.size[2]) + gap
    return np.array([[[0.0, 0.0, height]]]), np.array([[[0.0, 0.0, -1.0]]]), np.array([gap])


def at_walls(scene: Scene, nodes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Starts of a blade in a fissure, 0.25 u above the floor, at three places of each wall; see `Indentation.begin`."""
    block, tool = scene.organs[0].organ, scene.tools[0].tool
    assert isinstance(block, FissuredBlock)
    height = block.floor_height + 0.25 + 0.5 * float(tool.size[1])
    starts, directions, gaps = [], [], []
    for side, wall in zip((-1.0, 1.0), block.walls, strict=True):
        for x in (-0.6, 0.0, 0.6):
            beside = wall[np.abs(nodes[wall, 0] - x) <= 0.5 * tool.size[0]]
            starts.append([[x, 0.0, height]])
            directions.append([[0.0, side, 0.0]])
            gaps.append(float((side * nodes[beside, 1]).min() - 0.5 * tool.size[2]))
    return np.array(starts), np.array(directions), np.array(gaps)


def at_ridge(scene: Scene, nodes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Start of two jaws, one on either side of a ridge; see `Indentation.begin`."""
    starts = np.array([[placed.position for placed in scene.tools]])
    return starts, np.array([[[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]]), np.array([scenes.JAW_CLEARANCE])


def at_fold(scene: Scene, nodes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Starts of a blade on either side of a fold, 0.35 u above its foot; see `Indentation.begin`."""
    block, tool = scene.organs[0].organ, scene.tools[0].tool
    assert isinstance(block, RidgedBlock)
    edge, gap = block.foot_height + 0.35, 0.02
    flanks = nodes[np.concatenate(block.flanks)]
    beside = flanks[(flanks[:, 2] >= edge) & (np.abs(flanks[:, 1]) <= 0.5 * tool.size[0])]
    starts, directions = [], []
    for side in (-1.0, 1.0):
        reach = float((side * beside[:, 0]).max()) + 0.5 * float(tool.size[2]) + gap
        starts.append([[side * reach, 0.0, edge + 0.5 * float(tool.size[1])]])
        directions.append([[-side, 0.0, 0.0]])
    return np.array(starts), np.array(directions), np.full(2, gap)


def force_curves(
    scene: Scene, indentation: Indentation, depths: FloatArray, engine: str = "batch", places: int | None = None
) -> FloatArray:
    """Press an organ slowly, wait, and measure.

    Args:
        scene: Scene whose organ is pressed.
        indentation: How to press it.
        depths: (k,) depths [mm].
        engine: "batch" or "bullet".
        places: Number of places, the first ones; all by default.

    Returns:
        (c, k) force on each tool at each place, against its direction of motion [kg u/s2].
    """
    worlds = Worlds(scene, 1)
    starts, directions, gaps = indentation.begin(scene, worlds.nodes[0])
    starts, directions, gaps = starts[:places], directions[:places], gaps[:places]
    worlds.close()
    ways = (gaps[:, None] + depths * 1e-3 / scene.scale.length).ravel()
    count = len(depths)
    worlds = Worlds(scene, len(ways), engine=engine)
    orientations = np.array([placed.orientation for placed in scene.tools])
    every = np.arange(len(ways))
    worlds.place_tools(np.repeat(starts, count, axis=0), np.tile(orientations, (len(ways), 1, 1)), every)
    forces = _press(worlds, np.repeat(directions, count, axis=0), ways)
    worlds.close()
    by_tool = forces.reshape(len(starts), count, len(scene.tools)).transpose(0, 2, 1)
    return by_tool.reshape(-1, count)


def _press(worlds: Worlds, directions: FloatArray, ways: FloatArray) -> FloatArray:
    """Move all tools by distances (W,) [u], wait, and return the mean forces against their directions, (W, N)."""
    steps, nothing = round(CHUNK / worlds.scene.dt), np.zeros_like(directions)
    duration = steps * worlds.scene.dt
    left = ways.copy()
    while (left > 1e-9).any():
        speeds = np.clip(left / duration, 0.0, SPEED)
        worlds.advance(directions * speeds[:, None, None], nothing, steps)
        left -= speeds * duration
    rest = round(REST / worlds.scene.dt)
    worlds.advance(nothing, nothing, rest)
    loads = worlds.advance(nothing, nothing, rest)
    if loads.diverged.any():
        raise RuntimeError("a world has diverged")
    return -(loads.forces * directions).sum(axis=2)


def square_punch(edge: float) -> float:
    """Force over modulus and depth of a square plate on a half-space [u].

    Args:
        edge: Edge length of the plate [u].
    """
    return SQUARE_PUNCH * 2.0 * edge / math.sqrt(math.pi) / (1.0 - POISSON**2)


def indentations() -> tuple[Indentation, ...]:
    """All indentations. The numerical factors are from scripts/elastic_solid.py."""
    seed, palpate = scenes.seed(), scenes.palpate()
    generator = np.random.default_rng(0)
    turned, turned_and_held = [seed], [palpate]
    held_below = float(palpate.organs[0].vertices[list(palpate.organs[0].fixed_nodes), 2].max())
    for _ in range(ORIENTATIONS - 1):
        x, y, z, w = random_quaternion(generator).tolist()
        organ = dataclasses.replace(seed.organs[0], orientation=(x, y, z, w))
        turned.append(dataclasses.replace(seed, organs=(organ,)))
        held = tuple(np.flatnonzero(organ.vertices[:, 2] <= held_below).tolist())
        organ = dataclasses.replace(organ, fixed_nodes=held)
        turned_and_held.append(dataclasses.replace(palpate, organs=(organ,)))
    punch = square_punch(1.0)
    return (
        Indentation("seed", "plate on top of the sphere", tuple(turned), on_top, punch, (2.0, 6.0), 18.0),
        Indentation("palpate", "plate on the held sphere", tuple(turned_and_held), on_top, punch, (2.0, 6.0), 18.0),
        Indentation("retract", "blade against the fold", (scenes.retract(),), at_fold, 0.44, (2.0, 6.0), 12.0),
        Indentation("fissure", "blade against a wall", (scenes.fissure(),), at_walls, 1.25, (2.0, 6.0), 15.0),
        Indentation("clamp", "two jaws on the ridge", (scenes.clamp(),), at_ridge, 3.55, (1.0, 3.0), 4.0),
    )


@dataclass(frozen=True)
class Calibration:
    """Results for a scene, in SI units by the scene's scale.

    Attributes:
        indentation: How the organ was pressed.
        depths: (k,) depths [mm].
        forces: (c, k) forces of all curves [N].
    """

    indentation: Indentation
    depths: FloatArray
    forces: FloatArray

    @property
    def length(self) -> float:
        """Force over modulus and depth of the elastic solid [m]."""
        return self.indentation.factor * self.indentation.variants[0].scale.length

    def fit(self, forces: FloatArray) -> tuple[float, float]:
        """Fit a line to a curve (k,) in the window: slope [N/m], and depth at which the line has no force [mm]."""
        chosen = self.indentation.in_window(self.depths)
        slope, offset = np.polyfit(self.depths[chosen] * 1e-3, forces[chosen], 1)
        return float(slope), float(-offset / slope * 1e3)

    @property
    def modulus(self) -> float:
        """Modulus of the mean curve, from its slope in the window [Pa]."""
        return self.fit(self.forces.mean(axis=0))[0] / self.length

    @property
    def moduli(self) -> FloatArray:
        """(c,) modulus of each curve, from its slope in the window [Pa]."""
        return np.array([self.fit(curve)[0] for curve in self.forces]) / self.length

    @property
    def secant_moduli(self) -> FloatArray:
        """(k,) secant modulus of the mean curve, force over depth, at each depth [Pa]."""
        secant: FloatArray = self.forces.mean(axis=0) / (self.depths * 1e-3) / self.length
        return secant

    @property
    def stiffness(self) -> float:
        """The constant `STIFFNESS` of the scene's module [u]."""
        scene = self.indentation.variants[0]
        organ = scene.organs[0]
        return self.modulus / scene.scale.pressure * scene.dt**2 * organ.organ.area / organ.mass

    @property
    def density(self) -> float:
        """Density of the organ [kg/m3]."""
        scene = self.indentation.variants[0]
        organ = scene.organs[0]
        return organ.mass * scene.scale.mass / (organ.organ.volume * scene.scale.length**3)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        scale = self.indentation.variants[0].scale
        return {
            "how": self.indentation.how,
            "factor_u": self.indentation.factor,
            "window_mm": self.indentation.window,
            "modulus_pa": self.modulus,
            "moduli_pa": [float(self.moduli.min()), float(self.moduli.max())],
            "slope_newtons_per_metre": self.modulus * self.length,
            "stiffness_constant": self.stiffness,
            "mass_scale": scale.mass,
            "density": self.density,
            "depths_mm": self.depths.tolist(),
            "forces_newtons": self.forces.mean(axis=0).tolist(),
            "least_forces_newtons": self.forces.min(axis=0).tolist(),
            "greatest_forces_newtons": self.forces.max(axis=0).tolist(),
            "secant_moduli_pa": dict(zip(self.depths.tolist(), self.secant_moduli.tolist(), strict=True)),
        }


def calibrate(indentation: Indentation, depths: FloatArray | None = None) -> Calibration:
    """Measure a scene in the batch engine.

    Args:
        indentation: How to press the organ.
        depths: (k,) depths [mm]; those of the indentation by default.
    """
    depths = indentation.depths if depths is None else depths
    force = indentation.variants[0].scale.force
    curves = [force_curves(scene, indentation, depths) for scene in indentation.variants]
    return Calibration(indentation, depths, force * np.concatenate(curves))


def check_with_bullet(indentation: Indentation) -> dict[str, float]:
    """The modulus in both engines, from one place of a scene and the depths in the window [Pa]."""
    depths = indentation.depths[indentation.in_window(indentation.depths)]
    scene = indentation.variants[0]
    found = {}
    for engine in ("batch", "bullet"):
        forces = force_curves(scene, indentation, depths, engine, places=1) * scene.scale.force
        found[engine] = Calibration(indentation, depths, forces).modulus
    return found


COLOURS = {"seed": "#0072b2", "palpate": "#56b4e9", "retract": "#009e73", "fissure": "#d55e00", "clamp": "#cc79a7"}
"""M. Okabe and K. Ito's colours, for all kinds of colour vision."""


def draw(calibrations: Sequence[Calibration], path: Path) -> None:
    """Draw the figure of docs/calibration.md.

    Args:
        calibrations: Calibrations of all scenes.
        path: Path of the PNG file.

    Raises:
        ImportError: If Matplotlib or Pillow is not installed.
    """
    try:
        import matplotlib
        from matplotlib.figure import Figure
        from PIL import Image
    except ImportError as error:
        raise ImportError(f"the figure needs Matplotlib and Pillow: {install_hint('viz', 'demo')}") from error
    style = {
        "font.size": 10.5,
        "axes.edgecolor": "0.35",
        "axes.grid": True,
        "grid.color": "0.92",
        "axes.axisbelow": True,
    }
    with matplotlib.rc_context({**style, "legend.frameon": False}):
        figure = Figure(figsize=(10.0, 4.6), dpi=100, layout="constrained")
        left, right = figure.subplots(1, 2)
        _draw_forces(left, calibrations)
        _draw_moduli(right, calibrations)
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=10.0)
        figure.savefig(path, format="png", metadata={"Software": None})
    with Image.open(path) as image:
        few = image.convert("RGB").quantize(128, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    few.save(path, optimize=True)


def _draw_forces(panel: Axes, calibrations: Sequence[Calibration]) -> None:
    for found in calibrations:
        name = found.indentation.name
        mean = found.forces.mean(axis=0)
        slope, start = found.fit(mean)
        stop = 1.6 * found.indentation.window[1]
        panel.plot(found.depths, mean, "o-", color=COLOURS[name], markersize=4.5, linewidth=1.2, label=name)
        if len(found.forces) > 2:
            panel.fill_between(
                found.depths, found.forces.min(axis=0), found.forces.max(axis=0), color=COLOURS[name], alpha=0.15, lw=0
            )
        panel.plot([start, stop], [0.0, slope * (stop - start) * 1e-3], "--", color=COLOURS[name], linewidth=1.4)
    panel.set(xlabel="depth [mm]", ylabel="force on the tool [N]", xlim=(0.0, 18.5), ylim=(0.0, None))
    panel.set_xticks([0, 5, 10, 15])
    panel.set_title("Force, and the elastic solid of the fitted modulus (dashed)", fontsize=11)


def _draw_moduli(panel: Axes, calibrations: Sequence[Calibration]) -> None:
    low, high = (1e-3 * modulus for modulus in SOURCES)
    panel.axhspan(low, high, color="0.9", zorder=0)
    panel.axhline(1e-3 * scenes.TISSUE_MODULUS, color="0.3", linewidth=1.2, linestyle=(0, (1, 1.5)))
    for found in calibrations:
        name = found.indentation.name
        panel.plot(found.depths, 1e-3 * found.secant_moduli, "o-", color=COLOURS[name], markersize=4.5, linewidth=1.2)
    panel.text(18.3, 0.93 * high, "range of the sources", ha="right", va="top", color="0.35")
    panel.text(18.3, 1.03e-3 * scenes.TISSUE_MODULUS, "2.0 kPa", ha="right", va="bottom", color="0.3")
    panel.set_yscale("log")
    ticks = [0.5, 1.0, 2.0, 4.0, 8.0]
    panel.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.set_yticks([], minor=True)
    panel.set(xlabel="depth [mm]", ylabel="effective Young's modulus [kPa]", xlim=(0.0, 18.5), ylim=(0.5, 12.0))
    panel.set_xticks([0, 5, 10, 15])
    panel.set_title("Modulus from force over depth", fontsize=11)


def main() -> None:
    """Measure, draw and print."""
    parser = argparse.ArgumentParser(description="Measure how stiff the preset scenes are, and draw the figure.")
    parser.add_argument("--figure", type=Path, default=Path("docs/images/calibration.png"), help="where to draw it")
    parser.add_argument("--scene", action="append", help="only these scenes; no figure then")
    parser.add_argument("--no-bullet", action="store_true", help="leave the check with PyBullet out")
    given = parser.parse_args()
    chosen = [made for made in indentations() if given.scene is None or made.name in given.scene]
    if not chosen:
        parser.error(f"scene must be one of {[made.name for made in indentations()]}, got {given.scene}")
    calibrations, results = [], {}
    bullet = not given.no_bullet and bullet_is_there()
    if not bullet and not given.no_bullet:
        print(f"PyBullet is not installed: the check with it is left out. {bullet_hint()}", file=sys.stderr)
    for indentation in chosen:
        found = calibrate(indentation)
        calibrations.append(found)
        results[indentation.name] = found.as_dict()
        if bullet:
            results[indentation.name]["engines_pa"] = check_with_bullet(indentation)
        secants = [
            f"{depth:g} mm {1e-3 * modulus:.2f}"
            for depth, modulus in zip(found.depths, found.secant_moduli, strict=True)
            if depth in TABLE_DEPTHS
        ]
        print(
            f"{indentation.name} ({indentation.how}): modulus {1e-3 * found.modulus:.2f} kPa "
            f"({1e-3 * found.moduli.min():.2f} to {1e-3 * found.moduli.max():.2f}), by depth {', '.join(secants)}; "
            f"constant {found.stiffness:.3f}, density {found.density:.0f} kg/m3",
            flush=True,
        )
    if given.scene is None:
        draw(calibrations, given.figure)
    print(json.dumps({"tissue_modulus_pa": scenes.TISSUE_MODULUS, "scenes": results}))


if __name__ == "__main__":
    main()
