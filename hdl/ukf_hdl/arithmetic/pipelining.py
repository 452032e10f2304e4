"""Optional registers along a datapath."""

from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

from amaranth import Signal

__all__ = ["CutPoints", "delay"]

Travelling = TypeVar("Travelling")


class CutPoints:
    """Places the pipeline registers of a unit.

    A unit is written as combinational logic with named places where a register may stand. Which of
    them do is looked up by the number of stages; registers that find no place go to the output.

    Registers have no reset: what they hold is meaningful only as many clocks after an input as the
    unit has stages.

    Parameters
    ----------
    m : :class:`Module`
        Module of the unit.
    stages : :class:`int`
        Registers between input and output, at least 1. One is at the output.
    cuts : :class:`dict`
        Names of the places to use, for each number of stages up to some largest one. An entry for
        :py:`n` stages has at most :py:`n - 1` names.
    """

    def __init__(self, m, stages, cuts):
        self._m = m
        self._cuts = cuts[min(stages, max(cuts))]
        self._output_registers = stages - len(self._cuts)

    def uses(self, name):
        """Whether a register stands at the place of this name."""
        return name in self._cuts

    def cut(self, name: str, value: Travelling) -> Travelling:
        """Pass what travels together through registers if the place of this name is in use.

        Everything that is used later must go through every place.

        Parameters
        ----------
        name : :class:`str`
            Name of the place.
        value : value-like, :class:`tuple` or dataclass
            A value, or values that travel together. Each gets a register of its own, which
            simulators handle faster than the parts of a wide one.
        """
        return self._registers(value, name) if name in self._cuts else value

    def output(self, target, value):
        """Drive an output through the remaining registers."""
        for _ in range(self._output_registers):
            value = self._registers(value, "output")
        self._m.d.comb += target.eq(value)

    def _registers(self, value: Any, name: str) -> Any:
        if is_dataclass(value):
            parts = {field.name: getattr(value, field.name) for field in fields(value)}
            return type(value)(**{
                part: self._registers(inner, f"{name}_{part}") for part, inner in parts.items()
            })  # fmt: skip
        if isinstance(value, tuple):
            return tuple(
                self._registers(inner, f"{name}_{index}") for index, inner in enumerate(value)
            )
        register = Signal(value.shape(), name=f"{name}_register", reset_less=True)
        self._m.d.sync += register.eq(value)
        return register


def delay(m, value, clocks, name):
    """Give a value some clocks later.

    The last register has a reset, which keeps it out of a shift register: those are slow to leave.

    Parameters
    ----------
    m : :class:`Module`
        Module that has the value.
    value : value-like
        What to delay.
    clocks : :class:`int`
        How long; 0 gives the value itself.
    name : :class:`str`
        Name of the registers.
    """
    for left in reversed(range(clocks)):
        register = Signal(value.shape(), name=name, reset_less=left > 0)
        m.d.sync += register.eq(value)
        value = register
    return value
