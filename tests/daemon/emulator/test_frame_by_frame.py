"""The device taken one frame at a time, and the corners that no ordinary session comes to."""

from __future__ import annotations

import numpy as np
import pytest
from armrig_daemon.emulator.board import Board
from armrig_daemon.emulator.clock import EmulatedClock
from armrig_daemon.emulator.converter import latch
from armrig_daemon.emulator.device import LEAD_NS, Device
from armrig_daemon.emulator.firmware import NEVER, Firmware, Hardware, PendingSample
from armrig_daemon.emulator.requests import cal_answer
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_daemon.emulator.uart import Reception
from armrig_protocol import messages as wire
from armrig_protocol.frame import encode
from armrig_protocol.messages import SCHEMA_HASH, VERSION, Cause, Flag, Mode, State

from tests.daemon.emulator.emulated_host import (
    CONFIG,
    CONVERSION_NS,
    EXCHANGE_NS,
    MS,
    QUIET,
    SAMPLE_NS,
    US,
    Host,
    S,
    bytes_of,
    events,
    only,
)
from tests.simulator.watched import FrameByFrame

SCHEDULED: dict[str, int] = {**CONFIG, "mode": Mode.SCHEDULED, "ts_us": 500}
SESSION: list[tuple[int, bytes | wire.Message]] = [
    (1 * MS, wire.Hello(0, 0, VERSION, SCHEMA_HASH)),
    (1 * MS, wire.Config(0, 0, **CONFIG)),
    (1 * MS, wire.Arm(0, 0, 0, 0, 0)),
    (1 * MS, wire.Start(0, 0, 0, 0)),
    *[(700 * US, wire.Exchange(0, 0, 0, 30_000 + i)) for i in range(20)],
    (0, wire.Ping(0, 0, 5)),
    (0, b"noise\0"),
    (1100 * MS, wire.Keepalive(0, 0)),
    (1 * MS, b""),  # nothing leaves meanwhile
]


def test_the_device_sends_the_same_frames_one_by_one_as_all_at_once() -> None:
    sent = bytes_of(QUIET, SESSION)
    at_once, apart = Device(QUIET, 0), FrameByFrame(QUIET, 0)
    one: list[tuple[int, bytes]] = []
    other: list[tuple[int, bytes]] = []

    for t_ns, data in [*sent, (4 * S, b"")]:
        one += at_once.advance(t_ns)
        while frames := apart.advance_to_frame(t_ns):
            assert len(frames) in (1, 2)  # an ACK and the EVENT of its transition are made at once
            other += frames
        at_once.receive(t_ns, data)
        apart.receive(t_ns, data)

    assert len(one) > 30
    assert other == one
    assert apart.advance_to_frame(4 * S) == []


def test_status_reports_the_counters_of_a_new_device() -> None:
    host = Host()
    host.hello()

    status = only(wire.Status, host.wait(1 * S))

    assert status._replace(boot=0, seq=0, uptime_ms=0) == wire.Status(
        state=State.IDLE,
        seq=0,
        boot=0,
        vcc_mv=5000,
        uptime_ms=0,
        frames=1,
        spoilt=0,
        refused=0,
        rx_lost=0,
        tx_dropped=0,
        late=0,
        underruns=0,
        isr_max_us=0,
        stack_free=65535,
    )
    assert status.uptime_ms == 1000


@pytest.mark.parametrize(
    ("u", "k", "seq", "samples"),
    [(100, 2, None, True), (101, 2, None, False), (100, 1, None, False), (100, 2, 1, False)],
)
def test_visible_time_skips_the_conversions_of_a_sample(
    u: int, k: int, seq: int | None, samples: bool
) -> None:
    host = Host().reach(State.RUN, u_max=100)
    host.ask(wire.Exchange, k=1, u=50)

    arrival_ns = host.put(wire.Exchange, k=k, u=u, seq=seq)
    visible_ns = host.device.visible_ns()
    (left_ns, _), *_ = host.device.advance(arrival_ns + 2 * MS)

    assert visible_ns <= left_ns
    assert (visible_ns >= arrival_ns + 2 * CONVERSION_NS) == samples
    if samples:
        assert visible_ns == left_ns - LEAD_NS


