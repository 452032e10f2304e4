"""Diagrams of the documents: pictures that README, pages and site share.

What has numbers is drawn from the layout, the schedule and the parameters of real cores.
"""

from collections.abc import Callable, Mapping
from colorsys import hls_to_rgb
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from ukf_docs import DOCS
from ukf_docs.drawing import DIM, PAPER, Box, Drawing
from ukf_sw.engine.disassembler import disassemble
from ukf_sw.engine.layout import BANK_NONE, Layout
from ukf_sw.engine.microcode import microcode
from ukf_sw.engine.operations import Kind
from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.parameters import Noise, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine
from ukf_tools.estimate.occupancy import tracks
from ukf_tools.estimate.parts import Part, parts, runs

__all__ = ["DIAGRAMS", "FOLDER", "bus_words", "draw"]

FOLDER = DOCS / "figures" / "diagrams"

SOFTWARE, CORE, ARRAY, SOFT = "#fdf1de", "#e3eefb", "#cfe3f9", "#f2f4f6"
#: Colours of groups of columns, of vectors, of kinds of operations.
PALETTE = ("#f6c98b", "#9cc7ee", "#f4a6a0", "#b6dca8", "#d3c2ea", "#e3e3e3")
ROOT = "#4d4d4d"
#: Colours of the parts of a program that are no row of the elimination.
OTHERS = ("#4d4d4d", "#a0522d", "#d98cc0", "#8f6bb3", "#a9b4be")
#: Width of the diagrams in pixels: their text can be read on a phone.
WIDTH = 560

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
    d = Drawing("Software drives the core over AXI4-Lite; what is in the core", WIDTH, 290)
    d.box(8, 8, 136, 274, "software", "Python or C", fill=SOFTWARE, heading=True)
    models = d.box(18, 54, 116, 60, "*your models*", "f(x, w, u), h(x, v)")
    filter_ = d.box(18, 146, 116, 36, "filter")
    driver = d.box(18, 214, 116, 36, "driver")
    d.arrow(models.bottom(), filter_.top(), both=True)
    d.arrow(filter_.bottom(), driver.top(), both=True)
    d.box(214, 8, 338, 274, "core", "generated Verilog", fill=CORE, heading=True)
    registers = d.box(224, 54, 106, 60, "registers,", "step sequence")
    buffer = d.box(224, 194, 90, 60, "buffer:", "x, P, X, Z, z")
    sequencer = d.box(370, 54, 106, 60, "sequencer", "with programs")
    array = d.box(348, 172, 112, 104, "*P identical*", "*processing*", "*elements*", "memory, ×, ±",
                  fill=ARRAY)  # fmt: skip
    root = d.box(492, 194, 52, 60, "1/sqrt,", "scalars")
    d.arrow(driver.right(0.3), (180, driver.right(0.3)[1]), (180, 84), registers.left(), both=True,
            label=("AXI4-Lite,", "irq"), at=(180, 54))  # fmt: skip
    d.arrow(driver.right(0.7), (224, driver.right(0.7)[1]), both=True, label=("32 bits",),
            at=(180, 254))  # fmt: skip
    d.arrow(registers.right(), sequencer.left())
    d.arrow((423, 114), (423, 172), label=("a control word", "a clock"), at=(430, 136),
            anchor="start")  # fmt: skip
    d.arrow(buffer.right(), array.left(), both=True)
    d.arrow(array.right(), root.left(), both=True, label=("scalar bus",), at=(518, 182))
    return d


def _layers() -> Drawing:
    """Folders, and what imports what."""
    d = Drawing("Folders of the source; arrows go to what imports", WIDTH, 500)

    def row(y: float, height: float, *boxes: tuple[str, ...], fill: str = PAPER) -> list[Box]:
        """Draw boxes in a row."""
        step = (WIDTH - 28) / len(boxes)
        return [
            d.box(20 + step * k, y, step - 22, height, f"*{name}*", *says, size=12, fill=fill)
            for k, (name, *says) in enumerate(boxes)
        ]

    def chain(boxes: list[Box]) -> None:
        """Draw arrows from each to the next."""
        for before, after in pairwise(boxes):
            d.arrow(before.right(), after.left())

    d.box(8, 8, WIDTH - 16, 212, "sw/ukf_sw: plain Python", fill=SOFTWARE, heading=True)
    first = row(36, 76, ("spec", "parameters, formats,", "registers,", "memory map, steps"),
                ("engine", "layout, programs,", "scheduler, checker,", "interpreter"),
                ("golden", "the core,", "seen from its bus"))  # fmt: skip
    second = row(142, 66, ("drivers", "driver;", "buses: UIO, PYNQ"),
                 ("filter", "models, reference"),
                 ("problems", "applications,", "runs, judging"))  # fmt: skip
    chain(first)
    chain(second)
    d.arrow(first[0].bottom(), second[0].top())
    (right, _), (middle, _) = first[2].bottom(), second[1].top()
    d.arrow(first[2].bottom(), (right, 127), (middle, 127), second[1].top())
    d.box(8, 244, WIDTH - 16, 112, "hdl/ukf_hdl: Amaranth", fill=CORE, heading=True)
    hdl = row(270, 74, ("arithmetic", "adder,", "multiplier,", "1/sqrt"),
              ("core", "bus, control,", "buffer, array"), ("generate", "Verilog,", "headers, SVD"),
              ("packaging", "boards,", "Vivado"))  # fmt: skip
    chain(hdl)
    d.arrow((WIDTH / 2, 220), (WIDTH / 2, 244))
    above = row(394, 84, ("sim/ukf_sim", "co-simulation,", "C in the loop"),
                ("tools/ukf_tools", "command line,", "estimates,", "reports"),
                ("docs/ukf_docs", "tables and", "diagrams of", "these pages"), ("tests",),
                fill=SOFT)  # fmt: skip
    chain(above)
    d.arrow((above[0].top()[0], 356), above[0].top())
    return d


