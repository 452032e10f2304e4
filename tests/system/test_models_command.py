"""Command ``ukf models``."""

import itertools
import json

import pytest

from support.model_cores import model_core
from ukf_docs.studies import elementary
from ukf_sw.elementary.accuracy import largest_error
from ukf_sw.elementary.functions import FUNCTIONS
from ukf_sw.engine.control_word import STEERING, fields_of_models
from ukf_sw.engine.microcode import microcode
from ukf_sw.spec.float_format import BINARY16, BINARY32, FORMATS, FloatFormat
from ukf_sw.spec.model_programs import SourceKind
from ukf_sw.spec.parameters import Pipeline
from ukf_tools.estimate.model_costs import most_temporaries

MODEL = """
import numpy as np
from ukf_sw.problem import Problem, Sensor

def f(x, w, u):
    {body}

def h(x, v):
    return np.hypot(x[:1], 1.0) + v

problem = Problem(name="mine", states=("angle", "rate"), f=f, sensors=Sensor(h, R=[[1.0]]),
                  x0=[0.5, 1.0], P0=np.eye(2), inputs={{"torque": "N m", "gain": ""}})
"""


NUMBER = itertools.count()


@pytest.fixture
def mine(ukf, tmp_path, monkeypatch):
    """Function that shows a problem of the user with this body of f."""
    monkeypatch.syspath_prepend(tmp_path)

    def show(body, *options, code=0):
        # A name of its own: Python knows a module that has changed by its size and the second.
        name = f"mine_to_show{next(NUMBER)}"
        (tmp_path / f"{name}.py").write_text(MODEL.format(body=body))
        return ukf("models", "show", "--problem", f"{name}:problem", *options, code=code)

    return show


def test_show_says_what_the_models_compute(ukf):
    text = ukf("models", "show", "--problem", "ctrv").stdout
    assert "f: 5 rows, 10 operations deep\n" in text
    assert "h (device='radar'): 3 rows, 6 operations deep\n" in text
    assert "h (device='lidar'): 3 rows, 2 operations deep\n" in text
    assert "x[3] (heading), x[4] (turn rate), w[0], w[1], u (interval)\n" in text
    assert "  operations once: 2: 2 multiply\n" in text
    assert "  functions: divide, sqrt, sin, cos, arctan2\n" in text
    assert "  constants: 0.15~, 0.03~; ~ is rounded in binary32\n" in text
    assert " = " not in text


def test_show_lists_the_operations(ukf):
    text = ukf("models", "show", "--problem", "pendulum", "--listing").stdout
    assert "    x[0] = x[0] + 0.01 * x[1] + 0.0\n" in text
    assert "    sine of the angle = sin(x[0]) + 0.0\n" in text


@pytest.mark.parametrize("listing", [(), ("--listing",)])
def test_show_as_json(ukf, listing):
    made = json.loads(ukf("models", "show", "--problem", "battery", "--json", *listing).stdout)
    assert (made["problem"], made["format"]) == ("battery", "binary32")
    f, h = made["models"]
    assert f["operations"]["once"] == {"multiply": 3}
    assert [source["name"] for source in f["inputs"]][-1] == "current"
    assert h["inputs"][-1] == {"label": "current", "name": None, "per_point": False}
    assert h["depth"] == 12
    assert ("listing" in f) == bool(listing)


def test_format_of_the_core_decides_what_is_exact(ukf):
    ctrv = ("models", "show", "--problem", "ctrv")
    assert "all exact in binary64" in ukf(*ctrv, "--format", "binary64").stdout
    assert "~ is rounded in float6.17" in ukf(*ctrv, "--format", "float6.17").stdout
    assert "--format must be one of binary16" in ukf(*ctrv, "--format", "x", code=2).stderr
    message = ukf("models", "show", "--problem", "reentry", "--format", "binary16", code=2).stderr
    assert "each constant of process model f (_move) must be at most 65504" in message


def test_problems_of_the_user(mine):
    text = mine("return np.array([x[0] + u[1] * x[1], u[0]])", "--listing").stdout
    assert "inputs: x[0] (angle), x[1] (rate), u[0] (torque), u[1] (gain)\n" in text
    assert "    x[0] = x[0] + u[1] * x[1]\n    x[1] = u[0]\n" in text
    assert "  constants: none\n" in text


def test_refusals_are_messages(mine, tmp_path):
    message = mine("return x if x[0] > 0.0 else -x", code=2).stderr
    assert message.startswith("Error: process model f (f) must not branch on data, as in `")
    (written,) = tmp_path.glob("*.py")
    assert f"({written}, line 6); use np.where(condition, a, b)" in message
    message = mine("return x[:1]", code=2).stderr
    assert "process model f (f) must return the shape (2,), at a sigma point, not (1,)" in message
    message = mine("return x[7:] + missing", code=2).stderr
    assert "NameError: name 'missing' is not defined" in message
    assert "in process model f (f), traced with x of shape (2,)" in message


