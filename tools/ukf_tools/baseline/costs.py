"""Cycles of a Cortex-A9 for counted instructions, as a bracket, from LLVM's model of the core.

LLVM's machine code analyser tells for each instruction its latency and the units that it occupies.
The *throughput* bound supposes perfect overlap: the most occupied unit, or the two instructions a
clock that can be issued, decide. The *latency* bound supposes none: every instruction waits for the
one before. Real code lies between. Neither has cache misses or mispredicted branches.
"""

import json
import re
import subprocess
from collections import defaultdict
from dataclasses import dataclass

from ukf_tools.baseline.counting import Counts
from ukf_tools.baseline.executable import BaselineError, need

__all__ = ["TOOL", "Cycles", "cost", "rewrite"]

#: The model of the processor.
TOOL = "llvm-mca-14"
_COMMAND = (
    "-mtriple=armv7a-linux-gnueabihf", "-mcpu=cortex-a9", "-mattr=+neon", "-instruction-tables",
    "-json",
)  # fmt: skip
#: Instructions that a Cortex-A9 can issue in a clock.
_ISSUE = 2
#: Share of the executed instructions that may lack a cost.
_UNKNOWN = 0.01

_CONDITION = "eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le"
_PLAIN = re.compile(
    r"(add|adc|sub|sbc|rsb|and|orr|eor|bic|mov|mvn|movw|movt|mul|mla|mls|cmp|cmn|tst|teq|ldr|ldrb"
    r"|ldrh|ldrd|ldrsb|ldrsh|str|strb|strh|strd|lsl|lsr|asr|ror|ldm|ldmia|stm|stmia|push|pop|uxtb"
    r"|uxth|sxtb|sxth|ubfx|sbfx|bfi|bfc|umull|smull|clz|orn)(s?)"
    rf"({_CONDITION})$"
)


@dataclass(frozen=True, kw_only=True)
class Cycles:
    """What instructions take.

    Parameters
    ----------
    instructions
        How many they are.
    throughput, latency
        Cycles at least and at most, but for caches and branches.
    """

    instructions: float
    throughput: float
    latency: float

    def __add__(self, other: "Cycles") -> "Cycles":
        return Cycles(
            instructions=self.instructions + other.instructions,
            throughput=self.throughput + other.throughput,
            latency=self.latency + other.latency,
        )


def rewrite(instruction: str) -> list[str]:
    """Write an instruction of the disassembler as the analyser takes it, at the same cost.

    Thumb instructions become those of ARM, conditions go, targets of branches become 0.
    """
    name, _, operands = instruction.partition(" ")
    name = re.sub(r"\.[nw]$", "", name)
    match = _PLAIN.match(name)
    if match:
        name = match[1] + match[2]
    if re.match(r"it[te]*$", name) or name == "nop":
        return ["mov r0, r0"]
    if re.match(rf"(b|bl|blx|bx)({_CONDITION})?$", name) or name in ("cbz", "cbnz"):
        return ["b #0"]
    name = re.sub(rf"^(vmov|vldr|vstr|vsqrt|vdiv)({_CONDITION})(?=$|\.)", r"\1", name)
    operands = operands.replace(" :", ":")
    if name.startswith("vmov") and re.search(r", #\d+$", operands) and ".f" in name:
        return [f"{name} {operands.partition(',')[0]}, #1.0"]
    if name in ("ldrd", "strd"):
        return [f"{name} r0, r1, {operands[operands.index('[') :]}"]
    match = re.match(r"(v?ldm|v?stm|v?push|v?pop)(ia|db|ib|da)?$", name)
    if match:
        return _block(match[1], operands)
    if name in ("lsl", "lsr", "asr", "ror", "lsls", "lsrs", "asrs"):
        parts = operands.split(", ")
        if len(parts) == 2:
            return [f"{name} {parts[0]}, {parts[0]}, {parts[1]}"]
    if name == "vpadd.f32":  # not in the model; the adder is the same
        return [f"vadd.f32 {operands}"]
    if name in ("orn", "orns"):
        return [f"orr {operands}"]
    if re.match(r"(add|sub|rsb|and|orr|eor|bic|mul|adc|sbc)s?$", name):
        parts = operands.split(", ")
        if len(parts) == 2:
            return [f"{name} {parts[0]}, {parts[0]}, {parts[1]}"]
    return [f"{name} {operands}".strip()]


