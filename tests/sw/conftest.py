"""Fixtures of the software tests."""

import functools

import pytest

from support.sequential import Arithmetic, Sequential


@pytest.fixture
def sequential():
    """Programs as they are meant, computed with the golden model's arithmetic."""
    # Here, because tests of the base run without it.
    from ukf_sw.engine.arithmetic import add, multiply, reciprocal_sqrt

    return functools.partial(Sequential, arithmetic=Arithmetic(add, multiply, reciprocal_sqrt))