def test_the_wire_predicts_the_arrival_of_the_second_piece() -> None:
    reception = Reception(0, 1_000_000)
    times = []
    for data in (b"", b"ab\0", b"c\0", b"defg\0", b"h\0"):
        reception.put(0, data)
        times.append((reception.first_ns, reception.second_ns()))

    assert times == [(NEVER, NEVER), (30_000, NEVER), *[(30_000, 50_000)] * 3]


def test_the_wire_gives_its_next_piece_before_it_has_arrived() -> None:
    reception = Reception(0, 1_000_000)
    frame = encode(wire.Keepalive(0, 7))
    reception.put(0, frame + encode(wire.Setpoints(0, 8, 0, 1, 0, (5,) + (0,) * 23)))

    assert reception.first() == frame
    assert reception.first_ns == len(frame) * 10 * US
    assert reception.peek() == reception.pop() == [wire.Keepalive(0, 7)]
    assert reception.first() != frame


def test_visible_time_includes_frames_during_conversions() -> None:
    host = Host().reach(State.RUN)
    host.put(wire.Exchange, k=1, u=50)
    host.put(wire.Ping, host_ns=7)

    visible_ns = host.device.visible_ns()
    (left_ns, _), *_ = host.device.advance(host.now_ns + 2 * MS)

    assert visible_ns <= left_ns < host.now_ns + EXCHANGE_NS + 2 * CONVERSION_NS + SAMPLE_NS


def _firmware() -> Firmware:
    return Firmware(
        board=Board(QUIET, 0, np.random.default_rng(0)),
        hardware=Hardware(conversion_ns=1, hold_ns=1, adc_bits=10, pwm_bits=10, queue=512),
        rng=np.random.default_rng(0),
        clock=EmulatedClock(0),
        boot_id=1,
        mcusr=1,
    )


def test_a_run_that_has_lost_its_timer_ends_at_0_v() -> None:
    """S1."""
    firmware = _firmware()
    firmware.state = State.RUN
    firmware.board.latch(0, 65535, Cause.REQUEST)

    (event,) = firmware.tick(0)

    assert events([event]) == [(State.RUN, State.IDLE, Cause.END)]
    assert firmware.board.volts == 0.0


def test_no_sample_of_scheduled_mode_is_latched_without_a_queue() -> None:
    """S5."""
    firmware = _firmware()
    firmware.pending.append(PendingSample(0, 0))

    with pytest.raises(RuntimeError, match="needs a queue"):
        latch(firmware, 0)

    assert firmware.board.volts == 0.0


def test_readings_without_a_cal_in_progress_have_no_answer() -> None:
    with pytest.raises(RuntimeError, match="no CAL is in progress"):
        cal_answer(_firmware(), [1])


def test_the_end_of_a_run_is_visible_at_its_due_time() -> None:
    host = Host().reach(State.ARMED, **SCHEDULED)
    host.supply(0, [10, 20, 30])
    host.wait(1 * MS)
    host.put(wire.Start, k_stop=3)
    frames: list[tuple[int, bytes]] = []

    while host.device.state is not State.IDLE:
        at_ns = host.device.visible_ns()
        assert all(left >= at_ns for left, _ in host.device.advance(at_ns - 1))
        frames += host.device.advance(at_ns)

    fw = host.device._fw
    assert (fw.state, fw.cause) == (State.IDLE, Cause.END)
    assert fw.timer_ns == NEVER


@pytest.mark.parametrize("state", [State.READY, State.RUN])
def test_an_alpha_at_its_rail_is_reported_in_each_sample(state: State) -> None:
    railed = EmulatorSettings(
        baud=1_000_000, boot_ms=5.0, adc_noise_v=0.0, alpha_zero_deg=0.0, pwm_bits=0, adc_bits=0
    )
    host = Host(railed).reach(state, rail_ticks=2)

    first = host.ask(wire.Exchange, k=1, u=0)
    second = host.ask(wire.Exchange, k=2, u=0)

    for answers in (first, second):
        sample = only(wire.Sample, answers)
        assert sample.flags & Flag.ADC1_RAIL
        assert not sample.flags & Flag.ADC0_RAIL
    tripped = [m for m in second if isinstance(m, wire.Event)]
    assert [m.cause for m in tripped] == ([Cause.ADC_RAIL] if state is State.RUN else [])
