"""Numbers that come to their end: 32 bits of k, of the device's µs, and a clock that is stepped."""

from __future__ import annotations

import time

import pytest
from armrig_core.rig.volts import code_of, volts_of
from armrig_daemon.decisions.state import Phase
from armrig_daemon.pipe import Gap, RunEnded, RunStarted

from tests.daemon.virtual_bench import MS, Bench

TS_US = 10_000
WRAP = 1 << 32
RUN = [float(v) for v in (0.5, 2.0, 5.0, 1.0) * 50]


def _play(bench: Bench, *, scheduled: bool) -> None:
    bench.play(RUN, TS_US, scheduled=scheduled)
    bench.run_for(len(RUN) * TS_US / 1000 + 500)
    assert [r.outcome for r in bench.of(RunEnded)] == ["complete"]


def _assert_whole(bench: Bench) -> None:
    """Check that every k of the run is there once, with its own u, at regular times."""
    (started,) = bench.of(RunStarted)
    run = [s for s in bench.samples if 0 <= s.k - started.k_first < len(RUN)]
    assert [s.k - started.k_first for s in run] == list(range(len(RUN)))
    assert [s.u_cmd_v for s in run] == [volts_of(code_of(u)) for u in RUN]
    assert [s.u_applied_v for s in run] == pytest.approx(RUN, abs=5 / 1024)
    assert {s.t_device_us - run[0].t_device_us - (s.k - run[0].k) * TS_US for s in run} <= {0, 1}
    lateness = [s.t_host_ns - s.t_sched_ns for s in run]
    assert max(lateness) - min(lateness) < 2 * MS
    assert bench.of(Gap) == []
    assert bench.phase is Phase.SAFE
    assert bench.volts == 0.0


@pytest.mark.parametrize("scheduled", [False, True])
def test_k_continues_after_32_bits_on_the_wire(scheduled: bool) -> None:
    bench = Bench(k=WRAP - 100)

    _play(bench, scheduled=scheduled)

    _assert_whole(bench)
    ks = [s.k for s in bench.samples]
    assert ks == list(range(ks[0], ks[0] + len(ks)))
    assert ks[0] < WRAP < ks[-1]


@pytest.mark.parametrize("scheduled", [False, True])
def test_the_device_s_microseconds_wrap_in_a_run(scheduled: bool) -> None:
    """A device that has been on for 71 minutes."""
    bench = Bench(switched_on_ns=1_500 * MS - WRAP * 1000)

    _play(bench, scheduled=scheduled)

    _assert_whole(bench)
    (started,) = bench.of(RunStarted)
    raw = [s.t_device_us for s in bench.samples if s.k >= started.k_first]
    assert raw[0] < WRAP < raw[-1]


def test_a_step_of_the_real_time_clock_changes_no_byte_of_the_recording(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    alone = Bench()
    _play(alone, scheduled=True)
    hours = iter(range(1, 1_000_000))

    for name, hour in (("time", 3600), ("time_ns", 3600 * 10**9)):
        monkeypatch.setattr(time, name, lambda hour=hour: next(hours) * hour)
    stepped = Bench()
    _play(stepped, scheduled=True)

    assert str(stepped.records) == str(alone.records)  # as text, where nan is nan
    assert next(hours) == 1
