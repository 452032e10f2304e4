"""Control registers of the core and the state machine of its steps."""

from amaranth import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import wiring
from amaranth.lib.data import StructLayout
from amaranth.lib.wiring import In, Out

from ukf_hdl.arithmetic.float_layout import FloatLayout
from ukf_hdl.core.axi4_lite import AccessSignature
from ukf_hdl.core.signatures import EstimateSignature, RunSignature
from ukf_hdl.core.soc import csr, event
from ukf_sw.engine.microcode import routines
from ukf_sw.spec.memory_map import MemoryMap
from ukf_sw.spec.parameters import UkfParams
from ukf_sw.spec.registers import (
    CYCLES,
    DATA_WIDTH,
    ERROR,
    NIS_HIGH,
    NIS_LOW,
    REGISTERS,
    STATUS,
    Access,
    ErrorCode,
)
from ukf_sw.spec.sequence import (
    ENDINGS,
    FOLLOWING,
    HIDDEN,
    OF_SENSORS,
    STEPS,
    WAYS,
    Bank,
    Flag,
    Program,
    Step,
    steps_of,
)

__all__ = ["Control"]


class StrobedRW(csr.FieldAction):
    """A read/write field of which only the strobed bits are written.

    A CSR bus has no byte strobes: they come from the side.

    Parameters
    ----------
    shape : :ref:`shape-like object <lang-shapelike>`
        Shape of the field.
    bits : :class:`int`
        How many of its bits there are, from the lowest; the others are reserved.
    init : :class:`int`
        Value after reset.

    Members
    -------
    strobe : :py:`In(bits)`
        Bits to write, valid on the clock of the write.
    data : :py:`Out(bits)`
        Value.
    next : :py:`Out(bits)`
        Value on the next clock: on the clock of a write, what it leaves.
    """

    def __init__(self, shape, *, bits, init=0):
        super().__init__(
            shape,
            access="rw",
            members={"strobe": In(bits), "data": Out(bits), "next": Out(bits)},
        )
        self._storage = Value.cast(Signal(bits, init=init))

    def elaborate(self, platform):
        m = Module()
        m.d.comb += [
            self.port.r_data.eq(self._storage),
            self.data.eq(self._storage),
            self.next.eq(self._storage),
        ]
        # Bit by bit, so that strobes become clock enables.
        for index in range(len(self._storage)):
            with m.If(self.port.w_stb & self.strobe[index]):
                m.d.comb += self.next[index].eq(self.port.w_data[index])
                m.d.sync += self._storage[index].eq(self.port.w_data[index])
        return m


class MonitorPending(csr.FieldAction):
    """The pending bit of an event monitor: reads it, and writing 1 clears it.

    Parameters
    ----------
    shape : :ref:`shape-like object <lang-shapelike>`
        Shape of the field.

    Members
    -------
    pending : :py:`In(shape)`
        Events that are pending.
    clear : :py:`Out(shape)`
        Events to clear, high on the clock of the write.
    """

    def __init__(self, shape):
        super().__init__(shape, access="rw", members={"pending": In(shape), "clear": Out(shape)})

    def elaborate(self, platform):
        m = Module()
        m.d.comb += [
            self.port.r_data.eq(self.pending),
            self.clear.eq(Mux(self.port.w_stb, self.port.w_data, 0)),
        ]
        return m


