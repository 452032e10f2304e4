"""Packaging: what is written, the scripts on the model of Vivado, and mistakes it must find."""

import json
import re
import shutil
import subprocess
from importlib.util import find_spec

import pytest
from typer.testing import CliRunner

from support.stub_engine import StubEngine
from ukf_hdl.generate import files_of, generate
from ukf_hdl.instance import Instance
from ukf_hdl.packaging.boards import BOARDS, find_board
from ukf_hdl.packaging.package import package
from ukf_sim.testbench import record, write
from ukf_sw.problems.recipe import Recipe
from ukf_sw.spec.float_format import BINARY64
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import UkfParams
from ukf_tools.cli import app
from ukf_tools.vivado.check import check_package
from ukf_tools.vivado.commands import COMMANDS, PROPERTIES, VERSIONS
from ukf_tools.vivado.ips import BOARD_PARTS, ScriptError
from ukf_tools.vivado.model import Vivado

TINY = UkfParams(n=2, m=1, q=1, r=1, pes=2)
SMALLEST = UkfParams(n=1, m=1)
LARGER = UkfParams(n=6, m=5, q=6, r=5, format=BINARY64)

needs_tcl = pytest.mark.skipif(
    find_spec("_tkinter") is None,
    reason="Python has no tkinter, whose Tcl interpreter runs the scripts",
)


def make(folder, params=TINY, board="pynq-z2", part=None, **instance):
    return package(
        params, None, find_board(board, part), folder, engine=StubEngine(params),
        instance=Instance(**instance),
    )  # fmt: skip


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    folder = tmp_path_factory.mktemp("package")
    make(folder)
    return folder


@pytest.fixture
def folder(original, tmp_path):
    """Copy of a package, to be broken."""
    shutil.copytree(original, tmp_path / "package")
    return tmp_path / "package"


def test_equal_inputs_give_equal_files(original, tmp_path):
    for file in make(tmp_path):
        assert file.read_bytes() == (original / file.relative_to(tmp_path)).read_bytes()


@needs_tcl
@pytest.mark.parametrize("board", BOARDS)
@pytest.mark.parametrize(
    "params",
    [
        pytest.param(TINY, id="tiny"),
        pytest.param(SMALLEST, id="smallest", marks=pytest.mark.slow),
        pytest.param(LARGER, id="double", marks=pytest.mark.slow),
    ],
)
def test_scripts_make_a_system(params, board, tmp_path):
    make(tmp_path, params, board)
    checked = check_package(tmp_path)
    record = json.loads((tmp_path / "rtl" / "ukf_core.json").read_text())
    assert checked.address == Instance().base_address
    assert checked.interrupt == Instance().interrupt
    assert checked.versions == VERSIONS
    assert checked.size == max(1 << record["address_width"], 4096)
    assert checked.size >= 1 << MemoryMap(params).address_width
    assert checked.clock_mhz == 100.0
    assert "ukf_core_0" in checked.cells
    assert checked.commands > 60


