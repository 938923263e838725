"""Pictures of presses: the organ cut open in front of the spatula, the contact nodes coloured, and a caption."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spatula_env import scenes
from spatula_env.demo.press import PressResult, Snapshot
from spatula_env.geometry.transforms import rotate
from spatula_env.render import palette
from spatula_env.render.camera import Camera
from spatula_env.render.palette import Color
from spatula_env.render.primitives import WET_TISSUE, GroundPlane, Mesh
from spatula_env.render.renderer import Renderer
from spatula_env.render.shapes import arrow_mesh, box_mesh, sphere_mesh
from spatula_env.sim.engine import OWN_CONTACTS

if TYPE_CHECKING:
    from PIL import Image

FIGURE_SPEED = 60.0
"""Of the descent in the figures [u/s]: 0.25 u in a step, twice the spatula's thickness."""

BOTH: Color = (0.95, 0.60, 0.10)
"""Nodes that are flagged although their opposite is, too."""

INK = (38, 44, 52)
FAINT_INK = (98, 106, 116)
PAPER = (255, 255, 255)
RULE = (222, 226, 231)

VIEW = Camera.orbit((1.0, 0.45, 3.2), 14.0, -68.0, 15.0, vertical_field_of_view=30.0)
"""The whole organ, left of the middle, and room above it: without the first step it may be thrown up."""

FILM_VIEW = Camera.orbit((0.0, 0.0, 3.35), 12.4, -68.0, 15.0, vertical_field_of_view=32.0)
"""The whole organ in the middle, and room above it for an arrow."""

CLOSE_VIEW = Camera.orbit((0.0, -0.2, 4.6), 3.0, -68.0, 14.0, vertical_field_of_view=30.0)
"""The spatula where it is held."""

ARROW_LENGTH = 0.22
"""Of a force's arrow [u/N]."""


CUT_ORGAN = replace(WET_TISSUE, mottle=0.15)
"""Vessels belong to the outside, and the material is that of the section as well."""


@dataclass(frozen=True)
class Caption:
    """Words for a picture.

    Attributes:
        title: One line.
        lines: What is said below it.
        keys: Colours of the contact nodes that occur, and what they say.
    """

    title: str
    lines: tuple[str, ...]
    keys: tuple[tuple[Color, str], ...] = ()


def node_colors(snapshot: Snapshot, opposite: NDArray[np.int32], *, watched: bool = False) -> NDArray[np.float64]:
    """Colours of the contact nodes.

    Args:
        snapshot: With the flags.
        opposite: (n,) of the tool.
        watched: Whether the detector only watches: then no node is in contact.

    Returns:
        (n, 3) in 0..1.
    """
    colors = np.tile(np.array(palette.IDLE), (len(opposite), 1))
    if not watched:
        colors[snapshot.unfeasible] = palette.UNFEASIBLE
        colors[snapshot.flags] = palette.FEASIBLE
        colors[snapshot.flags & snapshot.flags[opposite]] = BOTH
    return colors


class PressPainter:
    """Draws presses, one after another."""

    def __init__(self, width: int, height: int, *, view: Camera = VIEW, inset: int = 0) -> None:
        """Prepare.

        Args:
            width: Of a picture [pixels].
            height: Of a picture [pixels].
            view: From where it is seen.
            inset: Width of a close view in the upper right corner, 0 for none [pixels].
        """
        scene = scenes.seed()
        self._tool = scene.tools[0].tool
        self._organ = scene.organs[0].organ
        self._ground = GroundPlane()
        self._view = view
        self._renderer = Renderer(width, height)
        self._close_renderer = Renderer(inset, round(0.72 * inset)) if inset else None

    def draw(
        self, snapshot: Snapshot, *, watched: bool = False, arrow: bool = False, nodes: bool = True
    ) -> NDArray[np.uint8]:
        """Draw one moment.

        Args:
            snapshot: The moment.
            watched: See `node_colors`.
            arrow: Whether to show the force on the tool.
            nodes: Whether to show the contact nodes.

        Returns:
            (height, width, 3).
        """
        position = snapshot.tool_position
        organ = Mesh(
            snapshot.nodes,
            self._organ.triangles,
            color=palette.TISSUE,
            back_color=palette.TISSUE_INSIDE,
            material=CUT_ORGAN,
            texture=self._organ.vertices,
            refine=1,
            clip_plane=((0.0, float(position[1]), 0.0), (0.0, -1.0, 0.0)),
            capped=True,
        )
        tool = box_mesh(self._tool.size, position, snapshot.tool_orientation, bevel=0.015)
        points = rotate(snapshot.tool_orientation, self._tool.nodes) + position
        colors = node_colors(snapshot, self._tool.opposite, watched=watched)

        def meshes(radius: float, subdivisions: int) -> list[Mesh]:
            markers = sphere_mesh(points, radius, colors=colors, subdivisions=subdivisions, casts_shadow=False)
            parts = [organ, tool]
            if nodes:
                parts.append(markers)
            if arrow:
                top = position + np.array([0.0, 0.0, 0.5 * self._tool.size[2]])
                parts.append(arrow_mesh(top, ARROW_LENGTH * snapshot.force, width=0.1))
            return parts

        picture = self._renderer.render(self._view, meshes(0.036, 1), ground=self._ground)
        if self._close_renderer is not None:
            # The ground would be a line far below.
            close = self._close_renderer.render(CLOSE_VIEW, meshes(0.026, 2))
            _paste_inset(picture, close)
        return picture


