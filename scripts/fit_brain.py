"""Fit `scenes.Material`'s model "rivlin" to tests of human brain tissue: prints `scenes.material.BRAIN`.

The data, in data/brain_budday2017.csv: mean nominal stress in uniaxial compression and tension, stretch 0.9 to 1.1, and
mean shear stress at shear -0.2 to 0.2, of four regions; S. Budday et al., Mechanical characterization of human brain
tissue, Acta Biomaterialia 48 (2017) 319-340, as tabulated by the project LivingMatterLab/CANN. Compression,
tension and shear are fitted together, each point alike: first as if tissue were incompressible, which is a linear
problem, then with Poisson's ratio 0.49.

The least squares alone would give two of the regions a material that shears by itself when it is stretched. So the
coefficients are held to those with which every further shear of a state costs energy: at least `MARGIN` of what it
costs at rest, at stretches of 0.6 to 1.6.

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
"""Of the fitted material; with less, tissue that is pressed gives way by losing volume."""

MARGIN = 0.05
"""Least stiffness against a further shear, of that at rest."""

OGDEN_ERRORS = {"cortex": 0.025, "corona_radiata": 0.022, "basal_ganglia": 0.012, "corpus_callosum": 0.013}
"""Root mean square errors of one-term Ogden models that are fitted to the same points [kPa]."""

Slopes = tuple[np.ndarray, np.ndarray]


def read_data() -> dict[str, np.ndarray]:
    """(n, 4) for each region: stretch, nominal stress [kPa], shear, shear stress [kPa]."""
    regions: dict[str, list[list[float]]] = {}
    with DATA.open(newline="") as file:
        for row in csv.DictReader(file):
            region = row.pop("region")
            regions.setdefault(region, []).append([float(value) for value in row.values()])
    return {region: np.array(rows) for region, rows in regions.items()}


def slopes(first: np.ndarray, second: np.ndarray) -> list[Slopes]:
    """Derivatives by I1 and by I2 of what c1, c2 and c3 are multiplied by, at I1 - 3 and I2 - 3."""
    one, none, square = np.ones_like(first), np.zeros_like(first), 2.0 * (first + second)
    return [(one, none), (none, one), (square, square)]


def stresses(stretch: np.ndarray, shear: np.ndarray) -> np.ndarray:
    """(n, 3) nominal stresses and shear stresses that c1, c2 and c3 of one would make."""
    first, second = stretch**2 + 2.0 / stretch - 3.0, 2.0 * stretch + stretch**-2 - 3.0
    pulled = [2.0 * (stretch - stretch**-2) * (a + b / stretch) for a, b in slopes(first, second)]
    sheared = [2.0 * shear * (a + b) for a, b in slopes(shear**2, shear**2)]
    return np.concatenate([np.column_stack(pulled), np.column_stack(sheared)])


def stiffnesses() -> np.ndarray:
    """(n, 3) second derivatives of energy by a further shear m n, m across n, of states of the same volume.

    Of I1 and I2 the first derivatives are 2 m.Bn and -2 n.B^-1 m, the second 2 n.Bn and 2 m.B^-1 m, with B the left
    Cauchy-Green tensor, here diagonal.
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
    """Coefficients (3,) [kPa] of least squares with which none of `needed` is negative, and which of it decided."""
    coefficients, active = np.array([0.0, 0.3, 1.0]), np.zeros(0, dtype=np.int64)
    for _ in range(60):
        coefficients = least(lambda x: design @ x - wanted, coefficients, needed[active])
        values = needed @ coefficients
        if values.min() > -1e-7:
            break
        # The states that are worst are held to it from now on.
        active = np.union1d(active, np.argsort(values)[:5])
    return coefficients, active


def least(errors: Callable[[np.ndarray], np.ndarray], start: np.ndarray, needed: np.ndarray) -> np.ndarray:
    """Where the sum of squared errors is least with `needed` not negative."""
    limits = {"type": "ineq", "fun": lambda x: needed @ x, "jac": lambda x: needed} if len(needed) else ()
    options = {"maxiter": 500, "ftol": 1e-12}
    return minimize(
        lambda x: 0.5 * (errors(x) ** 2).sum(), start, constraints=limits, method="SLSQP", options=options
    ).x


def law_of(coefficients: np.ndarray) -> Hyperelastic:
    """The nearly incompressible material of coefficients [kPa]."""
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
    """Fit all regions."""
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
