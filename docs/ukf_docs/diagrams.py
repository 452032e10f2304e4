"""Diagrams of the documents: pictures that README, pages and site share.

What has numbers is drawn from the layout, the schedule and the parameters of real cores.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ukf_docs import DOCS
from ukf_docs.drawing import Drawing
from ukf_sw.engine.disassembler import disassemble
from ukf_sw.engine.layout import BANK_NONE, Layout, Vector
from ukf_sw.engine.microcode import microcode
from ukf_sw.engine.operations import Kind
from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.parameters import Noise, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program

__all__ = ["DIAGRAMS", "FOLDER", "bus_words", "draw"]

FOLDER = DOCS / "figures" / "diagrams"

SOFTWARE, CORE, ARRAY, SOFT = "#fdf1de", "#e3eefb", "#cfe3f9", "#f2f4f6"
#: Colours of groups of columns, of vectors, of kinds of operations.
PALETTE = ("#f6c98b", "#9cc7ee", "#f4a6a0", "#b6dca8", "#d3c2ea", "#e3e3e3")

#: A core that has every group of columns, small enough to be drawn.
SMALL = UkfParams(
    n=3, m=2, q=3, r=2, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE, pes=4
)
#: The core of what has numbers.
NANOSAT_10 = replace(NANOSAT, pes=10)
#: The core of the listing in docs/inside.md.
TINY = UkfParams(n=2, m=1, pes=2)


def _overview() -> Drawing:
    """Software and core."""
    d = Drawing("Software drives the core over AXI4-Lite; what is in the core", 720, 300)
    d.box(10, 10, 160, 280, "software", "Python or C", fill=SOFTWARE, heading=True)
    models = d.box(25, 62, 130, 58, "*your models*", "f(x, w, u), h(x, v)", size=12)
    filter_ = d.box(25, 152, 130, 36, "filter")
    driver = d.box(25, 220, 130, 36, "driver")
    d.arrow(models.bottom(), filter_.top(), both=True)
    d.arrow(filter_.bottom(), driver.top(), both=True)
    d.box(265, 10, 445, 280, "core", "generated Verilog", fill=CORE, heading=True)
    registers = d.box(280, 62, 110, 58, "registers,", "step sequence")
    buffer = d.box(280, 198, 110, 60, "buffer:", "x, P, X, Z, z")
    sequencer = d.box(460, 62, 110, 58, "sequencer", "with programs")
    array = d.box(425, 178, 180, 100, "*P identical*", "*processing elements*",
                  "memory, multiplier,", "adder", fill=ARRAY)  # fmt: skip
    root = d.box(638, 198, 62, 60, "1/sqrt,", "scalars")
    bus = 215
    d.arrow(driver.right(0.3), (bus, driver.right(0.3)[1]), (bus, 91), registers.left(),
            both=True, label=("AXI4-Lite,", "irq"), at=(222, 60))  # fmt: skip
    d.arrow(driver.right(0.7), (280, driver.right(0.7)[1]), both=True,
            label=("32 bits",), at=(bus + 2, 262))  # fmt: skip
    d.arrow(registers.right(), sequencer.left())
    d.arrow(sequencer.bottom(), array.top(), label=("a control word", "a clock"), at=(525, 142),
            anchor="start")  # fmt: skip
    d.arrow(buffer.right(), array.left(), both=True)
    d.arrow(array.right(), root.left(), both=True, label=("scalar bus",), at=(655, 186))
    return d


def _layers() -> Drawing:
    """Folders, and what imports what."""
    d = Drawing("Folders of the source; arrows go to what imports", 720, 424)
    d.box(10, 10, 700, 186, "sw/ukf_sw: plain Python", fill=SOFTWARE, heading=True)
    spec = d.box(25, 42, 200, 60, "*spec*", "parameters, registers, formats,",
                 "memory map, step sequence", size=11)  # fmt: skip
    engine = d.box(260, 42, 190, 60, "*engine*", "layout, programs, scheduler,",
                   "checker, interpreter", size=11)  # fmt: skip
    golden = d.box(485, 42, 205, 60, "*golden*", "the core, seen from its bus", size=11)
    drivers = d.box(25, 130, 200, 50, "*drivers*", "driver; buses: UIO, PYNQ", size=11)
    filter_ = d.box(260, 130, 190, 50, "*filter, models, reference*", size=11)
    problems = d.box(485, 130, 205, 50, "*problems*", "scenarios, catalogue, judging", size=11)
    for before, after in ((spec, engine), (engine, golden), (drivers, filter_),
                          (filter_, problems)):  # fmt: skip
        d.arrow(before.right(), after.left())
    d.arrow(spec.bottom(), drivers.top())
    d.arrow(golden.bottom(), (golden.bottom()[0], 116), (filter_.top()[0], 116), filter_.top())
    d.box(10, 220, 700, 94, "hdl/ukf_hdl: Amaranth", fill=CORE, heading=True)
    names = (("arithmetic", "adder, multiplier, 1/sqrt"), ("core", "bus, control, buffer, array"),
             ("generate, interfaces", "Verilog, headers, SVD"), ("packaging", "boards, Vivado"))  # fmt: skip
    hdl = [
        d.box(25 + 173 * k, 250, 146, 50, f"*{name}*", says, size=11)
        for k, (name, says) in enumerate(names)
    ]
    for before, after in zip(hdl, hdl[1:], strict=False):
        d.arrow(before.right(), after.left())
    d.arrow((360, 196), (360, 220))
    names = (("sim/ukf_sim", "co-simulation,", "C in the loop"),
             ("tools/ukf_tools", "command line,", "estimates, reports"),
             ("docs/ukf_docs", "tables and diagrams", "of these pages"),
             ("tests", "of all of it"))  # fmt: skip
    above = [
        d.box(25 + 173 * k, 344, 146, 66, f"*{name}*", *says, size=11, fill=SOFT)
        for k, (name, *says) in enumerate(names)
    ]
    for before, after in zip(above, above[1:], strict=False):
        d.arrow(before.right(), after.left())
    d.arrow((above[0].top()[0], 314), above[0].top())
    return d


def _array() -> Drawing:
    """Lanes, scalar bus and what is on it."""
    d = Drawing("A lane of the array, and the scalar bus that all lanes share", 720, 330)
    for shift in (12, 6):
        d.box(20 + shift, 50 - shift, 420, 180, fill=SOFT)
    d.box(20, 50, 420, 180, fill=ARRAY)
    d.text(116, 66, "*one of P identical lanes*", anchor="start")
    memory = d.box(40, 92, 130, 120, "*memory*", "two reads and", "one write a clock")
    times = d.box(250, 100, 44, 44, "*×*", size=18, radius=22)
    plus = d.box(360, 130, 44, 44, "*±*", size=18, radius=22)
    d.arrow(memory.right(0.25), times.left(), label=("a, b",))
    d.arrow(times.right(), (382, times.right()[1]), plus.top())
    d.arrow(memory.right(0.5), plus.left(),
            label=("c",), at=(200, 162))  # fmt: skip
    d.arrow(plus.bottom(), (382, 197), memory.right(0.875), label=("result",), at=(276, 187))
    bus = d.box(600, 38, 34, 262, fill=PALETTE[0])
    d.text(617, 60, *"scalar bus".replace(" ", " ").upper(), size=11)
    d.arrow(plus.right(), (600, plus.right()[1]), label=("sum of all lanes (DOT)", "or last lane"),
            at=(532, 122))  # fmt: skip
    file = d.box(480, 190, 90, 40, "scalar file", size=12)
    d.arrow((600, 210), file.right())
    d.arrow(file.left(), (460, 210), (460, 80), (272, 80), times.top(),
            label=("s, in the place of a",), at=(368, 70))  # fmt: skip
    root = d.box(480, 248, 90, 34, "1/sqrt", size=12)
    d.arrow((600, 265), root.right())
    d.arrow(root.left(), (130, 265), (130, 212), label=("into all lanes of a word",), at=(290, 256))
    d.arrow((600, 294), (60, 294), (60, 212), label=("into one lane",), at=(290, 305))
    d.arrow((105, 92), (105, 20), (617, 20), bus.top(), label=("LOAD: one lane of a word",),
            at=(300, 29))  # fmt: skip
    return d


def _columns() -> Drawing:
    """Columns of the rows of residuals, with the lane and the beat of each."""
    layout, pes = Layout(SMALL), SMALL.pes
    beats = -(-layout.columns // pes)
    cell, left, top = 38, 96, 66
    d = Drawing("Columns of the rows of residuals, and where each lies", left + beats * pes * cell + 14,
                top + 5 * 30 + 78)  # fmt: skip
    for beat in range(beats):
        x = left + beat * pes * cell
        d.box(x, 12, pes * cell - 4, 20, f"beat {beat}", size=11, fill=SOFT)
        for lane in range(pes):
            d.text(x + (lane + 0.5) * cell - 2, 45, f"PE {lane}", size=10, fill="#5b6b7c")
    d.text(left - 8, 22, "word", size=11, anchor="end")
    d.text(left - 8, 45, "lane", size=11, anchor="end")
    colours = dict(zip(layout.spans, PALETTE, strict=False))
    for number, vector in enumerate([*layout.Ez, *layout.Ex]):
        y = top + 30 * number
        d.text(left - 8, y + 13, vector.name, anchor="end")
        for name, (start, stop) in layout.spans.items():
            for column in range(max(start, vector.columns[0]), min(stop, vector.columns[1])):
                d.box(left + column * cell, y, cell - 4, 26, str(column), size=11,
                      fill=colours[name], radius=2)  # fmt: skip
    y = top + 5 * 30 + 14
    for number, (name, colour) in enumerate(colours.items()):
        x, line = left + 250 * (number % 2), y + 26 * (number // 2)
        d.box(x, line, 18, 18, fill=colour, radius=2)
        d.text(x + 26, line + 9, name, anchor="start")
    return d


def _banks(vectors: list[Vector]) -> list[tuple[str, int, int, int]]:
    """Name, first address, words and bank of each run of vectors of a kind."""
    runs: list[tuple[str, int, int, int]] = []
    for vector in vectors:
        name = vector.name.partition("[")[0]
        if name not in VECTORS:
            name = "constants"
        known = runs[-1] if runs else None
        if known and known[0] == name and known[1] + known[2] == vector.address:
            runs[-1] = (name, known[1], known[2] + vector.beats, vector.bank)
        else:
            runs.append((name, vector.address, vector.beats, vector.bank))
    return runs


#: Meaning of the vectors in the memory of a lane.
VECTORS = {
    "x": "state estimate, two copies",
    "L": "its factor, two copies",
    "X": "sigma points of the state",
    "W": "of the process noise",
    "V": "of the observation noise",
    "Z": "of the observation, and z",
    "P": "covariance, when asked for",
    "LQ": "factor of Q",
    "LR": "factor of R",
    "F": "working copy of L",
    "Ex": "residuals of the prediction",
    "Ez": "residuals of the observation",
    "Az": "joint covariance, observation rows",
    "Ax": "joint covariance, state rows",
    "G": "state rows in elimination",
    "root": "1/sqrt of each pivot",
    "constants": "weights, sigma coefficients",
}


def _memory() -> Drawing:
    """Memory of a lane, by address."""
    layout = Layout(NANOSAT_10)
    runs = _banks(layout.vectors)
    runs += [(name, start + layout.bank_offset, words, bank)
             for name, start, words, bank in runs if bank != BANK_NONE]  # fmt: skip
    names = list(dict.fromkeys(name for name, *_ in runs))
    colours = {name: PALETTE[k % len(PALETTE)] for k, name in enumerate(names)}
    rows, width, height, left, top = 4, 640, 46, 64, 34
    per_row = layout.depth // rows
    d = Drawing(f"Memory of each of {NANOSAT_10.pes} lanes of nanosat's core, by address",
                left + width + 16, top + rows * (height + 8) + 18 + 24 * -(-len(names) // 2))  # fmt: skip
    d.text(left, 18, f"{layout.depth} words in each lane; the copies differ in the top address bit",
           anchor="start")  # fmt: skip
    for row in range(rows):
        y = top + row * (height + 8)
        d.text(left - 8, y + height / 2, str(row * per_row), size=11, anchor="end")
        d.box(left, y, width, height, fill=SOFT, stroke="#c4ccd4", radius=0)
        for name, start, words, _ in runs:
            low, high = max(start, row * per_row), min(start + words, (row + 1) * per_row)
            if low < high:
                x = left + (low - row * per_row) * width / per_row
                span = (high - low) * width / per_row
                fits = span >= 9 * len(name) + 1
                d.box(x, y, span, height, *((name,) if fits else ()), size=12, radius=0,
                      fill=colours[name])  # fmt: skip
    for number, name in enumerate(names):
        x, y = left + 300 * (number % 2), top + rows * (height + 8) + 10 + 24 * (number // 2)
        d.box(x, y, 16, 16, fill=colours[name], radius=2)
        d.text(x + 24, y + 8, f"{name}: {VECTORS[name]}", anchor="start")
    return d


def bus_words(params: UkfParams) -> dict[str, int]:
    """Give the words that an iteration of read estimates moves, by what they are."""
    n, m, points = params.n, params.m, params.N
    return {"X of SIG_GEN": n * (n + 2), "X": n * points, "Z, z": m * (points + 1), "x": n}


def _iteration() -> Drawing:
    """Who does what in an iteration, and what goes over the bus."""
    code, words = microcode(NANOSAT_10, Pipeline()), bus_words(NANOSAT_10)
    d = Drawing("An iteration: software, bus and core in turn", 720, 412)
    d.box(10, 10, 230, 392, "software", fill=SOFTWARE, heading=True)
    d.box(480, 10, 230, 392, "core", fill=CORE, heading=True)
    software = [
        d.box(25, y, 200, height, *lines, size=12)
        for y, height, lines in (
            (86, 54, ("*f* at every sigma point", "with w and the input u")),
            (196, 54, ("*h* at every sigma point", "with v; and the measurement z")),
            (346, 40, ("the estimate",)),
        )
    ]
    predict, update = code.clocks(Program.PREDICT), code.clocks(Program.UPDATE)
    core = [
        d.box(495, y, 200, height, *lines, size=12, fill=ARRAY)
        for y, height, lines in (
            (42, 40, ("*SIG_GEN*", "or the UPDATE before")),
            (146, 46, (f"*PREDICT*, {predict} clocks", "x = mean of X, residuals Ex")),
            (264, 72, (f"*UPDATE*, {update} clocks", "mean of Z, residuals Ez,",
                       "elimination: x, L,", "next sigma points")),
        )
    ]  # fmt: skip
    bus = [f"{label}: {words[key]} words" for key, label in (
        ("X of SIG_GEN", f"X, {NANOSAT_10.n + 2} columns"), ("X", f"X, {NANOSAT_10.N} columns"),
        ("Z, z", "Z and z"), ("x", "x"))]  # fmt: skip
    for start, end, label in (
        (core[0].left(), software[0].right(0.3), bus[0]),
        (software[0].right(0.8), core[1].left(), bus[1]),
        (software[1].right(0.8), core[2].left(0.3), bus[2]),
        (core[2].left(0.8), software[2].right(), bus[3]),
    ):
        middle = (start[1] + end[1]) / 2
        d.arrow(start, (360, start[1]), (360, end[1]), end)
        d.box(284, middle - 10, 152, 20, label, size=11, stroke="none")
    d.arrow(software[0].bottom(), software[1].top())
    d.arrow(core[1].bottom(), core[2].top())
    return d


def _schedule() -> Drawing:
    """Operations of an UPDATE over the clocks."""
    code = microcode(TINY, Pipeline())
    found = disassemble(code, Program.UPDATE)
    end = max(instruction.root_clock or instruction.done for instruction in found) + 1
    row, left, top, width = 11, 14, 52, 692
    scale = width / end
    d = Drawing("Operations of an UPDATE over the clocks, from their reads to their results", 720,
                top + row * len(found) + 12)  # fmt: skip
    colours = dict(zip(Kind, PALETTE, strict=False))
    for number, (kind, colour) in enumerate(colours.items()):
        d.box(left + 112 * number, 6, 16, 16, fill=colour, radius=2)
        d.text(left + 112 * number + 22, 14, kind.name, size=11, anchor="start")
    d.box(left + 560, 6, 16, 16, fill="#4d4d4d", radius=2)
    d.text(left + 582, 14, "1/sqrt", size=11, anchor="start")
    for clock in range(0, end, 10):
        x = left + clock * scale
        d.text(x, 36, str(clock), size=10, fill="#5b6b7c")
        d.box(x, 44, 0.5, row * len(found) + 8, stroke="#d5dbe1", radius=0)
    for number, found_one in enumerate(found):
        y = top + row * number
        start, done = found_one.clocks[0], found_one.done + 1
        d.box(left + start * scale, y, (done - start) * scale, row - 2, radius=1,
              fill=colours[found_one.kind])  # fmt: skip
        if found_one.root_clock is not None:
            d.box(left + done * scale, y, (found_one.root_clock + 1 - done) * scale, row - 2,
                  radius=1, fill="#4d4d4d")  # fmt: skip
    return d


#: Functions that draw, by the name of the file.
DIAGRAMS: dict[str, Callable[[], Drawing]] = {
    "overview": _overview,
    "layers": _layers,
    "array": _array,
    "columns": _columns,
    "memory": _memory,
    "iteration": _iteration,
    "schedule": _schedule,
}


def draw(folder: Path) -> list[Path]:
    """Draw all diagrams into a folder; gives the files that changed."""
    folder.mkdir(parents=True, exist_ok=True)
    changed: list[Path] = []
    for name, make in DIAGRAMS.items():
        file, text = folder / f"{name}.svg", make().svg()
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")
            changed.append(file)
    return changed
