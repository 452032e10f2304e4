"""Diagrams of the documents."""

import re
from xml.etree import ElementTree

import pytest

from ukf_docs.diagrams import DIAGRAMS, FOLDER, NANOSAT_10, SMALL, bus_words, draw
from ukf_docs.drawing import LINE, Drawing
from ukf_docs.studies import iteration
from ukf_sw.engine.layout import Layout
from ukf_sw.engine.microcode import microcode
from ukf_sw.spec.parameters import Pipeline
from ukf_sw.spec.sequence import Program, Routine
from ukf_tools.estimate.occupancy import tracks
from ukf_tools.estimate.parts import parts

SVG = "{http://www.w3.org/2000/svg}"


@pytest.mark.parametrize("name", DIAGRAMS)
def test_diagrams_are_current(name):
    """Run `make refresh` if this fails."""
    text = (FOLDER / f"{name}.svg").read_text(encoding="utf-8")
    assert DIAGRAMS[name]().svg() == text


def test_every_diagram_is_made_by_something():
    assert {file.stem for file in FOLDER.iterdir()} == set(DIAGRAMS)


@pytest.mark.parametrize("name", DIAGRAMS)
def test_diagrams_stand_alone_and_within_their_frame(name):
    root = ElementTree.fromstring(DIAGRAMS[name]().svg())
    width, height = float(root.attrib["width"]), float(root.attrib["height"])
    assert root.find(f"{SVG}title").text
    assert {element.tag for element in root.iter()} <= {
        SVG + tag for tag in ("svg", "title", "marker", "path", "rect", "text", "tspan", "polyline")
    }
    for box in root.iter(f"{SVG}rect"):
        x, y = float(box.get("x", 0)), float(box.get("y", 0))
        assert min(x, y) >= 0
        assert x + float(box.attrib["width"]) <= width
        assert y + float(box.attrib["height"]) <= height
    for line in root.iter(f"{SVG}polyline"):
        for point in line.attrib["points"].split():
            x, y = map(float, point.split(","))
            assert 0 <= x <= width
            assert 0 <= y <= height


def texts(drawing):
    """All lines of text of a drawing."""
    root = ElementTree.fromstring(drawing.svg())
    return ["".join(element.itertext()) for element in root.iter(f"{SVG}text")]


def test_columns_are_those_of_the_layout():
    layout = Layout(SMALL)
    assert len(layout.spans) == 4  # every group is there to be seen
    numbers = [int(text) for text in texts(DIAGRAMS["columns"]()) if text.isdecimal()]
    rows = [range(*vector.columns) for vector in (*layout.Ez, *layout.Ex)]
    assert sorted(numbers) == sorted(column for row in rows for column in row)
    for vector in layout.Ex:
        for column in range(*vector.columns):
            (address, _), lane = vector.element(column)
            assert (address - vector.address, lane) == divmod(column, SMALL.pes)


def test_memory_has_a_name_for_every_vector():
    shown = " ".join(texts(DIAGRAMS["memory"]()))
    assert f"{Layout(NANOSAT_10).depth} words in each lane" in shown
    root = ElementTree.fromstring(DIAGRAMS["memory"]().svg())
    boxes = [box for box in root.iter(f"{SVG}rect") if box.get("height") == "44"]
    filled = [box for box in boxes if box.attrib["stroke"] == LINE]
    used = sum(float(box.attrib["width"]) for box in filled) / sum(
        float(box.attrib["width"]) for box in boxes if box not in filled
    )
    assert used == pytest.approx(Layout(NANOSAT_10).used / Layout(NANOSAT_10).depth, rel=1e-4)
    for name in ("x", "L", "X", "W", "V", "Z", "P", "LQ", "LR", "F", "Ex", "Ez", "G", "root"):
        assert re.search(rf"\b{name}: ", shown)


def test_occupancy_has_every_clock_of_every_stage():
    """The areas of all bars, but the gaps between the lines of the tree, are the clocks taken."""
    root = ElementTree.fromstring(DIAGRAMS["occupancy"]().svg())
    shapes = [path.attrib["d"] for path in root.iter(f"{SVG}path") if "h-" in path.attrib["d"]]
    bars = [re.findall(r"M[\d.]+,[\d.]+h([\d.]+)v([\d.]+)h", shape) for shape in shapes]
    plan = microcode(NANOSAT_10, Pipeline()).programs[Routine(Program.UPDATE)].plan
    found = tracks(plan)
    clocks = sum(len(line) for lines in found.values() for line in lines if len(lines) == 1)
    of_tree = sum(len(line) for line in found["tree"])
    scale = 476 / -(-plan.length // 5)
    single = sum(float(width) for shape in bars for width, height in shape if height == "10")
    assert single == pytest.approx(clocks * scale, rel=1e-2)
    narrow = sum(float(width) for shape in bars for width, height in shape if height != "10")
    assert narrow == pytest.approx(of_tree * scale, rel=1e-2)
    shown = texts(DIAGRAMS["occupancy"]())
    assert [text for text in shown if text in found] == list(found) * 5
    for part in parts(plan.operations, Layout(NANOSAT_10)):
        assert part.name.removeprefix("row ") in shown
    assert len(shapes) == len(set(parts(plan.operations, Layout(NANOSAT_10))))


def test_words_are_those_that_the_driver_moves():
    found = iteration.load(iteration.STUDY.read())
    starts = 3  # of SIG_GEN, PREDICT and UPDATE
    assert sum(bus_words(NANOSAT_10).values()) + starts == found["nanosat"].words
    assert f"{bus_words(NANOSAT_10)['Z, z']} words" in texts(DIAGRAMS["iteration"]())


def test_only_what_changed_is_written(tmp_path):
    assert len(draw(tmp_path)) == len(DIAGRAMS)
    (tmp_path / "array.svg").write_text("old")
    assert draw(tmp_path) == [tmp_path / "array.svg"]


def test_text_is_escaped_and_partly_bold():
    drawing = Drawing("a < b", 90, 20)
    drawing.text(1, 2, "*f* & g")
    svg = drawing.svg()
    assert "<title>a &lt; b</title>" in svg
    assert '<tspan font-weight="bold">f</tspan> &amp; g</text>' in svg
