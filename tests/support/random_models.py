"""Models of cores at random: any steps of the array, and functions that keep a filter going."""

import dataclasses

import numpy as np

from ukf_sw.elementary.sequence import SequenceBuilder
from ukf_sw.lowering.endings import end
from ukf_sw.lowering.program import lower_model, places_of_inputs
from ukf_sw.spec.forms import Addend, Condition, Form, Multiplier, Reading, Root, Sign
from ukf_sw.spec.model_programs import (
    Constant,
    CoreModels,
    ModelProgram,
    Source,
    SourceKind,
    Temporary,
)
from ukf_sw.spec.parameters import Noise
from ukf_sw.tracing.models import TracedModel
from ukf_sw.tracing.tracer import Call, trace

__all__ = ["any_form", "any_models", "any_program", "sane_models", "with_models"]

#: Numbers in region U of random models.
INPUTS = 3


def any_form(rng, fmt):
    """A form of an issue slot; rng is a random.Random, as everywhere here."""
    readings = [Reading.NUMBER, Reading.NUMBER, Reading.ONE]
    if fmt.fraction_bits <= fmt.bias:
        readings += [Reading.POWER, Reading.EXPONENT]
    return Form(
        multiplier=rng.choice([*Multiplier]),
        addend=rng.choice([*Addend]),
        reading=rng.choice(readings),
        sign=rng.choice([Sign.KEEP, *Sign]),
        subtract=rng.random() < 0.4,
        condition=rng.choice([Condition.ALWAYS, *Condition]),
    )


class _AnyProgram:
    """Builds a program of random steps."""

    def __init__(self, rng, params, sensor, steps):
        self.rng, self.params, self.sensor = rng, params, sensor
        self.builder = SequenceBuilder(params.format)
        self.inputs = []
        self.common = []  # temporaries that can be scalars
        self.points = []  # all others
        self.own = []  # per point, written in all lanes, and no input
        terms = params.augmented_q if sensor is None else params.augmented_r
        for kind, count in ((SourceKind.STATE, params.n), (SourceKind.NOISE, terms)):
            for row in range(count):
                if kind is SourceKind.STATE or rng.random() < 0.7:
                    self._input(kind, row, self.points)
        for place in range(INPUTS):
            if rng.random() < 0.7:
                self._input(SourceKind.INPUT, place, self.common)
        for _ in range(steps):
            self._step()

    def _input(self, kind, index, group):
        temporary = self.builder.input()
        self.inputs.append((temporary, Source(kind, index)))
        group.append(temporary)
        return temporary

    def _constant(self):
        return Constant(float(self.params.format.round(self.rng.choice(
            [0.0, -0.0, 1.0, -1.0, 0.5, self.rng.uniform(-3.0, 3.0),
             1.5 * 2.0 ** self.params.format.fraction_bits],
        ))))  # fmt: skip

    def _word(self):
        choice = self.rng.random()
        if choice < 0.1:
            return self._constant()
        group = self.common if self.common and choice < 0.2 else self.points
        return self.rng.choice(group[-6:] if self.rng.random() < 0.7 else group)

    def _scalar(self):
        return self.rng.choice([self._constant(), *self.common[-3:]])

    def _step(self):
        rng, builder = self.rng, self.builder
        choice = rng.random()
        if choice < 0.06:
            self._add(builder.root(rng.choice(self.points), rng.choice([*Root])), self.points)
        elif choice < 0.12:
            self.common.append(builder.pick(rng.choice(self.points)))
        elif choice < 0.16 and self.common:
            self.common.append(builder.root(rng.choice(self.common), rng.choice([*Root])))
        else:
            self._slot()

    def _add(self, temporary, group):
        if temporary not in group:
            group.append(temporary)
            if group is self.points:
                self.own.append(temporary)

    def _slot(self):
        rng, builder = self.rng, self.builder
        form = any_form(rng, self.params.format)
        common = rng.random() < 0.15
        operands = [
            (rng.choice([self._constant(), *self.common]) if common else self._word())
            if used
            else None
            for used in (form.uses_word_0, form.uses_word_1)
        ]
        operands.append(self._scalar() if form.uses_scalar else None)
        if not set(self.points).isdisjoint(operands):
            group, own = self.points, self.own
        else:
            group = self.common
            own = []
            if form.condition is not Condition.ALWAYS:
                form = dataclasses.replace(form, condition=Condition.ALWAYS)
                if not form.uses_word_1:
                    operands[1] = None
        into = None
        if form.condition is not Condition.ALWAYS:
            if not own:
                own.append(builder.copied(rng.choice(self.points)))
                self.points.append(own[-1])
            into = rng.choice(own[-3:])
        elif own and rng.random() < 0.15:
            into = rng.choice(own)
        self._add(builder.slot(form, *operands, into=into), group)

    def _finite(self, operand):
        """Where it is not finite, a number that is."""
        result = self.builder.copied(self.rng.choice([0.5, -1.25]))
        return self.builder.copied(operand, condition=Condition.FINITE, into=result)

    def finish(self, finite):
        rng, params, builder = self.rng, self.params, self.builder
        is_f = self.sensor is None
        rows = params.n if is_f else len(params.rows_of(self.sensor))
        outputs = []
        for _ in range(rows):
            result = self._word()
            outputs.append(self._finite(result) if rng.random() < finite else result)
        measurements = []
        if not is_f and rng.random() < 0.5:
            row = rng.randrange(rows)
            z = self._input(SourceKind.MEASUREMENT, row, self.common)
            measurements.append((row, builder.scaled(self._scalar(), z, plus=0.25)))
        states = {t: source.index for t, source in self.inputs if source.kind is SourceKind.STATE}
        ended = end(
            builder, [*outputs, *(value for _, value in measurements)], states if is_f else None
        )
        return ModelProgram(
            title="f" if is_f else f"h of {self.sensor}",
            fmt=params.format,
            inputs=tuple(self.inputs),
            steps=tuple(builder.steps),
            outputs=ended[:rows],
            measurements=tuple(
                (row, value) for (row, _), value in zip(measurements, ended[rows:], strict=True)
            ),
        )


