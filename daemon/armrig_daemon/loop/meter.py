"""Statistics of the loop's timing, for each second."""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from itertools import accumulate

from armrig_core.telemetry.telemetry import Sample

from armrig_daemon.decisions.clockmap import ClockMap, estimate
from armrig_daemon.pipe import Clock, Distribution, Timing

_SECOND_NS = 1_000_000_000
_BINS_PER_OCTAVE = 32  # resolution of the values: 1/32, which is 3 %
_MAX_MISSED = 10_000  # limits the work after a suspend; no run survives so many


class Meter:
    """Histograms of the loop's timing during the current second."""

    def __init__(self, now_ns: int) -> None:
        """Start the first second now."""
        self._begin(now_ns)
        self._device: tuple[int, int, int] | None = None

    def _begin(self, now_ns: int) -> None:
        self._since_ns = now_ns
        self._wake, self._error, self._trip = Histogram(), Histogram(), Histogram()
        self._queue = Histogram()

    def note_wake(self, late_ns: int, missed: int, period_ns: int) -> None:
        """Count one wake-up, and the ticks that were missed before it."""
        self._wake.add(late_ns, missed, period_ns)

    def note_round_trip(self, round_trip_ns: int) -> None:
        """Count one round trip."""
        self._trip.add(round_trip_ns)

    def note_queue(self, depth: int) -> None:
        """Count one observed length of the device's queue, in setpoints."""
        self._queue.add(depth)

    def note_sample(self, sample: Sample, ts_ns: int) -> None:
        """Count the deviation of the device's sampling interval from the sampling time."""
        last, self._device = self._device, (sample.k, sample.t_device_us, ts_ns)
        if last is not None and sample.k > last[0] and ts_ns == last[2]:
            apart_ns = (sample.t_device_us - last[1]) * 1000
            self._error.add(abs(apart_ns - (sample.k - last[0]) * ts_ns))

    def forget_device(self) -> None:
        """Forget the last sample, so that no interval includes a change of the period."""
        self._device = None

    def is_second_over(self, now_ns: int) -> bool:
        """Return whether the statistics are due."""
        return now_ns - self._since_ns >= _SECOND_NS

    def take_second(self, now_ns: int, collections: int) -> Timing:
        """Return the statistics, with the number of garbage collections so far; start again."""
        timing = Timing(
            t_host_ns=now_ns,
            wake_lateness_us=self._wake.distribution(1e3),
            device_tick_error_us=self._error.distribution(1e3),
            link_round_trip_us=self._trip.distribution(1e3),
            queue_depth=self._queue.distribution(1),
            collections=collections,
        )
        self._begin(now_ns)
        return timing


def clock_record(clock: ClockMap, now_ns: int) -> Clock | None:
    """Return the estimate of the device's clock, or None before the first exchange."""
    if not clock.weight:
        return None
    clock_estimate = estimate(clock)
    return Clock(
        t_host_ns=now_ns,
        offset_ns=clock_estimate.offset_ns,
        offset_std_ns=clock_estimate.offset_std_ns,
        drift_ppm=clock_estimate.drift_ppm,
        drift_std_ppm=clock_estimate.drift_std_ppm,
        bound_ns=clock_estimate.bound_ns,
    )


def _bin(value: int) -> int:
    """Return the bin of a value; a bin is 1 wide below 64, and at most value / 32 wide above."""
    shift = value.bit_length() - 6
    return shift * _BINS_PER_OCTAVE + (value >> shift) if shift > 0 else value


def _greatest_in(index: int) -> int:
    """Return the largest value that belongs to a bin."""
    shift = max(0, index // _BINS_PER_OCTAVE - 1)
    return ((index - shift * _BINS_PER_OCTAVE + 1) << shift) - 1


class Histogram:
    """Counts of non-negative integers (ns) in log-linear bins, with bounded memory.

    A stall counts once for each tick that it delays [1]_.

    References
    ----------
    .. [1] G. Tene, "How NOT to measure latency" (2013): a stall must count once for each sample it
       made late (coordinated omission).
    """

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
