"""Scheduled runs: the device paces, the host keeps its queue full, in virtual time."""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import pairwise

import pytest
from armrig_core.telemetry import decode_sample
from armrig_core.volts import applied_code, code_of, volts_of
from armrig_daemon import pipe
from armrig_daemon.config import Config, Device, Timing
from armrig_daemon.decisions.state import Ordered, Phase
from armrig_daemon.pipe import Clock, Gap, Log, RunEnded, RunStarted, State
from armrig_daemon.pipe import Timing as TimingRecord
from armrig_protocol.decoder import feed
from armrig_protocol.frame import encode
from armrig_protocol.messages import Event, Flag, Ping, Setpoints, Stop
from armrig_protocol.messages import State as DeviceState

from tests.daemon.virtual_bench import LEASE, MS, Bench, codes

SETPOINTS = len(encode(Setpoints(0, 0, 0, 0, 0, (0,) * 24)))
SAMPLE = 36


def telegraph(n: int, seed: int = 1) -> list[float]:
    """Return n voltages that no two neighbouring indices share by habit."""
    rng = random.Random(seed)
    return [rng.choice([0.0, 0.5, 1.0, 2.5, 4.0, 5.0]) for _ in range(n)]


def play(bench: Bench, volts: list[float], ts_us: int = 10_000) -> None:
    """Arm and begin a scheduled run."""
    assert not bench.ask(pipe.Arm, owner="a student", lease=LEASE, ts_us=ts_us).error
    bench.order(
        pipe.Run(order=500, lease=LEASE, n=0, run_id="r", codes=codes(*volts), scheduled=True)
    )


def run(bench: Bench, volts: list[float], ts_us: int = 10_000) -> None:
    """Play a scheduled run to its end."""
    play(bench, volts, ts_us)
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
        assert s.u_applied_v == volts_of(applied_code(code, 10))
    for gap in gaps:
        code = code_of(volts[gap.k_first - started.k_first])
        assert gap.u_held_v == volts_of(applied_code(code, 10))


@pytest.mark.parametrize(
    ("ts_us", "baud"), [(10_000, 500_000), (1_000, 500_000), (500, 1_000_000), (250_000, 115_200)]
)
@pytest.mark.parametrize("queue", [512, 256])
def test_every_u_is_at_its_k(ts_us: int, baud: int, queue: int) -> None:
    """From 4 Hz to 2 kHz; an Uno's queue is enough."""
    bench = Bench(Config(device=Device(baud=baud)), queue=queue)
    volts = telegraph(20 if ts_us > 100_000 else 2000)

    run(bench, volts, ts_us)

    assert_aligned(bench, volts)
    assert [r.outcome for r in bench.of(RunEnded)] == ["complete"]
    assert bench.phase is Phase.SAFE
    assert bench.volts == 0.0


def test_the_device_keeps_its_period_whatever_the_host_does() -> None:
    """The host wakes 8 ms late each time."""
    bench = Bench()
    bench.lateness_ns = 8 * MS
    volts = telegraph(500)

    run(bench, volts)

    assert_aligned(bench, volts)
    k_first = bench.of(RunStarted)[0].k_first
    times = [s.t_device_us for s in bench.samples if 0 <= s.k - k_first < 500]
    assert {b - a for a, b in pairwise(times)} == {10_000}


def test_the_numbers_of_the_samples_never_go_back() -> None:
    for ts_us in (1_000, 100_000):
        bench = Bench(Config(device=Device(baud=1_000_000)))

        run(bench, telegraph(300 if ts_us == 1_000 else 8), ts_us)
        bench.run_for(200)

        ks = [s.k for s in bench.samples]
        assert all(a < b for a, b in pairwise(ks))


def test_a_second_run_follows_the_first() -> None:
    bench = Bench()
    for _ in range(2):
        run(bench, telegraph(100))
    bench.ask(pipe.Arm, owner="a student", lease=LEASE, ts_us=0)
    bench.order(pipe.Run(order=600, lease=LEASE, n=0, run_id="x", codes=codes(*[1.0] * 50)))
    bench.run_for(1000)

    assert [r.outcome for r in bench.of(RunEnded)] == ["complete"] * 3
    assert bench.of(Gap) == []


