import ast
import json
import os
import re
import threading
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import pytest

import ukf_hdl
from support.stub_engine import StubEngine
from ukf_hdl.core.control import Control
from ukf_hdl.core.soc import csr
from ukf_hdl.core.ukf_core import UkfCore
from ukf_hdl.generate import (
    NAME,
    description,
    files_of,
    generate,
    without_header,
    write_together,
)
from ukf_sw import __version__
from ukf_sw.spec.core import PARAMETERS, Core
from ukf_sw.spec.float_format import BINARY16, BINARY64
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.registers import REGISTERS

SMALLEST = UkfParams(n=1, m=1)
NANOSAT = UkfParams(n=7, m=6, q=7, r=6, pes=10)
CONFIGURATIONS = [
    pytest.param(SMALLEST, id="smallest"),
    pytest.param(NANOSAT, id="nanosat"),
    pytest.param(
        UkfParams(
            n=3, m=2, q=3, r=2, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE,
            format=BINARY64, form=Form.COVARIANCE, W0=0.25,
        ),
        id="double",
    ),
    pytest.param(UkfParams(n=2, m=3, format=BINARY16), id="half"),
]  # fmt: skip

#: Name, direction and width of every port; None where the parameters decide.
PORTS = {
    "aclk": ("input", 1), "aresetn": ("input", 1), "irq": ("output", 1),
    "s_axi_awaddr": ("input", None), "s_axi_awprot": ("input", 3),
    "s_axi_awvalid": ("input", 1), "s_axi_awready": ("output", 1),
    "s_axi_wdata": ("input", 32), "s_axi_wstrb": ("input", 4),
    "s_axi_wvalid": ("input", 1), "s_axi_wready": ("output", 1),
    "s_axi_bresp": ("output", 2), "s_axi_bvalid": ("output", 1), "s_axi_bready": ("input", 1),
    "s_axi_araddr": ("input", None), "s_axi_arprot": ("input", 3),
    "s_axi_arvalid": ("input", 1), "s_axi_arready": ("output", 1),
    "s_axi_rdata": ("output", 32), "s_axi_rresp": ("output", 2),
    "s_axi_rvalid": ("output", 1), "s_axi_rready": ("input", 1),
}  # fmt: skip


def stub_core(params, pipeline=None):
    return UkfCore(params, pipeline, engine=StubEngine(params))


def generate_stub(params, folder):
    return generate(params, Pipeline(), folder, engine=StubEngine(params))


def test_files_are_named_after_the_core(tmp_path):
    paths = generate_stub(SMALLEST, tmp_path / "new" / "folder")
    names = [path.relative_to(tmp_path / "new" / "folder").as_posix() for path in paths]
    assert names[:6] == [f"ukf_core.{kind}" for kind in ("v", "vlt", "json", "svd", "dtso", "md")]
    assert names[6:8] == ["c/ukf_core.h", "c/ukf_registers.h"]
    assert all(path.stat().st_size for path in paths)


@pytest.mark.parametrize("params", CONFIGURATIONS)
def test_ports_are_the_public_interface(params, tmp_path):
    """A change here breaks every user of the Verilog: it needs a new major version."""
    text = generate_stub(params, tmp_path)[0].read_text(encoding="utf-8")
    module = re.search(rf"^module {NAME}\((.*?)\);(.*?)^endmodule", text, re.DOTALL | re.MULTILINE)
    assert module is not None
    assert set(re.findall(r"\w+", module[1])) == set(PORTS)
    declared = {
        name: (direction, int(msb or 0) + 1)
        for direction, msb, name in re.findall(
            r"^  (input|output) (?:reg )?(?:\[(\d+):0\] )?(\w+);", module[2], re.MULTILINE
        )
    }
    width = MemoryMap(params).address_width
    assert declared == {
        name: (direction, width if bits is None else bits)
        for name, (direction, bits) in PORTS.items()
    }


@pytest.mark.parametrize("params", CONFIGURATIONS)
def test_verilog_says_which_core_it_is(params, tmp_path):
    pipeline = Pipeline(add=5)
    paths = generate(params, pipeline, tmp_path, engine=StubEngine(params))
    text = paths[0].read_text(encoding="utf-8")
    head, _, rest = text.partition("\n\n")
    assert all(line.startswith("//") for line in head.splitlines())
    assert f"ukf-core {__version__}," in head.splitlines()[0]
    said = dict(re.findall(r"^//   (\S+) +(\S+)", head, re.MULTILINE))
    core = Core(params=params, pipeline=pipeline)
    assert Core.from_values({name: PARAMETERS[name].read(said[name]) for name in said}) == core
    assert list(said) == list(PARAMETERS)
    assert without_header(text) == rest
    assert f"module {NAME}(" in rest


