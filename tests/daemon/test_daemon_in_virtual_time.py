"""The loop and its core against the emulated device, in virtual time.

The invariants S1 ... S6 and T1 are those of ARCHITECTURE.md.
"""

from __future__ import annotations

from typing import Any

import pytest
from armrig_core.commands.codes import GapCode
from armrig_core.rig.volts import code_of
from armrig_core.telemetry.telemetry import decode_sample
from armrig_daemon import pipe
from armrig_daemon.config import Config, DeviceTable, Limits, TimingTable
from armrig_daemon.decisions.state import LinkDown, LinkUp, Ordered, Phase
from armrig_daemon.pipe import Alive, Answer, Gap, Quit, Reset, RunEnded, RunStarted
from armrig_daemon.pipe import State as StateRecord
from armrig_protocol.messages import Cause
from armrig_protocol.messages import State as DeviceState

from tests.daemon.decisions.test_every_k_is_told_once import assert_each_k_is_told_once
from tests.daemon.virtual_bench import LEASE, MS, Bench, codes


@pytest.fixture
def bench() -> Bench:
    """Return a bench that has met its device, at 0 V."""
    return Bench()


@pytest.fixture
def driven(bench: Bench) -> Bench:
    """Return a bench whose motor is held at 3 V by hand, for as long as its lease lasts."""
    bench.arm()
    bench.order(pipe.Set(order=99, lease=LEASE, n=0, code=code_of(3.0)))
    bench.run_for(20)
    assert bench.volts == pytest.approx(3.0, abs=0.01)
    return bench


# -- the ordinary way ----------------------------------------------------------------------------


def test_a_changed_sampling_time_ends_with_the_lease_of_its_owner(bench: Bench) -> None:
    """The owner's Ts from arming on, the configured Ts afterwards."""
    answer = bench.arm(ts_us=20_000)
    assert answer.body["Ts"] == 0.02

    begin = bench.samples[-1].k
    bench.run_for(1000)
    armed = [s for s in bench.samples if s.k > begin]
    bench.ask(pipe.Disarm, lease=LEASE, n=0)
    begin = bench.samples[-1].k
    bench.run_for(1000)

    assert len(armed) == pytest.approx(50, abs=1)
    assert len([s for s in bench.samples if s.k > begin]) == pytest.approx(100, abs=1)
    assert all(g.code != GapCode.HOST_LATE for g in bench.of(Gap))


# -- who may command, and what -------------------------------------------------------------------


def test_disarm_during_a_start_stops_the_device(bench: Bench) -> None:
    """S6: a release during the start does not leave the device driven."""
    bench.arm()
    bench.order(pipe.Set(order=7, lease=LEASE, n=1, code=code_of(2.0)))
    bench.order(pipe.Disarm(order=8, lease=LEASE, n=2))
    bench.run_for(60)

    answers = {a.order: a for a in bench.of(Answer)}
    assert answers[7].error == "not begun: disarmed"
    assert answers[8].body == {"done": True}
    assert bench.phase is Phase.SAFE
    assert all(s.u_applied_v == 0.0 for s in bench.samples)


# -- what goes wrong -----------------------------------------------------------------------------


def test_missing_answers_of_the_device_stop_the_motor(driven: Bench) -> None:
    """S4: one-way loss; the device still receives, and gets STOP within the age limit."""
    driven.ports.from_device = lambda _: b""
    for n in range(1, 4):
        driven.order(pipe.Set(order=100 + n, lease=LEASE, n=n, code=code_of(3.0)))
        driven.run_for(20)

    driven.run_for(20)

    assert driven.ports.device.state is DeviceState.IDLE
    assert driven.volts == 0.0
    assert "no answer" in driven.loop.state.reason


def test_lost_commands_stop_the_motor(driven: Bench) -> None:
    """S3: the device's own watchdog, 100 ms after the last frame that it took in."""
    driven.ports.to_device = lambda _: b""

    driven.run_for(110)

    assert driven.ports.device.state is DeviceState.FAULT
    assert driven.ports.device.cause is Cause.WATCHDOG
    assert driven.volts == 0.0


def test_a_restored_link_does_not_arm_the_rig(driven: Bench) -> None:
    """S6 and T1: sampling is back within 2 s, latched at 0 V until a reset and an arm."""
    driven.ports.send(driven.ports.now, LinkDown("unplugged"))
    driven.run_for(200)
    driven.ports.device.reset(driven.ports.now)
    driven.ports.send(driven.ports.now, LinkUp())
    before = len(driven.samples)
    driven.run_for(2000)

    assert len(driven.samples) > before + 100
    assert driven.phase is Phase.FAULT
    assert "link lost: unplugged" in driven.loop.state.reason
    assert "in fault" in driven.arm().error

    assert "not the lease in force" in driven.drive(1.0, n=50).error
    driven.ask(Reset)
    assert driven.phase is Phase.SAFE
    assert "not the lease in force" in driven.drive(1.0, n=51).error
    assert not driven.arm().error


def test_a_port_failure_during_a_trip_is_in_the_last_state(driven: Bench) -> None:
    driven.ports.write = lambda _: LinkDown("gone")
    driven.lateness_ns = 60 * MS  # a pause: it trips, and the STOP is the first frame that fails
    driven.run_for(20)

    last = driven.of(StateRecord)[-1]
    assert last.phase == driven.phase
    assert not last.device
    assert last.motor.startswith("not known")