def _array() -> Drawing:
    """Lanes, scalar bus and what is on it."""
    d = Drawing("A lane of the array, and the scalar bus that all lanes share", WIDTH, 330)
    for shift, fill in ((12, SOFT), (6, SOFT), (0, ARRAY)):
        d.box(14 + shift, 50 - shift, 310, 186, fill=fill)
    d.text(94, 64, "*one of P identical lanes*", anchor="start", size=13)
    memory = d.box(26, 96, 104, 120, "*memory*", "two reads and", "one write", "a clock")
    times = d.box(184, 104, 44, 44, "*×*", size=18, radius=22)
    plus = d.box(262, 134, 44, 44, "*±*", size=18, radius=22)
    d.arrow(memory.right(0.25), times.left(), label=("a, b",))
    d.arrow(times.right(), (284, times.right()[1]), plus.top())
    d.arrow(memory.right(0.5), plus.left(), label=("c",), at=(156, 166))
    d.arrow(plus.bottom(), (284, 201), memory.right(0.875), label=("result",), at=(206, 191))
    bus = d.box(510, 36, 40, 280, fill=PALETTE[0])
    d.text(530, 64, *"SCALAR BUS")
    d.arrow(plus.right(), (510, plus.right()[1]), at=(430, 122),
            label=("DOT: sum of all lanes", "SCALE: last lane"))  # fmt: skip
    file = d.box(396, 196, 86, 40, "scalar file")
    d.arrow((510, 216), file.right())
    d.arrow(file.left(), (356, 216), (356, 88), (206, 88), times.top(),
            label=("s, instead of a",), at=(262, 79))  # fmt: skip
    root = d.box(396, 258, 86, 34, "1/sqrt")
    d.arrow((510, 275), root.right())
    d.arrow(root.left(), (112, 275), (112, 216), label=("into all lanes of a word",), at=(240, 265))
    d.arrow((510, 306), (50, 306), (50, 216), label=("into one lane",), at=(240, 317))
    d.arrow((80, 96), (80, 20), (530, 20), bus.top(), label=("LOAD: one lane of a word",),
            at=(250, 11))  # fmt: skip
    return d


