"""Decoder of accesses: registers or buffer."""

from amaranth import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ukf_hdl.core.axi4_lite import AccessSignature

__all__ = ["AccessDecoder"]


class AccessDecoder(wiring.Component):
    """Leads accesses to the register block or to the buffer.

    Region 0 is the register block. Nothing takes a clock here.

    Parameters
    ----------
    memory_map : :class:`MemoryMap`
        Where the regions are.

    Members
    -------
    access : :py:`In(AccessSignature(...))`
        Accesses; addresses as in :class:`MemoryMap`.
    registers : :py:`Out(AccessSignature(...))`
        Those to region 0; addresses are relative to it.
    buffer : :py:`Out(AccessSignature(...))`
        All others; addresses as in :class:`MemoryMap`.
    """

    def __init__(self, memory_map):
        self._map = memory_map
        whole = AccessSignature(address_width=memory_map.address_width)
        block = AccessSignature(address_width=memory_map.address_width - memory_map.region_bits)
        super().__init__({"access": In(whole), "registers": Out(block), "buffer": Out(whole)})

    def elaborate(self, platform):
        m = Module()
        access = self.access
        for target in (self.registers, self.buffer):
            m.d.comb += [
                target.write.eq(access.write),
                target.address.eq(access.address),
                target.data.eq(access.data),
                target.strobe.eq(access.strobe),
            ]

        def lead_to(target):
            return [
                target.valid.eq(access.valid),
                access.ack.eq(target.ack),
                access.error.eq(target.error),
                access.read_data.eq(target.read_data),
            ]

        with m.If(access.address[-self._map.region_bits :].any()):
            m.d.comb += lead_to(self.buffer)
        with m.Else():
            m.d.comb += lead_to(self.registers)
        return m
