"""What the comparison assumes, and how its figures are written."""

__all__ = ["CORE_MHZ", "PROCESSOR_MHZ", "WORD_CLOCKS", "as_range"]

#: Clocks of processor and core in MHz, the papers'.
PROCESSOR_MHZ, CORE_MHZ = 667.0, 100.0
#: Clocks of the core that a word takes on the 2018 paper's bus: 116 us for 726 words, and so on.
WORD_CLOCKS = 15.6


def as_range(bounds: list[float], digits: int = 0) -> str:
    """Write a bracket."""
    low, high = (f"{bound:.{digits}f}" for bound in bounds)
    return low if low == high else f"{low} – {high}"
