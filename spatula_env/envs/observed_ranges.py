"""Which parts of an observation are chosen, and how far what is measured of contact and of the organ reaches."""

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
"""All parts; those that a robot knows by its own sensors or is told; all, these apart from what is privileged."""


@dataclass(frozen=True)
class ObservedRanges:
    """Up to which values an observation tells what is measured of contact and of the organ.

    They are the bounds of the observation's space, and what is beyond is clipped. `info` has forces and pressures
    unclipped. A task's are what is met in it, with a margin; the defaults suit any.

    Attributes:
        force: Along each axis, on each tool, averaged over a control step [N].
        torque: About each axis [N m].
        contact_depth: Of the deepest contact [m].
        peak_pressure: Greatest on a node [Pa].
        mean_pressure: On the face that is pressed most [Pa].
        displacement: Of landmarks on the organ, along each axis [m].
        untouched: By `control`, the faces of the tools, in the order of `Situation.contact_share`, that the organ
            cannot touch as the control moves them: nothing is told of them, as it would be the same always.
        face_count: How many faces the tools have that `untouched` is about; where a scene has others, all are told of.
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
        """The faces that are told of.

        Args:
            control: Name of the control.
            count: How many faces the tools have.
        """
        left_out = self.untouched.get(control, ()) if count == self.face_count else ()
        return np.setdiff1d(np.arange(count), left_out)


def check_parts(parts: str, obs_mode: str) -> None:
    """Check that a mode of observation has a choice of parts.

    Args:
        parts: One of `PART_CHOICES`.
        obs_mode: "state", "dict", "rgb", "rgbd" or "pointcloud".

    Raises:
        ValueError: If it has not.
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
