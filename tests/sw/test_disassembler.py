"""The disassembler: what it finds in the words is what the programs were made of."""

import random
from dataclasses import replace

import pytest

from support.model_cores import PROBLEMS, model_core
from support.random_cores import random_configuration
from ukf_sw.engine.disassembler import MARKS, DisassemblyError, disassemble
from ukf_sw.engine.microcode import Microcode, microcode
from ukf_sw.engine.mnemonics import Mnemonics, say_constant
from ukf_sw.engine.operations import Beat, Kind
from ukf_sw.engine.programs import build_program
from ukf_sw.spec.forms import Addend, Condition, Multiplier, Reading, Root, Sign
from ukf_sw.spec.forms import Form as SlotForm
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program


def marks_of(operation):
    """Marks of the result of an operation of the list."""
    rows = (operation.pivot, operation.coupling, operation.model_row)
    row = next((row for row in rows if row is not None), None)
    marks = {
        "row": row,
        "coupling": None if operation.coupling is None else 1,
        "innovation": 1 if operation.innovation else None,
        "nis": 1 if operation.is_nis else None,
        "of_model": None if operation.model_row is None else 1,
        "unchecked": 1 if operation.unchecked else None,
        "signed": 1 if operation.root_kind is Root.SIGNED else None,
    }
    assert set(marks) == set(MARKS)
    return {mark: value for mark, value in marks.items() if value is not None}


def expected(operation, issue, code, registers, places):
    """What the disassembler should say of an operation of the list."""
    done = issue + code.timing.result(operation)
    beats = tuple(
        Beat(*(places.get(word, word) for word in (beat.word_0, beat.word_1)), beat.lanes)
        for beat in operation.beats
    )
    return {
        "kind": operation.kind,
        "beats": beats,
        "clocks": tuple(issue + k * code.pipeline.add for k in range(len(operation.beats))),
        "scalar": registers.get(operation.scalar),
        "subtract": operation.subtract,
        "form": operation.form,
        "done": done,
        "destination": places.get(operation.destination, operation.destination),
        "lanes": operation.lanes,
        "register": registers.get(operation.result),
        "root": places.get(operation.root, operation.root),
        "root_lanes": operation.root_lanes,
        "root_clock": done + code.pipeline.reciprocal_sqrt if operation.root else None,
        "observation": operation.observation,
        "marks": marks_of(operation),
    }


def said(instruction):
    """What the disassembler says, as a dict."""
    return {name: getattr(instruction, name) for name in instruction.__slots__}


def check_programs(code):
    """Compare all programs with the lists that they were made of; gives the operations."""
    every = []
    for routine, (plan, registers, places, _) in code.programs.items():
        # The list is made anew; the schedule adds the clocks, and scalars and temporaries by their
        # places.
        operations = build_program(code.layout, *routine)
        assert len(operations) == len(plan.operations) == len(plan.issue)
        numbers = {}
        for own, planned in zip(operations, plan.operations, strict=True):
            if own.result is not None and planned.result in registers:
                numbers[own.result] = registers[planned.result]
        wanted = sorted(
            (expected(operation, issue, code, numbers, places)
             for operation, issue in zip(operations, plan.issue, strict=True)),
            key=lambda entry: entry["clocks"],
        )  # fmt: skip
        assert [said(entry) for entry in disassemble(code, *routine)] == wanted
        every += operations
    return every


@pytest.mark.parametrize(
    "seed", [*range(5), *(pytest.param(k, marks=pytest.mark.slow) for k in range(5, 40))]
)
def test_disassembly_is_the_operation_list(seed):
    """Every operation is found at its clock with its operands, and nothing else."""
    params, pipeline = random_configuration(random.Random(300 + seed))
    operations = check_programs(microcode(params, pipeline))
    kinds = {operation.kind for operation in operations}
    assert kinds == set(Kind) - {Kind.SLOT}  # that is for models


