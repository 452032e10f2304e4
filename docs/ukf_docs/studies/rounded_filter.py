"""The square-root form as the core computes it, with or without each kind of rounding.

With all roundings to binary32 the estimates are those of the golden model to the last bit; without
any, those of the float64 reference. So a run with some of them tells what these do.

Many runs are computed at once: arrays have the shape (rows, runs, columns), with the columns of
:mod:`ukf_sw.engine.layout`.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ukf_sw.engine.arithmetic import reciprocal_sqrt
from ukf_sw.engine.constants import noise_coefficients, state_coefficients, unit, weights
from ukf_sw.engine.layout import Layout
from ukf_sw.problem import Problem
from ukf_sw.reference import weights as exact_weights
from ukf_sw.spec.float_format import BINARY32
from ukf_sw.spec.parameters import Form

__all__ = ["RoundedFilter", "Roundings"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Spacing of origins: sums of few of them are exact.
GRAIN = 2.0**-8


@dataclass(frozen=True, kw_only=True)
class Roundings:
    """Which numbers of a run are rounded to binary32.

    Parameters
    ----------
    points
        Sigma points of the state, at every addition.
    mean
        Products and sums of the mean of the predicted sigma points.
    state
        Estimate of the state after an update.
    rest
        Everything else: constants, what crosses the bus, residuals, elimination, factor.
    fused
        Whether dot products round the sum of a beat only, as a fused dot product does.
    origin
        Whether the core holds the state less an origin, which the processor adds before the models
        and subtracts after them, and moves with the estimate.
    """

    points: bool = False
    mean: bool = False
    state: bool = False
    rest: bool = False
    fused: bool = False
    origin: bool = False


def _round(values: Array, on: Flags) -> Array:
    """Round to binary32 where it is on."""
    return np.where(on, values.astype(np.float32), values)


class RoundedFilter:
    """Runs of one filter, side by side.

    Parameters
    ----------
    problem
        Filter, of a core with one sensor, the square-root form, binary32 and W0 = 0, that does not
        redraw. Its models take arrays of any shape behind the first axis.
    x0
        First estimate of each run, shape (runs, n).
    roundings
        Of each run.

    Attributes
    ----------
    points_variance
        What rounding the points has added to the variances in the last step, to first order,
        shape (runs, n).
    mean_error
        Error of the predicted mean in the last step, shape (runs, n).

    Raises
    ------
    ValueError
        If the filter is of another kind.
    """

    def __init__(self, problem: Problem, x0: Array, roundings: Sequence[Roundings]) -> None:
        self.problem, self.params = problem, problem.params
        p = self.params
        if (p.form, p.format, p.W0, p.sensors) != (Form.SQUARE_ROOT, BINARY32, 0.0, ()):
            raise ValueError(
                f"problem must have the square-root form, binary32 and W0 = 0, not {p}"
            )
        if problem.redraws:
            raise ValueError(f"redraw must be False, not {problem.redraw!r}")

        def flags(name: str) -> Flags:
            return np.array([[getattr(r, name)] for r in roundings])

        self._points, self._mean, self._state = flags("points"), flags("mean"), flags("state")
        self._rest, self._fused, self._origin = flags("rest"), flags("fused"), flags("origin")
        self._layout = layout = Layout(p)
        beats = -(-layout.columns // p.pes)
        self._width = beats * p.pes
        self._at = slice(*layout.points)
        first, count = p.points.start, len(p.points)
        runs = len(roundings)

        self._weights = np.zeros((1, runs, self._width))
        self._exact_weights = exact_weights(p.M, 0.0)[first:]
        self._weights[..., self._at] = np.where(self._rest, weights(p)[first:], self._exact_weights)
        self._coefficients = np.zeros((p.n, 1, runs, count))
        for j, row in enumerate(state_coefficients(p)):
            self._coefficients[j, ..., : len(row) - first] = _round(row[first:], self._rest)
        per_unit = _round(np.full((runs, 1), 1.0 / unit(p)), self._rest)

        # Additive noise has columns of its own; augmented noise has points.
        LQ, LR = (self._factor(S) for S in (problem.Q, problem.R))
        self._w, self._v = np.zeros((p.q, runs, count)), np.zeros((p.r, runs, count))
        self._LQ, self._LR = np.zeros((p.n, runs, 0)), np.zeros((p.m, runs, 0))
        noise = [self._constant(row[None, first:])[0] for row in noise_coefficients(p)]
        if p.additive_q:
            self._LQ = _round(LQ * per_unit, self._rest)
        else:
            self._w = self._spread(self._w, LQ, noise[: p.q], self._rest)
        if p.additive_r:
            self._LR = _round(LR * per_unit, self._rest)
        else:
            self._v = self._spread(self._v, LR, noise[p.augmented_q :], self._rest)

        self._o = np.where(self._origin, np.round(x0 / GRAIN) * GRAIN, 0.0).T[:, :, None]
        self._x = _round(x0.T[:, :, None] - self._o, self._state)
        self._F = _round(self._factor(problem.P0) * per_unit, self._rest)
        self.points_variance = self.mean_error = np.zeros((runs, p.n))

    def _constant(self, matrix: Array) -> Array:
        """A matrix for every run, shape (rows, runs, columns)."""
        return _round(np.repeat(matrix[:, None], len(self._rest), axis=1), self._rest)

    def _factor(self, covariance: Array) -> Array:
        return self._constant(np.linalg.cholesky(covariance).astype(np.float64))

    @staticmethod
    def _spread(x: Array, factor: Array, coefficients: Iterable[Array], on: Flags) -> Array:
        """Sigma points: x plus a row of coefficients times each column of the factor."""
        x = np.array(x)
        for j, row in enumerate(coefficients):
            x[j:] = _round(x[j:] + _round(factor[j:, :, j, None] * row, on), on)
        return x

    def _row(self, rows: int) -> Array:
        return np.zeros((rows, len(self._rest), self._width))

    def _dot(self, a: Array, b: Array, on: Flags) -> Array:
        """Dot products without the right-hand side: a tree for each beat, then the beats."""
        each = on & ~self._fused
        terms = _round(a * b, each)
        terms[..., self._layout.rhs] = 0.0
        terms = terms.reshape(*terms.shape[:2], -1, self.params.pes)
        each, on = each[..., None], on[..., None]
        while (count := terms.shape[-1]) > 1:
            even = count - count % 2
            sums = _round(terms[..., 0:even:2] + terms[..., 1:even:2], each)
            terms = np.concatenate((sums, terms[..., even:]), axis=-1)
        total = np.zeros_like(terms[:, :, 0])
        for beat in range(terms.shape[2]):
            total = _round(total + _round(terms[:, :, beat], on[..., 0]), on[..., 0])
        return total

    def _reciprocal_sqrt(self, d: Array) -> Array:
        rounded = reciprocal_sqrt(BINARY32, np.where(self._rest, d, 1.0))
        return np.where(self._rest, rounded, 1.0 / np.sqrt(d))

    @property
    def x(self) -> Array:
        """Estimates, shape (runs, n)."""
        return (self._x + self._o)[..., 0].T

    @property
    def deviations(self) -> Array:
        """Standard deviations that the filter believes in, shape (runs, n)."""
        return unit(self.params) * np.sqrt((self._F**2).sum(axis=2)).T

    def step(self, u: Array, z: Array) -> None:
        """Predict and update.

        Parameters
        ----------
        u
            Input of each run, shape (runs, inputs).
        z
            Observation of each run, shape (runs, m).
        """
        p, at, rhs = self.params, self._at, self._layout.rhs
        rest, m = self._rest, p.m
        X = np.repeat(self._x, len(p.points), axis=2)
        X = self._spread(X, self._F, self._coefficients, self._points)
        self._judge_points(X)

        # Predict. Its residuals stand below those of the observations.
        E = self._row(m + p.n)
        E[m:, :, at] = self.problem.f(X + self._o, self._w, u.T[:, :, None]) - self._o
        E[m:] = _round(E[m:], rest)
        X = np.array(E[m:, :, at])
        exact = (self._weights[..., at] * X).sum(axis=2)
        mean = _round(self._dot(E[m:], self._weights, self._mean), self._mean)
        self.mean_error = (mean[..., 0] - exact).T
        E[m:, :, at] = _round(X - mean, rest)
        E[m:, :, rhs] = -mean[..., 0]
        E[m:, :, slice(*self._layout.noise_q)] = self._LQ

        # Update.
        h = self.problem.sensor(self.problem.sensor_names[0]).h
        E[:m, :, at] = _round(np.asarray(h(X + self._o, self._v)), rest)
        z_mean = self._dot(E[:m], self._weights, rest)
        E[:m, :, at] = _round(E[:m, :, at] - z_mean, rest)
        E[:m, :, rhs] = _round(_round(z.T[:, :, None], rest) - z_mean, rest)[..., 0]
        E[:m, :, slice(*self._layout.noise_r)] = self._LR
        for j in range(m + p.n):
            d = self._dot(E[j:], E[j], rest)
            root = self._reciprocal_sqrt(d[0])
            L = _round(d * root, rest)
            pivot = _round(E[j] * root, rest)
            E[j + 1 :] = _round(E[j + 1 :] - _round(L[1:] * pivot, rest), rest)
            if j == m - 1:
                self._x = _round(-E[m:, :, rhs, None], self._state)
            if j >= m:
                self._F[j - m :, :, j - m] = L[..., 0]
        self._F *= np.tri(p.n)[:, None]
        self._move_origin()

    def _judge_points(self, X: Array) -> None:
        """Compare the points with what they would be without rounding."""
        exact = np.einsum("irj,jorc->irc", self._F, self._coefficients)
        off = (X - self._x) - exact
        variance = (self._exact_weights * off * exact).sum(axis=2)
        self.points_variance = 2.0 * variance.T

    def _move_origin(self) -> None:
        """Move the origin by a multiple of the spacing, which changes no bit of the state."""
        far = self._origin & (np.abs(self._x) > 2.0 * GRAIN)
        move = np.where(far, np.round(self._x / GRAIN) * GRAIN, 0.0)
        self._o, self._x = self._o + move, self._x - move
