"""Programs of the models of a problem.

The numbers that a model is given beside the sigma points, u and the keyword arguments of h that are
floats, stand in region U of the memory map: those of f first, then those of the h.
"""

from collections.abc import Collection, Sequence
from math import pi
from typing import cast

from ukf_sw.elementary.sequence import SequenceBuilder
from ukf_sw.lowering.arithmetic import GraphLowering
from ukf_sw.lowering.endings import end
from ukf_sw.problem import Problem
from ukf_sw.spec.float_format import FloatFormat
from ukf_sw.spec.model_programs import (
    CoreModels,
    ModelProgram,
    Operand,
    Source,
    SourceKind,
    Temporary,
)
from ukf_sw.tracing.graph import Input
from ukf_sw.tracing.models import TracedModel, TracedProblem

__all__ = ["InputPlace", "lower", "lower_model", "name_of", "places_of_inputs"]

#: Which model an input is for, f or h, and how it is written there.
InputPlace = tuple[str, Input]


def name_of(place: InputPlace) -> str:
    """Give the name of an input, as :class:`CoreModels` has it."""
    kind, source = place
    return f"{kind}: {source.label}"


def _kind(model: TracedModel) -> str:
    return "f" if model.sensor is None else "h"


def places_of_inputs(models: Sequence[TracedModel]) -> tuple[InputPlace, ...]:
    """Give the inputs of models in the order of region U; the h share those of one name."""
    found: dict[InputPlace, None] = {}
    for model in models:
        common = (source for source in model.graph.inputs if not source.per_point)
        for source in sorted(common, key=lambda source: (source.argument, source.path)):
            found[_kind(model), source] = None
    return tuple(found)


def lower(
    traced: TracedProblem,
    problem: Problem,
    fmt: FloatFormat,
    which: Collection[str] = ("f", "h"),
    places: Sequence[InputPlace | None] | None = None,
) -> CoreModels:
    """Make the programs of the models of a problem.

    Parameters
    ----------
    traced, problem
        What was traced, and of which problem.
    fmt
        Number format of the core.
    which
        Models that the core evaluates: f, h or both.
    places
        Inputs in the order of region U, where None is not theirs; None are those of the models.

    Raises
    ------
    FormatOverflowError
        If a constant is too large for the format.
    ValueError
        If the format has no coefficients for a function that is needed.
    """
    if places is None:
        places = places_of_inputs([model for model in traced.models if _kind(model) in which])

    def program(model: TracedModel) -> ModelProgram:
        if model.sensor is None:
            return lower_model(model, fmt, places, cast("tuple[int, ...]", problem.state_angles))
        angles = cast("tuple[int, ...]", problem.sensor(model.sensor).angles)
        terms = problem.terms_of(problem.sensor_names.index(model.sensor))
        return lower_model(model, fmt, places, angles, terms.start)

    return CoreModels(
        f=program(traced.f) if "f" in which else None,
        h=tuple(tuple(map(program, models)) for models in traced.h.values())
        if "h" in which
        else (),
        inputs=tuple("" if place is None else name_of(place) for place in places),
    )


def lower_model(
    model: TracedModel,
    fmt: FloatFormat,
    places: Sequence[InputPlace | None],
    angles: Sequence[int] = (),
    first_term: int = 0,
) -> ModelProgram:
    """Make the program of a model.

    Parameters
    ----------
    model
        What was traced.
    fmt
        Number format of the core.
    places
        Inputs in the order of region U.
    angles
        Rows of the result that are wrapped to within half a turn of the same row of one sigma
        point, and so are observations of these rows.
    first_term
        Row of the sigma points of the noise at which those of the model begin.
    """
    builder = SequenceBuilder(fmt)
    lowering = GraphLowering(builder, model.graph, model.title)
    inputs: list[tuple[Temporary, Source]] = []
    for number, temporary in lowering.inputs.items():
        source = cast("Input", model.graph.nodes[number].source)
        if not source.per_point:
            place = Source(SourceKind.INPUT, places.index((_kind(model), source)))
        else:
            row = cast("int", source.path[0])
            if source.argument == "x":
                place = Source(SourceKind.STATE, row)
            else:
                place = Source(SourceKind.NOISE, first_term + row)
        inputs.append((temporary, place))
    outputs = lowering.outputs()
    measurements: list[tuple[int, Operand]] = []
    for row in angles:
        own = outputs[row]
        centre = own
        if isinstance(own, Temporary):
            centre = builder.pick(own)
            outputs[row] = _wrapped(builder, own, centre)
        if model.sensor is not None:
            measured = builder.input()
            inputs.append((measured, Source(SourceKind.MEASUREMENT, row)))
            measurements.append((row, _wrapped(builder, measured, centre)))
    states = {
        temporary: source.index for temporary, source in inputs if source.kind is SourceKind.STATE
    }
    ended = end(
        builder,
        [*outputs, *(value for _, value in measurements)],
        states if model.sensor is None else None,
    )
    rows = [row for row, _ in measurements]
    return ModelProgram(
        title=model.title,
        fmt=fmt,
        inputs=tuple(inputs),
        steps=tuple(builder.steps),
        outputs=ended[: len(outputs)],
        measurements=tuple(zip(rows, ended[len(outputs) :], strict=True)),
    )


def _wrapped(builder: SequenceBuilder, angle: Temporary, reference: Operand) -> Temporary:
    """Shift an angle by whole turns to within half a turn of a reference."""
    middle = builder.constant(1.5 * 2.0**builder.fmt.fraction_bits)
    difference = builder.sum(angle, reference, subtract=True)
    turns = builder.sum(builder.scaled(0.5 / pi, difference, plus=middle), middle, subtract=True)
    return builder.scaled(2.0 * pi, turns, plus=angle, subtract=True)
