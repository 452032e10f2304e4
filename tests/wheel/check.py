"""Install the wheel in new environments and use it in empty folders, as others will.

``python tests/wheel/check.py`` builds the wheel and

- installs it with all extras: every kind of command runs, some of them also without a home and
  with an install that is read-only;
- installs it alone on Python 3.10 with a NumPy below 2, and with 1.21: the filter runs on an
  emulated core behind a UIO device, with the bits of the golden model, and with the older one the
  tests of the base pass.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
TESTS = ROOT / "tests"
#: What runs on the golden model here and on an emulated board there.
BOARD = ["--problem", "nanosat-additive", "--pes", "10", "--steps", "5"]
SMALL = ["--n", "1", "--m", "1"]
NANOSAT = ["--problem", "nanosat", "--pes", "2"]
BASE_TESTS = ["test_base.py", "test_boards.py"]
#: What makes root obey permissions; others do.
GUARD = (
    ["setpriv", "--bounding-set", "-dac_override,-dac_read_search,-fowner"]
    if os.getuid() == 0
    else []
)
#: NumPy of the base installs.
NUMPY = ["numpy<2", "numpy==1.21.*"]

#: Looks in the standard library for every name that a package imports of it.
NAMES = """
import ast, importlib, pathlib, sys

for package in sys.argv[1:]:
    for file in pathlib.Path(package).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_bytes())):
            if not isinstance(node, ast.ImportFrom) or node.level:
                continue
            if node.module.partition(".")[0] in sys.stdlib_module_names:
                module = importlib.import_module(node.module)
                for alias in node.names:
                    if not hasattr(module, alias.name):
                        sys.exit(f"{file}: {node.module} has no {alias.name} in this Python")