def test_steps_are_those_that_there_are(ukf):
    few = ukf("models", "show", "--problem", "ctrv", "--steps", 1).stdout
    assert "device='lidar'" in few
    assert "device='radar'" not in few
    assert "device='radar'" in ukf("models", "show", "--problem", "ctrv", "--steps", 100000).stdout
    assert "--steps must be at least 1" in ukf("models", "show", "--steps", 0, code=2).stderr


# Programs.


def test_show_says_what_the_programs_need(ukf):
    made = json.loads(
        ukf("models", "show", "--problem", "ctrv", "--pes", "3,11-12", "--json").stdout
    )
    params = model_core("ctrv")
    fields = set()
    for record, program in zip(made["models"], params.models, strict=True):
        found = record["program"]
        assert (found["slots"], found["streams"]) == (program.slots, program.streams)
        assert found["scalars"] == list(program.scalars)
        assert found["words"] == list(program.words)
        assert [entry["name"] for entry in found["functions"]] == record["functions"]
        for entry in found["functions"]:
            assert entry["error_ulp"] == largest_error(entry["name"], params.format)
        assert not found["powers"]
        assert not found["exponents"]
        fields |= {*found["forms"], *(["signed"] if found["signed_roots"] else [])}
    assert fields == fields_of_models(params.models) - {"of_model", "unchecked"}
    assert fields > set(STEERING[3:5])
    for pes in (3, 11, 12):
        code = microcode(model_core("ctrv", pes=pes), Pipeline())
        clocks = [code.clocks(*routine) for routine in list(code.programs)[-3:]]
        found = [record["program"]["clocks"] for record in made["models"]]
        assert [each[str(pes)] for each in found] == clocks
        assert all(list(each) == ["3", "11", "12"] for each in found)


def test_lines_of_programs(ukf):
    text = ukf("models", "show", "--problem", "ctrv", "--pes", 12).stdout
    f, radar, lidar = model_core("ctrv").models
    for program in (f, radar, lidar):
        assert f"  program: {program.slots} issue slots a beat and " in text
        scalars, words = len(program.scalars), len(program.words)
        assert f"  constants of it: {scalars} as scalars, {words} as words\n" in text
    assert f"ulp: divide {largest_error('divide', BINARY32):.2f}, sin " in text
    assert text.count("  powers and exponents: not built in\n") == 3
    assert text.count(" with 12 PEs\n") == 3
    assert "with" not in ukf("models", "show", "--problem", "battery").stdout.partition("clocks")[2]


def test_powers_and_exponents_are_built_in_where_they_are_needed(mine):
    text = mine("return np.array([np.exp(x[0]), x[1]])").stdout
    f, h = text.split("\nh: ")
    assert "lanes need: " in f
    assert "powers of two" in f
    assert " exponents," not in f.split("lanes need:")[1].splitlines()[0]
    assert f.endswith("  powers and exponents: built in")
    assert "  powers and exponents: not built in\n" in h
    f = mine("return np.array([np.log(x[0]), x[1]])").stdout.split("\nh: ")[0]
    assert "exponents" in f.split("lanes need: ")[1].splitlines()[0]
    # Lanes that need no more than the filter's.
    assert "  largest errors of functions in binary32, in ulp: none\n" in mine("return x").stdout


def test_formats_without_coefficients_have_no_programs(ukf):
    text = ukf("models", "show", "--problem", "ctrv", "--format", "float6.17").stdout
    assert text.count("  program: none, format of elementary functions must be one of ") == 3
    assert "`make coefficients FORMATS=float6.17` makes theirs" in text
    text = ukf("models", "show", "--problem", "ctrv", "--format", "binary16").stdout
    assert f"in binary16, in ulp: divide {largest_error('divide', BINARY16):.2f}" in text


def test_numbers_of_pes_must_be_those_of_a_core(ukf):
    show = ("models", "show", "--problem", "battery", "--pes")
    assert "--pes must be a list like 1,2,4-6, not 'x'" in ukf(*show, "x", code=2).stderr
    assert "must be" in ukf(*show, "999", code=2).stderr


def test_temporaries_are_counted():
    """No more than the program writes, and as many as any step needs at least."""
    for name in ("ctrv", "battery", "nanosat"):
        for program in model_core(name).models:
            results = {*program.outputs, *(value for _, value in program.measurements)}
            written = {step.destination for step in program.steps} - results
            given = {
                temporary for temporary, source in program.inputs
                if source.kind in (SourceKind.INPUT, SourceKind.MEASUREMENT)
            }  # fmt: skip
            inside = written | given
            least = max(
                (len(inside & {*step.reads, step.destination}) for step in program.steps),
                default=0,
            )
            assert least <= most_temporaries(program) <= len(inside)
            assert most_temporaries(program) < len(inside) or len(inside) < 12


def test_errors_are_those_that_were_measured():
    """The note of the study is the file that commands read; all functions but exact ones are in."""
    record = elementary.STUDY.read()
    assert set(record) == set(elementary.EXACT) <= set(FUNCTIONS)
    for name, measured in record.items():
        for fmt in FORMATS.values():
            assert largest_error(name, fmt) == measured[fmt.name]["error"] > 0.0
        assert largest_error(name, FloatFormat(exponent_bits=6, fraction_bits=17)) is None
    assert largest_error("floor", BINARY32) is None
