"""Times that the loop measures, second by second."""

from __future__ import annotations

from armrig_core.telemetry.channels import SAMPLE_FIELDS
from armrig_core.telemetry.telemetry import Sample
from armrig_daemon.decisions.clockmap import LinkTiming, start
from armrig_daemon.loop.meter import Meter, clock_record

S, MS, US = 1_000_000_000, 1_000_000, 1_000
BEGAN = 5 * S


def _sample(k: int, t_device_us: int) -> Sample:
    return Sample(*(0 for _ in SAMPLE_FIELDS))._replace(k=k, t_device_us=t_device_us)


def test_statistics_are_reported_after_each_second_and_start_again_at_0() -> None:
    meter = Meter(BEGAN)
    meter.note_wake(30 * US, 2, 10 * US)
    meter.note_round_trip(20 * US)
    meter.note_queue(7)

    assert [meter.is_second_over(BEGAN + ns) for ns in (S - 1, S)] == [False, True]
    told = meter.take_second(BEGAN + S, 4)
    assert [meter.is_second_over(BEGAN + ns) for ns in (2 * S - 1, 2 * S)] == [False, True]
    nothing = meter.take_second(BEGAN + 2 * S, 4)

    assert (told.t_host_ns, told.collections) == (BEGAN + S, 4)
    wake = told.wake_lateness_us
    assert (wake.max, wake.n, wake.missed) == (30.0, 3, 2)
    assert told.link_round_trip_us.max == 20.0
    assert told.queue_depth.max == 7
    empty = (nothing.wake_lateness_us, nothing.link_round_trip_us, nothing.queue_depth)
    assert [(it.n, it.missed, it.max) for it in empty] == [(0, 0, 0.0)] * 3


def test_the_device_s_error_is_its_distance_from_the_period() -> None:
    meter = Meter(BEGAN)
    for k, t_us in ((1, 1000), (2, 2007), (5, 4997), (3, 9000), (4, 10_000)):
        meter.note_sample(_sample(k, t_us), 1 * MS)
    meter.forget_device()
    meter.note_sample(_sample(9, 99_000), 2 * MS)
    meter.note_sample(_sample(10, 101_000), 2 * MS)

    told = meter.take_second(BEGAN + S, 0)

    assert (told.device_tick_error_us.n, told.device_tick_error_us.max) == (4, 10.0)


def test_a_clock_without_a_comparison_is_not_reported() -> None:
    assert clock_record(start(LinkTiming()), BEGAN) is None
