"""Schedules, their checker, control words, and the interpreter that executes them."""

import dataclasses
import os
import random
import subprocess
import sys

import numpy as np
import pytest

from support.random_cores import random_configuration
from ukf_sw.engine import scheduler
from ukf_sw.engine.adder_tree import adder_tree
from ukf_sw.engine.checker import ScheduleError, check_schedule
from ukf_sw.engine.control_word import ControlFormat
from ukf_sw.engine.interpreter import Interpreter
from ukf_sw.engine.layout import Layout
from ukf_sw.engine.microcode import STEP_OVERHEAD, Microcode, microcode, routines
from ukf_sw.engine.operations import Kind, ProgramBuilder
from ukf_sw.engine.programs import build_program
from ukf_sw.engine.scheduler import Schedule, schedule
from ukf_sw.engine.timing import Timing
from ukf_sw.spec.memory_map import FirstColumn, MemoryMap
from ukf_sw.spec.parameters import Pipeline, UkfParams
from ukf_sw.spec.sequence import Program, Routine


@pytest.mark.parametrize("seed", range(12))
def test_schedules_are_right(seed):
    params, pipeline = random_configuration(random.Random(seed))
    code = microcode(params, pipeline)
    for routine, found in code.programs.items():
        check_schedule(found.plan, pes=params.pes, pipeline=pipeline, registers=found.registers)
        assert found.plan.operations, routine


@pytest.mark.parametrize("seed", range(12))
def test_words_mean_what_the_operations_mean(seed, sequential):
    """The interpreter of the scheduled words against operations one after the other."""
    params, pipeline = random_configuration(random.Random(100 + seed), largest=4)
    rng = np.random.default_rng(seed)
    layout = Layout(params)
    for program, sensor, _ in microcode(params, pipeline).programs:
        memory = sequential(layout, params.format)
        interpreter = Interpreter(params, pipeline)
        values = params.format.round(rng.uniform(0.5, 2.0, size=memory.current.shape))
        # Data everywhere but in the constants and in lanes that no column uses.
        untouched = memory.current != 0
        untouched[:, layout.weights.address : layout.state_sigma[0].address] = True
        for row in (*layout.state_sigma, *layout.noise_sigma):
            untouched[:, row.address : row.address + row.beats] = True
        memory.current[~untouched] = values[~untouched]
        memory.next = memory.current.copy()
        interpreter.memory[:] = params.format.encode(memory.current)
        mask = rng.integers(1 << params.m) if params.m > 1 else 1
        result = interpreter.run(
            program, sensor=sensor, mask=int(mask), state_bank=0, factor_bank=0
        )
        programs = [program]
        if program is Program.UPDATE_REDRAWN:
            programs.append(Program.UPDATE)
        for part in programs:
            memory.run(build_program(layout, part, sensor), mask=int(mask))
        if result.error_code:
            continue  # what follows an error is not written
        banked = layout.bank_offset
        expected = memory.current.copy()
        count = layout.x.beats + sum(row.beats for row in layout.L)
        written = memory.next[:, :count] != memory.current[:, :count]
        expected[:, banked : banked + count][written] = memory.next[:, :count][written]
        np.testing.assert_array_equal(
            interpreter.memory, params.format.encode(expected), str(program)
        )


def test_most_random_programs_run_without_error():
    """Else the test above would not test much."""
    good = 0
    for seed in range(12):
        params, pipeline = random_configuration(random.Random(100 + seed), largest=4)
        interpreter = Interpreter(params, pipeline)
        good += interpreter.run(Program.INIT).error_code == 0
        good += interpreter.run(Program.SIG_GEN).error_code == 0
    assert good == 24


def every_strategy(timing):
    """All strategies that there are for an array, the plain one first."""
    has_phases = timing.levels and timing.beat_interval > 1
    found = scheduler._STRATEGIES if has_phases else scheduler._WITHOUT_PHASES
    assert found[0] == scheduler._Strategy(0, 0, counts_issues=False)
    assert len(set(found)) == len(found) == (24 if has_phases else 2)
    return found


