"""What models take beside sigma points, as one vector a step."""

from collections import namedtuple
from dataclasses import replace

import numpy as np
import pytest

from support.beacons import STEPS, rover, with_data
from ukf_sw.problem import Data, Sensor
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.tracing.inputs import InputVector

Parts = namedtuple("Parts", "left right")


def test_inputs_arguments_and_choices_in_their_order():
    problem = rover()
    inputs = InputVector.of(problem)
    assert inputs.labels == (
        "u[0]", "u[1]", "place[0] of h", "place[1] of h",
        "which h of beacon: 0 beacon='near', 1 beacon='far'",
        "which h of compass: 0 beacon='near', 1 beacon='far'",
    )  # fmt: skip
    assert len(inputs) == 6
    table = inputs.table(problem, 4)
    assert table.tolist() == [[1.0, 1.0, 5.0 + k, 1.0, k % 2, k % 2] for k in range(4)]


def test_sensors_that_were_not_sampled_choose_nothing():
    """Their constants may be those of nobody, and without a sample nothing of h matters."""
    sampled = {"beacon": np.zeros((STEPS, 1), bool), "compass": np.zeros((STEPS, 1), bool)}
    sampled["beacon"][[0, 2]] = True
    sampled["compass"][[0, 1]] = True
    problem = with_data(sampled=sampled)
    inputs = InputVector.of(problem)
    assert inputs.choices["beacon"] == ({"beacon": "near"},)
    assert inputs.table(problem, 4)[:, 2:].tolist() == [
        [5.0, 1.0, 0.0, 0.0], [6.0, 1.0, 0.0, 1.0], [7.0, 1.0, 0.0, 0.0], [0.0] * 4,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("u", "numbers"),
    [
        (2.5, [2.5]), (None, []), ([1.0, (2.0, 3)], [1.0, 2.0, 3.0]),
        ({"b": np.array([[1.0, 2.0], [3.0, 4.0]]), "a": 5.0}, [1.0, 2.0, 3.0, 4.0, 5.0]),
        (Parts(1.0, np.array([2.0])), [1.0, 2.0]),
    ],
    ids=["number", "none", "nested", "dict", "named"],
)  # fmt: skip
def test_all_kinds_of_u(u, numbers):
    data = Data(times=np.arange(2.0), measurements=np.zeros((2, 1)), inputs=[u, u])
    sensor = Sensor(lambda x, v: x[:1] + v, R=[[1.0]])
    problem = rover(sensors=sensor, inputs=(), data=data)
    inputs = InputVector.of(problem)
    assert inputs.table(problem, 2).tolist() == [numbers, numbers]


def test_what_is_no_number_is_named():
    inputs = InputVector.of(rover())
    arguments = [dict(given) for given in rover().record.observation_arguments]
    arguments[3]["place"] = np.array([1.0, np.nan])
    message = r"^place\[1\] must be a finite number in every step, and is none at step 3$"
    with pytest.raises(ValueError, match=message):
        inputs.table(with_data(observation_arguments=arguments), STEPS)
    del arguments[3]["place"]
    with pytest.raises(ValueError, match=r"^place\[0\] must be a finite number .* at step 3$"):
        inputs.table(with_data(observation_arguments=arguments), STEPS)
    problem = replace(rover(), inputs=())
    message = r"^u must be a finite number in every step, and is none at step 0$"
    problem = replace(problem, data=replace(problem.record, inputs=["left"] * STEPS))
    with pytest.raises(ValueError, match=message):
        InputVector.of(problem).table(problem, STEPS)


def test_the_shape_of_u_stays():
    problem = replace(rover(), inputs=())
    inputs = [np.zeros(1), *[np.zeros(2)] * (STEPS - 1)]
    problem = replace(problem, data=replace(problem.record, inputs=inputs))
    message = (
        r"^u must have the shape \(1,\) in every step, as in the first one, not \(2,\) at step 1$"
    )
    with pytest.raises(ValueError, match=message):
        InputVector.of(problem).table(problem, STEPS)


def test_constants_of_no_model_are_named():
    inputs = InputVector.of(rover())
    arguments = [dict(given, beacon="lost") for given in rover().record.observation_arguments]
    message = (
        r"^constants of h of beacon must be among \[\{'beacon': 'near'\}, \{'beacon': 'far'\}\], "
        r"not \{'beacon': 'lost'\} at step 0$"
    )
    with pytest.raises(ValueError, match=message):
        inputs.table(with_data(observation_arguments=arguments), 1)


def test_a_record_with_arguments():
    """Each step has the numbers of its own."""
    problem = CATALOGUE["battery"].scenario(0, 20)
    record = problem.record
    table = InputVector.of(problem).table(problem, 20)
    assert table[:, 0].tolist() == np.asarray(record.inputs).tolist()
    assert table[:, 1].tolist() == [given["current"] for given in record.observation_arguments]
    assert (table[:, 0] != table[:, 1]).any()
