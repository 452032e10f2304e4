"""How accurate the elementary functions are: measured against MPFR, on hostile points."""

from collections.abc import Callable, Mapping, Sequence
from math import inf, isinf, isnan, log, nan, pi
from pathlib import Path
from typing import Any

import gmpy2 as untyped_gmpy2
import numpy as np
from numpy.typing import NDArray

from ukf_docs import DOCS
from ukf_docs.markdown import table
from ukf_docs.studies.study import Study, Tell
from ukf_sw.elementary import accuracy
from ukf_sw.elementary.functions import FUNCTIONS, sequence
from ukf_sw.elementary.sequence import SequenceBuilder
from ukf_sw.elementary.trigonometric import angle_limit
from ukf_sw.spec.float_format import BINARY32, FORMATS, FloatFormat
from ukf_sw.spec.forms import exponent_step

__all__ = [
    "DOMAINS",
    "EXACT",
    "STUDY",
    "arguments_of",
    "errors",
    "every_number",
    "exact_table",
    "is_inside",
    "measure",
    "measure_function",
    "points",
    "worst",
]

_Numbers = NDArray[np.float64]

gmpy2: Any = untyped_gmpy2

#: Points of each kind; there are some seven kinds.
COUNT = 100_000
#: Points that are compared with MPFR, of formats that are shorter than float64.
_LOOKED_AT = 4_000
#: Exponents ``y * log(x)`` of the powers that are measured: the error grows with them.
POWER_LIMIT = 10.0

_WIDE = gmpy2.context(precision=160, emin=-(1 << 24), emax=1 << 24)


def _reciprocal(x: Any) -> Any:
    return _WIDE.div(gmpy2.mpfr(1), x)


#: What should come out, by function: one exact function for every result.
EXACT: Mapping[str, tuple[Callable[..., Any], ...]] = {
    "reciprocal": (_reciprocal,),
    "divide": (_WIDE.div,),
    "sqrt": (_WIDE.sqrt,),
    "hypot": (_WIDE.hypot,),
    "sin": (_WIDE.sin,),
    "cos": (_WIDE.cos,),
    "sincos": (_WIDE.sin, _WIDE.cos),
    "tan": (_WIDE.tan,),
    "arcsin": (_WIDE.asin,),
    "arccos": (_WIDE.acos,),
    "arctan": (_WIDE.atan,),
    "arctan2": (_WIDE.atan2,),
    "exp": (_WIDE.exp,),
    "log": (_WIDE.log,),
    "power": (_WIDE.pow,),
    "tanh": (_WIDE.tanh,),
}


def _one(function: Callable[..., _Numbers]) -> Callable[..., tuple[_Numbers, ...]]:
    return lambda *arguments: (function(*arguments),)


#: The same in float64, which is enough to find where errors of shorter formats are large.
_ROUGHLY: Mapping[str, Callable[..., tuple[_Numbers, ...]]] = {
    "reciprocal": lambda x: (1.0 / x,),
    "sincos": lambda x: (np.sin(x), np.cos(x)),
    **{
        name: _one(getattr(np, name))
        for name in (
            "divide", "sqrt", "hypot", "sin", "cos", "tan", "arcsin", "arccos", "arctan",
            "arctan2", "exp", "log", "power", "tanh",
        )
    },
}  # fmt: skip
_PERIODIC = ("sin", "cos", "sincos", "tan")


def is_inside(name: str, fmt: FloatFormat, arguments: Sequence[_Numbers]) -> NDArray[np.bool_]:
    """Whether arguments are in the domain of a function; elsewhere it may be NaN."""
    last = np.abs(arguments[-1])
    everywhere = np.ones(last.shape, dtype=np.bool_)
    if name in ("reciprocal", "divide", "arctan"):
        return (last < 2.0 ** (fmt.bias - 1)) | np.isinf(last)
    if name == "sqrt":
        return np.isfinite(last)
    if name in ("hypot", "arctan2"):
        return ~(np.isinf(arguments[0]) & np.isinf(last))
    if name in _PERIODIC:
        return last < angle_limit(fmt)
    if name == "log":
        return last < (fmt.max_finite / 2.0**0.5 if exponent_step(fmt) == 1 else inf)
    if name == "power":
        base, exponent = arguments
        below = is_inside("log", fmt, [base]) & (base >= 0.0)
        undefined = np.isinf(exponent) & (base == 1.0) | (base == 0.0) & (exponent == 0.0)
        return below & ~undefined
    return everywhere