#: File, what to replace, with what, and what the check must say.
MISTAKES = {
    "pin": ("block_design.tcl", "$core/$core_clock", "$core/clk", "no pin clk"),
    "interface": ("block_design.tcl", "$core/$core_bus]", "$core/axi]", "no interface axi"),
    "command": ("block_design.tcl", "validate_bd_design", "check_bd_design", "invalid command"),
    "option": ("block_design.tcl", "-type ip", "-kind ip", "no option -kind"),
    "property": ("block_design.tcl", "PCW_IRQ_F2P_INTR", "PCW_IRQ_F2P", "no property CONFIG"),
    "ip version": ("block_design.tcl", "smartconnect:1.0", "smartconnect:9.0", "catalogue has no"),
    "cell": ("block_design.tcl", "get_bd_pins $reset/per", "get_bd_pins /r/per", "no cell '/r'"),
    "no interrupt": (
        "block_design.tcl", "connect_bd_net [get_bd_pins $core/$core_interrupt]", "list",
        "irq|IRQ_F2P is not connected",
    ),
    "interrupt off": (
        "block_design.tcl", "FABRIC_INTERRUPT 1", "FABRIC_INTERRUPT 0", "IRQ_F2P only with",
    ),
    "no clock": (
        "block_design.tcl", "    [get_bd_pins $bus/aclk] \\\n", "", "smartconnect_0/aclk is not",
    ),
    "no reset": (
        "block_design.tcl", " \\\n    [get_bd_pins $core/$core_reset]", "", "aresetn is not conn",
    ),
    "polarity": (
        "block_design.tcl", "$reset/peripheral_aresetn", "$reset/peripheral_reset", "polarity",
    ),
    "clock as reset": (
        "block_design.tcl", "$ps/FCLK_RESET0_N", "$reset/mb_reset", "must not have the polarity",
    ),
    "two masters": ("block_design.tcl", "$ps/M_AXI_GP0]", "$bus/M00_AXI]", "master|connected"),
    "not linked": (
        "block_design.tcl", "connect_bd_intf_net [get_bd_intf_pins $bus/M00_AXI]", "list",
        "s_axi|M00_AXI is not connected",
    ),
    "no preset": ("block_design.tcl", "apply_board_preset", "apply_preset", "rule does"),
    "preset forgotten": ("block_design.tcl", "[expr {$board_parts ne {}}]", "0", "a board has one"),
    "no address": ("block_design.tcl", "assign_bd_address", "list", "has no address"),
    "address outside": ("settings.tcl", "core_base 0x43c00000", "core_base 0x83c00000", "window"),
    "address odd": ("settings.tcl", "core_base 0x43c00000", "core_base 0x43c00800", "multiple"),
    "range": ("settings.tcl", "core_range 4096", "core_range 2048", "power of 2"),
    "part": ("settings.tcl", "part xc7z020clg400-1", "part xc7z099", "no part"),
    "board": ("settings.tcl", "tul.com.tw", "tul.com", "must be installed"),
    "board of another part": (
        "settings.tcl", "board_parts {tul.com.tw:pynq-z2", "board_parts {avnet.com:zedboard",
        "does not have the part",
    ),
    "module": ("settings.tcl", "core_name ukf_core", "core_name ukf", "no file"),
    "clock port": ("settings.tcl", "core_clock aclk", "core_clock clk", "must not be clk"),
    "interfaces": ("settings.tcl", "{s_axi aclk", "{m_axi aclk", "must have the interface m_axi"),
    "variable": ("settings.tcl", "set design_name", "set design", "can't read"),
    "file": ("package_ip.tcl", "${core_name}.v]", "${core_name}.sv]", "no file"),
    "no block": ("package_ip.tcl", "ipx::add_address_block $core_block $map", "", "one obj"),
    "no clock of bus": ("package_ip.tcl", "-clock $core_clock", "-clock $core_reset", "clock of"),
    "not saved": ("package_ip.tcl", "ipx::save_core $core\n", "", "catalogue has no"),
    "project left open": ("package_ip.tcl", "close_project\n", "", "still open"),
    "catalogue": ("build.tcl", "update_ip_catalog\n", "", "catalogue has no"),
    "repository": ("build.tcl", "[file join $root ip]]", "[file join $root]]", "ip_repo_paths"),
    "top": ("build.tcl", "${design_name}_wrapper [curr", "${design_name} [curr", "top must be"),
    "run": ("build.tcl", "launch_runs impl_1", "launch_runs impl_2", "no run impl_2"),
    "no bitstream": ("build.tcl", "-to_step write_bitstream ", "", "after it is made"),
    "hold": ("build.tcl", "hold min", "hold low", "no delays low"),
    "output": ("build.tcl", "$root ${design_name}.hwh", "$root x.hwh", "must end with bit"),
    "bitstream": ("build.tcl", "up 0x0 [file join $root ", "up 0x0 [file join $root x", "no bits"),
    "swapped bits": ("build.tcl", " -disablebitswap", "", "byte order of Linux"),
    "bytes": ("build.tcl", "-interface SMAPx32", "-interface SMAPx8", "byte order of Linux"),
    "memory": ("build.tcl", "-size 32", "-size 30", "power of 2"),
    "no bit.bin": ("build.tcl", "write_cfgmem", "list", "must end with bit"),
    "store": ("build.tcl", "set_param board.repoPaths", "list", "must be installed"),
    "parameter": ("build.tcl", "set_param board.repoPaths", "set_param board.paths", "no property"),
    "property of a run": ("build.tcl", "get_property PROGRESS", "get_property DONE", "no property"),
    "item": ("settings.tcl", "board_items *:pynq-z2", "board_items *:pynq", "store must have"),
    "not refreshed": ("install_board.tcl", "xhub::refresh_catalog", "list", "be refreshed"),
    "new command": ("build.tcl", "wait_on_run ", "wait_on_runs ", "Vivado 2020.2 has no wait_on_r"),
    "constraint": ("ukf_core_ooc.xdc", "get_ports aclk", "get_ports clk", "there is no clock clk"),
    "constraint of another port": ("ukf_core_ooc.xdc", "get_ports aclk", "get_ports irq", "no cl"),
    "verilog port": ("../rtl/ukf_core.v", "s_axi ARADDR", "s_axi ARADR", "ARADDR"),
    "verilog clock": ("../rtl/ukf_core.v", "ASSOCIATED_BUSIF s_axi", "ASSOCIATED s", "a clock"),
    "tcl": ("block_design.tcl", "validate_bd_design", "validate_bd_design {", "missing close"),
}  # fmt: skip


