"""Makes the coefficients of the elementary functions: ``python -m ukf_docs coefficients``.

Polynomials are minimax (see :mod:`ukf_docs.minimax`) and as short as the precision of the format
allows. The reduction of angles is tried on the numbers that lie nearest to each multiple of pi/2.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
from mpmath import mpf

from ukf_docs.minimax import PRECISION, fit_polynomial, fit_rational
from ukf_docs.studies.study import Tell
from ukf_sw.elementary.primitives import is_narrow
from ukf_sw.engine import arithmetic
from ukf_sw.spec.float_format import FORMATS, FloatFormat
from ukf_sw.spec.forms import exponent_step

__all__ = [
    "FILE",
    "dump",
    "make_coefficients",
    "make_polynomials",
    "make_reduction",
    "make_tanh",
    "refresh",
]

FILE = Path(__file__).parents[2] / "sw/ukf_sw/elementary/coefficients/coefficients.json"

#: Largest error of a reduced angle, in units in the last place.
_ANGLE_ERROR = 0.75
#: More turns than that are nobody's angle.
_MOST_TURN_BITS = 13
_MOST_TERMS = 40


def round_exactly(fmt: FloatFormat, value: Any) -> float:
    """Round a number of mpmath to a format, to nearest, within the range of normal numbers."""
    with mpmath.workprec(fmt.precision):
        return float(+mpf(value))


def _split(fmt: FloatFormat, value: Any, count: int, bits: int, *, up: bool) -> tuple[float, ...]:
    """Give parts that sum to a number; all but the last have few bits.

    up: the first is larger than the number, so that one of the others is negative.
    """
    parts: list[float] = []
    for number in range(count - 1):
        scale = mpf(2) ** (bits - 1 - int(mpmath.floor(mpmath.log(abs(value), 2))))
        rounded = mpmath.ceil if up and number == 0 else mpmath.nint
        parts.append(float(rounded(value * scale) / scale))
        value -= mpf(parts[-1])
    return (*parts, round_exactly(fmt, value))


def _angle_error(fmt: FloatFormat, parts: tuple[float, ...], scale: float, turns: int) -> float:
    """Give the largest error of a reduced angle, beside all multiples of pi/2 up to a number."""
    k = np.arange(1, turns + 1, dtype=np.float64)
    exact = [mpmath.pi / 2 * int(number) for number in k]
    x = np.array([round_exactly(fmt, value) for value in exact])
    r = x * scale
    for part in parts:
        r = arithmetic.add(fmt, r, -arithmetic.multiply(fmt, k, part))
    worst = 0.0
    for angle, multiple, found in zip(x, exact, r / scale, strict=True):
        left = mpf(float(angle)) - multiple
        unit = mpf(2) ** (int(mpmath.floor(mpmath.log(abs(left), 2))) - fmt.fraction_bits)
        worst = max(worst, float(abs(left - mpf(float(found))) / unit))
    return worst


def make_reduction(fmt: FloatFormat) -> dict[str, Any]:
    """Give how many turns are reduced well, and with which parts of pi/2."""
    for bits in range(min(fmt.fraction_bits - 3, _MOST_TURN_BITS), 0, -1):
        # No angle is 4 * 2**bits or more; the smallest parts have to be normal numbers.
        scale = 2.0 ** (fmt.bias - bits - 2) if is_narrow(fmt) else 1.0
        kept = fmt.precision - bits - 1
        if kept < 2:
            continue
        parts = _split(fmt, mpmath.pi / 2 * scale, 3, kept, up=True)
        if _angle_error(fmt, parts, scale, 1 << (bits + 1)) <= _ANGLE_ERROR:
            return {"turn_bits": bits, "angle_scale": scale, "half_pi": parts}
    raise ValueError(f"format must be one in which angles can be reduced, not {fmt.name!r}")


def _shortest(
    fmt: FloatFormat,
    function: Callable[[Any], Any],
    weight: Callable[[Any], Any],
    interval: tuple[Any, Any],
    fixed: float | None = None,
) -> tuple[float, ...]:
    """Give the shortest polynomial that is good enough; fixed: its first coefficient."""
    # A third of a unit in the last place, and half a unit when coefficients are rounded.
    goal = mpf(2) ** -(fmt.precision + mpf(1.5))
    first = 0 if fixed is None else 1
    for count in range(max(1, fmt.fraction_bits // 9), _MOST_TERMS):
        found = fit_polynomial(
            function, weight, interval, range(first, first + count),
            lambda value: round_exactly(fmt, value),
            fixed=None if fixed is None else {0: fixed}, goal=goal,
        )  # fmt: skip
        if found.coefficients and found.error < mpf(2) ** -(fmt.precision + 1):
            return found.coefficients
    raise ValueError(f"format must be one with short polynomials, not {fmt.name!r}")


def _odd(
    fmt: FloatFormat, function: Callable[[Any], Any], limit: Any, series: tuple[Any, Any]
) -> tuple[float, ...]:
    """Give P of an odd function r + r * z * P(z), relative to it; series: of P, at zero."""

    def of_square(z: Any) -> Any:
        if z < mpf(2) ** -60:
            return series[0] + series[1] * z
        r = mpmath.sqrt(z)
        return (function(r) / r - 1) / z

    def weight(z: Any) -> Any:
        r = mpmath.sqrt(z)
        return z * r / function(r) if z else mpf(0)

    return _shortest(fmt, of_square, weight, (mpf(0), limit**2))


def _cosine(fmt: FloatFormat, limit: Any) -> tuple[float, ...]:
    def of_square(z: Any) -> Any:
        return (mpmath.cos(mpmath.sqrt(z)) - 1) / z if z else mpf(-1) / 2

    return _shortest(fmt, of_square, lambda z: z, (mpf(0), limit**2), -0.5)


def _exponential(fmt: FloatFormat, limit: Any, factor: int) -> tuple[float, ...]:
    def function(r: Any) -> Any:
        return factor * mpmath.exp(r)

    return _shortest(fmt, function, lambda r: 1 / function(r), (-limit, limit), float(factor))


def _logarithm(fmt: FloatFormat, low: Any, high: Any) -> tuple[float, ...]:
    def function(f: Any) -> Any:
        if abs(f) < mpf(2) ** -50:
            return mpf(-1) / 2 + f / 3 - f * f / 4
        return (mpmath.log1p(f) / f - 1) / f

    def weight(f: Any) -> Any:
        return f * f / mpmath.log1p(f) if f else mpf(0)

    return _shortest(fmt, function, weight, (low, high), -0.5)


def make_tanh(fmt: FloatFormat) -> dict[str, Any]:
    """Make what the hyperbolic tangent has.

    With t = tanh(x / 2) it is ``2 * t / (1 + t * t)``, which makes errors of t small where t is
    large: so the quotient of polynomials that is t may be short.
    """
    # Beyond, the function rounds to 1.
    limit = round_exactly(fmt, mpmath.atanh(1 - mpf(2) ** -(fmt.precision + 2)))

    def function(z: Any) -> Any:
        return mpmath.tanh(mpmath.sqrt(z)) / mpmath.sqrt(z) if z else mpf(1)

    def weight(z: Any) -> Any:
        t = mpmath.tanh(mpmath.sqrt(z))
        return (1 - t * t) / (1 + t * t) / function(z)

    for terms in range(1, _MOST_TERMS):
        degrees = (terms // 2, terms - terms // 2)
        found = fit_rational(function, weight, (mpf(0), (mpf(limit) / 2) ** 2), degrees)
        if found[0].error < mpf(2) ** -(fmt.precision + 1):
            # Of z = x * x instead of that of x / 2. Their quotient stays what it is if both are
            # multiplied by 7/4, but numbers below a power of two are rounded more finely than those
            # above.
            dividend, divisor = (
                tuple(
                    round_exactly(fmt, c * mpf(1.75) / 4**k)
                    for k, c in enumerate(side.coefficients)
                )
                for side in found
            )
            return {"tanh_dividend": dividend, "tanh_divisor": divisor, "tanh_limit": limit}
    raise ValueError(f"format must be one with short polynomials, not {fmt.name!r}")


def make_polynomials(fmt: FloatFormat, turn_bits: int, names: Iterable[str]) -> dict[str, Any]:
    """Make some of the polynomials.

    Parameters
    ----------
    fmt
        Number format.
    turn_bits
        Bits of the number of turns of an angle.
    names
        Fields of :class:`ukf_sw.elementary.coefficients.Coefficients`.
    """
    unit = mpf(2) ** -fmt.fraction_bits
    # The number of periods is rounded from a number that is wrong by a rounding or two.
    reduced = 1 + 2 * mpf(2) ** (turn_bits + 1) * unit
    step = exponent_step(fmt)
    exponents = mpf(2) ** (fmt.exponent_bits - 1) / step
    factor = round_exactly(fmt, 1 / (step * mpmath.log(2)))
    wrong = unit + 2 * abs(factor * step * mpmath.log(2) - 1)
    exponential_limit = step * mpmath.log(2) / 2 * (1 + exponents * wrong)
    root = mpmath.sqrt(mpf(2)) if step == 1 else mpf(2)

    quarter = mpmath.pi / 4 * reduced
    one, sine = mpf(1), (mpf(-1) / 6, mpf(1) / 120)
    makers: dict[str, Callable[[], tuple[float, ...]]] = {
        "sine": lambda: _odd(fmt, mpmath.sin, 2 * quarter, sine),
        "quarter_sine": lambda: _odd(fmt, mpmath.sin, quarter, sine),
        "quarter_cosine": lambda: _cosine(fmt, quarter),
        "tangent": lambda: _odd(fmt, mpmath.tan, quarter, (one / 3, 2 * one / 15)),
        "arcsine": lambda: _odd(fmt, mpmath.asin, (1 + unit) / 2, (one / 6, 3 * one / 40)),
        "arctangent": lambda: _odd(fmt, mpmath.atan, 1 + 4 * unit, (-one / 3, one / 5)),
        "exponential": lambda: _exponential(fmt, exponential_limit, 2 // step),
        "logarithm": lambda: _logarithm(fmt, (1 - 2 * unit) / root - 1, root * (1 + 2 * unit) - 1),
    }
    return {name: makers[name]() for name in names}


def make_coefficients(fmt: FloatFormat) -> dict[str, Any]:
    """Make the fields of :class:`ukf_sw.elementary.coefficients.Coefficients` for a format.

    Raises
    ------
    ValueError
        If its fraction or its exponent is too short.
    """
    step = exponent_step(fmt)
    if step > 2:
        raise ValueError(
            f"format must be one with exponents that its fraction can count, not {fmt.name!r}"
        )
    with mpmath.workprec(PRECISION):
        record = make_reduction(fmt)
        # Exponents, or halves of them, are at most a power of two.
        bits = fmt.precision - (fmt.exponent_bits - step)
        count = 2 if bits >= 5 else 3
        record["ln_2"] = _split(fmt, step * mpmath.log(2), count, max(bits, 1), up=False)
        names = (
            "sine", "quarter_sine", "quarter_cosine", "tangent", "arcsine", "arctangent",
            "exponential", "logarithm",
        )  # fmt: skip
        return {**record, **make_polynomials(fmt, record["turn_bits"], names), **make_tanh(fmt)}


def dump(records: Mapping[str, Mapping[str, Any]]) -> str:
    """Write coefficients as text: numbers as hexadecimal fractions, so exactly."""

    def text(value: Any) -> Any:
        if isinstance(value, tuple | list):
            return [text(number) for number in value]
        return value.hex() if isinstance(value, float) else value

    found = {
        name: {field: text(value) for field, value in record.items()}
        for name, record in records.items()
    }
    return json.dumps(found, indent=1) + "\n"


def refresh(file: Path, formats: Iterable[FloatFormat], tell: Tell) -> None:
    """Make coefficients for some formats, and write them to a file; others there stay.

    Raises
    ------
    ValueError
        If a format cannot have any; the file is then as it was.
    """
    formats = list(formats)
    records = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    for k, fmt in enumerate(formats):
        tell(fmt.name, k, len(formats))
        records[fmt.name] = make_coefficients(fmt)
    usual = [name for name in FORMATS if name in records]
    others = sorted(name for name in records if name not in FORMATS)
    file.write_text(dump({name: records[name] for name in usual + others}), encoding="utf-8")
