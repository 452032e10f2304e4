"""AXI4-Lite: its signature, and the front end that turns it into single accesses."""

from amaranth import Module, Mux, Signal, unsigned
from amaranth.lib import enum, wiring
from amaranth.lib.wiring import In, Out

__all__ = ["AccessSignature", "AxiLiteSubordinate", "Response", "Signature"]


class Response(enum.Enum, shape=unsigned(2)):
    """Values of ``bresp`` and ``rresp`` in use here."""

    OKAY = 0b00
    SLVERR = 0b10


class Signature(wiring.Signature):
    """AXI4-Lite, seen from the manager.

    Parameters
    ----------
    addr_width : :class:`int`
        Width of addresses, in bits.
    data_width : 32 or 64
        Width of data, in bits.

    Members
    -------
    awaddr, awprot, awvalid, awready : write address
    wdata, wstrb, wvalid, wready : write data
    bresp, bvalid, bready : write response
    araddr, arprot, arvalid, arready : read address
    rdata, rresp, rvalid, rready : read data

    Raises
    ------
    ValueError
        If a width is out of range.
    """

    def __init__(self, *, addr_width, data_width=32):
        if addr_width < 1:
            raise ValueError(f"Address width must be at least 1, not {addr_width!r}")
        if data_width not in (32, 64):
            raise ValueError(f"Data width must be 32 or 64, not {data_width!r}")
        super().__init__({
            "awaddr":  Out(addr_width),
            "awprot":  Out(3),
            "awvalid": Out(1),
            "awready": In(1),
            "wdata":   Out(data_width),
            "wstrb":   Out(data_width // 8),
            "wvalid":  Out(1),
            "wready":  In(1),
            "bresp":   In(Response),
            "bvalid":  In(1),
            "bready":  Out(1),
            "araddr":  Out(addr_width),
            "arprot":  Out(3),
            "arvalid": Out(1),
            "arready": In(1),
            "rdata":   In(data_width),
            "rresp":   In(Response),
            "rvalid":  In(1),
            "rready":  Out(1),
        })  # fmt: skip


class AccessSignature(wiring.Signature):
    """One access at a time, seen from the initiator.

    The initiator raises ``valid`` with everything else and holds it until the clock on which
    ``ack`` is high, which ends the access. On that clock ``error`` and, for a read,
    ``read_data`` are valid; ``read_data`` of a failed read is zero. ``ack`` may depend on
    ``valid`` on the same clock, and is ignored without it.

    Parameters
    ----------
    address_width : :class:`int`
        Width of byte addresses. The two low bits have no meaning.
    data_width : :class:`int`
        Width of data, in bits.

    Members
    -------
    valid, write, address, data, strobe : request
    ack, error, read_data : answer

    Raises
    ------
    ValueError
        If the address width is out of range.
    """

    def __init__(self, *, address_width, data_width=32):
        if address_width < 1:
            raise ValueError(f"Address width must be at least 1, not {address_width!r}")
        super().__init__({
            "valid":     Out(1),
            "write":     Out(1),
            "address":   Out(address_width),
            "data":      Out(data_width),
            "strobe":    Out(data_width // 8),
            "ack":       In(1),
            "error":     In(1),
            "read_data": In(data_width),
        })  # fmt: skip


class AxiLiteSubordinate(wiring.Component):
    """Turns AXI4-Lite requests into accesses, one after the other.

    Write address and write data are taken independently, in any order; the access is made when
    both are here. One write and one read are held at a time. When both wait, they alternate, so
    neither starves the other; the answer of one is never needed to finish the other. Each request
    gets exactly one response: ``SLVERR`` if the access answered with an error, else ``OKAY``.

    Every output on the AXI side comes from a register: no input reaches an output within a clock.
    :py:`access.valid` rises one clock after the last part of the request is taken, and the
    response is valid one clock after :py:`access.ack`. The next request is taken meanwhile, so a
    manager that keeps requests coming has an access of n clocks every n + 1 clocks.

    ``awprot`` and ``arprot`` are ignored.

    Parameters
    ----------
    addr_width : :class:`int`
        Width of addresses, in bits.

    Members
    -------
    s_axi : :py:`In(Signature(addr_width=addr_width))`
        Bus.
    access : :py:`Out(AccessSignature(address_width=addr_width))`
        Accesses.

    Raises
    ------
    ValueError
        If the width is out of range.
    """

    def __init__(self, *, addr_width):
        super().__init__({
            "s_axi":  In(Signature(addr_width=addr_width)),
            "access": Out(AccessSignature(address_width=addr_width)),
        })  # fmt: skip

    def elaborate(self, platform):
        m = Module()
        bus = self.s_axi
        access = self.access

        # One register per request channel; a channel is ready while its register is empty.
        have_write_address = Signal()
        have_write_data = Signal()
        have_read_address = Signal()
        write_address = Signal.like(bus.awaddr)
        write_data = Signal.like(bus.wdata)
        write_strobe = Signal.like(bus.wstrb)
        read_address = Signal.like(bus.araddr)
        m.d.comb += [
            bus.awready.eq(~have_write_address),
            bus.wready.eq(~have_write_data),
            bus.arready.eq(~have_read_address),
        ]
        with m.If(bus.awvalid & bus.awready):
            m.d.sync += [have_write_address.eq(1), write_address.eq(bus.awaddr)]
        with m.If(bus.wvalid & bus.wready):
            m.d.sync += [
                have_write_data.eq(1),
                write_data.eq(bus.wdata),
                write_strobe.eq(bus.wstrb),
            ]
        with m.If(bus.arvalid & bus.arready):
            m.d.sync += [have_read_address.eq(1), read_address.eq(bus.araddr)]

        # Choice between write and read, held from the first clock of an access to its last. An
        # access starts only when its response register is free. The write goes first; it leaves
        # its response there, so on the next clock a read that waits is alone.
        can_write = Signal()
        can_read = Signal()
        chosen = Signal()
        chosen_write = Signal()
        m.d.comb += [
            can_write.eq(have_write_address & have_write_data & ~bus.bvalid),
            can_read.eq(have_read_address & ~bus.rvalid),
            access.valid.eq(can_write | can_read),
            access.write.eq(Mux(chosen, chosen_write, can_write)),
            access.address.eq(Mux(access.write, write_address, read_address)),
            access.data.eq(write_data),
            access.strobe.eq(write_strobe),
        ]
        m.d.sync += [
            chosen.eq(access.valid & ~access.ack),
            chosen_write.eq(access.write),
        ]

        # Responses.
        with m.If(bus.bready):
            m.d.sync += bus.bvalid.eq(0)
        with m.If(bus.rready):
            m.d.sync += bus.rvalid.eq(0)
        with m.If(access.valid & access.ack):
            with m.If(access.write):
                m.d.sync += [
                    have_write_address.eq(0),
                    have_write_data.eq(0),
                    bus.bvalid.eq(1),
                    bus.bresp.eq(Mux(access.error, Response.SLVERR, Response.OKAY)),
                ]
            with m.Else():
                m.d.sync += [
                    have_read_address.eq(0),
                    bus.rvalid.eq(1),
                    bus.rresp.eq(Mux(access.error, Response.SLVERR, Response.OKAY)),
                    bus.rdata.eq(access.read_data),
                ]

        return m
