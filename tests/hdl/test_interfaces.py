"""What software gets about a core: compiled, validated, read back, compared with the maps."""

import json
import re
import shlex
import shutil
import subprocess
from functools import cache
from importlib.resources import files
from pathlib import Path

import pytest
from cmsis_svd.parser import SVDParser
from lxml import etree

from support.stub_engine import StubEngine
from ukf_hdl.core.ukf_core import UkfCore
from ukf_hdl.generate import generate, interface_files
from ukf_hdl.instance import Instance
from ukf_sw.c_sources import C_SOURCES, DRIVER_SOURCES
from ukf_sw.lowering.c_problem import c_problem_files
from ukf_sw.lowering.software import software_models
from ukf_sw.problems.scenario_files import export_scenario
from ukf_sw.problems.systems.nanosat import nanosat
from ukf_sw.spec.float_format import BINARY16, BINARY64
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.registers import ID, REGISTERS, Access, ErrorCode
from ukf_sw.spec.sequence import Step

SMALLEST = UkfParams(n=1, m=1)
NANOSAT = UkfParams(n=7, m=6, q=7, r=6, pes=10)
ADDITIVE = UkfParams(
    n=3, m=2, q=3, r=2, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE,
    format=BINARY64, form=Form.COVARIANCE, W0=0.25,
)  # fmt: skip
CONFIGURATIONS = [
    pytest.param(SMALLEST, id="smallest"),
    pytest.param(NANOSAT, id="nanosat"),
    pytest.param(ADDITIVE, id="double"),
    pytest.param(UkfParams(n=2, m=3, format=BINARY16), id="half"),
]

needs_cc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")
needs_cxx = pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Werror")


USUAL = Instance()


@cache
def texts(params, **place):
    return interface_files(UkfCore(params, engine=StubEngine(params)), Instance(**place))


def write(params, folder, **place):
    """Write the files of a core; gives the folder of the C driver."""
    for name, text in texts(params, **place).items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    return folder / "c"


# C headers.


def macros(*headers):
    return {
        name: int(value.removesuffix("u"), 0)
        for header in headers
        for name, value in re.findall(r"^#define (UKF_\w+) (\w+)$", header, re.MULTILINE)
    }


@pytest.mark.parametrize("params", CONFIGURATIONS)
def test_headers_say_what_the_maps_say(params):
    headers = [texts(params)[f"c/{name}"] for name in ("ukf_core.h", "ukf_registers.h")]
    found = macros(*headers)
    # Two guards have no value, and the initialiser and the list of fields have more than one.
    assert len(found) == sum(header.count("#define UKF_") for header in headers) - 4, "twice"
    for register in REGISTERS:
        assert found[f"UKF_{register.name}_OFFSET"] == register.offset
        for field in register:
            assert found[f"UKF_{register.name}_{field.name}_SHIFT"] == field.lsb
            assert found[f"UKF_{register.name}_{field.name}_MASK"] == field.mask
    for field in ID:
        assert found[f"UKF_ID_{field.name}_VALUE"] == field.reset
    memory_map = MemoryMap(params)
    for region in memory_map:
        stem = f"UKF_{region.name.upper()}"
        assert found[f"{stem}_BASE"] == memory_map.address(region.symbol, 0, 0)
        assert (found[f"{stem}_ROWS"], found[f"{stem}_COLUMNS"]) == (region.rows, region.columns)
    for step in Step:
        assert found[f"UKF_STEP_{step.name}"] == step
    for code in ErrorCode:
        assert found[f"UKF_ERROR_CODE_{code.name}"] == code
    assert found["UKF_ROW_STRIDE"] == memory_map.row_stride
    assert found["UKF_ELEMENT_BYTES"] == memory_map.element_bytes


def test_registers_are_those_of_all_cores():
    assert texts(SMALLEST)["c/ukf_registers.h"] == texts(NANOSAT)["c/ukf_registers.h"]
    assert texts(SMALLEST)["c/ukf_core.h"] != texts(NANOSAT)["c/ukf_core.h"]


