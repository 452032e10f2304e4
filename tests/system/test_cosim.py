"""The Verilog of the core against the golden model, through the bus, bit for bit."""

import random
from dataclasses import replace

import numpy as np
import pytest

from support.random_models import any_models, sane_models, with_models
from ukf_sim.cosimulation import Iteration, Observations, cosimulate
from ukf_sim.session import Job, run_job
from ukf_sim.simulators import Simulator, SimulatorError
from ukf_sw.drivers.driver import Traffic
from ukf_sw.engine.microcode import microcode
from ukf_sw.problems.recipe import Recipe
from ukf_sw.problems.running import run
from ukf_sw.problems.systems.nanosat import NANOSAT, NANOSAT_ADDITIVE
from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64, FloatFormat
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_sw.spec.sequence import Program
from ukf_tools.estimate.latency import latency

pytestmark = pytest.mark.system

ODD_FORMAT = FloatFormat(exponent_bits=6, fraction_bits=17)
FORMATS = (BINARY32, BINARY64, BINARY16, BFLOAT16, ODD_FORMAT, BINARY32)

#: Steps as `reset_during_steps` names them.
DROPPED = [
    f"{step}, dropped"
    for step in (
        "INIT", "SIG_GEN", "SIG_GEN of a prediction", "PREDICT", "UPDATE",
        "UPDATE of a prediction", "COVARIANCE", "COVARIANCE of a prediction",
    )
]  # fmt: skip


def run_core(cache, params, *, name="nanosat", steps=3, P0=1.0, **options):
    recipe = Recipe(name=name, params=params, P0=P0)
    return cosimulate(recipe.scenario, steps, cache=cache, optimise=False, **options)


def check(found, params, steps, pipeline=None):
    """Every word agreed, the run went through, and CYCLES read what the schedule says."""
    assert found.mismatch is None
    assert found.run.stop is None
    assert found.okay
    assert found.run.steps == len(found.iterations) == steps
    expected = latency(params, pipeline or Pipeline(), redraws=found.run.problem.redraws)
    assert found.first_cycles == {"INIT": expected["programs"]["INIT"]}
    first = {"SIG_GEN": expected["programs"]["SIG_GEN"]}
    assert found.iterations[0].cycles == expected["steps"] | first
    assert all(each.cycles == expected["steps"] for each in found.iterations[1:])


@pytest.mark.parametrize(
    ("form", "P0", "interrupt"),
    [
        pytest.param(Form.SQUARE_ROOT, 1.0, True, marks=pytest.mark.slow),
        pytest.param(Form.COVARIANCE, 1e-4, False, marks=pytest.mark.slow),
    ],
)
def test_nanosat(core_cache, form, P0, interrupt):
    params = replace(NANOSAT, pes=2, form=form)
    found = run_core(core_cache, params, P0=P0, interrupt=interrupt)
    check(found, params, 3)
    # Points up to n + 1, and x, which is not known before the first; what f and h make of 21.
    n, m, points = 7, 6, 21
    for k, each in enumerate(found.iterations):
        assert each.traffic.words_read == n * (n + 1) + n * (1 + (k == 0))
        assert each.traffic.words_written == (n + m) * points + m
    assert found.traffic.words <= 350
    assert np.isfinite(found.run.P).all()
    assert found.words_compared > 3 * (2 * 7 * 22 + 7 * 7)


def test_covariance_form_stops_at_first_bad_pivot(core_cache):
    """Eleven bits are too few for the covariances of a pendulum: an error, and a good estimate.

    Which pivot is the first bad one is a matter of rounding, so the model says it.
    """
    recipe = Recipe.of("pendulum", P0=100.0, pes=2, form=Form.COVARIANCE, format=BINARY16)
    found = cosimulate(recipe.scenario, 20, cache=core_cache, optimise=False)
    assert found.mismatch is None
    assert not found.okay
    stop = found.run.stop
    assert stop.error in ("SINGULAR_OBSERVATION", "NOT_POSITIVE_DEFINITE")
    assert stop.code in (3, 4)
    assert stop.iteration == found.run.steps < 20
    assert np.isfinite(found.run.last_x).all()
    assert np.isfinite(found.run.x).all()
    assert found.run.P is None


@pytest.mark.slow
def test_bus_latency(core_cache):
    """The 2018 paper's bus: 15.6 clocks a word on average, whatever the core would allow."""
    params = replace(NANOSAT, pes=2)
    found = run_core(core_cache, params, steps=2, word_clocks=15.6)
    check(found, params, 2)
    for each in found.iterations:
        assert each.bus_clocks / each.bus_words == pytest.approx(15.6, abs=0.02)
        assert each.clocks >= each.bus_clocks + found.cycles["UPDATE"]