SLOW_CORES = {("gps-ins", 8), ("nanosat", 2), ("ctrv", 1)}
#: Problems, and numbers of PEs of which one divides the columns and one does not; the last is all.
MODEL_CORES = [
    pytest.param(name, pes, id=f"{name}-{pes}",
                 marks=[pytest.mark.slow] if (name, pes) in SLOW_CORES else [])
    for name, numbers in {"ctrv": (1, 3, 12), "battery": (1, 4, 11), "nanosat": (2, 10, 22),
                          "gps-ins": (8, 35)}.items()
    for pes in numbers
]  # fmt: skip


@pytest.mark.parametrize(("name", "pes"), MODEL_CORES)
def test_disassembly_of_models_is_the_operation_list(name, pes):
    code = microcode(model_core(name, pes=pes), Pipeline(add=3, reciprocal_sqrt=4))
    operations = check_programs(code)
    assert Kind.SLOT in {operation.kind for operation in operations}
    assert {operation.model_row for operation in operations} > set(range(code.params.m))


def test_operations_of_models_are_of_all_kinds():
    """Else the test above would not test much."""
    every = [
        operation
        for name in PROBLEMS
        for routine, (plan, *_) in microcode(
            model_core(name, pes=10), Pipeline(add=3, reciprocal_sqrt=4)
        ).programs.items()
        if routine.program in (Program.MODEL_F, Program.MODEL_H)
        for operation in plan.operations
    ]
    forms = [operation.form for operation in every if operation.form is not None]
    assert {form.condition for form in forms} >= {Condition.NEGATIVE, Condition.FINITE}
    assert {form.reading for form in forms} >= {Reading.NUMBER, Reading.ONE}
    assert {form.sign for form in forms} >= {Sign.KEEP, Sign.CLEAR, Sign.COPY}
    assert {form.addend for form in forms} >= {Addend.MINUS_ZERO, Addend.WORD, Addend.SCALAR}
    roots = [operation for operation in every if operation.root is not None]
    assert {operation.root_kind for operation in roots} == set(Root)
    assert {operation.root_lanes.bit_count() for operation in roots} >= {1}
    assert {operation.unchecked for operation in every} == {False, True}


@pytest.mark.parametrize("seed", range(10))
def test_registers_hold_the_operands(seed):
    """The register that an operation reads was written last by the one whose result it takes."""
    params, pipeline = random_configuration(random.Random(400 + seed))
    code = microcode(params, pipeline)
    for routine, (plan, *_) in code.programs.items():
        producer = {
            operation.result: issue + code.timing.result(operation)
            for operation, issue in zip(plan.operations, plan.issue, strict=True)
        }
        scalars = dict(zip(plan.issue, (op.scalar for op in plan.operations), strict=True))
        found = disassemble(code, *routine)
        written = sorted((i.done, i.register) for i in found if i.register is not None)
        for instruction in found:
            if instruction.scalar is not None:
                clock = instruction.clocks[0]
                latest = max(
                    done for done, register in written
                    if register == instruction.scalar and done < clock
                )  # fmt: skip
                assert latest == producer[scalars[clock]]


def check_bits(code, routine, clocks):
    """Turn every bit of words: another disassembly, or none. Gives how many of each."""
    words, right = code.words_of(*routine), disassemble(code, *routine)
    refused = changed = 0
    for clock in clocks:
        for bit in range(code.format.width):
            words[clock] ^= 1 << bit
            try:
                assert disassemble(code, *routine) != right, (routine, clock, bit)
                changed += 1
            except DisassemblyError:
                refused += 1
            words[clock] ^= 1 << bit
    assert disassemble(code, *routine) == right
    return refused, changed


@pytest.mark.parametrize("form", list(Form))
def test_no_bit_is_overlooked(form):
    """Words with one bit turned give another disassembly, or none."""
    params = UkfParams(n=2, m=2, q=1, r=2, observation_noise=Noise.ADDITIVE, pes=3, form=form)
    code = Microcode(params, Pipeline(add=3))
    refused = changed = 0
    for routine in code.programs:
        clocks = random.Random(1).sample(range(len(code.words_of(*routine))), 4)
        found = check_bits(code, routine, clocks)
        refused, changed = refused + found[0], changed + found[1]
    assert refused > 100
    assert changed > 100