@needs_tcl
@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_found(name, folder):
    file, old, new, message = MISTAKES[name]
    path = folder / "vivado" / file
    text = path.read_text(encoding="utf-8")
    assert old in text, "the mistake must be one"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ScriptError, match=message):
        check_package(folder)


@needs_tcl
def test_the_versions_know_different_commands(folder):
    """wait_on_runs came after 2020.2; wait_on_run is in all versions."""
    script = folder / "vivado" / "build.tcl"
    script.write_text(script.read_text().replace("wait_on_run ", "wait_on_runs "))
    Vivado(folder, "2024.2").run(script)
    with pytest.raises(ScriptError, match=r"^build.tcl: Vivado 2020.2 has no wait_on_runs$"):
        Vivado(folder, "2020.2").run(script)


@needs_tcl
def test_the_tables_of_vivado_have_what_the_scripts_use_and_no_more(folder):
    """All of it is in the table of the documents; nothing has been kept that nobody uses."""
    model = Vivado(folder)
    used = set()
    scripts = "".join(file.read_text() for file in (folder / "vivado").glob("*.tcl"))
    for name, entry in COMMANDS.items():
        assert model.tcl.eval(f"info commands {name}"), f"the model must have {name}"
        if re.search(rf"(?<![\w:]){name}\b", scripts):
            used.add(name)
        for option in entry.valued | entry.flags:
            assert re.search(rf"{option}\b", scripts), f"{name} {option}"
    assert set(COMMANDS) - used == {"wait_on_runs"}
    for _, name in PROPERTIES:
        assert re.search(rf"\b{re.escape(name)}\b", scripts), name


@needs_tcl
def test_the_latest_files_of_a_board_are_taken(folder, monkeypatch):
    """By number, in which 1.10 comes after 1.9; whoever the vendor says he is."""
    for version in ("1.9", "1.10"):
        monkeypatch.setitem(BOARD_PARTS, f"tul.com.tw:pynq-z2:part0:{version}", "xc7z020clg400-1")
    model = Vivado(folder)
    model.run(folder / "vivado" / "build.tcl")
    assert model.board_part == "tul.com.tw:pynq-z2:part0:1.10"


