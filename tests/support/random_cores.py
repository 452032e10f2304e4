"""Cores at random."""

import dataclasses

import numpy as np

from ukf_sw.spec.float_format import BFLOAT16, BINARY16, BINARY32, BINARY64
from ukf_sw.spec.parameters import Form, Noise, Pipeline, UkfParams

__all__ = ["random_configuration"]


def random_configuration(rng, largest=5):
    """Parameters and pipeline of any core up to these sizes.

    Parameters
    ----------
    rng : random.Random
        Where chance comes from.
    largest : int
        Largest number of states, observations and noise terms.
    """
    n, m = rng.randint(1, largest), rng.randint(1, largest)
    # Where one sensor ends and another begins.
    cuts = sorted(rng.sample(range(1, m), rng.randint(0, m - 1))) if rng.random() < 0.5 else []
    process, observation = rng.choice(list(Noise)), rng.choice(list(Noise))
    params = UkfParams(
        n=n,
        m=m,
        q=rng.choice([0, n]) if process is Noise.ADDITIVE else rng.randint(0, largest),
        r=rng.choice([0, m]) if observation is Noise.ADDITIVE else rng.randint(0, largest),
        sensors=tuple(np.diff([0, *cuts, m]).tolist()),
        process_noise=process,
        observation_noise=observation,
        form=rng.choice(list(Form)),
        W0=rng.choice([0.0, 0.5]),
        format=rng.choice([BINARY32, BINARY32, BINARY16, BFLOAT16, BINARY64]),
    )
    pipeline = Pipeline(
        multiply=rng.randint(1, 5), add=rng.randint(1, 6), reciprocal_sqrt=rng.randint(1, 9)
    )
    return dataclasses.replace(params, pes=rng.randint(1, params.columns + 1)), pipeline