class Control(wiring.Component):
    """Registers, flags and steps: everything about the core that is not arithmetic.

    The layout of the registers is that of :mod:`ukf_sw.spec.registers`. Every access to
    :py:`access` takes two clocks and a write has taken effect when it ends, so a read that follows
    sees it. An access to an address without a register has no effect, reads zero and is answered
    with an error; a write to a read-only field is ignored. Byte strobes are honoured.

    A step starts when exactly one start bit is written, with ENABLE set by then, while no step
    runs, and in sequence. :py:`run.start` follows one clock after the write takes effect. From
    that clock until :py:`run.done`, both included, :py:`busy` is high and CYCLES counts. A step
    goes on with another program starts it on the next clock. SIG_GEN
    with sigma points already there ends at once, without :py:`run.start` and without ever being
    busy.

    Races, on one clock: a write is judged before the end of a step. So a start on the clock of
    :py:`run.done` is illegal, an error of the ending step replaces its ILLEGAL_STEP, and RESET
    drops the ending step; only a GATE written on that clock comes too late. An event wins over the
    write that clears its pending bit.

    Parameters
    ----------
    params : :class:`UkfParams`
        What the core computes.

    Members
    -------
    access : :py:`In(AccessSignature(...))`
        Accesses to the register block; addresses are relative to it.
    irq : :py:`Out(1)`
        Interrupt, high while an enabled event is pending.
    busy : :py:`Out(1)`
        High while a step runs: the buffer must refuse accesses.
    written : :py:`In(EstimateSignature())`
        High for one clock when x, when L has been written over the bus.
    run : :py:`Out(RunSignature(params))`
        Program of a step. Which one holds until the next start, and so do the observations that
        take part in it: MASK as it was at the start.
    banks : :py:`Out(EstimateSignature())`
        Which copies of x and L are the current ones.

    Raises
    ------
    TypeError
        If :py:`params` is not a :class:`UkfParams`.
    RuntimeError
        If the register map resolved by the library is not that of :mod:`ukf_sw.spec.registers`.
    """

    def __init__(self, params):
        if not isinstance(params, UkfParams):
            raise TypeError(f"Parameters must be a UkfParams, not {params!r}")
        self._params = params
        self._registers = self._build_registers()
        self._bridge = csr.Bridge(self._build_map())
        self._check_map()

        memory_map = MemoryMap(params)
        block_width = memory_map.address_width - memory_map.region_bits
        super().__init__({
            "access":  In(AccessSignature(address_width=block_width)),
            "irq":     Out(1),
            "busy":    Out(1),
            "written": In(EstimateSignature()),
            "run":     Out(RunSignature(params)),
            "banks":   Out(EstimateSignature()),
        })  # fmt: skip

    @property
    def params(self):
        """Parameters given to the constructor."""
        return self._params

    @property
    def memory_map(self):
        """Map of the registers as the CSR library resolved it; addresses count words."""
        return self._bridge.bus.memory_map

    def _build_registers(self):
        """Make a CSR register from every register of the description."""

        def action(register, field):
            reset = field.value_after_reset(self._params)
            match field.access:
                case Access.RO:
                    return csr.Field(csr.action.R, field.width)
                case Access.RW:
                    bits = field.bits_of(self._params)
                    return csr.Field(StrobedRW, field.width, bits=bits, init=reset)
                case Access.W1S | Access.WO:
                    return csr.Field(csr.action.W, field.width)
                case Access.RW1C:
                    return csr.Field(MonitorPending, field.width)

        built = {}
        for register in REGISTERS:
            fields = {}
            position = 0
            for field in sorted(register, key=lambda field: field.lsb):
                if field.lsb > position:
                    fields[f"reserved_{position}"] = csr.Field(
                        csr.action.ResR0WA, field.lsb - position
                    )
                fields[field.name] = action(register, field)
                position = field.lsb + field.width
            read_only = all(field.access is Access.RO for field in register)
            built[register] = csr.Register(fields, access="r" if read_only else "rw")
        return built

    def _build_map(self):
        last = max(register.offset for register in REGISTERS)
        builder = csr.Builder(
            addr_width=(last // (DATA_WIDTH // 8)).bit_length(),
            data_width=DATA_WIDTH,
            granularity=8,
        )
        for register, built in self._registers.items():
            builder.add(register.name, built, offset=register.offset)
        return builder.as_memory_map()

    def _check_map(self):
        resolved = {
            str(info.path[-1][-1]): info.start * (DATA_WIDTH // 8)
            for info in self.memory_map.all_resources()
        }
        described = {register.name: register.offset for register in REGISTERS}
        if resolved != described:
            raise RuntimeError(f"Register map must resolve to {described!r}, not {resolved!r}")

    def elaborate(self, platform):
        m = Module()
        m.submodules.bridge = self._bridge
        fields = {register.name: built.f for register, built in self._registers.items()}

        self._elaborate_access(m)

        # What a write does: fields of one register share the strobe of its write.
        control = fields["CONTROL"]
        starts = Signal(len(STEPS))
        any_start = Signal()
        reset = Signal()
        m.d.comb += [
            reset.eq(control.RESET.w_stb & control.RESET.w_data),
            starts.eq(Cat(control[step.name].w_stb & control[step.name].w_data for step in STEPS)),
            any_start.eq(starts.any() & ~reset),
        ]

        # What is known of the memories, a bit for each Flag, and of the steps. Steps that the core
        # has not never run.
        flags = Signal(len(Flag))
        gated = Signal()
        ended = Signal(len(STEPS))
        own = steps_of(self._params.models)
        cycles = Signal(DATA_WIDTH)
        error_code = Signal(8)
        error_index = Signal(8)
        nis = Signal(self._params.format.width)
        state = Signal(range(1 + max(own)))
        m.d.comb += self.busy.eq(state != Step.IDLE)

        # Events.
        step_done = Signal()
        error_recorded = Signal()
        self._elaborate_interrupt(m, fields, step_done, error_recorded)

        # Judgement of a start.
        way = self._elaborate_ways(m, own, starts, flags)
        of_sensor = self._is_one(way.step, Step.UPDATE, Step.H, Step.ITERATE)
        of_variant = self._is_one(way.step, Step.H, Step.ITERATE)
        sensor = Mux(of_sensor, control.SENSOR.w_data, 0)
        variant = Mux(of_variant, control.VARIANT.w_data, 0)
        exists = self._elaborate_exists(m, of_variant, sensor, variant)
        launch = Signal()
        refuse = Signal()
        m.d.comb += [
            launch.eq(any_start & way.legal & exists & control.ENABLE.next & ~self.busy),
            refuse.eq(any_start & ~launch),
        ]

        # Below, a later assignment wins over an earlier one.
        # Writes over the bus to what steps start from.
        memory_map = MemoryMap(self._params)
        for written, symbol in ((self.written.state, "x"), (self.written.factor, "L")):
            with m.If(written):
                m.d.sync += self._bits(flags, memory_map[symbol].forgets).eq(0)

        # Start.
        m.d.sync += [self.run.start.eq(0), self.run.stop.eq(0)]
        with m.If(launch):
            m.d.sync += [
                error_code.eq(ErrorCode.NONE),
                error_index.eq(0),
                ended.eq(Mux(way.at_once, ended | starts, ended & ~starts)),
                cycles.eq(0),
            ]
            with m.If(of_sensor):
                m.d.sync += gated.eq(0)
            with m.If(~way.at_once):
                m.d.sync += [
                    state.eq(way.step),
                    self.run.program.eq(way.program),
                    *self._select(way.program, sensor, variant),
                    self.run.observation_mask.eq(fields["MASK"].VALUE.data),
                    self.run.start.eq(1),
                ]
        with m.If(refuse):
            m.d.sync += [error_code.eq(ErrorCode.ILLEGAL_STEP), error_index.eq(0)]
        with m.If(self.busy):
            m.d.sync += cycles.eq(cycles + 1)

        # End.
        end = Signal()
        goes_on = Signal()
        failed = Signal()
        gate = self._gate(fields)
        # An innovation too large for the format is above every gate.
        overflow = self.run.innovation_overflow & gate.is_finite
        m.d.comb += [
            end.eq(self.busy & self.run.done & ~reset),
            failed.eq((self.run.error_code != ErrorCode.NONE) & ~overflow),
            step_done.eq((end & ~goes_on) | (launch & way.at_once)),
            error_recorded.eq((end & failed) | refuse),
        ]
        self._elaborate_following(m, state, flags, launch, sensor, variant, end & ~failed, goes_on)
        with m.If(end):
            with m.If(~goes_on):
                m.d.sync += state.eq(Step.IDLE)
                with m.Switch(state):
                    for step in own:
                        with m.Case(step):
                            m.d.sync += ended[step - 1].eq(1)
            with m.If(failed):
                m.d.sync += [
                    error_code.eq(self.run.error_code),
                    error_index.eq(self.run.error_index),
                ]
            self._elaborate_ending(m, gate, failed, flags, gated, nis)

        # Reset.
        with m.If(reset):
            m.d.sync += [
                state.eq(Step.IDLE),
                self.run.stop.eq(1),
                Cat(flags, gated, ended, error_code, error_index, cycles).eq(0),
            ]

        self._elaborate_values(m, fields, {
            (STATUS, "STATE"): state,
            (STATUS, "GATED"): gated,
            **{
                (STATUS, flag.name): self._bits(flags, flag)
                for flag in Flag if flag not in HIDDEN
            },
            **{
                (STATUS, step.name): bit for step, bit in zip(STEPS, ended, strict=True)
            },
            (ERROR, "CODE"): error_code,
            (ERROR, "INDEX"): error_index,
            (CYCLES, "VALUE"): cycles,
            (NIS_LOW, "VALUE"): nis[:DATA_WIDTH],
            (NIS_HIGH, "VALUE"): nis[DATA_WIDTH:],
        })  # fmt: skip
        return m

    @staticmethod
    def _bits(flags, chosen):
        """Bits of some flags."""
        return Cat(bit for bit, flag in zip(flags, Flag, strict=True) if flag in chosen)

    def _elaborate_values(self, m, fields, values):
        """What the read-only fields show: these values, and the constants of the description."""
        for register in REGISTERS:
            for field in register:
                if field.access is Access.RO:
                    value = (
                        field.value_after_reset(self._params)
                        if field.is_fixed
                        else values.pop((register, field.name))
                    )
                    m.d.comb += fields[register.name][field.name].r_data.eq(value)
        if values:
            raise RuntimeError(f"Fields must be read only and have values, not {list(values)!r}")

    def _elaborate_access(self, m):
        """From accesses to the CSR bus: two clocks each, strobes and unmapped addresses."""
        access = self.access
        bus = self._bridge.bus
        word = access.address[2:]
        mapped = Signal()
        last = Signal()
        strobe_mask = Signal(DATA_WIDTH)
        with m.Switch(word):
            for info in self.memory_map.all_resources():
                with m.Case(info.start):
                    m.d.comb += mapped.eq(1)
        m.d.sync += last.eq(access.valid & ~last)
        m.d.comb += [
            strobe_mask.eq(Cat(strobe.replicate(8) for strobe in access.strobe)),
            bus.addr.eq(word),
            # A bit that is not strobed is written as 0, which does nothing to an action bit. The
            # read/write fields take the strobes as well. They see the write on the second clock,
            # through which the access holds.
            bus.w_data.eq(access.data & strobe_mask),
            bus.r_stb.eq(access.valid & ~access.write & mapped & ~last),
            bus.w_stb.eq(access.valid & access.write & mapped & ~last),
            access.ack.eq(last),
            access.error.eq(~mapped),
            access.read_data.eq(bus.r_data),
        ]
        for register, built in self._registers.items():
            for field in register:
                if field.access is Access.RW:
                    bits = slice(field.lsb, field.lsb + field.width)
                    m.d.comb += built.f[field.name].strobe.eq(strobe_mask[bits])

    def _elaborate_interrupt(self, m, fields, step_done, error_recorded):
        """Events, enable and pending bits, and the interrupt."""
        sources = {
            "DONE": (event.Source(path=("step_done",)), step_done),
            "ERROR": (event.Source(path=("error_recorded",)), error_recorded),
        }
        events = event.EventMap()
        for source, line in sources.values():
            events.add(source)
            m.d.comb += source.i.eq(line)
        m.submodules.monitor = monitor = event.Monitor(events)
        for name, (source, _) in sources.items():
            index = events.index(source)
            m.d.comb += [
                monitor.enable[index].eq(fields["INTERRUPT_ENABLE"][name].data),
                monitor.clear[index].eq(fields["INTERRUPT_PENDING"][name].clear),
                fields["INTERRUPT_PENDING"][name].pending.eq(monitor.pending[index]),
            ]
        m.d.comb += self.irq.eq(monitor.src.i)

    def _is_one(self, step, *choices):
        """Whether a step is one of some; those that the core has not never are."""
        own = [choice for choice in choices if choice in steps_of(self._params.models)]
        return Cat(step == choice for choice in own).any() if own else Const(0)

    def _elaborate_exists(self, m, of_variant, sensor, variant):
        """Whether there is the sensor that a start names, and the variant of its model."""
        exists = Signal()
        m.d.comb += exists.eq(sensor < len(self._params.sensor_rows))
        with m.If(of_variant):
            m.d.comb += exists.eq(0)
            for number, variants in enumerate(self._params.models.h):
                with m.If((sensor == number) & (variant < len(variants))):
                    m.d.comb += exists.eq(1)
        return exists

    def _select(self, program, sensor, variant):
        """Whose program runs."""
        own = {routine.program for routine in routines(self._params)}
        of_sensor = Cat(program == each for each in OF_SENSORS & own).any()
        return [
            self.run.sensor.eq(Mux(of_sensor, sensor, 0)),
            self.run.variant.eq(Mux(program == Program.MODEL_H, variant, 0)),
        ]

    def _elaborate_following(self, m, state, flags, launch, sensor, variant, succeeded, goes_on):
        """With what a step goes on when a program has succeeded, as in the table."""
        if not self._params.models:
            return
        chosen = Signal.like(self.run.sensor)
        chosen_variant = Signal.like(self.run.variant)
        with m.If(launch):
            m.d.sync += [chosen.eq(sensor), chosen_variant.eq(variant)]
        program = Signal.like(self.run.program)
        for (step, before), following in FOLLOWING.items():
            if step not in steps_of(self._params.models):
                continue
            change = ENDINGS[before].success
            with m.If(succeeded & (state == step) & (self.run.program == before)):
                m.d.comb += goes_on.eq(1)
                for choice in reversed(WAYS[following]):
                    # The program that has ended changes these flags on this clock.
                    left = choice.needs & ~change.sets
                    if not left & change.clears:
                        with m.If(self._has_flags(flags, left)):
                            m.d.comb += program.eq(choice.program)
        with m.If(goes_on):
            m.d.sync += [
                self.run.start.eq(1),
                self.run.program.eq(program),
                *self._select(program, chosen, chosen_variant),
            ]

    def _has_flags(self, flags, needed):
        """Whether all of some flags are set."""
        return self._bits(flags, needed).all() if needed else Const(1)

    def _elaborate_ways(self, m, own, starts, flags):
        """What a start bit would start: the first way whose flags are set, as in the table."""
        way = Signal(StructLayout({
            "step": range(1 + max(own)), "program": self.run.program.shape(), "legal": 1,
            "at_once": 1,
        }))  # fmt: skip
        with m.Switch(starts):
            for step in own:
                with m.Case(1 << (step - 1)):
                    m.d.comb += way.step.eq(step)
                    # The first in the table wins, so it is assigned last.
                    for choice in reversed(WAYS[step]):
                        with m.If(self._has_flags(flags, choice.needs)):
                            m.d.comb += [
                                way.legal.eq(1),
                                way.at_once.eq(choice.program is None),
                                way.program.eq(choice.program or 0),
                            ]
        return way

    def _gate(self, fields):
        """The gate as a number."""
        words = Cat(fields["GATE_LOW"].VALUE.data, fields["GATE_HIGH"].VALUE.data)
        return FloatLayout(self._params.format)(words)

    def _elaborate_ending(self, m, gate, failed, flags, gated, nis):
        """What the end of a program does to the flags and banks, as in the table."""
        fmt = self._params.format
        found = FloatLayout(fmt)(Signal(fmt.width, name="found"))
        above_gate = Signal()
        m.d.comb += [
            Value.cast(found).eq(Mux(self.run.innovation_overflow, fmt.infinity, self.run.nis)),
            # Magnitudes of floating-point numbers compare as integers.
            above_gate.eq(found.magnitude > gate.magnitude),
        ]

        def change(effect):
            for value, chosen in ((0, effect.clears), (1, effect.sets)):
                m.d.sync += [bit.eq(value) for bit in self._bits(flags, chosen)]
            for bank, line in ((Bank.STATE, self.banks.state), (Bank.FACTOR, self.banks.factor)):
                if bank in effect.turns:
                    m.d.sync += line.eq(~line)

        with m.Switch(self.run.program):
            for program in sorted({routine.program for routine in routines(self._params)}):
                ending = ENDINGS[program]
                with m.Case(program):
                    rejected = failed
                    if ending.gives_nis:
                        rejected = failed | above_gate
                        m.d.sync += gated.eq(~failed & above_gate)
                        with m.If(~failed):
                            m.d.sync += nis.eq(found)
                    with m.If(rejected):
                        change(ending.failure)
                    with m.Else():
                        change(ending.success)
