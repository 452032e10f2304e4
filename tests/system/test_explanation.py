"""Where the clocks of a program go, what takes the stages, and the picture of it."""

import random
from collections import Counter
from dataclasses import replace
from itertools import groupby, pairwise

import pytest

from support.model_cores import model_core
from support.random_cores import random_configuration
from ukf_sw.engine.checker import ScheduleError, check_schedule
from ukf_sw.engine.control_word import BusSource
from ukf_sw.engine.disassembler import disassemble, fields_of, kind_of
from ukf_sw.engine.layout import Layout
from ukf_sw.engine.microcode import microcode
from ukf_sw.engine.model_programs import model_of
from ukf_sw.engine.operations import Kind, ProgramBuilder
from ukf_sw.engine.scheduler import Schedule, schedule
from ukf_sw.engine.timing import Timing
from ukf_sw.spec.parameters import Form, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine
from ukf_tools.estimate.explanation import explain
from ukf_tools.estimate.occupancy import tracks
from ukf_tools.estimate.parts import parts, runs
from ukf_tools.estimate.schedule_plot import plot_schedule
from ukf_tools.estimate.waits import Reason, Waits

STAGES = {
    Reason.ISSUE, Reason.ADDERS, Reason.WRITE_PORT, Reason.SCALAR_BUS, Reason.HELD_BACK,
}  # fmt: skip
TINY = UkfParams(n=2, m=1, q=1, pes=3)


def random_code(seed, largest=4):
    return microcode(*random_configuration(random.Random(seed), largest=largest))


#: Cores at random, and some that evaluate models.
CORES = [*range(8), "battery", "ctrv"]


def code_of(seed, core):
    """A core at random, or that of a problem's models."""
    if isinstance(core, int):
        return random_code(seed + core)
    return microcode(model_core(core, pes=4), Pipeline(add=3, reciprocal_sqrt=4))


def reads_of(code, routine):
    """Clocks on which the control words read something."""
    words = code.words_of(*routine)
    return {clock for clock, word in enumerate(words) if kind_of(fields_of(code, word))}


# Clocks without an issue.


@pytest.mark.parametrize("core", CORES)
def test_every_clock_without_an_issue_has_a_reason(core):
    code = code_of(600, core)
    for routine, (plan, *_) in code.programs.items():
        found = explain(code, routine)
        issued = reads_of(code, routine)
        assert set(found.idle) == set(range(plan.length)) - issued
        assert sum(found.reasons.values()) == plan.length - len(issued)
        behind = {clock for clock in found.idle if clock > max(issued)}
        ends = {clock for clock, reason in found.idle.items() if reason is Reason.ENDS}
        assert ends == behind


def test_reasons_of_all_kinds_are_found():
    """Else the tests here would not test much."""
    seen = Counter()
    for seed in range(8):
        code = random_code(600 + seed)
        for routine in code.programs:
            seen.update(explain(code, routine).reasons.keys())
    assert {Reason.DOT, Reason.ROOT, Reason.SCALE, Reason.AXPY, Reason.ENDS} <= set(seen)
    assert {Reason.ADDERS, Reason.WRITE_PORT, Reason.SCALAR_BUS} <= set(seen)


def complaint(plan, index, clock, params, pipeline):
    """What the checker says of a schedule in which one operation issues on another clock."""
    issue = list(plan.issue)
    issue[index] = clock
    moved = Schedule(plan.operations, issue, plan.timing, plan.length)
    try:
        check_schedule(moved, pes=params.pes, pipeline=pipeline)
    except ScheduleError as error:
        return str(error)
    return None


