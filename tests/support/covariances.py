"""Covariances to try a factorisation with."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["random_covariances"]


def random_covariances(dtype: type) -> Iterator[NDArray[Any]]:
    """Matrices that are covariances but for rounding to a type, of all ranks and scales."""
    rng = np.random.default_rng(12)
    for trial in range(300):
        size = int(rng.integers(1, 12))
        scales = 10.0 ** rng.integers(-4, 5, size) if trial % 3 else np.ones(size)
        if trial % 2:
            # Rotated, with eigenvalues from 1 to 1e-18.
            turn, _ = np.linalg.qr(rng.standard_normal((size, size)))
            A = (turn * np.logspace(0, -18, size)) @ turn.T * np.outer(scales, scales)
            yield np.asarray((A + A.T) / 2.0, dtype)
        else:
            g = rng.standard_normal((size, int(rng.integers(1, size + 1)))) * scales[:, None]
            g[rng.integers(size)] *= trial % 8 != 0  # a state without uncertainty
            g = g.astype(dtype)
            yield g @ g.T
