"""Number formats: IEEE 754 binary interchange formats with subnormals flushed to zero."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["BFLOAT16", "BINARY16", "BINARY32", "BINARY64", "FORMATS", "FloatFormat"]


@dataclass(frozen=True, kw_only=True)
class FloatFormat:
    """A binary floating-point format.

    Numbers are laid out as in IEEE 754: sign, biased exponent, fraction. Subnormal numbers read
    as a zero of their sign and are never produced. There is one NaN (:attr:`nan`), so equal
    results are equal words.

    Every value of every legal format is also a float64, which is how the golden model holds it;
    :meth:`encode` and :meth:`decode` go from one to the other.

    Parameters
    ----------
    exponent_bits
        Width of the exponent, 4 to 11.
    fraction_bits
        Width of the fraction without the hidden bit, 5 to 52.

    Raises
    ------
    ValueError
        If a width is out of range.
    """

    exponent_bits: int
    fraction_bits: int

    def __post_init__(self) -> None:
        if self.exponent_bits not in range(4, 12):
            raise ValueError(f"Exponent bits must be between 4 and 11, not {self.exponent_bits!r}")
        if self.fraction_bits not in range(5, 53):
            raise ValueError(f"Fraction bits must be between 5 and 52, not {self.fraction_bits!r}")

    @staticmethod
    def from_name(name: str) -> "FloatFormat":
        """Give the format of a :attr:`name`: a usual one, or widths as in float6.17.

        Raises
        ------
        ValueError
            If it is neither.
        """
        if name in FORMATS:
            return FORMATS[name]
        exponent, point, fraction = name.removeprefix("float").partition(".")
        widths = exponent.isdecimal() and fraction.isdecimal()
        if not (name.startswith("float") and point and widths):
            known = ", ".join(FORMATS)
            raise ValueError(f"format must be one of {known}, or like float6.17, not {name!r}")
        return FloatFormat(exponent_bits=int(exponent), fraction_bits=int(fraction))

    @property
    def width(self) -> int:
        """Width of a word in bits."""
        return 1 + self.exponent_bits + self.fraction_bits

    @property
    def precision(self) -> int:
        """Bits of the significand, the hidden bit included."""
        return self.fraction_bits + 1

    @property
    def bias(self) -> int:
        """What is added to an exponent to store it."""
        return (1 << (self.exponent_bits - 1)) - 1

    @property
    def max_exponent_field(self) -> int:
        """Exponent field of infinity and NaN: all ones."""
        return (1 << self.exponent_bits) - 1

    @property
    def infinity(self) -> int:
        """Word of plus infinity."""
        return self.max_exponent_field << self.fraction_bits

    @property
    def nan(self) -> int:
        """Word of the one NaN: positive, quiet, no payload."""
        return self.infinity | 1 << (self.fraction_bits - 1)

    @property
    def min_normal(self) -> float:
        """Smallest positive normal number."""
        return 2.0 ** (1 - self.bias)

    @property
    def max_finite(self) -> float:
        """Largest finite number."""
        return (2.0 - 2.0**-self.fraction_bits) * 2.0**self.bias

    @property
    def epsilon(self) -> float:
        """Distance from 1 to the next larger number."""
        return 2.0**-self.fraction_bits

    @property
    def bus_words(self) -> int:
        """Number of 32-bit bus words that carry one number."""
        return (self.width + 31) // 32

    @property
    def name(self) -> str:
        """Usual name of the format, or its widths."""
        for name, known in FORMATS.items():
            if known == self:
                return name
        return f"float{self.exponent_bits}.{self.fraction_bits}"

    def encode(self, values: ArrayLike) -> NDArray[np.uint64]:
        """Round numbers to the format (to nearest, ties to even) and give their words.

        Parameters
        ----------
        values
            Numbers, any shape.

        Returns
        -------
        array of uint64
            Words, same shape. What is below the smallest normal number *after* rounding to
            :attr:`precision` bits becomes a zero of its sign.
        """
        shift = np.uint64(52 - self.fraction_bits)
        bits = np.asarray(values, dtype=np.float64).view(np.uint64)
        sign = (bits >> np.uint64(63)) << np.uint64(self.width - 1)
        magnitude = bits & np.uint64((1 << 63) - 1)
        half = (np.uint64(1) << shift) >> np.uint64(1)
        if shift:
            odd = (magnitude >> shift) & np.uint64(1)
            rounded = magnitude + half - np.uint64(1) + odd
        else:
            rounded = magnitude
        rebias = (1023 - self.bias) << self.fraction_bits
        word = (rounded >> shift).astype(np.int64) - np.int64(rebias)
        # The test on the value is for subnormal float64 numbers, which have no hidden bit.
        tiny = (word < np.int64(1 << self.fraction_bits)) | (
            np.abs(values) < self.min_normal * (1.0 - self.epsilon / 4)
        )
        large = word >= np.int64(self.infinity)
        word = np.where(tiny, 0, np.where(large, self.infinity, word)).astype(np.uint64) | sign
        return np.where(np.isnan(values), np.uint64(self.nan), word)

    def decode(self, words: ArrayLike) -> NDArray[np.float64]:
        """Give the numbers that words stand for.

        Parameters
        ----------
        words
            Words, any shape; bits above :attr:`width` are ignored.

        Returns
        -------
        array of float64
            Exact values, same shape; subnormal words read as zeros of their sign.
        """
        bits = np.asarray(words).astype(np.uint64)
        fraction = bits & np.uint64((1 << self.fraction_bits) - 1)
        exponent = (bits >> np.uint64(self.fraction_bits)) & np.uint64(self.max_exponent_field)
        sign = (bits >> np.uint64(self.width - 1) & np.uint64(1)) << np.uint64(63)
        wide = fraction << np.uint64(52 - self.fraction_bits)
        rebiased = (exponent + np.uint64(1023 - self.bias)) << np.uint64(52)
        special = exponent == np.uint64(self.max_exponent_field)
        word = np.where(special, np.uint64(0x7FF << 52) | wide, rebiased | wide)
        word = np.where(exponent == 0, np.uint64(0), word) | sign
        values = np.asarray(word, dtype=np.uint64).view(np.float64)
        return np.where(special & (fraction != 0), np.nan, values)

    def round(self, values: ArrayLike) -> NDArray[np.float64]:
        """Round numbers to the format, as :meth:`encode` does, and give them as float64."""
        return self.decode(self.encode(values))


BINARY16 = FloatFormat(exponent_bits=5, fraction_bits=10)
BFLOAT16 = FloatFormat(exponent_bits=8, fraction_bits=7)
BINARY32 = FloatFormat(exponent_bits=8, fraction_bits=23)
BINARY64 = FloatFormat(exponent_bits=11, fraction_bits=52)

#: Formats that the command line knows by name.
FORMATS = {
    "binary16": BINARY16,
    "bfloat16": BFLOAT16,
    "binary32": BINARY32,
    "binary64": BINARY64,
}