def _error(fmt: FloatFormat, exact: Any, found: float, *, inside: bool, early: float) -> float:
    """Give an error in units in the last place of what is exact."""
    if isnan(found):
        return 0.0 if gmpy2.is_nan(exact) or not inside else inf
    if gmpy2.is_nan(exact):
        return inf
    if isinf(found) or gmpy2.is_infinite(exact):
        beyond = abs(exact) >= fmt.max_finite * (1.0 - 4.0 * fmt.epsilon)
        agree = gmpy2.is_signed(exact) == (found < 0.0)
        return 0.0 if isinf(found) and beyond and agree else inf
    smallest = fmt.min_normal * early
    if found == 0.0 and abs(exact) < smallest * (1.0 + 4.0 * fmt.epsilon):
        return 0.0
    if exact == 0:
        return abs(found) / fmt.min_normal
    exponent = max(gmpy2.get_exp(exact) - 1, 1 - fmt.bias)
    with gmpy2.context(_WIDE):
        return float(abs(exact - gmpy2.mpfr(found)) / gmpy2.exp2(exponent - fmt.fraction_bits))


def errors(name: str, fmt: FloatFormat, *arguments: _Numbers) -> _Numbers:
    """Give the error of every point, in units in the last place of the exact result.

    It is infinite where the result is NaN within the domain, or a number where there is none, and
    zero where a result outside of the domain is NaN.
    """
    inside = is_inside(name, fmt, arguments)
    largest = np.zeros(arguments[0].shape)
    # Results of an exponential may be zero from a little earlier on than they would have to; where
    # that is depends on the errors of a power.
    early = 2.0**0.5 if name in ("exp", "power") and exponent_step(fmt) == 1 else 1.0
    early *= 1.0 + 64.0 * fmt.epsilon if name == "power" else 1.0
    results = sequence(name, fmt).evaluate(*arguments)
    rows = list(zip(*(argument.tolist() for argument in arguments), strict=True))
    for function, result in zip(EXACT[name], results, strict=True):
        for k, (row, found) in enumerate(zip(rows, result.tolist(), strict=True)):
            # Unlike here, NaN to the power of zero is 1 there, and there is more of that kind.
            has_nan = any(map(isnan, row))
            exact = function(*(gmpy2.mpfr(nan if has_nan else value) for value in row))
            error = _error(fmt, exact, found, inside=bool(inside[k]), early=early)
            largest[k] = max(largest[k], error)
    return largest


def every_number(fmt: FloatFormat) -> _Numbers:
    """Give all numbers of a format of few bits, NaN once."""
    numbers = fmt.decode(np.arange(1 << fmt.width))
    is_tiny = (numbers == 0.0) & (np.arange(1 << fmt.width) % (1 << (fmt.width - 1)) != 0)
    return np.append(numbers[~is_tiny & ~np.isnan(numbers)], np.nan)


def _neighbours(fmt: FloatFormat, values: _Numbers) -> _Numbers:
    """Give numbers, and those beside them."""
    near = [fmt.round(values * (1.0 + step * fmt.epsilon)) for step in (-2, -1, 0, 1, 2)]
    return np.concatenate(near)


