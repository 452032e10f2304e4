"""How often each instruction of the Cortex-A9 program runs, in each section of an iteration."""

import re
from collections import defaultdict
from pathlib import Path

from ukf_sw.problem import Problem
from ukf_tools.baseline.executable import SOURCES, Executable, execute

__all__ = ["COMPILER", "DISASSEMBLER", "SECTIONS", "Counts", "count"]

#: What compiles the plugin, and what tells the instructions of the program.
COMPILER, DISASSEMBLER = "gcc", "arm-linux-gnueabihf-objdump"

#: Sections of an iteration, as ``baseline.h`` numbers them from 1.
SECTIONS = ("sig_gen", "predict", "update", "models")

#: Number of executions of each instruction, as text, by section.
Counts = dict[str, dict[str, int]]

_LINE = re.compile(r"\s+([0-9a-f]+):\s+(\S+)\s*(.*)$")


def _disassemble(path: Path) -> dict[int, str]:
    """Instructions by address."""
    text = execute([DISASSEMBLER, "-d", "--no-show-raw-insn", str(path)])
    found: dict[int, str] = {}
    for line in text.decode().splitlines():
        match = _LINE.match(line)
        if match:
            operands = re.split(r"\s*[;@]", re.sub(r"<.*?>", "", match[3]))[0].strip()
            found[int(match[1], 16)] = f"{match[2]} {operands}".strip()
    return found


def count(program: Executable, variant: str, problem: Problem, folder: Path) -> Counts:
    """Run a variant under qemu with the counting plugin.

    Parameters
    ----------
    program
        Compiled for ARM.
    variant
        Of the program.
    problem
        What to run.
    folder
        For the plugin and its output.

    Returns
    -------
    dict
        Of all steps of the scenario together.

    Raises
    ------
    BaselineError
        If a tool is missing or fails.
    """
    plugin, output = folder / "count.so", folder / f"counts-{variant}.txt"
    flags = ("-std=c11", "-O2", "-shared", "-fPIC")
    execute([COMPILER, *flags, str(SOURCES / "count.c"), "-o", str(plugin)])
    program.run(variant, problem, ("-d", "plugin", "-plugin", f"{plugin},output={output}"))
    instructions = _disassemble(program.path)
    counts: Counts = {section: defaultdict(int) for section in SECTIONS}
    for line in output.read_text(encoding="ascii").splitlines():
        address, *numbers = line.split()
        instruction = instructions[int(address, 16)]
        for section, number in zip(SECTIONS, numbers, strict=True):
            if int(number):
                counts[section][instruction] += int(number)
    return counts
