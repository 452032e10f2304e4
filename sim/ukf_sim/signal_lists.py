"""Lists of signals beside a waveform: what is worth seeing of a core, and as what.

Of a waveform ``run.fst`` GTKWave opens ``run.gtkw``, and Surfer runs the commands of ``run.sucl``.
Both show steps, programs and errors by name, control words as the disassembler says them, and
words of the memories as numbers, under the names that they have in the equations. Names of files
are relative, so the viewers are started in the folder of the waveform.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from io import StringIO
from math import ceil, log10
from pathlib import Path

from ukf_sim.simulators import Simulator, Waves
from ukf_sw.engine.layout import BANK_NONE, Vector
from ukf_sw.engine.microcode import Microcode
from ukf_sw.engine.mnemonics import Mnemonics
from ukf_sw.extras import importing
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FloatFormat
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.registers import DATA_WIDTH, ErrorCode
from ukf_sw.spec.sequence import Step, steps_of

__all__ = ["Group", "Signal", "Signals", "signal_lists", "write_signal_lists"]

#: How a signal is shown, where not by one of the tables of names.
PLAIN, NUMBER = "plain", "number"

_TOP = "ukf_core"
_CONTROL, _ENGINE = f"{_TOP}.core.control", f"{_TOP}.core.engine"

#: What Surfer calls the formats that it knows.
_SURFER_FORMATS = {
    BINARY16: "FP: 16-bit IEEE 754",
    BFLOAT16: "FP: bfloat16",
    BINARY32: "FP: 32-bit IEEE 754",
    BINARY64: "FP: 64-bit IEEE 754",
}

_FILTER = '''\
#!/usr/bin/env python3
"""Shows words as numbers: reads one in hexadecimal from each line, and answers with a line."""

import sys

EXPONENT, FRACTION, DIGITS = {exponent}, {fraction}, {digits}
LARGEST = (1 << EXPONENT) - 1


def show(word):
    sign = "-" if word >> EXPONENT + FRACTION & 1 else ""
    exponent, fraction = word >> FRACTION & LARGEST, word & (1 << FRACTION) - 1
    if exponent == LARGEST:
        return "NaN" if fraction else sign + "inf"
    if exponent == 0:  # what is subnormal is read as zero
        return sign + "0"
    number = (1 + fraction / (1 << FRACTION)) * 2.0 ** (exponent - LARGEST // 2)
    return f"{{sign}}{{number:.{{DIGITS}}g}}"


for line in sys.stdin:
    try:
        print(show(int(line, 16)), flush=True)
    except ValueError:  # a bit is unknown
        print(line.strip(), flush=True)
'''


@dataclass(frozen=True)
class Signal:
    """A signal, or a word of an array.

    Parameters
    ----------
    label
        Name to show.
    scope, name
        Instance, from the top on, and name of the signal or array in it.
    width
        Bits.
    shown
        As what: `PLAIN`, `NUMBER`, or a table of :attr:`Signals.names`.
    index
        Word of an array; None if it is none.
    row
        Row that it is an element of, or nothing.
    """

    label: str
    scope: str
    name: str
    width: int = 1
    shown: str = PLAIN
    index: int | None = None
    row: str = ""


@dataclass(frozen=True)
class Group:
    """Signals under a heading.

    Parameters
    ----------
    name
        Heading.
    signals
        Signals.
    closed
        Whether they are to be hidden at first.
    """

    name: str
    signals: tuple[Signal, ...]
    closed: bool = False


def _table(names: Iterable[IntEnum]) -> dict[int, str]:
    return {each.value: each.name for each in names}


class Signals:
    """What to show of a core.

    Parameters
    ----------
    code
        Its programs, which say where everything is.

    Attributes
    ----------
    format : FloatFormat
        Format of the numbers.
    groups : list of Group
    names : dict of str to dict
        Tables of texts by value, for signals that have names for their values.
    """

    def __init__(self, code: Microcode) -> None:
        self._code = code
        self.format = code.params.format
        mnemonics, words = Mnemonics(code), sorted({0, *code.words})
        self.names: dict[str, Mapping[int, str]] = {
            "step": _table([Step.IDLE, *steps_of(code.params.models)]),
            "program": _table({routine.program for routine in code.programs}),
            "error": _table(ErrorCode),
            "reads": {word: mnemonics.reads(word) for word in words},
            "writes": {word: mnemonics.writes(word) for word in words},
        }  # fmt: skip
        self.groups = [*self._control(), *self._array(), *self._memory()]

    @property
    def words(self) -> list[str]:
        """Words of arrays that are shown, by their names in Verilog."""
        return [
            f"{signal.scope}.{signal.name}[{signal.index}]"
            for group in self.groups
            for signal in group.signals
            if signal.index is not None
        ]

    def _number(self, label: str, scope: str, name: str, index: int | None = None) -> Signal:
        return Signal(label, scope, name, self.format.width, NUMBER, index)

    def _control(self) -> Iterator[Group]:
        address = MemoryMap(self._code.params).address_width
        width = (len(self._code.params.sensor_rows) - 1).bit_length()
        steps = steps_of(self._code.params.models)
        programs = max(routine.program for routine in self._code.programs)
        sensor = [Signal("sensor", _CONTROL, "run__sensor", width)] if width else []
        yield Group("steps", (
            Signal("clock", _TOP, "aclk"),
            Signal("step", _CONTROL, "state", max(steps).bit_length(), "step"),
            Signal("program", _CONTROL, "run__program", programs.bit_length(), "program"),
            *sensor,
            Signal("start", _CONTROL, "run__start"),
            Signal("done", _CONTROL, "run__done"),
            Signal("error", _CONTROL, "error_code", 8, "error"),
            Signal("gated", _CONTROL, "gated"),
            Signal("bank of x", _CONTROL, "banks__state"),
            Signal("bank of L", _CONTROL, "banks__factor"),
            Signal("irq", _TOP, "irq"),
        ))  # fmt: skip
        bus = (
            ("awvalid", 1), ("awready", 1), ("awaddr", address), ("wvalid", 1), ("wready", 1),
            ("wdata", DATA_WIDTH), ("arvalid", 1), ("arready", 1), ("araddr", address),
            ("rvalid", 1), ("rready", 1), ("rdata", DATA_WIDTH),
        )  # fmt: skip
        signals = (Signal(name, _TOP, f"s_axi_{name}", width) for name, width in bus)
        yield Group("AXI4-Lite", tuple(signals), closed=True)

    def _array(self) -> Iterator[Group]:
        # The control word twice: as what it reads, and as what it writes.
        sequencer, width = f"{_ENGINE}.sequencer", self._code.format.width
        halves = (Signal(half, sequencer, "word", width, half) for half in ("reads", "writes"))
        numbers = {"scalar bus": "bus", "operand s": "scalar", "1/sqrt": "root", "NIS": "run__nis"}
        yield Group("program", (
            *halves,
            *(self._number(label, _ENGINE, name) for label, name in numbers.items()),
            Signal("writes pass", _ENGINE, "passed"),
        ))  # fmt: skip
        yield Group(
            "scalar file",
            tuple(
                self._number(f"s{k}", _ENGINE, "scalar_file", k) for k in range(self._code.scalars)
            ),
            closed=True,
        )
        for lane in range(self._code.params.pes):
            names = ("a", "b", "c", "product", "sum")
            scope = f"{_ENGINE}.lane_{lane}"
            yield Group(
                f"lane {lane}", tuple(self._number(name, scope, name) for name in names),
                closed=True,
            )  # fmt: skip

    def _memory(self) -> Iterator[Group]:
        """Vectors, those of a matrix together."""
        families: dict[str, list[Signal]] = {}
        for vector in self._code.layout.vectors:
            family = families.setdefault(vector.name.partition("[")[0], [])
            family += self._elements(vector)
        for name, signals in families.items():
            yield Group(name, tuple(signals), closed=True)

    def _elements(self, vector: Vector) -> Iterator[Signal]:
        layout = self._code.layout
        width = 8 * ceil(self.format.width / 8)  # whole bytes
        first, stop = (0, 1) if vector.broadcast else vector.columns
        for bank in range(2 if vector.bank != BANK_NONE else 1):
            copy = f" in bank {bank}" if vector.bank != BANK_NONE else ""
            for column in range(first, stop):
                (address, _), lane = vector.element(column)
                label = vector.name if vector.broadcast else f"{vector.name}[{column}]"
                yield Signal(
                    label + copy, f"{_ENGINE}.lane_{lane}", "memory_0", width, NUMBER,
                    address + bank * layout.bank_offset, vector.name + copy,
                )  # fmt: skip


def signal_lists(waves: Path) -> dict[str, Path]:
    """Give the lists beside a waveform, by viewer: GTKWave's save file, Surfer's commands."""
    return {"gtkwave": waves.with_suffix(".gtkw"), "surfer": waves.with_suffix(".sucl")}


def write_signal_lists(waves: Path, signals: Signals, simulator: Simulator) -> None:
    """Write the lists of signals beside a waveform.

    Parameters
    ----------
    waves
        The waveform; it need not exist yet.
    signals
        What to show.
    simulator
        Who writes it.
    """
    lists, tool = signal_lists(waves), simulator.tool.waves
    lists["gtkwave"].write_text(_gtkwave(waves, signals, tool), encoding="utf-8")
    lists["surfer"].write_text(_surfer(waves, signals, tool), encoding="utf-8")


def _path(signal: Signal, word: str) -> str:
    """Name of a signal; that of a word of an array is made after a pattern."""
    if signal.index is None:
        return f"{signal.scope}.{signal.name}"
    return f"{signal.scope}.{word.format(array=signal.name, index=signal.index)}"


def _gtkwave(waves: Path, signals: Signals, tool: Waves) -> str:
    """Text of the save file; writes the filters that it names."""
    with importing("sim"):
        from vcd.gtkw import GTKWSave

    # Without spaces: what follows one in the name of a filter is an argument to GTKWave.
    folder = waves.parent / f"{re.sub(r'[^0-9A-Za-z.-]', '_', waves.stem)}.gtkwave"
    folder.mkdir(exist_ok=True)
    for name, texts in signals.names.items():
        bits = next(s.width for g in signals.groups for s in g.signals if s.shown == name)
        lines = (f"{value:0{ceil(bits / 4)}x} {text}\n" for value, text in texts.items())
        (folder / f"{name}.txt").write_text("".join(lines), encoding="utf-8")
    number = folder / f"{NUMBER}.py"
    number.write_text(_number_filter(signals.format), encoding="utf-8")
    number.chmod(0o755)

    text = StringIO()
    save = GTKWSave(text)
    save.dumpfile(waves.name, abspath=False)
    save.sst_expanded(False)
    save.signals_width(300)
    for group in signals.groups:
        with save.group(group.name, closed=group.closed):
            for signal in group.signals:
                path = _path(signal, tool.gtkwave_word)
                if signal.width > 1:
                    path += f"[{signal.width - 1}:0]"
                named = (
                    f"{folder.name}/{signal.shown}.txt" if signal.shown in signals.names else None
                )
                process = f"./{folder.name}/{number.name}" if signal.shown == NUMBER else None
                save.trace(
                    path, signal.label, translate_filter_file=named, translate_filter_proc=process
                )
    return text.getvalue()


def _number_filter(fmt: FloatFormat) -> str:
    """Text of the program that shows words of a format as numbers."""
    return _FILTER.format(
        exponent=fmt.exponent_bits,
        fraction=fmt.fraction_bits,
        digits=min(ceil(fmt.precision * log10(2.0)), 8),
    )


def _surfer(waves: Path, signals: Signals, tool: Waves) -> str:
    """Text of the commands; writes the tables that they name, where Surfer looks for them."""
    folder = waves.parent / ".surfer" / "mappings"
    folder.mkdir(parents=True, exist_ok=True)
    shown = {PLAIN: "", NUMBER: _SURFER_FORMATS.get(signals.format, "Hexadecimal")}
    for name, texts in signals.names.items():
        bits = next(s.width for g in signals.groups for s in g.signals if s.shown == name)
        # Named by its file, and as wide as its values.
        shown[name] = f"{waves.stem}-{name}"
        lines = (f"0b{value:0{bits}b} {text}\n" for value, text in texts.items())
        (folder / f"{shown[name]}.txt").write_text("".join(lines), encoding="utf-8")
    commands = [f"load_file {waves.name}"]
    heading = ""
    for group in signals.groups:
        for signal in group.signals:
            # It cannot be told names of its own, so rows have headings.
            if (signal.row or group.name) != heading:
                heading = signal.row or group.name
                # One word: its parser takes no other.
                word = re.sub(r"\W+", "_", heading).strip("_")
                commands.append(f"divider_add {word}")
            commands.append(f"variable_add {_path(signal, tool.surfer_word)}")
            if shown[signal.shown]:
                commands.append(f"item_set_format {shown[signal.shown]}")
    return "\n".join([*commands, "zoom_fit", ""])