def _one_argument(name: str, fmt: FloatFormat, count: int, rng: np.random.Generator) -> _Numbers:
    """Give points for a function of one argument: hostile ones, and random ones of some kinds."""
    exponents = np.arange(1 - fmt.bias, fmt.bias + 1, dtype=np.float64)
    hostile = [np.exp2(exponents), np.array([0.0, fmt.max_finite, inf, np.nan])]
    kinds = [np.exp2(rng.uniform(1 - fmt.bias, fmt.bias + 1, count)), rng.uniform(0.0, 8.0, count)]
    if name in _PERIODIC:
        # Zeros and poles, and where reductions change; beyond the limit as well.
        turns = np.arange(1, int(angle_limit(fmt) * 8.0 / pi) + 9)
        turns = rng.choice(turns, min(turns.size, count), replace=False)
        hostile.append(turns * (pi / 4.0))
        kinds.append(rng.uniform(0.0, angle_limit(fmt) * 1.02, count))
        kinds.append(np.exp2(rng.uniform(-fmt.precision, 2.0, count)))
    elif name in ("arcsin", "arccos"):
        kinds = [rng.uniform(0.0, 1.0, count), np.exp2(rng.uniform(-fmt.precision, 0.1, count))]
        kinds.append(1.0 - np.exp2(rng.uniform(-fmt.precision, 0.0, count)))
        hostile.append(np.array([0.25, 0.5, 1.0]))
    elif name in ("exp", "tanh"):
        largest = 0.7 * fmt.bias
        kinds.append(rng.uniform(0.0, largest, count))
        kinds.append(np.exp2(rng.uniform(-fmt.precision, 1.0, count)))
        hostile.append((np.arange(2 * fmt.bias + 4) + 0.5) * np.log(2.0))
        hostile.append(np.arange(2 * fmt.bias + 4) * np.log(2.0))
    else:
        kinds.append(1.0 + np.exp2(rng.uniform(-fmt.fraction_bits, 0.0, count)))
        kinds.append(1.0 - np.exp2(rng.uniform(-fmt.precision, -1.0, count)))
        kinds.append(rng.uniform(1.0, 4.0, count))
        hostile.append(np.exp2(exponents) * 2.0**0.5)
    values = np.concatenate([_neighbours(fmt, np.concatenate(hostile)), *map(fmt.round, kinds)])
    return np.concatenate([values, -values])


def _two_arguments(
    name: str, fmt: FloatFormat, count: int, rng: np.random.Generator
) -> list[_Numbers]:
    """Give points for a function of two arguments."""

    def signs() -> _Numbers:
        return rng.choice([-1.0, 1.0], count)

    if name == "power":
        base = np.exp2(rng.uniform(1 - fmt.bias, fmt.bias + 0.4, 2 * count))
        base[:count] = rng.uniform(0.3, 3.0, count)
        base = fmt.round(base)
        base = np.where(base == 1.0, 2.0, base)
        exponent = rng.uniform(-POWER_LIMIT, POWER_LIMIT, 2 * count) / np.log(base)
        return [base, fmt.round(np.clip(exponent, -(2.0**fmt.bias), 2.0**fmt.bias))]
    low, high = 1 - fmt.bias, fmt.bias + 1
    wide = np.exp2(rng.uniform(low, high, (2, count)))
    near = np.exp2(rng.uniform(-3.0, 3.0, (2, count)))
    # A quotient that is a number, of any size.
    other = wide[0] * np.exp2(rng.uniform(low, high, count))
    related = np.array([np.clip(other, fmt.min_normal, fmt.max_finite), wide[0]])
    close = np.array([wide[1], np.clip(wide[1] * near[0], 0.0, fmt.max_finite)])
    kinds = [wide, near, related, close, rng.uniform(1.0, 2.0, (2, count))]
    pairs = np.concatenate([fmt.round(kind) * [signs(), signs()] for kind in kinds], axis=1)
    special = fmt.round([0.0, fmt.min_normal, 1.0, 2.0 ** (fmt.bias - 1), fmt.max_finite, inf])
    special = np.concatenate([special, -special, [np.nan]])
    grid = np.array([(a, b) for a in special for b in special]).T
    return list(np.concatenate([grid, pairs], axis=1))