@pytest.mark.parametrize("scheduled", [False, True])
def test_a_replayed_session_of_host_frames_does_not_move_the_motor(
    bench: Bench, scheduled: bool
) -> None:
    """S6: all frames of the host, byte for byte at their times, in the same boot."""
    sent: list[tuple[int, bytes]] = []
    ports, device = bench.ports, bench.ports.device

    def record(data: bytes) -> bytes:
        sent.append((ports.now, data))
        return data

    ports.to_device = record
    ports.send(ports.now, LinkDown("pulled"))
    ports.send(ports.now, LinkUp())  # the session begins, with a HELLO
    bench.run_for(300)
    bench.play([2.5] * 50, scheduled=scheduled)
    bench.run_for(1100)
    assert max(s.u_applied_v for s in bench.samples) == pytest.approx(2.5, abs=0.01)
    bench.ask(pipe.Stop, reason="enough")
    states: set[DeviceState] = set()
    volts: set[float] = set()

    begin_ns = ports.now + MS - sent[0][0]  # from here on nobody turns the loop
    for t_ns, data in [*sent, (sent[-1][0] + 1000 * MS, b"")]:
        while (due_ns := device.next_ns()) < begin_ns + t_ns:
            device.advance(due_ns)
            states.add(device.state)
            volts.add(device.board.volts)
        device.receive(begin_ns + t_ns, data)

    assert DeviceState.READY in states
    assert states <= {DeviceState.IDLE, DeviceState.READY}
    assert volts == {0.0}


def test_a_shorter_sampling_time_is_not_mistaken_for_a_pause() -> None:
    bench = Bench(Config(timing=TimingTable(Ts=0.5)))
    between_ticks = bench.ports.now + 300 * MS

    bench.order(pipe.Arm(order=49, owner="a", lease=LEASE, ts_us=10_000), at_ns=between_ticks)
    bench.run_for(400)
    bench.order(pipe.Run(order=50, lease=LEASE, n=0, run_id="r", codes=codes(*[1.0] * 20)))
    bench.run_for(500)

    assert bench.of(RunEnded)[0].outcome == "complete"
    assert not bench.of(Gap)


@pytest.mark.parametrize("scheduled", [False, True])
def test_every_k_is_published_or_reported(scheduled: bool) -> None:
    """L2: through noise, unplugging, a reset and the end of a run."""
    bench = Bench()
    frames = iter(range(1_000_000))
    bench.play([1.0, 2.0] * 100, scheduled=scheduled)
    bench.run_for(200)
    bench.ports.from_device = lambda data: data if next(frames) % 7 else b""
    bench.run_for(2500)
    bench.ports.send(bench.ports.now, LinkDown("unplugged"))
    bench.run_for(500)
    bench.ports.device.reset(bench.ports.now)
    bench.ports.send(bench.ports.now, LinkUp())
    bench.run_for(500)
    bench.ports.from_device = lambda data: data
    bench.run_for(500)

    assert_each_k_is_told_once(bench)
    (ended,) = bench.of(RunEnded)
    assert ended.outcome == "complete"
    first, told = bench.of(RunStarted)[0].k_first, 0
    for record in bench.records[: bench.records.index(ended)]:
        if isinstance(record, bytes):
            told += first <= decode_sample(record).k < first + 200
        elif isinstance(record, Gap):
            told += record.count if first <= record.k_first < first + 200 else 0
    assert told == 200  # each of the run before its end, the last one, too
    assert bench.samples[-1].k > first + 250
    assert len(bench.of(Gap)) > 10


# -- the end -------------------------------------------------------------------------------------


def test_the_loop_ends_when_the_device_is_seen_stopped(driven: Bench) -> None:
    """0 V, then exit, within 100 ms."""
    began = driven.ports.now

    driven.order(Quit(reason="SIGTERM"))
    driven.run_for(1000)

    assert driven.loop.ended
    assert driven.ports.now - began < 100 * MS
    assert driven.ports.device.state is DeviceState.IDLE
    assert driven.volts == 0.0


def test_the_loop_ends_after_the_loss_of_the_device_too(driven: Bench) -> None:
    began = driven.ports.now
    driven.ports.to_device = lambda _: b""

    driven.order(Quit(reason="SIGTERM"))
    driven.run_for(1000)

    assert driven.loop.ended
    assert driven.ports.now - began < 300 * MS


def test_a_limit_of_the_configuration_reaches_the_device() -> None:
    """S1 in three layers: the device refuses what the daemon would not have sent."""
    bench = Bench(
        Config(limits=Limits(u_max_v=2.0, revolutions=1.5), device=DeviceTable(watchdog_ms=50))
    )

    config = bench.ports.device._fw.config

    assert (config.u_max, config.watchdog_ms, config.turns) == (code_of(2.0), 50, 150)


@pytest.mark.parametrize("ahead_ns", [1, 123_456, 3_000_001])
def test_an_order_for_a_later_time_is_delivered_at_that_time(bench: Bench, ahead_ns: int) -> None:
    at_ns = bench.ports.now + ahead_ns
    bench.order(Alive(), at_ns)
    bench.order(Reset(order=1), at_ns)
    events: list[Any] = []
    while not any(isinstance(event, Ordered) for event in events):
        assert bench.ports.now < at_ns
        events = bench.ports.wait(at_ns + 10 * MS)

    assert bench.ports.now == at_ns
    assert [e for e in events if isinstance(e, Ordered)] == [
        Ordered(Alive()),
        Ordered(Reset(order=1)),
    ]
