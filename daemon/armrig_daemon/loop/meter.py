"""Statistics of the loop's timing, for each second."""

from __future__ import annotations

from armrig_core.telemetry.telemetry import Sample

from armrig_daemon.decisions.clockmap import ClockMap, estimate
from armrig_daemon.loop.timing import Histogram
from armrig_daemon.pipe import Clock, Timing

_SECOND_NS = 1_000_000_000


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

    def woke(self, late_ns: int, missed: int, period_ns: int) -> None:
        """Count one wake-up, and the ticks that were missed before it."""
        self._wake.add(late_ns, missed, period_ns)

    def came_back(self, round_trip_ns: int) -> None:
        """Count one round trip."""
        self._trip.add(round_trip_ns)

    def queued(self, depth: int) -> None:
        """Count one observed length of the device's queue, in setpoints."""
        self._queue.add(depth)

    def sampled(self, sample: Sample, ts_ns: int) -> None:
        """Count the deviation of the device's sampling interval from the sampling time."""
        last, self._device = self._device, (sample.k, sample.t_device_us, ts_ns)
        if last is not None and sample.k > last[0] and ts_ns == last[2]:
            apart_ns = (sample.t_device_us - last[1]) * 1000
            self._error.add(abs(apart_ns - (sample.k - last[0]) * ts_ns))

    def forget_device(self) -> None:
        """Forget the last sample, so that no interval includes a change of the period."""
        self._device = None

    def each_second(self, now_ns: int, collections: int) -> Timing | None:
        """Return the statistics once a second, with the number of garbage collections so far."""
        if now_ns - self._since_ns < _SECOND_NS:
            return None
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
    known = estimate(clock)
    return Clock(
        t_host_ns=now_ns,
        offset_ns=known.offset_ns,
        offset_std_ns=known.offset_std_ns,
        drift_ppm=known.drift_ppm,
        drift_std_ppm=known.drift_std_ppm,
        bound_ns=known.bound_ns,
    )