def _losing(share: float, length: int, seed: int = 3) -> Callable[[bytes], bytes]:
    rng = random.Random(seed)

    def line(data: bytes) -> bytes:
        return b"" if len(data) == length and rng.random() < share else data

    return line


@pytest.mark.parametrize("queue", [512, 256])
def test_setpoints_that_are_lost_are_sent_again(queue: int) -> None:
    """Three frames of ten are lost: go-back-N by `queued` fills the queue."""
    bench = Bench(queue=queue)
    bench.ports.to_device = _losing(0.3, SETPOINTS)
    volts = telegraph(3000)

    run(bench, volts)

    assert_aligned(bench, volts)


def test_samples_that_are_lost_are_gaps_with_their_voltage() -> None:
    """One of ten is lost; the gap has the queue's own u, confirmed or as commanded."""
    bench = Bench()
    play(bench, volts := telegraph(1000))
    bench.run_for(150)
    bench.ports.from_device = _losing(0.1, SAMPLE)

    bench.run_for(10_500)

    k_first = bench.of(RunStarted)[0].k_first
    missing = sum(0 <= g.k_first - k_first < 1000 for g in bench.of(Gap))
    assert 60 < missing < 140
    assert_aligned(bench, volts, missing)
    assert bench.of(RunEnded)[0].outcome == "complete"


def test_a_stall_shorter_than_the_watchdog_costs_nothing() -> None:
    """150 ms without the host, 250 ms of watchdog."""
    bench = Bench(Config(device=Device(watchdog_ms=250)))
    play(bench, volts := telegraph(1000))
    bench.run_for(2000)
    bench.lateness_ns = 150 * MS
    bench.run_for(10)
    bench.lateness_ns = 0

    bench.run_for(10_000)

    assert_aligned(bench, volts)
    late_us = max(t.wake_lateness_us.max for t in bench.of(TimingRecord))
    assert late_us == pytest.approx(150_000, rel=0.05)


@pytest.mark.parametrize(
    ("queue", "stall_ms", "dry"), [(256, 228, False), (256, 238, True), (512, 220, False)]
)
def test_a_small_queue_may_run_dry_before_the_watchdog_at_1_khz(
    queue: int, stall_ms: int, dry: bool
) -> None:
    """A queue of 256 ms has 24 ms less if no frame fits."""
    bench = Bench(Config(device=Device(watchdog_ms=250)), queue=queue)
    play(bench, telegraph(1500), ts_us=1_000)
    bench.run_for(810)  # where the next frame is almost due
    bench.lateness_ns = stall_ms * MS
    bench.run_for(10)
    bench.lateness_ns = 0

    bench.run_for(1500)

    flagged = [s for s in bench.samples if s.flags & Flag.UNDERRUN]
    assert bool(flagged) is dry
    assert all(s.u_applied_v == 0.0 for s in flagged)
    assert bench.of(RunEnded)[0].outcome == "complete"


def test_a_stall_longer_than_the_watchdog_ends_at_0_v() -> None:
    """300 ms: the device stops by itself, and the host trips at its first tick."""
    bench = Bench(Config(device=Device(watchdog_ms=250)))
    play(bench, telegraph(1000))
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


def test_a_commander_of_setpoints_alone_does_not_feed_the_watchdog() -> None:
    """S3: 100 ms after the line to the device is cut, with a second of setpoints queued."""
    bench = Bench()
    play(bench, telegraph(1000))
    bench.run_for(2000)
    bench.ports.to_device = lambda _: b""

    bench.run_for(110)

    assert bench.ports.device.state is DeviceState.FAULT
    assert bench.volts == 0.0


def test_answers_that_do_not_come_stop_a_scheduled_run() -> None:
    """S4: one-way loss; the age limit is the watchdog's, and STOP goes out at once."""
    bench = Bench()
    play(bench, telegraph(1000))
    bench.run_for(2000)
    bench.ports.from_device = lambda _: b""

    bench.run_for(130)

    assert bench.ports.device.state is DeviceState.IDLE
    assert bench.volts == 0.0
    assert "no answer" in bench.loop.state.reason