def test_no_bit_of_models_is_overlooked():
    code = Microcode(model_core("ctrv", pes=12), Pipeline())
    assert {"exponent", "power"}.isdisjoint(code.format.fields)
    for routine in code.programs:
        if routine.program in (Program.MODEL_F, Program.MODEL_H):
            length = len(code.words_of(*routine))
            clocks = random.Random(2).sample(range(length), 2)
            refused, changed = check_bits(code, routine, [*clocks, length - 1])
            assert refused > 50
            assert changed > 10


def words_with(program, clock, **fields):
    """Tiny core, in one of whose programs a word has further fields."""
    code = Microcode(UkfParams(n=1, m=1), Pipeline())
    code.words_of(program)[clock] |= code.format.encode(fields)
    return code


@pytest.mark.parametrize(
    ("clock", "fields", "message"),
    [
        (0, {"first": 1}, "^first of clock 0 must belong to an operation, not be 1 for none$"),
        (4, {"address_0": 1}, r"^address_0 of clock 4 must be that of a vector, not \(1, 0\)$"),
        (4, {"dot": 1, "bank_state_0": 1}, "must be that of a vector"),
        (2, {"bus_source": 1}, "^bus_source of clock 2 must belong to an operation"),
        (0, {"bank_factor_1": 1}, "^bank_factor_1 of clock 0 must belong to an operation"),
    ],
)
def test_words_that_are_no_program(clock, fields, message):
    with pytest.raises(DisassemblyError, match=message):
        disassemble(words_with(Program.INIT, clock, **fields), Program.INIT)


def test_the_end_must_be_marked():
    code = words_with(Program.INIT, 0)
    words = code.words_of(Program.INIT)
    words[-1] ^= code.format.encode({"last": 1})
    with pytest.raises(DisassemblyError, match="must be marked as last"):
        disassemble(code, Program.INIT)


# Names.


@pytest.mark.parametrize("seed", range(6))
def test_every_word_has_its_name(seed):
    params, pipeline = random_configuration(random.Random(500 + seed))
    code = microcode(params, pipeline)
    layout, mnemonics = code.layout, Mnemonics(code)
    rows = {
        "L": layout.L, "X": layout.X, "W": layout.W, "V": layout.V, "Z": layout.Z, "P": layout.P,
        "LQ": layout.LQ, "LR": layout.LR, "F": layout.F, "Ex": layout.Ex, "Ez": layout.Ez,
        "Az": layout.Az, "Ax": layout.Ax, "G": layout.G,
    }  # fmt: skip
    vectors = [(f"{name}[{i}]", row) for name, group in rows.items() for i, row in enumerate(group)]
    for name, vector in [("x", layout.x), ("scale", layout.scale), *vectors]:
        for beat in range(vector.first, vector.first + vector.beats):
            for lane in range(params.pes):
                column = beat * params.pes + lane
                assert mnemonics.place(vector.word(beat), 1 << lane) == f"{name}[{column}]"
    for j, root in enumerate(layout.roots):
        assert mnemonics.place(root.word(0)) == f"root[{j}]"
    assert mnemonics.place(layout.one.word(0)) == "one"


def test_columns_are_said_as_runs():
    code = microcode(UkfParams(n=5, m=2, pes=6), Pipeline())
    mnemonics, word = Mnemonics(code), code.layout.X[3].word(1)
    assert mnemonics.place(word) == "X[3][6..11]"
    assert mnemonics.place(word, 0b101110) == "X[3][7..9,11]"
    assert mnemonics.place(code.layout.x.word(0), 0b1000, written=True) == "x'[3]"
    assert mnemonics.place(code.layout.L[2].word(0), 0b11, written=True) == "L'[2][0..1]"
    assert mnemonics.place(code.layout.L[2].word(0), 0b11) == "L[2][0..1]"


