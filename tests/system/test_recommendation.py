"""Which numbers of processing elements are worth their place."""

import random
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import pytest

from support.model_cores import model_core
from support.random_cores import random_configuration
from ukf_sw.engine.layout import Layout
from ukf_sw.problems.systems.nanosat import NANOSAT
from ukf_sw.spec.model_programs import NO_MODELS
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams
from ukf_tools.estimate.latency import latency
from ukf_tools.estimate.recommendation import RULE, candidates, choices, recommended


@pytest.mark.parametrize("seed", range(20))
def test_no_recommended_number_is_beaten(seed):
    """Neither by fewer that are as fast, nor by more that give more for each."""
    rng = random.Random(seed)
    cycles = {pes: rng.randint(100, 2000) + 4000 // pes for pes in range(1, rng.randint(2, 30))}
    found = recommended(cycles)
    assert found == sorted(found)
    assert found
    for chosen in found:
        for pes in cycles:
            assert pes >= chosen or cycles[pes] > cycles[chosen]
            assert pes <= chosen or pes * cycles[pes] >= chosen * cycles[chosen]
    for before, after in pairwise(found):
        gain = Fraction(cycles[before], cycles[after]) - 1
        assert gain >= (Fraction(after, before) - 1) / 3


def test_what_is_recommended():
    assert recommended({1: 900, 2: 450, 3: 300}) == [1, 2, 3]
    assert recommended({1: 900, 2: 450, 3: 450, 4: 225}) == [1, 2, 4]
    # Twice as many must be a third faster.
    assert recommended({1: 400, 2: 300}) == [1, 2]
    assert recommended({1: 400, 2: 301}) == [1]
    # 3 lanes are better used by 4.
    assert recommended({1: 900, 3: 330, 4: 226}) == [1, 4]
    assert recommended({7: 10}) == [7]
    assert recommended({}) == []
    assert "third" in RULE


@pytest.mark.parametrize(
    "params",
    [
        UkfParams(n=2, m=1),
        NANOSAT,
        UkfParams(n=15, m=6, q=15, r=6),
        UkfParams(n=20, m=9, q=20, r=9, form=Form.COVARIANCE, process_noise=Noise.ADDITIVE),
    ],
    ids=lambda params: f"{params.columns} columns",
)
def test_candidates(params):
    """All that are legal, or those that need fewer beats for something than one less."""
    found = candidates(params)
    legal = range(1, params.columns + 1)
    for pes in legal:
        replace(params, pes=pes)
    with pytest.raises(ValueError, match="pes must be"):
        replace(params, pes=params.columns + 1)
    if params.columns <= 32:
        assert found == list(legal)
        return
    layout = Layout(params)
    lengths = [params.columns]
    if params.form is Form.COVARIANCE:
        lengths += [layout.joint_rhs, layout.joint_rhs + 1]

    def beats(pes):
        return [-(-length // pes) for length in lengths]

    assert found == [pes for pes in legal if pes == 1 or beats(pes) != beats(pes - 1)]
    assert len(found) < len(legal)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("redraws", [False, True])
def test_cycles_are_those_of_the_core(seed, redraws):
    params, pipeline = random_configuration(random.Random(800 + seed), largest=2)
    found = choices(params, pipeline, redraws=redraws)
    assert [each.pes for each in found] == list(range(1, params.columns + 1))
    for each in random.Random(seed).sample(found, 2):
        core = replace(params, pes=each.pes)
        assert each.cycles == latency(core, pipeline, redraws=redraws)["total"]
        assert each.beats == -(-Layout(core).columns // each.pes)
        assert each.speedup_per_pe == found[0].cycles / each.cycles / each.pes
    cycles = {each.pes: each.cycles for each in found}
    assert [each.pes for each in found if each.recommended] == recommended(cycles)


@pytest.mark.parametrize(
    ("which", "redraws"), [(("f", "h"), False), (("f", "h"), True), (("h",), False)]
)
def test_cycles_count_the_models(which, redraws):
    params = model_core("battery", which)
    found = choices(params, Pipeline(), redraws=redraws)
    bare = choices(replace(params, models=NO_MODELS), Pipeline(), redraws=redraws)
    for each, other in list(zip(found, bare, strict=True))[::5]:
        assert (
            each.cycles
            == latency(replace(params, pes=each.pes), Pipeline(), redraws=redraws)["total"]
        )
        assert each.cycles > other.cycles


def test_progress_is_told():
    told = []
    found = choices(
        UkfParams(n=1, m=1), Pipeline(), redraws=False, tell=lambda *done: told.append(done)
    )
    assert told == [(number, len(found)) for number in range(len(found))]
