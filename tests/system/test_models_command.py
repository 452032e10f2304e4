"""Command ``ukf models``."""

import json
import sys

import pytest

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


@pytest.fixture
def mine(ukf, tmp_path, monkeypatch):
    """Function that shows a problem of the user with this body of f."""
    monkeypatch.syspath_prepend(tmp_path)

    def show(body, *options, code=0):
        sys.modules.pop("mine_to_show", None)
        (tmp_path / "mine_to_show.py").write_text(MODEL.format(body=body))
        return ukf("models", "show", "--problem", "mine_to_show:problem", *options, code=code)

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
    assert f"({tmp_path / 'mine_to_show.py'}, line 6); use np.where(condition, a, b)" in message
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
