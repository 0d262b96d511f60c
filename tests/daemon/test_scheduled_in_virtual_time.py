"""Scheduled runs: the device paces, the host keeps its queue full, in virtual time."""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import pairwise

import pytest
from armrig_core.rig.volts import code_of, device_code, volts_of
from armrig_core.telemetry.telemetry import decode_sample
from armrig_daemon import pipe
from armrig_daemon.config import Config, DeviceTable, TimingTable
from armrig_daemon.decisions.state import Ordered, Phase
from armrig_daemon.pipe import Clock, Gap, RunEnded, RunStarted, State
from armrig_protocol.decoder import feed
from armrig_protocol.frame import encode
from armrig_protocol.messages import Setpoints, Stop
from armrig_protocol.messages import State as DeviceState

from tests.daemon.virtual_bench import MS, Bench

SETPOINTS = len(encode(Setpoints(0, 0, 0, 0, 0, (0,) * 24)))
SAMPLE = 36


def telegraph(n: int, seed: int = 1) -> list[float]:
    """Return n voltages that no two neighbouring indices share by habit."""
    rng = random.Random(seed)
    return [rng.choice([0.0, 0.5, 1.0, 2.5, 4.0, 5.0]) for _ in range(n)]


def run(bench: Bench, volts: list[float], ts_us: int = 10_000) -> None:
    """Play a scheduled run to its end."""
    bench.play(volts, ts_us)
    bench.run_for(len(volts) * ts_us / 1000 + 500)


def assert_aligned(bench: Bench, volts: list[float], missing: int = 0) -> None:
    """Check that every sample of the run has its own u, and k no break but reported gaps."""
    (started,) = bench.of(RunStarted)
    samples = [s for s in bench.samples if 0 <= s.k - started.k_first < len(volts)]
    gaps = [g for g in bench.of(Gap) if 0 <= g.k_first - started.k_first < len(volts)]
    gone = {g.k_first for g in gaps}
    assert len(samples) == len(volts) - missing == len(volts) - len(gone)
    assert {s.k for s in samples} | gone == set(
        range(started.k_first, started.k_first + len(volts))
    )
    for s in samples:
        code = code_of(volts[s.k - started.k_first])
        assert s.u_cmd_v == volts_of(code)
        assert s.u_applied_v == volts_of(device_code(code, 10))
    for gap in gaps:
        code = code_of(volts[gap.k_first - started.k_first])
        assert gap.u_held_v == volts_of(device_code(code, 10))


@pytest.mark.parametrize(
    ("ts_us", "baud"), [(10_000, 500_000), (1_000, 500_000), (500, 1_000_000), (250_000, 115_200)]
)
@pytest.mark.parametrize("queue", [512, 256])
def test_every_u_is_applied_at_its_k(ts_us: int, baud: int, queue: int) -> None:
    """From 4 Hz to 2 kHz; an Uno's queue is enough."""
    bench = Bench(Config(device=DeviceTable(baud=baud)), queue=queue)
    volts = telegraph(20 if ts_us > 100_000 else 2000)

    run(bench, volts, ts_us)

    assert_aligned(bench, volts)
    assert [r.outcome for r in bench.of(RunEnded)] == ["complete"]
    assert bench.phase is Phase.SAFE
    assert bench.volts == 0.0


def _losing(share: float, length: int, seed: int = 3) -> Callable[[bytes], bytes]:
    rng = random.Random(seed)

    def line(data: bytes) -> bytes:
        return b"" if len(data) == length and rng.random() < share else data

    return line


@pytest.mark.parametrize("queue", [512, 256])
def test_lost_setpoints_are_sent_again(queue: int) -> None:
    """Three frames of ten are lost: go-back-N by `queued` fills the queue."""
    bench = Bench(queue=queue)
    bench.ports.to_device = _losing(0.3, SETPOINTS)
    volts = telegraph(3000)

    run(bench, volts)

    assert_aligned(bench, volts)


def test_a_stall_longer_than_the_watchdog_ends_at_0_v() -> None:
    """300 ms: the device stops by itself, and the host trips at its first tick."""
    bench = Bench(Config(device=DeviceTable(watchdog_ms=250)))
    bench.play(telegraph(1000))
    bench.run_for(2000)
    bench.lateness_ns = 300 * MS
    bench.run_for(10)
    bench.lateness_ns = 0

    bench.run_for(500)

    assert bench.ports.device.state is DeviceState.FAULT
    assert bench.phase is Phase.FAULT
    assert bench.volts == 0.0
    assert bench.of(RunEnded)[0].outcome.startswith("the host paused for")
    (gap,) = [g for g in bench.of(Gap) if g.reason.startswith("the host paused for")]
    assert 3 <= gap.count <= 10  # from the watchdog's bite to the host's return
    assert gap.u_held_v == 0.0


