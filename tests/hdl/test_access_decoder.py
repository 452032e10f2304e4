"""The decoder leads every access to one device and brings its answer back."""

import random

import pytest
from amaranth.sim import Simulator

from ukf_hdl.core.access_decoder import AccessDecoder
from ukf_sw.spec.float_format import BINARY64
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import UkfParams

PARAMS = [
    pytest.param(UkfParams(n=1, m=1), id="smallest"),
    pytest.param(UkfParams(n=7, m=6, q=7, r=6, pes=10), id="nanosat"),
    pytest.param(UkfParams(n=3, m=2, q=1, format=BINARY64), id="double"),
]


@pytest.mark.parametrize("params", PARAMS)
def test_accesses_go_to_the_region_that_they_name(params):
    """Region 0 and all others, their first and last words, with both devices answering at once."""
    memory_map = MemoryMap(params)
    dut = AccessDecoder(memory_map)
    rng = random.Random(repr(params))
    stride = memory_map.region_stride
    size = 1 << memory_map.address_width
    edges = [start + offset for start in range(0, size, stride) for offset in (0, stride - 4)]
    addresses = edges + [rng.randrange(size) for _ in range(200)]
    reached = set()

    async def testbench(ctx):
        for address in addresses:
            request = {
                "write": rng.getrandbits(1), "data": rng.getrandbits(32),
                "strobe": rng.getrandbits(4),
            }  # fmt: skip
            valid = rng.random() < 0.8
            ctx.set(dut.access.valid, valid)
            ctx.set(dut.access.address, address)
            for name, value in request.items():
                ctx.set(getattr(dut.access, name), value)
            answers = []
            for device in (dut.registers, dut.buffer):
                answer = {
                    "ack": rng.getrandbits(1), "error": rng.getrandbits(1),
                    "read_data": rng.getrandbits(32),
                }  # fmt: skip
                for name, value in answer.items():
                    ctx.set(getattr(device, name), value)
                answers.append(answer)
            await ctx.delay(1e-9)

            index = int(address >= stride)
            devices = [dut.registers, dut.buffer]
            target, other = devices[index], devices[1 - index]
            assert ctx.get(target.valid) == valid, hex(address)
            assert not ctx.get(other.valid), hex(address)
            assert ctx.get(target.address) == (address if index else address % stride)
            for name, value in request.items():
                assert ctx.get(getattr(target, name)) == value
            for name, value in answers[index].items():
                assert ctx.get(getattr(dut.access, name)) == value, hex(address)
            reached.add((index, valid))

    simulator = Simulator(dut)
    simulator.add_testbench(testbench)
    simulator.run()
    assert reached == {(index, valid) for index in (0, 1) for valid in (False, True)}