def points(name: str, fmt: FloatFormat, count: int, rng: np.random.Generator) -> list[_Numbers]:
    """Give arguments of a function, of all sizes, where it is hard, and where it is not defined.

    Parameters
    ----------
    name
        Function.
    fmt
        Number format.
    count
        Random points of each of a few kinds.
    rng
        Generator of random numbers.
    """
    # Some are infinite because they overflow.
    with np.errstate(over="ignore"):
        if FUNCTIONS[name].arguments == 1:
            return [_one_argument(name, fmt, count, rng)]
        return _two_arguments(name, fmt, count, rng)


def _suspects(name: str, fmt: FloatFormat, arguments: Sequence[_Numbers]) -> list[_Numbers]:
    """Give the points whose errors are largest as float64 sees them, and others, taken evenly.

    Formats as precise as float64 have all their points looked at.
    """
    if fmt.precision > 40 or arguments[0].size <= _LOOKED_AT:
        return list(arguments)
    rough = np.zeros(arguments[0].shape)
    with np.errstate(all="ignore"):
        expected = _ROUGHLY[name](*arguments)
        for value, found in zip(expected, sequence(name, fmt).evaluate(*arguments), strict=True):
            unit = np.exp2(np.floor(np.log2(np.abs(value))))
            # What is flushed or overflows is among those that are taken evenly.
            is_usual = (np.abs(value) > 2.0 * fmt.min_normal) & (np.abs(value) < fmt.max_finite)
            error = np.where(is_usual & np.isfinite(found), np.abs(found - value) / unit, 0.0)
            rough = np.maximum(rough, error)
    order = np.argsort(rough)[::-1]
    half = _LOOKED_AT // 2
    chosen = np.concatenate([order[:half], order[half :: order.size // half]])
    return [argument[chosen] for argument in arguments]


def worst(name: str, fmt: FloatFormat, arguments: Sequence[_Numbers]) -> tuple[float, list[float]]:
    """Give the largest error on some points, and where it is.

    Of many points, those are looked at where it may be.
    """
    looked_at = _suspects(name, fmt, arguments)
    found = errors(name, fmt, *looked_at)
    k = int(np.argmax(found))
    return float(found[k]), [float(argument[k]) for argument in looked_at]


#: Domains, for the table; L is a limit of each format.
DOMAINS = {
    "reciprocal": "abs(x) < B, or infinite; 1/0 is infinite",
    "divide": "abs(y) < B, or infinite; x/0 is infinite, 0/0 is NaN",
    "sqrt": "0 <= x, finite",
    "hypot": "not both infinite",
    "sin": "abs(x) < L",
    "cos": "abs(x) < L",
    "sincos": "abs(x) < L",
    "tan": "abs(x) < L",
    "arcsin": "abs(x) <= 1",
    "arccos": "abs(x) <= 1",
    "arctan": "abs(x) < B, or infinite",
    "arctan2": "not both infinite; zeros as usual",
    "exp": "everywhere; 0 below E",
    "log": "0 <= x <= G; log(0) is minus infinity",
    "power": "0 < x <= G; 0, but not to the power 0",
    "tanh": "everywhere",
}


def _bounds(fmt: FloatFormat) -> Mapping[str, float]:
    """Give the limits that domains name."""
    step = exponent_step(fmt)
    return {
        "L": angle_limit(fmt),
        "B": 2.0 ** (fmt.bias - 1),
        "E": log(fmt.min_normal) + (log(2.0) / 2.0 if step == 1 else 0.0),
        "G": fmt.max_finite / 2.0**0.5 if step == 1 else fmt.max_finite,
    }


def arguments_of(
    name: str, fmt: FloatFormat, count: int, rng: np.random.Generator
) -> list[_Numbers]:
    """Give all numbers, where a format has few and the function one argument; else points."""
    if fmt.width <= 16 and FUNCTIONS[name].arguments == 1:
        return [every_number(fmt)]
    return points(name, fmt, count, rng)


def measure_function(name: str, fmt: FloatFormat, count: int = COUNT) -> dict[str, float]:
    """Measure slots and the largest error of a function.

    Parameters
    ----------
    name
        Function.
    fmt
        Number format.
    count
        Points of each kind; fewer of a format as precise as float64, as all go through MPFR.
    """
    many = count if fmt.precision < 40 else count // 12
    error, _ = worst(name, fmt, arguments_of(name, fmt, many, np.random.default_rng(0)))
    steps = sequence(name, fmt)
    return {"slots": steps.slots, "loads": steps.loads, "error": round(error, 3)}


def measure(tell: Tell) -> dict[str, dict[str, dict[str, float]]]:
    """Measure slots and largest errors, by function and format."""
    record: dict[str, dict[str, dict[str, float]]] = {}
    for k, name in enumerate(EXACT):
        record[name] = {}
        for i, (format_name, fmt) in enumerate(FORMATS.items()):
            tell(f"{name}, {format_name}", k * len(FORMATS) + i, len(EXACT) * len(FORMATS))
            record[name][format_name] = measure_function(name, fmt)
    return record


def _slots(slots: int, loads: int) -> str:
    streams = {0: "", 1: " + N"}.get(loads, f" + {loads} N")
    return f"{slots}{streams}"


def _table(record: Mapping[str, Mapping[str, Mapping[str, float]]]) -> str:
    rows: list[tuple[str, ...]] = []
    for name, measured in record.items():
        cells = [
            f"{_slots(int(found['slots']), int(found['loads']))}; {found['error']:.2f}"
            for found in (measured[format_name] for format_name in FORMATS)
        ]
        rows.append((f"`{name}`", *cells, DOMAINS[name]))
    bounds = [_bounds(fmt) for fmt in FORMATS.values()]
    rows += [(letter, *(f"{bound[letter]:.4g}" for bound in bounds), "") for letter in bounds[0]]
    return table(("function", *FORMATS, "domain"), rows, left=6)


#: Functions that are exact, by the documents' rows, with arguments that are constants there.
_EXACT_ROWS: tuple[tuple[str, tuple[float | None, ...]], ...] = (
    ("absolute", (None,)),
    ("copysign", (None, None)),
    ("sign", (None,)),
    ("rint", (None,)),
    ("floor", (None,)),
    ("ceil", (None,)),
    ("minimum", (None, 1.0)),
    ("minimum", (None, None)),
    ("maximum", (None, 1.0)),
    ("maximum", (None, None)),
    ("clip", (None, -1.0, 1.0)),
    ("clip", (None, None, None)),
    ("where", (None, None, None)),
    ("less", (None, 1.0)),
    ("less", (None, None)),
    ("less_equal", (None, 1.0)),
    ("less_equal", (None, None)),
    ("equal", (None, 1.0)),
    ("equal", (None, None)),
    ("not_equal", (None, 1.0)),
    ("not_equal", (None, None)),
    ("logical_and", (None, None)),
    ("logical_or", (None, None)),
    ("logical_not", (None,)),
)


def exact_table() -> str:
    """Make the table of slots of the functions that are exact."""
    rows: list[tuple[str, str]] = []
    for name, constants in _EXACT_ROWS:
        builder = SequenceBuilder(BINARY32)
        letters = iter("xyz")
        given = [
            builder.input() if value is None else builder.constant(value) for value in constants
        ]
        FUNCTIONS[name].expand(builder, *given)
        written = ", ".join(next(letters) if value is None else "constant" for value in constants)
        rows.append((f"`{name}({written})`", str(builder.finish().slots)))
    return table(("function", "slots a beat"), rows)


STUDY = Study(
    name="elementary",
    document=DOCS / "numerics.md",
    measure=measure,
    tables={"elementary": _table},
    folder=Path(accuracy.__file__).parent,  # commands show it
)