def _block(name: str, operands: str) -> list[str]:
    """Accesses to a block of registers: the analyser counts one, the core makes one for each."""
    load = name.endswith(("ldm", "pop"))
    access = ("v" if name.startswith("v") else "") + ("ldr" if load else "str")
    registers: list[str] = []
    for part in operands[operands.index("{") + 1 : operands.index("}")].split(", "):
        ends = re.fullmatch(r"([a-z])(\d+)-[a-z](\d+)", part)
        if ends:
            registers += [f"{ends[1]}{i}" for i in range(int(ends[2]), int(ends[3]) + 1)]
        else:
            registers.append(part)
    # A jump, when the program counter is loaded, is counted as one.
    words = ["b #0" if register == "pc" else f"{access} {register}, [r0]" for register in registers]
    return [*words, "add r0, r0, #8"] if "!" in operands or "p" in name else words


def _analyse(lines: list[str]) -> dict[str, tuple[float, dict[int, float]]]:
    """Latency and use of units of instructions; those that are not understood are left out."""
    need(TOOL)
    while lines:
        result = subprocess.run(
            [TOOL, *_COMMAND, "-"], input="\n".join(lines) + "\n", capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        wrong = {int(n) for n in re.findall(r"^<stdin>:(\d+):\d+: error", result.stderr, re.M)}
        if not wrong:
            break
        lines = [line for number, line in enumerate(lines, 1) if number not in wrong]
    else:
        raise BaselineError(f"{TOOL} understood no instruction")
    if result.returncode:
        raise BaselineError(f"{TOOL} failed: {result.stderr.strip()[-500:]}")
    (region,) = json.loads(result.stdout)["CodeRegions"]
    units: dict[int, dict[int, float]] = defaultdict(dict)
    for use in region["ResourcePressureView"]["ResourcePressureInfo"]:
        units[use["InstructionIndex"]][use["ResourceIndex"]] = use["ResourceUsage"]
    table = region["InstructionInfoView"]["InstructionList"]
    if len(table) != len(lines):
        raise BaselineError(f"{TOOL} must cost {len(lines)} instructions, not {len(table)}")
    return {
        line: (entry["Latency"], units[index])
        for index, (line, entry) in enumerate(zip(lines, table, strict=True))
    }


def cost(counts: Counts, steps: int) -> dict[str, Cycles]:
    """Cycles of each section of an iteration.

    Parameters
    ----------
    counts
        Of all steps.
    steps
        How many steps.

    Raises
    ------
    BaselineError
        If the analyser is not installed, or knows too few of the instructions.
    """
    rewritten = {text: rewrite(text) for section in counts.values() for text in section}
    known = _analyse(sorted({line for lines in rewritten.values() for line in lines}))
    result: dict[str, Cycles] = {}
    executed = unknown = 0
    missing: dict[str, int] = defaultdict(int)
    for section, instructions in counts.items():
        latency, issued = 0.0, 0.0
        pressure: dict[int, float] = defaultdict(float)
        for text, number in instructions.items():
            executed += number
            for line in rewritten[text]:
                issued += number
                if line not in known:
                    unknown += number
                    missing[text] += number
                    latency += number
                    continue
                own_latency, units = known[line]
                latency += number * own_latency
                for unit, use in units.items():
                    pressure[unit] += number * use
        throughput = max([issued / _ISSUE, *pressure.values()])
        result[section] = Cycles(
            instructions=sum(instructions.values()) / steps,
            throughput=throughput / steps,
            latency=max(latency, throughput) / steps,
        )
    if unknown > _UNKNOWN * executed:
        often = sorted(missing, key=lambda text: -missing[text])[:8]
        raise BaselineError(
            f"{TOOL} knows the cost of too few instructions: {unknown} of {executed} lack one, "
            f"{'; '.join(often)}"
        )
    return result