def any_program(rng, params, sensor=None, *, steps=30, finite=1.0):
    """A program of any steps: f, or h of a sensor.

    Parameters
    ----------
    rng : random.Random
        Where chance comes from.
    params : UkfParams
        Sizes and format.
    sensor : int or None
        None is f.
    steps : int
        Number of steps, beside those that end it.
    finite : float
        Part of the rows in which NaN and infinity become numbers.
    """
    return _AnyProgram(rng, params, sensor, steps).finish(finite)


def any_models(rng, params, *, steps=30, finite=1.0, variants=2):
    """Models of any steps."""
    return CoreModels(
        f=any_program(rng, params, steps=steps, finite=finite),
        h=tuple(
            tuple(
                any_program(rng, params, sensor, steps=steps, finite=finite)
                for _ in range(1 + (sensor + variants) % 2)
            )
            for sensor in range(len(params.sensor_rows))
        ),
        inputs=tuple(f"u{k}" for k in range(INPUTS)),
    )


def _function(draws, rows, states, terms, additive):
    """Make a function of x, noise and u that is bounded by little more than its arguments."""
    A = draws.uniform(-0.8, 0.8, (rows, states)) / states
    c = draws.uniform(0.2, 0.9, rows)
    order = draws.permuted(np.tile(np.arange(states), (rows, 1)), axis=1)
    kinds = [int(draws.integers(4)) for _ in range(rows)]

    def of_row(i, x, noise, u):
        first, last = x[order[i][0]], x[order[i][-1]]
        value = x[order[i][0]] * 0.5
        for j in range(states):
            value = value + A[i, j] * x[j]
        match kinds[i]:
            case 0:
                value = value + c[i] * np.sin(last)
            case 1:
                value = value + np.where(first < c[i], last * 0.25, first * first / 8.0 - u)
            case 2:
                value = value + last / (1.0 + first * first)
            case _:
                value = value * c[i] - u * last
        return value if additive or not terms else value + noise[i % terms] * (1.0 + c[i])

    return lambda x, noise, u: np.array([of_row(i, x, noise, u) for i in range(rows)])


def _traced(function, name, sensor, rows, states, terms, additive):
    call = Call(
        function=function, name=name, rows=rows, states=states,
        noise="w" if sensor is None else "v", terms=terms, additive=additive,
        positional={"u": 0.5} if sensor is None else {},
        keywords={} if sensor is None else {"gain": 0.5},
    )  # fmt: skip
    return TracedModel(call=call, sensor=sensor, constants={}, graph=trace(call))


def sane_models(rng, params):
    """Models of products, sums, sines, quotients and choices that give numbers of the usual size.

    Sensors with an even number have two variants.
    """
    draws = np.random.default_rng(rng.getrandbits(32))
    p = params
    q = p.n if p.process_noise is Noise.ADDITIVE else p.q
    f = _function(draws, p.n, p.n, q, p.process_noise is Noise.ADDITIVE)
    models = [_traced(f, "f", None, p.n, p.n, q, p.process_noise is Noise.ADDITIVE)]
    additive = p.observation_noise is Noise.ADDITIVE
    own = []
    for sensor, rows in enumerate(p.sensor_rows):
        own.append([])
        for variant in range(2 - sensor % 2):
            terms = rows if additive else p.r
            h = _function(draws, rows, p.n, terms, additive)
            own[-1].append(_traced(
                lambda x, v, *, gain, h=h: h(x, v, gain), f"h {sensor} {variant}", str(sensor),
                rows, p.n, terms, additive,
            ))  # fmt: skip
            models.append(own[-1][-1])
    places = places_of_inputs(models)
    return CoreModels(
        f=lower_model(models[0], p.format, places),
        h=tuple(tuple(lower_model(each, p.format, places) for each in group) for group in own),
        inputs=tuple(f"{kind}: {source.label}" for kind, source in places),
    )


def with_models(params, models):
    """The same core, with models."""
    return dataclasses.replace(params, models=models)


def temporaries_of(program):
    """All temporaries of a program."""
    found = {temporary for temporary, _ in program.inputs}
    found.update(step.destination for step in program.steps)
    assert all(isinstance(each, Temporary) for each in found)
    return found
