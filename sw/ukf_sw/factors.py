"""Covariances: whether a matrix is one, and its lower triangular factor. Every backend has it here.

Matrices are judged with their rows scaled to a diagonal near 1, so that variances of any sizes may
stand beside each other, and within the rounding errors of the type they came in.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["IndefiniteError", "check_definite", "lower_factor", "rounding_errors"]

Array = NDArray[np.float64]


class IndefiniteError(ValueError):
    """A matrix is not positive semidefinite, or not definite.

    Parameters
    ----------
    rule
        What it must be.
    row
        First row that makes it wrong, together with those before it.
    reason
        What is wrong there.
    """

    def __init__(self, rule: str, row: int, reason: str) -> None:
        super().__init__(f"{rule}, and is not in row {row}: {reason}")
        self.rule = rule
        self.row = row
        self.reason = reason

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.rule, self.row, self.reason), self.__dict__


def rounding_errors(size: int, epsilon: float) -> float:
    """What rounding leaves of a zero, in a matrix of so many rows with a diagonal near 1."""
    return 4.0 * size * epsilon


def _scales(A: Array, rule: str) -> Array:
    """Powers of two near the square roots of the diagonal, which scale exactly; 0 for 0."""
    diagonal = np.diag(A)
    if (diagonal < 0.0).any():
        row = int((diagonal < 0.0).argmax())
        raise IndefiniteError(rule, row, f"its variance is {float(diagonal[row])!r}")
    _, exponents = np.frexp(np.sqrt(diagonal))
    scales = np.ldexp(1.0, exponents) * (diagonal > 0.0)
    for row in np.flatnonzero(diagonal == 0.0).tolist():
        if A[row].any():
            reason = f"beside a variance of 0 stands {float(np.abs(A[row]).max())!r}"
            raise IndefiniteError(rule, row, reason)
    return scales


def _scaled(A: Array, scales: Array) -> Array:
    """Scale rows and columns; those of zeros get a diagonal of 1."""
    divisors = np.where(scales > 0.0, scales, 1.0)
    return A / divisors[:, None] / divisors + np.diag((scales == 0.0).astype(np.float64))


def _check_eigenvalues(C: Array, least: float, rule: str) -> None:
    """Check that every eigenvalue of a scaled matrix is at least so large; name the row."""
    if np.linalg.eigvalsh(C)[0] >= least:
        return
    for row in range(len(C)):
        smallest = float(np.linalg.eigvalsh(C[: row + 1, : row + 1])[0])
        if smallest < least or row == len(C) - 1:
            reason = (
                f"with variances near 1, the smallest eigenvalue up to there is {smallest:.3g}, "
                f"and at least {least:.3g} is needed"
            )
            raise IndefiniteError(rule, row, reason)


def check_definite(A: Array, epsilon: float = np.finfo(np.float64).eps) -> None:
    """Check that a matrix is positive definite, beyond its rounding errors.

    Parameters
    ----------
    A
        Symmetric matrix, shape (k, k).
    epsilon
        Relative rounding error of its elements.

    Raises
    ------
    IndefiniteError
        If it is not.
    """
    rule = "must be positive definite"
    scales = _scales(A, rule)
    if not scales.all():
        raise IndefiniteError(rule, int((scales == 0.0).argmax()), "its variance is 0.0")
    _check_eigenvalues(_scaled(A, scales), rounding_errors(len(A), epsilon), rule)


def _eliminate(C: Array, tolerance: float) -> Array:
    """Factor with a zero column for every pivot that is zero but for rounding."""
    B = np.zeros_like(C)
    remainder = C.copy()
    for j in range(len(C)):
        pivot = remainder[j, j]
        if pivot > tolerance:
            B[j:, j] = remainder[j:, j] / np.sqrt(pivot)
            remainder[j:, j:] -= np.outer(B[j:, j], B[j:, j])
    return B


def lower_factor(A: Array, epsilon: float = np.finfo(np.float64).eps) -> Array:
    """Lower triangular B with A = B B^T, for positive *semi*definite A.

    The square root of equation 8 of the 2018 paper. For positive definite A it is the Cholesky
    factor; a pivot that is zero, but for rounding, gives a zero column where that is accurate.

    Parameters
    ----------
    A
        Symmetric matrix, shape (k, k).
    epsilon
        Relative rounding error of its elements, as that of float32 if they have been float32.

    Returns
    -------
    array of shape (k, k)
        A and B B^T differ by rounding errors: by at most ``32 k epsilon`` times the root of the
        product of the diagonal elements of row and column.

    Raises
    ------
    IndefiniteError
        If A is not positive semidefinite.
    """
    try:
        return np.asarray(np.linalg.cholesky(A), dtype=np.float64)
    except np.linalg.LinAlgError:
        return _lower_factor(A, epsilon)


def _lower_factor(A: Array, epsilon: float) -> Array:
    """Factor of a matrix that may be singular."""
    rule = "must be positive semidefinite"
    scales = _scales(A, rule)
    C = _scaled(A, scales)
    tolerance = rounding_errors(len(A), epsilon)
    factor = _eliminate(C, tolerance)
    # A pivot that is small but not zero magnifies the rounding errors of those after it. What is
    # then added to the diagonal is not more than they are.
    if not np.abs(C - factor @ factor.T).max(initial=0.0) <= tolerance:
        _check_eigenvalues(C, -tolerance, rule)
        factor = np.linalg.cholesky(C + 2.0 * tolerance * np.eye(len(C)))
    return factor * scales[:, None]
