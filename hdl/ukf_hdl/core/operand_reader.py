"""Operand reader: what a lane makes of its two words beyond taking them as they are."""

from amaranth import Cat, Const, Module, Mux, Signal
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from ukf_hdl.arithmetic.float_layout import FloatLayout

__all__ = ["CONDITIONS", "READINGS", "OperandReader"]

#: Steering of operand b, beside its subtraction.
READINGS = (
    "one", "power", "exponent", "clear_sign", "copy_sign", "turn_bit_0", "turn_bit_1",
)  # fmt: skip
#: Steering of what is kept, as far as words decide it.
CONDITIONS = ("if_negative", "if_not_negative", "if_odd")


class OperandReader(wiring.Component):
    """Makes operand b of a lane, and decides by its words whether it keeps what it has.

    All without a clock. What :py:`one`, :py:`power` and :py:`exponent` make of the second word is
    in :class:`ukf_sw.spec.forms.Reading`; without them it is the word. Then the sign of `b`
    becomes plus if :py:`clear_sign`, that of the first word if :py:`copy_sign` too; and it is
    turned if :py:`turn_bit_0` and bit 0 of the first word, if :py:`turn_bit_1` and its bit 1, and
    if :py:`subtract`.

    :py:`keep` is high if the second word has its sign not set at :py:`if_negative`, has it set at
    :py:`if_not_negative`, or its bit 0 is not set at :py:`if_odd`.

    Signs and bits are those of the number that a word stands for: a subnormal number is a zero of
    its sign, any NaN is the one NaN of the format, whose sign is plus. A `b` that is NaN may be
    any word of NaN, of either sign.

    In a format with more bits of fraction than its bias, there is no integer for :py:`exponent`,
    which means nothing then, and every finite number gives zero at :py:`power`.

    Parameters
    ----------
    fmt : :class:`FloatFormat`
        Number format.
    steering : iterable of :class:`str`
        Those of :data:`ukf_sw.engine.control_word.STEERING` that there are.

    Members
    -------
    word_0, word_1 : :py:`In(fmt.width)`
        Words that were read.
    steering : :py:`In(StructLayout(...))`
        What to make of them. At most one of :py:`one`, :py:`power` and :py:`exponent` is high, and
        at most one condition.
    b : :py:`Out(fmt.width)`
        Operand.
    keep : :py:`Out(1)`
        The condition is not met.
    """

    def __init__(self, fmt, steering):
        self._fmt = fmt
        self._names = tuple(steering)
        super().__init__({
            "word_0":   In(fmt.width),
            "word_1":   In(fmt.width),
            "steering": In(data.StructLayout(dict.fromkeys(self._names, 1))),
            "b":        Out(fmt.width),
            "keep":     Out(1),
        })  # fmt: skip

    def elaborate(self, platform):
        m = Module()
        number = FloatLayout(self._fmt)
        word_0 = number(self.word_0)
        word_1 = number(self.word_1)
        m.d.comb += [
            self.b.eq(Cat(self._magnitude(m, word_1), self._sign(word_0, word_1))),
            self.keep.eq(self._keep(word_1)),
        ]
        return m

    def _present(self, *names):
        """Those of some steering inputs that there are."""
        return [self.steering[name] for name in names if name in self._names]

    def _bit(self, word, number):
        """A bit of a number; those of infinity and NaN are zero."""
        return word.fraction[number] & ~word.is_zero & word.is_finite

    def _magnitude(self, m, word_1):
        """What is constant is chosen last: to a register behind it that is its set and reset."""
        fmt = self._fmt
        fraction, exponent = word_1.fraction, word_1.exponent
        if moved := self._present("power", "exponent"):
            exponent = exponent & ~Cat(moved).any().replicate(len(exponent))
        for steer in self._present("exponent"):
            special = Signal()
            nan = Signal()
            m.d.comb += [
                nan.eq(steer & (~word_1.is_finite | (word_1.sign & ~word_1.is_zero))),
                special.eq(nan | (steer & word_1.is_zero)),
            ]
            integer = min(fmt.bias + fmt.fraction_bits, fmt.max_exponent_field)
            exponent = exponent | special.replicate(len(exponent))
            exponent = exponent | (Const(integer, len(exponent)) & steer.replicate(len(exponent)))
            fraction = Mux(steer, self._integer_fraction(word_1), fraction)
            fraction = Mux(special, self._special_fraction(nan), fraction)
        for steer in self._present("power"):
            nan = steer & word_1.is_nan
            exponent = exponent | self._power_exponent(m, steer, word_1)
            fraction = Mux(steer, self._special_fraction(nan), fraction)
        magnitude = Cat(fraction, exponent)
        for steer in self._present("one"):
            magnitude = Mux(steer, Const(fmt.bias << fmt.fraction_bits, fmt.width - 1), magnitude)
        return magnitude

    def _special_fraction(self, nan):
        return Cat(Const(0, self._fmt.fraction_bits - 1), nan)

    def _sign(self, word_0, word_1):
        sign = word_1.sign
        if plus := self._present("one", "power", "exponent", "clear_sign"):
            sign = sign & ~Cat(plus).any()
        for steer in self._present("exponent"):  # of minus infinity
            minus = steer & word_1.is_zero
            for clear in self._present("clear_sign"):
                minus = minus & ~clear
            sign = sign | minus
        for steer in self._present("copy_sign"):
            sign = sign | (steer & word_0.sign & ~word_0.is_nan)
        for number in range(2):
            for steer in self._present(f"turn_bit_{number}"):
                sign = sign ^ (steer & self._bit(word_0, number))
        return sign ^ self.steering.subtract

    def _power_exponent(self, m, steer, word_1):
        """Exponent of the power of two that an integer stands for; zero if it is another number."""
        fmt = self._fmt
        E, F = fmt.exponent_bits, fmt.fraction_bits
        all_ones = Signal()
        exact = Signal()
        # Where all numbers are integers, bits below the top one of the fraction say how far it is
        # from the middle; those that are more than an exponent has repeat its top bit, inverted.
        top = word_1.fraction[-1]
        low = word_1.fraction[: min(E, F) - 1]
        surplus = word_1.fraction[len(low) : -1]
        field = Cat(low, (~top).replicate(E - 1 - len(low)), top)
        if fmt.bias < F:
            is_large = ~word_1.is_finite
        else:
            is_integer = steer & ~word_1.sign & (word_1.exponent == fmt.bias + F)
            fits = surplus == (~top).replicate(len(surplus))
            m.d.comb += exact.eq(is_integer & fits)
            is_large = (word_1.exponent > fmt.bias + F) | (is_integer & ~fits & top)
        m.d.comb += all_ones.eq(steer & ((~word_1.sign & is_large) | word_1.is_nan))
        return (field & exact.replicate(E)) | all_ones.replicate(E)

    def _integer_fraction(self, word_1):
        """Fraction of the integer that an exponent makes."""
        F = self._fmt.fraction_bits
        field = word_1.exponent[-F:]
        low, top = field[:-1], field[-1]
        return Cat(low, (~top).replicate(F - len(field)), top)

    def _keep(self, word_1):
        is_negative = word_1.sign & ~word_1.is_nan
        keep = Const(0, 1)
        for steer in self._present("if_negative"):
            keep = keep | (steer & ~is_negative)
        for steer in self._present("if_not_negative"):
            keep = keep | (steer & is_negative)
        for steer in self._present("if_odd"):
            keep = keep | (steer & ~self._bit(word_1, 0))
        return keep
