"""Materials of tissue, in SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, cast, get_args

from spatula_env.geometry.checks import check_finite, check_not_negative, check_positive, is_number

ModelName = Literal["neo_hookean", "rivlin"]
"""How stress grows with strain; see `Material`."""

BrainRegion = Literal["cortex", "corona_radiata", "basal_ganglia", "corpus_callosum"]
"""The regions of the human brain for which `Material.brain` has coefficients."""

GREATEST_POISSON_RATIO = 0.49
"""Beyond it the longest stable step becomes too short; tissue's volume is kept to a per cent or two."""

INJURY_STRAIN = 0.21
"""Greatest principal Green-Lagrange strain beyond which tissue counts as strained too far. This threshold best told
damaged from undamaged nerve fibres in guinea pigs' optic nerves, 0.14 being the cautious and 0.34 the lenient one
(A. C. Bain and D. F. Meaney, Tissue-level thresholds for axonal damage in an experimental model of central nervous
system white matter injury, Journal of Biomechanical Engineering 122, 2000). The nerves were stretched along their
fibres within some tens of milliseconds, as in an accident: the threshold says little about slow retraction."""

LENIENT_STRAIN = 0.34
"""The lenient threshold of the same source."""

BRAIN = {
    "cortex": (1330.4, -3.275, 1.566),
    "corona_radiata": (737.1, -4.176, 1.699),
    "basal_ganglia": (738.3, -3.106, 0.891),
    "corpus_callosum": (416.4, -4.206, 1.719),
}
"""Shear modulus [Pa] and `Material.rivlin` of regions of the human brain, fitted by scripts/fit_brain.py to the mean
stresses in compression, tension and shear of S. Budday et al., Mechanical characterization of human brain tissue, Acta
Biomaterialia 48 (2017) 319-340, as tabulated by the project LivingMatterLab/CANN."""


