"""Runs a pipelined unit on millions of vectors, with Verilator and a C++ harness."""

import subprocess
from pathlib import Path

import numpy as np
from amaranth.back import verilog

from ukf_sim.simulators import Simulator, tool_environment

__all__ = ["UnitHarness"]

_TOP = "unit"

_HARNESS = """\
#include <cstdint>
#include <cstdio>
#include <vector>
#include "Vunit.h"
#include "verilated.h"

// Reads one block of words for each input, and writes the words of the output.
int main(int argc, char** argv) {{
    if (argc != 3) return 2;
    FILE* source = std::fopen(argv[1], "rb");
    if (!source) return 3;
    std::fseek(source, 0, SEEK_END);
    const std::size_t inputs = {input_count};
    const std::size_t count = std::ftell(source) / (8 * inputs);
    std::rewind(source);
    std::vector<std::uint64_t> words(inputs * count), results(count);
    if (std::fread(words.data(), 8, words.size(), source) != words.size()) return 4;
    std::fclose(source);

    VerilatedContext context;
    Vunit unit(&context);
    const std::size_t stages = {stages};
    for (std::size_t clock = 0; clock < count + stages; ++clock) {{
        const std::size_t index = clock < count ? clock : count - 1;
        {inputs}
        unit.clk = 0;
        unit.eval();
        // What went in this many clocks ago comes out before the next edge.
        if (clock >= stages) results[clock - stages] = unit.{output};
        unit.clk = 1;
        unit.eval();
    }}

    FILE* sink = std::fopen(argv[2], "wb");
    if (!sink || std::fwrite(results.data(), 8, count, sink) != count) return 5;
    return std::fclose(sink) ? 6 : 0;
}}
"""


class UnitHarness:
    """A compiled unit with inputs, one output and a fixed latency, and no handshake.

    A vector is put in on every clock.

    Parameters
    ----------
    unit : :class:`Component`
        Unit. Its attribute :py:`stages` is its latency in clocks.
    inputs : :class:`list`
        Names of the inputs, of up to 64 bits each.
    output : :class:`str`
        Name of the output, of up to 64 bits.
    folder : :class:`Path`
        An empty folder for generated and compiled files.

    Raises
    ------
    SimulatorError
        If Verilator is not installed.
    CalledProcessError
        If Verilator or the compiler fails. Their messages are in its :py:`stderr`.
    """

    def __init__(self, unit, inputs, output, folder):
        self._folder = Path(folder).resolve()
        self._inputs = list(inputs)
        text = verilog.convert(unit, name=_TOP, strip_internal_attrs=True)
        (self._folder / "unit.v").write_text(text, encoding="utf-8")
        harness = _HARNESS.format(
            input_count=len(self._inputs),
            inputs=" ".join(
                f"unit.{name} = words[{position} * count + index];"
                for position, name in enumerate(self._inputs)
            ),
            stages=unit.stages,
            output=output,
        )
        (self._folder / "harness.cpp").write_text(harness, encoding="utf-8")

        simulator = Simulator.VERILATOR
        simulator.require()
        command = [
            "verilator", "--cc", "--exe", "--build", *simulator.tool.flags, "-Wno-lint",
            "--top-module", _TOP, "--Mdir", "build", "unit.v", "harness.cpp",
        ]  # fmt: skip
        with tool_environment(simulator.make_flags(optimise=True)):
            subprocess.run(command, cwd=self._folder, check=True, capture_output=True, text=True)

    def run(self, *words):
        """Put words in, and give what comes out for each.

        Parameters
        ----------
        words : arrays of uint64
            Words for each input, in the order of the constructor; equally many, at least one.

        Returns
        -------
        array of uint64
            Words of the output.

        Raises
        ------
        ValueError
            If there are not as many equally long, nonempty arrays as inputs.
        """
        arrays = [np.asarray(array, dtype=np.uint64) for array in words]
        sizes = {array.shape for array in arrays}
        if len(arrays) != len(self._inputs) or len(sizes) != 1 or arrays[0].ndim != 1:
            shapes = [array.shape for array in arrays]
            raise ValueError(
                f"Words must be {len(self._inputs)} arrays of one length, not of shapes {shapes!r}"
            )
        if arrays[0].size == 0:
            raise ValueError(f"Words must not be empty, not {arrays!r}")
        source, sink = self._folder / "input.bin", self._folder / "output.bin"
        np.concatenate(arrays).tofile(source)
        executable = self._folder / "build" / f"V{_TOP}"
        subprocess.run([str(executable), str(source), str(sink)], check=True, capture_output=True)
        return np.fromfile(sink, dtype=np.uint64)