"""


class CheckError(Exception):
    """Something that should work does not."""


class Place:
    """An environment with the wheel, and the folder in which its commands run.

    Parameters
    ----------
    folder
        Folder for both.
    python
        Interpreter to make it with.
    requirements
        What pip installs.
    """

    def __init__(self, folder: Path, python: str, requirements: Sequence[str]) -> None:
        self.bin = folder / "environment" / "bin"
        self.work = folder / "empty"
        self.work.mkdir(parents=True)
        tell(f"Installing {', '.join(Path(each).name for each in requirements)} with {python}")
        subprocess.run([python, "-m", "venv", str(self.bin.parent)], check=True)
        pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        self.run("python", *pip, *requirements)

    def run(
        self, program: str, *arguments: str, code: int = 0, cwd: Path | None = None,
        guarded: bool = False, **environment: str | None,
    ) -> str:  # fmt: skip
        """Run a program of the environment, and give what it printed.

        Raises
        ------
        CheckError
            If it ends with another exit code.
        """
        path = f"{self.bin}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
        own = {"PATH": path, "PYTHONDONTWRITEBYTECODE": "1", "MAKEFLAGS": "", **environment}
        # Nothing of this repository may be found by chance.
        kept = {name: text for name, text in os.environ.items() if name != "PYTHONPATH"}
        everything = {name: text for name, text in {**kept, **own}.items() if text is not None}
        shown = " ".join([program, *arguments]).partition("\n")[0][:100]
        started = time.monotonic()
        done = subprocess.run(
            [*GUARD * guarded, str(self.bin / program), *arguments],
            cwd=cwd or self.work, env=everything,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
        )  # fmt: skip
        tell(f"  {time.monotonic() - started:5.1f} s  {shown}")
        if done.returncode != code:
            raise CheckError(f"{shown}: exit code {done.returncode}, not {code}\n{done.stdout}")
        return done.stdout


def tell(text: str) -> None:
    """Print a line at once, also into a pipe."""
    print(text, flush=True)


def expect(condition: bool, what: str) -> None:
    """Demand something.

    Raises
    ------
    CheckError
        If it is not so.
    """
    if not condition:
        raise CheckError(f"{what}: not so")


def find_python_310() -> str:
    """Find Python 3.10: on the path, or of pyenv.

    Raises
    ------
    CheckError
        If there is none.
    """
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found = [shutil.which("python3.10"), *map(str, versions.glob("3.10.*/bin/python3.10"))]
    for python in filter(None, found):
        # A shim of pyenv may stand for a version that is not chosen.
        if not subprocess.run([python, "-c", ""], capture_output=True, check=False).returncode:
            return python
    raise CheckError("Python 3.10 must be on the path or in pyenv, or given as --python310")


def check_everything(folder: Path, wheel: Path) -> Path:
    """Use all extras; gives estimates of the golden model."""
    place = Place(folder, sys.executable, [f"{wheel}[all]"])
    expect(place.run("ukf", "--version") == place.run("python", "-m", "ukf_tools", "--version"),
           "`python -m ukf_tools` is `ukf`")  # fmt: skip
    place.run("ukf", "latency", *NANOSAT)
    place.run("ukf", "generate", *SMALL, "--output", "core")
    expect((place.work / "core" / "ukf_core.v").is_file(), "generate writes Verilog")
    place.run("ukf", "run", *NANOSAT, "--steps", "50")
    text = place.run("ukf", "cosim", *SMALL, "--steps", "5")
    expect("Bit-exact" in text, "the simulated core equals the golden model")
    place.run("ukf", "package", *SMALL, "--board", "pynq-z2", *no_check_without_tcl())
    expect(any((place.work / "build" / "package").rglob("*.tcl")), "package writes scripts")
    place.run("ukf", "export", "--problem", "nanosat", "--steps", "5")
    place.run("ukf", "run", *NANOSAT, "--models", "core", "--steps", "50")
    place.run("ukf", "resources", *SMALL)
    place.run("ukf", "new", "strut", "--n", "1", "--m", "1")
    place.run("python", "-m", "pip", "install", "--quiet", "pytest")
    project = place.work / "strut"
    make = shutil.which("make")
    if make is None:
        raise CheckError("make must be installed")
    (place.bin / "make").symlink_to(make)
    place.run("make", "test", "PYTHON=python", cwd=project)
    text = place.run("make", "c-loop", "PYTHON=python", cwd=project)
    expect("Bit-exact" in text, "models of one's own in C equal those in Python")
    check_read_only(place, folder)
    estimates = folder / "golden.npz"
    place.run("python", "-m", "ukf_sw.board", *BOARD, "--save", str(estimates))
    return estimates


def no_check_without_tcl() -> list[str]:
    """Option for packages where Python comes without Tcl."""
    probe = [sys.executable, "-c", "import tkinter"]
    missing = subprocess.run(probe, capture_output=True, check=False).returncode
    return ["--no-check"] * bool(missing)


def check_read_only(place: Place, folder: Path) -> None:
    """Use the install where nothing can be written to it, and without a home."""
    own = folder / "own"
    own.mkdir()
    unset = {"HOME": "/proc/none", "XDG_CACHE_HOME": None, "NUMBA_CACHE_DIR": None}
    environment = place.bin.parent
    subprocess.run(["chmod", "-R", "a-w", str(environment)], check=True)
    try:
        touch = [*GUARD, "touch", str(place.bin / "x")]
        written = subprocess.run(touch, stderr=subprocess.DEVNULL, check=False).returncode == 0
        expect(not written, "the install is read-only")
        for arguments in (
            ["latency", *SMALL],
            ["run", *NANOSAT, "--steps", "5"],
            ["generate", *SMALL, "--output", "core"],
        ):
            place.run("ukf", *arguments, cwd=own, guarded=True, **unset)
    finally:
        subprocess.run(["chmod", "-R", "u+w", str(environment)], check=True)


def check_base(
    folder: Path, wheel: Path, python: str, numpy: str, estimates: Path, *, tested: bool
) -> None:
    """Use the base: the filter on an emulated register file, and the tests of the base or not."""
    place = Place(folder, python, [str(wheel), numpy])
    listed = place.run("python", "-m", "pip", "freeze", "--disable-pip-version-check").split("\n")
    names = {line.partition("=")[0].partition(" ")[0] for line in listed if line}
    expect(names == {"numpy", "ukf-core"}, f"only NumPy is installed with it, not {names}")
    text = place.run("python", "-m", "ukf_sw.board", code=2)
    expect("pip install 'ukf-core[golden]'" in text, "the golden model says what it needs")
    text = place.run("ukf", "latency", code=1)
    expect("pip install 'ukf-core[tools]'" in text, "the command says what it needs")
    text = place.run(
        "python", "-W", "error", "-m", "support.emulated_core", *BOARD,
        "--compare", str(estimates), PYTHONPATH=str(TESTS),
    )  # fmt: skip
    expect("bit for bit" in text, "the emulated core gives the bits of the golden model")
    packages = place.run("python", "-c", "import ukf_sw; print(*ukf_sw.__path__)").strip()
    expect(packages.startswith(str(folder)), "the package is that of the wheel")
    sources = [str(Path(packages).parent / name) for name in
               ("ukf_sw", "ukf_hdl", "ukf_sim", "ukf_tools")]  # fmt: skip
    place.run("python", "-c", NAMES, *sources)
    if not tested:
        return
    place.run("python", "-m", "pip", "install", "--quiet", "pytest")
    place.run(
        "python", "-W", "error", "-m", "pytest", "-q", "-c", os.devnull, f"--rootdir={TESTS}",
        "--import-mode=importlib", "-p", "no:cacheprovider",
        *(str(TESTS / "sw" / name) for name in BASE_TESTS), PYTHONPATH=str(TESTS),
    )  # fmt: skip


def main() -> int:
    """Run the checks; the exit code is 1 if one fails."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--python310", help="Python 3.10, for the base install")
    parser.add_argument("--only", choices=["all", "base"], help="one of the two parts")
    options = parser.parse_args()
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="ukf-wheel-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        try:
            python = options.python310 or find_python_310()
            subprocess.run(
                [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
                cwd=ROOT, check=True, stdout=subprocess.DEVNULL,
            )  # fmt: skip
            (wheel,) = folder.glob("*.whl")
            if options.only != "base":
                estimates = check_everything(folder / "all", wheel)
            else:
                estimates = folder / "golden.npz"
                subprocess.run(
                    [sys.executable, "-m", "ukf_sw.board", *BOARD, "--save", str(estimates)],
                    check=True,
                )
            for k, numpy in enumerate(NUMPY if options.only != "all" else []):
                oldest = numpy == NUMPY[-1]
                check_base(folder / f"base{k}", wheel, python, numpy, estimates, tested=oldest)
        except CheckError as error:
            tell(f"Failed: {error}")
            return 1
    tell(f"The wheel works: {(time.monotonic() - started) / 60.0:.1f} minutes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