@needs_tcl
@pytest.mark.parametrize("vendor", ["avnet-tria", "Avnet-tria", "avnet.com", None])
def test_the_vendor_of_a_board_may_have_another_name(vendor, tmp_path, monkeypatch):
    make(tmp_path, board="zedboard")
    for name in [name for name in BOARD_PARTS if "zedboard" in name]:
        monkeypatch.delitem(BOARD_PARTS, name)
    if vendor is None:
        with pytest.raises(ScriptError, match=r"must be installed: source install_board.tcl"):
            check_package(tmp_path)
        return
    monkeypatch.setitem(BOARD_PARTS, f"{vendor}:zedboard:part0:1.5", "xc7z020clg484-1")
    assert check_package(tmp_path).cells[0] == "processing_system7_0"


@needs_tcl
@pytest.mark.parametrize(("interrupt", "bit"), [(61, 0), (63, 2), (68, 7), (84, 8), (91, 15)])
def test_a_core_has_its_name_and_place(interrupt, bit, tmp_path):
    """All files say the same, and the model of Vivado finds the core there."""
    make(tmp_path, name="left", base_address=0x4001_0000, interrupt=interrupt, clock_mhz=62.5)
    checked = check_package(tmp_path)
    assert (checked.address, checked.interrupt) == (0x4001_0000, interrupt)
    assert checked.clock_mhz == 62.5
    assert "left_0" in checked.cells
    settings = (tmp_path / "vivado" / "settings.tcl").read_text()
    assert f"set core_interrupt_bit {bit}\n" in settings
    assert "set design_name left_system\n" in settings
    assert "create_clock -period 16.000" in (tmp_path / "vivado" / "left_ooc.xdc").read_text()
    header = (tmp_path / "rtl" / "c" / "left.h").read_text()
    assert f"#define LEFT_INTERRUPT {interrupt}u\n" in header
    assert "#define LEFT_BASE_ADDRESS 0x40010000u\n" in header
    assert "#define LEFT_CLOCK_HZ 62500000u\n" in header
    overlay = (tmp_path / "rtl" / "left.dtso").read_text()
    assert "left@40010000 {" in overlay
    assert f"interrupts = <0 {interrupt - 32} 4>;" in overlay
    assert "assigned-clock-rates = <62500000>;" in overlay
    assert not [path for path in tmp_path.rglob("*") if "ukf_core" in path.name]


@needs_tcl
def test_a_device_has_no_board(tmp_path):
    make(tmp_path, board=None, part="xc7z045ffg900-2")
    model = Vivado(tmp_path)
    model.run(tmp_path / "vivado" / "build.tcl")
    assert (model.part, model.board_part) == ("xc7z045ffg900-2", "")
    assert not check_package(tmp_path).cells[0].startswith("left")


PLACES = "base_address must be from 0x40000000 to 0x7fffffff, the window of M_AXI_GP0, not {}"
LINES = "interrupt must be from 61 to 68 or from 84 to 91, those of IRQ_F2P, not {}"


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ({"base_address": 0x3FFF_F000}, PLACES.format("0x3ffff000")),
        ({"base_address": 0x8000_0000}, PLACES.format("0x80000000")),
        ({"base_address": 0x43C0_0800}, "base_address must be a multiple of 0x1000,"),
        ({"interrupt": 60}, LINES.format(60)),
        ({"interrupt": 69}, LINES.format(69)),
        ({"interrupt": 92}, LINES.format(92)),
    ],
)
def test_what_a_zynq_has_not_is_refused(place, message, tmp_path):
    with pytest.raises(ValueError, match=f"^{message}"):
        make(tmp_path / "package", **place)
    assert not (tmp_path / "package").exists()


