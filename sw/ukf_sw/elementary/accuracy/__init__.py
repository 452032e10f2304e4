"""Largest errors of the elementary functions that have been found, by number format.

``make elementary`` measures them and writes the file of this folder, which the table of the
documents is made of as well.
"""

import json
from functools import cache
from importlib.resources import files

from ukf_sw.spec.float_format import FloatFormat

__all__ = ["largest_error"]


@cache
def _records() -> dict[str, dict[str, dict[str, float]]]:
    return json.loads(files(__name__).joinpath("elementary.json").read_text(encoding="utf-8"))


def largest_error(function: str, fmt: FloatFormat) -> float | None:
    """Give the largest error of a function, in units in the last place of the exact result.

    Parameters
    ----------
    function
        Its name, as in :data:`ukf_sw.elementary.functions.FUNCTIONS`.
    fmt
        Number format.

    Returns
    -------
    float or None
        None if nobody has measured it: it is exact, or the format is an unusual one.
    """
    found = _records().get(function, {}).get(fmt.name)
    return None if found is None else found["error"]