def test_vivado_can_infer_the_interfaces(tmp_path):
    text = generate_stub(SMALLEST, tmp_path)[0].read_text(encoding="utf-8")
    text = text[text.index(f"module {NAME}(") :].partition("endmodule")[0]
    ports = re.findall(r"((?:^  \(\*.*\*\)\n)*)^  (?:input|output) .*?(\w+);", text, re.MULTILINE)
    attributes = {name: text for text, name in ports}
    assert set(attributes) == set(PORTS)
    for name, value in attributes.items():
        if name.startswith("s_axi_"):
            role = name.removeprefix("s_axi_").upper()
            assert f'"xilinx.com:interface:aximm:1.0 s_axi {role}"' in value
    assert "PROTOCOL AXI4LITE" in attributes["s_axi_awaddr"]
    assert "ASSOCIATED_BUSIF s_axi, ASSOCIATED_RESET aresetn" in attributes["aclk"]
    assert "POLARITY ACTIVE_LOW" in attributes["aresetn"]
    assert "SENSITIVITY LEVEL_HIGH" in attributes["irq"]


def test_generation_is_reproducible(tmp_path, monkeypatch):
    first = generate(SMALLEST, Pipeline(), tmp_path / "a")
    monkeypatch.setenv("AMARANTH_USE_YOSYS", "system")
    files_of.cache_clear()
    second = generate(SMALLEST, Pipeline(), tmp_path / "b")
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
    assert os.environ["AMARANTH_USE_YOSYS"] == "system", "the caller's choice stays"
    for path in first:
        text = path.read_text(encoding="utf-8")
        assert str(tmp_path) not in text
        assert not re.search(r"\b20\d\d-\d\d|\\src\b|\.py\b", text)


def test_the_environment_is_left_as_it_was(tmp_path, monkeypatch):
    monkeypatch.delenv("AMARANTH_USE_YOSYS", raising=False)
    generate_stub(SMALLEST, tmp_path)
    assert "AMARANTH_USE_YOSYS" not in os.environ


@pytest.mark.parametrize("params", CONFIGURATIONS)
def test_description_is_that_of_the_hardware(params, tmp_path):
    record = json.loads(generate_stub(params, tmp_path)[2].read_text(encoding="utf-8"))
    assert record == description(stub_core(params))
    found = {
        register["name"]: (
            register["offset"],
            {
                field["name"]: (field["lsb"], field["width"], field["access"])
                for field in register["fields"]
            },
        )
        for register in record["registers"]
    }
    assert found == {
        register.name: (
            register.offset,
            {field.name: (field.lsb, field.width, field.access.value) for field in register},
        )
        for register in REGISTERS
    }
    memory_map = MemoryMap(params)
    for region in record["regions"]:
        assert region["base"] == memory_map.address(region["symbol"], 0, 0)
        last = (region["rows"] - 1, region["columns"] - 1)
        assert (
            region["base"] + last[0] * record["row_stride"] + last[1] * record["element_bytes"]
        ) == memory_map.address(region["symbol"], *last)
    assert record["parameters"]["n"] == params.n
    assert record["parameters"]["W0"] == params.W0
    assert record["parameters"]["format"]["name"] == params.format.name
    assert record["pipeline"] == asdict(Pipeline())


def test_a_register_map_that_resolves_otherwise_is_refused():
    class Moved(Control):
        def _build_map(self):
            builder = csr.Builder(addr_width=5, data_width=32)
            for register, built in self._registers.items():
                builder.add(register.name, built, offset=register.offset + 4)
            return builder.as_memory_map()

    with pytest.raises(RuntimeError, match=r"^Register map must resolve to .*, not .*$"):
        Moved(SMALLEST)


@pytest.mark.parametrize("variables", [{"HOME": "/proc/none"}, {"XDG_CACHE_HOME": "/proc/none"}])
def test_a_user_without_a_cache_gets_the_same_bytes(variables, tmp_path, monkeypatch):
    usual = generate(SMALLEST, Pipeline(), tmp_path / "usual", engine=StubEngine(SMALLEST))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    without = generate(SMALLEST, Pipeline(), tmp_path / "without", engine=StubEngine(SMALLEST))
    assert [file.read_bytes() for file in without] == [file.read_bytes() for file in usual]
    assert os.environ.get("XDG_CACHE_HOME") == variables.get("XDG_CACHE_HOME")


