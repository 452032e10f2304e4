"""Memory map of the core as the processor sees it: the register block, then the buffer.

The map depends on the sizes and the number format only, never on the number of processing
elements. A buffer address is made of bit fields, from the top: region, row, column, byte::

    region | row | column | 00      (one more zero for formats of 64 bits)

so every row stride is a power of two, and region 0 is the register block.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

from ukf_sw.spec.parameters import UkfParams
from ukf_sw.spec.sequence import NO_BANK, NO_FLAG, Bank, Flag

__all__ = ["FirstColumn", "MemoryMap", "Region"]

_BANKS = {"x": Bank.STATE, "L": Bank.FACTOR}
_FORGETS = {
    "x": Flag.POINTS | Flag.RESIDUALS,
    "L": Flag.POINTS | Flag.RESIDUALS | Flag.PREDICTED,
}


class FirstColumn(Enum):
    """What column 0 of a region is. With W0 = 0 there is no sigma point 0 to be stored."""

    STORED = "stored"  #: As all others.
    STATE = "state"  #: x: row i reads as state i, and writes are dropped.
    EMPTY = "empty"  #: Reads as zero, and writes are dropped.


@dataclass(frozen=True, kw_only=True)
class Region:
    """A matrix in the buffer; x is a matrix of one row, z of one column.

    Parameters
    ----------
    symbol
        Letter of the equations, and name in the C header.
    name
        What it is, spelled out; the name in the hardware.
    index
        Value of the region field of its addresses.
    rows, columns
        Shape. Elements outside are unmapped.
    doc
        Meaning, for the documentation.
    bank
        Bank that says which of its copies is the current one, which is what the bus sees.
    forgets
        Flags that a write to it clears: what the memories held then belongs to another estimate.
    first_column
        What its column 0 is.
    """

    symbol: str
    name: str
    index: int
    rows: int
    columns: int
    doc: str
    bank: Bank = NO_BANK
    forgets: Flag = NO_FLAG
    first_column: FirstColumn = FirstColumn.STORED


#: Without W0.
_FIRST_COLUMNS = {
    "X": FirstColumn.STATE,
    "W": FirstColumn.EMPTY,
    "V": FirstColumn.EMPTY,
    "Z": FirstColumn.EMPTY,
}


@dataclass(frozen=True)
class MemoryMap:
    """Where everything is for a set of parameters."""

    params: UkfParams

    @cached_property
    def regions(self) -> tuple[Region, ...]:
        """Regions that exist for these parameters, by rising address."""
        p = self.params
        first = p.points.start
        written = (
            f"SIG_GEN and UPDATE write columns {first} to n + 1 = {p.n + 1} only; the others are "
            "to be read as column 0."
        )
        if p.models:
            written = "SIG_GEN and UPDATE write all of them."
        taken = f"PREDICT takes all {p.N}."
        state, empty = "", ""
        if first:
            state = "Column 0 is x, and writes to it are dropped: with W0 = 0 it has no weight. "
            empty = " Column 0 is zero, and writes to it are dropped."
            taken = f"PREDICT takes columns 1 to {p.N - 1}."
        factor_of_r = "Lower triangular factor of R."
        if p.sensors and p.additive_r:
            factor_of_r = (
                "Lower triangular factors of the R of each sensor, one below the other; each "
                "begins in column 0."
            )
        first_columns = _FIRST_COLUMNS if first else {}
        table = (
            ("X", "state_points", p.n, p.N,
             f"Sigma points of the state, row i is state i. {state}{written} {taken}"),
            ("W", "process_noise_points", p.augmented_q, p.N,
             f"Sigma points of the process noise.{empty}"),
            ("V", "observation_noise_points", p.augmented_r, p.N,
             f"Sigma points of the observation noise.{empty}"),
            ("Z", "observation_points", p.m, p.N, f"Sigma points seen through h.{empty}"),
            ("z", "observation", p.m, 1, "Measurement."),
            ("x", "state", 1, p.n, "State estimate."),
            ("L", "factor", p.n, p.n, "Lower triangular factor of P: P = L L^T."),
            ("P", "covariance", p.n, p.n, "Covariance, as of the last COVARIANCE step."),
            ("LQ", "process_noise_factor", p.q, p.q, "Lower triangular factor of Q."),
            ("LR", "observation_noise_factor", p.r, p.columns_of_r or p.r, factor_of_r),
            ("U", "inputs", int(bool(p.models.inputs)), len(p.models.inputs),
             f"Inputs of the models on the core: {', '.join(p.models.inputs)}."),
        )  # fmt: skip
        return tuple(
            Region(
                symbol=symbol,
                name=name,
                index=index,
                rows=rows,
                columns=columns,
                doc=doc,
                bank=_BANKS.get(symbol, NO_BANK),
                forgets=_FORGETS.get(symbol, NO_FLAG),
                first_column=first_columns.get(symbol, FirstColumn.STORED),
            )
            for index, (symbol, name, rows, columns, doc) in enumerate(table, start=1)
            if rows and columns
        )

    def __getitem__(self, symbol: str) -> Region:
        """Region of a symbol; KeyError if these parameters have none."""
        for region in self.regions:
            if region.symbol == symbol:
                return region
        raise KeyError(f"There is no region {symbol!r} for {self.params!r}")

    def __contains__(self, symbol: str) -> bool:
        return any(region.symbol == symbol for region in self.regions)

    def __iter__(self) -> Iterator[Region]:
        return iter(self.regions)

    @property
    def element_bytes(self) -> int:
        """Bytes of one element: 4, or 8 for formats wider than 32 bits."""
        return 4 * self.params.format.bus_words

    @cached_property
    def byte_bits(self) -> int:
        """Width of the byte field."""
        return (self.element_bytes - 1).bit_length()

    @cached_property
    def column_bits(self) -> int:
        """Width of the column field: enough for any region, and for the register block."""
        widest = max(region.columns for region in self.regions)
        return max((widest - 1).bit_length(), 1)

    @cached_property
    def row_bits(self) -> int:
        """Width of the row field."""
        tallest = max(region.rows for region in self.regions)
        # Row and column together hold the register block of 64 words.
        return max((tallest - 1).bit_length(), 6 + 2 - self.column_bits - self.byte_bits, 1)

    @property
    def region_bits(self) -> int:
        """Width of the region field."""
        return 4

    @cached_property
    def address_width(self) -> int:
        """Width of a byte address."""
        return self.region_bits + self.row_bits + self.column_bits + self.byte_bits

    @property
    def row_stride(self) -> int:
        """Bytes from one row to the next."""
        return 1 << (self.column_bits + self.byte_bits)

    @property
    def region_stride(self) -> int:
        """Bytes from one region to the next."""
        return self.row_stride << self.row_bits

    def address(self, symbol: str, row: int, column: int) -> int:
        """Byte address of an element.

        Raises
        ------
        KeyError
            If there is no such region.
        IndexError
            If the element is outside its region.
        """
        region = self[symbol]
        if not (0 <= row < region.rows and 0 <= column < region.columns):
            raise IndexError(
                f"{symbol} is {region.rows} by {region.columns}, no element ({row}, {column})"
            )
        return (
            region.index * self.region_stride + row * self.row_stride + column * self.element_bytes
        )
