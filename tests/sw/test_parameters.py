"""Parameters of a core: what they refuse, and the one description of a core."""

import json
import random
import re
from dataclasses import dataclass, fields, replace
from enum import Enum
from typing import Annotated

import numpy as np
import pytest

from ukf_sw.engine.layout import Layout
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.placing import core_models
from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.core import PARAMETERS, Core, Placement
from ukf_sw.spec.fields import Meaning, check_parameters, parameters_of
from ukf_sw.spec.float_format import BINARY16, BINARY32, FORMATS, FloatFormat
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams

KNOWN = ", ".join(FORMATS)
ODD = FloatFormat(exponent_bits=6, fraction_bits=17)


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Kinds that no parameter of the core has today."""

    bypass: Annotated[bool, Meaning("Whether there is one.")] = False
    ports: Annotated[int, Meaning("Ports.", low=2)] = 2
    gain: Annotated[float, Meaning("Gain.")] = 1.0


@dataclass(frozen=True)
class Mute:
    """A field that does not say what it is."""

    n: int = 1


def randomly(rng, entry):
    """Value of a parameter that is legal by itself."""
    if issubclass(entry.kind, Enum):
        return rng.choice(list(entry.kind))
    if entry.kind is FloatFormat:
        return rng.choice([*FORMATS.values(), ODD])
    if entry.kind is float:
        return rng.random()
    if entry.kind is tuple:
        return ()
    return rng.randint(entry.meaning.low, entry.meaning.high or 9)


def cores(count, seed=1):
    """Random cores."""
    rng = random.Random(seed)
    found = []
    while len(found) < count:
        values = {label: randomly(rng, entry) for label, entry in PARAMETERS.items()}
        if rng.random() < 0.5:
            first = rng.randint(1, values["m"])
            values["sensors"] = (first, *[1] * (values["m"] - first))
        try:
            found.append(Core.from_values(values))
        except ValueError:  # additive noise of another size, or too many PEs
            continue
    return found


# What is refused.


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"n": 0}, ValueError, "n must be between 1 and 32, not 0"),
        ({"m": 33}, ValueError, "m must be between 1 and 32, not 33"),
        ({"sensors": (1, 2)}, ValueError,
         "sensors must have m = 1 observations together, not (1, 2)"),
        ({"sensors": (1, 0)}, ValueError, "sensors must be between 1 and 32, not 0"),
        ({"sensors": 3}, TypeError, "sensors must be a tuple, not 3"),
        ({"sensors": (1.5,)}, TypeError, "each of sensors must be an int, not 1.5"),
        ({"sensors": "1,2"}, ValueError, "sensors must be like 3+3, or one, not '1,2'"),
        ({"q": -1}, ValueError, "q must be between 0 and 32, not -1"),
        ({"r": 33}, ValueError, "r must be between 0 and 32, not 33"),
        ({"n": "2"}, TypeError, "n must be an int, not '2'"),
        ({"n": True}, TypeError, "n must be an int, not True"),
        ({"n": 2.0}, TypeError, "n must be an int, not 2.0"),
        ({"pes": 0}, ValueError, "pes must be at least 1, not 0"),
        ({"pes": 5}, ValueError,
         "pes must be between 1 and the number of columns, 4, not 5"),
        ({"process_noise": "colored"}, ValueError,
         "process_noise must be one of augmented, additive, not 'colored'"),
        ({"observation_noise": None}, TypeError, "observation_noise must be a Noise, not None"),
        ({"form": 1}, TypeError, "form must be a Form, not 1"),
        ({"format": "fp32"}, ValueError,
         f"format must be one of {KNOWN}, or like float6.17, not 'fp32'"),
        ({"format": 32}, TypeError, "format must be a FloatFormat, not 32"),
        ({"W0": "0"}, TypeError, "W0 must be a number, not '0'"),
        ({"W0": False}, TypeError, "W0 must be a number, not False"),
        ({"W0": 1.0}, ValueError, "W0 must be at least 0 and less than 1, not 1.0"),
        ({"W0": -0.1}, ValueError, "W0 must be at least 0 and less than 1, not -0.1"),
        ({"W0": float("nan")}, ValueError, "W0 must be at least 0 and less than 1, not nan"),
        ({"process_noise": Noise.ADDITIVE, "q": 1}, ValueError,
         "q must be 0 or n = 2 for additive noise, not 1"),
        ({"observation_noise": Noise.ADDITIVE, "r": 2}, ValueError,
         "r must be 0 or m = 1 for additive noise, not 2"),
    ],
)  # fmt: skip
def test_bad_parameters(arguments, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        UkfParams(**{"n": 2, "m": 1} | arguments)


@pytest.mark.parametrize("W0", [0.0, 0.5])
@pytest.mark.parametrize(
    "sizes",
    [
        {},
        {"q": 3, "r": 2},
        {"q": 2, "r": 3, "process_noise": "additive", "observation_noise": "additive"},
        {"r": 3, "sensors": (1, 2), "observation_noise": "additive"},
    ],
)
def test_there_are_at_most_as_many_processing_elements_as_columns(sizes, W0):
    params = UkfParams(n=2, m=3, W0=W0, **sizes)
    # Points with weight, right-hand side, and additive noise, of which sensors share the columns.
    columns = len(params.points) + 1 + params.additive_q + params.columns_of_r
    assert params.columns == columns == Layout(params).columns
    assert replace(params, pes=columns).pes == columns
    message = f"pes must be between 1 and the number of columns, {columns}, not {columns + 1}"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        replace(params, pes=columns + 1)


@pytest.mark.parametrize("W0", [0.0, 0.5])
def test_sigma_points_are_those_with_a_weight(W0):
    for n in (1, 3):
        params = UkfParams(n=n, m=2, q=2, r=1, W0=W0)
        N = n + 2 + 1 + 2
        assert params.N == N
        assert [*params.points] == [*range(0 if W0 else 1, N)]
        assert params.centre == (0 if W0 else N - 1)
        assert params.centre in params.points


@pytest.mark.parametrize(
    ("given", "plain"),
    [
        ({"n": np.int64(3), "q": np.uint8(3), "pes": np.array(2)}, {"n": 3, "q": 3, "pes": 2}),
        ({"W0": np.float32(0.25)}, {"W0": 0.25}),
        ({"W0": 0}, {"W0": 0.0}),
        ({"process_noise": "additive", "q": 2}, {"process_noise": Noise.ADDITIVE, "q": 2}),
        ({"form": "covariance"}, {"form": Form.COVARIANCE}),
        ({"format": "binary16"}, {"format": BINARY16}),
    ],
)
def test_what_is_unambiguous_is_taken(given, plain):
    taken, expected = (UkfParams(**{"n": 2, "m": 1} | each) for each in (given, plain))
    assert taken == expected
    assert hash(taken) == hash(expected)
    assert repr(taken) == repr(expected)
    assert type(taken.n) is type(taken.pes) is int
    assert type(taken.W0) is float
    assert Pipeline(add=np.int32(3)) == Pipeline(add=3)


@pytest.mark.parametrize("n", [np.bool_(True), np.float64(2.0), np.array([2])])
def test_what_is_ambiguous_is_not(n):
    with pytest.raises(TypeError, match=r"^n must be an int, not "):
        UkfParams(n=n, m=1)


@pytest.mark.parametrize(
    ("name", "largest"), [("multiply", 8), ("add", 8), ("reciprocal_sqrt", 16)]
)
def test_bad_pipeline(name, largest):
    Pipeline(**{name: largest})
    for value in (0, largest + 1):
        message = f"^{name} must be between 1 and {largest}, not {value}$"
        with pytest.raises(ValueError, match=message):
            Pipeline(**{name: value})
    with pytest.raises(TypeError, match=f"^{name} must be an int, not None$"):
        Pipeline(**{name: None})


def test_a_field_must_say_what_it_is():
    with pytest.raises(TypeError, match=r"^Mute\.n must have a Meaning$"):
        parameters_of(Mute)


# Values as text, in tables and in records.


@pytest.mark.parametrize("core", cores(40))
def test_values_come_back(core):
    for label, value in core.values().items():
        entry = PARAMETERS[label]
        assert entry.read(entry.text(value)) == value
        assert entry.from_record(json.loads(json.dumps(entry.record(value)))) == value
        assert type(entry.cell(value)) is entry.cell_kind


@pytest.mark.parametrize(
    ("label", "text", "message"),
    [
        ("n", "x", "n must be an int, not 'x'"),
        ("W0", "x", "W0 must be a number, not 'x'"),
        ("form", "x", "form must be one of square-root, covariance, not 'x'"),
        ("format", "fp", f"format must be one of {KNOWN}, or like float6.17, not 'fp'"),
        ("format", "float60.17", "Exponent bits must be between 4 and 11, not 60"),
    ],
)  # fmt: skip
def test_bad_text(label, text, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        PARAMETERS[label].read(text)


def test_switches():
    entry = parameters_of(Sample)["bypass"]
    assert [entry.text(value) for value in (False, True)] == ["false", "true"]
    assert [entry.read(text) for text in ("false", "true")] == [False, True]
    assert entry.said(True) == "bypass true"
    check_parameters(Sample(bypass=True))
    with pytest.raises(TypeError, match=r"^bypass must be a bool, not 1$"):
        check_parameters(Sample(bypass=1))
    with pytest.raises(ValueError, match=r"^bypass must be one of false, true, not 'yes'$"):
        entry.read("yes")


def test_whole_number_may_stand_for_any():
    core = Core(params=UkfParams(n=1, m=1, W0=0))
    assert type(PARAMETERS["W0"].cell(0)) is float
    assert json.dumps(core.record()) == json.dumps(Core(params=UkfParams(n=1, m=1)).record())


def test_limits():
    check_parameters(Sample(ports=1000, gain=3))
    with pytest.raises(ValueError, match=r"^ports must be at least 2, not 1$"):
        check_parameters(Sample(ports=1))


# Descriptions.


def test_every_parameter_is_described():
    names = [each.name for block in (UkfParams, Pipeline) for each in fields(block)]
    assert [entry.name for entry in PARAMETERS.values()] == names
    assert all(entry.meaning.doc.endswith(".") for entry in PARAMETERS.values())
    assert len({entry.meaning.doc for entry in PARAMETERS.values()}) == len(PARAMETERS)


@pytest.mark.parametrize("core", cores(40, seed=2))
def test_record_is_exact(core):
    assert Core.from_record(json.loads(json.dumps(core.record()))) == core
    assert Core.from_values(core.values()) == core


def test_record_tells_what_results_depend_on():
    one, other = (Core(params=NANOSAT, pipeline=Pipeline(add=depth)) for depth in (2, 3))
    assert one.record()["parameters"] == other.record()["parameters"]
    assert one.record()["pipeline"] != other.record()["pipeline"]


def test_every_parameter_tells_cores_apart():
    """In records, descriptions, titles and names of files: caches and plots depend on it."""
    base = Core(params=UkfParams(n=3, m=3, q=3, r=3, pes=2, format=BINARY32))
    others = {
        "process_noise": Noise.ADDITIVE, "observation_noise": Noise.ADDITIVE, "W0": 0.25,
        "form": Form.COVARIANCE, "format": BINARY16, "sensors": (1, 2),
    }  # fmt: skip
    for label, value in base.values().items():
        if label == "models":
            continue  # they are of a problem: the next test
        other = Core.from_values(base.values() | {label: others.get(label, value)})
        if label not in others:
            other = Core.from_values(base.values() | {label: value + 1})
        for describe in (Core.record, lambda core: core.description, lambda core: core.title,
                         lambda core: core.stem):  # fmt: skip
            assert describe(other) != describe(base), label


def test_models_tell_cores_apart():
    base = Core(params=CATALOGUE["pendulum"].params, problem="pendulum")
    found = [
        Core.from_values(base.values() | {"models": each}, "pendulum", place=core_models)
        for each in Placement
    ]
    for describe in (Core.record, lambda core: core.description, lambda core: core.title,
                     lambda core: core.stem):  # fmt: skip
        assert len({repr(describe(core)) for core in found}) == len(Placement)
    with pytest.raises(ValueError, match=r"in software without a problem, not 'core'$"):
        Core.from_values(base.values() | {"models": Placement.CORE})


def test_titles():
    sizes = UkfParams(n=2, m=1, q=1, observation_noise=Noise.ADDITIVE, W0=0.5, format=ODD)
    core = Core(params=sizes, pipeline=Pipeline(add=3))
    assert core.title == (
        "n = 2, m = 1, q = 1, r = 0, observation noise additive, W0 = 0.5, square-root form, "
        "float6.17, 1 PE, add stages 3"
    )
    assert core.title_without("pes", "W0", "n") == (
        "m = 1, q = 1, r = 0, observation noise additive, square-root form, float6.17, add stages 3"
    )
    named = Core(params=NANOSAT, problem="nanosat")
    assert named.title == "nanosat, square-root form, binary32, 1 PE"
    assert named.stem == "nanosat-square-root-form-binary32-1-pe"
    assert "multiply stages 2" in named.description


def test_values_must_be_of_parameters():
    with pytest.raises(TypeError, match=r"^parameter must be one of n, .*, not 'colour'$"):
        Core.from_values({"n": 1, "m": 1, "colour": "red"})