def texts(code, program):
    mnemonics = Mnemonics(code)
    return [line for entry in disassemble(code, program) for line in mnemonics.lines(entry)]


def test_listing_of_a_small_program():
    """INIT of one state: x and L pass over the bus, which checks them."""
    code = microcode(UkfParams(n=1, m=1), Pipeline())
    assert {line.text for line in texts(code, Program.INIT)} == {
        "LOAD     s0 = x[0]",
        "LOAD     s0 = L[0][0]",
    }


@pytest.mark.parametrize(("W0", "first"), [(0.0, "1"), (0.5, "0..1")])
def test_listing_of_an_update(W0, first):
    """One state, one observation without noise, on two lanes: sigma points are columns 0 to 2.

    Without W0 the right-hand side is in column 0; with W0 a third word has it.
    """
    params = UkfParams(n=1, m=1, pes=2, W0=W0, observation_noise=Noise.ADDITIVE)
    code = microcode(params, Pipeline())
    lines = texts(code, Program.UPDATE)
    found = "\n".join(line.text for line in lines)
    for text in (
        f"DOT      s0 = Z[0][{first}] . weights[{first}]",
        "            + Z[0][2] . weights[2]  (0 if z[0] masked)",
        "AXPY     Ez[0][0..1] = Z[0][0..1] - s0 * ones[0..1]  (0 if z[0] masked)",
        "MULTIPLY Ez[0][0..1] = Ez[0][0..1] * root[0]",
        "         root[0] = 1/sqrt of it",
        "  (pivot 0)",
        " * inverse_weight  (nis)",
        "SCALE    x'[0] = -s",
        "MULTIPLY L'[0][0] = F[0][0] * root_weight",
    ):
        assert text in found
    # A result that is due later than it is asked for.
    assert all(line.done is None or line.clock is None or line.done > line.clock for line in lines)


@pytest.mark.parametrize("form", list(Form))
@pytest.mark.parametrize("pes", [pytest.param(pes, marks=pytest.mark.slow) for pes in (4, 16, 32)])
def test_lines_are_short(form, pes):
    """The largest core in a listing of 100 columns, of which 13 are clocks."""
    params = UkfParams(
        n=32, m=32, q=32, r=32, process_noise=Noise.ADDITIVE, observation_noise=Noise.ADDITIVE,
        form=form, pes=pes,
    )  # fmt: skip
    code = microcode(params, Pipeline())
    longest = max(len(line.text) for line in texts(code, Program.UPDATE))
    assert 70 < longest <= 87


