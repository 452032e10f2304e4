"""Polynomials and constants of the elementary functions, for the number formats that have them.

``make coefficients`` makes the file of this folder; see :mod:`ukf_docs.coefficients`.
"""

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from ukf_sw.spec.float_format import FloatFormat

__all__ = ["Coefficients", "coefficients"]


@dataclass(frozen=True, kw_only=True)
class Coefficients:
    """Coefficients for one format, all of them numbers of it; those of polynomials rise.

    Parameters
    ----------
    turn_bits
        Sine and cosine take arguments below ``pi * 2**turn_bits``.
    angle_scale
        1; in formats with a narrow range, what angles are multiplied with while they are reduced.
    half_pi
        Parts that sum to pi/2 times the scale. Products of all but the last with a number of
        quarter turns are exact. One of them is negative.
    ln_2
        Parts that sum to ln 2 times the step of :func:`ukf_sw.spec.forms.exponent_step`.
        Products of all but the last with an exponent, in these steps, are exact.
    sine, quarter_sine, tangent, arcsine, arctangent
        P, with z = r * r: the function is ``r + r * z * P(z)``; up to pi/2, pi/4, pi/4, 1/2 and 1.
    quarter_cosine
        P: cosine is ``1 + z * P(z)``, up to pi/4.
    exponential
        P: ``2 * exp(r) = P(r)``, or with a step of 2, ``exp(r) = P(r)``; as far as r goes.
    logarithm
        P: ``log(1 + f) = f + f * f * P(f)``, between the middles of two powers of two.
    tanh_dividend, tanh_divisor
        P and Q: ``tanh(x / 2) = x * P(z) / Q(z) / 2``, with z = x * x, below `tanh_limit`.
    tanh_limit
        From here on the hyperbolic tangent is 1.
    """

    turn_bits: int
    angle_scale: float
    half_pi: tuple[float, ...]
    ln_2: tuple[float, ...]
    sine: tuple[float, ...]
    quarter_sine: tuple[float, ...]
    quarter_cosine: tuple[float, ...]
    tangent: tuple[float, ...]
    arcsine: tuple[float, ...]
    arctangent: tuple[float, ...]
    exponential: tuple[float, ...]
    logarithm: tuple[float, ...]
    tanh_dividend: tuple[float, ...]
    tanh_divisor: tuple[float, ...]
    tanh_limit: float


@cache
def _records() -> dict[str, dict[str, int | str | list[str]]]:
    return json.loads(files(__name__).joinpath("coefficients.json").read_text(encoding="utf-8"))


@cache
def coefficients(fmt: FloatFormat) -> Coefficients:
    """Give the coefficients for a format.

    Raises
    ------
    ValueError
        If there are none.
    """
    records = _records()
    if fmt.name not in records:
        known = ", ".join(records)
        raise ValueError(
            f"format of elementary functions must be one of {known}, or "
            f"`make coefficients FORMATS={fmt.name}` makes theirs; not {fmt.name!r}"
        )

    def number(value: int | str | list[str]) -> int | float | tuple[float, ...]:
        if isinstance(value, list):
            return tuple(float.fromhex(text) for text in value)
        return value if isinstance(value, int) else float.fromhex(value)

    fields: dict[str, object] = {name: number(value) for name, value in records[fmt.name].items()}
    return Coefficients(**fields)  # pyright: ignore[reportArgumentType]