@dataclass(frozen=True)
class Material:
    """Tissue: hyperelastic, nearly incompressible, viscous, and relaxing.

    The energy per volume at rest, with the principal invariants I1 and I2 of the right Cauchy-Green tensor, J the ratio
    of volumes and y = I1 + I2 - 6 J, is

        c1 (I1 - 3) + c2 (I2 - 3) + c3 y^2 - (2 c1 + 4 c2) (J - 1) + k / 2 (J - 1)^2

    with c1 + c2 half the shear modulus, and k such that small strains are those of Young's modulus and Poisson's ratio.
    It stays finite where an element turns inside out. "neo_hookean": c1 alone. "rivlin", after R. S. Rivlin's
    polynomial in both invariants: all three, c1 being negative for tissue that stiffens more in compression than in
    tension; 2 c3 y is limited to -c1, which it reaches only at strains far beyond those of any test.

    Attributes:
        young_modulus: Young's modulus at small strain, before any relaxation [Pa].
        poisson_ratio: Poisson's ratio at small strain, zero or more and at most 0.49.
        density: Density [kg/m3].
        model: How stress grows with strain.
        viscosity: Stress per rate of shear strain, in addition to relaxation [Pa s]. The bulk is viscous in the same
            proportion to its stiffness. With the default, the force on a tool that stands still is steady within 0.3 %,
            in cortex as well, the stiffest region of the brain; there it shakes by 5 % with half of it.
        relaxation: A Prony series: pairs of a share of the distortional stress that relaxes, less than 1 in all, and
            its time [s]. ((0.3, 2.0),): 30 % of the stress relaxes, as 1 - exp(-t / 2 s).
        rivlin: c1 and c3 divided by the shear modulus; for the model "rivlin".
    """

    young_modulus: float = 2010.0
    poisson_ratio: float = 0.45
    density: float = 1040.0
    model: ModelName = "neo_hookean"
    viscosity: float = 1.0
    relaxation: tuple[tuple[float, float], ...] = ()
    rivlin: tuple[float, float] = (0.5, 0.0)

    def __post_init__(self) -> None:
        """Check the values."""
        check_positive(self.young_modulus, "young_modulus")
        if not (is_number(self.poisson_ratio) and 0.0 <= self.poisson_ratio <= GREATEST_POISSON_RATIO):
            raise ValueError(f"poisson_ratio must be from 0 to {GREATEST_POISSON_RATIO:g}, got {self.poisson_ratio!r}")
        check_positive(self.density, "density")
        if self.model not in get_args(ModelName):
            raise ValueError(f"model must be one of {list(get_args(ModelName))}, got {self.model!r}")
        check_not_negative(self.viscosity, "viscosity")
        self._check_relaxation()
        self._check_rivlin()

    def _check_relaxation(self) -> None:
        terms = []
        for term in self.relaxation:
            if not (len(term) == 2 and all(is_number(value) for value in term)):
                raise ValueError(f"relaxation must hold pairs of a share and a time, got {term!r}")
            share, time = map(float, term)
            check_positive(time, "a time of relaxation")
            check_not_negative(share, "a share of relaxation")
            terms.append((share, time))
        if sum(share for share, _ in terms) >= 1.0:
            raise ValueError(f"the shares of relaxation must be less than 1 in all, got {self.relaxation!r}")
        object.__setattr__(self, "relaxation", tuple(terms))

    def _check_rivlin(self) -> None:
        if not (len(self.rivlin) == 2 and all(is_number(value) for value in self.rivlin)):
            raise ValueError(f"rivlin must be c1 and c3 by the shear modulus, got {self.rivlin!r}")
        first, square = map(float, self.rivlin)
        if self.model == "neo_hookean" and (first, square) != (0.5, 0.0):
            raise ValueError(f"rivlin must be left alone with model 'neo_hookean', got {self.rivlin!r}")
        check_not_negative(square, "the second of rivlin")
        if square == 0.0 and not 0.0 <= first <= 0.5:
            raise ValueError(f"the first of rivlin must be from 0 to 0.5 where the second is zero, got {first!r}")
        check_finite(first, "the first of rivlin")
        object.__setattr__(self, "rivlin", (first, square))

    @property
    def shear_modulus(self) -> float:
        """Shear modulus at small strain [Pa]."""
        return self.young_modulus / (2.0 * (1.0 + self.poisson_ratio))

    @property
    def lame_parameter(self) -> float:
        """Lamé's first parameter, at small strain [Pa]."""
        return 2.0 * self.shear_modulus * self.poisson_ratio / (1.0 - 2.0 * self.poisson_ratio)

    @classmethod
    def brain(
        cls,
        region: BrainRegion,
        *,
        poisson_ratio: float = GREATEST_POISSON_RATIO,
        viscosity: float = 1.0,
        relaxation: tuple[tuple[float, float], ...] = (),
    ) -> Material:
        """Tissue of a region of the human brain, as fitted to the tests of Budday et al. (2017).

        The tests do not show how tissue relaxes in operations: no coefficients of a Prony series could be derived, so
        these are an argument.

        Args:
            region: The region.
            poisson_ratio: See `Material`; with less than that of the fit, compression is softer than published.
            viscosity: See `Material`.
            relaxation: See `Material`.

        Raises:
            ValueError: If an argument is not allowed.
        """
        if region not in BRAIN:
            raise ValueError(f"region must be one of {list(BRAIN)}, got {region!r}")
        shear, first, square = BRAIN[region]
        if not (is_number(poisson_ratio) and math.isfinite(poisson_ratio)):
            raise ValueError(f"poisson_ratio must be a finite number, got {poisson_ratio!r}")
        return cls(
            young_modulus=2.0 * shear * (1.0 + poisson_ratio),
            poisson_ratio=poisson_ratio,
            model="rivlin",
            viscosity=viscosity,
            relaxation=relaxation,
            rivlin=(first, square),
        )


def as_material(value: Any) -> Material:
    """Make a material from a material, a mapping of some of its fields, or the name of a region of the brain.

    Args:
        value: A `Material`; a mapping such as `{"young_modulus": 3000.0}`, whose other fields have their defaults; or a
            region for which `Material.brain` has coefficients.

    Raises:
        ValueError: If it is none of these, or a value is not allowed.
    """
    if isinstance(value, Material):
        return value
    if isinstance(value, str):
        return Material.brain(cast("BrainRegion", value))
    names = [each.name for each in fields(Material)]
    if isinstance(value, Mapping):
        unknown = [name for name in value if name not in names]
        if unknown:
            raise ValueError(f"material must have fields among {names}, got {unknown}")
        return Material(**value)
    raise ValueError(
        f"material must be a Material, a mapping of fields among {names}, or one of {list(BRAIN)}, got {value!r}"
    )