@pytest.mark.parametrize(
    ("board", "part", "message"),
    [
        (None, None, "--board must be given, one of zedboard, pynq-z2; or --part"),
        ("arty", None, "--board must be one of zedboard, pynq-z2, not 'arty'"),
        (None, "xc7a35ticsg324-1L", "--part must be a Zynq-7000, as xc7z020clg484-1, not 'xc7a35"),
        ("zedboard", "xc7z020clg400-1", "--part must be xc7z020clg484-1, which the zedboard has,"),
    ],
)
def test_boards_and_devices_that_there_are_not(board, part, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        find_board(board, part)


@needs_tcl
def test_forgotten_file_is_found(folder):
    (folder / "vivado" / "ukf_core_ooc.xdc").unlink()
    with pytest.raises(ScriptError, match="there is no file"):
        check_package(folder)


def test_device_tree_says_what_the_scripts_say(original, tmp_path):
    overlay = original / "rtl" / "ukf_core.dtso"
    text = overlay.read_text()
    settings = (original / "vivado" / "settings.tcl").read_text()
    base = int(re.search(r"core_base (\w+)", settings)[1], 16)
    size = int(re.search(r"core_range (\w+)", settings)[1])
    assert f"reg = <{base:#x} {size:#x}>;" in text
    assert f"ukf_core@{base:x}" in text
    if shutil.which("dtc") is None or shutil.which("fdtoverlay") is None:
        pytest.skip("the device tree compiler is not installed")
    stub = tmp_path / "base.dts"
    stub.write_text(
        "/dts-v1/;\n/ { #address-cells = <1>; #size-cells = <1>;\n"
        "intc: interrupt-controller@f8f01000 { reg = <0xf8f01000 0x1000>; interrupt-controller;\n"
        "#interrupt-cells = <3>; };\n"
        "clkc: clkc@f8000100 { reg = <0xf8000100 0x100>; #clock-cells = <1>; };\n"
        'amba: axi { compatible = "simple-bus"; #address-cells = <1>; #size-cells = <1>; ranges;'
        " };\n};\n"
    )
    for command in (
        ["dtc", "-@", "-q", "-I", "dts", "-O", "dtb", "-o", "base.dtb", "base.dts"],
        ["dtc", "-@", "-q", "-I", "dts", "-O", "dtb", "-o", "core.dtbo",
         str(overlay)],
        ["fdtoverlay", "-i", "base.dtb", "-o", "all.dtb", "core.dtbo"],
        ["dtc", "-q", "-I", "dtb", "-O", "dts", "-o", "all.dts", "all.dtb"],
    ):  # fmt: skip
        result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
    merged = (tmp_path / "all.dts").read_text()
    assert 'generic-uio";' in merged
    assert "interrupts = <0x00 0x1d 0x04>;" in merged


@needs_tcl
def test_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["--n", "2", "--m", "1", "--q", "1", "--r", "1", "--pes", "2"]
    runner = CliRunner()
    result = runner.invoke(app, ["package", *arguments, "--board", "zedboard", "--json"])
    assert result.exit_code == 0, result.output
    made = json.loads(result.stdout)
    assert made["checked"]["address"] == Instance().base_address
    assert (
        "set part xc7z020clg484-1" in (tmp_path / "build/package/vivado/settings.tcl").read_text()
    )
    # The same parameters give the same core.
    assert runner.invoke(app, ["generate", *arguments, "--output", "core"]).exit_code == 0
    for name in ("ukf_core.v", "ukf_core.json", "c/ukf_core.h", "c/ukf_driver.c"):
        own, other = tmp_path / "build/package/rtl" / name, tmp_path / "core" / name
        assert own.read_bytes() == other.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["package", "--board", "arty"], "--board must be one of zedboard, pynq-z2, not 'arty'"),
        (["package"], "--board must be given, one of zedboard, pynq-z2; or --part"),
        (["package", "--part", "xc7a35t"], "--part must be a Zynq-7000, as xc7z020clg484-1, not"),
        (
            ["package", "--board", "zedboard", "--name", "module"],
            "name must not be 'module', a key",
        ),
        (
            ["package", "--board", "zedboard", "--interrupt", "60"],
            "interrupt must be from 61 to 68",
        ),
        (
            ["package", "--board", "zedboard", "--base-address", "0x80000000"],
            "--base-address must be from 0x40000000 to 0x7fffffff, the window of M_AXI_GP0",
        ),
        (
            ["package", "--board", "zedboard", "--clock-mhz", "300"],
            "--clock-mhz must be between 1 and 250, not 300.0",
        ),
        (["testbench", "--name", "Left"], "name must be at most 25 lower-case letters"),
        (["package", "--board", "zedboard", "--output", "file"], "--output must be a folder, not"),
        (["testbench", "--output", "file"], "--output must be a folder, not the file 'file'"),
        (["generate", "--name", "uio"], "name must not be 'uio', which the C driver has"),
        (["generate", "--base-address", "here"], "--base-address must be a number, as 0x43c00000"),
        (
            ["generate", "--base-address", "0x43c00004"],
            "--base-address must be a multiple of 0x1000",
        ),
        (["generate", "--interrupt", "1020"], "interrupt must be between 32 and 1019, not 1020"),
        (["generate", "--clock-mhz", "0"], "--clock-mhz must be between 1 and 250, not 0.0"),
    ],
)
def test_commands_refuse(arguments, message, tmp_path, monkeypatch):
    """Before the slow part, and nothing has been written."""
    monkeypatch.chdir(tmp_path)
    files_of.cache_clear()
    monkeypatch.setattr("ukf_hdl.generate.verilog.convert", None)
    monkeypatch.setattr("ukf_sim.testbench.record", None)
    (tmp_path / "file").touch()
    result = CliRunner().invoke(app, [*arguments, "--n", "1", "--m", "1"], env={"COLUMNS": "500"})
    assert result.exit_code == 2
    assert message in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("command", ["generate", "package", "testbench"])
