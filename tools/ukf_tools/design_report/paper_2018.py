"""Tables 2, 3 and 4 of the 2018 paper: resources, power and latency of its core.

J. Soh and X. Wu, *A scalable, FPGA-based implementation of the unscented Kalman filter* (2018). All
of it is for the nanosatellite, of 7 states and 22 sigma points, in single precision.
"""

from dataclasses import dataclass

__all__ = [
    "BUS_US",
    "CLOCK_MHZ",
    "LATENCY",
    "POWER",
    "RESOURCES",
    "SOFTWARE",
    "Latency",
    "Power",
    "Used",
]

#: Clock of the core; its processor runs at 667 MHz.
CLOCK_MHZ = 100.0
#: Time of its words on the bus in µs, section 5.3; the system models' computing takes 21 more.
BUS_US = 116.0


@dataclass(frozen=True, kw_only=True)
class Used:
    """A column of table 2: resources on an XC7Z045, after implementation in Vivado.

    Parameters
    ----------
    lut, ff, dsp, bram36
        Look-up tables, flip-flops, DSP slices, and block memories of 36 Kbit.
    """

    lut: int
    ff: int
    dsp: int
    bram36: float


@dataclass(frozen=True, kw_only=True)
class Power:
    """A column of table 3: power in mW, estimated by Xilinx Power Estimator.

    Parameters
    ----------
    clocks, signals, logic, bram, dsp, total
        Rows of the table.
    """

    clocks: int
    signals: int
    logic: int
    bram: int
    dsp: int
    total: int


@dataclass(frozen=True, kw_only=True)
class Latency:
    """A column of table 4: time of an iteration in µs.

    Parameters
    ----------
    sig_gen
        Sigma points; None where the table has them in `predict`.
    system_model
        Both models on the processor: 21 µs of computing, 116 µs for the words on the bus. For
        software alone, the computing of both.
    predict, update, total
        The other rows. The total is as printed; parts are rounded.
    """

    sig_gen: float | None
    system_model: float
    predict: float
    update: float
    total: float

    @property
    def core(self) -> float:
        """What the core computes: all but the models, in µs."""
        return (self.sig_gen or 0.0) + self.predict + self.update

    @property
    def cycles(self) -> int:
        """The same in clocks."""
        return round(self.core * CLOCK_MHZ)


#: Table 2, by number of processing elements.
RESOURCES = {
    1: Used(lut=5_764, ff=7_668, dsp=35, bram36=16.5),
    2: Used(lut=15_158, ff=14_286, dsp=62, bram36=36.5),
    5: Used(lut=29_500, ff=27_311, dsp=104, bram36=62.0),
    10: Used(lut=53_427, ff=48_714, dsp=182, bram36=109.5),
}
#: Table 3, by number of processing elements.
POWER = {
    1: Power(clocks=38, signals=24, logic=23, bram=51, dsp=4, total=140),
    2: Power(clocks=74, signals=83, logic=76, bram=82, dsp=6, total=336),
    5: Power(clocks=136, signals=144, logic=126, bram=112, dsp=21, total=549),
    10: Power(clocks=234, signals=261, logic=219, bram=209, dsp=52, total=975),
}
#: Table 4, by number of processing elements.
LATENCY = {
    1: Latency(sig_gen=None, system_model=137, predict=170, update=56, total=363),
    2: Latency(sig_gen=92, system_model=137, predict=13, update=30, total=272),
    5: Latency(sig_gen=61, system_model=137, predict=8.5, update=21, total=228),
    10: Latency(sig_gen=51, system_model=137, predict=6.5, update=17, total=212),
}
#: Table 4, software alone.
SOFTWARE = Latency(sig_gen=None, system_model=52, predict=522, update=87, total=660)
