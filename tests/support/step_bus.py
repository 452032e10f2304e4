"""A golden model whose steps do not end as they should, and time that passes by looking at it."""

from support.breaking_bus import BreakingBus
from ukf_sw.spec.registers import CONTROL, INTERRUPT_PENDING
from ukf_sw.spec.sequence import STEPS

__all__ = ["Clock", "StepBus", "finish_when_given_up"]


class Clock:
    """Time that passes by looking at it, a millisecond a look."""

    def __init__(self):
        self.time = 0.0

    def __call__(self):
        self.time += 1e-3
        return self.time


class StepBus(BreakingBus):
    """Holds one of the steps; or resets the core when it has started."""

    step = None
    resets = False

    def hold(self, step, *, resets=False):
        """Hold the step of this number, from 1 on; None is none."""
        self.step, self.resets = step, resets
        self.core.hold = False

    def write(self, address, word):
        starts = address == CONTROL.offset and word & sum(CONTROL[s.name].mask for s in STEPS)
        if starts and self.step is not None:
            self.step -= 1
            self.core.hold = self.step == 0
        super().write(address, word)
        if starts and self.step == 0 and self.resets:
            super().write(address, CONTROL["RESET"].mask | CONTROL["ENABLE"].mask)


def finish_when_given_up(bus):
    """Have the step end just before the reset, and the processor's handler clear its event."""
    write = bus.write

    def late(address, word):
        if address == CONTROL.offset and word & CONTROL["RESET"].mask and bus.core.busy:
            bus.core.finish()
            if bus.core.irq:
                bus.core.write(INTERRUPT_PENDING.offset, 0b11)
        write(address, word)

    bus.write = late
