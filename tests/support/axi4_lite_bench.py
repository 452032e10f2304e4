"""AXI4-Lite and access-bus managers for testbenches of Amaranth's simulator."""

import random

__all__ = ["AccessManager", "AxiLiteManager", "check_axi4_lite"]


class AxiLiteManager:
    """Makes one write or one read at a time, pausing at random on every channel.

    Parameters
    ----------
    bus
        Interface of the device, :class:`ukf_hdl.core.axi4_lite.Signature`.
    rng
        Source of the pauses.
    pause
        Probability of one more clock of pause, on each channel.
    """

    def __init__(self, bus, rng=None, pause=0.0):
        self.bus = bus
        self._rng = rng or random.Random(0)
        self._pause = pause

    def _delay(self):
        delay = 0
        while self._rng.random() < self._pause:
            delay += 1
        return delay

    async def write(self, ctx, address, data, strobe=0xF):
        """Write a word; gives the response and the clocks from first valid to response."""
        bus = self.bus
        delays = {"aw": self._delay(), "w": self._delay(), "b": self._delay()}
        waiting = {"aw", "w", "b"}
        response = clocks = 0
        while waiting:
            due = {name for name in waiting if delays[name] <= clocks}
            ctx.set(bus.awvalid, "aw" in due)
            ctx.set(bus.wvalid, "w" in due)
            ctx.set(bus.bready, "b" in due)
            if "aw" in due:
                ctx.set(bus.awaddr, address)
            if "w" in due:
                ctx.set(bus.wdata, data)
                ctx.set(bus.wstrb, strobe)
            _, _, awready, wready, bvalid, bresp = await ctx.tick().sample(
                bus.awready, bus.wready, bus.bvalid, bus.bresp
            )
            clocks += 1
            answers = {"aw": awready, "w": wready, "b": bvalid}
            taken = {name for name in due if answers[name]}
            if "b" in taken:
                assert not {"aw", "w"} & waiting, "response before request"
                response = bresp
            waiting -= taken
        for valid in (bus.awvalid, bus.wvalid, bus.bready):
            ctx.set(valid, 0)
        # What is not valid may be anything.
        ctx.set(bus.awaddr, self._rng.getrandbits(len(bus.awaddr)))
        ctx.set(bus.wdata, self._rng.getrandbits(32))
        ctx.set(bus.wstrb, self._rng.getrandbits(4))
        return response, clocks

    async def read(self, ctx, address):
        """Read a word; gives it, the response, and the clocks from first valid to response."""
        bus = self.bus
        delays = {"ar": self._delay(), "r": self._delay()}
        waiting = {"ar", "r"}
        data = response = clocks = 0
        while waiting:
            due = {name for name in waiting if delays[name] <= clocks}
            ctx.set(bus.arvalid, "ar" in due)
            ctx.set(bus.rready, "r" in due)
            if "ar" in due:
                ctx.set(bus.araddr, address)
            _, _, arready, rvalid, rdata, rresp = await ctx.tick().sample(
                bus.arready, bus.rvalid, bus.rdata, bus.rresp
            )
            clocks += 1
            answers = {"ar": arready, "r": rvalid}
            taken = {name for name in due if answers[name]}
            if "r" in taken:
                assert "ar" not in waiting, "response before request"
                data, response = rdata, rresp
            waiting -= taken
        ctx.set(bus.arvalid, 0)
        ctx.set(bus.rready, 0)
        ctx.set(bus.araddr, self._rng.getrandbits(len(bus.araddr)))
        return data, response, clocks


async def check_axi4_lite(ctx, bus):
    """Check for ever that responses hold until taken and follow requests one to one."""
    held_b = held_r = None
    addresses = words = asked = writes = reads = 0
    async for _, _, aw, w, ar, b, r in ctx.tick().sample(
        bus.awvalid & bus.awready,
        bus.wvalid & bus.wready,
        bus.arvalid & bus.arready,
        (bus.bvalid << 3) | (bus.bready << 2) | bus.bresp.as_value(),
        (bus.rvalid << 35) | (bus.rready << 34) | (bus.rresp.as_value() << 32) | bus.rdata,
    ):
        b_valid, b_ready, b_payload = b >> 3, b >> 2 & 1, b & 3
        r_valid, r_ready, r_payload = r >> 35, r >> 34 & 1, r & ((1 << 34) - 1)
        assert held_b is None or (b_valid, b_payload) == (1, held_b), "B changed before transfer"
        assert held_r is None or (r_valid, r_payload) == (1, held_r), "R changed before transfer"
        held_b = b_payload if b_valid and not b_ready else None
        held_r = r_payload if r_valid and not r_ready else None
        assert not b_valid or writes < min(addresses, words), "write response without a request"
        assert not r_valid or reads < asked, "read response without a request"
        writes += b_valid & b_ready
        reads += r_valid & r_ready
        addresses += aw
        words += w
        asked += ar


class AccessManager:
    """Makes accesses on :class:`ukf_hdl.core.axi4_lite.AccessSignature`, one at a time.

    Parameters
    ----------
    access
        Interface of the device.
    """

    def __init__(self, access):
        self.access = access

    async def write(self, ctx, address, data, strobe=0xF):
        """Write a word; gives the error flag and the clocks it took."""
        _, error, clocks = await self._run(ctx, 1, address, data, strobe)
        return error, clocks

    async def read(self, ctx, address):
        """Read a word; gives it, the error flag and the clocks it took."""
        return await self._run(ctx, 0, address, 0, 0)

    async def _run(self, ctx, write, address, data, strobe):
        access = self.access
        ctx.set(access.valid, 1)
        ctx.set(access.write, write)
        ctx.set(access.address, address)
        ctx.set(access.data, data)
        ctx.set(access.strobe, strobe)
        clocks = ack = read_data = error = 0
        while not ack:
            _, _, ack, read_data, error = await ctx.tick().sample(
                access.ack, access.read_data, access.error
            )
            clocks += 1
        ctx.set(access.valid, 0)
        return read_data, error, clocks
