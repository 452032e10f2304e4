"""The Verilog as others take it: linted as it is delivered, and two cores in one design."""

import re
import shutil
import subprocess

import pytest

from ukf_hdl.generate import generate
from ukf_hdl.instance import Instance
from ukf_sim.simulators import Simulator, tool_environment
from ukf_sw.spec.float_format import BINARY16, BINARY64, FloatFormat
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams

TINY = UkfParams(n=2, m=1, q=1, r=1, pes=2)
#: Sizes, formats, forms, kinds of noise and depths that change what the generator writes.
CORES = [
    pytest.param(TINY, Pipeline(), id="tiny", marks=pytest.mark.slow),
    pytest.param(
        UkfParams(n=1, m=1), Pipeline(multiply=1, add=1, reciprocal_sqrt=1), id="smallest",
        marks=pytest.mark.slow,
    ),
    pytest.param(
        UkfParams(
            n=3, m=2, q=3, r=2, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE,
            format=BINARY64, form=Form.COVARIANCE, W0=0.25, pes=3,
        ),
        Pipeline(multiply=5, add=6, reciprocal_sqrt=12),
        id="double",
        marks=pytest.mark.slow,
    ),
    pytest.param(
        UkfParams(n=2, m=3, pes=4, format=BINARY16), Pipeline(add=4), id="half",
        marks=pytest.mark.slow,
    ),
    pytest.param(
        UkfParams(n=2, m=2, q=1, pes=3, format=FloatFormat(exponent_bits=6, fraction_bits=17)),
        Pipeline(),
        id="float6.17",
    ),
    pytest.param(
        UkfParams(n=7, m=6, q=7, r=6, pes=22), Pipeline(), id="nanosat", marks=pytest.mark.slow
    ),
]  # fmt: skip

needs_verilator = pytest.mark.skipif(
    not Simulator.VERILATOR.available, reason="Verilator is not installed"
)


def lint(folder, *files):
    """Exit code and messages of Verilator's lint with all warnings."""
    with tool_environment():
        result = subprocess.run(
            ["verilator", "--lint-only", "-Wall", *files],
            cwd=folder, capture_output=True, text=True, check=False,
        )  # fmt: skip
    messages = (result.stdout + result.stderr).splitlines()
    return result.returncode, "\n".join(line for line in messages if line.startswith("%"))


@needs_verilator
@pytest.mark.parametrize(("params", "pipeline"), CORES)
def test_lint_is_silent_as_delivered(params, pipeline, tmp_path):
    generate(params, pipeline, tmp_path)
    assert lint(tmp_path, "ukf_core.vlt", "ukf_core.v") == (0, "")
    # By its whole name as well, and from elsewhere.
    assert lint("/", tmp_path / "ukf_core.vlt", tmp_path / "ukf_core.v") == (0, "")
    assert lint(tmp_path, "ukf_core.v")[0] != 0, "there is something to waive"


@pytest.fixture(scope="module")
def delivered(tmp_path_factory):
    folder = tmp_path_factory.mktemp("delivered")
    generate(TINY, None, folder)
    return folder


#: What to replace once, with what, and the rule that must find it.
FAULTS = {
    "net without driver": (r"\n  assign ", r"\n  // assign ", "UNDRIVEN"),
    "wide value in a narrow net": (
        r"assign s_axi__bresp = s_axi_bresp", r"assign s_axi__bresp = {1'h0, s_axi_bresp}",
        "WIDTHTRUNC",
    ),
    "narrow value in a wide net": (
        r"assign s_axi__bresp = s_axi_bresp", r"assign s_axi__bresp = irq", "WIDTHEXPAND",
    ),
    "pin left out": (r"\n    \.s_axi__awvalid\([^)]*\),", "", "PINMISSING"),
    "pin of another width": (
        r"\.s_axi__awprot\(s_axi_awprot\)", r".s_axi__awprot(s_axi_awvalid)", "WIDTHEXPAND",
    ),
    "default left out": (
        r"\nendmodule", r"\n  reg kept; always @* if (irq) kept = rst;\nendmodule", "LATCH",
    ),
}  # fmt: skip


