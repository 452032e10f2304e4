import random
from itertools import pairwise

import pytest
from amaranth.sim import Simulator

from support.axi4_lite_bench import AxiLiteManager, check_axi4_lite
from ukf_hdl.core import axi4_lite
from ukf_hdl.core.axi4_lite import AccessSignature, AxiLiteSubordinate, Response

ADDR_WIDTH = 8


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: axi4_lite.Signature(addr_width=0), "Address width must be at least 1, not 0"),
        (
            lambda: axi4_lite.Signature(addr_width=4, data_width=16),
            "Data width must be 32 or 64, not 16",
        ),
        (lambda: AccessSignature(address_width=0), "Address width must be at least 1, not 0"),
        (lambda: AxiLiteSubordinate(addr_width=0), "Address width must be at least 1, not 0"),
    ],
)
def test_wrong_widths_are_rejected(make, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        make()


class Target:
    """Answers accesses after a random time; refuses odd words; records what it saw."""

    def __init__(self, access, rng, pause):
        self.access = access
        self.rng = rng
        self.pause = pause
        self.memory = {}
        self.log = []

    @staticmethod
    def refuses(address):
        return bool(address >> 2 & 1)

    async def run(self, ctx):
        access = self.access
        held = None
        while True:
            acknowledge = self.rng.random() >= self.pause
            ctx.set(access.ack, acknowledge)
            request = None
            if ctx.get(access.valid):
                address = ctx.get(access.address)
                request = (
                    ctx.get(access.write), address, ctx.get(access.data), ctx.get(access.strobe),
                )  # fmt: skip
                ctx.set(access.error, self.refuses(address))
                value = 0 if self.refuses(address) else self.memory.get(address, 0)
                ctx.set(access.read_data, value)
            else:
                ctx.set(access.error, self.rng.getrandbits(1))
                ctx.set(access.read_data, self.rng.getrandbits(32))
            if held is not None:  # a read need not hold data and strobe
                assert request is not None, "access withdrawn"
                assert request[: 4 if held[0] else 2] == held[: 4 if held[0] else 2]
            held = request if request and not acknowledge else None
            if request and acknowledge:
                self.log.append(request)
                write, address, data, _ = request
                if write and not self.refuses(address):
                    self.memory[address] = data
            await ctx.tick()


def simulate(dut, *testbenches, background=()):
    sim = Simulator(dut)
    sim.add_clock(10e-9)
    for testbench in testbenches:
        sim.add_testbench(testbench)
    for testbench in background:
        sim.add_testbench(testbench, background=True)
    sim.run()


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("target_pause", [0.0, 0.7])
@pytest.mark.parametrize("pause", [0.0, 0.3, 0.8])
def test_every_request_is_one_access_and_one_response(pause, target_pause, seed):
    rng = random.Random(f"{seed} {pause} {target_pause}")
    dut = AxiLiteSubordinate(addr_width=ADDR_WIDTH)
    target = Target(dut.access, rng, target_pause)
    writer = AxiLiteManager(dut.s_axi, rng, pause)
    reader = AxiLiteManager(dut.s_axi, rng, pause)
    writes = [
        (rng.getrandbits(ADDR_WIDTH) & ~3, rng.getrandbits(32), rng.getrandbits(4))
        for _ in range(150)
    ]
    reads = [rng.getrandbits(ADDR_WIDTH) for _ in range(150)]
    answered = []

    async def write_all(ctx):
        for address, data, strobe in writes:
            response, _ = await writer.write(ctx, address, data, strobe)
            expected = Response.SLVERR if target.refuses(address) else Response.OKAY
            assert response == expected

    async def read_all(ctx):
        for address in reads:
            data, response, _ = await reader.read(ctx, address)
            expected = Response.SLVERR if target.refuses(address) else Response.OKAY
            assert response == expected
            answered.append((address, data))

    async def protocol(ctx):
        await check_axi4_lite(ctx, dut.s_axi)

    simulate(dut, write_all, read_all, background=(target.run, protocol))

    assert [entry[1:] for entry in target.log if entry[0]] == writes
    assert [entry[1] for entry in target.log if not entry[0]] == reads
    # Replay the accesses: every read got what was there at its turn.
    memory, replies = {}, []
    for write, address, data, _ in target.log:
        if write and not target.refuses(address):
            memory[address] = data
        elif not write:
            replies.append((address, 0 if target.refuses(address) else memory.get(address, 0)))
    assert answered == replies


@pytest.mark.parametrize("first", ["address", "data"])
def test_address_and_data_come_in_any_order(first):
    dut = AxiLiteSubordinate(addr_width=ADDR_WIDTH)
    bus = dut.s_axi
    channels = {"address": (bus.awvalid, bus.awready), "data": (bus.wvalid, bus.wready)}
    second = "data" if first == "address" else "address"

    async def testbench(ctx):
        ctx.set(bus.awaddr, 0x10)
        ctx.set(bus.wdata, 0x1234)
        ctx.set(bus.wstrb, 0b0101)
        ctx.set(bus.bready, 1)
        ctx.set(dut.access.ack, 1)
        valid, ready = channels[first]
        ctx.set(valid, 1)
        assert ctx.get(ready)
        await ctx.tick()
        ctx.set(valid, 0)
        for _ in range(5):
            assert not ctx.get(ready), "took a second request before the first was complete"
            assert not ctx.get(dut.access.valid)
            await ctx.tick()
        valid, _ = channels[second]
        ctx.set(valid, 1)
        await ctx.tick()
        ctx.set(valid, 0)
        assert ctx.get(dut.access.valid)
        assert ctx.get(dut.access.write)
        assert ctx.get(dut.access.address) == 0x10
        assert ctx.get(dut.access.data) == 0x1234
        assert ctx.get(dut.access.strobe) == 0b0101
        await ctx.tick()
        assert ctx.get(bus.bvalid)
        assert not ctx.get(dut.access.valid)

    simulate(dut, testbench)


def test_writes_and_reads_alternate():
    """When both always wait, neither is served twice in a row."""
    dut = AxiLiteSubordinate(addr_width=ADDR_WIDTH)
    bus = dut.s_axi
    served = []

    async def testbench(ctx):
        for signal in (bus.awvalid, bus.wvalid, bus.arvalid, bus.bready, bus.rready):
            ctx.set(signal, 1)
        for clock in range(200):
            # Acknowledge every third clock, so that both wait when a choice is made.
            ctx.set(dut.access.ack, clock % 3 == 0)
            _, _, taken, write = await ctx.tick().sample(
                dut.access.valid & dut.access.ack, dut.access.write
            )
            if taken:
                served.append(write)

    simulate(dut, testbench)
    assert len(served) > 50
    assert all(before != after for before, after in pairwise(served[2:]))


@pytest.mark.parametrize("kind", ["write", "read"])
def test_a_stuck_response_does_not_block_the_other_direction(kind):
    dut = AxiLiteSubordinate(addr_width=ADDR_WIDTH)
    bus = dut.s_axi

    async def testbench(ctx):
        ctx.set(dut.access.ack, 1)
        manager = AxiLiteManager(bus)
        stuck = (bus.awvalid, bus.wvalid) if kind == "write" else (bus.arvalid,)
        for signal in stuck:
            ctx.set(signal, 1)  # for ever, and its response is never taken
        await ctx.tick().repeat(10)
        for _ in range(5):
            if kind == "write":
                await manager.read(ctx, 0)
            else:
                await manager.write(ctx, 0, 0)
        assert ctx.get(bus.bvalid if kind == "write" else bus.rvalid)

    simulate(dut, testbench)


@pytest.mark.parametrize("kind", ["write", "read"])
def test_no_access_while_its_response_waits(kind):
    """Or the response before it would be overwritten."""
    dut = AxiLiteSubordinate(addr_width=ADDR_WIDTH)
    bus = dut.s_axi
    write = kind == "write"
    valid, ready, response = (
        (bus.bvalid, bus.bready, bus.bresp) if write else (bus.rvalid, bus.rready, bus.rresp)
    )

    async def testbench(ctx):
        for signal in (bus.awvalid, bus.wvalid) if write else (bus.arvalid,):
            ctx.set(signal, 1)
        ctx.set(dut.access.ack, 1)
        for expected in (Response.OKAY, Response.SLVERR):
            ctx.set(dut.access.error, expected == Response.SLVERR)
            ctx.set(ready, 0)
            await ctx.tick().until(dut.access.valid)
            ctx.set(dut.access.error, expected == Response.OKAY)
            for _ in range(5):
                assert ctx.get(valid)
                assert not ctx.get(dut.access.valid)
                await ctx.tick()
            assert ctx.get(response) == expected
            ctx.set(ready, 1)
            await ctx.tick()
            assert not ctx.get(valid)

    simulate(dut, testbench)


@pytest.mark.parametrize("access_clocks", [1, 2, 5])
def test_latency_and_throughput(access_clocks):
    """An access begins one clock after its request, and one clock after it is the response."""
    dut = AxiLiteSubordinate(addr_width=ADDR_WIDTH)
    bus = dut.s_axi
    starts, ends = [], []

    async def acknowledge(ctx):
        age = 0
        while True:
            age = age + 1 if ctx.get(dut.access.valid) else 0
            ctx.set(dut.access.ack, age == access_clocks)
            await ctx.tick()
            age %= access_clocks

    async def testbench(ctx):
        ctx.set(bus.arvalid, 1)
        ctx.set(bus.rready, 1)
        for clock in range(100):
            _, _, ar, r = await ctx.tick().sample(bus.arready, bus.rvalid)
            if ar:
                starts.append(clock)
            if r:
                ends.append(clock)

    simulate(dut, testbench, background=(acknowledge,))
    assert ends[0] - starts[0] == access_clocks + 1
    assert {after - before for before, after in pairwise(ends[1:])} == {access_clocks + 1}
