"""C headers: registers, which all cores share, and sizes and addresses, which each has its own."""

from typing import Any

from ukf_sw.spec.registers import ID, ErrorCode, Step

__all__ = ["core_header", "registers_header"]

#: What C++ needs before and after declarations of C.
_OPEN = ("#ifdef __cplusplus", 'extern "C" {', "#endif", "")
_CLOSE = ("", "#ifdef __cplusplus", "}", "#endif")

#: Names of the base addresses in ``struct ukf_core`` (sw/c/ukf_driver.h) are those of the regions.
REGIONS = (
    "state_points", "process_noise_points", "observation_noise_points", "observation_points",
    "observation", "state", "factor", "covariance", "process_noise_factor",
    "observation_noise_factor",
)  # fmt: skip


def registers_header(record: dict[str, Any]) -> str:
    """Render the register block as a C header, C99 and later, and C++.

    It is the same for all cores of one version of the map, so a driver compiled with it drives any
    of them. In C11 and later the layout of ``struct ukf_registers`` is asserted.

    Parameters
    ----------
    record
        Description of a core.
    """
    lines = [
        "/* Registers of the UKF core. Generated, do not edit. */",
        "#ifndef UKF_REGISTERS_H",
        "#define UKF_REGISTERS_H",
        "",
        "#include <stddef.h>",
        "#include <stdint.h>",
        "",
        *_OPEN,
        "/* What ID must hold. */",
        *(f"#define UKF_ID_{field.name}_VALUE {field.reset:#x}u" for field in ID),
    ]
    for register in record["registers"]:
        stem = f"UKF_{register['name']}"
        lines += ["", f"/* {register['doc']} */", f"#define {stem}_OFFSET {register['offset']:#x}u"]
        for field in register["fields"]:
            mask = ((1 << field["width"]) - 1) << field["lsb"]
            lines += [
                f"#define {stem}_{field['name']}_SHIFT {field['lsb']}u",
                f"#define {stem}_{field['name']}_MASK {mask:#x}u",
            ]
    lines += ["", "/* Values of STATUS.STATE. */"]
    lines += [f"#define UKF_STEP_{step.name} {step.value}u" for step in Step]
    lines += ["", "/* Values of ERROR.CODE. */"]
    lines += [f"#define UKF_ERROR_CODE_{code.name} {code.value}u" for code in ErrorCode]
    lines += ["", *_structure(record), *_CLOSE, "", "#endif", ""]
    return "\n".join(lines)


def _structure(record: dict[str, Any]) -> list[str]:
    """Lines of a struct that lies over the registers."""
    lines = [
        "/* The registers in place, for `volatile struct ukf_registers *`. */",
        "struct ukf_registers {",
    ]
    position = 0
    for register in sorted(record["registers"], key=lambda register: register["offset"]):
        gap = (register["offset"] - position) // 4
        if gap:
            lines.append(f"    uint32_t reserved_{position:#04x}[{gap}];")
        access = {field["access"] for field in register["fields"]}
        constant = "const " if access == {"ro"} else ""
        lines.append(f"    {constant}uint32_t {register['name']};")
        position = register["offset"] + 4
    lines += ["};", "", "#if defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L"]
    for register in record["registers"]:
        name = register["name"]
        lines.append(
            f"_Static_assert(offsetof(struct ukf_registers, {name}) == UKF_{name}_OFFSET, "
            f'"offset of {name}");'
        )
    return [*lines, "#endif"]


def core_header(record: dict[str, Any]) -> str:
    """Render sizes and addresses of a core as a C header, C99 and later, and C++.

    Parameters
    ----------
    record
        Description of the core.
    """
    parameters = record["parameters"]
    number_format = parameters["format"]
    bases = {region["name"]: region["base"] for region in record["regions"]}
    points = next(region["columns"] for region in record["regions"] if region["symbol"] == "X")
    additive = {
        noise: int(parameters[f"{noise}_noise"] == "additive")
        for noise in ("process", "observation")
    }
    lines = [
        "/* Sizes and addresses of a UKF core. Generated, do not edit. */",
        "#ifndef UKF_CORE_H",
        "#define UKF_CORE_H",
        "",
        '#include "ukf_registers.h"',
        "",
        *_OPEN,
        "/* Sizes. */",
        *(f"#define UKF_{name.upper()} {parameters[name]}u" for name in "nmqr"),
        f"#define UKF_POINTS {points}u",
        f"#define UKF_PES {parameters['pes']}u",
        f"#define UKF_EXPONENT_BITS {number_format['exponent_bits']}u",
        f"#define UKF_FRACTION_BITS {number_format['fraction_bits']}u",
        f"#define UKF_COVARIANCE_FORM {int(parameters['form'] == 'covariance')}u",
        f"#define UKF_ADDITIVE_Q {additive['process']}u",
        f"#define UKF_ADDITIVE_R {additive['observation']}u",
        "",
        "/* Addresses are in bytes. Element (i, j) of a region is at",
        " * base + i * UKF_ROW_STRIDE + j * UKF_ELEMENT_BYTES. */",
        f"#define UKF_ADDRESS_BITS {record['address_width']}u",
        f"#define UKF_ELEMENT_BYTES {record['element_bytes']}u",
        f"#define UKF_ROW_STRIDE {record['row_stride']:#x}u",
        f"#define UKF_REGION_STRIDE {record['region_stride']:#x}u",
    ]
    for region in record["regions"]:
        stem = f"UKF_{region['name'].upper()}"
        lines += [
            "",
            f"/* {region['symbol']}: {region['doc']} */",
            f"#define {stem}_BASE {region['base']:#x}u",
            f"#define {stem}_ROWS {region['rows']}u",
            f"#define {stem}_COLUMNS {region['columns']}u",
        ]
    members = [
        *((name, f"UKF_{name.upper()}") for name in "nmqr"),
        ("points", "UKF_POINTS"),
        ("exponent_bits", "UKF_EXPONENT_BITS"),
        ("fraction_bits", "UKF_FRACTION_BITS"),
        ("covariance_form", "UKF_COVARIANCE_FORM"),
        ("additive_q", "UKF_ADDITIVE_Q"),
        ("additive_r", "UKF_ADDITIVE_R"),
        ("element_bytes", "UKF_ELEMENT_BYTES"),
        ("row_stride", "UKF_ROW_STRIDE"),
        *((name, f"UKF_{name.upper()}_BASE" if name in bases else "0u") for name in REGIONS),
    ]
    lines += [
        "",
        "/* The same as an initialiser of `struct ukf_core` (ukf_driver.h), in the order of its",
        " * members: C++ before C++20 cannot name them. */",
        "#define UKF_CORE_INITIALISER { \\",
        *(f"    {value}, /* {name} */ \\" for name, value in members),
        "}",
        *_CLOSE,
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)
