"""FuseSoC with the project's core file, on a small core so that it takes seconds."""

import json
import runpy
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml

from ukf_sim.simulators import Simulator

ROOT = Path(__file__).parents[2]
SMALL = "{n: 2, m: 1, q: 1, r: 1, pes: 2}"

#: Runs Verilator once more where FuseSoC ran it.
RERUN = """
import subprocess, sys
from ukf_sim.simulators import tool_environment
with tool_environment():
    command = ["verilator", "-f", "ukf__ukf_core_0.1.0.vc"]
    sys.exit(subprocess.run(command, cwd=sys.argv[1]).returncode)
"""

pytestmark = pytest.mark.skipif(find_spec("fusesoc") is None, reason="FuseSoC is not installed")


@pytest.fixture(scope="module")
def fusesoc(tmp_path_factory):
    """Function that runs FuseSoC on a copy of the core file with other sizes."""
    folder = tmp_path_factory.mktemp("fusesoc")
    text = (ROOT / "ukf_core.core").read_text(encoding="utf-8")
    for old, new in (
        ("{config: nanosat, pes: 2}", SMALL),
        ("command: tools/", f"command: {ROOT}/tools/"),
    ):
        assert old in text
        text = text.replace(old, new)
    (folder / "ukf_core.core").write_text(text, encoding="utf-8")

    def fusesoc(target):
        command = [sys.executable, ROOT / "tools/fusesoc/run.py", "run", f"--target={target}"]
        return subprocess.run(
            [*command, "ukf::ukf_core"], cwd=folder, capture_output=True, text=True, check=False
        )

    fusesoc.folder = folder
    return fusesoc


def test_lint(fusesoc):
    result = fusesoc("lint")
    assert result.returncode == 0, result.stdout + result.stderr
    assert "Warning" not in result.stdout + result.stderr
    # What was linted is the core that was asked for.
    record = json.loads(next(fusesoc.folder.glob("**/ukf_core.json")).read_text())
    assert record["parameters"]["pes"] == 2
    assert record["parameters"]["n"] == 2
    # A net without a driver must not pass.
    (file,) = fusesoc.folder.glob("build/*/lint/ukf_core.v")
    file.write_text(file.read_text().replace("  assign ", "  // assign ", 1))
    command = [sys.executable, "-c", RERUN, str(file.parent)]
    broken = subprocess.run(command, capture_output=True, text=True, check=False)
    assert broken.returncode != 0
    assert "UNDRIVEN" in broken.stdout + broken.stderr


@pytest.mark.slow
def test_simulation_with_icarus(fusesoc):
    if not Simulator.ICARUS.available:
        pytest.skip("Icarus Verilog is not installed")
    result = fusesoc("sim-icarus")
    assert result.returncode == 0, result.stdout + result.stderr
    assert "PASS: " in result.stdout + result.stderr
    assert "FAIL" not in result.stdout + result.stderr


@pytest.mark.slow
def test_simulation_with_verilator(fusesoc):
    result = fusesoc("sim")
    assert result.returncode == 0, result.stdout + result.stderr
    assert "PASS: " in result.stdout + result.stderr


def test_generator_refuses_other_commands(tmp_path, monkeypatch):
    main = runpy.run_path(str(ROOT / "tools/fusesoc/generator.py"))["main"]

    monkeypatch.chdir(tmp_path)
    file = tmp_path / "call.yml"
    call = {"vlnv": "::x:0", "parameters": {"command": "run", "options": {}}}
    file.write_text(yaml.safe_dump(call))
    with pytest.raises(
        ValueError, match=r"^command must be one of generate, testbench, not 'run'$"
    ):
        main(file)
