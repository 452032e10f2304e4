"""Cycles and bus words of iterations, with models on the core and without."""

from dataclasses import replace

import pytest

from support.model_cores import model_core
from support.traffic import count_words
from ukf_sw.backends import golden_driver
from ukf_sw.engine.microcode import microcode
from ukf_sw.filter import UnscentedKalmanFilter
from ukf_sw.golden.core import GoldenCore
from ukf_sw.problems.finding import find
from ukf_sw.spec.float_format import BINARY64
from ukf_sw.spec.model_programs import NO_MODELS
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine
from ukf_tools.estimate.latency import iteration, latency, steps_of
from ukf_tools.estimate.traffic import bus_words, traffic_of


@pytest.mark.parametrize(
    ("pes", "total"), [(1, 6122), (2, 3327), (5, 1660), (10, 1097), (11, 842), (22, 642)]
)
def test_an_iteration_of_nanosat(pes, total):
    params = model_core("nanosat", pes=pes)
    code, found = microcode(params, Pipeline()), latency(params, Pipeline(), redraws=False)
    chain = (Program.MODEL_F, Program.PREDICT, Program.MODEL_H, Program.UPDATE)
    assert found["total"] == sum(code.clocks(program) for program in chain) == total
    assert found["steps"]["ITERATE"] == total
    assert found["steps"]["F"] + found["steps"]["H"] == total
    assert found["steps"]["SIG_GEN"] == 0
    assert found["bus_words"] == 17


def test_steps_of_models_in_software_are_as_ever():
    params = UkfParams(n=2, m=3, sensors=(1, 2))
    assert list(steps_of(params, redraws=False)) == [
        "PREDICT", "SIG_GEN", "UPDATE of sensor 0", "UPDATE of sensor 1",
    ]  # fmt: skip
    assert list(iteration(params, redraws=False)) == [
        "PREDICT", "UPDATE of sensor 0", "UPDATE of sensor 1",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("which", "redraws", "steps"),
    [
        ((), False, ["PREDICT", "UPDATE"]),
        (("f",), False, ["F", "UPDATE"]),
        (("f",), True, ["F", "SIG_GEN", "UPDATE"]),
        (("h",), False, ["PREDICT", "H"]),
        (("f", "h"), False, ["ITERATE"]),
        (("f", "h"), True, ["F", "SIG_GEN", "H"]),
    ],
)
def test_steps_of_an_iteration(which, redraws, steps):
    params = model_core("ctrv", which, pes=12)
    found = iteration(params, redraws=redraws)
    assert list(found) == steps
    record = latency(params, Pipeline(), redraws=redraws)
    assert record["total"] == sum(record["steps"][name] for name in steps)
    redrawn = {routine.program for chain in found.values() for routine in chain}
    assert (Program.UPDATE_REDRAWN in redrawn) is redraws


def test_the_longest_observation_model_counts():
    """That of the radar, not of the lidar; each is among the programs."""
    params = model_core("ctrv", pes=12)
    code, record = microcode(params, Pipeline()), latency(params, Pipeline(), redraws=False)
    clocks = [code.clocks(Program.MODEL_H, 0, variant) for variant in range(2)]
    assert clocks == [record["programs"][f"MODEL_H, variant {variant}"] for variant in range(2)]
    assert record["steps"]["H"] == max(clocks) + code.clocks(Program.UPDATE)
    assert clocks[0] != clocks[1]


def test_clocks_are_those_that_the_golden_core_counts():
    params = model_core("battery", pes=4)
    core, found = GoldenCore(params), iteration(params, redraws=False)["ITERATE"]
    expected = sum(core.engine.clocks(*routine) for routine in found)
    assert latency(params, Pipeline(), redraws=False)["total"] == expected
    assert found[0] == Routine(Program.MODEL_F)


@pytest.mark.parametrize("redraws", [False, True])
@pytest.mark.parametrize(
    "params",
    [
        UkfParams(n=1, m=1, q=1, r=1),
        UkfParams(n=3, m=2, q=1, r=2),
        UkfParams(n=3, m=2, q=1, r=2, W0=0.5, format=BINARY64),
        UkfParams(n=2, m=3, q=2, r=3, sensors=(1, 2), process_noise=Noise.ADDITIVE),
        UkfParams(n=3, m=3, q=1, r=3, sensors=(1, 1, 1), W0=0.25, form=Form.COVARIANCE),
        UkfParams(n=4, m=4, r=4, sensors=(3, 1), observation_noise=Noise.ADDITIVE),
    ],
)
def test_bus_words_are_those_that_the_driver_counts(params, redraws):
    counted = count_words(params, redraws=redraws)
    assert traffic_of(params, redraws=redraws) == counted
    assert bus_words(params, redraws=redraws) == counted.words


@pytest.mark.parametrize("redraws", [False, True])
@pytest.mark.parametrize("which", [(), ("f",), ("h",), ("f", "h")])
@pytest.mark.parametrize("name", ["nanosat", "battery"])
def test_bus_words_with_models(name, which, redraws):
    """What the driver counts; inputs that have not changed are not written."""
    problem = replace(find(name).scenario(0, 100), redraw=redraws)
    params = model_core(name, which, pes=10)
    driver = golden_driver(params)
    places = dict.fromkeys(("f", "h"), "software") | dict.fromkeys(which, "core")
    ukf = UnscentedKalmanFilter(problem, driver, models=places)
    data, counts = problem.data, []
    for k in range(4):
        before, inputs = driver.traffic, dict(driver._inputs)
        arguments = data.observation_arguments
        ukf.iterate(
            data.inputs[k], problem.samples(problem.sensor_names[0])[0][k],
            **({} if arguments is None else arguments[k]),
        )  # fmt: skip
        _ = ukf.x
        same = sum(driver._inputs[place] == word for place, word in inputs.items())
        size = params.format.bus_words
        found = driver.traffic - before
        counts.append(replace(found, words_written=found.words_written + same * size))
    assert counts[1:] == [traffic_of(params, redraws=redraws)] * 3


def test_bus_words_of_no_models():
    params = model_core("nanosat", pes=10)
    bare = replace(params, models=NO_MODELS)
    assert bus_words(bare, redraws=False) > 10 * bus_words(params, redraws=False)
