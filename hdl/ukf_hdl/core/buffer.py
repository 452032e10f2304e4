"""The buffer: where the words of the memory map are in the memories of the engine."""

from amaranth import Cat, Const, Module, Mux, Signal
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out
from amaranth.utils import ceil_log2

from ukf_hdl.core.axi4_lite import AccessSignature
from ukf_hdl.core.signatures import EstimateSignature, MemorySignature
from ukf_sw.engine.layout import Layout
from ukf_sw.engine.timing import LOAD_LATENCY
from ukf_sw.spec.memory_map import FirstColumn, MemoryMap
from ukf_sw.spec.parameters import UkfParams

__all__ = ["Buffer"]

DATA_WIDTH = 32


class Buffer(wiring.Component):
    """Reads and writes elements of the matrices over the bus.

    Takes the region, row and column fields of an address to a lane and an address of the engine's
    memories, by tables. A write takes two clocks, a read five: one for the tables, three for the
    memories, and the answer on the clock after. An access that is refused takes two.

    Refused, without effect and reading zero: every access that begins while :py:`busy`, and every
    access outside of the regions. A format narrower than 32 bits ignores the upper bits of a
    write and reads them as zero; a wider one has two words an element, the lower first, each
    written on its own. Column 0 of the sigma points is what :class:`FirstColumn` says.

    Parameters
    ----------
    params : :class:`UkfParams`
        What the core computes.
    layout : :class:`Layout`
        Where everything is in the engine's memories.

    Members
    -------
    access : :py:`In(AccessSignature(...))`
        Accesses; addresses as in :class:`MemoryMap`.
    busy : :py:`In(1)`
        High while the engine runs.
    banks : :py:`In(EstimateSignature())`
        Which copies of x and L are the current ones.
    written : :py:`Out(EstimateSignature())`
        High for one clock when x, when L is written, at least one byte of it.
    memory : :py:`Out(MemorySignature(...))`
        Memories of the engine. Lane and address hold from the second clock of an access to its
        end.

    Raises
    ------
    TypeError
        If a parameter is of the wrong kind.
    ValueError
        If the layout does not have the rows of a region at fixed distances of beats.
    """

    def __init__(self, params, layout):
        if not isinstance(params, UkfParams):
            raise TypeError(f"Parameters must be a UkfParams, not {params!r}")
        if not isinstance(layout, Layout):
            raise TypeError(f"Layout must be a Layout, not {layout!r}")
        self._params = params
        self._layout = layout
        self._map = MemoryMap(params)
        self._tabulate()

        super().__init__({
            "access":  In(AccessSignature(address_width=self._map.address_width)),
            "busy":    In(1),
            "banks":   In(EstimateSignature()),
            "written": Out(EstimateSignature()),
            "memory":  Out(MemorySignature(params, layout.address_width)),
        })  # fmt: skip

    def _location(self, region, row, column, **banks):
        return self._layout.buffer_location(region.symbol, row, column, **banks)

    def _tabulate(self):
        """Split the places of all elements into tables over region, row and column.

        A region's element (row, column) is at position ``first + column`` of a vector that starts
        at a base address of its row: lane ``position % P``, address ``base + position // P``.
        """
        pes = self._params.pes
        self._first = {}
        self._bases = {}
        self._distances = {}
        if self._location(self._map["x"], 0, 0) != (0, 0):
            raise ValueError("Layout must have x at the start of the memories")
        for region in self._map:
            self._first[region] = self._location(region, 0, 0)[0]
            self._distances[region] = self._bank_distances(region)
            for row in range(region.rows):
                base = self._bases[region, row] = self._location(region, row, 0)[1]
                if any(base & distance for distance in self._distances[region]):
                    raise ValueError(f"Layout must have bank 0 of {region.symbol} below bank 1")
                for column in range(region.columns):
                    beat, lane = divmod(self._first[region] + column, pes)
                    found = self._location(region, row, column)
                    if found != (lane, base + beat):
                        raise ValueError(
                            f"Layout must have element ({row}, {column}) of {region.symbol} in "
                            f"lane {lane}, not {found!r}"
                        )

    def elaborate(self, platform):
        m = Module()
        access = self.access

        # First clock: look the place up.
        is_state, is_empty = self._first_column()
        valid, lane, address = self._elaborate_decode(m, is_state)
        refused = Signal()
        fixed = Signal()
        blank = Signal()
        clock = Signal(range(LOAD_LATENCY + 2))
        with m.If(clock == 0):
            m.d.sync += [
                refused.eq(~valid | self.busy),
                fixed.eq(is_state | is_empty),
                blank.eq(~valid | self.busy | is_empty),
                self.memory.lane.eq(lane),
                self.memory.address.eq(address),
            ]

        # Then: write or fail at once, or wait for the memories.
        writing = Signal()
        m.d.comb += [
            access.ack.eq(((clock == 1) & (access.write | refused)) | (clock == LOAD_LATENCY + 1)),
            access.error.eq(refused),
            writing.eq((clock == 1) & access.write & ~refused),
            self.memory.write.eq(writing & ~fixed),
        ]
        with m.If(~access.valid | access.ack):
            m.d.sync += clock.eq(0)
        with m.Else():
            m.d.sync += clock.eq(clock + 1)

        self._elaborate_words(m, blank)

        region = self._fields()[0]
        with m.If(writing & access.strobe.any()):
            m.d.comb += [
                self.written.state.eq(region == self._map["x"].index),
                self.written.factor.eq(region == self._map["L"].index),
            ]
        return m

    def _fields(self):
        """Region, row and column fields of the address."""
        memory_map = self._map
        bits = self.access.address[memory_map.byte_bits :]
        column = bits[: memory_map.column_bits]
        row = bits[memory_map.column_bits : memory_map.column_bits + memory_map.row_bits]
        return bits[memory_map.column_bits + memory_map.row_bits :], row, column

    def _first_column(self):
        """Whether an access is to a column 0 that is not stored: one that is x, one that is empty.

        Constants where all columns are stored.
        """
        region, _, column = self._fields()

        def one_of(kind):
            found = [each.index for each in self._map if each.first_column is kind]
            return (column == 0) & region.matches(*found) if found else Const(0)

        return one_of(FirstColumn.STATE), one_of(FirstColumn.EMPTY)

    def _elaborate_decode(self, m, is_state):
        """From the fields of an address to a place.

        If `is_state`, row i is column i of x, which is at the start of the memories.
        """
        region_field, row, column = self._fields()
        pes = self._params.pes
        regions = tuple(self._map)

        # Per region: is the element inside, and at what position of its row?
        valid = Signal()
        with m.Switch(region_field):
            for region in regions:
                with m.Case(region.index):
                    m.d.comb += valid.eq((row < region.rows) & (column < region.columns))
        first = Signal(range(max(self._first.values()) + 1))
        offset = Signal(self._layout.address_width)
        with m.Switch(region_field):
            for region in regions:
                with m.Case(region.index):
                    m.d.comb += first.eq(self._first[region])
                    for bank, distance in zip(
                        (self.banks.state, self.banks.factor), self._distances[region], strict=True
                    ):
                        if distance:
                            with m.If(bank):
                                m.d.comb += offset.eq(distance)

        with m.If(is_state & self.banks.state):
            m.d.comb += offset.eq(self._distances[self._map["x"]][0])

        # Per position: lane and beat.
        last = max(self._first[region] + region.columns for region in regions) - 1
        position = Signal(range(last + 1))
        lane = Signal(range(pes))
        beat = Signal(range(last // pes + 1))
        m.d.comb += position.eq(first + Mux(is_state, row, column))
        if pes == 1 << ceil_log2(pes):
            m.d.comb += [lane.eq(position), beat.eq(position >> ceil_log2(pes))]
        else:
            with m.Switch(position):
                for value in range(last + 1):
                    with m.Case(value):
                        m.d.comb += [lane.eq(value % pes), beat.eq(value // pes)]

        # Per row: base address. Banks differ in one bit that bases of banked rows do not have.
        base = Signal(self._layout.address_width)
        with m.Switch(Cat(row, region_field)):
            for (region, index), value in self._bases.items():
                with m.Case(region.index << len(row) | index):
                    m.d.comb += base.eq(value)
        address = Signal(self._layout.address_width)
        m.d.comb += address.eq((Mux(is_state, 0, base) | offset) + beat)
        return valid, lane, address

    def _bank_distances(self, region):
        """Distance of the other copy, for the state bank and for the factor bank."""
        origin = self._location(region, 0, 0)[1]
        return (
            self._location(region, 0, 0, state_bank=1)[1] - origin,
            self._location(region, 0, 0, factor_bank=1)[1] - origin,
        )

    def _elaborate_words(self, m, blank):
        """Between elements and words of the bus; what is blank reads as zero."""
        access = self.access
        words = self._params.format.bus_words
        strobe_width = DATA_WIDTH // 8
        read_words = Signal(words * DATA_WIDTH)
        selected = Signal(DATA_WIDTH)
        # A word of a wide element, by the lowest bit of the address of words.
        word = access.address[2 : self._map.byte_bits]
        m.d.comb += [
            read_words.eq(self.memory.read_data),
            selected.eq(read_words.word_select(word, DATA_WIDTH) if words > 1 else read_words),
            self.memory.write_data.eq(Cat(access.data for _ in range(words))),
        ]
        for index in range(words):
            with m.If(word == index):
                lanes = slice(index * strobe_width, (index + 1) * strobe_width)
                m.d.comb += self.memory.write_strobe[lanes].eq(access.strobe)
        with m.If(~blank):
            m.d.comb += access.read_data.eq(selected)
