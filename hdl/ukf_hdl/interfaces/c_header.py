"""C headers: registers, which all cores share, and sizes and addresses, which each has its own."""

from typing import Any

from ukf_sw.spec.registers import ID, IDENTITY, STATUS, ErrorCode
from ukf_sw.spec.sequence import HIDDEN, STEPS, WAYS, Flag, Step

__all__ = ["core_header", "registers_header"]

#: What C++ needs before and after declarations of C.
_OPEN = ("#ifdef __cplusplus", 'extern "C" {', "#endif", "")
_CLOSE = ("", "#ifdef __cplusplus", "}", "#endif")

#: Names of the base addresses in ``struct ukf_core`` (sw/c/ukf_driver.h) are those of the regions.
REGIONS = (
    "state_points", "process_noise_points", "observation_noise_points", "observation_points",
    "observation", "state", "factor", "covariance", "process_noise_factor",
    "observation_noise_factor", "inputs",
)  # fmt: skip


#: Names in ``struct ukf_core`` of how many inputs the models on the core take.
INPUTS = ("input_count", "inputs_of_f", "inputs_of_h")

#: Fields that identify a core, in the order of their registers; any number of PEs will do.
IDENTITY_FIELDS = tuple(
    (register.name, field.name)
    for register in IDENTITY
    for field in register
    if field.of is not None and field.name != "PES"
)


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
    lines += ["", "/* Bits of STATUS of which a step needs one; 0 if it is always legal. */"]
    lines += [f"#define UKF_STEP_{step.name}_NEEDS {_needs(step):#x}u" for step in STEPS]
    lines += ["", "/* Values of ERROR.CODE. */"]
    lines += [f"#define UKF_ERROR_CODE_{code.name} {code.value}u" for code in ErrorCode]
    lines += [
        "",
        "/* X(register, field, member) for what identifies a core beside ID and the number of",
        " * processing elements; members are those of `struct ukf_core` (ukf_driver.h). */",
        " \\\n    ".join(
            (
                "#define UKF_IDENTITY(X)",
                *(f"X({name}, {field}, {field.lower()})" for name, field in IDENTITY_FIELDS),
            )
        ),
    ]
    lines += ["", *_structure(record), *_CLOSE, "", "#endif", ""]
    return "\n".join(lines)


def _needs(step: Step) -> int:
    """Bits of STATUS of which a step needs one; a prediction is there only after an INIT."""
    needed = [way.needs & ~HIDDEN for way in WAYS[step]]
    return sum(STATUS[str(flag.name)].mask for flag in Flag if any(flag in each for each in needed))


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


def _inputs(record: dict[str, Any]) -> dict[str, int]:
    """How many inputs the models on the core take, by the name in the struct."""
    models = record.get("models", {"inputs": [], "inputs_of_f": 0, "inputs_of_h": 0})
    counts = [len(models["inputs"]), models["inputs_of_f"], models["inputs_of_h"]]
    return dict(zip(INPUTS, counts, strict=True))


def core_header(record: dict[str, Any]) -> str:
    """Render sizes and addresses of a core as a C header, C99 and later, and C++.

    Its macros begin with the prefix of the core, so one program can include those of several.

    Parameters
    ----------
    record
        Description of the core.
    """
    values = {
        (register["name"], field["name"]): field["reset"]
        for register in record["registers"]
        for field in register["fields"]
    }
    bases = {region["name"]: region["base"] for region in record["regions"]}
    points = next(region["columns"] for region in record["regions"] if region["symbol"] == "X")
    prefix = record["c_prefix"]
    inputs = _inputs(record)
    lines = [
        f"/* Sizes and addresses of the UKF core {record['name']}. Generated, do not edit. */",
        f"#ifndef {prefix}_CORE_H",
        f"#define {prefix}_CORE_H",
        "",
        '#include "ukf_registers.h"',
        "",
        *_OPEN,
        "/* Sizes. */",
        *(f"#define {prefix}_{field} {values[name, field]}u" for name, field in IDENTITY_FIELDS),
        f"#define {prefix}_POINTS {points}u",
        f"#define {prefix}_PES {values['CONFIG', 'PES']}u",
        "",
        "/* Numbers that the models on the core take from region U: all, the first ones for f, the",
        " * last ones for h. */",
        *(f"#define {prefix}_{name.upper()} {count}u" for name, count in inputs.items()),
        "",
        "/* Place in the system: address of the registers, interrupt at its controller, clock. */",
        f"#define {prefix}_BASE_ADDRESS {record['base_address']:#x}u",
        f"#define {prefix}_INTERRUPT {record['interrupt']}u",
        f"#define {prefix}_CLOCK_HZ {record['clock_hz']}u",
        "",
        "/* Addresses are in bytes from there on. Element (i, j) of a region is at",
        f" * base + i * {prefix}_ROW_STRIDE + j * {prefix}_ELEMENT_BYTES. */",
        f"#define {prefix}_ADDRESS_BITS {record['address_width']}u",
        f"#define {prefix}_ELEMENT_BYTES {record['element_bytes']}u",
        f"#define {prefix}_ROW_STRIDE {record['row_stride']:#x}u",
        f"#define {prefix}_REGION_STRIDE {record['region_stride']:#x}u",
    ]
    for region in record["regions"]:
        stem = f"{prefix}_{region['name'].upper()}"
        lines += [
            "",
            f"/* {region['symbol']}: {region['doc']} */",
            f"#define {stem}_BASE {region['base']:#x}u",
            f"#define {stem}_ROWS {region['rows']}u",
            f"#define {stem}_COLUMNS {region['columns']}u",
        ]
    members = [
        *((field.lower(), f"{prefix}_{field}") for _, field in IDENTITY_FIELDS),
        ("points", f"{prefix}_POINTS"),
        ("element_bytes", f"{prefix}_ELEMENT_BYTES"),
        ("row_stride", f"{prefix}_ROW_STRIDE"),
        *((name, f"{prefix}_{name.upper()}_BASE" if name in bases else "0u") for name in REGIONS),
        *((name, f"{prefix}_{name.upper()}") for name in inputs),
    ]
    lines += [
        "",
        "/* The same as an initialiser of `struct ukf_core` (ukf_driver.h), in the order of its",
        " * members: C++ before C++20 cannot name them. */",
        f"#define {prefix}_CORE_INITIALISER {{ \\",
        *(f"    {value}, /* {name} */ \\" for name, value in members),
        "}",
        *_CLOSE,
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)
