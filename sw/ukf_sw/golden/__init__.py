"""Golden model of the whole core: what every word of the hardware must be."""

from ukf_sw.golden.bus import GoldenBus
from ukf_sw.golden.core import GoldenCore

__all__ = ["GoldenBus", "GoldenCore"]
