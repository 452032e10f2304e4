import random

import pytest
from amaranth import Module
from amaranth.lib.wiring import connect
from amaranth.sim import Simulator

from support.axi4_lite_bench import AccessManager
from support.stub_engine import StubEngine
from ukf_hdl.core.buffer import Buffer
from ukf_sw.engine.layout import Layout
from ukf_sw.spec.float_format import BINARY16, BINARY64, FloatFormat
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import Form, Noise, UkfParams

ADDITIVE = {"process_noise": Noise.ADDITIVE, "observation_noise": Noise.ADDITIVE}
SHAPES = [
    pytest.param(UkfParams(n=1, m=1), id="smallest"),
    pytest.param(UkfParams(n=2, m=3, q=1, r=2, pes=1), id="1 PE"),
    pytest.param(UkfParams(n=2, m=3, q=1, r=2, pes=2, W0=0.25), id="a point 0"),
    pytest.param(UkfParams(n=3, m=2, q=2, r=1, pes=3), id="3 PEs"),
    pytest.param(UkfParams(n=3, m=4, q=3, r=4, pes=4, **ADDITIVE), id="additive"),
    pytest.param(UkfParams(n=2, m=3, q=2, r=3, pes=9, **ADDITIVE), id="a PE a column"),
    pytest.param(UkfParams(n=2, m=2, q=1, pes=2, form=Form.COVARIANCE), id="covariance"),
    pytest.param(UkfParams(n=2, m=2, q=1, pes=3, format=BINARY16), id="half"),
    pytest.param(UkfParams(n=2, m=2, q=1, pes=3, format=BINARY64), id="double"),
    pytest.param(
        UkfParams(n=2, m=1, pes=2, format=FloatFormat(exponent_bits=6, fraction_bits=12)),
        id="19 bits",
    ),
    pytest.param(
        UkfParams(n=2, m=1, pes=2, format=FloatFormat(exponent_bits=9, fraction_bits=31)),
        id="41 bits",
    ),
]
NANOSAT = UkfParams(n=7, m=6, q=7, r=6, pes=10)


class Bench:
    """Buffer and memories."""

    def __init__(self, params):
        self.params = params
        self.module = m = Module()
        self.map = MemoryMap(params)
        m.submodules.engine = self.engine = engine = StubEngine(params)
        m.submodules.buffer = self.buffer = buffer = Buffer(params, engine.layout)
        self.manager = AccessManager(buffer.access)
        connect(m, buffer.memory, engine.memory)

    def simulate(self, testbench, background=()):
        sim = Simulator(self.module)
        sim.add_clock(10e-9)
        sim.add_testbench(testbench)
        for process in background:
            sim.add_testbench(process, background=True)
        sim.run()

    def place(self, address, state_bank=0, factor_bank=0):
        """Index in the memory, and number of the word within the element; None if unmapped.

        Column 0 of X is x if there is no sigma point 0.
        """
        memory_map = self.map
        region_index, rest = divmod(address, memory_map.region_stride)
        row, rest = divmod(rest, memory_map.row_stride)
        column, rest = divmod(rest, memory_map.element_bytes)
        for region in memory_map:
            if region.index == region_index and row < region.rows and column < region.columns:
                element = region.symbol, row, column
                if region.symbol == "X" and self.is_fixed(address):
                    element = "x", 0, row
                lane, within = self.engine.layout.buffer_location(
                    *element, state_bank=state_bank, factor_bank=factor_bank
                )
                return self.engine.word_index(lane, within), rest // 4
        return None

    def is_fixed(self, address):
        """Whether an address is in the place of a sigma point 0 that there is not."""
        column = address % self.map.row_stride // self.map.element_bytes
        points = self.symbol(address) in ("X", "W", "V", "Z")
        return points and column == 0 and self.map.params.W0 == 0.0

    def is_empty(self, address):
        """Whether it always reads as zero."""
        return self.is_fixed(address) and self.symbol(address) != "X"

    def symbol(self, address):
        index = address // self.map.region_stride
        return next((region.symbol for region in self.map if region.index == index), None)


def test_wrong_params_are_rejected():
    params = UkfParams(n=1, m=1)
    with pytest.raises(TypeError, match=r"^Parameters must be a UkfParams, not 3$"):
        Buffer(3, Layout(params))
    with pytest.raises(TypeError, match=r"^Layout must be a Layout, not 3$"):
        Buffer(params, 3)


@pytest.mark.parametrize(
    ("element", "banks", "message"),
    [
        ((1, 0), False, r"^Layout must have element \(1, 0\) of X in lane 0, not \(1, .*\)$"),
        ((0, 0), True, r"^Layout must have bank 0 of L below bank 1$"),
    ],
)
def test_a_layout_that_the_tables_cannot_hold_is_rejected(element, banks, message):
    class Odd(Layout):
        def buffer_location(self, symbol, row, column, **kwargs):
            lane, address = super().buffer_location(symbol, row, column, **kwargs)
            if not banks and (symbol, row, column) == ("X", *element):
                lane += 1
            if banks and symbol == "L":
                address += self.bank_offset if not kwargs else 2 * self.bank_offset
            return lane, address

    params = UkfParams(n=2, m=1, pes=2)
    with pytest.raises(ValueError, match=message):
        Buffer(params, Odd(params))