@pytest.mark.parametrize(
    ("form", "text", "where"),
    [
        (SlotForm(), "X[0][0..1] * X[1][0..1]", None),
        (SlotForm(addend=Addend.PLUS_ZERO), "0 + X[0][0..1] * X[1][0..1]", None),
        (SlotForm(addend=Addend.WORD), "X[0][0..1] + X[0][0..1] * X[1][0..1]", None),
        (SlotForm(subtract=True), "-X[0][0..1] * X[1][0..1]", None),
        (
            SlotForm(multiplier=Multiplier.SCALAR, addend=Addend.WORD, subtract=True),
            "X[0][0..1] - s3 * X[1][0..1]", None,
        ),
        (
            SlotForm(addend=Addend.SCALAR, reading=Reading.ONE, condition=Condition.NEGATIVE),
            "s3 + X[0][0..1]", "where X[1][0..1] is negative",
        ),
        (
            SlotForm(sign=Sign.CLEAR, reading=Reading.POWER, condition=Condition.FINITE),
            "X[0][0..1] * |power(X[1][0..1])|", "where that is finite",
        ),
        (
            SlotForm(sign=Sign.COPY, reading=Reading.EXPONENT, condition=Condition.ODD),
            "X[0][0..1] * |exponent(X[1][0..1])| * sign(X[0][0..1])", "where X[1][0..1] is odd",
        ),
        (
            SlotForm(multiplier=Multiplier.SCALAR, sign=Sign.COPY, reading=Reading.ONE),
            "s3 * sign(X[0][0..1])", None,
        ),
        (
            SlotForm(sign=Sign.BIT_1, condition=Condition.NOT_NEGATIVE),
            "X[0][0..1] * X[1][0..1] * (-1)^bit1(X[0][0..1])", "where X[1][0..1] is not negative",
        ),
    ],
)  # fmt: skip
def test_forms_are_written_down(form, text, where):
    code = microcode(UkfParams(n=2, m=1, pes=2), Pipeline())
    X, Z = code.layout.X, code.layout.Z
    word_0 = X[0].word(0) if form.uses_word_0 else None
    word_1 = X[1].word(0) if form.uses_word_1 else None
    instruction = replace(
        disassemble(code, Program.PREDICT)[0], kind=Kind.SLOT, form=form, marks={"unchecked": 1},
        beats=(Beat(word_0, word_1, 0b11),), clocks=(7,), scalar=3 if form.uses_scalar else None,
        destination=Z[0].word(0), lanes=0b11, register=None, root=None,
    )  # fmt: skip
    found = [line.text.strip() for line in Mnemonics(code).lines(instruction)]
    assert found == [f"SLOT     Z[0][0..1] = {text}", *([] if where is None else [where])]


def listed(name, program, **values):
    """Texts of the lines of a program of a problem's models."""
    code = microcode(model_core(name, **values), Pipeline())
    return code, [text.text.strip() for text in texts(code, program)]


def test_listing_of_models():
    """Inputs and constants have names and values, results their rows."""
    code, lines = listed("battery", Program.MODEL_F, pes=11)
    assert any(" = U[0][0]  (f: u)" in line for line in lines)
    for value in code.params.models.f.scalars:
        assert any(line.endswith(f"({say_constant(value)})") for line in lines), value
    for row in range(code.params.n):
        assert (
            sum(f"X[{row}][" in line and line.endswith(f"(row {row} of f)") for line in lines) == 1
        )
    _, lines = listed("battery", Program.MODEL_H, pes=11)
    assert any(line.startswith("SLOT     Z[0][") and "0 if z[0] masked" in line for line in lines)
    code, lines = listed("ctrv", Program.MODEL_F, pes=12)
    assert any(" = signed 1/sqrt of it" in line for line in lines)
    assert any(line.startswith("where ") for line in lines)
    (middle,) = {value for value in code.params.models.f.words if value > 1e6}
    assert any(f"= {say_constant(middle)} + s" in line for line in lines)


def test_temporaries_have_the_names_of_their_words():
    """All but a few lanes of vectors are lent; what they do not hold is in words of its own."""
    code = microcode(model_core("ctrv", pes=1), Pipeline())
    mnemonics, layout = Mnemonics(code), code.layout
    assert layout.temporaries
    for k, vector in enumerate(layout.temporaries):
        assert mnemonics.place(vector.word(0), 0b1) == f"temporary[{k}][0]"
    for value, vector in layout.model_words.items():
        assert mnemonics.place(vector.word(0)) == say_constant(float.fromhex(value))
    root = layout.roots[1].word(0)
    assert mnemonics.place(root, 0b1) == "root[1]"
    assert mnemonics.place(root, 0b1, of_model=True) == "root[1][0]"


@pytest.mark.parametrize("name", PROBLEMS)
def test_lines_of_models_are_short(name):
    code = microcode(model_core(name, pes=10), Pipeline())
    for routine in code.programs:
        mnemonics = Mnemonics(code)
        for entry in disassemble(code, *routine):
            assert max(len(line.text) for line in mnemonics.lines(entry)) <= 87


