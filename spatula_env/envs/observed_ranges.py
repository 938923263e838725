"""Selection of an observation's parts, and ranges of measurements of contact and of the organ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np

from spatula_env.geometry.checks import check_positive

if TYPE_CHECKING:
    from spatula_env.arrays import IntArray

ALL_PARTS, SENSORS, GROUPED = "all", "sensors", "grouped"

PART_CHOICES = (ALL_PARTS, SENSORS, GROUPED)
"""All parts; only those that a robot senses or is told; all, with the privileged ones separate."""


@dataclass(frozen=True)
class ObservedRanges:
    """Ranges of an observation's measurements of contact and of the organ.

    They are the bounds of the observation space, to which values are clipped; forces and pressures in `info` are not
    clipped. A task's ranges cover what occurs in it, with a margin; the defaults suit any task.

    Attributes:
        force: Greatest force along each axis, on each tool, averaged over a control step [N].
        torque: Greatest torque about each axis [N m].
        contact_depth: Greatest depth of the deepest contact [m].
        peak_pressure: Greatest pressure on a node [Pa].
        mean_pressure: Greatest mean pressure on the face that is pressed most [Pa].
        displacement: Greatest displacement of landmarks on the organ, along each axis [m].
        untouched: By `control`, the faces of the tools (in the order of `Situation.contact_share`) that the organ
            cannot touch with this control: they are left out of the observation, as their values would be constant.
        face_count: Number of faces of the tools to which `untouched` applies; with another number, all faces are
            observed.
    """

    force: float = 10.0
    torque: float = 0.2
    contact_depth: float = 0.05
    peak_pressure: float = 20e3
    mean_pressure: float = 20e3
    displacement: float = 0.1
    untouched: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    face_count: int = 0

    def __post_init__(self) -> None:
        """Check the values."""
        for each in fields(self):
            if each.name not in ("untouched", "face_count"):
                check_positive(getattr(self, each.name), f"observed.{each.name}")
        faces = set(range(self.face_count))
        for control, left_out in self.untouched.items():
            if not set(left_out) < faces:
                raise ValueError(
                    f"observed.untouched must be some of the faces 0 to {self.face_count - 1}, and not all, got "
                    f"{left_out} for the control {control!r}"
                )

    def touched(self, control: str, count: int) -> IntArray:
        """Indices of the faces that are observed.

        Args:
            control: Name of the control.
            count: Number of faces of the tools.
        """
        left_out = self.untouched.get(control, ()) if count == self.face_count else ()
        return np.setdiff1d(np.arange(count), left_out)


def check_parts(parts: str, obs_mode: str) -> None:
    """Check that an observation mode allows a selection of parts.

    Args:
        parts: One of `PART_CHOICES`.
        obs_mode: "state", "dict", "rgb", "rgbd" or "pointcloud".

    Raises:
        ValueError: If it does not.
    """
    if parts == GROUPED and obs_mode == "dict":
        raise ValueError(
            "observation.parts must be 'all' or 'sensors' with obs_mode='dict', whose parts are apart already; "
            f"got {parts!r}"
        )
    if parts != ALL_PARTS and obs_mode == "pointcloud":
        raise ValueError(
            "observation.parts must be 'all' with obs_mode='pointcloud', whose points are always the same ones of the "
            f"organ, as no sensor knows them; got {parts!r}"
        )