@needs_verilator
@pytest.mark.parametrize("name", FAULTS)
def test_lint_still_finds_faults(name, delivered, tmp_path):
    """The waivers are for what the generator does, not for whatever may go wrong."""
    old, new, rule = FAULTS[name]
    text = (delivered / "ukf_core.v").read_text(encoding="utf-8")
    broken, count = re.subn(old, new, text, count=1)
    assert count == 1, "the fault must be one"
    (tmp_path / "ukf_core.v").write_text(broken, encoding="utf-8")
    shutil.copy(delivered / "ukf_core.vlt", tmp_path)
    code, messages = lint(tmp_path, "ukf_core.vlt", "ukf_core.v")
    assert code != 0
    assert re.search(rf"%(Warning|Error)-({rule}):", messages), messages


@needs_verilator
def test_waivers_are_for_their_file_only(delivered):
    """A file of the user's, whatever its name ends in, is linted in full."""
    try:
        (delivered / "my_ukf_core.v").write_text(
            "module my_ukf_core(input wire unused, output wire [1:0] y);\n"
            "  wire [3:0] sum = 4'd1 + 2'd1;\n  assign y = sum[1:0];\nendmodule\n"
        )
        _, messages = lint(delivered, "ukf_core.vlt", "my_ukf_core.v")
    finally:
        (delivered / "my_ukf_core.v").unlink()
    assert "UNUSEDSIGNAL" in messages
    assert "WIDTHEXPAND" in messages


PAIR = {"left": TINY, "right": UkfParams(n=1, m=1)}


@pytest.fixture(scope="module")
def two_cores(tmp_path_factory):
    """Folder with two cores, and a design that has both."""
    folder = tmp_path_factory.mktemp("pair")
    ports = ""
    for name, params in PAIR.items():
        generate(params, None, folder, instance=Instance(name=name))
        text = (folder / f"{name}.v").read_text(encoding="utf-8")
        inputs = re.findall(r"^  input (?:\[\d+:0\] )?(\w+);", text.split("endmodule")[0], re.M)
        values = {"aclk": "aclk", "aresetn": "aresetn"}
        ports += (
            f"  {name} {name}_0 (.irq(irq_{name})"
            + "".join(f",\n    .{port}({values.get(port, chr(39) + '0')})" for port in inputs)
            + ");\n"
        )
    (folder / "pair.sv").write_text(
        "module pair(input wire aclk, input wire aresetn, output wire irq_left,"
        f" output wire irq_right);\n{ports}endmodule\n"
    )
    return folder


def modules(text):
    return set(re.findall(r"^module (\S+)", text, re.M))


def test_cores_of_one_design_have_no_module_in_common(two_cores):
    names = {name: modules((two_cores / f"{name}.v").read_text()) for name in PAIR}
    assert names["left"] & names["right"] == set()
    for name, found in names.items():
        assert all(re.match(rf"\\?{name}\b", module) for module in found)
        assert len(found) > 20


def test_the_name_is_all_that_differs(tmp_path, delivered):
    generate(TINY, None, tmp_path, instance=Instance(name="left"))
    text = (tmp_path / "left.v").read_text(encoding="utf-8")
    same = re.sub(r"(?<=^module )left(?=\()|(?<=\\)left(?=\.)", "ukf_core", text, flags=re.M)
    assert same == (delivered / "ukf_core.v").read_text(encoding="utf-8")


@needs_verilator
def test_two_cores_in_one_design_are_linted(two_cores):
    files = ("left.vlt", "right.vlt", "left.v", "right.v", "pair.sv")
    code, messages = lint(two_cores, *files, "--top-module", "pair", "-Wno-PINMISSING",
                          "-Wno-PINCONNECTEMPTY")  # fmt: skip
    assert (code, messages) == (0, "")


@pytest.mark.skipif(not Simulator.ICARUS.available, reason="Icarus Verilog is not installed")
def test_two_cores_in_one_design_are_elaborated(two_cores):
    files = ("left.v", "right.v", "pair.sv")
    command = ["iverilog", "-g2012", "-o", "pair.vvp", "-s", "pair", *files]
    result = subprocess.run(command, cwd=two_cores, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "already declared" not in result.stderr
    # The same with one name collides.
    shutil.copy(two_cores / "left.v", two_cores / "again.v")
    command[-3] = "again.v"
    command.insert(-3, "left.v")
    result = subprocess.run(command, cwd=two_cores, capture_output=True, text=True, check=False)
    assert result.returncode != 0