@pytest.mark.parametrize("seed", range(8))
def test_the_shortest_schedule_of_all_strategies_is_kept(seed):
    """In particular none is longer than without waiting, by the chain of clocks alone."""
    params, pipeline = random_configuration(random.Random(400 + seed), largest=4)
    params = dataclasses.replace(params, pes=params.columns) if seed == 0 else params
    layout, timing = Layout(params), Timing(params.pes, pipeline)
    plain = scheduler._Strategy(0, 0, counts_issues=False)
    for routine in routines(params):
        operations = build_program(layout, *routine)
        assert len(operations) * 24 < scheduler.WORK
        plan = schedule(operations, timing)
        check_schedule(plan, pes=params.pes, pipeline=pipeline)
        single = scheduler._Scheduler(operations, timing)
        lengths = {}
        for strategy in every_strategy(timing):
            lengths[strategy] = single.length(single.place(strategy, None))
            # One that takes as long as the limit, or longer, is given up.
            assert single.place(strategy, lengths[strategy]) is None
            assert single.place(strategy, lengths[strategy] + 1) is not None
        assert plan.length == min(lengths.values()) <= lengths[plain], routine


def test_of_a_long_program_fewer_strategies_are_tried(monkeypatch):
    operations = build_program(Layout(UkfParams(n=2, m=2, q=1, pes=3)), Program.UPDATE)
    tried = []

    def place(self, strategy, limit):
        tried.append(strategy)
        return original(self, strategy, limit)

    original = scheduler._Scheduler.place
    monkeypatch.setattr(scheduler._Scheduler, "place", place)
    for times, count in ((30, 24), (7, 7), (1, 2)):
        monkeypatch.setattr(scheduler, "WORK", times * len(operations))
        tried.clear()
        schedule(operations, Timing(3, Pipeline()))
        assert tried == list(scheduler._STRATEGIES[:count])


def test_a_schedule_that_repeats_itself_more_is_kept_if_it_is_hardly_longer():
    """A clock is worth some packets of program memory, in random cores sometimes and not always."""
    longer = {False: 0, True: 0}
    for seed in range(400, 412):
        params, pipeline = random_configuration(random.Random(seed), largest=4)
        code = microcode(params, pipeline)
        for routine, (plan, *_) in code.programs.items():
            plans = scheduler.schedules(plan.operations, code.timing)
            assert plan.issue in [each.issue for each in plans], routine
            assert plans[0].length == min(each.length for each in plans)
            assert plan.length <= plans[0].length * (1 + 1 / scheduler.MARGIN)
            longer[plan.issue != plans[0].issue] += 1
    assert longer[False] > 10
    assert longer[True] > 4


def test_what_repeats_itself_more_saves_program_memory(monkeypatch):
    params = UkfParams(n=4, m=3, q=4, r=3, pes=2)

    def packets(code):
        return sum(len(stream.packets) for stream in code.streams.values())

    code = Microcode(params, Pipeline())
    monkeypatch.setattr(
        "ukf_sw.engine.microcode.schedules", lambda *program: scheduler.schedules(*program)[:1]
    )
    shortest = Microcode(params, Pipeline())
    assert packets(code) < packets(shortest)
    for routine in code.programs:
        assert code.clocks(*routine) >= shortest.clocks(*routine)


def test_waiting_for_a_phase_makes_some_schedules_shorter():
    """Else the strategies would be for nothing."""
    shorter = set()
    for seed in range(400, 408):
        params, pipeline = random_configuration(random.Random(seed), largest=4)
        layout, timing = Layout(params), Timing(params.pes, pipeline)
        for routine in routines(params):
            single = scheduler._Scheduler(build_program(layout, *routine), timing)
            waiting = {
                strategy: single.length(single.place(strategy, None))
                for strategy in every_strategy(timing)
            }
            without = min(waiting[each] for each in waiting if each[:2] == (0, 0))
            by_clocks = min(waiting[each] for each in waiting if not each.counts_issues)
            if min(waiting.values()) < without:
                shorter.add("waiting")
            if min(waiting.values()) < by_clocks:
                shorter.add("counting issues")
    assert shorter == {"waiting", "counting issues"}


