"""Commands whose extra is missing say so at once; and progress where there is no terminal."""

import io
import subprocess
import sys

import pytest
from rich.console import Console
from typer.main import get_command

from ukf_sw.extras import EXTRAS
from ukf_tools.cli import app, console

SMALL = ["--n", "1", "--m", "1"]
NANOSAT = ["--problem", "nanosat", "--pes", "2"]

#: Arguments of every command, and the extras that it then needs besides `tools`.
COMMANDS = {
    "apps all": (["--no-study"], ["golden"]),
    "apps list": ([], []),
    "apps run": (["pendulum"], ["golden"]),
    "apps run ": (["pendulum", "--backend", "cosim"], ["hdl", "sim", "golden"]),
    "apps run  ": (["pendulum", "--backend", "reference", "--steps", "9"], []),
    "apps swampsat": (["--duration", "60"], ["apps", "golden"]),
    "baseline": ([], []),
    "c-arm": (NANOSAT, ["hdl", "golden"]),
    "c-loop": (NANOSAT, ["hdl", "golden"]),
    "c-loop ": ([*NANOSAT, "--beside-cocotb", "1"], ["hdl", "sim", "golden"]),
    "cosim": (SMALL, ["hdl", "sim", "golden"]),
    "disassemble": (SMALL, []),
    "export": (["--problem", "nanosat", "--steps", "2"], []),
    "generate": (SMALL, ["hdl"]),
    "latency": (SMALL, []),
    "latency ": ([*SMALL, "--explain", "--plot", "update.svg"], []),
    "models show": (["--problem", "pendulum"], ["golden"]),
    "new": (["strut"], []),
    "package": ([*SMALL, "--board", "pynq-z2", "--no-check"], ["hdl"]),
    "report": (["--sweep", __file__], ["sweep"]),
    "resources": (SMALL, ["hdl", "synth"]),
    "run": ([*NANOSAT, "--steps", "2"], ["golden"]),
    "run ": ([*NANOSAT, "--steps", "2", "--backend", "reference"], []),
    "sweep": ([*SMALL, "--no-resources"], ["sweep", "hdl", "golden"]),
    "sweep ": (SMALL, ["sweep", "hdl", "golden", "synth"]),
    "sweep  ": (
        [*SMALL, "--no-resources", "--scheduler", "tcp://127.0.0.1:9"],
        ["sweep", "hdl", "golden", "cluster"],
    ),
    "testbench": ([*SMALL, "--steps", "1"], ["golden"]),
    "timing": (SMALL, ["hdl", "synth"]),
}
#: Those that take a second.
QUICK = (
    "apps list", "apps run  ", "disassemble", "export", "generate", "latency", "latency ",
    "models show", "new",
    "package", "run ", "testbench",
)  # fmt: skip

#: Runs the command line where the modules of its first argument cannot be imported.
BLOCKED = """
import sys

blocked = sys.argv.pop(1).split(",")

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if any(name == each or name.startswith(each + ".") for each in blocked):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Blocker())
from ukf_tools.__main__ import main

main()
"""


def run_without(modules, command, folder):
    return subprocess.run(
        [sys.executable, "-c", BLOCKED, ",".join(modules), *command],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip


def commands_of(group, name=""):
    for word, command in group.commands.items():
        full = f"{name} {word}".strip()
        yield from commands_of(command, full) if hasattr(command, "commands") else [full]


def test_every_command_is_here():
    assert set(commands_of(get_command(app))) == {name.strip() for name in COMMANDS}


@pytest.mark.parametrize(
    ("name", "extra"),
    [(name, extra) for name, (_, extras) in COMMANDS.items() for extra in extras],
)
def test_a_missing_extra_is_named_before_any_work(ukf, monkeypatch, tmp_path, name, extra):
    for module in EXTRAS[extra]:
        monkeypatch.setitem(sys.modules, module, None)
    result = ukf(*name.split(), *COMMANDS[name][0], code=1)
    assert f"pip install 'ukf-core[{extra}]'" in result.stderr
    assert "installed" in result.stderr
    assert result.stdout == ""
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", QUICK)
def test_a_command_needs_no_other_extra(tmp_path, name):
    """What it asks for is enough."""
    arguments, needed = COMMANDS[name]
    allowed = {module for extra in ("tools", *needed) for module in EXTRAS[extra]}
    others = {module for modules in EXTRAS.values() for module in modules} - allowed
    done = run_without(others, [*name.split(), *arguments], tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("module", EXTRAS["tools"])
def test_the_command_itself_says_what_it_needs(tmp_path, module):
    done = run_without([module], ["latency", *SMALL], tmp_path)
    assert done.returncode == 1
    assert done.stderr == f"Error: {module} is not installed: pip install 'ukf-core[tools]'\n"


# Progress.


@pytest.fixture
def log(monkeypatch):
    """What a command writes where there is no terminal, and a clock that the test turns."""
    log = io.StringIO()
    monkeypatch.setattr(console, "messages", Console(file=log, force_terminal=False))
    log.now = 0.0
    monkeypatch.setattr(console.time, "monotonic", lambda: log.now)
    return log


def test_progress_is_told_in_lines_where_there_is_no_terminal(log):
    with console.progress_bars() as bars:
        task = bars.add_task("Compiling", total=None)
        bars.update(task, description="Simulating [x]", completed=0, total=40)
        assert log.getvalue() == "Compiling\n"  # what is counted: once a second
        for done in range(1, 41):
            log.now += 0.5
            bars.update(task, completed=done)
    assert log.getvalue().splitlines() == [
        "Compiling", "Simulating [x], 2 of 40", "Simulating [x], 22 of 40",
    ]  # fmt: skip


def test_steps_of_progress_are_told_at_once(log):
    with console.progress_bars(counted=False) as bars:
        task = bars.add_task("Generating", total=None)
        bars.update(task, description="Compiling")
        bars.update(task, description="Compiling")
        other = bars.add_task("Routing", total=2)
        log.now += 10.0
        bars.advance(other)
    assert log.getvalue().splitlines() == [
        "Generating", "Compiling", "Routing, 0 of 2", "Routing, 1 of 2",
    ]  # fmt: skip


def test_a_terminal_shows_bars(monkeypatch):
    monkeypatch.setattr(console, "messages", Console(file=io.StringIO(), force_terminal=True))
    assert not isinstance(console.make_progress(), console.PlainProgress)