def test_record_of_a_slot():
    code = microcode(model_core("ctrv", pes=12), Pipeline())
    mnemonics = Mnemonics(code)
    found = [mnemonics.record(entry) for entry in disassemble(code, Program.MODEL_F)]
    slots = [record for record in found if record["operation"] == "SLOT"]
    assert all(record["form"] is None for record in found if record not in slots)
    assert {record["form"]["condition"] for record in slots} >= {"always"}
    constants = {
        read["value"] for record in slots for beat in record["beats"] for read in beat["reads"]
        if "value" in read
    }  # fmt: skip
    assert constants == set(code.params.models.f.words)
    roots = [write for record in found for write in record["writes"] if write.get("is")]
    assert roots
    assert all(len(write["columns"]) == 1 for write in roots)


def test_programs_of_variants_have_names():
    code = microcode(model_core("ctrv", pes=12), Pipeline())
    names = [code.name_of(routine) for routine in code.programs]
    assert names[-3:] == ["MODEL_F", "MODEL_H, variant 0", "MODEL_H, variant 1"]


def test_record_says_the_same():
    code = microcode(UkfParams(n=2, m=1, pes=2), Pipeline())
    mnemonics = Mnemonics(code)
    *_, nis = (entry for entry in disassemble(code, Program.UPDATE) if "nis" in entry.marks)
    record = mnemonics.record(nis)
    assert record["operation"] == "SCALE"
    assert record["clock"] == record["beats"][0]["clock"] == nis.clocks[0]
    assert record["beats"][0]["reads"] == [
        {"vector": "inverse_weight", "columns": None, "banked": False}
    ]
    assert record["writes"] == [{"clock": record["done"], "register": nis.register}]
    assert record["marks"] == {"nis": 1}
    (pivot,) = (entry for entry in disassemble(code, Program.UPDATE) if entry.marks == {"row": 0})
    assert mnemonics.record(pivot)["writes"][-1] == {
        "clock": pivot.root_clock, "vector": "root[0]", "columns": None, "banked": False,
        "is": "1/sqrt",
    }  # fmt: skip


def test_words_by_themselves():
    """What a waveform shows of a word: its reads and its writes."""
    code = microcode(UkfParams(n=2, m=1, pes=2), Pipeline())
    mnemonics = Mnemonics(code)
    assert (mnemonics.reads(0), mnemonics.writes(0)) == ("-", "-")
    for routine in code.programs:
        words = code.words_of(*routine)
        for entry in disassemble(code, *routine):
            reads = mnemonics.reads(words[entry.clocks[0]])
            writes = mnemonics.writes(words[entry.done])
            assert reads.startswith("AXPY" if entry.kind is Kind.SCALE else entry.kind.name)
            if entry.register is not None:
                assert writes.startswith(f"s{entry.register} = ")
            if entry.destination is not None:
                place = mnemonics.place(entry.destination, entry.lanes, written=True)
                assert f"{place} = " in writes
            for mark in set(entry.marks) - {"row", "coupling"}:
                assert mark in writes
            if "row" in entry.marks:
                assert f" {entry.marks['row']}" in writes.split("pivot" if entry.root else "row")[1]
    assert mnemonics.writes(words[-1]).endswith("last")


@pytest.mark.parametrize(
    ("marks", "text"),
    [
        ({"row": 2}, "(pivot 2)"),
        ({"row": 2, "coupling": 1}, "(couples row 2)"),
        ({"nis": 1}, "(nis)"),
        ({"innovation": 1}, "(innovation)"),
    ],
)
def test_marks_are_said(marks, text):
    code = microcode(UkfParams(n=2, m=1), Pipeline())
    instruction = replace(disassemble(code, Program.PREDICT)[0], marks=marks)
    assert Mnemonics(code).lines(instruction)[-1].text.endswith(f"  {text}")


def test_beats_have_the_lanes_that_take_part():
    code = microcode(UkfParams(n=2, m=1, pes=4), Pipeline())
    dots = [entry for entry in disassemble(code, Program.PREDICT) if entry.kind is Kind.DOT]
    assert all(isinstance(beat, Beat) and beat.lanes for entry in dots for beat in entry.beats)
