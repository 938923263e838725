"""Recording at the rate of the haptic loop, on request: kept in memory, and in a file next to an episode.

The file is a NumPy archive (`numpy.load`) with arrays for n cycles, in the device frame and SI units:

=============  ==========  ==============================================================================
time           (n,)        time of the cycle, by the device's clock [s]
position       (n, 3)      position of the grip [m]
velocity       (n, 3)      its filtered velocity [m/s]
told           (n, 3)      the simulation's force on the tool, as last reported, not scaled [N]
shown          (n, 3)      force sent to the motors [N]
buttons        (n,)        bits of the buttons, in the order of `button_names`
button_names   (b,)        text
lost           ()          number of cycles that no longer fitted
=============  ==========  ==============================================================================
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spatula_env.teleop.device import FloatArray
from spatula_env.teleop.haptics.contact import Vector

COLUMNS = 14
"""Numbers in a row: time, position, velocity, told, shown, buttons."""


@dataclass(frozen=True, eq=False)
class HapticTrack:
    """Recording of n cycles of a loop; see the module.

    Attributes:
        time: (n,) [s].
        position: (n, 3) [m].
        velocity: (n, 3) [m/s].
        told: (n, 3) [N].
        shown: (n, 3) [N].
        buttons: (n,).
        button_names: Names of the bits.
        lost: Number of cycles that no longer fitted.
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    told: FloatArray
    shown: FloatArray
    buttons: NDArray[np.int64]
    button_names: tuple[str, ...]
    lost: int = 0

    def save(self, path: str | Path) -> None:
        """Write the track to a file atomically: the file is complete or absent."""
        target = Path(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        unfinished = target.with_name(target.name + ".part")
        with open(unfinished, "wb") as file:
            np.savez_compressed(file, **{**vars(self), "button_names": np.array(self.button_names)})
        os.replace(unfinished, target)

    @classmethod
    def load(cls, path: str | Path) -> HapticTrack:
        """Load a track from a file."""
        with np.load(path, allow_pickle=False) as found:
            fields = {name: found[name] for name in found.files}
        names = tuple(fields.pop("button_names").tolist())
        return cls(**{**fields, "lost": int(fields["lost"])}, button_names=names)

    def motion(self) -> Callable[[float], tuple[float, float, float]]:
        """Grip position as a function of time from 0, device frame [m]; for a hand on an emulated device."""
        start = float(self.time[0])

        def place(seconds: float) -> tuple[float, float, float]:
            x, y, z = (float(np.interp(start + seconds, self.time, column)) for column in self.position.T)
            return x, y, z

        return place


class TrackRecorder:
    """Stores rows in memory that was allocated in advance."""

    def __init__(self, cycles: int) -> None:
        """Allocate the memory.

        Args:
            cycles: Number of rows.
        """
        self._rows = array("d", bytes(8 * COLUMNS * cycles))
        self._room = cycles
        self._count = self.lost = 0

    def add(self, time: float, position: Vector, velocity: Vector, told: Vector, shown: Vector, buttons: int) -> None:
        """Add a row; rows that do not fit are only counted."""
        if self._count >= self._room:
            self.lost += 1
            return
        at = self._count * COLUMNS
        rows = self._rows
        rows[at] = time
        for first, vector in ((1, position), (4, velocity), (7, told), (10, shown)):
            rows[at + first], rows[at + first + 1], rows[at + first + 2] = vector
        rows[at + 13] = buttons
        self._count += 1

    def take(self, button_names: tuple[str, ...]) -> HapticTrack:
        """Return the rows so far and start again with the first.

        Args:
            button_names: Names of the device's buttons.
        """
        rows = np.frombuffer(self._rows, dtype=np.float64).reshape(-1, COLUMNS)[: self._count].copy()
        track = HapticTrack(
            rows[:, 0],
            rows[:, 1:4],
            rows[:, 4:7],
            rows[:, 7:10],
            rows[:, 10:13],
            rows[:, 13].astype(np.int64),
            tuple(button_names),
            self.lost,
        )
        self._count = self.lost = 0
        return track