#: Prints all that a schedule consists of.
PRINT_SCHEDULES = """
import sys
from ukf_sw.engine.microcode import Microcode
from ukf_sw.spec.parameters import Pipeline, UkfParams

code = Microcode(UkfParams(n=2, m=2, q=1, r=1, sensors=(1, 1), pes=3), Pipeline(add=3))
for routine, (plan, registers, places, temporaries) in code.programs.items():
    print(routine, plan.length, plan.issue, registers, places, temporaries)
print(code.words, code.lane_sets)
"""


def test_equal_inputs_give_equal_schedules_in_every_process():
    """Whatever the seed of Python's hashes: nothing goes by the order of a set."""
    printed = [
        subprocess.run(
            [sys.executable, "-c", PRINT_SCHEDULES],
            env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": os.pathsep.join(sys.path)},
            capture_output=True, text=True, check=True,
        ).stdout
        for seed in ("1", "20")
    ]  # fmt: skip
    assert len(printed[0]) > 1000
    assert printed[0] == printed[1]


@pytest.fixture
def plan():
    params = UkfParams(n=2, m=2, q=1, pes=2)
    return schedule(build_program(Layout(params), Program.UPDATE), Timing(2, Pipeline()))


def moved(plan, index, clocks):
    issue = list(plan.issue)
    issue[index] += clocks
    return Schedule(plan.operations, issue, plan.timing, plan.length + abs(clocks))


def test_checker_sees_every_operation_that_is_too_early(plan):
    """Whatever can move later cannot have waited for nothing, and moving earlier is noticed."""
    noticed = 0
    for index in range(len(plan.operations)):
        for clocks in (-1, -2, -plan.issue[index] - 1):
            with_move = moved(plan, index, clocks)
            try:
                check_schedule(with_move, pes=2, pipeline=Pipeline())
            except ScheduleError:
                noticed += 1
    assert noticed > 2 * len(plan.operations)


def test_checker_sees_two_operations_on_one_clock(plan):
    issue = list(plan.issue)
    issue[1] = issue[0]
    crowded = Schedule(plan.operations, issue, plan.timing, plan.length)
    with pytest.raises(ScheduleError, match="read ports of lane 0 is used by operations 0 and 1"):
        check_schedule(crowded, pes=2, pipeline=Pipeline())


def test_checker_sees_adders_that_meet():
    """A dot product's tree level 1 and an axpy that is issued one adder latency later."""
    layout = Layout(UkfParams(n=2, m=1, pes=2))
    builder = ProgramBuilder(layout)
    x, ones = layout.X[0], layout.ones
    builder.dot([(x.word(0), ones.word(0), 0b11)])
    builder.multiply(layout.Ex[0], x, ones, [(0, 2)])
    pipeline = Pipeline()
    timing = Timing(2, pipeline)
    bad = Schedule(builder.operations, [0, pipeline.add], timing, 100)
    with pytest.raises(ScheduleError, match="adder of lane 1 is used by operations 0 and 1"):
        check_schedule(bad, pes=2, pipeline=pipeline)
    check_schedule(
        Schedule(builder.operations, [0, pipeline.add + 1], timing, 100), pes=2, pipeline=pipeline
    )


def test_checker_sees_a_register_that_is_reused_too_early(plan):
    registers = {
        operation.result: 0 for operation in plan.operations if operation.result is not None
    }
    with pytest.raises(ScheduleError, match="scalar"):
        check_schedule(plan, pes=2, pipeline=Pipeline(), registers=registers)


def test_checker_sees_a_result_after_the_end(plan):
    short = Schedule(plan.operations, plan.issue, plan.timing, plan.length - 1)
    with pytest.raises(ScheduleError, match="after the end"):
        check_schedule(short, pes=2, pipeline=Pipeline())


