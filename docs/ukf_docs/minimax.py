"""Polynomials and rational functions with the smallest largest error, for numbers of a format.

All in mpmath, so that results depend on nothing but the arguments.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
from mpmath import mpf

__all__ = ["Fit", "fit_polynomial", "fit_rational", "nodes", "polynomial"]

#: Bits with which everything is computed.
PRECISION = 220
_EXCHANGES = 30
#: How much better the largest error on the grid may get before the exchange ends.
_LEVELLED = mpf(1) + mpf(2) ** -10
_REWEIGHTINGS = 30


@dataclass(frozen=True)
class Fit:
    """An approximation.

    Parameters
    ----------
    coefficients
        Of rising powers.
    error
        Largest weighted error on the nodes.
    """

    coefficients: tuple[Any, ...]
    error: Any


def nodes(low: Any, high: Any, count: int) -> list[Any]:
    """Give points of an interval, ends included, denser towards the ends."""
    return [
        (high + low) / 2 - (high - low) / 2 * mpmath.cos(mpmath.pi * k / (count - 1))
        for k in range(count)
    ]


def polynomial(coefficients: Sequence[Any], point: Any) -> Any:
    """Give the value of a polynomial with coefficients of rising powers."""
    value = mpf(0)
    for coefficient in reversed(coefficients):
        value = value * point + coefficient
    return value


def _extremes(errors: Sequence[Any], count: int) -> list[int]:
    """Give where errors of alternating sign are largest, the best of that many in a row."""
    found: list[int] = []
    for index, error in enumerate(errors):
        if found and (error > 0) == (errors[found[-1]] > 0):
            if abs(error) > abs(errors[found[-1]]):
                found[-1] = index
        else:
            found.append(index)
    while len(found) > count:
        found.pop(0 if abs(errors[found[0]]) < abs(errors[found[-1]]) else -1)
    return found


def _exchange(
    points: Sequence[Any], wanted: Sequence[Any], weights: Sequence[Any], powers: Sequence[int]
) -> Fit:
    """Fit a polynomial of some powers on points: Remez's exchange."""
    unknowns = len(powers)
    columns = [
        [weight * point**power for power in powers]
        for point, weight in zip(points, weights, strict=True)
    ]
    targets = [weight * value for value, weight in zip(wanted, weights, strict=True)]
    reference = [round(k * (len(points) - 1) / unknowns) for k in range(unknowns + 1)]
    best = Fit((), mpmath.inf)
    for _ in range(_EXCHANGES):
        rows = [[*columns[index], mpf((-1) ** k)] for k, index in enumerate(reference)]
        solution = mpmath.lu_solve(
            mpmath.matrix(rows), mpmath.matrix([targets[index] for index in reference])
        )
        coefficients = [solution[k] for k in range(unknowns)]
        errors = [
            target - mpmath.fdot(row, coefficients)
            for row, target in zip(columns, targets, strict=True)
        ]
        largest = max(abs(error) for error in errors)
        if largest < best.error:
            best = Fit(tuple(coefficients), largest)
        if largest <= abs(solution[unknowns]) * _LEVELLED:
            break
        exchanged = _extremes(errors, unknowns + 1)
        if len(exchanged) <= unknowns or exchanged == reference:
            break
        reference = exchanged
    return best


def fit_polynomial(
    function: Callable[[Any], Any],
    weight: Callable[[Any], Any],
    interval: tuple[Any, Any],
    powers: Sequence[int],
    rounded: Callable[[Any], float],
    *,
    fixed: Mapping[int, float] | None = None,
    goal: Any = mpmath.inf,
) -> Fit:
    """Fit a polynomial whose coefficients are numbers of a format.

    One coefficient after the other is rounded, that of the lowest power first, and the others are
    fitted again.

    Parameters
    ----------
    function, weight
        What to approximate, and what its error is multiplied by.
    interval
        Where.
    powers
        Powers to fit, rising.
    rounded
        Rounds to the format.
    fixed
        Coefficients that are given, by power.
    goal
        If the error is above that before anything is rounded, no coefficients are given.
    """
    points = nodes(*interval, 12 * (len(powers) + 4))
    points = [point for point in points if weight(point)]  # any error there is none
    weights = [weight(point) for point in points]
    wanted = [function(point) for point in points]
    known: dict[int, float] = {}

    def take(power: int, value: float) -> None:
        known[power] = value
        for index, point in enumerate(points):
            wanted[index] -= mpf(value) * point**power

    for power, value in (fixed or {}).items():
        take(power, value)
    free = list(powers)
    while free:
        found = _exchange(points, wanted, weights, free)
        if found.error > goal and len(free) == len(powers):
            return Fit((), found.error)
        take(free.pop(0), rounded(found.coefficients[0]))
    error = max(abs(value * weight) for value, weight in zip(wanted, weights, strict=True))
    return Fit(tuple(known.get(power, 0.0) for power in range(max(known) + 1)), error)


def fit_rational(
    function: Callable[[Any], Any],
    weight: Callable[[Any], Any],
    interval: tuple[Any, Any],
    degrees: tuple[int, int],
) -> tuple[Fit, Fit]:
    """Fit a quotient of polynomials; the divisor begins with 1.

    Least squares, weighted anew with the errors until these are nearly level (Lawson's way).

    Parameters
    ----------
    function, weight
        What to approximate, and what its error is multiplied by.
    interval
        Where.
    degrees
        Of dividend and divisor.

    Returns
    -------
    Fit, Fit
        Dividend and divisor, not rounded, with the same error.
    """
    above, below = degrees
    unknowns = above + 1 + below
    points = nodes(*interval, 8 * unknowns)
    values = [function(point) for point in points]
    weights = [weight(point) for point in points]
    importance = [mpf(1)] * len(points)
    divisors = [mpf(1)] * len(points)
    best: tuple[Any, list[Any]] | None = None
    for _ in range(_REWEIGHTINGS):
        normal = mpmath.matrix(unknowns, unknowns)
        right = mpmath.matrix(unknowns, 1)
        for k, (point, value) in enumerate(zip(points, values, strict=True)):
            scale = importance[k] * (weights[k] / divisors[k]) ** 2
            row = [point**power for power in range(above + 1)]
            row += [-value * point**power for power in range(1, below + 1)]
            for i, first in enumerate(row):
                right[i] += scale * first * value
                for j in range(i + 1):
                    normal[i, j] += scale * first * row[j]
        for i in range(unknowns):
            for j in range(i):
                normal[j, i] = normal[i, j]
        solution = mpmath.lu_solve(normal, right)
        top = [solution[k] for k in range(above + 1)]
        bottom = [mpf(1), *(solution[above + 1 + k] for k in range(below))]
        divisors = [polynomial(bottom, point) for point in points]
        errors = [
            abs((polynomial(top, point) / divisors[k] - values[k]) * weights[k])
            for k, point in enumerate(points)
        ]
        largest = max(errors)
        if best is None or largest < best[0]:
            best = largest, [*top, *bottom]
        total = mpmath.fsum(a * b for a, b in zip(importance, errors, strict=True))
        importance = [a * b / total for a, b in zip(importance, errors, strict=True)]
    assert best is not None
    error, found = best
    return Fit(tuple(found[: above + 1]), error), Fit(tuple(found[above + 1 :]), error)
