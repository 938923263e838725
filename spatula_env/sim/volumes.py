"""Volumes that organs enclose; an organ whose volume is negative has turned inside out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from spatula_env._kernels import ARRAYS, kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spatula_env.scenes import PlacedOrgan, Scene

    FloatArray = NDArray[np.float64]

COLLAPSED = 0.05
"""An organ that at rest has a smaller share of its volume has collapsed. In motion it may recover: a fast tool presses
an organ flat for a moment."""

INSIDE_OUT = -1e-3
"""An organ with a smaller share of its volume is inside out. One that is flat has a volume of zero, up to rounding."""

F8_2, F8_3, I4_2, I8 = ARRAYS["f8_2"], ARRAYS["f8_3"], ARRAYS["i4_2"], ARRAYS["i8"]


@kernel((F8_3, I4_2, I8, F8_2))
def enclosed_volumes(nodes: np.ndarray, triangles: np.ndarray, ends: np.ndarray, volumes: np.ndarray) -> None:
    """The volumes that closed surfaces enclose, in many worlds.

    Args:
        nodes: (W, V, 3) of all organs [u].
        triangles: (T, 3) of all organs, organ after organ.
        ends: (O,) the triangle after the last one of each organ.
        volumes: (W, O) written [u3]; negative for a surface that is inside out.
    """
    for w in range(nodes.shape[0]):
        first = 0
        for organ in range(ends.shape[0]):
            # Relative to a node of the organ itself: far from the origin, digits would be lost.
            origin, six_fold = nodes[w, triangles[first, 0]], 0.0
            ax, ay, az = origin[0], origin[1], origin[2]
            for t in range(first, ends[organ]):
                p, q, r = nodes[w, triangles[t, 0]], nodes[w, triangles[t, 1]], nodes[w, triangles[t, 2]]
                px, py, pz = p[0] - ax, p[1] - ay, p[2] - az
                qx, qy, qz = q[0] - ax, q[1] - ay, q[2] - az
                rx, ry, rz = r[0] - ax, r[1] - ay, r[2] - az
                six_fold += px * (qy * rz - qz * ry) + py * (qz * rx - qx * rz) + pz * (qx * ry - qy * rx)
            volumes[w, organ] = six_fold / 6.0
            first = ends[organ]


class Volumes:
    """The volumes of a scene's organs.

    Attributes:
        organs: The scene's organs.
        triangles: (T, 3) of all organs, organ after organ.
        initial: (O,) of the O organs as the scene has them, undeformed [u3].
    """

    def __init__(self, scene: Scene) -> None:
        """Prepare to measure.

        Args:
            scene: The scene with the organs.
        """
        self.organs: tuple[PlacedOrgan, ...] = scene.organs
        starts = np.cumsum([0, *(len(placed.organ.vertices) for placed in scene.organs)])
        surfaces = [placed.organ.triangles + start for placed, start in zip(scene.organs, starts, strict=False)]
        self.triangles: NDArray[np.int32] = np.concatenate(surfaces).astype(np.int32)
        self._ends = np.cumsum([len(placed.organ.triangles) for placed in scene.organs])
        self.initial: FloatArray = np.array([placed.organ.volume for placed in scene.organs])

    def measure(self, nodes: FloatArray) -> FloatArray:
        """The present volumes.

        Args:
            nodes: (W, V, 3) of W worlds [u].

        Returns:
            (W, O) [u3].
        """
        volumes = np.empty((len(nodes), len(self._ends)))
        enclosed_volumes(np.ascontiguousarray(nodes), self.triangles, self._ends, volumes)
        return volumes

    def inside_out(self, nodes: FloatArray) -> NDArray[np.bool_]:
        """(W, O) which organs have turned inside out."""
        wrong: NDArray[np.bool_] = self.measure(nodes) < INSIDE_OUT * self.initial
        return wrong

    def collapsed(self, nodes: FloatArray) -> NDArray[np.bool_]:
        """(W, O) which organs, if they are at rest, have collapsed."""
        wrong: NDArray[np.bool_] = self.measure(nodes) < COLLAPSED * self.initial
        return wrong

    def tell(self, volumes: FloatArray) -> str:
        """Describe in words which organs with these volumes (O,) have collapsed or turned inside out."""
        return _enumerate(self.organs, volumes / self.initial)


def _enumerate(organs: Sequence[PlacedOrgan], shares: FloatArray) -> str:
    told = []
    for placed, share in zip(organs, shares.tolist(), strict=True):
        if share < 0.0:
            told.append(f"organ {placed.organ.name!r} has turned inside out")
        elif share < COLLAPSED:
            told.append(f"organ {placed.organ.name!r} has collapsed to {100.0 * share:.2g} % of its volume")
    return " and ".join(told)
