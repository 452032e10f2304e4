"""Breaks the project on purpose, one small change at a time, and demands that a test fails.

``python tests/mutants/run.py`` applies each mutant to a copy of the sources and runs the tests
that are to see it. A mutant that survives is a test that is missing.
"""

import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

ROOT = Path(__file__).parents[2]

ENGINE = "tests/hdl/test_engine.py"
ENGINE_OF_MODELS = "tests/hdl/test_engine_of_models.py"
LANE = "tests/hdl/test_processing_element.py"
CONTROL = "tests/hdl/test_control.py"
SCHEDULE = "tests/sw/test_schedule.py"
SEQUENCER = "tests/hdl/test_sequencer.py"
DESIGN_SPACE = "tests/system/test_design_space.py"
EXPLANATION = "tests/system/test_explanation.py"
RECOMMENDATION = "tests/system/test_recommendation.py"
C_DRIVER = "tests/system/test_c_driver.py"
C_RECOVERY = "tests/system/test_c_recovery.py"
C_MODELS = "tests/system/test_c_models.py"
C_ON_CORE = "tests/system/test_c_models_on_core.py"
C_RECOVERY_OF_MODELS = "tests/system/test_c_recovery_of_models.py"
C_PROBLEM = "tests/system/test_c_problem.py"
SOFTWARE_MODELS = "tests/sw/test_software_models.py"
AHEAD = "tests/sw/test_ahead.py"
RECOVERY = "tests/sw/test_recovery.py -k access"
MODEL_PROGRAMS = "tests/sw/test_model_programs.py"
MODELS_IN_CORE = "tests/sw/test_golden_core_of_models.py"
LOWERING = "tests/sw/test_lowering.py"
ELEMENTARY = "tests/sw/test_elementary.py"
ACCURACY = "tests/sw/test_elementary_accuracy.py"
LANE_FORMS = "tests/sw/test_elementary_primitives.py"
COEFFICIENTS = "tests/sw/test_elementary_coefficients.py"


@dataclass(frozen=True)
class Mutant:
    """A small change that makes the core wrong.

    Parameters
    ----------
    name
        What is broken.
    file
        Source file.
    before, after
        Text that stands in the file exactly once, and what takes its place.
    tests
        Arguments for pytest: the tests that are to see it.
    """

    name: str
    file: str
    before: str
    after: str
    tests: str