def test_a_stop_ends_a_scheduled_run_at_once() -> None:
    """S6: whatever is queued."""
    bench = Bench()
    play(bench, telegraph(1000))
    bench.run_for(2000)

    bench.ask(pipe.Stop)

    assert bench.volts == 0.0
    assert bench.ports.device.state is DeviceState.READY
    assert bench.of(RunEnded)[0].outcome == "stopped"


def test_after_a_trip_no_setpoint_and_no_life_is_sent() -> None:
    """S4, S6: STOP does not arrive, so the watchdog stops the motor."""
    bench = Bench()
    play(bench, telegraph(1000))
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


def test_a_stop_is_asked_for_until_the_device_has_stopped() -> None:
    bench = Bench(Config(device=Device(watchdog_ms=250)))
    play(bench, telegraph(1000))
    bench.run_for(2000)
    bench.ports.to_device = lambda data: b"" if isinstance(feed(b"", data)[1][0], Stop) else data
    bench.order(pipe.Stop(order=9))
    bench.run_for(150)
    bench.ports.to_device = lambda data: data

    bench.run_for(60)

    assert bench.phase is Phase.FAULT
    assert bench.ports.device.state is DeviceState.IDLE
    assert bench.volts == 0.0


def test_a_device_that_leaves_the_run_early_is_not_at_its_end() -> None:
    bench = Bench()
    play(bench, telegraph(1000))
    bench.run_for(2000)

    bench.ports.device.receive(bench.ports.now, encode(Stop(0, 9)))
    bench.run_for(300)

    assert bench.phase is Phase.FAULT
    assert "which the daemon did not request" in bench.of(RunEnded)[0].outcome
    assert bench.volts == 0.0


def test_an_end_that_is_not_heard_is_an_end_all_the_same() -> None:
    """EVENT(END) is lost; after the end of the run IDLE means that it ended."""
    bench = Bench()
    bench.ports.from_device = lambda data: (
        b"" if any(isinstance(m, Event) for m in feed(b"", data)[1]) else data
    )

    run(bench, telegraph(100))

    assert bench.of(RunEnded)[0].outcome == "complete"


def test_a_stop_while_the_queue_is_filled_refuses_the_run() -> None:
    bench = Bench()
    bench.ports.to_device = _losing(1.0, SETPOINTS)
    play(bench, telegraph(1000))
    bench.run_for(100)

    bench.ask(pipe.Stop)

    answers = {a.order: a for a in bench.records if hasattr(a, "order")}
    assert "stopped" in answers[500].error
    assert bench.phase is Phase.SAFE
    assert not bench.of(RunStarted)


def test_a_device_that_takes_no_setpoints_starts_no_run() -> None:
    bench = Bench()
    bench.ports.to_device = _losing(1.0, SETPOINTS)
    play(bench, telegraph(1000))

    bench.run_for(3000)

    answers = {a.order: a for a in bench.records if hasattr(a, "order")}
    assert "does not take the setpoints" in answers[500].error
    assert bench.phase is Phase.SAFE
    assert bench.volts == 0.0


def test_an_underrun_is_flagged_in_its_sample_and_reported() -> None:
    bench = Bench(Config(device=Device(baud=1_000_000)))
    play(bench, volts := [3.0] * 4000, ts_us=500)
    bench.run_for(300)
    bench.ports.to_device = _losing(1.0, SETPOINTS)
    bench.run_for(400)
    bench.ports.to_device = lambda data: data
    bench.run_for(3000)

    dry = [s for s in bench.samples if s.flags & Flag.UNDERRUN]
    assert dry
    assert {s.u_applied_v for s in dry} == {0.0}
    assert any("had no setpoint" in log.message for log in bench.of(Log))
    assert len(volts) == 4000