#: Kind of memory by depth: a look-up table holds 64 words, a block memory from 4096 bits on.
MEMORIES = [
    pytest.param(SMALLEST, {64: "distributed"}, id="64 words"),
    pytest.param(UkfParams(n=2, m=1, q=1, r=1, pes=2), {128: "block"}, id="128 words"),
    pytest.param(
        UkfParams(n=2, m=1, q=1, r=1, pes=2, format=BINARY16), {128: "distributed"}, id="narrow"
    ),
]


@pytest.mark.parametrize(("params", "lanes"), MEMORIES)
def test_the_verilog_says_what_memories_are(params, lanes, tmp_path):
    """Those of the lanes, programs and tables; the scalars' is small, and may be either."""
    text = generate(params, None, tmp_path)[0].read_text(encoding="utf-8")
    memories = re.findall(
        r"((?:^  \(\* .* \*\)\n)*)^  reg \[(\d+):0\] (\w+) \[(\d+):0\];", text, re.MULTILINE
    )
    found = {}
    for attributes, msb, name, last in memories:
        styles = re.findall(r'\(\* (ram|rom)_style = "(\w+)" \*\)', attributes)
        depth, width = int(last) + 1, int(msb) + 1
        if name == "scalar_file":
            assert styles == []
        elif name in ("packets", "logic_table", "block_table"):
            large = depth * width >= 9216 if name == "packets" else name == "block_table"
            assert styles == [("rom", "block")] * large, name
        else:
            ((kind, style),) = styles
            assert kind == "ram"
            found.setdefault(name, {})[depth] = style
    assert found.pop("memory_0") == found.pop("memory_1") == lanes
    assert {name: set(styles.values()) for name, styles in found.items()} == {
        "history": {"distributed"}
    }


def test_cores_that_are_written_to_a_folder_at_once_are_not_mixed(tmp_path):
    """Nor is a file seen half: at any time it is one or the other, at the end all are of one."""
    cores = [dict.fromkeys(("a", "c/b", "d"), f"{number}" * 10**6) for number in range(2)]
    threads = [threading.Thread(target=write_together, args=(core, tmp_path)) for core in cores * 4]
    seen = set()
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        with suppress(FileNotFoundError):
            seen.add((tmp_path / "d").read_text())
    assert seen <= {core["d"] for core in cores}
    assert {name: (tmp_path / name).read_text() for name in cores[0]} in cores
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "b", "c", "d"]


def test_generate_writes_together(tmp_path, monkeypatch):
    written = []
    monkeypatch.setattr(
        "ukf_hdl.generate.write_together",
        lambda files, output, *, gone: written.append((files, output, set(gone))),
    )
    generate_stub(SMALLEST, tmp_path)
    ((files, output, gone),) = written
    assert output == tmp_path
    assert "c/ukf_core.h" in files
    assert gone == {f"c/ukf_{stem}.{kind}" for stem in ("model", "problem") for kind in "hc"}
    assert not list(tmp_path.iterdir())


def test_models_in_c_are_written_as_well_and_others_go(tmp_path):
    for name in ("ukf_model.c", "ukf_problem.h", "left_model.c"):
        (tmp_path / "c").mkdir(exist_ok=True)
        (tmp_path / "c" / name).write_text("another")
    paths = generate(
        SMALLEST, Pipeline(), tmp_path, engine=StubEngine(SMALLEST), models={"ukf_model.c": "new"}
    )
    assert tmp_path / "c" / "ukf_model.c" in paths
    assert (tmp_path / "c" / "ukf_model.c").read_text() == "new"
    assert not (tmp_path / "c" / "ukf_problem.h").exists()
    assert (tmp_path / "c" / "left_model.c").read_text() == "another", "of a core of another name"


def test_place_is_judged_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr("ukf_hdl.generate.UkfCore", None)
    with pytest.raises(ValueError, match=r"^output must be a folder, not the file "):
        generate(SMALLEST, Pipeline(), tmp_path / "file")


def test_names_of_signals_do_not_depend_on_the_version_of_python():
    """Amaranth takes them from the bytecode, which is the same only if a statement makes one."""
    for file in Path(ukf_hdl.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
                for call in (value for value in node.value.elts if isinstance(value, ast.Call)):
                    names = {keyword.arg for keyword in call.keywords}
                    assert "name" in names, (file.name, call.lineno)