MUTANTS = [
    Mutant(
        "models on the array: a place is free on the clock of its last read",
        "sw/ukf_sw/engine/temporaries.py",
        "busy[0][0] < first:", "busy[0][0] <= first:",
        f"{MODEL_PROGRAMS} -k any_steps",
    ),
    Mutant(
        "models on the array: an error has the row behind",
        "sw/ukf_sw/engine/model_programs.py",
        "output: (results[row], first + row)", "output: (results[row], first + (row + 1) % 2)",
        f"{MODEL_PROGRAMS} -k not_finite",
    ),
    Mutant(
        "models on the array: a row of h that is masked is an error",
        "sw/ukf_sw/engine/model_programs.py",
        "observation=None if self._is_f else row,", "observation=None,",
        f"{MODEL_PROGRAMS} -k masked_row",
    ),
    Mutant(
        "models on the array: a write with a condition keeps nothing",
        "sw/ukf_sw/engine/operations.py",
        "self.form.condition is not Condition.ALWAYS", "self.form is None",
        f"{MODEL_PROGRAMS} -k another_order",
    ),
    Mutant(
        "models on the array: what a conditional write keeps is not checked",
        "sw/ukf_sw/engine/checker.py",
        "for place, index, writer in kept[clock]:", "for place, index, writer in ():",
        f"{MODEL_PROGRAMS} -k another_order",
    ),
    Mutant(
        "models on the array: region U begins at its second number",
        "sw/ukf_sw/engine/model_programs.py",
        "layout.U[0].element(source.index)", "layout.U[0].element((source.index + 1) % 3)",
        f"{MODEL_PROGRAMS} -k any_steps",
    ),
    Mutant(
        "models on the array: a load beside a result hides what is not finite",
        "sw/ukf_sw/engine/interpreter.py",
        'checks_lanes = checked or word["of_model"]', "checks_lanes = checked",
        f"{MODEL_PROGRAMS} -k row_that_is_wrong",
    ),
    Mutant(
        "models on the array: a load beside a result hides what is not finite, in hardware",
        "hdl/ukf_hdl/core/engine.py",
        "write &= word.of_model | ~word.unchecked", "write &= ~word.unchecked",
        f"{ENGINE_OF_MODELS} -k errors",
    ),
    Mutant(
        "models on the array: an angle is not wrapped",
        "sw/ukf_sw/lowering/program.py",
        "outputs[row] = _wrapped(builder, own, centre)", "outputs[row] = own",
        f"{LOWERING} -k angles",
    ),
    Mutant(
        "placement: programs of a core are in the order of the data",
        "sw/ukf_sw/lowering/placement.py",
        "tuple(number(program, on_core) for program in own)", "tuple(range(len(own)))",
        "tests/sw/test_filter_with_models.py -k more_programs",
    ),
    Mutant(
        "placement: every program of a core is the one that is wanted",
        "sw/ukf_sw/lowering/placement.py",
        "if replace(program, title=other.title) == other:", "if program:",
        "tests/sw/test_filter_with_models.py -k without_a_program",
    ),
    Mutant(
        "placement: inputs of a core are in the order of the data",
        "sw/ukf_sw/lowering/placement.py",
        "places = tuple(found.pop(name, None) for name in models.inputs)",
        "places = tuple(found.values())\n    found.clear()",
        "tests/sw/test_filter_with_models.py -k without_an_input",
    ),
    Mutant(
        "placement: lists are no arrays", "sw/ukf_sw/lowering/placement.py",
        "isinstance(value, (list, tuple)):", "isinstance(value, dict):",
        "tests/sw/test_filter_with_models.py -k lists_are_arrays",
    ),
    Mutant(
        "applications: models on the core are in software",
        "tools/ukf_tools/evaluate/evaluation.py",
        "core_models(entry.name, self.models.value,", 'core_models(entry.name, "software",',
        "tests/system/test_apps.py -k judged_as_well",
    ),
    Mutant(
        "applications: models on the core are not compared with float64",
        "tools/ukf_tools/evaluate/evaluation.py",
        "        if whole\n        else None,",
        "        if whole and own.models is Placement.SOFTWARE\n        else None,",
        "tests/system/test_apps.py -k core_that_are_beyond",
    ),
    Mutant(
        "co-simulation: the iteration that is shown may be the first",
        "sim/ukf_sim/cosimulation.py",
        "reversed(self.iterations[1:] or self.iterations)", "reversed(self.iterations)",
        "tests/system/test_cosim.py -k is_shown",
    ),
    Mutant(
        "models on the array: a joined difference is turned",
        "sw/ukf_sw/lowering/arithmetic.py",
        "negative = subtract and not turned", "negative = subtract",
        f"{LOWERING} -k joins",
    ),
    Mutant(
        "models on the array: all sensors have the first noise terms",
        "sw/ukf_sw/lowering/program.py",
        "Source(SourceKind.NOISE, first_term + row)", "Source(SourceKind.NOISE, row)",
        f"{MODEL_PROGRAMS} -k noise_of_a_sensor",
    ),
    Mutant(
        "steps of models: ITERATE ends with PREDICT",
        "sw/ukf_sw/spec/sequence.py",
        "    (Step.ITERATE, Program.PREDICT): Step.H,\n", "",
        f"{MODELS_IN_CORE} -k iterate_is",
    ),
    Mutant(
        "steps of models: H may follow an update that was rejected",
        "sw/ukf_sw/spec/sequence.py",
        "failure=Change(clears=Flag.PROPAGATED), gives_nis", "failure=Change(), gives_nis",
        f"{MODELS_IN_CORE} -k rejected",
    ),
    Mutant(
        "steps of models: a program ends a clock later for a reset",
        "sw/ukf_sw/golden/core.py",
        "if left < clocks:", "if left <= clocks:",
        f"{MODELS_IN_CORE} -k chained",
    ),
    Mutant(
        "steps of models: the variant is the first one",
        "hdl/ukf_hdl/core/control.py",
        "self.run.variant.eq(Mux(program == Program.MODEL_H, variant, 0))",
        "self.run.variant.eq(0)",
        f"{CONTROL} -k every_clock",
    ),
    Mutant(
        "elementary: a coefficient of the sine in its 12th bit",
        "sw/ukf_sw/elementary/coefficients/coefficients.json",
        "0x1.110eda0000000p-7",
        "0x1.1100da0000000p-7",
        ACCURACY,
    ),
    Mutant(
        "elementary: a late coefficient of the logarithm in binary64",
        "sw/ukf_sw/elementary/coefficients/coefficients.json",
        "0x1.c71c71e19c925p-4",
        "0x1.c70c71e19c925p-4",
        ACCURACY,
    ),
    Mutant(
        "elementary: the second part of pi in its last bits",
        "sw/ukf_sw/elementary/coefficients/coefficients.json",
        "-0x1.2e7b967674000p-40",
        "-0x1.2e7b967674008p-40",
        f"{COEFFICIENTS} {ACCURACY}",
    ),
    Mutant(
        "elementary: the last part of pi is left out",
        "sw/ukf_sw/elementary/trigonometric.py",
        "for part in table.half_pi:",
        "for part in table.half_pi[:-1]:",
        ACCURACY,
    ),
    Mutant(
        "elementary: the sign of a sine is that of half as many turns",
        "sw/ukf_sw/elementary/trigonometric.py",
        "sign=Sign.BIT_0",
        "sign=Sign.BIT_1",
        f"{ELEMENTARY} {ACCURACY}",
    ),
    Mutant(
        "elementary: sine and cosine keep their places",
        "sw/ukf_sw/elementary/trigonometric.py",
        "builder.copied(kept, condition=Condition.ODD, where=word, into=sine)",
        "builder.copied(kept)",
        ACCURACY,
    ),
    Mutant(
        "elementary: angles are taken from twice as far",
        "sw/ukf_sw/elementary/trigonometric.py",
        "scale = 2.0 ** (fmt.bias + 1 -",
        "scale = 2.0 ** (fmt.bias -",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: the second part of pi is positive",
        "docs/ukf_docs/coefficients.py",
        "3, kept, up=True)",
        "3, kept, up=False)",
        COEFFICIENTS,
    ),
    Mutant(
        "elementary: a reciprocal is corrected where there is nothing to correct",
        "sw/ukf_sw/elementary/quotients.py",
        "rest, condition=Condition.FINITE, into=result)\n\n\ndef divide",
        "rest, into=result)\n\n\ndef divide",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: a reciprocal is not corrected",
        "sw/ukf_sw/elementary/quotients.py",
        "rest = builder.product_plus(1.0, x, result, subtract=not negate)",
        "rest = builder.product_plus(1.0, x, result, subtract=negate)",
        ACCURACY,
    ),
    Mutant(
        "elementary: quotients by numbers near the largest",
        "sw/ukf_sw/elementary/primitives.py",
        "magnitude >= 2.0 ** (fmt.bias - 1)",
        "magnitude >= 2.0**fmt.bias",
        f"{ELEMENTARY} {LANE_FORMS}",
    ),
    Mutant(
        "elementary: 1/0 is 0",
        "sw/ukf_sw/elementary/primitives.py",
        "np.where(magnitude < fmt.min_normal, np.inf, result)",
        "np.where(magnitude < fmt.min_normal, 0.0, result)",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: magnitudes are not sorted",
        "sw/ukf_sw/elementary/quotients.py",
        "builder.copied(larger, into=smaller, condition=Condition.NEGATIVE, where=steeper)",
        "builder.copied(larger, into=smaller, condition=Condition.ODD, where=steeper)",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: 0/0 of magnitudes",
        "sw/ukf_sw/elementary/quotients.py",
        "root = builder.root(larger, Root.PLAIN)",
        "root = builder.root(larger, Root.SIGNED)",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: arcsine chooses the wrong side",
        "sw/ukf_sw/elementary/inverse_trigonometric.py",
        "builder.copied(x, condition=Condition.NOT_NEGATIVE, where=large, into=r)",
        "builder.copied(x, condition=Condition.NEGATIVE, where=large, into=r)",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: arccosine of negative numbers",
        "sw/ukf_sw/elementary/inverse_trigonometric.py",
        "angle, condition=Condition.NEGATIVE, where=x, into=result)",
        "angle, condition=Condition.NEGATIVE, where=large, into=result)",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: the arctangent of infinity has the other sign",
        "sw/ukf_sw/elementary/inverse_trigonometric.py",
        "    return builder.grown(r, builder.product(polynomial, z, addend=Addend.PLUS_ZERO))\n\n"
        "\ndef arctan(",
        "    return builder.grown(r, builder.product(polynomial, z))\n\n\ndef arctan(",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: arctan2 behind",
        "sw/ukf_sw/elementary/inverse_trigonometric.py",
        "angle, condition=Condition.NEGATIVE, where=x, into=angle)",
        "angle, condition=Condition.NOT_NEGATIVE, where=x, into=angle)",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: exp overflows to a number",
        "sw/ukf_sw/elementary/exponential.py",
        "result = builder.scaled(2.0, word, reading=Reading.POWER)",
        "result = builder.scaled(1.0, word, reading=Reading.POWER)",
        ACCURACY,
    ),
    Mutant(
        "elementary: exp far from zero",
        "sw/ukf_sw/elementary/exponential.py",
        "factor, word, reading=Reading.POWER, addend=Addend.PLUS_ZERO,\n"
        "            condition=Condition.FINITE, into=result,",
        "factor, word, reading=Reading.POWER, addend=Addend.PLUS_ZERO,\n            into=result,",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: the small part of ln 2 comes last",
        "sw/ukf_sw/elementary/exponential.py",
        "high, *low = table.ln_2",
        "*low, high = table.ln_2",
        ACCURACY,
    ),
    Mutant(
        "elementary: log of numbers near 1 in binary16",
        "sw/ukf_sw/elementary/exponential.py",
        "if is_narrow(fmt):",
        "if fmt.bias < 0:",
        ACCURACY,
    ),
    Mutant(
        "elementary: log(0) is NaN",
        "sw/ukf_sw/elementary/primitives.py",
        "return np.where(word == 0.0, -np.inf, result)",
        "return np.where(word == 0.0, np.nan, result)",
        f"{ELEMENTARY} {LANE_FORMS}",
    ),
    Mutant(
        "elementary: tanh is 1 a little early",
        "sw/ukf_sw/elementary/exponential.py",
        "plus=table.tanh_limit",
        "plus=0.8 * table.tanh_limit",
        ACCURACY,
    ),
    Mutant(
        "elementary: minus zero is below zero",
        "sw/ukf_sw/elementary/selection.py",
        "builder.sum(builder.sum(x, 0.0), y, subtract=True)",
        "builder.sum(x, y, subtract=True)",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: minus zero is below a constant zero",
        "sw/ukf_sw/elementary/selection.py",
        "y.value or -0.0",
        "y.value",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: a NaN is lost in a maximum",
        "sw/ukf_sw/elementary/selection.py",
        "result = builder.sum(x, y)",
        "result = builder.copied(x)",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: NaN is less than or equal",
        "sw/ukf_sw/elementary/selection.py",
        "return builder.copied(_difference(builder, y, x), negate=True)",
        "return logical_not(builder, _difference(builder, y, x))",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: rounding of large numbers",
        "sw/ukf_sw/elementary/selection.py",
        "plus=-whole, sign=Sign.CLEAR",
        "plus=-2.0 * whole, sign=Sign.CLEAR",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: floor forgets to step down",
        "sw/ukf_sw/elementary/selection.py",
        "result, 1.0, subtract=True, condition=Condition.NEGATIVE, where=rest, into=result",
        "result, 1.0, subtract=True, condition=Condition.ODD, where=rest, into=result",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: products lose the sign of zero",
        "sw/ukf_sw/elementary/primitives.py",
        "Addend.MINUS_ZERO: -0.0}",
        "Addend.MINUS_ZERO: 0.0}",
        f"{ELEMENTARY} {LANE_FORMS}",
    ),
    Mutant(
        "elementary: the largest power is infinite",
        "sw/ukf_sw/elementary/primitives.py",
        "(exponent > fmt.bias), np.inf, result)",
        "(exponent >= fmt.bias), np.inf, result)",
        LANE_FORMS,
    ),
    Mutant(
        "elementary: NaN is negative",
        "sw/ukf_sw/elementary/primitives.py",
        "return np.signbit(values) & ~np.isnan(values)",
        "return np.signbit(values) | np.isnan(values)",
        f"{ELEMENTARY} {LANE_FORMS}",
    ),
    Mutant(
        "elementary: the polynomial's coefficients in the other order",
        "sw/ukf_sw/elementary/sequence.py",
        "for coefficient in reversed(rest):",
        "for coefficient in rest:",
        ACCURACY,
    ),
    Mutant(
        "elementary: what is not a number of the format goes in",
        "sw/ukf_sw/elementary/sequence.py",
        "if wrong.any():",
        "if wrong.all():",
        ELEMENTARY,
    ),
    Mutant(
        "elementary: NaN within the domain is no error",
        "docs/ukf_docs/studies/elementary.py",
        "return 0.0 if gmpy2.is_nan(exact) or not inside else inf",
        "return 0.0",
        ACCURACY,
    ),
    Mutant(
        "elementary: formats without coefficients have those of binary32",
        "sw/ukf_sw/elementary/coefficients/__init__.py",
        "if fmt.name not in records:",
        "if fmt.name not in records and fmt.width > 64:",
        ELEMENTARY,
    ),
    Mutant(
        "sensors: a bad pivot is reported as a row of the first sensor",
        "sw/ukf_sw/engine/programs.py",
        "pivot_offset=observed.start - first, innovation=rhs,",
        "pivot_offset=-first, innovation=rhs,",
        "tests/sw/test_problem.py tests/sw/test_logs.py tests/sw/test_schedule.py",
    ),
    Mutant(
        "sensors: the observations of another one are taken", "sw/ukf_sw/engine/programs.py",
        "b, layout.Z[i], residual,", "b, layout.Z[i - observed.start], residual,",
        "tests/sw/test_problem.py",
    ),
    Mutant(
        "sensors: noise columns of a sensor with one row", "sw/ukf_sw/engine/programs.py",
        "columns = _Columns(layout, len(observed))", "columns = _Columns(layout, 1)",
        "tests/sw/test_problem.py tests/sw/test_schedule.py",
    ),
    Mutant(
        "buffer: column 0 of X is not x", "hdl/ukf_hdl/core/buffer.py",
        "return one_of(FirstColumn.STATE), one_of(FirstColumn.EMPTY)",
        "return Const(0), one_of(FirstColumn.EMPTY)",
        "tests/hdl/test_buffer.py -k every_address",
    ),
    Mutant(
        "buffer: a write to column 0 reaches the measurement", "hdl/ukf_hdl/core/buffer.py",
        "self.memory.write.eq(writing & ~fixed)", "self.memory.write.eq(writing)",
        "tests/hdl/test_buffer.py -k every_address",
    ),
    Mutant(
        "buffer: column 0 of Z shows the measurement", "hdl/ukf_hdl/core/buffer.py",
        "blank.eq(~valid | self.busy | is_empty)", "blank.eq(~valid | self.busy)",
        "tests/hdl/test_buffer.py -k every_address",
    ),
    Mutant(
        "golden: column 0 of X is that of the right-hand side", "sw/ukf_sw/golden/buffer.py",
        "if kind is FirstColumn.STATE:", "if kind is None:",
        "tests/sw/test_golden_core.py",
    ),
    Mutant(
        "programs: a beat of noise too few", "sw/ukf_sw/engine/programs.py",
        "self.observation_dots(self._rows - 1)", "self.observation_dots(0)",
        "tests/sw/test_filter.py tests/sw/test_problem.py",
    ),
    Mutant(
        "programs: noise above the diagonal is not cleared", "sw/ukf_sw/engine/programs.py",
        "b.multiply(row, layout.ones, layout.ones, [(start + i + 1, stop)])",
        "b.multiply(row, layout.ones, layout.ones, [(stop, stop)])",
        "tests/sw/test_additive_noise.py",
    ),
    Mutant(
        "scheduler: which of equal schedules is kept is chance", "sw/ukf_sw/engine/scheduler.py",
        "(-urgency[successor], successor)",
        "(-urgency[successor] - hash(str(successor)) % 2 / 4, successor)",
        "tests/sw/test_schedule.py",
    ),
    Mutant(
        "microcode: the longest of the schedules is kept", "sw/ukf_sw/engine/microcode.py",
        "min(codes, key=_cost)", "max(codes, key=_cost)",
        "tests/sw/test_schedule.py",
    ),
    Mutant(
        "parameters: angles are wrapped to point 1", "sw/ukf_sw/spec/parameters.py",
        "return 0 if self.W0 else self.N - 1", "return 0 if self.W0 else 1",
        "tests/sw/test_filter.py tests/sw/test_parameters.py",
    ),
    Mutant(
        "driver: x from before an update is given", "sw/ukf_sw/drivers/driver.py",
        "x, self._x = self._x, None\n            gated = self._correct(Step.UPDATE",
        "x = self._x\n            gated = self._correct(Step.UPDATE",
        "tests/sw/test_driver.py tests/sw/test_filter.py",
    ),
    Mutant(
        "latency: redrawing is not counted", "tools/ukf_tools/estimate/latency.py",
        "(Routine(Program.SIG_GEN_PREDICTED),) if redraws else ()", "()",
        f"{DESIGN_SPACE} -k redrawing",
    ),
    Mutant(
        "latency: all sensors find residuals of the prediction",
        "tools/ukf_tools/estimate/latency.py",
        "redrawn = redraws or sensor > 0", "redrawn = redraws",
        "tests/system/test_cli.py -k latency",
    ),
    Mutant(
        "explain: the adders of the accumulator are overlooked",
        "tools/ukf_tools/estimate/occupancy.py",
        "for level in range(timing.levels + 1)]", "for level in range(max(timing.levels, 1))]",
        f"{EXPLANATION} -k tracks",
    ),
    Mutant(
        "explain: any predecessor will do", "tools/ukf_tools/estimate/waits.py",
        "+ distance == self.ready[index]", "+ distance <= self.ready[index]",
        f"{EXPLANATION} -k chain",
    ),
    Mutant(
        "explain: nothing is ever held back", "tools/ukf_tools/estimate/waits.py",
        "if clock not in reasons or reason is Reason.HELD_BACK:", "if clock not in reasons:",
        f"{EXPLANATION} -k held_back",
    ),
    Mutant(
        "explain: what subtracts a row belongs to none", "tools/ukf_tools/estimate/parts.py",
        "multiplied[operation.destination] = row", "pass",
        f"{EXPLANATION} -k rows_of",
    ),
    Mutant(
        "numbers of PEs: larger ones that use lanes better do not count",
        "tools/ukf_tools/estimate/recommendation.py",
        "for larger in cycles if larger > pes", "for larger in ()",
        RECOMMENDATION,
    ),
    Mutant(
        "numbers of PEs: an update from drawn points is not counted whole",
        "tools/ukf_tools/estimate/recommendation.py",
        "if routine.program is Program.UPDATE_REDRAWN:", "if False:",
        f"{RECOMMENDATION} -k core",
    ),
    Mutant(
        "words: redrawing is not counted", "tools/ukf_tools/estimate/traffic.py",
        "starts = 1 + redraws + sensors", "starts = 1 + sensors",
        "tests/system/test_latency_of_models.py -k counts",
    ),
    Mutant(
        "many samples: a round that fails stays half done", "sw/ukf_sw/engine/interpreter.py",
        "                memory[:] = memory_before\n", "",
        f"{AHEAD} -k not_begun",
    ),
    Mutant(
        "many samples: banks do not turn within a step", "sw/ukf_sw/golden/scripts.py",
        "banks_of_runs.append(now ^ turns)", "banks_of_runs.append(now)",
        f"{AHEAD} -k one_by_one",
    ),
    Mutant(
        "many samples: inputs are written again and again", "sw/ukf_sw/drivers/scripts.py",
        "if self._inputs.get(place) != word", "if True",
        f"{AHEAD} -k one_by_one",
    ),
    Mutant(
        "many samples: an interrupt leaves what was done", "sw/ukf_sw/golden/core.py",
        "            self.engine.memory[:] = memory\n", "",
        f"{AHEAD} -k interrupt",
    ),
    Mutant(
        "many samples: a prediction alone is thought to be undone", "sw/ukf_sw/drivers/driver.py",
        "            if not status & POINTS:\n                raise EstimateLostError\n", "",
        f"{AHEAD} -k interrupt",
    ),
    Mutant(
        "lanes: binary32 flushes before it rounds", "sw/ukf_sw/engine/arithmetic.py",
        "if abs(value) < _MIN_ROUNDED_32", "if abs(value) < _MIN_NORMAL_32",
        "tests/sw/test_arithmetic.py -k binary32_alone",
    ),
    Mutant(
        "driver: a step that costs nothing hides the cycles of the one before it",
        "sw/ukf_sw/drivers/driver.py",
        "cycles or self.last_cycles.get(name, 0)", "cycles",
        "tests/sw/test_driver.py -k cycles",
    ),
    Mutant(
        "driver: a row that is constant and has noise is refused", "sw/ukf_sw/drivers/driver.py",
        "constant &= ~factors.any(axis=1)", "pass",
        "tests/sw/test_hostile_observations.py -k constant",
    ),
    Mutant(
        "reference: a row that is constant has a variance", "sw/ukf_sw/reference.py",
        "S[equal], S[:, equal], Pxz[:, equal] = 0.0, 0.0, 0.0", "pass",
        "tests/sw/test_hostile_observations.py -k constant",
    ),
    Mutant(
        "C filter: a row that is constant is left to the core", "sw/c/ukf_software.c",
        "if (!varies) {", "if (!varies && core->n == 0u) {",
        C_DRIVER + " -k constant",
    ),
    Mutant(
        "C filter: a row that is constant and has noise is refused", "sw/c/ukf_software.c",
        "varies = varies || !all_zero(", "varies = varies || all_zero(",
        C_DRIVER + " -k constant",
    ),
    Mutant(
        "finding: results of an older model are taken", "sw/ukf_sw/problems/recipe.py",
        'known["modules"] = digest_of_modules(self.name)', "pass",
        "tests/sw/test_finding.py",
    ),
    Mutant(
        "logs: an input is taken before it was there", "sw/ukf_sw/problems/logs.py",
        'side="right") - 1', 'side="left") - 1',
        "tests/sw/test_logs.py",
    ),
    Mutant(
        "logs: a column dt may contradict the times", "sw/ukf_sw/problems/logs.py",
        "np.flatnonzero(np.abs(dt[1:] - between) > allowed) + 1", "np.flatnonzero(between < 0.0)",
        "tests/sw/test_logs.py -k dt",
    ),
    Mutant(
        "logs: times that differ by rounding are two steps", "sw/ukf_sw/problems/log_times.py",
        "time - last <= reach + own", "time - last <= 0.0",
        "tests/sw/test_logs.py -k rounding",
    ),
    Mutant(
        "logs: times that differ by more are one step", "sw/ukf_sw/problems/log_times.py",
        "time - first <= _JITTER * shortest", "time - first <= 0.5 * shortest",
        "tests/sw/test_logs.py -k by_more",
    ),
    Mutant(
        "logs: columns that are ignored are read", "sw/ukf_sw/problems/log_tables.py",
        "numbers.append([_number(cells[k], headings[k], row, name) for k in indices])",
        "whole = [_number(c, h, row, name) for c, h in zip(cells, headings)]\n"
        "        numbers.append([whole[k] for k in indices])",
        "tests/sw/test_logs.py -k ignored",
    ),
    Mutant(
        "sensors: the update of another one is started", "hdl/ukf_hdl/core/control.py",
        "*self._select(way.program, sensor, variant)", "*self._select(way.program, 0, variant)",
        f"{CONTROL} -k sensors",
    ),
    Mutant(
        "sensors: an update of one that is not there is started", "hdl/ukf_hdl/core/control.py",
        "way.legal & exists &", "way.legal &",
        f"{CONTROL} -k not_there",
    ),
    Mutant(
        "registers: MASK has bits of observations that are not there",
        "sw/ukf_sw/spec/registers.py",
        ", bits=lambda p: p.m,", ",",
        f"{CONTROL} -k reserved",
    ),
    Mutant(
        "multiplier: ties are not to even", "hdl/ukf_hdl/arithmetic/float_multiplier.py",
        "round_up.eq(total[low] & (total[low + 1] | sticky))",
        "round_up.eq(total[low])",
        "tests/hdl/test_float_units.py",
    ),
    Mutant(
        "multiplier: infinity times zero is infinity", "hdl/ukf_hdl/arithmetic/float_multiplier.py",
        " | (~a.is_finite & b.is_zero) | (~b.is_finite & a.is_zero)", "",
        "tests/hdl/test_float_units.py",
    ),
    Mutant(
        "adder: guard bits of the smaller operand are lost",
        "hdl/ukf_hdl/arithmetic/float_adder.py",
        "below[0].eq(small[0])", "below[0].eq(0)",
        "tests/hdl/test_float_units.py",
    ),
    Mutant(
        "reciprocal square root: exponent is off by one",
        "hdl/ukf_hdl/arithmetic/reciprocal_sqrt.py",
        "exponent = (operand.exponent + root.value[fmt.precision])",
        "exponent = (operand.exponent + 1 + root.value[fmt.precision])",
        "tests/hdl/test_float_units.py",
    ),
    Mutant(
        "processing element: operands are swapped", "hdl/ukf_hdl/core/processing_element.py",
        "c.eq(self._addend(words[0]))", "c.eq(self._addend(words[1]))",
        ENGINE,
    ),
    Mutant(
        "processing element: subtraction adds", "hdl/ukf_hdl/core/processing_element.py",
        "words[1] ^ (steering.subtract << (fmt.width - 1))", "words[1]",
        ENGINE,
    ),
    Mutant(
        "processing element: c arrives a clock early", "hdl/ukf_hdl/core/processing_element.py",
        "for _ in range(pipeline.multiply):", "for _ in range(pipeline.multiply - 1):",
        ENGINE,
    ),
    Mutant(
        "processing element: infinity counts as finite", "hdl/ukf_hdl/core/processing_element.py",
        "is_finite = written.is_finite\n", "is_finite = ~written.is_nan\n",
        ENGINE,
    ),
    Mutant(
        "processing element: a condition masks the bus", "hdl/ukf_hdl/core/processing_element.py",
        "Cat(reasons).any() & ~self.write.from_bus", "Cat(reasons).any()",
        LANE,
    ),
    Mutant(
        "processing element: conditions come a clock early",
        "hdl/ukf_hdl/core/processing_element.py",
        "latency = 1 + self._pipeline.multiply", "latency = self._pipeline.multiply",
        LANE,
    ),
    Mutant(
        "operand reader: NaN has a sign to copy", "hdl/ukf_hdl/core/operand_reader.py",
        "word_0.sign & ~word_0.is_nan", "word_0.sign",
        LANE,
    ),
    Mutant(
        "operand reader: a subnormal number has bits", "hdl/ukf_hdl/core/operand_reader.py",
        "& ~word.is_zero & word.is_finite", "& word.is_finite",
        LANE,
    ),
    Mutant(
        "operand reader: every integer is a power", "hdl/ukf_hdl/core/operand_reader.py",
        "exact.eq(is_integer & fits)", "exact.eq(is_integer)",
        LANE,
    ),
    Mutant(
        "operand reader: the exponent of zero is plus infinity",
        "hdl/ukf_hdl/core/operand_reader.py",
        "minus = steer & word_1.is_zero\n", "minus = Const(0, 1)\n",
        LANE,
    ),
    Mutant(
        "reciprocal square root: one more number has a signed root",
        "hdl/ukf_hdl/arithmetic/reciprocal_sqrt.py",
        "a.exponent >= 2 * fmt.bias - 1", "a.exponent >= 2 * fmt.bias",
        "tests/hdl/test_float_units.py -k signed",
    ),
    Mutant(
        "engine: results of models are pivots", "hdl/ukf_hdl/core/engine.py",
        "is_pivot & ~word.of_model", "is_pivot",
        ENGINE_OF_MODELS,
    ),
    Mutant(
        "engine: f is blamed as h", "hdl/ukf_hdl/core/engine.py",
        "Mux(is_observation, ErrorCode.MODEL_H, ErrorCode.MODEL_F)", "ErrorCode.MODEL_H",
        ENGINE_OF_MODELS,
    ),
    Mutant(
        "engine: scalars are always checked", "hdl/ukf_hdl/core/engine.py",
        "scalar_write &= ~word.unchecked", "scalar_write &= 1",
        ENGINE_OF_MODELS,
    ),
    Mutant(
        "engine: lanes that do not count are summed", "hdl/ukf_hdl/core/engine.py",
        "lane.drop_product.eq(dot[0] & ~counted[number])", "lane.drop_product.eq(0)",
        ENGINE,
    ),
    Mutant(
        "engine: the accumulator does not start from zero", "hdl/ukf_hdl/core/engine.py",
        "accumulator.right.eq(Mux(first, 0, accumulator.sum))",
        "accumulator.right.eq(accumulator.sum)",
        ENGINE,
    ),
    Mutant(
        "engine: writes go to the current bank", "hdl/ukf_hdl/core/engine.py",
        "state, factor = ~self.banks.state, ~self.banks.factor",
        "state, factor = ~self.banks.state, self.banks.factor",
        ENGINE,
    ),
    Mutant(
        "engine: writes go on after an error", "hdl/ukf_hdl/core/engine.py",
        "passed.eq(~failed & ~bad_pivot & ~not_finite)", "passed.eq(~bad_pivot & ~not_finite)",
        ENGINE,
    ),
    Mutant(
        "engine: the mask is that of the next observation", "hdl/ukf_hdl/core/engine.py",
        "return ~Cat(1, self.run.observation_mask).bit_select(observation, 1)",
        "return ~Cat(1, 1, self.run.observation_mask).bit_select(observation, 1)",
        ENGINE,
    ),
    Mutant(
        "engine: a masked observation with a zero pivot is an error", "hdl/ukf_hdl/core/engine.py",
        "is_observation, ~in_use,", "is_observation, 0,",
        ENGINE,
    ),
    Mutant(
        "engine: a pivot that is rounding noise passes", "hdl/ukf_hdl/core/engine.py",
        "(pivot.exponent < noise)", "0",
        ENGINE,
    ),
    Mutant(
        "engine: couplings of the last program count", "hdl/ukf_hdl/core/engine.py",
        "m.d.sync += seen.eq(0)", "pass",
        ENGINE,
    ),
    Mutant(
        "engine: whatever overflows is the innovation", "hdl/ukf_hdl/core/engine.py",
        "run.innovation_overflow.eq(~other)", "run.innovation_overflow.eq(1)",
        ENGINE,
    ),
    Mutant(
        "control: a gate that is off rejects an overflow", "hdl/ukf_hdl/core/control.py",
        "overflow = self.run.innovation_overflow & gate.is_finite",
        "overflow = self.run.innovation_overflow",
        "tests/hdl/test_control.py -k every_clock",
    ),
    Mutant(
        "constants: weights are only rounded", "sw/ukf_sw/engine/constants.py",
        "left = 1 - sum(map(Fraction, row))", "left = Fraction(0)",
        "tests/sw/test_constants.py",
    ),
    Mutant(
        "engine: beats of a stopped program live on", "hdl/ukf_hdl/core/engine.py",
        "Mux(self.run.start, 0, Cat(word.dot, beats))", "Cat(word.dot, beats)",
        ENGINE,
    ),
    Mutant(
        "sequencer: a stop lets one more word through", "hdl/ukf_hdl/core/sequencer.py",
        "m.d.sync += self.word.eq(0)", "pass",
        SEQUENCER,
    ),
    Mutant(
        "unpacker: addresses of repeated words stand still", "hdl/ukf_hdl/core/unpacker.py",
        "before[name] + steps[name]", "before[name]",
        SEQUENCER,
    ),
    Mutant(
        "unpacker: one repetition too many", "hdl/ukf_hdl/core/unpacker.py",
        "repeat.eq(left != 1)", "repeat.eq(left != 0)",
        SEQUENCER,
    ),
    Mutant(
        "unpacker: what a stopped program had left is repeated", "hdl/ukf_hdl/core/unpacker.py",
        "m.d.sync += [left.eq(0), repeat.eq(0)]", "pass",
        SEQUENCER,
    ),
    Mutant(
        "packets: a repetition reaches too far back", "sw/ukf_sw/engine/packets.py",
        "(packet.distance - 1) <<", "packet.distance <<",
        "tests/sw/test_packets.py",
    ),
    Mutant(
        "schedule: a slot too early", "sw/ukf_sw/engine/scheduler.py",
        "(writer, written + 1 - k * interval)", "(writer, written - k * interval)",
        SCHEDULE,
    ),
    Mutant(
        "schedule: writes overtake reads", "sw/ukf_sw/engine/scheduler.py",
        "(reader, read + 1 - written)", "(reader, -999)",
        SCHEDULE,
    ),
    Mutant(
        "schedule: adders are not reserved", "sw/ukf_sw/engine/scheduler.py",
        "taken |= self._no_lanes", "pass",
        SCHEDULE,
    ),
    Mutant(
        "microcode: registers are reused while they are needed", "sw/ukf_sw/engine/microcode.py",
        "last_read.get(scalar, written + 1)", "written + 1",
        SCHEDULE,
    ),
    Mutant(
        "microcode: a dot product's first beat does not say so", "sw/ukf_sw/engine/microcode.py",
        '"first": int(k == 0)', '"first": 0',
        SCHEDULE,
    ),
    Mutant(
        "control: steps start out of sequence", "hdl/ukf_hdl/core/control.py",
        "with m.If(self._has_flags(flags, choice.needs)):", "with m.If(Const(1)):",
        CONTROL,
    ),
    Mutant(
        "sequence: a rejected update with points drawn anew can be repeated",
        "sw/ukf_sw/spec/sequence.py",
        "success=_UPDATED, failure=Change(clears=_ALL_POINTS), gives_nis=True",
        "success=_UPDATED, gives_nis=True",
        f"{CONTROL} -k agrees",
    ),
    Mutant(
        "sequence: a write to L keeps the residuals of a prediction",
        "sw/ukf_sw/spec/memory_map.py",
        '"L": Flag.POINTS | Flag.RESIDUALS | Flag.PREDICTED', '"L": Flag.POINTS',
        "tests/sw/test_golden_core.py",
    ),
    Mutant(
        "golden model: results of a failed step are committed", "sw/ukf_sw/golden/core.py",
        "change = ending.failure if rejected else ending.success", "change = ending.success",
        "tests/sw/test_golden_core.py",
    ),
    Mutant(
        "control: results of a failed step are committed", "hdl/ukf_hdl/core/control.py",
        "with m.If(rejected):", "with m.If(Const(0)):",
        CONTROL,
    ),
    Mutant(
        "control: byte strobes are ignored", "hdl/ukf_hdl/core/control.py",
        "bus.w_data.eq(access.data & strobe_mask)", "bus.w_data.eq(access.data)",
        CONTROL,
    ),
    Mutant(
        "decoder: accesses to the buffer reach the registers as well",
        "hdl/ukf_hdl/core/access_decoder.py",
        "target.write.eq(access.write),", "target.write.eq(access.write), target.valid.eq(1),",
        "tests/hdl/test_access_decoder.py",
    ),
    Mutant(
        "buffer: answers while a step runs", "hdl/ukf_hdl/core/buffer.py",
        "refused.eq(~valid | self.busy)", "refused.eq(~valid)",
        "tests/hdl/test_buffer.py",
    ),
    Mutant(
        "AXI4-Lite: a response is dropped before it is taken", "hdl/ukf_hdl/core/axi4_lite.py",
        "        with m.If(bus.bready):\n            m.d.sync += bus.bvalid.eq(0)",
        "        m.d.sync += bus.bvalid.eq(0)",
        "tests/hdl/test_axi4_lite.py",
    ),
    Mutant(
        "C driver: subnormal numbers are rounded to the grid of binary32", "sw/c/ukf_driver.c",
        "fabs(value) < 0x1p-126 - 0x1p-151", "fabs(value) < 0x1p-150",
        C_DRIVER,
    ),
    Mutant(
        "C driver: the mask is written at every update", "sw/c/ukf_driver.c",
        "driver->mask_known = result == UKF_OK;", "driver->mask_known = false;",
        C_DRIVER,
    ),
    Mutant(
        "driver: INIT forgets a prediction that is there still", "sw/ukf_sw/drivers/driver.py",
        "            self._initialised = True\n            if status", "            if status",
        "tests/sw/test_recovery.py::test_undoing_may_fail",
    ),
    Mutant(
        "C driver: an x that is being assigned is still known", "sw/c/ukf_driver.c",
        "    if (base == core->state) {", "    if (base == 1u) {",
        C_DRIVER + " -k x_is_read",
    ),
    Mutant(
        "C driver: an x of which half has been read is known", "sw/c/ukf_driver.c",
        "driver->x_known = result == UKF_OK;", "driver->x_known = true;",
        C_RECOVERY,
    ),
    Mutant(
        "C driver: an update that is refused leaves x known", "sw/c/ukf_driver.c",
        "    driver->x_known = false;\n    result = run_of(", "    result = run_of(",
        C_DRIVER + " -k refused",
    ),
    Mutant(
        "C driver: angles are wrapped to the first point", "sw/c/ukf_driver.c",
        "== 0u ? 0u : core->points - 1u", "== 0u ? 0u : 1u",
        C_DRIVER + " -k angles",
    ),
    Mutant(
        "C filter: sigma points are counted from the first one", "sw/c/ukf_software.c",
        "return bad_model(ukf, k, i);",
        "return bad_model(ukf, k - ukf_core_first_point(ukf->driver.core), i);",
        C_DRIVER + " -k without_a_result",
    ),
    Mutant(
        "C driver: after the time-out it does not look once more", "sw/c/ukf_driver.c",
        "        result = get(driver, UKF_STATUS_OFFSET, status);\n"
        "        if (result != UKF_OK || late ||",
        "        result = late ? UKF_TIMEOUT : get(driver, UKF_STATUS_OFFSET, status);\n"
        "        if (result != UKF_OK || late ||",
        C_DRIVER,
    ),
    Mutant(
        "C driver: polls are not bounded", "sw/c/ukf_driver.c",
        "deadline || polls == 0u || late", "deadline || polls >> 50 != 0u || late",
        C_DRIVER,
    ),
    Mutant(
        "C driver: a finite gate becomes infinite", "sw/c/ukf_driver.c",
        "overflows ? largest : gate", "gate",
        C_DRIVER,
    ),
    Mutant(
        "C driver: a write that fails leaves no doubt", "sw/c/ukf_driver.c",
        ": ukf_driver_judged(driver, refused(driver, address));", ": refused(driver, address);",
        C_RECOVERY,
    ),
    Mutant(
        "C driver: a step that fails leaves no doubt", "sw/c/ukf_driver.c",
        "ukf_driver_judged(driver, start_and_wait(driver, step, sensor, variant, status));",
        "start_and_wait(driver, step, sensor, variant, status);",
        C_RECOVERY,
    ),
    Mutant(
        "C driver: x from before a prediction is not written again", "sw/c/ukf_driver.c",
        "if (result == UKF_OK && driver->predicted) {\n        result = ukf_driver_write(",
        "if (result == UKF_OK && driver->dropping) {\n        result = ukf_driver_write(",
        C_RECOVERY,
    ),
    Mutant(
        "C driver: INIT forgets a prediction that is there still", "sw/c/ukf_driver.c",
        "            driver->initialised = true;\n", "",
        C_RECOVERY + "::test_undoing_may_fail",
    ),
    Mutant(
        "C driver: a handler of interrupts hides the end of a step", "sw/c/ukf_driver.c",
        "result = put(driver, UKF_INTERRUPT_ENABLE_OFFSET, 0u);", "",
        C_RECOVERY + "::test_every_step_may_fail_to_end",
    ),
    Mutant(
        "C filter: an assignment that broke off is not made", "sw/c/ukf_filter.c",
        "ukf->unfinished != NULL ? ukf->unfinished(ukf) : UKF_OK", "UKF_OK",
        C_RECOVERY,
    ),
    Mutant(
        "C filter: a noise that is refused stays", "sw/c/ukf_filter.c",
        "result = back_out(ukf, write_next_noise(ukf), write_old_noise);",
        "result = write_next_noise(ukf);",
        C_RECOVERY + "::test_a_noise_that_the_core_refuses_is_not_taken",
    ),
    Mutant(
        "C filter: a predict stays whose covariance is none", "sw/c/ukf_filter.c",
        "back_out(ukf, redraw(ukf), undo_predict)", "redraw(ukf)",
        C_RECOVERY + "::test_a_predict_whose_covariance_overflows",
    ),
    Mutant(
        "C filter: one that has not been started may be used", "sw/c/ukf_filter.c",
        "result == UKF_OK && !ukf->started ?", "result != UKF_OK && !ukf->started ?",
        C_RECOVERY + "::test_the_first_start_may_fail",
    ),
    Mutant(
        "C driver: a code of the core without a name is not handed on", "sw/c/ukf_driver.c",
        "code < UKF_FIRST_OWN_RESULT ?", "code <= UKF_ERROR_CODE_NOT_POSITIVE_DEFINITE ?",
        C_DRIVER,
    ),
    Mutant(
        "C filter: a gated update uses up the prediction", "sw/c/ukf_filter.c",
        "if (result == UKF_OK && !ukf->gated) {", "if (result == UKF_OK) {",
        C_DRIVER,
    ),
    Mutant(
        "C filter: asymmetry is judged beside the largest element", "sw/c/ukf_filter.c",
        "sqrt(fabs((double)A[i * size + i])) *",
        "sqrt(fabs((double)A[0])) *",
        C_DRIVER,
    ),
    Mutant(
        "C filter: the upper triangle of a covariance is dropped", "sw/c/ukf_factor.c",
        "return lower + (A[j * size + i] - lower) / 2;", "return lower;",
        C_DRIVER,
    ),
    Mutant(
        "C filter: a covariance with small pivots is refused", "sw/c/ukf_factor.c",
        " || factorise(size, A, part, 0.0, B)) {", ") {",
        C_DRIVER,
    ),
    Mutant(
        "C filter: a factor is not compared with its covariance", "sw/c/ukf_factor.c",
        "if (!(fabs(rest) <= tolerance * unit)) {", "if (!(fabs(rest) <= unit)) {",
        C_DRIVER,
    ),
    Mutant(
        "C filter: a singular covariance is definite", "sw/c/ukf_factor.c",
        "factorise(size, A, -ukf_rounding_errors(size), 0.0, scratch)",
        "factorise(size, A, 0.0, 0.0, scratch)",
        C_DRIVER,
    ),
    Mutant(
        "C filter: a start that is refused is tried for ever", "sw/c/ukf_filter.c",
        "return ukf->started ? back_out(ukf, result, write_old_noise) : result;",
        "ukf->driver.doubtful = result != UKF_OK;\n    return result;",
        C_RECOVERY + "::test_a_start_that_the_core_refuses",
    ),
    Mutant(
        "C filter: a start that is refused leaves its noise", "sw/c/ukf_filter.c",
        "return ukf->started ? back_out(ukf, result, write_old_noise) : result;",
        "return result;",
        C_RECOVERY + "::test_a_start_that_the_core_refuses",
    ),
    Mutant(
        "C filter: angles of z are not wrapped", "sw/c/ukf_software.c",
        "if ((angles >> i & 1u) != 0u) {", "if (i > UKF_MAX_SIZE) {",
        C_DRIVER,
    ),
    Mutant(
        "C driver: an update loses the masks of other sensors", "sw/c/ukf_driver.c",
        "bits = (before & ~(own << rows.first)) | (mask & own) << rows.first;",
        "bits = (mask & own) << rows.first;",
        C_DRIVER + " -k sensors",
    ),
    Mutant(
        "C filter: a model is given the noise terms of another sensor", "sw/c/ukf_software.c",
        "get_column(ukf->V + terms.first * core->points,", "get_column(ukf->V,",
        C_DRIVER + " -k sensors",
    ),
    Mutant(
        "C filter: half of a new noise is taken for the old one", "sw/c/ukf_filter.c",
        "ukf->noise_written ? ukf->noise : NULL", "ukf->noise",
        C_RECOVERY + " -k starting_again",
    ),
    Mutant(
        "driver: half of a new noise is taken for the old one", "sw/ukf_sw/drivers/driver.py",
        "self._noise if self._noise_written else None", "self._noise",
        "tests/sw/test_recovery.py -k starting_again",
    ),
    Mutant(
        "C driver: H takes points that a rejected update has overwritten", "sw/c/ukf_driver.c",
        "(propagated && step == UKF_STEP_COVARIANCE);", "propagated;",
        f"{C_ON_CORE} -k failed",
    ),
    Mutant(
        "C driver: an h that failed loses its points", "sw/c/ukf_driver_models.c",
        "        driver->propagated = propagated;\n", "",
        f"{C_ON_CORE} -k failed",
    ),
    Mutant(
        "C driver: an iterate whose h failed loses its points", "sw/c/ukf_driver_models.c",
        "driver->predicted && refusal == UKF_MODEL_H;", "false && refusal == UKF_MODEL_H;",
        f"{C_ON_CORE} -k failed",
    ),
    Mutant(
        "C driver: inputs are written in each step", "sw/c/ukf_driver_models.c",
        "    memcpy(held, wanted, count * sizeof *held);\n", "",
        f"{C_ON_CORE} -k cross_the_bus",
    ),
    Mutant(
        "C driver: an input whose writing broke off is known", "sw/c/ukf_driver_models.c",
        "            held[i] = UKF_NOT_HELD;\n", "",
        f"{C_ON_CORE} -k broke_off",
    ),
    Mutant(
        "C driver: the variant is not handed on", "sw/c/ukf_driver.c",
        "variant << UKF_CONTROL_VARIANT_SHIFT", "(variant & 0u)",
        f"{C_ON_CORE} -k variants",
    ),
    Mutant(
        "C driver: an F that broke off is a prediction", "sw/c/ukf_driver.c",
        "driver->step != UKF_STEP_F;", "driver->step != UKF_STEP_IDLE + 100u;",
        f"{C_RECOVERY_OF_MODELS} -k undone",
    ),
    Mutant(
        "C driver: an iterate whose f has failed is a prediction", "sw/c/ukf_driver.c",
        "const bool failed = driver->step == UKF_STEP_ITERATE &&",
        "const bool failed = driver->step > UKF_STEP_ITERATE &&",
        f"{C_RECOVERY_OF_MODELS} -k undo",
    ),
    Mutant(
        "driver: an iterate whose f has failed is a prediction", "sw/ukf_sw/drivers/driver.py",
        "self._step = Step.ITERATE  # if", "pass  # if",
        f"{C_RECOVERY_OF_MODELS} -k undo",
    ),
    Mutant(
        "C driver: an H that was lost has not changed the factor", "sw/c/ukf_driver.c",
        "        driver->step != UKF_STEP_H && driver->step != UKF_STEP_ITERATE) {",
        "        driver->step != UKF_STEP_ITERATE) {",
        f"{C_RECOVERY_OF_MODELS} -k end",
    ),
    Mutant(
        "C filter: an iterate is one step although predict redraws", "sw/c/ukf_filter.c",
        "taken.used == 0u || ukf->redraw ||", "taken.used == 0u ||",
        f"{C_ON_CORE} -k iterate_is_one",
    ),
    Mutant(
        "C filter: inputs of f that were never set are sent", "sw/c/ukf_filter.c",
        "if (!ukf_is_number((double)ukf->inputs.wanted[i])) {", "if (i > UKF_MAX_SIZE) {",
        f"{C_ON_CORE} -k must_have_been",
    ),
    Mutant(
        "C filter: a start leaves the inputs", "sw/c/ukf_filter.c",
        "rely on nothing. */\n    forget_inputs(ukf);\n", "rely on nothing. */\n",
        f"{C_ON_CORE} -k all_inputs",
    ),
    Mutant(
        "driver: a reset leaves the inputs", "sw/ukf_sw/drivers/driver.py",
        "rely on nothing\n        self._inputs.clear()\n", "rely on nothing\n",
        f"{C_ON_CORE} -k all_inputs",
    ),
    Mutant(
        "C filter: a new estimate keeps the points of the old", "sw/c/ukf_filter.c",
        "    ukf->transformed = false;\n"
        "    return ukf_driver_write(&ukf->driver, ukf->driver.core->state,",
        "    return ukf_driver_write(&ukf->driver, ukf->driver.core->state,",
        C_DRIVER,
    ),
    Mutant(
        "C filter: NaN passes where the compiler may deny it", "sw/c/ukf_real.h",
        "(word & UINT64_C(0x7FF0000000000000)) != UINT64_C(0x7FF0000000000000)",
        "word != 0 || value == value",
        C_DRIVER,
    ),
    Mutant(
        "written models: numbers next to the smallest normal one are rounded twice",
        "sw/ukf_sw/lowering/c_problem.py",
        "fabs(number) < 0x1p-126 - 0x1p-151 ?", "number != number ?",
        C_PROBLEM + " -k rounded_as_in_python",
    ),
    Mutant(
        "written models: a model that there is not is the first", "sw/ukf_sw/lowering/c_problem.py",
        "? (uint32_t){number} : {count}u;", "? (uint32_t){number} : 0u;",
        C_PROBLEM + " -k without_their_numbers",
    ),
    Mutant(
        "written models: numbers that were never given are zeros",
        "sw/ukf_sw/lowering/c_problem.py",
        'lines += ["if (!given.is_set) {", "    return false;", "}"]\n        lines.append(',
        "pass\n        lines.append(",
        C_PROBLEM + " -k without_their_numbers",
    ),
    Mutant(
        "written models: angles of a sensor are those of the state",
        "sw/ukf_sw/lowering/c_problem.py",
        'cast("tuple[int, ...]", self._problem.sensor(name).angles)',
        'cast("tuple[int, ...]", self._problem.state_angles)',
        C_PROBLEM + " -k sensors_and_angles",
    ),
    Mutant(
        "written models: those of another core stay beside a core without",
        "hdl/ukf_hdl/generate.py",
        "for name in set(gone).difference(files):", "for name in ():",
        C_PROBLEM + " -k says_why",
    ),
    Mutant(
        "written models: an export numbers them in its own order",
        "tools/ukf_tools/cli/c_software.py",
        "if inputs.choices and recipe.name is not None:", "if recipe.name is None:",
        C_PROBLEM + " -k an_export",
    ),
    Mutant(
        "written models: a sensor that was not sampled chooses", "sw/ukf_sw/tracing/inputs.py",
        "if sensor not in used:", "if not used:",
        "tests/sw/test_tracing_inputs.py -k not_sampled",
    ),
    Mutant(
        "written models: C is compared with models in float64", "tools/ukf_tools/arm/emulator.py",
        "problem = write_models(problem, folder)", "write_models(problem, folder)",
        "tests/system/test_c_programs.py -k cortex_a9",
    ),
    Mutant(
        "models in software: a sensor has the noise of the next", "sw/ukf_sw/lowering/software.py",
        "name: tuple(lower_model(model, fmt, places) for model in models)",
        "name: tuple(lower_model(model, fmt, places, (), 1) for model in models)",
        SOFTWARE_MODELS + " -k noise",
    ),
    Mutant(
        "models in software: angles are wrapped twice", "sw/ukf_sw/lowering/software.py",
        "f=lower_model(traced.f, fmt, places),",
        "f=lower_model(traced.f, fmt, places, problem.state_angles),",
        SOFTWARE_MODELS + " -k angles",
    ),
    Mutant(
        "C application: a sensor sees the mask of the first", "sw/c/apps/scenario_run.c",
        "sampled >> rows.first &", "sampled &",
        C_MODELS + " -k with_an_angle",
    ),
    Mutant(
        "C application: NIS of the last sensor only", "sw/c/apps/scenario_run.c",
        "(ukf_is_number(record->nis) ? record->nis : 0.0) + (double)ukf->nis", "(double)ukf->nis",
        C_MODELS + " -k with_an_angle",
    ),
    Mutant(
        "C application: a scenario for another core is run", "sw/c/apps/scenario_run.c",
        "scenario->m != UKF_M || scenario->q != UKF_Q ||", "scenario->m != UKF_M ||",
        C_MODELS + " -k another_core",
    ),
    Mutant(
        "C models: a warning about a user's file is an error",
        "sim/ukf_sim/c_in_the_loop/compiler.py",
        'USER_FLAGS = ("-std=gnu11",)', "USER_FLAGS = OWN_FLAGS",
        C_MODELS + " -k warnings",
    ),
    Mutant(
        "filter: an error that leaves a doubt leaves none", "sw/ukf_sw/certainty.py",
        "if kind is None or issubclass(kind, REFUSALS):", "if True:",
        RECOVERY,
    ),
    Mutant(
        "driver: a predict that broke off is taken for one that has happened",
        "sw/ukf_sw/drivers/driver.py",
        "predicted = self._before is not None and step not in (Step.PREDICT, Step.F)",
        "predicted = self._before is not None",
        "tests/sw/test_driver.py",
    ),
    Mutant(
        "driver: a factorisation that has happened is taken for none",
        "sw/ukf_sw/drivers/driver.py",
        "            if status & POINTS:\n", "            if False:\n",
        RECOVERY,
    ),
    Mutant(
        "driver: what broke off is not sent again", "sw/ukf_sw/certainty.py",
        "            if self._unfinished is not None:\n", "            if False:\n",
        RECOVERY,
    ),
    Mutant(
        "driver: a lost interrupt is a time-out", "sw/ukf_sw/drivers/driver.py",
        "            if late or not status & STATE:\n                return status",
        "            if late or not status & STATE:\n                return status | STATE * late",
        "tests/sw/test_driver.py",
    ),
    Mutant(
        "filter: a predict whose covariance fails stays", "sw/ukf_sw/filter.py",
        "                self._backend.undo_predict()\n                raise",
        "                raise",
        "tests/sw/test_filter.py -k overflow",
    ),
    Mutant(
        "bus of a board: the interrupt is not enabled again", "sw/ukf_sw/drivers/uio.py",
        "os.write(self._events, _ENABLE)", "pass",
        "tests/sw/test_boards.py",
    ),
    Mutant(
        "bus of a board: the buffer is read while a step runs", "sw/ukf_sw/drivers/device_bus.py",
        "self._load(STATUS.offset) & _STATE", "False",
        "tests/sw/test_boards.py",
    ),
    Mutant(
        "bus of a board: a name of two devices is the first one's", "sw/ukf_sw/drivers/uio.py",
        "if len(found) > 1:", "if False:",
        "tests/sw/test_boards.py -k two_uio",
    ),
    Mutant(
        "packaging: half of the address range", "hdl/ukf_hdl/instance.py",
        "max(1 << MemoryMap(params).address_width, _PAGE)",
        "max(1 << MemoryMap(params).address_width - 1, _PAGE)",
        "tests/system/test_package.py -k scripts_make",
    ),
    Mutant(
        "packaging: the bitstream is not turned round", "hdl/ukf_hdl/packaging/vivado/build.tcl",
        " -disablebitswap", "",
        "tests/system/test_package.py -k scripts_make",
    ),
    Mutant(
        "packaging: board files in the order of text", "hdl/ukf_hdl/packaging/vivado/build.tcl",
        "[lindex [get_board_parts -quiet -nocase -latest_file_version $pattern] 0]",
        "[lindex [lsort [get_board_parts -quiet -nocase $pattern]] end]",
        "tests/system/test_package.py -k latest_files",
    ),
    Mutant(
        "packaging: a command that 2020.2 lacks", "hdl/ukf_hdl/packaging/vivado/build.tcl",
        "wait_on_run ", "wait_on_runs ",
        "tests/system/test_package.py -k scripts_make",
    ),
    Mutant(
        "names: the C header of every core has the same macros", "hdl/ukf_hdl/instance.py",
        'return "UKF" if self.name == NAME else self.name.upper()', 'return "UKF"',
        "tests/hdl/test_interfaces.py -k two_cores",
    ),
    Mutant(
        "names: the Verilog of every core has the same modules", "hdl/ukf_hdl/generate.py",
        "verilog.convert(Toplevel(core), name=stem,", "verilog.convert(Toplevel(core), name=NAME,",
        "tests/system/test_verilog.py -k module_in_common",
    ),
    Mutant(
        "waivers: all widths", "hdl/ukf_hdl/lint_waivers.py",
        '("*expects * bits on the Assign RHS, but Assign RHS\'s SHIFTR generates*",)', '("*",)',
        "tests/system/test_verilog.py -k still_finds",
    ),
    Mutant(
        "another interrupt in the device tree", "hdl/ukf_hdl/interfaces/device_tree.py",
        """interrupts = <0 {record["interrupt"] - FIRST_SHARED} 4>;""",
        """interrupts = <0 {record["interrupt"]} 4>;""",
        "tests/system/test_package.py -k device_tree",
    ),
    Mutant(
        "testbench: words are not compared", "sim/ukf_sim/testbench.py",
        " || rdata !== accesses[i][31:0]", "",
        "tests/system/test_package.py -k icarus",
    ),
    Mutant(
        "software baseline: the gain has the wrong sign", "tools/ukf_tools/baseline/c/fast.c",
        "right[i] -= l * right[j];", "right[i] += l * right[j];",
        "tests/system/test_baseline.py -k follows",
    ),
    Mutant(
        "costs: a return is a load", "tools/ukf_tools/baseline/costs.py",
        '''"b #0" if register == "pc" else ''', "",
        "tests/system/test_baseline.py -k rewritten",
    ),
    Mutant(
        "design space: cycles do not depend on the pipeline",
        "tools/ukf_tools/design_space/parts.py",
        'Core(params=self.params, pipeline=self.pipeline).record(),\n            "redraws"',
        'Core(params=self.params).record(),\n            "redraws"',
        f"{DESIGN_SPACE} -k know_what",
    ),
    Mutant(
        "design space: a worker may have other sources",
        "tools/ukf_tools/design_space/executors.py",
        "if part.key != key:", "if False:",
        f"{DESIGN_SPACE} -k other_sources",
    ),
    Mutant(
        "design space: results are kept at the end only", "tools/ukf_tools/design_space/sweep.py",
        "executor.run([part.prepared(cache) for part in missing])",
        "list(executor.run([part.prepared(cache) for part in missing]))",
        f"{DESIGN_SPACE} -k interrupted",
    ),
    Mutant(
        "design space: data files do not count", "tools/ukf_tools/design_space/sources.py",
        'if file.name == "__init__.py":', "if False:",
        f"{DESIGN_SPACE} -k digest",
    ),
    Mutant(
        "disassembler: bits are left over", "sw/ukf_sw/engine/disassembler.py",
        "for name, value in words.left(clock).items():", "for name, value in ():",
        "tests/sw/test_disassembler.py",
    ),
    Mutant(
        "disassembler: a subtraction is an addition", "sw/ukf_sw/engine/disassembler.py",
        'bool(words.take(clock, "subtract"))', 'bool(words.take(clock, "subtract") > 1)',
        "tests/sw/test_disassembler.py",
    ),
    Mutant(
        "signal lists: both copies are the first", "sim/ukf_sim/signal_lists.py",
        "address + bank * layout.bank_offset", "address",
        "tests/system/test_waves.py::test_rows_have_their_names",
    ),
    Mutant(
        "kept: the digest of a result is not looked at", "tools/ukf_tools/design_space/cache.py",
        "return result if digest == key_of([kind, key, result]) else None", "return result",
        f"{DESIGN_SPACE} -k flipped",
    ),
    Mutant(
        "kept: a damaged netlist counts as known", "tools/ukf_tools/design_space/cache.py",
        "if self.get(kind, file.stem) is not None", "if True",
        f"{DESIGN_SPACE} -k damaged_netlist",
    ),
    Mutant(
        "kept: the digest of machine code is not looked at", "sw/ukf_sw/engine/kernel_cache.py",
        "if digest != hashlib.sha256(kept).digest():", "if False:",
        "tests/sw/test_kernel_cache.py -k flipped",
    ),
    Mutant(
        "kept: any program that is there is run", "sim/ukf_sim/builds.py",
        "return kept is not None and kept == _digest(folder / program)", "return True",
        "tests/system/test_simulators.py -k damaged",
    ),
    Mutant(
        "kept: a damaged library of the simulator is linked", "sim/ukf_sim/builds.py",
        "whole = all(_digest(folder / name) == digest for name, digest in digests.items())",
        "whole = True",
        "tests/system/test_simulators.py -k damaged_library",
    ),
    Mutant(
        "kept: what is compiled is compiled in its own folder", "sim/ukf_sim/builds.py",
        "made = Path(scratch, folder.name)", 'made = folder.with_name("made")',
        "tests/system/test_simulators.py -k cannot_name",
    ),
    Mutant(
        "kept: nobody waits for a folder", "sw/ukf_sw/folders.py",
        "fcntl.flock(handle, fcntl.LOCK_EX)", "pass",
        "tests/sw/test_folders.py -k one_at_a_time",
    ),
    Mutant(
        "kept: files are written in place", "sw/ukf_sw/folders.py",
        'part = file.with_name(f".{uuid.uuid4().hex}{_PART}")', "part = file",
        "tests/sw/test_folders.py -k whole",
    ),
    Mutant(
        "command line: folders are not judged", "tools/ukf_tools/cli/paths.py",
        "parser=_parser(check_folder, option), **rest", "**rest",
        "tests/system/test_cli.py -k paths_are_judged",
    ),
    Mutant(
        "command line: messages name fields", "tools/ukf_tools/cli/names.py",
        'return f"{_OPTIONS.get(name, name)}{must}{rule}"', "return message",
        "tests/system/test_cli.py -k bad_arguments",
    ),
    Mutant(
        "command line: a record takes any seed", "sw/ukf_sw/problems/entry.py",
        "if self.recorded and seed:", "if False:",
        "tests/system/test_cli.py -k records",
    ),
    Mutant(
        "command line: a missing device is told after the work", "tools/ukf_tools/cli/backends.py",
        "make_backend(name, core.params, core.pipeline)", "pass",
        "tests/system/test_cli.py -k before_the_work",
    ),
    Mutant(
        "command line: a missing simulator is told after the work",
        "tools/ukf_tools/cli/backends.py",
        "simulator_of(simulator).require()", "simulator_of(simulator)",
        "tests/system/test_cli.py -k before_the_work",
    ),
    Mutant(
        "board: files are judged after the run", "sw/ukf_sw/board.py",
        'check_file("--save", options.save, (".npz",))', "pass",
        "tests/sw/test_boards.py -k judges",
    ),
    Mutant(
        "cluster: a scheduler that has gone is an error of Dask's",
        "tools/ukf_tools/design_space/executors.py",
        'if future.status == "cancelled":', "if False:",
        f"{DESIGN_SPACE} -k scheduler_that_is_killed",
    ),
    Mutant(
        "register server: two programs at once", "tools/ukf_tools/arm/register_server.py",
        "if self._server.is_alive():", "if False:",
        "tests/system/test_register_server.py -k second",
    ),
    Mutant(
        "signals: two in a statement", "hdl/ukf_hdl/core/unpacker.py",
        """        write = history.write_port()
        earlier = history.read_port(domain="comb")
""",
        """        write, earlier = history.write_port(), history.read_port(domain="comb")
""",
        "tests/hdl/test_generate.py -k names_of_signals",
    ),
    Mutant(
        "projects: a name may begin with an underscore", "tools/ukf_tools/new/project_writer.py",
        "[a-z][a-z0-9_]*", "[a-z_][a-z0-9_]*",
        "tests/system/test_new.py -k names_are_checked",
    ),
    Mutant(
        "tracing: a - b and b - a are one node", "sw/ukf_sw/tracing/operations.py",
        "    Operation.ADD, Operation.MULTIPLY, Operation.EQUAL,",
        "    Operation.ADD, Operation.SUBTRACT, Operation.MULTIPLY, Operation.EQUAL,",
        "tests/sw/test_tracing_graph.py",
    ),
    Mutant(
        "tracing: x + 0.0 is left out", "sw/ukf_sw/tracing/builder.py",
        "case Operation.ADD if (-0.0).hex() in known:\n"
        "                return arguments[1 - known.index((-0.0).hex())]",
        "case Operation.ADD if (0.0).hex() in known:\n"
        "                return arguments[1 - known.index((0.0).hex())]",
        "tests/sw/test_tracing_graph.py -k bits",
    ),
    Mutant(
        "tracing: slices are copies", "sw/ukf_sw/tracing/values.py",
        "else TracedArray(self.origin, found)", "else TracedArray(self.origin, found.copy())",
        "tests/sw/test_tracing_idioms.py -k views",
    ),
    Mutant(
        "tracing: other packages get arrays that record", "sw/ukf_sw/tracing/makers.py",
        "return caller == package or not is_foreign(file)", "return True",
        "tests/sw/test_tracing_idioms.py -k packages",
    ),
    Mutant(
        "tracing: a state is not looked for", "sw/ukf_sw/tracing/tracer.py",
        "    if first != again:", "    if False:",
        "tests/sw/test_tracing_refusals.py -k state",
    ),
    Mutant(
        "tracing: the place is that of the outermost call", "sw/ukf_sw/tracing/places.py",
        "return _place(own[0])", "return _place(own[-1])",
        "tests/sw/test_tracing_refusals.py -k place",
    ),
    Mutant(
        "tracing: models are compared near the first estimate only", "sw/ukf_sw/tracing/models.py",
        "for scale in (NEAR, FAR):", "for scale in (NEAR,):",
        "tests/sw/test_tracing_models.py -k near_and_far",
    ),
    Mutant(
        "tracing: models are compared for one step of the data", "sw/ukf_sw/tracing/models.py",
        "for given in _spread(data):", "for given in data[:1]:",
        "tests/sw/test_tracing_models.py -k one_step",
    ),
    Mutant(
        "tracing: a listing loses parentheses", "sw/ukf_sw/tracing/listing.py",
        "bound(arguments[1], binding + 1)", "bound(arguments[1], binding)",
        "tests/sw/test_tracing_graph.py -k executed",
    ),
]  # fmt: skip


