"""The test that cocotb runs, without a simulator."""

import pickle
import sys

import pytest

from ukf_sim import simulator_side
from ukf_sim.session import JOB_VARIABLE, Job, TaskFailure
from ukf_sw.spec.parameters import UkfParams


def leave(context):
    """A task that ends the process."""
    sys.exit("no core to be seen")


def answer(context, *, value):
    """A task that succeeds."""
    return value + 1


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Function that runs a task of this module, and gives what it left for the waiting process."""

    async def no_core(dut, word_clocks):
        return None

    def bridge(task):
        async def call(*arguments, **keywords):
            return task(*arguments, **keywords)

        return call

    monkeypatch.setattr(simulator_side, "bridge", bridge)
    monkeypatch.setattr(simulator_side.CoreBench, "started", no_core)
    monkeypatch.setattr(simulator_side, "import_module", lambda name: sys.modules[__name__])
    monkeypatch.setenv(JOB_VARIABLE, str(tmp_path))

    def run(name, **arguments):
        job = Job(params=UkfParams(n=1, m=1), task=f"tasks:{name}", arguments=arguments)
        (tmp_path / "job.pickle").write_bytes(pickle.dumps(job))
        with pytest.raises((StopIteration, SystemExit)):
            simulator_side.run_job.func(None).send(None)
        return pickle.loads((tmp_path / "result.pickle").read_bytes())

    return run


def test_result_is_kept(run):
    assert run("answer", value=41) == 42


def test_task_that_ends_the_process_is_reported(run):
    failure = run("leave")
    assert isinstance(failure, TaskFailure)
    assert (failure.kind, failure.message) == ("SystemExit", "no core to be seen")
    assert "in leave" in failure.trace
