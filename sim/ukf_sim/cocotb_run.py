"""Running cocotb's tests on compiled Verilog."""

from collections.abc import Mapping
from pathlib import Path

from cocotb_tools.check_results import get_results
from cocotb_tools.runner import get_runner

from ukf_sim.builds import Build
from ukf_sim.simulators import SimulatorError, tool_environment

__all__ = ["run_cocotb"]

#: cocotb has pytest rewrite the assertions of every module that the simulator's process imports,
#: of NumPy and Numba as well, which takes longer than a short simulation. Empty: of none.
NO_REWRITING = {"COCOTB_REWRITE_ASSERTION_FILES": ""}


def run_cocotb(
    compiled: Build,
    module: str,
    folder: Path,
    *,
    environment: Mapping[str, str] | None = None,
    seed: int = 1,
    waves: Path | None = None,
) -> int:
    """Run the cocotb tests of a module.

    Parameters
    ----------
    compiled
        What to simulate.
    module
        Name of the Python module with the tests.
    folder
        Folder to run in, for logs and results.
    environment
        Further environment variables.
    seed
        Seed of cocotb's random numbers.
    waves
        Where to write a waveform, for which it must have been compiled.

    Returns
    -------
    int
        Number of tests that ran, at least 1.

    Raises
    ------
    SimulatorError
        If a test fails, or none ran.
    """
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "simulation.log"
    results = (folder / "results.xml").resolve()
    options = None if waves is None else compiled.simulator.tool.waves.options(waves.resolve())
    try:
        with tool_environment(last_arguments=options.last if options else ()):
            get_runner(compiled.simulator.value).test(
                test_module=module,
                hdl_toplevel=compiled.top,
                hdl_toplevel_lang="verilog",
                build_dir=compiled.folder,
                test_dir=folder,
                results_xml=str(results),
                extra_env=NO_REWRITING | dict(environment or {}),
                seed=seed,
                log_file=log,
                test_args=options.first if options else (),
                plusargs=options.plus if options else (),
            )
        count, failed = get_results(results)
    except (RuntimeError, SystemExit) as error:
        raise SimulatorError.with_log(
            f"{compiled.simulator.value} failed to run {module} ({error})", log
        ) from error
    if failed:
        raise SimulatorError.with_log(f"{failed} of {count} tests of {module} failed", log)
    if not count:
        raise SimulatorError(f"No test ran: there is none in {module}")
    return count
