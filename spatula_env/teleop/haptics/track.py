"""What happened at the rate of the haptic loop, on request: kept in memory, and in a file beside an episode.

The file is a NumPy archive (`numpy.load`) with arrays of n cycles, device's frame, SI units:

=============  ==========  ==============================================================================
time           (n,)        of the cycle, by the device's clock [s]
position       (n, 3)      of the grip [m]
velocity       (n, 3)      of it, filtered [m/s]
told           (n, 3)      the simulation's force on the tool, as it was last told, not scaled [N]
shown          (n, 3)      what was sent to the motors [N]
buttons        (n,)        bit by bit, in the order of `button_names`
button_names   (b,)        text
lost           ()          how many cycles did not find room any more
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
    """What happened in n cycles of a loop; see the module.

    Attributes:
        time: (n,) [s].
        position: (n, 3) [m].
        velocity: (n, 3) [m/s].
        told: (n, 3) [N].
        shown: (n, 3) [N].
        buttons: (n,).
        button_names: Of the bits.
        lost: How many cycles did not find room any more.
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
        """Write it into a file, which is whole or not there."""
        target = Path(path)
        target.parent.mkdir(parents=True, exist_ok=True)
        unfinished = target.with_name(target.name + ".part")
        with open(unfinished, "wb") as file:
            np.savez_compressed(file, **{**vars(self), "button_names": np.array(self.button_names)})
        os.replace(unfinished, target)

    @classmethod
    def load(cls, path: str | Path) -> HapticTrack:
        """Read it again."""
        with np.load(path, allow_pickle=False) as found:
            fields = {name: found[name] for name in found.files}
        names = tuple(fields.pop("button_names").tolist())
        return cls(**{**fields, "lost": int(fields["lost"])}, button_names=names)

    def motion(self) -> Callable[[float], tuple[float, float, float]]:
        """Where the grip was against time from 0 on, device's frame [m]; for a hand on an emulated device."""
        start = float(self.time[0])

        def place(seconds: float) -> tuple[float, float, float]:
            x, y, z = (float(np.interp(start + seconds, self.time, column)) for column in self.position.T)
            return x, y, z

        return place


class TrackRecorder:
    """Takes rows into a place that was made beforehand."""

    def __init__(self, cycles: int) -> None:
        """Make room.

        Args:
            cycles: For how many rows.
        """
        self._rows = array("d", bytes(8 * COLUMNS * cycles))
        self._room = cycles
        self._count = self.lost = 0

    def add(self, time: float, position: Vector, velocity: Vector, told: Vector, shown: Vector, buttons: int) -> None:
        """Take a row; what finds no room is counted."""
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
        """What there is; the next row is the first again.

        Args:
            button_names: Of the device.
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