@pytest.mark.parametrize("pes", [1, 2, 3, 5, 6, 7, 8, 10, 22])
def test_adder_tree_sums_every_lane_once(pes):
    nodes, root = adder_tree(pes)
    sums = {}

    def lanes(source):
        return sums[source.lane] if source.is_sum else (source.lane,)

    for node in nodes:
        assert node.lane not in sums
        sums[node.lane] = lanes(node.left) + lanes(node.right)
    assert lanes(root) == tuple(range(pes))
    assert pes - 1 not in sums  # free to accumulate
    assert all(node.level < Timing(pes, Pipeline()).levels for node in nodes)


def test_clocks_do_not_depend_on_data():
    params = UkfParams(n=2, m=2)
    code = microcode(params, Pipeline())
    length = code.programs[Routine(Program.PREDICT)].plan.length
    assert code.clocks(Program.PREDICT) == length + STEP_OVERHEAD
    assert Interpreter(params).run(Program.PREDICT).clocks == length + STEP_OVERHEAD
    redrawn = code.programs[Routine(Program.UPDATE_REDRAWN)].plan.length
    assert code.clocks(Program.UPDATE_REDRAWN) == redrawn + code.clocks(Program.UPDATE)


def test_results_do_not_depend_on_the_pipeline():
    params = UkfParams(n=3, m=2, q=2, pes=3)
    rng = np.random.default_rng(7)
    contents = []
    filled = params.format.encode(rng.normal(size=Interpreter(params).memory.shape))
    for pipeline in (Pipeline(), Pipeline(multiply=1, add=1, reciprocal_sqrt=2)):
        interpreter = Interpreter(params, pipeline)
        interpreter.memory[:] = np.where(interpreter.memory, interpreter.memory, filled)
        for program in (Program.INIT, Program.SIG_GEN, Program.PREDICT, Program.UPDATE):
            interpreter.run(program)
        contents.append(interpreter.memory)
    np.testing.assert_array_equal(*contents)


def test_control_words_reject_values_that_do_not_fit():
    control = ControlFormat(
        address_width=4, scalar_width=2, lane_sets=3, pes=2, observations=2, rows=4
    )
    with pytest.raises(ValueError, match=r"^scalar_address must fit 2 bits, not 4$"):
        control.encode({"scalar_address": 4})
    words = [control.encode({"address_0": 9, "row": 4, "last": 1})]
    fields = control.decode(words)
    assert (fields["address_0"][0], fields["row"][0], fields["last"][0]) == (9, 4, 1)


@pytest.mark.parametrize("seed", range(8))
def test_layout_gives_every_element_a_place_of_its_own(seed):
    params, _ = random_configuration(random.Random(200 + seed))
    layout = Layout(params)
    places = {}
    for region in MemoryMap(params):
        for row in range(region.rows):
            # Where there is no sigma point 0 it has no place.
            has_first = region.first_column is FirstColumn.STORED
            for column in range(0 if has_first else 1, region.columns):
                for bank in (0, 1):
                    place = layout.buffer_location(
                        region.symbol, row, column, state_bank=bank, factor_bank=bank
                    )
                    assert place[0] < params.pes
                    assert place[1] < layout.depth
                    key = (region.symbol, row, column, bank * (region.symbol in "xL"))
                    assert places.setdefault(place, key) == key
    constants = layout.initial_words() != 0
    assert not any(constants[place] for place in places)


@pytest.mark.parametrize("W0", [0.0, 0.5])
def test_a_dot_product_has_its_beats_one_adder_latency_apart(W0):
    params = UkfParams(n=3, m=1, W0=W0)
    plan = schedule(build_program(Layout(params), Program.PREDICT), Timing(1, Pipeline(add=4)))
    dots = [
        (operation, issue)
        for operation, issue in zip(plan.operations, plan.issue, strict=True)
        if operation.kind is Kind.DOT
    ]
    assert dots
    # One processing element takes the points one by one.
    assert all(len(operation.beats) == len(params.points) for operation, _ in dots)