def test_a_layout_with_x_elsewhere_is_rejected():
    class Odd(Layout):
        def buffer_location(self, symbol, row, column, **kwargs):
            lane, address = super().buffer_location(symbol, row, column, **kwargs)
            return lane, address + (symbol == "x")

    params = UkfParams(n=2, m=1)
    with pytest.raises(ValueError, match=r"^Layout must have x at the start of the memories$"):
        Buffer(params, Odd(params))


@pytest.mark.parametrize("params", SHAPES)
def test_every_address_is_an_element_or_refused(params):
    """Fill the memories, then read and write every word of the map, and look where it went."""
    bench = Bench(params)
    rng = random.Random(repr(params))
    size = 1 << bench.map.address_width
    mask = (1 << params.format.width) - 1

    async def testbench(ctx):
        data = bench.engine.words.data
        model = [rng.getrandbits(params.format.width) for _ in range(data.depth)]
        for index, word in enumerate(model):
            ctx.set(data[index], word)
        elements = 0
        for address in range(0, size, 4):
            place = bench.place(address)
            word, error, clocks = await bench.manager.read(ctx, address)
            if place is None:
                assert (word, error, clocks) == (0, 1, 2), hex(address)
                assert await bench.manager.write(ctx, address, 0xFFFF_FFFF) == (1, 2)
                continue
            elements += 1
            index, part = place
            expected = model[index] >> 32 * part & 0xFFFF_FFFF
            if bench.is_empty(address):
                expected = 0
            assert (word, error, clocks) == (expected, 0, 5), hex(address)
            new, strobe = rng.getrandbits(32), rng.choice([0xF, 0xF, rng.getrandbits(4)])
            assert await bench.manager.write(ctx, address, new, strobe) == (0, 2)
            bits = sum(0xFF << 8 * i for i in range(4) if strobe >> i & 1)
            if bench.is_fixed(address):
                bits = 0
            merged = (model[index] & ~(bits << 32 * part)) | (new & bits) << 32 * part
            model[index] = merged & mask
            assert ctx.get(data[index]) & mask == model[index], hex(address)
        assert [ctx.get(data[i]) & mask for i in range(data.depth)] == model
        assert elements == sum(r.rows * r.columns for r in bench.map) * params.format.bus_words

    bench.simulate(testbench)


@pytest.mark.parametrize("params", [*SHAPES, pytest.param(NANOSAT, id="nanosat")])
def test_random_traffic_with_banks_and_busy(params):
    bench = Bench(params)
    rng = random.Random(repr(params))
    mask = (1 << params.format.width) - 1
    memory_map = bench.map
    addresses = [
        memory_map.address(r.symbol, row, column) + 4 * word
        for r in memory_map
        for row in range(r.rows)
        for column in range(r.columns)
        for word in range(params.format.bus_words)
    ]
    banked = [a for a in addresses if bench.symbol(a) in ("x", "L")]
    written = {"state": 0, "factor": 0}

    async def count(ctx):
        async for _, _, state, factor in ctx.tick().sample(
            bench.buffer.written.state, bench.buffer.written.factor
        ):
            written["state"] += state
            written["factor"] += factor

    async def testbench(ctx):
        data = bench.engine.words.data
        model = [rng.getrandbits(params.format.width) for _ in range(data.depth)]
        for index, word in enumerate(model):
            ctx.set(data[index], word)
        expected = {"state": 0, "factor": 0}
        for _ in range(400):
            address = rng.choice(rng.choice([addresses, banked, [rng.getrandbits(8)]]))
            address |= rng.getrandbits(2)
            banks = {"state": rng.getrandbits(1), "factor": rng.getrandbits(1)}
            for name, value in banks.items():
                ctx.set(getattr(bench.buffer.banks, name), value)
            busy = rng.random() < 0.1
            ctx.set(bench.buffer.busy, busy)
            place = bench.place(address, banks["state"], banks["factor"])
            refused = busy or place is None
            if rng.random() < 0.5:
                word, error, _ = await bench.manager.read(ctx, address)
                assert error == refused
                blank = refused or bench.is_empty(address)
                assert word == (0 if blank else model[place[0]] >> 32 * place[1] & 0xFFFF_FFFF)
            else:
                new, strobe = rng.getrandbits(32), rng.choice([0xF, rng.getrandbits(4)])
                error, _ = await bench.manager.write(ctx, address, new, strobe)
                assert error == refused
                if not refused:
                    index, part = place
                    bits = sum(0xFF << 8 * i for i in range(4) if strobe >> i & 1)
                    if bench.is_fixed(address):
                        bits = 0
                    model[index] &= ~(bits << 32 * part)
                    model[index] |= (new & bits) << 32 * part
                    model[index] &= mask
                    expected["state"] += bench.symbol(address) == "x" and strobe != 0
                    expected["factor"] += bench.symbol(address) == "L" and strobe != 0
            while rng.random() < 0.3:
                await ctx.tick()
        assert [ctx.get(data[i]) & mask for i in range(data.depth)] == model
        await ctx.tick()  # the count is a clock behind
        assert written == expected
        assert all(expected.values())

    bench.simulate(testbench, [count])