@pytest.mark.slow
def test_additive_noise(core_cache):
    params = replace(NANOSAT_ADDITIVE, pes=3)
    found = run_core(core_cache, params, name="nanosat-additive", steps=2)
    check(found, params, 2)
    n, m, points = 7, 6, 8
    assert found.traffic.words == n * (n + 1) + n + (n + m) * points + m + 3 <= 180


def test_icarus(core_cache, icarus):
    """A second opinion on the Verilog."""
    params = UkfParams(n=2, m=1, q=1, r=1, pes=2)
    check(run_core(core_cache, params, name=None, simulator=icarus), params, 3)


@pytest.mark.slow
def test_icarus_does_everything(core_cache, icarus):
    params = UkfParams(n=1, m=1)
    job = Job(
        params=params,
        task="support.random_lockstep:all_at_random",
        arguments={"seed": 1, "rounds": 12},
    )
    check_counts(run_job(job, icarus, cache=core_cache).value, params)


def test_the_iteration_that_is_shown_is_a_full_one():
    """Neither the first, which also draws the first sigma points, nor one without an update."""

    def made(*clocks):
        iterations = tuple(
            Iteration(cycles=each, traffic=Traffic(starts=k), clocks=0, bus_clocks=0, bus_words=0)
            for k, each in enumerate(clocks)
        )
        return Observations(
            mismatch=None, words_compared=0, first_cycles={}, iterations=iterations,
            seconds=0.0, cpu_seconds=0.0,
        )  # fmt: skip

    first, full, short = {"SIG_GEN": 9, "ITERATE": 50}, {"ITERATE": 50}, {"SIG_GEN": 9, "F": 20}
    found = made(first, full, short, dict(full), short)
    assert (found.cycles, found.traffic.starts) == (full, 3)
    assert made(first).cycles == first
    assert (made().fullest, made().cycles, made().traffic) == (None, {}, Traffic())


@pytest.mark.parametrize(
    ("name", "steps", "each"),
    [
        ("pendulum", 5, ["F", "SIG_GEN", "H"]),
        ("ctrv-masked", 6, ["ITERATE"]),  # two programs of h, an angle, masks
        ("nanosat", 3, ["ITERATE"]),
    ],
)
def test_applications_with_models_on_the_core(core_cache, name, steps, each):
    """Bit for bit, in the clocks of the schedule, and with the words that were counted."""
    recipe = Recipe.of(name, models="core")
    found = cosimulate(recipe.scenario, steps, cache=core_cache, optimise=False)
    assert found.okay
    assert found.words_compared > 200
    expected = latency(recipe.params, Pipeline(), redraws=found.run.problem.redraws)
    # In the first step of ctrv nothing is sampled, so that the second draws points as well.
    regular = found.iterations[2:]
    assert all([*one.cycles] == each for one in regular)
    assert max(sum(one.cycles.values()) for one in regular) == expected["total"]
    # Inputs that have not changed are not written.
    same = 0 if name == "nanosat" else len(recipe.params.models.inputs)
    assert {one.traffic.words for one in regular} == {expected["bus_words"] - same}
    golden = run(recipe.scenario(steps), "golden", covariance=True)
    np.testing.assert_array_equal(found.run.x, golden.x)
    np.testing.assert_array_equal(found.run.P, golden.P)


