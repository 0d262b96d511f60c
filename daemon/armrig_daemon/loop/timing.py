"""Histograms of the loop's timing, in which a stall counts once for each tick that it delays.

References
----------
.. [1] G. Tene, "How NOT to measure latency" (2013): a stall must count once for each sample it
   made late (coordinated omission).
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from itertools import accumulate

from armrig_daemon.pipe import Distribution

_BINS_PER_OCTAVE = 32  # resolution of the values: 1/32, which is 3 %
_MAX_MISSED = 10_000  # limits the work after a suspend; no run survives so many


def _bin(value: int) -> int:
    """Return the bin of a value; a bin is 1 wide below 64, and at most value / 32 wide above."""
    shift = value.bit_length() - 6
    return shift * _BINS_PER_OCTAVE + (value >> shift) if shift > 0 else value


def _greatest_in(index: int) -> int:
    """Return the largest value that belongs to a bin."""
    shift = max(0, index // _BINS_PER_OCTAVE - 1)
    return ((index - shift * _BINS_PER_OCTAVE + 1) << shift) - 1


class Histogram:
    """Counts of non-negative integers (ns) in log-linear bins, with bounded memory."""

    def __init__(self) -> None:
        """Create an empty histogram."""
        self._bins: defaultdict[int, int] = defaultdict(int)
        self._max = 0
        self.n = 0
        self.missed = 0

    def add(self, value_ns: int, missed: int = 0, period_ns: int = 0) -> None:
        """Count the lateness of a tick and of `missed` later ticks, each a period less late."""
        # A comparison is faster than `max`: three values are added at each tick.
        value = value_ns if value_ns > 0 else 0
        if value > self._max:
            self._max = value
        self._bins[_bin(value)] += 1
        self.n += 1
        if missed:
            self.n += missed
            self.missed += missed
            for n in range(1, min(missed, _MAX_MISSED) + 1):
                self._bins[_bin(max(0, value - n * period_ns))] += 1

    def quantiles(self, *shares: float) -> list[int]:
        """Return the quantiles, in ns: values that these shares of the counts do not exceed."""
        indices = sorted(self._bins)
        cumulative = list(accumulate(map(self._bins.__getitem__, indices)))
        at = [bisect_left(cumulative, share * self.n) for share in shares]
        return [min(_greatest_in(indices[i]), self._max) if i < len(cumulative) else 0 for i in at]

    def distribution(self, unit: float) -> Distribution:
        """Return the percentiles in units of `unit` ns; all are 0 if no value was counted."""
        p50, p90, p99, p999 = (q / unit for q in self.quantiles(0.5, 0.9, 0.99, 0.999))
        largest = self._max / unit
        return Distribution(
            p50=p50, p90=p90, p99=p99, p999=p999, max=largest, n=self.n, missed=self.missed
        )