def compile_c(folder, source, standard):
    (folder / "main.c").write_text(source, encoding="utf-8")
    return subprocess.run(
        ["gcc", f"-std={standard}", *STRICT, "main.c"],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip


@needs_cc
@pytest.mark.parametrize("standard", ["c99", "c11", "c17"])
def test_headers_compile(standard, tmp_path):
    folder = write(NANOSAT, tmp_path)
    names = macros(*((folder / name).read_text() for name in ("ukf_core.h", "ukf_registers.h")))
    uses = "\n".join(f"    sum += {name};" for name in names)
    result = compile_c(
        folder,
        '#include "ukf_core.h"\n#include "ukf_core.h"\n#include "ukf_registers.h"\n'
        "int main(void)\n{\n    unsigned long sum = sizeof(struct ukf_registers);\n"
        f"{uses}\n    return sum == 0;\n}}\n",
        standard,
    )
    assert result.returncode == 0, result.stderr


@needs_cc
def test_a_register_at_another_offset_does_not_compile(tmp_path):
    folder = write(SMALLEST, tmp_path)
    header = folder / "ukf_registers.h"
    text = header.read_text()
    assert text.count("#define UKF_MASK_OFFSET 0x24u") == 1
    header.write_text(text.replace("#define UKF_MASK_OFFSET 0x24u", "#define UKF_MASK_OFFSET 0x2u"))
    result = compile_c(folder, '#include "ukf_registers.h"\nint main(void) { return 0; }\n', "c11")
    assert "offset of MASK" in result.stderr


# The C driver.

HEADERS = sorted(path.relative_to(C_SOURCES).as_posix() for path in C_SOURCES.rglob("*.h"))
GENERATED = ["ukf_core.h", "ukf_registers.h", "scenario_data.h"]


@pytest.fixture(scope="module")
def c_folder(tmp_path_factory):
    """Folder of the C driver of a nanosatellite's core, with a scenario for C."""
    folder = write(NANOSAT, tmp_path_factory.mktemp("core"))
    export_scenario(nanosat(steps=2), 2, folder)
    return folder


@needs_cc
@needs_cxx
@pytest.mark.parametrize("header", [*HEADERS, *GENERATED])
def test_every_header_stands_alone_in_c_and_in_cxx(header, c_folder, tmp_path):
    """And its declarations are those of C in both."""
    includes = [f"-I{path}" for path in (c_folder, C_SOURCES, *sorted(C_SOURCES.glob("**/*/")))]
    (tmp_path / "alone.c").write_text(
        f'#include "{header}"\n#include "{header}"\nint main(void);\n'
    )
    for language, standard in (("c", "c11"), ("c++", "c++17"), ("c++", "c++20")):
        result = subprocess.run(
            ["gcc", "-x", language, f"-std={standard}", *STRICT, "-Wno-unused-variable",
             "-fsyntax-only", *includes, "alone.c"],
            cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert result.returncode == 0, f"{standard}: {result.stderr}"
    folder = c_folder if header in GENERATED else C_SOURCES
    text = (folder / header).read_text(encoding="utf-8")
    assert '\n#ifdef __cplusplus\nextern "C" {\n#endif\n' in text
    assert text.endswith("\n#ifdef __cplusplus\n}\n#endif\n\n#endif\n")


def written_command(folder):
    """The one command of the README."""
    text = (folder / "README.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"^```sh\n(.*)\n```$", text, re.MULTILINE)
    return shlex.split(command)


@pytest.mark.parametrize("compiler", ["cc", "arm-linux-gnueabihf-gcc"])
@pytest.mark.parametrize("port", ["uio", "bare_metal", "remote"])
@pytest.mark.parametrize("params", [SMALLEST, ADDITIVE], ids=["smallest", "double"])
def test_the_driver_compiles_as_its_readme_says(params, port, compiler, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    folder = write(params, tmp_path)
    first, *words = written_command(folder)
    assert first == "cc"
    assert words.count("ports/uio.c") == 1
    words = [word.replace("uio", port) for word in words]
    result = subprocess.run(
        [compiler, *STRICT, *words], cwd=folder, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    objects = {path.name for path in folder.glob("*.o")}
    assert objects == {f"{Path(name).stem}.o" for name in (*DRIVER_SOURCES, f"{port}.c")}


#: Prints what struct ukf_core holds, and what a driver says on a bus where all words are 0.
PROGRAM = """\
#include <stdio.h>
#include <ukf_core.h>
#include <ukf_filter.h>
#include <uio.h>

static bool get(void *context, uint32_t address, uint32_t *word)
{
    *word = 0u;
    return context == NULL && address < (1u << UKF_ADDRESS_BITS);
}

static bool put(void *context, uint32_t address, uint32_t word)
{
    return context == NULL && address != word;
}

static uint64_t now(void *context)
{
    return context == NULL ? 0u : 1u;
}

static bool process(void *context, const ukf_real *x, const ukf_real *w, const void *u,
                    ukf_real *next)
{
    next[0] = x[0];
    return context == NULL && w != NULL && u == NULL;
}

static bool observe(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z)
{
    z[0] = x[0];
    return context == NULL && v != NULL;
}

int main(void)
{
    static const struct ukf_core core = UKF_CORE_INITIALISER;
    static ukf_real work[UKF_WORK_LENGTH(UKF_N, UKF_M, UKF_Q, UKF_R, UKF_POINTS,
                                         UKF_INPUT_COUNT)];
    const struct ukf_port port = {NULL, get, put, NULL, now};
    static const struct ukf_sensor sensor = {observe, UKF_R, 0u, 0u};
    const struct ukf_models models = {NULL, process, &sensor, 0u, NULL};
    const struct ukf_options options = {1000u, false};
    struct ukf ukf;
    enum ukf_result result = ukf_open(&ukf, &core, &port, &models, &options, work,
                                      (uint32_t)(sizeof work / sizeof work[0]));

MEMBERS
    printf("%d %s\\n", (int)result, ukf_result_name(result));
    return 0;
}
"""


@needs_cc
@needs_cxx
@pytest.mark.parametrize(
    ("language", "standard"), [("c", "c11"), ("c++", "c++11"), ("c++", "c++17"), ("c++", "c++20")]
)
def test_a_program_links_with_the_driver(language, standard, c_folder, tmp_path):
    """In C++ as in C; every member of the core's description is what its name says."""
    folder = tmp_path / "c"
    shutil.copytree(c_folder, folder)
    subprocess.run(written_command(folder), cwd=folder, check=True)
    text = (C_SOURCES / "ukf_driver.h").read_text(encoding="utf-8")
    text = text.split("struct ukf_core {")[1].split("};")[0]
    names = re.findall(r"uint32_t (\w+);", text)
    lines = [f'    printf("{name} %u\\n", (unsigned)core.{name});' for name in names]
    (folder / "main.c").write_text(PROGRAM.replace("MEMBERS", "\n".join(lines)))
    compiler = "gcc" if language == "c" else "g++"
    for command in (
        [compiler, "-x", language, f"-std={standard}", *STRICT, "-I.", "-Iports", "-c", "main.c"],
        [compiler, *sorted(path.name for path in folder.glob("*.o")), "main.o", "-lm"],
    ):
        result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
    done = subprocess.run([str(folder / "a.out")], capture_output=True, text=True, check=True)
    *members, verdict = done.stdout.splitlines()
    assert verdict == "68 wrong ID"
    found = {name: int(value) for name, value in map(str.split, members)}
    memory_map = MemoryMap(NANOSAT)
    bases = {region.name: memory_map.address(region.symbol, 0, 0) for region in memory_map}
    assert found == bases | {
        "n": 7, "m": 6, "q": 7, "r": 6, "points": 22, "exponent_bits": 8, "fraction_bits": 23,
        "covariance_form": 0, "additive_q": 0, "additive_r": 0, "w0_low": 0, "w0_high": 0,
        "sensors": 1, "has_f": 0, "has_h": 0, "models": 0, "inputs": 0,
        "input_count": 0, "inputs_of_f": 0, "inputs_of_h": 0,
        "element_bytes": memory_map.element_bytes, "row_stride": memory_map.row_stride,
    }  # fmt: skip


#: What the reader of the page has to bring.
MY_DATA = """\
#include <stdbool.h>
#include "ukf_core.h"
#include "ukf_problem.h"

static const ukf_real x0[UKF_N], P0[UKF_N * UKF_N], Q[UKF_Q * UKF_Q], R[UKF_R * UKF_R];

static bool my_data(ukf_real *u, ukf_real *z)
{
    u[UKF_PROBLEM_INPUTS - 1u] = 0;
    z[0] = 0;
    return false;
}

static void my_use(const ukf_real *x)
{
    (void)x;
}
"""


def programs_of_the_page(name="zynq.md"):
    page = (Path(__file__).parents[2] / "docs" / name).read_text(encoding="utf-8")
    return re.findall(r"^```c\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)


@needs_cc
def test_the_sensors_of_the_page_compile(c_folder, tmp_path):
    folder = tmp_path / "c"
    shutil.copytree(c_folder, folder)
    sensors, call = programs_of_the_page()[1].split("\n\n")
    (folder / "main.c").write_text(
        '#include "ukf_filter.h"\n'
        "bool gps_h(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z);\n"
        "bool compass_h(void *context, const ukf_real *x, const ukf_real *v, ukf_real *z);\n"
        f"{sensors}\n"
        "enum ukf_result correct(struct ukf *ukf_pointer, ukf_real heading);\n"
        "enum ukf_result correct(struct ukf *ukf_pointer, ukf_real heading)\n{\n"
        "    const struct ukf_models models = {.sensors = sensors};\n"
        "    struct ukf ukf = *ukf_pointer;\n    enum ukf_result result;\n"
        f"    ukf.models = &models;\n    {call}    return result;\n}}\n"
    )
    result = subprocess.run(
        ["gcc", "-std=c11", *STRICT, "-I.", "-fsyntax-only", "main.c"],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr


@needs_cc
def test_the_programs_of_models_on_the_core_compile(c_folder, tmp_path):
    """That of the page about them, and the part of the page about C."""
    folder = tmp_path / "c"
    shutil.copytree(c_folder, folder)
    (whole,) = programs_of_the_page("models-on-core.md")
    told, calls = programs_of_the_page()[2].split("\n\n")
    (folder / "main.c").write_text(
        f"{whole}\n{told}\n"
        "enum ukf_result correct(struct ukf *pointer, ukf_real gain, ukf_real range);\n"
        "enum ukf_result correct(struct ukf *pointer, ukf_real gain, ukf_real range)\n{\n"
        "    struct ukf ukf = *pointer;\n    enum ukf_result result;\n"
        "    ukf.models = pointer->redraw ? &models : &on_core;\n"
        f"    {calls}    return result;\n}}\n"
    )
    result = subprocess.run(
        ["gcc", "-std=c11", *STRICT, "-I.", "-fsyntax-only", "main.c"],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr


@needs_cc
@pytest.mark.parametrize(
    ("device", "message"),
    [("none", "none: No such file or directory"), ("zeros", "the filter stopped: wrong ID")],
)
def test_the_program_of_the_page_stops_if_something_is_wrong(device, message, c_folder, tmp_path):
    """Without a device, and with one that is no core."""
    folder = tmp_path / "c"
    shutil.copytree(c_folder, folder)
    program = programs_of_the_page()[0]
    assert program.count('"/dev/uio0') == 2
    (folder / "my_data.h").write_text(MY_DATA)
    models = c_problem_files(software_models(nanosat(steps=1)))
    for name, text in models.items():
        (folder / name).write_text(text)
    (folder / "main.c").write_text(program.replace("/dev/uio0", device))
    (folder / "zeros").write_bytes(bytes(1 << MemoryMap(NANOSAT).address_width))
    command = written_command(folder)
    subprocess.run([*command, "ukf_model.c", "ukf_problem.c"], cwd=folder, check=True)
    objects = sorted(path.name for path in folder.glob("*.o"))
    command = ["gcc", "-std=c11", *STRICT, "-I.", "-Iports", "main.c", *objects, "-lm"]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    done = subprocess.run(["./a.out"], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, f"{message}\n")


@needs_cc
def test_the_initialiser_of_a_core_without_a_region_has_a_zero(tmp_path):
    """Additive noise has no sigma points."""
    folder = write(ADDITIVE, tmp_path)
    result = compile_c(
        folder,
        '#include "ukf_core.h"\n#include "ukf_driver.h"\n'
        "static const struct ukf_core core = UKF_CORE_INITIALISER;\n"
        "int main(void)\n{\n"
        "    return !(core.process_noise_points == 0u && core.covariance_form == 1u &&\n"
        "    core.observation_points == UKF_OBSERVATION_POINTS_BASE &&\n"
        "    core.observation_noise_factor == UKF_OBSERVATION_NOISE_FACTOR_BASE);\n}\n",
        "c11",
    )
    assert result.returncode == 0, result.stderr
    subprocess.run([str(folder / "a.out")], check=True)


def test_a_format_that_c_has_not_has_no_driver_in_c():
    half = texts(UkfParams(n=2, m=3, format=BINARY16))
    assert [name for name in half if name.startswith("c/")] == ["c/ukf_core.h", "c/ukf_registers.h"]
    assert {f"c/{path.name}" for path in C_SOURCES.iterdir() if path.is_file()} <= set(
        texts(ADDITIVE)
    )


# CMSIS-SVD.


@pytest.fixture(scope="module")
def schema():
    """Schema of CMSIS-SVD 1.3, of the package cmsis-svd."""
    folder = files("cmsis_svd") / "schemas"
    return etree.XMLSchema(etree.fromstring((folder / "CMSIS-SVD_1_3_9.xsd").read_bytes()))


@pytest.mark.parametrize("params", CONFIGURATIONS)
def test_svd_is_valid_and_says_what_the_map_says(params, schema, tmp_path):
    text = texts(params)["ukf_core.svd"].encode()
    schema.assertValid(etree.fromstring(text))
    (tmp_path / "core.svd").write_bytes(text)
    device = SVDParser.for_xml_file(str(tmp_path / "core.svd")).get_device()
    (peripheral,) = device.peripherals
    assert peripheral.base_address == USUAL.base_address
    assert [interrupt.value for interrupt in peripheral.interrupts] == [USUAL.interrupt]
    blocks = [(block.offset, block.offset + block.size) for block in peripheral.address_blocks]
    memory_map = MemoryMap(params)
    assert blocks == [
        (0, memory_map.region_stride),
        (memory_map.region_stride, 1 << memory_map.address_width),
    ]
    access = {
        Access.RO: ("read-only", None),
        Access.RW: ("read-write", "modify"),
        Access.WO: ("write-only", None),
        Access.W1S: ("write-only", "oneToSet"),
        Access.RW1C: ("read-write", "oneToClear"),
    }
    found = {register.name: register for register in peripheral.registers}
    assert set(found) == {register.name for register in REGISTERS}
    for register in REGISTERS:
        assert found[register.name].address_offset == register.offset
        assert found[register.name].size == 32
        fields = {field.name: field for field in found[register.name].fields}
        assert set(fields) == {field.name for field in register}
        for field in register:
            other = fields[field.name]
            assert (other.bit_offset, other.bit_width) == (field.lsb, field.width)
            assert other.description == field.doc
            assert (other.access.value, getattr(other.modified_write_values, "value", None)) == (
                access[field.access]
            )
    sizes = found["SIZES"].reset_value
    assert sizes == params.n | params.q << 8 | params.r << 16 | params.m << 24
    states = next(field for field in found["STATUS"].fields if field.name == "STATE")
    (values,) = states.enumerated_values
    assert {value.name: value.value for value in values.enumerated_values} == {
        step.name: int(step) for step in Step
    }


def test_the_schema_refuses_what_is_wrong(schema):
    text = texts(SMALLEST)["ukf_core.svd"]
    assert "read-only" in text
    broken = etree.fromstring(text.replace("read-only", "read-sometimes").encode())
    assert not schema.validate(broken)


# Device tree.

BASE = """\
/dts-v1/;
/ {
	#address-cells = <1>;
	#size-cells = <1>;
	amba: axi {
		compatible = "simple-bus";
		#address-cells = <1>;
		#size-cells = <1>;
		ranges;
		intc: interrupt-controller@f8f01000 {
			compatible = "arm,cortex-a9-gic";
			reg = <0xf8f01000 0x1000>;
			interrupt-controller;
			#interrupt-cells = <3>;
		};
		clkc: clkc@f8000100 {
			compatible = "xlnx,ps7-clkc";
			reg = <0xf8000100 0x100>;
			#clock-cells = <1>;
		};
	};
};
"""


def run(*command):
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


@pytest.mark.skipif(
    shutil.which("dtc") is None or shutil.which("fdtoverlay") is None,
    reason="device-tree-compiler is not installed",
)
@pytest.mark.parametrize(
    "params", [NANOSAT, UkfParams(n=32, m=32, q=32, r=32)], ids=["page", "big"]
)
def test_the_overlay_applies_to_a_zynq(params, tmp_path):
    (tmp_path / "base.dts").write_text(BASE)
    (tmp_path / "core.dtso").write_text(texts(params)["ukf_core.dtso"])
    for name in ("base.dts", "core.dtso"):
        stderr = subprocess.run(
            ["dtc", "-@", "-I", "dts", "-O", "dtb", "-o", f"{name}.dtb", name],
            cwd=tmp_path, capture_output=True, text=True, check=True,
        ).stderr  # fmt: skip
        assert "rror" not in stderr
    merged = str(tmp_path / "merged.dtb")
    run("fdtoverlay", "-i", str(tmp_path / "base.dts.dtb"), "-o", merged,
        str(tmp_path / "core.dtso.dtb"))  # fmt: skip
    node = f"/axi/ukf_core@{USUAL.base_address:x}"
    size = max(1 << MemoryMap(params).address_width, 4096)
    assert run("fdtget", "-t", "x", merged, node, "reg") == [f"{USUAL.base_address:x}", f"{size:x}"]
    assert run("fdtget", "-t", "u", merged, node, "interrupts") == [
        "0",
        str(USUAL.interrupt - 32),
        "4",
    ]
    assert run("fdtget", merged, node, "compatible")[-1] == "generic-uio"
    controller = run("fdtget", merged, "/axi/interrupt-controller@f8f01000", "phandle")
    assert run("fdtget", merged, node, "interrupt-parent") == controller
    # Its clock has the right frequency, and stays on.
    clocks = run("fdtget", merged, "/axi/clkc@f8000100", "phandle")
    assert run("fdtget", "-t", "u", merged, node, "assigned-clocks") == [*clocks, "15"]
    assert run("fdtget", "-t", "u", merged, node, "assigned-clock-rates") == ["100000000"]
    assert run("fdtget", "-t", "u", merged, "/axi/ukf_core_clock", "clocks") == [*clocks, "15"]
    assert run("fdtget", merged, "/axi/ukf_core_clock", "compatible") == ["xlnx,fclk"]


PLACES = "base_address must be a multiple of {}, the size of the core, of 32 bits, not {}"
SHARED = "interrupt must be between 32 and 1019, not {}"


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ({"base_address": 0x43C0_0004}, PLACES.format("0x1000", "0x43c00004")),
        ({"base_address": 1 << 32}, PLACES.format("0x1000", "0x100000000")),
        ({"interrupt": 31}, SHARED.format(31)),
        ({"interrupt": 1020}, SHARED.format(1020)),
    ],
)
def test_the_place_in_the_system_is_checked(place, message, tmp_path):
    with pytest.raises(ValueError, match=f"^{message}$"):
        generate(
            SMALLEST, Pipeline(), tmp_path / "core", engine=StubEngine(SMALLEST),
            instance=Instance(**place),
        )  # fmt: skip
    assert not (tmp_path / "core").exists()


@pytest.mark.parametrize("base_address", [0x43C0_1000, 0xFFFF_F000])
def test_a_large_core_is_at_a_multiple_of_its_size(base_address):
    with pytest.raises(ValueError, match=f"^{PLACES.format('0x4000', f'{base_address:#x}')}$"):
        texts(NANOSAT, base_address=base_address)


def test_the_place_in_the_system_is_in_the_files():
    found = texts(SMALLEST, base_address=0x4000_0000, interrupt=84)
    assert "reg = <0x40000000 " in found["ukf_core.dtso"]
    assert "interrupts = <0 52 4>;" in found["ukf_core.dtso"]
    assert "<baseAddress>0x40000000</baseAddress>" in found["ukf_core.svd"]
    assert "<value>84</value>" in found["ukf_core.svd"]
    assert "#define UKF_BASE_ADDRESS 0x40000000u\n" in found["c/ukf_core.h"]
    assert "#define UKF_INTERRUPT 84u\n" in found["c/ukf_core.h"]
    assert "At 0x40000000 in the system, interrupt 84, clock 100 MHz" in found["ukf_core.md"]
    record = json.loads(found["ukf_core.json"])
    assert (record["base_address"], record["interrupt"]) == (0x4000_0000, 84)
    assert (record["clock_hz"], record["address_range"]) == (100_000_000, 4096)


# Names.

#: Two cores of one system.
PAIR = {
    "left": (SMALLEST, {"base_address": 0x43C0_0000, "interrupt": 61}),
    "right": (NANOSAT, {"base_address": 0x43C1_0000, "interrupt": 62}),
}

TWO_CORES = """\
#include <stdio.h>
#include <left.h>
#include <right.h>
#include <ukf_filter.h>

static const struct ukf_core left = LEFT_CORE_INITIALISER;
static const struct ukf_core right = RIGHT_CORE_INITIALISER;

int main(void)
{
    printf("%u %u %u %u\\n", (unsigned)left.n, LEFT_N, (unsigned)right.n, RIGHT_N);
    printf("%x %u %x %u\\n", LEFT_BASE_ADDRESS, LEFT_INTERRUPT, RIGHT_BASE_ADDRESS,
           RIGHT_INTERRUPT);
    return 0;
}
"""


@needs_cc
@needs_cxx
@pytest.mark.parametrize(("language", "standard"), [("c", "c99"), ("c", "c11"), ("c++", "c++17")])
def test_one_program_has_two_cores(language, standard, tmp_path):
    """Their headers say nothing twice, and the driver is one."""
    for name, (params, place) in PAIR.items():
        folder = write(params, tmp_path, name=name, **place)
    assert "UKF_N" not in (folder / "left.h").read_text()
    (folder / "main.c").write_text(TWO_CORES)
    compiler = "gcc" if language == "c" else "g++"
    result = subprocess.run(
        [compiler, "-x", language, f"-std={standard}", *STRICT, "-I.", "main.c"],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    done = subprocess.run([str(folder / "a.out")], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["1 1 7 7", "43c00000 61 43c10000 62"]


def test_two_cores_have_no_name_in_common():
    (left, a), (right, b) = PAIR.values()
    ours = texts(left, name="left", **a), texts(right, name="right", **b)
    common = set(ours[0]) & set(ours[1])
    assert all(name.startswith("c/") for name in common)
    # What both have is the same in both: the driver.
    assert all(ours[0][name] == ours[1][name] for name in common)
    pairs = list(zip(PAIR, ours, strict=True))
    defined = [set(re.findall(r"#define (\w+)", text[f"c/{name}.h"])) for name, text in pairs]
    assert not defined[0] & defined[1]
    assert not (defined[0] | defined[1]) & set(
        re.findall(r"#define (\w+)", ours[0]["c/ukf_registers.h"])
    )
    nodes = [re.findall(r"^\t(\w[\w@]*) \{", text[f"{name}.dtso"], re.M) for name, text in pairs]
    assert nodes == [
        ["left@43c00000", "left_clock"], ["right@43c10000", "right_clock"],
    ]  # fmt: skip
    for name, text in pairs:
        peripheral = text[f"{name}.svd"].split("<peripheral>")[1]
        assert f"<name>{name.upper()}</name>" in peripheral


FORM = (
    "name must be at most 25 lower-case letters, digits and single underscores, beginning with "
    "a letter, not {!r}"
)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        *((name, FORM.format(name)) for name in (
            "", "Left", "2nd", "_left", "left_", "a__b", "a b", "a-b", "\u00fcber", "a" * 26, "a\n",
        )),
        ("module", "name must not be 'module', a keyword of Verilog"),
        ("logic", "name must not be 'logic', a keyword of Verilog"),
        ("signal", "name must not be 'signal', a keyword of VHDL"),
        ("typedef", "name must not be 'typedef', a keyword of Verilog"),
        ("sizeof", "name must not be 'sizeof', a keyword of C"),
        ("math", "name must not be 'math', a header of the C library"),
        ("ukf_registers", "name must not be 'ukf_registers', which the C driver has"),
        ("ukf_driver", "name must not be 'ukf_driver', which the C driver has"),
        ("uio", "name must not be 'uio', which the C driver has"),
        ("ukf", "name must not be 'ukf', which the C driver has"),
    ],
)  # fmt: skip
def test_names_that_a_core_cannot_have(name, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        Instance(name=name)


@pytest.mark.parametrize("name", ["a", "left", "core_2", "nanosat", "ukf_port_uio", "a" * 25])
def test_names_that_a_core_can_have(name):
    assert Instance(name=name).prefix == name.upper()


@pytest.mark.parametrize(
    ("place", "error", "message"),
    [
        ({"name": 1}, TypeError, "name must be a str, not 1"),
        ({"base_address": "0x4"}, TypeError, "base_address must be an int, not '0x4'"),
        ({"interrupt": True}, TypeError, "interrupt must be an int, not True"),
        ({"clock_mhz": 0.5}, ValueError, "clock_mhz must be between 1 and 250, not 0.5"),
        ({"clock_mhz": float("nan")}, ValueError, "clock_mhz must be between 1 and 250, not nan"),
    ],
)
def test_instances_that_there_are_not(place, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        Instance(**place)


# Documentation.


@pytest.mark.parametrize("params", CONFIGURATIONS)
def test_the_page_has_every_field_and_region(params):
    page = texts(params)["ukf_core.md"]
    rows, heading = [], []
    for line in page.splitlines():
        if line.startswith("## "):
            heading = []
        elif line.startswith("### "):
            heading = [word.strip("`") for word in line[4:].split(", offset ")]
        elif line.startswith("| ") and "`" in line:
            cells = [cell.strip().strip("`") for cell in line.strip("|").split("|")]
            rows.append([*heading, *cells] if len(cells) == 5 else cells)
    fields = [
        [register.name, f"{register.offset:#04x}", field.name, field.access.value, field.doc]
        for register in REGISTERS
        for field in register
    ]
    assert sorted([*row[:2], *row[3:5], row[6]] for row in rows if len(row) == 7) == sorted(fields)
    assert all(f"\n{register.doc}\n" in page for register in REGISTERS)
    memory_map = MemoryMap(params)
    assert [row for row in rows if len(row) == 4] == [
        [
            f"{memory_map.address(region.symbol, 0, 0):#06x}", region.symbol,
            f"{region.rows} x {region.columns}", region.doc,
        ]
        for region in memory_map
    ]  # fmt: skip
    assert ["SIZES", "0x04", "7:0", "N", "ro", hex(params.n), "States, n."] in rows
    assert "Reserved bits" in page


@pytest.mark.parametrize("params", CONFIGURATIONS)
def test_every_description_says_which_columns_the_core_writes(params):
    """X has a column for every sigma point, but SIG_GEN writes n + 2 of them."""
    written = f"write columns {params.points.start} to n + 1 = {params.n + 1} only"
    for name in ("ukf_core.json", "ukf_core.svd", "ukf_core.md", "c/ukf_core.h"):
        assert texts(params)[name].count(written) == 1, name
