"""cocotb test that runs a job of :mod:`ukf_sim.session` on the simulated core."""

import os
import pickle
import traceback
from importlib import import_module
from pathlib import Path
from typing import Any

import cocotb
from cocotb.task import bridge

from ukf_sim.bus import CoreBench
from ukf_sim.session import JOB_VARIABLE, Context, TaskFailure
from ukf_sw.errors import describe


@cocotb.test
async def run_job(dut: Any) -> None:
    """Call the job's function with the core, in a thread, and leave its result in a file."""
    folder = Path(os.environ[JOB_VARIABLE])
    job = pickle.loads((folder / "job.pickle").read_bytes())
    module, _, name = job.task.partition(":")
    task = getattr(import_module(module), name)
    bench = await CoreBench.started(dut, job.word_clocks)
    context = Context(job=job, bench=bench, folder=folder)

    def keep(result: Any) -> None:
        (folder / "result.pickle").write_bytes(pickle.dumps(result))

    try:
        result = await bridge(task)(context, **job.arguments)
    except BaseException as error:  # one that ends the process is a result, too
        notes = tuple(getattr(error, "__notes__", ()))
        message = describe(error) if notes and isinstance(error, Exception) else str(error)
        trace = traceback.format_exc()
        keep(TaskFailure(kind=type(error).__name__, message=message, trace=trace, notes=notes))
        raise
    keep(result)