def test_missing_answers_of_the_device_stop_a_scheduled_run() -> None:
    """S4: one-way loss; the age limit is the watchdog's, and STOP goes out at once."""
    bench = Bench()
    bench.play(telegraph(1000))
    bench.run_for(2000)
    bench.ports.from_device = lambda _: b""

    bench.run_for(130)

    assert bench.ports.device.state is DeviceState.IDLE
    assert bench.volts == 0.0
    assert "no answer" in bench.loop.state.reason


def test_after_a_trip_no_setpoint_and_no_keepalive_is_sent() -> None:
    """S4, S6: STOP does not arrive, so the watchdog stops the motor."""
    bench = Bench()
    bench.play(telegraph(1000))
    bench.run_for(2000)
    sent: list[type] = []

    def without_stop(data: bytes) -> bytes:
        (message,) = feed(b"", data)[1]
        sent.append(type(message))
        return b"" if isinstance(message, Stop) else data

    bench.ports.to_device = without_stop
    bench.ports.send(bench.ports.now, Ordered(pipe.Stop(order=9)))
    bench.run_for(130)

    assert set(sent) == {Stop}
    assert bench.ports.device.state is DeviceState.FAULT
    assert bench.volts == 0.0


@pytest.mark.parametrize("ppm", [-100.0, 100.0])
def test_a_scheduled_run_keeps_the_period_of_a_drifting_device_clock(ppm: float) -> None:
    bench = Bench(clock_ppm=ppm)
    volts = telegraph(2000)

    run(bench, volts)

    assert_aligned(bench, volts)
    k_first = bench.of(RunStarted)[0].k_first
    times = [s.t_device_us for s in bench.samples if 0 <= s.k - k_first < 2000]
    assert {b - a for a, b in pairwise(times)} == {10_000}


@pytest.mark.parametrize("ppm", [-100.0, 100.0])
@pytest.mark.parametrize("scheduled", [False, True])
def test_the_drift_of_the_device_clock_is_estimated_and_reported(
    ppm: float, scheduled: bool
) -> None:
    """Within three of its own standard deviations."""
    bench = Bench(clock_ppm=ppm)
    bench.play(telegraph(1500), scheduled=scheduled)
    bench.run_for(15_500)

    last = bench.of(Clock)[-1]
    assert last.drift_ppm == pytest.approx(ppm, abs=3 * last.drift_std_ppm + 0.01)
    assert last.drift_std_ppm < 5
    true_ns = bench.ports.now * ppm * 1e-6
    assert last.offset_ns == pytest.approx(true_ns, abs=3 * last.offset_std_ns + 100_000)


def test_the_lateness_of_a_scheduled_sample_does_not_grow_with_the_drift() -> None:
    """Without the map of the clocks 100 ppm in 20 s would be 2 ms."""
    bench = Bench(clock_ppm=-100.0)
    volts = telegraph(2000)

    run(bench, volts)

    k_first = bench.of(RunStarted)[0].k_first
    samples = [s for s in bench.samples if 100 <= s.k - k_first < 2000]
    late_ns = [s.t_host_ns - s.t_sched_ns for s in samples]
    assert max(late_ns) - min(late_ns) < 1 * MS  # a PONG of 0.5 ms may be in the way


def test_the_state_reports_the_period_of_the_following_samples() -> None:
    bench = Bench(Config(timing=TimingTable(Ts=0.02)))

    bench.play([2.0] * 400, 5_000)
    bench.run_for(300)
    bench.ports.from_device = lambda data: b""
    bench.run_for(200)
    bench.ports.from_device = lambda data: data
    bench.run_for(300)

    told, due_ns, periods = 0, 0, []
    for record in bench.records:
        sample = decode_sample(record) if isinstance(record, bytes) else None
        if isinstance(record, State):
            told, due_ns = record.ts_us, 0  # a new pace begins with the next sample
            periods.append((record.phase, told))
        elif isinstance(record, Gap):
            due_ns = 0
        elif sample is not None:
            assert not due_ns or abs(sample.t_sched_ns - due_ns - told * 1000) < 0.1 * MS
            due_ns = sample.t_sched_ns
    assert list(dict.fromkeys(periods)) == [
        ("safe", 20_000),
        ("armed", 5_000),
        ("armed", 10_000),
        ("active", 5_000),
        ("fault", 5_000),
        ("fault", 20_000),
    ]
