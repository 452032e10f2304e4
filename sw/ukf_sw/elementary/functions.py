"""The elementary functions by name, and their sequences for a number format."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from ukf_sw.elementary import (
    exponential,
    inverse_trigonometric,
    quotients,
    selection,
    trigonometric,
)
from ukf_sw.elementary.sequence import Sequence, SequenceBuilder
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.forms import Reading
from ukf_sw.spec.model_programs import Operand

__all__ = ["FUNCTIONS", "Function", "needs_exponents", "sequence"]


@dataclass(frozen=True, kw_only=True)
class Function:
    """An elementary function.

    Parameters
    ----------
    name
        As in NumPy.
    arguments
        How many it has.
    expand
        Adds its steps to a builder, and gives the result or results.
    """

    name: str
    arguments: int
    expand: Callable[..., Operand | tuple[Operand, ...]]

    def sequence(self, fmt: FloatFormat) -> Sequence:
        """Give its steps.

        Raises
        ------
        ValueError
            If the format has no coefficients for it.
        """
        builder = SequenceBuilder(fmt)
        results = self.expand(builder, *(builder.input() for _ in range(self.arguments)))
        return builder.finish(*(results if isinstance(results, tuple) else (results,)))


#: All of them, in the order of the documents.
FUNCTIONS = {
    function.name: function
    for function in (
        Function(name=expand.__name__, arguments=arguments, expand=expand)
        for arguments, expand in (
            (1, quotients.reciprocal),
            (2, quotients.divide),
            (1, quotients.sqrt),
            (2, quotients.hypot),
            (1, trigonometric.sin),
            (1, trigonometric.cos),
            (1, trigonometric.sincos),
            (1, trigonometric.tan),
            (1, inverse_trigonometric.arcsin),
            (1, inverse_trigonometric.arccos),
            (1, inverse_trigonometric.arctan),
            (2, inverse_trigonometric.arctan2),
            (1, exponential.exp),
            (1, exponential.log),
            (2, exponential.power),
            (1, exponential.tanh),
            (1, selection.absolute),
            (1, selection.sign),
            (2, selection.copysign),
            (2, selection.minimum),
            (2, selection.maximum),
            (3, selection.clip),
            (1, selection.rint),
            (1, selection.floor),
            (1, selection.ceil),
            (3, selection.where),
            (2, selection.less),
            (2, selection.less_equal),
            (2, selection.greater),
            (2, selection.greater_equal),
            (2, selection.equal),
            (2, selection.not_equal),
            (2, selection.logical_and),
            (2, selection.logical_or),
            (1, selection.logical_not),
        )
    )
}


@cache
def sequence(name: str, fmt: FloatFormat) -> Sequence:
    """Give the steps of a function, by its name.

    Raises
    ------
    ValueError
        If there is no such function, or the format has no coefficients for it.
    """
    if name not in FUNCTIONS:
        raise ValueError(f"function must be one of {', '.join(FUNCTIONS)}, not {name!r}")
    return FUNCTIONS[name].sequence(fmt)


def needs_exponents(name: str, fmt: FloatFormat) -> bool:
    """Whether a function needs lanes that read powers and exponents."""
    return any(
        form.reading in (Reading.POWER, Reading.EXPONENT) for form in sequence(name, fmt).forms
    )
