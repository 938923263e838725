"""A material's energy and stress in NumPy: the reference for the kernels, and stress curves of standard tests."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from spatula_env.arrays import FloatArray
    from spatula_env.scenes import Material


@dataclass(frozen=True)
class Hyperelastic:
    """The coefficients of `scenes.Material`'s energy, in any one unit of stress.

    Attributes:
        c1: Coefficient of I1.
        c2: Coefficient of I2.
        c3: Coefficient of the square of y.
        bulk: The coefficient k.
        greatest_slope: Upper bound of 2 c3 y.
    """

    c1: float
    c2: float
    c3: float
    bulk: float
    greatest_slope: float

    @classmethod
    def of(cls, material: Material, unit: float = 1.0) -> Hyperelastic:
        """The coefficients of a material.

        Args:
            material: The material.
            unit: Pascals in a unit of stress.
        """
        shear = material.shear_modulus / unit
        first, square = material.rivlin if material.model == "rivlin" else (0.5, 0.0)
        c1, c3 = first * shear, square * shear
        return cls(
            c1=c1,
            c2=0.5 * shear - c1,
            c3=c3,
            bulk=material.lame_parameter / unit + 2.0 * c1,
            greatest_slope=max(-c1, 0.0) if c3 > 0.0 else 0.0,
        )

    @property
    def shear(self) -> float:
        """Shear modulus at small strain."""
        return 2.0 * (self.c1 + self.c2)

    @property
    def greatest_shear(self) -> float:
        """The greatest tangent modulus in simple shear, which occurs where 2 c3 y reaches its upper bound."""
        return self.shear + 12.0 * self.greatest_slope

    @property
    def lame(self) -> float:
        """Lamé's first parameter at small strain."""
        return self.bulk - 2.0 * self.c1

    @property
    def rest_pressure(self) -> float:
        """2 c1 + 4 c2: the stress of the invariants' terms at rest, which the term in J - 1 cancels."""
        return 2.0 * self.c1 + 4.0 * self.c2

    def energy(self, deformations: ArrayLike) -> FloatArray:
        """(...) energy per volume at rest, of deformation gradients (..., 3, 3)."""
        f, _, first, second = _invariants(deformations)
        change = np.linalg.det(f) - 1.0
        strain = np.maximum(first + second - 6.0 * (change + 1.0), 0.0)
        square = self.c3 * strain**2
        if self.c3 > 0.0:
            limit = self.greatest_slope / (2.0 * self.c3)
            square = np.where(strain < limit, square, self.c3 * limit**2 + self.greatest_slope * (strain - limit))
        energy: FloatArray = (
            self.c1 * (first - 3.0)
            + self.c2 * (second - 3.0)
            + square
            - self.rest_pressure * change
            + 0.5 * self.bulk * change**2
        )
        return energy

    def stress(self, deformations: ArrayLike) -> FloatArray:
        """(..., 3, 3) first Piola-Kirchhoff stress of deformation gradients (..., 3, 3), which must be invertible."""
        f, c, first, second = _invariants(deformations)
        volume = np.linalg.det(f)
        slope = np.clip(2.0 * self.c3 * (first + second - 6.0 * volume), 0.0, self.greatest_slope)
        cofactors = volume[..., None, None] * np.swapaxes(np.linalg.inv(f), -1, -2)
        of_second = 2.0 * (self.c2 + slope)
        of_first = 2.0 * (self.c1 + slope) + of_second * first
        pressure = self.bulk * (volume - 1.0) - self.rest_pressure - 6.0 * slope
        stress: FloatArray = (
            of_first[..., None, None] * f - of_second[..., None, None] * (f @ c) + pressure[..., None, None] * cofactors
        )
        return stress

    def uniaxial(self, stretches: ArrayLike) -> FloatArray:
        """(...) nominal stress of a bar that is stretched by (...) along its axis, its sides free."""
        along = np.asarray(stretches, dtype=np.float64)
        across = along**-0.5
        f = np.zeros((*along.shape, 3, 3))
        f[..., 0, 0] = along
        # Newton's method on the lateral stress, with its slope by finite differences.
        for _ in range(50):
            values = []
            for change in (0.0, 1e-6):
                f[..., 1, 1] = f[..., 2, 2] = across + change
                values.append(self.stress(f)[..., 1, 1])
            across = across - values[0] * 1e-6 / (values[1] - values[0])
        f[..., 1, 1] = f[..., 2, 2] = across
        return self.stress(f)[..., 0, 0]

    def simple_shear(self, amounts: ArrayLike) -> FloatArray:
        """(...) shear stress of a block whose top is moved along itself by amounts (...) of its height."""
        amount = np.asarray(amounts, dtype=np.float64)
        f = np.zeros((*amount.shape, 3, 3))
        f[...] = np.eye(3)
        f[..., 0, 1] = amount
        return self.stress(f)[..., 0, 1]


def _invariants(deformations: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """F, C, I1 and I2 of deformation gradients."""
    f = np.asarray(deformations, dtype=np.float64)
    c = np.swapaxes(f, -1, -2) @ f
    first = np.trace(c, axis1=-2, axis2=-1)
    second = 0.5 * (first**2 - np.einsum("...ij,...ij->...", c, c))
    return f, c, first, second
