"""Histograms of what the loop's timing was, with percentiles that do not flatter.

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

_STEPS = 32  # a power of two is cut into so many: values are known to 1/32, that is 3 %
_MOST_MISSED = 10_000  # more than any run survives; bounds the work after a suspend


def _bin(value: int) -> int:
    """Return the log-linear bin of a value: exact below 32, to 1/32 of the value above."""
    shift = value.bit_length() - 6
    return shift * _STEPS + (value >> shift) if shift > 0 else value


def _greatest_in(index: int) -> int:
    """Return the greatest value that falls in a bin."""
    shift = max(0, index // _STEPS - 1)
    return ((index - shift * _STEPS + 1) << shift) - 1


class Histogram:
    """Counts of non-negative integers (ns) in log-linear bins, with bounded memory."""

    def __init__(self) -> None:
        """Start empty."""
        self._bins: defaultdict[int, int] = defaultdict(int)
        self._max = 0
        self.n = 0
        self.missed = 0

    def add(self, value_ns: int, missed: int = 0, period_ns: int = 0) -> None:
        """Count a value; `missed` ticks behind it count too, each a period less late."""
        # By comparing and not by `max`: three values are added at each tick.
        value = value_ns if value_ns > 0 else 0
        if value > self._max:
            self._max = value
        self._bins[_bin(value)] += 1
        self.n += 1
        if missed:
            self.n += missed
            self.missed += missed
            for n in range(1, min(missed, _MOST_MISSED) + 1):
                self._bins[_bin(max(0, value - n * period_ns))] += 1

    def quantiles(self, *shares: float) -> list[int]:
        """Return for each share the value in ns that so much of all counts does not exceed."""
        indices = sorted(self._bins)
        cumulative = list(accumulate(map(self._bins.__getitem__, indices)))
        at = [bisect_left(cumulative, share * self.n) for share in shares]
        return [min(_greatest_in(indices[i]), self._max) if i < len(cumulative) else 0 for i in at]

    def distribution(self, unit: float) -> Distribution:
        """Return the percentiles in `unit` of what was counted; all 0 where nothing was."""
        p50, p90, p99, p999 = (q / unit for q in self.quantiles(0.5, 0.9, 0.99, 0.999))
        largest = self._max / unit
        return Distribution(
            p50=p50, p90=p90, p99=p99, p999=p999, max=largest, n=self.n, missed=self.missed
        )
