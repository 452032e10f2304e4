"""Leading zeros and left shifts in digits of two bits, as LUTs of six inputs like them."""

from dataclasses import dataclass

from amaranth import Cat, Mux, Signal, Value

__all__ = [
    "Coarse",
    "leading_units_digit",
    "normalisation_digits",
    "select",
    "shift_left_digit",
]


@dataclass(frozen=True, eq=False)
class Coarse:
    """A count of leading zeros without its lowest digit.

    Parameters
    ----------
    sixteens, fours : :class:`Value`
        Its digits.
    """

    sixteens: Value
    fours: Value

    @property
    def value(self):
        """Number of fours in all."""
        return Cat(self.fours, self.sixteens)


def normalisation_digits(m, value):
    """Count leading zeros in groups of four.

    Parameters
    ----------
    m : :class:`Module`
        Module to add logic to.
    value : :class:`Signal`
        Number of up to 64 bits.

    Returns
    -------
    (coarse, is_zero)
        A shift to the left by :py:`16 * coarse.sixteens + 4 * coarse.fours` brings the leading one
        into the top four bits. If the number is zero, only :py:`is_zero` has a meaning.
    """
    top = len(value)
    groups = [value[max(0, end - 4) : end].any() for end in range(top, 0, -4)]
    blocks = [groups[start : start + 4] for start in range(0, len(groups), 4)]

    # The digit of every block is found before it is known which block counts.
    any_set = Signal(len(blocks))
    digits = [_first(m, Cat(*block), f"fours_{index}") for index, block in enumerate(blocks)]
    m.d.comb += any_set.eq(Cat(Cat(*block).any() for block in blocks))

    sixteens = _first(m, any_set, "sixteens")
    fours = Signal(2)
    with m.Switch(sixteens):
        for index, digit in enumerate(digits):
            with m.Case(index):
                m.d.comb += fours.eq(digit)
    return Coarse(sixteens, fours), ~any_set.any()


def leading_units_digit(m, value):
    """Count leading zeros of a number whose leading one is among its top four bits.

    Parameters
    ----------
    m : :class:`Module`
        Module to add logic to.
    value : :class:`Signal`
        Number of at least four bits.

    Returns
    -------
    :class:`Signal`
        Leading zeros, 0 to 3.
    """
    return _first(m, value[-4:][::-1], "ones")


def shift_left_digit(m, value, digit, unit):
    """Shift to the left by :py:`digit * unit`; bits shifted out are lost.

    Parameters
    ----------
    m : :class:`Module`
        Module to add logic to.
    value : :class:`Signal`
        Number to shift.
    digit : :class:`Signal`
        Number of units.
    unit : :class:`int`
        Bits of one unit.

    Returns
    -------
    :class:`Signal`
        Shifted number, of the same width.
    """
    shifted = Signal(len(value), name=f"shifted_left_{unit}")
    m.d.comb += shifted.eq(
        select(digit, [value << (count * unit) for count in range(1 << len(digit))])
    )
    return shifted


def select(index, options):
    """Multiplexer, as a tree of multiplexers of two, which maps to fewer LUTs than a switch.

    Parameters
    ----------
    index : :class:`Value`
        Which option.
    options : :class:`list`
        As many values as the index has.

    Returns
    -------
    :class:`Value`
        The chosen one.
    """
    for bit in index:
        options = [Mux(bit, odd, even) for even, odd in zip(*[iter(options)] * 2, strict=True)]
    (chosen,) = options
    return chosen


def _first(m, flags, name):
    """Index of the lowest set bit of up to four; the last index if none is set."""
    last = len(flags) - 1
    index = Signal(range(max(2, last + 1)), name=name)
    m.d.comb += index.eq(last)
    for position in reversed(range(last)):
        with m.If(flags[position]):
            m.d.comb += index.eq(position)
    return index
