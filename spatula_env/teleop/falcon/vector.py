"""Vectors of three numbers and 3 x 3 matrices as tuples, without arrays.

The servo loop processes three legs a thousand times a second. On three numbers, plain Python arithmetic takes a tenth
of the time of NumPy calls.
"""

from __future__ import annotations

from collections.abc import Iterable

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
"""A 3 x 3 matrix as three rows."""

ZERO: Vector = (0.0, 0.0, 0.0)


def as_vector(values: Iterable[float]) -> Vector:
    """Convert three numbers to a tuple of floats.

    Args:
        values: The numbers.

    Returns:
        The tuple.

    Raises:
        ValueError: If there are not exactly three.
    """
    x, y, z = (float(value) for value in values)
    return x, y, z


def scale(factor: float, vector: Vector) -> Vector:
    """Multiply a vector by a number.

    Args:
        factor: The number.
        vector: The vector.

    Returns:
        The product.
    """
    x, y, z = vector
    return factor * x, factor * y, factor * z


def transpose(matrix: Matrix) -> Matrix:
    """Swap rows and columns.

    Args:
        matrix: Three rows.

    Returns:
        The transposed matrix.
    """
    a, b, c = matrix
    return (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])


def solve(matrix: Matrix, right: Vector) -> Vector:
    """Solve three linear equations by Cramer's rule.

    Args:
        matrix: Three rows.
        right: The right-hand side.

    Returns:
        The solution.

    Raises:
        ZeroDivisionError: If the matrix is singular.
    """
    (a, b, c), (d, e, f), (g, h, i) = matrix
    x, y, z = right
    first, second, third = e * i - f * h, f * g - d * i, d * h - e * g
    determinant = a * first + b * second + c * third
    return (
        (x * first + y * (c * h - b * i) + z * (b * f - c * e)) / determinant,
        (x * second + y * (a * i - c * g) + z * (c * d - a * f)) / determinant,
        (x * third + y * (b * g - a * h) + z * (a * e - b * d)) / determinant,
    )


def norm(vector: Vector) -> float:
    """The length of a vector.

    Args:
        vector: The vector.

    Returns:
        Its length.
    """
    x, y, z = vector
    return float((x * x + y * y + z * z) ** 0.5)
