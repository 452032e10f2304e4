"""What the parts of the core say to each other."""

from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from ukf_sw.engine.microcode import routines

__all__ = ["EstimateSignature", "MemorySignature", "RunSignature"]


class RunSignature(wiring.Signature):
    """The run of a program, seen from who starts it.

    Parameters
    ----------
    params : :class:`UkfParams`
        What the core computes.

    Members
    -------
    start : :py:`Out(1)`
        High for one clock to run a program.
    program : :py:`Out(range(...))`
        Which :class:`Program`; valid with :py:`start`. It has no more bits than the core's need.
    sensor : :py:`Out(range(len(params.sensor_rows)))`
        Whose, of a program in :data:`OF_SENSORS`; else 0. Valid with :py:`start`.
    variant : :py:`Out(range(...))`
        Which of its observation models, of :py:`Program.MODEL_H`; else 0. Valid with :py:`start`.
    stop : :py:`Out(1)`
        High for one clock to drop the program that runs.
    observation_mask : :py:`Out(params.m)`
        Bit i takes observation i into an update.
    done : :py:`In(1)`
        High on the last clock of the program.
    error_code, error_index : :py:`In(8)`
        First error of the program, as in the register ERROR; valid with :py:`done`.
    innovation_overflow : :py:`In(1)`
        That error is an innovation too large for the format; valid with :py:`done`.
    nis : :py:`In(params.format.width)`
        Normalised innovation squared of the last update that reached it; valid with :py:`done`.
    """

    def __init__(self, params):
        programs = routines(params)
        super().__init__({
            "start":               Out(1),
            "program":             Out(range(1 + max(found.program for found in programs))),
            "sensor":              Out(range(len(params.sensor_rows))),
            "variant":             Out(range(1 + max(found.variant for found in programs))),
            "stop":                Out(1),
            "observation_mask":    Out(params.m),
            "done":                In(1),
            "error_code":          In(8),
            "error_index":         In(8),
            "innovation_overflow": In(1),
            "nis":                 In(params.format.width),
        })  # fmt: skip


class EstimateSignature(wiring.Signature):
    """A bit for each part of the estimate.

    Members
    -------
    state : :py:`Out(1)`
        For x.
    factor : :py:`Out(1)`
        For L.
    """

    def __init__(self):
        super().__init__({"state": Out(1), "factor": Out(1)})


class MemorySignature(wiring.Signature):
    """Access to a word of the memories of the lanes, seen from the initiator.

    Parameters
    ----------
    params : :class:`UkfParams`
        What the core computes.
    address_width : :class:`int`
        Width of an address within a lane.

    Members
    -------
    lane, address : :py:`Out(range(params.pes))`, :py:`Out(address_width)`
        Word to read or write.
    read_data : :py:`In(params.format.width)`
        That word, :py:`LOAD_LATENCY` clocks after it is asked for.
    write : :py:`Out(1)`
        Write on this clock.
    write_data, write_strobe : :py:`Out(params.format.width)`, :py:`Out(...)`
        Word to write, and its bytes.
    """

    def __init__(self, params, address_width):
        width = params.format.width
        super().__init__({
            "lane":         Out(range(params.pes)),
            "address":      Out(address_width),
            "read_data":    In(width),
            "write":        Out(1),
            "write_data":   Out(width),
            "write_strobe": Out(-(-width // 8)),
        })  # fmt: skip
