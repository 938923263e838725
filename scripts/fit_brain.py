"""Fit `scenes.Material`'s model "rivlin" to tests of human brain tissue: prints `scenes.material.BRAIN`.

The data in data/brain_budday2017.csv are mean nominal stresses in uniaxial compression and tension, at stretches of 0.9
to 1.1, and mean shear stresses at shears of -0.2 to 0.2, of four regions; S. Budday et al., Mechanical characterization
of human brain tissue, Acta Biomaterialia 48 (2017) 319-340, as tabulated by the project LivingMatterLab/CANN.
Compression, tension and shear are fitted together, with equal weight of all points: first for incompressible tissue,
which is a linear problem, then with Poisson's ratio 0.49.

Unconstrained least squares would give two of the regions a material that is unstable: when stretched, it shears by
itself. The coefficients are therefore constrained so that every further shear of a deformed state has a positive
stiffness, at least `MARGIN` of that at rest, at stretches of 0.6 to 1.6.

Needs SciPy: python scripts/fit_brain.py
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from spatula_env.scenes import Material
from spatula_env.sim.tissue.hyperelastic import Hyperelastic

DATA = Path(__file__).parent / "data" / "brain_budday2017.csv"

POISSON_RATIO = 0.49
"""Poisson's ratio of the fitted material; with a smaller one, compressed tissue would give way by losing volume."""

MARGIN = 0.05
"""Least stiffness against a further shear, relative to that at rest."""

OGDEN_ERRORS = {"cortex": 0.025, "corona_radiata": 0.022, "basal_ganglia": 0.012, "corpus_callosum": 0.013}
"""Root mean square errors of one-term Ogden models fitted to the same points [kPa]."""

Slopes = tuple[np.ndarray, np.ndarray]


def read_data() -> dict[str, np.ndarray]:
    """Read the data: for each region (n, 4) stretch, nominal stress [kPa], shear, shear stress [kPa]."""
    regions: dict[str, list[list[float]]] = {}
    with DATA.open(newline="") as file:
        for row in csv.DictReader(file):
            region = row.pop("region")
            regions.setdefault(region, []).append([float(value) for value in row.values()])
    return {region: np.array(rows) for region, rows in regions.items()}


def slopes(first: np.ndarray, second: np.ndarray) -> list[Slopes]:
    """Derivatives by I1 and by I2 of the terms whose coefficients are c1, c2 and c3, at given I1 - 3 and I2 - 3."""
    one, none, square = np.ones_like(first), np.zeros_like(first), 2.0 * (first + second)
    return [(one, none), (none, one), (square, square)]


def stresses(stretch: np.ndarray, shear: np.ndarray) -> np.ndarray:
    """(n, 3) nominal stresses, then shear stresses, that c1, c2 and c3 would each make if they were 1."""
    first, second = stretch**2 + 2.0 / stretch - 3.0, 2.0 * stretch + stretch**-2 - 3.0
    pulled = [2.0 * (stretch - stretch**-2) * (a + b / stretch) for a, b in slopes(first, second)]
    sheared = [2.0 * shear * (a + b) for a, b in slopes(shear**2, shear**2)]
    return np.concatenate([np.column_stack(pulled), np.column_stack(sheared)])