@pytest.mark.parametrize(
    ("form", "pes"), [(Form.SQUARE_ROOT, 3), (Form.SQUARE_ROOT, 2), (Form.COVARIANCE, 1)]
)
def test_the_checker_agrees_with_the_reasons(form, pes):
    """No operation can be moved to a clock that has a reason; if a stage is it, for want of it.

    The checker knows the lanes of a word apart, the dependences do not: so one lane for the form
    whose words are written by many.
    """
    params, pipeline = replace(TINY, form=form, pes=pes), Pipeline()
    plan = microcode(params, pipeline).programs[Routine(Program.UPDATE)].plan
    idle = Waits(plan).idle()
    assert len(set(idle.values())) > 1
    for clock, reason in list(idle.items())[:: -(-len(idle) // 12)]:
        later = [index for index, issue in enumerate(plan.issue) if issue > clock]
        said = [complaint(plan, index, clock, params, pipeline) for index in later]
        assert None not in said
        # The checker names the stage unless an operand is missing too.
        assert any("is used by" in text for text in said) or reason not in STAGES
        if reason is Reason.ENDS:
            assert not later


def test_what_is_held_back_is_seen():
    """All operations three clocks later: nothing but the schedule kept them from beginning."""
    plan = microcode(TINY, Pipeline()).programs[Routine(Program.UPDATE)].plan
    late = Schedule(plan.operations, [at + 3 for at in plan.issue], plan.timing, plan.length + 3)
    before, after = Waits(plan).idle(), Waits(late).idle()
    assert Reason.HELD_BACK not in before.values()
    assert [after[clock] for clock in range(3)] == [Reason.HELD_BACK] * 3
    assert complaint(late, 0, 1, TINY, Pipeline()) is None
    assert {clock + 3: reason for clock, reason in before.items()} == {
        clock: reason for clock, reason in after.items() if clock >= 3
    }


@pytest.mark.parametrize("loads", [False, True])
def test_one_that_is_free_is_held_back_whatever_else_is_blocked(loads):
    """A dot product on clock 0 meets lane operations of clock 2 in its second level of adders."""
    layout = Layout(UkfParams(n=4, m=1, pes=2))
    builder = ProgramBuilder(layout)
    x, ones = layout.X[0], layout.ones
    builder.dot([(x.word(0), ones.word(0), 0b11)])
    builder.multiply(layout.Ex[0], x, ones, [(0, 1)])
    if loads:
        builder.load(x, 0)
    issue = [0, 3, 4][: len(builder.operations)]
    idle = Waits(Schedule(builder.operations, issue, Timing(2, Pipeline()), 10)).idle()
    assert idle[1] is Reason.HELD_BACK
    assert idle[2] is (Reason.HELD_BACK if loads else Reason.ADDERS)
    assert {reason for clock, reason in idle.items() if clock > 2} == {Reason.ENDS}


def dot_and_axpy(beats):
    """Dot product of a row, and a multiplication of it by the result."""
    layout = Layout(UkfParams(n=4, m=1, pes=2))
    builder = ProgramBuilder(layout)
    x, ones = layout.X[0], layout.ones
    pairs = [(x.word(beat), ones.word(beat), 0b11) for beat in range(beats)]
    s = builder.dot(pairs)
    builder.axpy(layout.Ex[0], x, s, ones, [(0, 1)])
    return schedule(builder.operations, Timing(2, Pipeline(add=3)))


def test_a_wait_has_the_name_of_what_is_waited_for():
    """Two beats of a dot product three clocks apart, then its sum, then the last result."""
    plan = dot_and_axpy(2)
    assert plan.issue == [0, plan.timing.result(plan.operations[0]) + 1]
    assert Counter(Waits(plan).idle().values()) == {
        Reason.DOT: plan.issue[1] - 2, Reason.ENDS: plan.timing.lanes
    }  # fmt: skip


# The longest chain.


@pytest.mark.parametrize("core", CORES)
def test_every_operation_of_the_chain_waits_for_the_one_before(core):
    """Against the control words: what is read was written on the clock before, and not sooner."""
    code = code_of(620, core)
    results = 0
    for routine, (plan, *_) in code.programs.items():
        instructions = {entry.clocks[0]: entry for entry in disassemble(code, *routine)}
        found = explain(code, routine)
        links = [step.link for step in found.chain]
        last = instructions[links[-1].issue]
        assert max(last.done, last.root_clock or 0) + 1 == plan.length == found.length
        assert links[0].ready == 0
        assert links[0].waits_for is None
        for before, link in pairwise(links):
            assert link.ready == before.issue + link.result_clocks
            other, own = instructions[before.issue], instructions[link.issue]
            if link.waits_for is Reason.OVERWRITE:
                continue
            results += 1
            done = other.root_clock if link.waits_for is Reason.ROOT else other.done
            late = done + 1 - link.ready  # of the beat that needs it
            assert late % code.timing.beat_interval == 0
            beat = own.beats[late // code.timing.beat_interval]
            written = other.root if link.waits_for is Reason.ROOT else other.destination
            by_word = written is not None and written in (beat.word_0, beat.word_1)
            by_scalar = own.scalar is not None and own.scalar == other.register
            assert by_word or by_scalar
            if link.waits_for is not Reason.ROOT:
                assert link.waits_for.name == other.kind.name
        for link in links:
            assert sum(link.stage_clocks.values()) == link.issue - link.ready >= 0
            assert set(link.stage_clocks) <= STAGES
    assert results > 20


def expanded(text):
    """Words of the text of a stretch, each as often as it says."""
    for entry in text.split(", "):
        *times, word = entry.split()
        yield from [word] * int(*times or "1")


@pytest.mark.parametrize("core", CORES)
def test_stretches_are_the_chain_in_short(core):
    code = code_of(640, core)
    roots = 0
    for routine, (plan, *_) in code.programs.items():
        found = explain(code, routine)
        names = [step.part for step in found.chain]
        assert [each.name for each in found.stretches] == [name for name, _ in groupby(names)]
        assert sum(each.clocks for each in found.stretches) == plan.length
        words = []
        for step in found.chain:
            words += ["1/sqrt"] * (step.link.waits_for is Reason.ROOT) + [step.kind]
        assert [word for each in found.stretches for word in expanded(each.text)] == words
        waited = sum((Counter(each.stage_clocks) for each in found.stretches), Counter())
        assert waited == sum((Counter(step.link.stage_clocks) for step in found.chain), Counter())
        roots += words.count("1/sqrt")
    assert roots


# Bounds, lanes.


@pytest.mark.parametrize("core", CORES)
def test_bounds(core):
    """None is larger than the program; those of stages are counted in the control words."""
    code = code_of(660, core)
    for routine, (plan, *_) in code.programs.items():
        found = explain(code, routine)
        assert max(found.bounds.values()) <= plan.length
        assert found.ratio >= 1.0
        fields = [fields_of(code, word) for word in code.words_of(*routine)]
        assert found.bounds["issue slot"] == len(reads_of(code, routine))
        assert found.bounds["write port"] == sum("write" in each for each in fields)
        assert found.bounds["scalar bus"] == len(bus_clocks(fields))


def test_longest_chain_of_known_operations():
    plan = dot_and_axpy(3)
    beats = 2 * 3  # two more beats, three clocks apart
    dot = 2 + 2 + 3 * 2  # operands, product, one level and the accumulator
    assert Waits(plan).longest_chain() == beats + dot + 1 + (2 + 2 + 3) + 1 == plan.length


def test_lanes_that_take_part():
    """A state on two lanes: three sigma points make every other word half full."""
    code = microcode(UkfParams(n=1, m=1, W0=0.25, pes=2), Pipeline())
    plan = code.programs[Routine(Program.PREDICT)].plan
    found = explain(code, Routine(Program.PREDICT)).lanes
    kinds = Counter(operation.kind for operation in plan.operations)
    assert kinds == {Kind.DOT: 1, Kind.AXPY: 2, Kind.MULTIPLY: 1}
    # Three columns of the dot product, four of the residual, one that is scaled.
    assert found == (3 + 4 + 1, 2 * (2 + 2 + 1), 2 * plan.length)


# Stages.


def bus_clocks(fields):
    """Clocks on which something is on the scalar bus: a register, a word or 1/sqrt takes it."""
    return {
        clock for clock, each in enumerate(fields)
        if "scalar_write" in each or ("write" in each and "write_bus" in each)
        or each.get("bus_source") == BusSource.LOAD
    }  # fmt: skip


@pytest.mark.parametrize("core", CORES)
def test_tracks_are_those_of_the_control_words(core):
    code = code_of(680, core)
    timing, add = code.timing, code.pipeline.add
    for routine, (plan, *_) in code.programs.items():
        found = tracks(plan)
        fields = [fields_of(code, word) for word in code.words_of(*routine)]
        assert set(found["issue"][0]) == reads_of(code, routine)
        assert set(found["write port"][0]) == {
            k for k, each in enumerate(fields) if "write" in each
        }
        assert set(found["scalar bus"][0]) == bus_clocks(fields)
        dots = [clock for clock, each in enumerate(fields) if "dot" in each]
        assert len(found["tree"]) == timing.levels + 1
        for level, line in enumerate(found["tree"]):
            assert list(line) == [clock + timing.product + level * add for clock in dots]
        by_lanes = {
            clock - add for clock, each in enumerate(fields)
            if "write" in each and "write_bus" not in each
        }  # fmt: skip
        scales = {i.done - add for i in disassemble(code, *routine) if i.kind is Kind.SCALE}
        assert set(found["lanes"][0]) == by_lanes | scales
        roots = {
            clock - back for clock, each in enumerate(fields)
            if each.get("bus_source") == BusSource.ROOT
            for back in range(1, code.pipeline.reciprocal_sqrt + 1)
        }  # fmt: skip
        assert set(found["1/sqrt"][0]) == roots
        for lines in found.values():
            for line in lines:
                assert list(line) == sorted(line)


def test_runs_join_clocks_of_a_part():
    code = microcode(TINY, Pipeline())
    plan = code.programs[Routine(Program.UPDATE)].plan
    found = parts(plan.operations, code.layout)
    line = tracks(plan)["issue"][0]
    joined = runs(line, found)
    clocks = {run.first + k: run.part for run in joined for k in range(run.clocks)}
    assert clocks == {clock: found[index] for clock, index in line.items()}
    for before, after in pairwise(joined):
        assert before.first + before.clocks < after.first or before.part != after.part
    assert len(joined) < len(line)


# Parts.


@pytest.mark.parametrize("seed", range(12))
def test_rows_of_the_elimination(seed):
    """In program order: from a pivot to the next one all is of its row; the last row has no axpy.

    Behind the rows of the observations stands what is of the new state.
    """
    code = random_code(700 + seed)
    for routine, (plan, *_) in code.programs.items():
        found = parts(plan.operations, code.layout)
        pivots = [k for k, operation in enumerate(plan.operations) if operation.pivot is not None]
        rows = {part.row for part in found} - {None}
        assert rows == {plan.operations[k].pivot for k in pivots}
        for start, stop in pairwise([*pivots, len(found)]):
            row = plan.operations[start].pivot
            own = [part.row == row for part in found[start:stop]]
            assert own == sorted(own, reverse=True)  # at the beginning, without gaps
            if stop < len(found) and plan.operations[stop].pivot != code.params.m:
                assert all(own)
            kinds = Counter(plan.operations[start + k].kind for k in range(sum(own)))
            last = row == code.params.m + code.params.n - 1
            assert (kinds[Kind.AXPY] == 0) is last
        behind = {part.name for part in found if part.row is None}
        if routine.program is Program.UPDATE:
            joint = {"joint covariance"} if code.params.form is Form.COVARIANCE else set()
            assert behind == {"residuals", "NIS", "state", "factor", "sigma points"} | joint


def test_parts_of_the_other_programs():
    code = microcode(UkfParams(n=2, m=1, q=1, r=1, pes=2), Pipeline())
    named = {
        routine.program.name: {part.name for part in parts(plan.operations, code.layout)}
        for routine, (plan, *_) in code.programs.items()
    }
    assert named["INIT"] == {"checks", "sigma points"}
    assert named["SIG_GEN"] == {"factor", "sigma points"}
    assert named["PREDICT"] == {"residuals"}
    assert named["COVARIANCE"] == named["COVARIANCE_PREDICTED"] == {"covariance"}


@pytest.mark.parametrize("name", ["battery", "ctrv"])
def test_parts_of_models(name):
    code = microcode(model_core(name, pes=4), Pipeline())
    for routine, (plan, *_) in code.programs.items():
        if routine.program not in (Program.MODEL_F, Program.MODEL_H):
            continue
        found = parts(plan.operations, code.layout)
        program = model_of(code.layout, routine)
        beats = len(ProgramBuilder(code.layout).lanes_by_beat([code.layout.points]))
        names = Counter(part.name for part in found)
        assert set(names) <= {"inputs", "stream through 1/sqrt", "model", "results"}
        results = len(program.outputs) * beats + len(program.measurements)
        assert names["results"] >= results
        assert (names["stream through 1/sqrt"] > 0) is bool(program.roots)
        for operation, part in zip(plan.operations, found, strict=True):
            assert (part.name == "stream through 1/sqrt") is (operation.root is not None)


def test_what_waits_for_models_is_said():
    seen = Counter()
    code = microcode(model_core("ctrv", pes=4), Pipeline())
    for routine in code.programs:
        if routine.program is Program.MODEL_F:
            found = explain(code, routine)
            seen.update(step.link.waits_for for step in found.chain)
            assert set(found.record()["bounds"]) == {
                "longest chain", "issue slot", "write port", "scalar bus"
            }  # fmt: skip
    assert {Reason.SLOT, Reason.ROOT} <= set(seen)


# The picture.


@pytest.mark.parametrize("kind", ["svg", "pdf"])
def test_pictures_of_equal_programs_are_equal(tmp_path, kind):
    code = microcode(TINY, Pipeline())
    files = [
        plot_schedule(tmp_path / name / f"x.{kind}", code, Routine(Program.UPDATE), "title")
        for name in "ab"
    ]
    assert files[0].read_bytes() == files[1].read_bytes()
    other = plot_schedule(tmp_path / f"c.{kind}", code, Routine(Program.PREDICT), "title")
    assert other.read_bytes() != files[0].read_bytes()


def test_picture_of_a_program(tmp_path):
    """One shape for each run of clocks, a bar of colours if there are rows."""
    code = microcode(TINY, Pipeline())
    plan = code.programs[Routine(Program.UPDATE)].plan
    found = parts(plan.operations, code.layout)
    shapes = sum(len(runs(line, found)) for lines in tracks(plan).values() for line in lines)
    text = plot_schedule(tmp_path / "x.svg", code, Routine(Program.UPDATE), "t").read_text()
    assert text.count('<path d="M') >= shapes
    assert text.count('<g id="axes_') == 2
    text = plot_schedule(tmp_path / "y.svg", code, Routine(Program.PREDICT), "t").read_text()
    assert text.count('<g id="axes_') == 1


def test_picture_of_a_model(tmp_path):
    code = microcode(model_core("ctrv", pes=12), Pipeline())
    text = plot_schedule(tmp_path / "x.svg", code, Routine(Program.MODEL_F), "t").read_text()
    assert text.count('<g id="axes_') == 1