def test_a_folder_that_cannot_be_written_is_refused_first(command, tmp_path, monkeypatch):
    files_of.cache_clear()
    monkeypatch.setattr("ukf_hdl.generate.verilog.convert", None)
    monkeypatch.setattr("ukf_sim.testbench.record", None)
    (tmp_path / "file").touch()
    board = ["--board", "zedboard"] if command == "package" else []
    for folder in (tmp_path / "file" / "below", "/proc/none"):
        arguments = [command, *board, "--n", "1", "--m", "1", "--output", str(folder)]
        result = CliRunner().invoke(app, arguments, env={"COLUMNS": "500"})
        assert result.exit_code == 2
        assert result.stderr.splitlines()[-1].startswith("Error: --output must be a folder")


# The testbench in Verilog.


def test_testbench_has_the_whole_filter():
    accesses = record(Recipe(params=TINY), 3)
    kinds = [what for what, _, _ in accesses]
    # INIT, three iterations of three steps, COVARIANCE.
    assert kinds.count(3) == 1 + 3 * 3 + 1
    assert set(kinds) == {1, 2, 3}


@pytest.mark.parametrize("broken", [False, True], ids=["right", "wrong word"])
def test_testbench_runs_in_icarus(broken, tmp_path):
    if shutil.which("iverilog") is None:
        pytest.skip("Icarus Verilog is not installed")
    generate(TINY, None, tmp_path)
    _, vectors = write(Recipe(params=TINY), 1, tmp_path)
    lines = vectors.read_text().splitlines()
    last = max(k for k, line in enumerate(lines) if line.startswith("02"))
    if broken:  # one bit of the last word that is read
        lines[last] = lines[last][:-1] + f"{int(lines[last][-1], 16) ^ 1:x}"
        vectors.write_text("\n".join(lines) + "\n")
    for command in (
        ["iverilog", "-g2005", "-o", "tb.vvp", "ukf_core.v", "ukf_core_tb.v"],
        ["vvp", "-n", "tb.vvp"],
    ):
        result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    if broken:
        assert f"FAIL: access {last}," in result.stdout
        assert "FAIL: 1 errors" in result.stdout
    else:
        assert f"PASS: {len(lines)} accesses" in result.stdout