def run(mutant: Mutant) -> tuple[bool, str]:
    """Whether a test sees the mutant, and the last line that pytest printed."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in ("sw", "hdl", "sim", "tools", "docs", "tests", "pyproject.toml", "README.md"):
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, copy / name)
        file = copy / mutant.file
        text = file.read_text(encoding="utf-8")
        if text.count(mutant.before) != 1:
            return False, f"the text to change stands {text.count(mutant.before)} times in the file"
        file.write_text(text.replace(mutant.before, mutant.after), encoding="utf-8")
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider",
                   "-m", "not slow", *mutant.tests.split()]  # fmt: skip
        result = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)
    lines = result.stdout.strip().splitlines() or result.stderr.strip().splitlines() or [""]
    # 1: tests ran and failed. Anything else, such as an import error, proves nothing.
    return result.returncode == 1 and "failed" in lines[-1], lines[-1]


def main() -> int:
    """Run all mutants, or those whose name contains the first argument."""
    wanted = sys.argv[1] if len(sys.argv) > 1 else ""
    chosen = [mutant for mutant in MUTANTS if wanted in mutant.name]
    console = Console()
    table = Table("Mutant", "Killed", "pytest says")
    killed = 0
    with Progress(console=console) as progress, ThreadPoolExecutor(2) as pool:
        task = progress.add_task("mutants", total=len(chosen))
        for mutant, (dead, says) in zip(chosen, pool.map(run, chosen), strict=True):
            killed += dead
            table.add_row(mutant.name, "yes" if dead else "[red]NO[/red]", says)
            progress.advance(task)
    console.print(table)
    console.print(f"{killed} of {len(chosen)} mutants killed")
    return 0 if killed == len(chosen) > 0 else 1


if __name__ == "__main__":
    sys.exit(main())