def _paste_inset(picture: NDArray[np.uint8], close: NDArray[np.uint8]) -> None:
    """Put a framed picture into the upper right corner of another."""
    height, width = close.shape[:2]
    margin, frame = max(6, width // 24), max(2, width // 130)
    top, right = margin, picture.shape[1] - margin
    picture[top - frame : top + height + frame, right - width - frame : right + frame] = PAPER
    picture[top : top + height, right - width : right] = close


def figure_caption(result: PressResult) -> Caption:
    """What a picture of a result says."""
    case = result.case
    titles = {
        "bullet": "Bullet's own contact",
        "mujoco": "MuJoCo's own contact",
        "second_step": "Flags method, second step only",
        "flags": "Flags method, both steps",
    }
    own = f"Force on the spatula {result.force_mean:.2f} N."
    outcome = {
        "bullet": own,
        "mujoco": own,
        "second_step": f"Both faces push in {result.pairs_steps} of {result.steps} steps.",
        "flags": f"Force on the spatula {result.force_mean:.2f} N, deviation {result.force_deviation:.4f} N.",
    }[case.contact]
    where = _where_surface(result.residual_max)
    snapshot, opposite = result.snapshot, scenes.seed().tools[0].tool.opposite
    pairs = snapshot.flags & snapshot.flags[opposite]
    keys: list[tuple[Color, str]] = []
    if case.contact in OWN_CONTACTS:
        keys.append((palette.IDLE, "contact nodes (not used)"))
    else:
        for color, label, present in (
            (palette.FEASIBLE, "in contact", snapshot.flags & ~pairs),
            (BOTH, "both nodes of a pair in contact", pairs),
            (palette.UNFEASIBLE, "unfeasible: refused by the first step", snapshot.unfeasible),
            (palette.IDLE, "no contact", ~snapshot.flags & ~snapshot.unfeasible),
        ):
            if present.any():
                keys.append((color, label))
    return Caption(
        f"{titles[case.contact]}: {result.verdict}",
        (f"Pressed at {case.speed:g} u/s. {where}", outcome),
        tuple(keys),
    )


def _where_surface(residual: float | None) -> str:
    if residual is None:
        return "No organ is over or under the spatula."
    return f"Organ up to {abs(residual):.3f} u {'above' if residual > 0.0 else 'below'} the spatula's underside."


def figure(result: PressResult, *, width: int = 960, text_scale: float = 1.0) -> Image.Image:
    """The picture of a result, with its caption below.

    Args:
        result: Of a press.
        width: Of the picture [pixels].
        text_scale: Size of the caption; 1 is what suits a picture that is shown alone.
    """
    painter = PressPainter(width, round(0.6 * width), inset=round(0.33 * width))
    picture = painter.draw(result.snapshot, watched=result.case.contact in OWN_CONTACTS)
    return with_caption(picture, figure_caption(result), text_scale)


def with_caption(picture: NDArray[np.uint8], caption: Caption, text_scale: float = 1.0) -> Image.Image:
    """A picture with a caption below it; `text_scale` as in `figure`."""
    from PIL import Image

    height, width = picture.shape[:2]
    strip = _draw_caption(caption, width, text_scale)
    page = Image.new("RGB", (width, height + strip.height), PAPER)
    page.paste(Image.fromarray(picture), (0, 0))
    page.paste(strip, (0, height))
    return page


def side_by_side(pages: Sequence[Image.Image], gap: int = 12) -> Image.Image:
    """Pictures of one height in a row."""
    from PIL import Image

    width = sum(page.width for page in pages) + gap * (len(pages) - 1)
    row = Image.new("RGB", (width, max(page.height for page in pages)), PAPER)
    left = 0
    for page in pages:
        row.paste(page, (left, 0))
        left += page.width + gap
    return row


def _draw_caption(caption: Caption, width: int, text_scale: float) -> Image.Image:
    """The strip with the words: title, lines, keys."""
    from PIL import Image, ImageDraw

    # Drawn three times as large and reduced, because Pillow's circles have steps.
    fine = 3
    unit = text_scale * fine * width / 960.0
    below_lines = 52.0 + 30.0 * len(caption.lines)
    strip = Image.new("RGB", (fine * width, round((below_lines + 42.0) * unit)), PAPER)
    draw = ImageDraw.Draw(strip)
    draw.line([(0, 0), (fine * width, 0)], fill=RULE, width=fine)
    left = 24 * unit
    draw.text((left, 15 * unit), caption.title, fill=INK, font=_font(26 * unit))
    for index, line in enumerate(caption.lines):
        draw.text((left, (52 + 30 * index) * unit), line, fill=FAINT_INK, font=_font(20 * unit))
    font, middle, radius = _font(18 * unit), (below_lines + 16.0) * unit, 6.5 * unit
    for color, label in caption.keys:
        fill = tuple(round(255 * part) for part in color)
        draw.ellipse([left, middle - radius, left + 2 * radius, middle + radius], fill=fill)
        left += 2 * radius + 8 * unit
        draw.text((left, middle), label, fill=INK, font=font, anchor="lm")
        left += draw.textlength(label, font=font) + 26 * unit
    return strip.resize((width, strip.height // fine), Image.Resampling.LANCZOS)


def _font(size: float) -> Any:
    """Pillow's built-in font."""
    from PIL import ImageFont

    return ImageFont.load_default(size=max(size, 8.0))