def _legend(d: Drawing, left: float, top: float, columns: int, colours: Mapping[str, str]) -> None:
    """Say what colours mean, in columns."""
    for number, (name, colour) in enumerate(colours.items()):
        x = left + (WIDTH - left) / columns * (number % columns)
        y = top + 24 * (number // columns)
        d.box(x, y, 16, 16, fill=colour, radius=2)
        d.text(x + 23, y + 8, name, anchor="start")


def _columns() -> Drawing:
    """Columns of the rows of residuals, with the lane and the beat of each."""
    layout, pes = Layout(SMALL), SMALL.pes
    beats = -(-layout.columns // pes)
    cell, left, top = 40, 70, 66
    rows = [*layout.Ez, *layout.Ex]
    below = top + 30 * len(rows)
    d = Drawing("Columns of the rows of residuals, and where each lies", WIDTH, below + 78)
    for beat in range(beats):
        x = left + beat * pes * cell
        d.box(x, 12, pes * cell - 4, 20, f"beat {beat}", fill=SOFT)
        for lane in range(pes):
            d.text(x + (lane + 0.5) * cell - 2, 45, f"PE {lane}", size=11, fill=DIM)
    d.text(left - 8, 22, "word", anchor="end")
    d.text(left - 8, 45, "lane", anchor="end")
    colours = dict(zip(layout.spans, PALETTE, strict=False))
    for number, vector in enumerate(rows):
        y = top + 30 * number
        d.text(left - 8, y + 13, vector.name, anchor="end")
        for name, (start, stop) in layout.spans.items():
            for column in range(max(start, vector.columns[0]), min(stop, vector.columns[1])):
                d.box(left + column * cell, y, cell - 4, 26, str(column),
                      fill=colours[name], radius=2)  # fmt: skip
    _legend(d, left, below + 14, 2, colours)
    return d


def _runs(layout: Layout) -> list[tuple[str, int, int]]:
    """Name, first address and words of each run of vectors of a kind."""
    runs: list[tuple[str, int, int]] = []
    copies = [(vector.address + layout.bank_offset, vector) for vector in layout.vectors
              if vector.bank != BANK_NONE]  # fmt: skip
    for address, vector in [*((vector.address, vector) for vector in layout.vectors), *copies]:
        name = vector.name.partition("[")[0]
        name = name if name in VECTORS else "constants"
        if runs and runs[-1][0] == name and runs[-1][1] + runs[-1][2] == address:
            _, start, words = runs.pop()
            runs.append((name, start, words + vector.beats))
        else:
            runs.append((name, address, vector.beats))
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
    runs = _runs(layout)
    names = list(dict.fromkeys(name for name, *_ in runs))
    colours = {name: PALETTE[k % len(PALETTE)] for k, name in enumerate(names)}
    rows, width, height, left, top = 4, 500, 44, 48, 34
    per_row = layout.depth // rows
    d = Drawing(f"Memory of each of {NANOSAT_10.pes} lanes of nanosat's core, by address",
                WIDTH, top + rows * (height + 8) + 18 + 24 * -(-len(names) // 2))  # fmt: skip
    d.text(left, 18, f"{layout.depth} words in each lane; the copies differ in the top address bit",
           anchor="start")  # fmt: skip
    for row in range(rows):
        y = top + row * (height + 8)
        d.text(left - 8, y + height / 2, str(row * per_row), size=11, anchor="end")
        d.box(left, y, width, height, fill=SOFT, stroke="#c4ccd4", radius=0)
        for name, start, words in runs:
            low, high = max(start, row * per_row), min(start + words, (row + 1) * per_row)
            if low < high:
                x = left + (low - row * per_row) * width / per_row
                span = (high - low) * width / per_row
                fits = span >= 8 * len(name) - 1
                d.box(x, y, span, height, *((name,) if fits else ()), size=12, radius=0,
                      fill=colours[name])  # fmt: skip
    said = {f"{name}: {VECTORS[name]}": colour for name, colour in colours.items()}
    _legend(d, 14, top + rows * (height + 8) + 10, 2, said)
    return d


def bus_words(params: UkfParams) -> dict[str, int]:
    """Give the words that an iteration of read estimates moves, by what they are."""
    n, m, points = params.n, params.m, len(params.points)
    drawn = n + 2 - params.points.start
    return {"X of SIG_GEN": n * drawn, "X": n * points, "Z, z": m * (points + 1), "x": n}


def _iteration() -> Drawing:
    """Who does what in an iteration, and what goes over the bus."""
    code, words = microcode(NANOSAT_10, Pipeline()), bus_words(NANOSAT_10)
    d = Drawing("An iteration: software, bus and core in turn", WIDTH, 412)
    d.box(8, 8, 180, 396, "software", fill=SOFTWARE, heading=True)
    d.box(362, 8, 190, 396, "core", fill=CORE, heading=True)
    software = [
        d.box(18, y, 160, height, *lines, size=12)
        for y, height, lines in (
            (86, 54, ("*f* at every sigma point", "with w and the input u")),
            (196, 54, ("*h* at every sigma point", "with v; measurement z")),
            (346, 40, ("the estimate",)),
        )
    ]
    predict, update = code.clocks(Program.PREDICT), code.clocks(Program.UPDATE)
    core = [
        d.box(372, y, 170, height, *lines, size=12, fill=ARRAY)
        for y, height, lines in (
            (42, 40, ("*SIG_GEN*", "or the UPDATE before")),
            (146, 46, (f"*PREDICT*, {predict} clocks", "mean of X, residuals Ex")),
            (264, 72, (f"*UPDATE*, {update} clocks", "mean of Z, residuals Ez,",
                       "elimination: x, L,", "next sigma points")),
        )
    ]  # fmt: skip
    drawn, points = (words[key] // NANOSAT_10.n for key in ("X of SIG_GEN", "X"))
    bus = [(f"{label}:", f"{words[key]} words") for key, label in (
        ("X of SIG_GEN", f"X, {drawn} columns"), ("X", f"X, {points} columns"),
        ("Z, z", "Z and z"), ("x", "x"))]  # fmt: skip
    for start, end, label in (
        (core[0].left(), software[0].right(0.3), bus[0]),
        (software[0].right(0.8), core[1].left(), bus[1]),
        (software[1].right(0.8), core[2].left(0.3), bus[2]),
        (core[2].left(0.8), software[2].right(), bus[3]),
    ):
        middle = (start[1] + end[1]) / 2
        d.arrow(start, (275, start[1]), (275, end[1]), end)
        d.box(225, middle - 16, 100, 32, *label, size=12, stroke="none")
    d.arrow(software[0].bottom(), software[1].top())
    d.arrow(core[1].bottom(), core[2].top())
    return d


def _schedule() -> Drawing:
    """Operations of an UPDATE over the clocks."""
    code = microcode(TINY, Pipeline())
    found = disassemble(code, Program.UPDATE)
    end = max(instruction.root_clock or instruction.done for instruction in found) + 1
    row, left, top, width = 11, 14, 72, 532
    scale = width / end
    d = Drawing("Operations of an UPDATE over the clocks, from their reads to their results", WIDTH,
                top + row * len(found) + 12)  # fmt: skip
    colours = dict(zip(Kind, PALETTE, strict=False))
    named = {kind.name: colour for kind, colour in colours.items()}
    _legend(d, left, 6, 3, named | {"1/sqrt": ROOT})
    for clock in range(0, end, 10):
        x = left + clock * scale
        d.text(x, 57, str(clock), size=11, fill=DIM)
        d.box(x, 64, 0.5, row * len(found) + 8, stroke="#d5dbe1", radius=0)
    for number, one in enumerate(found):
        y = top + row * number
        start, done = one.clocks[0], one.done + 1
        d.box(left + start * scale, y, (done - start) * scale, row - 2, radius=1,
              fill=colours[one.kind])  # fmt: skip
        if one.root_clock is not None:
            d.box(left + done * scale, y, (one.root_clock + 1 - done) * scale, row - 2, radius=1,
                  fill=ROOT)  # fmt: skip
    return d


def _shade(number: int, of: int) -> str:
    """Colour of a row of the elimination: from blue over green and yellow to red."""
    red, green, blue = hls_to_rgb(0.62 * (1 - number / max(of - 1, 1)), 0.6, 0.75)
    return f"#{round(255 * red):02x}{round(255 * green):02x}{round(255 * blue):02x}"


def _occupancy() -> Drawing:
    """What takes the stages of the array in an UPDATE, clock by clock, in several bands."""
    code = microcode(NANOSAT_10, Pipeline())
    plan = code.programs[Routine(Program.UPDATE)].plan
    found = parts(plan.operations, code.layout)
    lines = tracks(plan)
    rows = sorted({part for part in found if part.row is not None}, key=lambda part: part.row or 0)
    others = [part for part in dict.fromkeys(found) if part.row is None]
    colours = {part: _shade(number, len(rows)) for number, part in enumerate(rows)}
    colours |= dict(zip(others, OTHERS, strict=True))

    bands, left, width, gap = 5, 72, 476, 4
    span = -(-plan.length // bands)
    heights = {name: 10 if len(each) == 1 else 4 * len(each) for name, each in lines.items()}
    step = sum(heights.values()) + gap * len(heights) + 24
    legend = 36 + bands * step
    d = Drawing(f"What an UPDATE of nanosat's core with {NANOSAT_10.pes} PEs takes, clock by clock",
                WIDTH, legend + 46 + 24 * -(-len(others) // 3))  # fmt: skip
    scale = width / span
    d.text(left, 16, "Clocks run from left to right, and on from band to band", anchor="start")
    bars: dict[Part, list[tuple[float, float, float, float]]] = {part: [] for part in colours}
    for band in range(bands):
        top, start = 36 + band * step, band * span
        for clock in range(-(-start // 20) * 20, start + span, 20):
            x = left + (clock - start) * scale
            d.box(x, top, 0.5, step - 24, stroke="#d5dbe1", radius=0)
            d.text(x, top + step - 16, str(clock), size=11, fill=DIM)
        y: float = top
        for name, each in lines.items():
            d.text(left - 8, y + heights[name] / 2, name, size=12, anchor="end")
            height = heights[name] / len(each)
            for number, line in enumerate(each):
                for run in runs(line, found):
                    low, high = max(run.first, start), min(run.first + run.clocks, start + span)
                    if low < high:
                        bars[run.part].append(
                            (left + (low - start) * scale, y + number * height,
                             (high - low) * scale, height - 0.5 * (len(each) > 1))
                        )  # fmt: skip
            y += heights[name] + gap
    for part, there in bars.items():
        d.bars(there, colours[part])
    d.text(14, legend + 10, "row", anchor="start")
    each = (width + 26) / len(rows)
    for number, part in enumerate(rows):
        d.box(46 + number * each, legend, each - 3, 20, str(part.row), fill=colours[part], radius=2)
    _legend(d, 14, legend + 34, 3, {part.name: colours[part] for part in others})
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
    "occupancy": _occupancy,
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