def stiffnesses() -> np.ndarray:
    """(n, 3) stiffness against a further shear of sampled isochoric states, for each of c1, c2 and c3.

    The stiffness is the second derivative of the energy by the amount of a shear along m on planes of normal n, where m
    and n are orthogonal. The first derivatives of I1 and I2 are 2 m.Bn and -2 n.B^-1 m, the second derivatives 2 n.Bn
    and 2 m.B^-1 m, with the left Cauchy-Green tensor B, here diagonal.
    """
    generator = np.random.default_rng(0)
    logarithms = np.concatenate([generator.uniform(-s, s, (n, 2)) for s, n in ((0.45, 4000), (0.12, 600))])
    stretches = np.exp(np.column_stack([logarithms, -logarithms.sum(axis=1)]))
    stretches = stretches[(stretches.min(axis=1) > 0.6) & (stretches.max(axis=1) < 1.6)]
    m = generator.normal(size=stretches.shape)
    n = np.cross(m, generator.normal(size=stretches.shape))
    axes = np.eye(3)
    pairs = [(m, n)] + [(axes[i] + 0.0 * m, axes[j] + 0.0 * m) for i in range(3) for j in range(3) if i != j]
    rows = []
    for m_, n_ in pairs:
        m_, n_ = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (m_, n_))
        b = stretches**2
        first, second = b.sum(axis=1) - 3.0, (1.0 / b).sum(axis=1) - 3.0
        change = 2.0 * (m_ * b * n_).sum(axis=1) - 2.0 * (n_ / b * m_).sum(axis=1)
        bend = [2.0 * (n_ * b * n_).sum(axis=1), 2.0 * (m_ / b * m_).sum(axis=1)]
        columns = [a * bend[0] + c * bend[1] for a, c in slopes(first, second)]
        columns[2] = columns[2] + 2.0 * change**2
        rows.append(np.column_stack(columns))
    return np.concatenate(rows)


def fit_incompressible(design: np.ndarray, wanted: np.ndarray, needed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Constrained least squares for incompressible tissue, by an active set.

    Args:
        design: (n, 3) stresses per unit of each coefficient.
        wanted: (n,) measured stresses [kPa].
        needed: (m, 3) inequality constraints: the product with the coefficients must not be negative.

    Returns:
        Coefficients (3,) [kPa], and the indices of the constraints that were imposed.
    """
    coefficients, active = np.array([0.0, 0.3, 1.0]), np.zeros(0, dtype=np.int64)
    for _ in range(60):
        coefficients = least(lambda x: design @ x - wanted, coefficients, needed[active])
        values = needed @ coefficients
        if values.min() > -1e-7:
            break
        # From now on, the constraints of the five worst states are imposed.
        active = np.union1d(active, np.argsort(values)[:5])
    return coefficients, active


def least(errors: Callable[[np.ndarray], np.ndarray], start: np.ndarray, needed: np.ndarray) -> np.ndarray:
    """Coefficients (3,) of least squared `errors`, for which the products with `needed` (m, 3) are not negative."""
    limits = {"type": "ineq", "fun": lambda x: needed @ x, "jac": lambda x: needed} if len(needed) else ()
    options = {"maxiter": 500, "ftol": 1e-12}
    return minimize(
        lambda x: 0.5 * (errors(x) ** 2).sum(), start, constraints=limits, method="SLSQP", options=options
    ).x


def law_of(coefficients: np.ndarray) -> Hyperelastic:
    """The nearly incompressible material with coefficients (3,) [kPa]."""
    c1, c2, c3 = coefficients.tolist()
    shear = 2.0 * (c1 + c2)
    return Hyperelastic.of(
        Material(
            young_modulus=2.0 * shear * (1.0 + POISSON_RATIO),
            poisson_ratio=POISSON_RATIO,
            model="rivlin",
            rivlin=(c1 / shear, c3 / shear),
        )
    )


def main() -> None:
    """Fit all regions, and print their materials."""
    needed = stiffnesses() - MARGIN * np.array([2.0, 2.0, 0.0])
    for region, rows in read_data().items():
        stretch, pulled, shear, sheared = rows.T
        design, wanted = stresses(stretch, shear), np.concatenate([pulled, sheared])
        start, active = fit_incompressible(design, wanted, needed)

        def errors(x: np.ndarray, rows: np.ndarray = rows) -> np.ndarray:
            law = law_of(x)
            return np.concatenate([law.uniaxial(rows[:, 0]) - rows[:, 1], law.simple_shear(rows[:, 2]) - rows[:, 3]])

        coefficients = least(errors, start, needed[active])
        c1, c2, c3 = coefficients
        modulus, error = 2.0 * (c1 + c2), float(np.sqrt((errors(coefficients) ** 2).mean()))
        print(
            f'    "{region}": ({1e3 * modulus:.1f}, {c1 / modulus:.3f}, {c3 / modulus:.3f}),'
            f"  # error {error:.4f} kPa, one-term Ogden {OGDEN_ERRORS[region]:.3f} kPa"
        )


if __name__ == "__main__":
    main()
