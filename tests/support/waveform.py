"""Waveforms, read back clock by clock."""

from bisect import bisect_right

__all__ = ["Waveform"]


class Waveform:
    """A waveform of a core.

    Parameters
    ----------
    file : Path
        FST or VCD.

    Attributes
    ----------
    widths : dict of str to int
        Width of every signal, by its full name.
    clocks : int
        Rising edges of the clock.
    """

    def __init__(self, file):
        # Here, because few tests need it.
        from pywellen import Waveform as Reader

        self._variables = {
            variable.full_name: variable for variable in Reader(str(file)).all_vars()
        }
        self.widths = {name: each.bitwidth for name, each in self._variables.items()}
        self._edges = [time for time, level in self.changes("ukf_core.aclk") if level == 1]
        self.clocks = len(self._edges) - 1
        self._sampled = {}

    def changes(self, name):
        """Changes of a signal: time and new value, which is text where bits are unknown."""
        return list(self._variables[name].tv)

    def __getitem__(self, name):
        """Values of a signal at the end of every clock, just before the next rising edge."""
        if name not in self._sampled:
            changes = self.changes(name)
            times = [time for time, _ in changes]
            self._sampled[name] = [
                changes[bisect_right(times, edge - 1) - 1][1] for edge in self._edges[1:]
            ]
        return self._sampled[name]
