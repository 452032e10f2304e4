"""A filter of the catalogue on any backend: ``python -m ukf_sw.board``.

The same command runs on a model here and on a core on a board, where it needs NumPy only. Here, on
the golden model::

    python -m ukf_sw.board --backend golden --pes 2 --steps 1000 --save golden.npz

and on the board, compared with that bit for bit::

    python -m ukf_sw.board --backend uio:0 --steps 1000 --compare golden.npz
"""

import argparse
import faulthandler
import sys
import time
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ukf_sw.backends import make_backend
from ukf_sw.drivers.driver import Driver
from ukf_sw.errors import UkfError
from ukf_sw.extras import MissingExtraError
from ukf_sw.folders import check_file, replacing
from ukf_sw.problems.catalogue import CATALOGUE
from ukf_sw.problems.judging import judge
from ukf_sw.problems.logs import LogFiles
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.running import Run, run

__all__ = ["compare", "main"]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m ukf_sw.board", description="Run a filter on any backend."
    )
    parser.add_argument(
        "--backend", default="golden",
        help="reference, golden, cosim, uio:NUMBER_NAME_OR_ADDRESS, pynq:ADDRESS[,INTERRUPT_PIN]",
    )  # fmt: skip
    parser.add_argument(
        "--problem", default="nanosat", metavar="NAME",
        help=f"{', '.join(CATALOGUE)}, or MODULE:ATTRIBUTE, as strut.model:problem",
    )  # fmt: skip
    parser.add_argument(
        "--data", action="append", metavar="FILE",
        help="log in the place of the problem's data, CSV; several as gps=gps.csv",
    )  # fmt: skip
    parser.add_argument(
        "--ignore", action="append", default=[], metavar="COLUMN", help="column of it to leave out"
    )
    parser.add_argument(
        "--start", type=float, metavar="SECONDS",
        help="time of it that the first estimate belongs to; what is before it is left out",
    )  # fmt: skip
    parser.add_argument("--pes", type=int, help="of a model, by default the problem's; a core "
                        "says its own")  # fmt: skip
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", type=Path, metavar="FILE", help="write the estimates, .npz")
    parser.add_argument("--compare", type=Path, metavar="FILE", help="estimates that must be equal")
    return parser


def compare(x: NDArray[np.float64], saved: dict[str, Any], about: dict[str, Any]) -> str | None:
    """Compare estimates bit for bit with saved ones; gives the first difference, or None.

    Parameters
    ----------
    x
        Estimates, shape (K, n).
    saved
        What another run saved: ``x`` and what it was about.
    about
        What this run was about. It must be the same, the number of PEs included, because that
        decides the order of sums.
    """
    for name, value in about.items():
        if saved[name] != value:
            return f"{name} is {value!r}, of the saved run {saved[name]!r}"
    other = saved["x"]
    if other.shape != x.shape:
        return f"{len(x)} steps, of the saved run {len(other)}"
    wrong = np.argwhere(other.view(np.uint64) != x.view(np.uint64))
    if wrong.size:
        k, i = (int(index) for index in wrong[0])
        return f"x[{i}] after step {k} is {x[k, i]!r}, of the saved run {other[k, i]!r}"
    return None


def _load(file: Path) -> dict[str, Any]:
    """Load what another run saved.

    Raises
    ------
    ValueError
        If the file is none of those.
    """
    wrong = f"--compare must be a file that --save wrote, not {str(file)!r}"
    try:
        with np.load(BytesIO(file.read_bytes()), allow_pickle=False) as contents:
            saved: dict[str, Any] = {name: contents[name] for name in contents}
        x = saved.pop("x")
        about = {name: saved[name].item() for name in ("problem", "seed", "pes")}
    except Exception as error:  # NumPy and zipfile raise all kinds of a file that is damaged
        raise ValueError(f"{wrong} ({type(error).__name__}: {error})") from error
    if x.dtype != np.float64 or x.ndim != 2:
        raise ValueError(f"{wrong} (x must be of float64 and 2 dimensions)")
    return {"x": x, **about}


def _print(found: Run, reference: Run, backend: object, seconds: float) -> None:
    each = seconds / found.steps * 1e6
    print(f"{found.problem.name}: {found.steps} steps, {each:.0f} us each with the models")
    if isinstance(backend, Driver):
        traffic = backend.traffic
        print(
            f"{backend.pes} PEs; {traffic.words} words of numbers and starts, and "
            f"{traffic.register_words} of the registers in all"
        )
        for step, cycles in backend.last_cycles.items():
            print(f"  {step}: {cycles} clocks of the core")
    judged = judge(found, reference)
    after = "" if judged.since is None else f" after {judged.since:g} s"
    for sensor in judged.sensors:
        print(
            f"  {sensor.name}: {sensor.updates} updates, mean NIS {sensor.nis:.4g} with "
            f"{sensor.rows:.4g} rows"
        )
    for error in judged.as_dict()["errors"]:
        print(
            f"  rms of {error['error']}{after}: {error['rms']:.6g} {error['unit']}, "
            f"float64 reference {error['float64_rms']:.6g}"
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments
        Command line; None is that of the process.

    Returns
    -------
    int
        Exit code: 0, 1 if the core, its device or the comparison failed, 2 for bad arguments or a
        backend that is not installed.
    """
    options = _parser().parse_args(arguments)
    try:
        # What can be wrong with files is found before a run that may take long.
        if options.save is not None:
            check_file("--save", options.save, (".npz",))
        saved = None if options.compare is None else _load(options.compare)
        logs = None
        if options.data is not None:
            logs = LogFiles.of(options.data, options.ignore, options.start)
        elif options.ignore or options.start is not None:
            raise ValueError("--ignore and --start must come with --data, of which they are")
        chosen = {} if options.pes is None else {"pes": options.pes}
        recipe = Recipe.of(options.problem, seed=options.seed, logs=logs, **chosen)
        problem = recipe.scenario(options.steps)
        backend = make_backend(options.backend, problem.params)
        if isinstance(backend, Driver):
            backend.count_cycles = True
        start = time.perf_counter()
        found = run(problem, backend)
        seconds = time.perf_counter() - start
    except (ValueError, OSError, MissingExtraError) as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    except UkfError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    _print(found, run(problem, "reference"), backend, seconds)
    pes = backend.pes if isinstance(backend, Driver) else 0
    about: dict[str, Any] = {"problem": options.problem, "seed": options.seed, "pes": pes}
    if options.save is not None:
        try:
            options.save.parent.mkdir(parents=True, exist_ok=True)
            with replacing(options.save) as part, part.open("wb") as stream:
                np.savez(stream, x=found.x, **about)
        except OSError as error:
            print(f"Error: --save {options.save}: {error.strerror}", file=sys.stderr)
            return 1
    if saved is not None:
        difference = compare(found.x, saved, about)
        if difference is not None:
            print(f"Not equal: {difference}", file=sys.stderr)
            return 1
        print(f"Equal to {options.compare}, bit for bit")
    return 0


if __name__ == "__main__":
    # An access that a core refuses ends the process: then at least say where.
    faulthandler.enable()
    sys.exit(main())