def test_a_sampling_time_that_only_scheduled_mode_carries_is_not_played_by_hand() -> None:
    """2 kHz over 1 Mbaud."""
    bench = Bench(Config(device=Device(baud=1_000_000)))
    assert not bench.ask(pipe.Arm, owner="a", lease=LEASE, ts_us=500).error

    answer = bench.ask(pipe.Run, lease=LEASE, n=0, run_id="r", codes=codes(1.0))

    assert "cannot be carried in exchange mode" in answer.error


@pytest.mark.parametrize("ppm", [-100.0, 100.0])
def test_a_device_clock_that_drifts_keeps_its_own_time(ppm: float) -> None:
    bench = Bench(clock_ppm=ppm)
    volts = telegraph(2000)

    run(bench, volts)

    assert_aligned(bench, volts)
    k_first = bench.of(RunStarted)[0].k_first
    times = [s.t_device_us for s in bench.samples if 0 <= s.k - k_first < 2000]
    assert {b - a for a, b in pairwise(times)} == {10_000}


def test_a_run_with_too_many_missed_ticks_is_stopped_where_that_is_asked_for() -> None:
    """`stop_after` is "maximum missed ticks" of the students' earlier tool; exchange mode only."""
    bench = Bench(Config(timing=Timing(stop_after=3)))
    bench.arm()
    bench.order(pipe.Run(order=50, lease=LEASE, n=0, run_id="r", codes=codes(*[2.0] * 100)))
    bench.run_for(200)
    bench.lateness_ns = 35 * MS
    bench.run_for(20)
    bench.lateness_ns = 0
    bench.run_for(100)

    assert bench.phase is Phase.FAULT
    assert "ticks in a row were missed: 3 are allowed" in bench.loop.state.reason
    assert bench.volts == 0.0


def test_the_clock_of_the_device_is_asked_for_all_the_time() -> None:
    """PING every 25 ms feeds the watchdog, also when all setpoints are there."""
    bench = Bench()
    pings = 0
    length = len(encode(Ping(0, 0, 0)))

    def count(data: bytes) -> bytes:
        nonlocal pings
        pings += len(data) == length
        return data

    play(bench, telegraph(100))
    bench.run_for(100)
    bench.ports.to_device = count
    bench.run_for(500)

    assert pings == pytest.approx(20, abs=5)


@pytest.mark.parametrize("ppm", [-100.0, 0.0, 100.0])
@pytest.mark.parametrize("scheduled", [False, True])
def test_the_drift_of_the_device_is_found_and_reported(ppm: float, scheduled: bool) -> None:
    """Within three of its own standard deviations."""
    bench = Bench(clock_ppm=ppm)
    volts = telegraph(3000)
    bench.arm()
    bench.order(
        pipe.Run(order=9, lease=LEASE, n=0, run_id="r", codes=codes(*volts), scheduled=scheduled)
    )
    bench.run_for(30_500)

    last = bench.of(Clock)[-1]
    assert last.drift_ppm == pytest.approx(ppm, abs=3 * last.drift_std_ppm + 0.01)
    assert last.drift_std_ppm < 5
    true_ns = bench.ports.now * ppm * 1e-6
    assert last.offset_ns == pytest.approx(true_ns, abs=3 * last.offset_std_ns + 100_000)


def test_the_lateness_of_a_scheduled_sample_does_not_grow_with_the_drift() -> None:
    """Without the map of the clocks 100 ppm in 60 s would be 6 ms."""
    bench = Bench(clock_ppm=-100.0)
    volts = telegraph(6000)

    run(bench, volts)

    k_first = bench.of(RunStarted)[0].k_first
    samples = [s for s in bench.samples if 100 <= s.k - k_first < 6000]
    late_ns = [s.t_host_ns - s.t_sched_ns for s in samples]
    assert max(late_ns) - min(late_ns) < 1 * MS  # a PONG of 0.5 ms may be in the way


def test_the_state_reports_the_period_of_the_samples_that_come() -> None:
    bench = Bench(Config(timing=Timing(Ts=0.02)))
    assert not bench.arm(5_000).error
    order = pipe.Run(
        order=9, lease=LEASE, n=0, run_id="r", codes=codes(*[2.0] * 400), scheduled=True
    )

    bench.order(order)
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