def random_core(seed, sensors=1):
    """Random parameters and pipeline. Form and format go round."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 6)), int(rng.integers(1, 5))
    rows = ()
    if sensors > 1:
        m = sensors + int(rng.integers(0, 4))
        cuts = np.sort(rng.choice(np.arange(1, m), sensors - 1, replace=False))
        rows = tuple(np.diff([0, *cuts, m]).tolist())
    noises = [Noise.AUGMENTED, Noise.ADDITIVE]
    process, observation = noises[rng.integers(2)], noises[rng.integers(2)]
    params = UkfParams(
        n=n,
        m=m,
        q=int(rng.integers(0, 4)) if process is Noise.AUGMENTED else n,
        r=int(rng.integers(0, 4)) if observation is Noise.AUGMENTED else m,
        sensors=rows,
        process_noise=process,
        observation_noise=observation,
        W0=float(rng.choice([0.0, 0.25, 0.6])),
        form=(Form.SQUARE_ROOT, Form.COVARIANCE)[seed % 2],
        format=FORMATS[seed // 2 % len(FORMATS)],
    )
    pipeline = Pipeline(
        multiply=int(rng.integers(1, 6)),
        add=int(rng.integers(1, 7)),
        reciprocal_sqrt=int(rng.integers(1, 13)),
    )
    most = min(params.columns, 8 if params.format.width <= 32 else 4)
    return replace(params, pes=int(rng.integers(1, most + 1))), pipeline


def check_counts(counts, params):
    """The tasks did what they are there for."""
    used, aborted = counts["use_filter"], counts["reset_during_steps"]
    assert used["predict"] > 0
    if not used["NotPositiveDefiniteError"]:
        # In a coarse format most things may end with an error instead.
        assert used["update"] > 0
        assert used["redrawn update"] > 0
        assert used["masked update"] > 0 or params.m == 1
        assert used["covariance"] > 0
        assert all(aborted[name] > 0 for name in DROPPED)
    assert sum(aborted[name] > 0 for name in DROPPED) >= 4
    poisoned = counts["run_on_odd_words"]
    symbols = [
        "X", "x", "L", "z", "Z", *(["LQ"] if params.q else []), *(["LR"] if params.r else []),
    ]  # fmt: skip
    for symbol in symbols:
        for word in ("NaN", "NaN with payload", "infinity", "-infinity"):
            assert poisoned[f"{symbol} {word}"] > 0, (symbol, word)
    assert poisoned["code 2"] > 0
    abused = counts["access_at_random"]
    for what in ("SLVERR", "partial strobe", "start while running", "running buffer read",
                 "running buffer write", "anywhere read", "anywhere write"):  # fmt: skip
        assert abused[what] > 0, what


def do_everything(cache, seed, rounds, sensors=1):
    params, pipeline = random_core(seed, sensors)
    assert len(params.sensor_rows) == sensors
    job = Job(
        params=params,
        pipeline=pipeline,
        task="support.random_lockstep:all_at_random",
        arguments={"seed": seed, "rounds": rounds},
        interrupt=bool(seed % 3),
    )
    check_counts(run_job(job, cache=cache, optimise=False).value, params)


# Every form and format, and one sensor, are in the slow ones.
@pytest.mark.parametrize(
    ("seed", "sensors"),
    [(59, 2), pytest.param(58, 3, marks=pytest.mark.slow)],
)
def test_random_core(core_cache, seed, sensors):
    do_everything(core_cache, seed, rounds=12, sensors=sensors)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 136))
def test_random_cores(core_cache, seed):
    do_everything(core_cache, seed, rounds=60)


# Both forms, all pairs of noises, and a format of two words are among them.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "sensors"),
    [(10, 3), (13, 2), (22, 4), (24, 2), (36, 4), (47, 3), (49, 2), (203, 4), (207, 2)],
)
def test_random_cores_with_several_sensors(core_cache, seed, sensors):
    do_everything(core_cache, seed, rounds=60, sensors=sensors)


def small_core_of_models(seed):
    """A small core with models and its pipeline: every third of any steps, others of functions."""
    params, pipeline = random_core(seed, 1 + seed // 3 % 2)
    rng, of_any_steps = random.Random(seed), seed % 3 == 2
    # Functions need coefficients of their format.
    odd = ODD_FORMAT if of_any_steps else BINARY64
    one_lane = replace(params, format=(BINARY16, BFLOAT16, BINARY32, odd)[seed // 2 % 4], pes=1)
    small = replace(one_lane, pes=min(params.pes, 2, one_lane.columns))
    if of_any_steps:
        return with_models(small, any_models(rng, small, steps=10, finite=0.95)), pipeline
    return with_models(small, sane_models(rng, small)), pipeline


#: Seeds of the usual cores with models, and of those that are slow.
WITH_MODELS, MORE_WITH_MODELS = (602, 616, 619, 653), range(700, 720)


@pytest.mark.parametrize(
    "seed",
    [*WITH_MODELS, *(pytest.param(seed, marks=pytest.mark.slow) for seed in MORE_WITH_MODELS)],
)
def test_random_cores_with_models(core_cache, seed):
    params, pipeline = small_core_of_models(seed)
    job = Job(
        params=params, pipeline=pipeline, task="support.random_lockstep:models_at_random",
        arguments={"seed": seed, "rounds": 60},
    )  # fmt: skip
    counts = run_job(job, cache=core_cache, optimise=False).value
    for step in ("ITERATE", "F", "H"):
        assert sum(counts[f"{step} code {code}"] for code in range(7)) > 0
        assert any(counts[f"reset of {step} in program {number}"] for number in range(4))
    assert counts["ITERATE code 1"] + counts["F code 1"] + counts["H code 1"] > 0
    assert counts["masked"] > 0
    assert counts["words compared"] > 1000


@pytest.mark.parametrize("seeds", [WITH_MODELS, MORE_WITH_MODELS], ids=["usual", "slow"])
def test_random_cores_with_models_are_of_every_kind(seeds):
    """Few cores stand for many only if what they have in common is little."""
    cores = [small_core_of_models(seed)[0] for seed in seeds]
    assert len(cores) >= (20 if seeds is MORE_WITH_MODELS else 4)
    assert {(core.form, len(core.sensor_rows)) for core in cores} == {
        (form, sensors) for form in Form for sensors in (1, 2)
    }
    assert {core.pes for core in cores} == {1, 2}
    assert len({core.format for core in cores}) >= (5 if seeds is MORE_WITH_MODELS else 3)
    assert {core.W0 == 0.0 for core in cores} == {True, False}
    for noise in ("process_noise", "observation_noise"):
        assert {getattr(core, noise) for core in cores} == {Noise.AUGMENTED, Noise.ADDITIVE}
    # Programs of any steps, and of functions, which read the unit 1/sqrt and the inputs.
    assert {seed % 3 == 2 for seed in seeds} == {True, False}
    assert any(len(variants) > 1 for core in cores for variants in core.models.h)
    assert any(core.models.roots for core in cores)
    assert any(len({*core.sensor_rows}) > 1 for core in cores)


@pytest.mark.slow
def test_second_run_does_not_compile(tmp_path):
    params = UkfParams(n=1, m=1)
    # Make knows no blanks in names.
    cache = tmp_path / "a folder"
    found = [run_core(cache, params, name=None, steps=2) for _ in range(2)]
    assert [each.build.compiled for each in found] == [True, False]
    assert found[0].build.folder == found[1].build.folder
    np.testing.assert_array_equal(found[0].run.x, found[1].run.x)


@pytest.mark.slow
def test_pipeline_changes_cycles_only(core_cache):
    params = UkfParams(n=2, m=1, q=1, r=1, pes=2)
    deep = Pipeline(multiply=5, add=6, reciprocal_sqrt=12)
    found = []
    for pipeline in (Pipeline(), deep):
        found.append(run_core(core_cache, params, name=None, pipeline=pipeline))
        check(found[-1], params, 3, pipeline)
    np.testing.assert_array_equal(found[0].run.x, found[1].run.x)
    assert all(
        latency(params, deep, redraws=redraws)["total"]
        > latency(params, Pipeline(), redraws=redraws)["total"]
        for redraws in (False, True)
    )


def test_a_difference_is_found(core_cache):
    """A wrong word in the model's memory is as good as one in the core's."""
    params = UkfParams(n=2, m=1, q=1, r=1, pes=2)
    job = Job(params=params, task="support.random_lockstep:change_model", arguments={})
    with pytest.raises(SimulatorError, match=r"MismatchError: .* of the core is .* golden model"):
        run_job(job, cache=core_cache, optimise=False)


def test_wrong_verilog_is_reported(tmp_path):
    from ukf_sim.builds import build

    source = tmp_path / "broken.v"
    source.write_text("module broken(; endmodule\n", encoding="utf-8")
    with pytest.raises(SimulatorError, match="failed to compile"):
        build(source, "broken", Simulator.VERILATOR, tmp_path / "cache")


def test_module_without_tests_is_reported(core_cache, tmp_path):
    from ukf_hdl.generate import NAME, generate
    from ukf_sim.builds import build
    from ukf_sim.cocotb_run import run_cocotb

    generate(UkfParams(n=2, m=1, q=1, r=1, pes=2), None, tmp_path)
    source = tmp_path / f"{NAME}.v"
    compiled = build(source, NAME, Simulator.VERILATOR, core_cache, optimise=False)
    with pytest.raises(SimulatorError, match=r"cocotb|[Nn]o test"):
        run_cocotb(compiled, "ukf_sim.session", tmp_path / "run")


def test_missing_simulator_is_reported(monkeypatch, tmp_path):
    from ukf_sim.builds import build

    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SimulatorError, match="icarus is not installed"):
        build(tmp_path / "x.v", "x", Simulator.ICARUS, tmp_path)


def test_overhead_of_steps_is_the_same_for_all():
    """CYCLES counts a few clocks more than there are words, whatever the program."""
    code = microcode(NANOSAT, Pipeline())
    extra = {
        code.clocks(*routine) - code.programs[routine].plan.length
        for routine in code.programs
        if routine.program is not Program.UPDATE_REDRAWN
    }
    assert len(extra) == 1
