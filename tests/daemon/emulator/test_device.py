"""The device in virtual time, to the nanosecond: what the rules of `conformance/` do not reach.

They are tried on it in tests/daemon/conformance, and are not repeated here.
"""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from armrig_daemon.emulator.board import Change
from armrig_daemon.emulator.device import Device
from armrig_daemon.emulator.settings import EmulatorSettings
from armrig_protocol import decoder, frame
from armrig_protocol import messages as wire
from armrig_protocol.messages import SCHEMA_HASH, VERSION, Cause, Code, Flag, State

from tests.daemon.emulator.emulated_host import (
    BAUD,
    CONFIG,
    CONVERSION_NS,
    EXCHANGE_NS,
    HOLD_NS,
    MS,
    QUIET,
    SAMPLE_NS,
    US,
    Host,
    S,
    codes,
    events,
    only,
)

# ------------------------------------------------------------------ boot


def test_the_end_of_boot_is_reported_with_the_state_idle() -> None:
    device = Device(QUIET, 0)

    (_, first), (t_ns, second) = device.advance(10 * MS)

    _, (event,) = decoder.feed(b"", second)
    assert first == b"\0"
    assert t_ns == 5 * MS + 10 * US + 260 * US
    assert events([event]) == [(State.BOOT, State.IDLE, Cause.POWER_ON)]


def test_the_first_received_byte_is_the_byte_in_progress_at_the_end_of_boot() -> None:
    ping = frame.encode(wire.Ping(0, 1, 7))
    for gone, answers, spoilt in (
        (0, 1, 0),
        (1, 0, 1),
        (len(ping) - 2, 0, 1),
        (len(ping) - 1, 0, 0),  # an empty frame: the 00 alone is heard
    ):
        device = Device(QUIET, 0)
        device.receive(5 * MS - gone * 10 * US - 5 * US, ping)

        assert len(device.advance(50 * MS)) == 2 + answers, gone
        later = b"".join(data for _, data in device.advance(1500 * MS))
        assert only(wire.Status, decoder.feed(b"", later)[1]).spoilt == spoilt, gone


def test_a_reset_draws_a_new_boot_id_and_drops_to_0_v() -> None:
    host = Host().reach(State.RUN)
    before = host.hello()
    host.ask(wire.Exchange, k=1, u=65535)
    speed = host.device.board.motion(host.now_ns)[2]

    host.device.reset(host.now_ns)

    assert host.device.state is State.BOOT
    assert host.device.board.volts == 0.0
    assert host.device.board.motion(host.now_ns)[2] == speed > 0
    host.wait(6 * MS)
    after = host.hello()
    assert after.boot_id & 0xFFFF != before.boot_id & 0xFFFF
    assert (before.reset, after.reset) == (0x01, 0x02)


def test_no_two_boots_in_a_row_have_the_same_low_half() -> None:
    device = Device(QUIET, 0)
    low = device._boot_id & 0xFFFF
    drawn = iter([0, low, 0x7000_0000 | low, device._boot_id, 5 << 16 | (low ^ 1)])
    device._rng = SimpleNamespace(integers=lambda *_, **__: next(drawn))

    device.reset(1 * MS)

    assert device._boot_id == 5 << 16 | (low ^ 1)


# ------------------------------------------------------------------ nonces


def test_the_nonce_wraps_and_leaves_out_0() -> None:
    """From 2^32 - 1 to 1."""
    host = Host()
    host.device._fw.boot_id = 2**32 - 3

    assert [host.configure().nonce for _ in range(4)] == [2**32 - 2, 2**32 - 1, 1, 2]


# ------------------------------------------------------------------ exchange


def test_an_exchange_has_the_documented_timing() -> None:
    """Alpha at t_r, theta_1 one conversion later, latch 12 µs on, SAMPLE at the end."""
    host = Host().reach(State.RUN)

    t_r = host.put(wire.Exchange, k=1, u=65535)
    host.wait(3 * MS)

    sample = host.heard[-1]
    assert isinstance(sample.message, wire.Sample)
    assert t_r == host.now_ns - 3 * MS + EXCHANGE_NS
    assert sample.message.t_us * US == (t_r + CONVERSION_NS) // US * US
    assert host.changes[-1] == Change(t_r + CONVERSION_NS + HOLD_NS, 5.0, State.RUN, Cause.REQUEST)
    assert sample.t_ns == t_r + 2 * CONVERSION_NS + SAMPLE_NS


def test_a_reading_precedes_the_effect_of_the_u_of_its_exchange() -> None:
    """y_k is read just before u_k acts."""
    samples = []
    for u in (0, 65535):
        host = Host().reach(State.RUN)
        for k in (1, 2):
            host.ask(wire.Exchange, k=k, u=30_000)
        first = only(wire.Sample, host.ask(wire.Exchange, k=3, u=u))
        second = only(wire.Sample, host.ask(wire.Exchange, k=4, u=u))
        samples.append((first, second))

    (zero, zero_next), (full, full_next) = samples
    assert (zero.y0, zero.y1) == (full.y0, full.y1)
    assert (zero_next.y0, zero_next.y1) != (full_next.y0, full_next.y1)


def test_an_exchange_of_an_old_run_does_not_drive_the_next() -> None:
    host = Host(EmulatorSettings(model_baud=False, boot_ms=5)).reach(State.RUN)
    boot_id, config_crc = host.hello().boot_id, 0
    host.changes.clear()

    host.put(wire.Exchange, k=1, u=65535)
    host.put(wire.Stop)
    host.put(wire.Config, **CONFIG)
    config_crc = only(wire.ConfigReply, host.wait(0)).config_crc
    host.put(wire.Arm, boot_id=boot_id, config_crc=config_crc)
    host.put(wire.Start, k_stop=0)
    host.wait(3 * MS)

    assert host.device.state is State.RUN
    assert host.changes == []


def test_rails_and_turns_trip_in_run() -> None:
    for config, cause in (
        ({"rail_ticks": 2}, Cause.ADC_RAIL),
        ({"turns": 25}, Cause.REV_LIMIT),
    ):
        host = Host().reach(State.RUN, **config)
        answers: list[wire.Message] = []
        k = 0
        while host.device.state is State.RUN and k < 500:
            answers = host.ask(wire.Exchange, k=k, u=65535)
            k += 1

        sample, event = answers
        assert isinstance(sample, wire.Sample)
        assert isinstance(event, wire.Event)
        assert (event.cause, sample.state, sample.u_k) == (cause, State.FAULT, 0)
        assert bool(sample.flags & Flag.ADC0_RAIL) == (cause is Cause.ADC_RAIL)
        assert bool(sample.flags & Flag.REV_LIMIT) == (cause is Cause.REV_LIMIT)
        assert not sample.flags & (Flag.RUN | Flag.ARMED)
        assert host.device.board.volts == 0.0


# ------------------------------------------------------------------ watchdog


@pytest.mark.parametrize("state", [State.ARMED, State.RUN])
@pytest.mark.parametrize("watchdog_ms", [20, 100, 250])
def test_the_watchdog_trips_exactly_at_its_tick(state: State, watchdog_ms: int) -> None:
    """S3: exactly watchdog_ms after the last accepted frame, not a nanosecond before."""
    host = Host().reach(state, watchdog_ms=watchdog_ms)
    last = host.put(wire.Exchange, k=1, u=65535)

    host.wait(last + watchdog_ms * MS - 1 - host.now_ns)
    assert host.device.state is state
    host.wait(1)

    assert host.device.state is State.FAULT
    assert host.device.cause is Cause.WATCHDOG
    assert host.device.board.volts == 0.0
    if state is State.RUN:
        assert host.changes[-1] == Change(last + watchdog_ms * MS, 0.0, State.FAULT, Cause.WATCHDOG)
    host.wait(1 * MS)
    assert only(wire.Sample, host.ask(wire.Exchange, k=2, u=0)).flags & Flag.WATCHDOG


@pytest.mark.parametrize("kind", [wire.Keepalive, wire.Stop, wire.Estop])
def test_an_accepted_frame_makes_frames_with_earlier_numbers_stale(
    kind: type[wire.Message],
) -> None:
    host = Host().reach(State.RUN)
    newest = (host.seq + 10) & 0xFFFF

    host.ask(kind, seq=newest)

    for behind, answer in ((5, [Code.STALE]), (0, [Code.STALE]), (-1, [])):
        assert codes(host.ask(wire.Keepalive, seq=(newest - behind) & 0xFFFF)) == answer, behind


def test_a_frame_exactly_at_the_deadline_is_in_time() -> None:
    """The bytes and the watchdog are due in the same nanosecond."""
    host = Host().reach(State.RUN)
    last = host.put(wire.Keepalive)
    host.wait(last - host.now_ns + 100 * MS - 100 * US)

    assert host.put(wire.Keepalive) == last + 100 * MS
    host.wait(50 * MS)

    assert host.device.state is State.RUN


# ------------------------------------------------------------------ the line


def test_a_delayed_pong_contains_the_time_of_its_transmission() -> None:
    host = Host()
    for n in range(3):
        host.put(wire.Ping, host_ns=n)
    host.wait(3 * MS)

    pongs = [heard for heard in host.heard if isinstance(heard.message, wire.Pong)]
    length_ns = frame.wire_length(wire.Pong) * 10 * US
    assert [h.message.tx_us for h in pongs] == [(h.t_ns - length_ns) // US for h in pongs]
    assert pongs[2].message.tx_us > pongs[2].message.rx_us


def test_a_frame_without_room_is_dropped_whole_and_reported() -> None:
    """Twenty HELLOs at once give more bytes than the ring contains."""
    host = Host()

    for _ in range(20):
        host.put(wire.Hello, version=VERSION, schema=SCHEMA_HASH)
    replies = [m for m in host.wait(20 * MS) if isinstance(m, wire.HelloReply)]
    sample = only(wire.Sample, host.ask(wire.Exchange, k=0, u=0))

    assert len(replies) < 20
    assert sample.flags & Flag.TX_DROP
    assert only(wire.Status, host.wait(1 * S)).tx_dropped == 20 - len(replies)


def test_the_clocks_wrap() -> None:
    """t_us after 71.6 min, seq after 65536 frames."""
    host = Host()
    host.wait(2**32 * US - 10 * MS)
    before = only(wire.Sample, host.ask(wire.Exchange, k=2**32 - 1, u=0))
    host.wait(20 * MS)
    after = only(wire.Sample, host.ask(wire.Exchange, k=0, u=0))

    assert before.t_us > 2**32 - 10_000
    assert after.t_us < 30_000
    assert (after.t_us - before.t_us) % 2**32 == 23_000


def test_seed_changes_noise_and_boot_id() -> None:
    replies = []
    for seed in (1, 2):
        host = Host(EmulatorSettings(baud=BAUD, seed=seed))
        readings = [only(wire.Sample, host.ask(wire.Exchange, k=k, u=0)).y0 for k in range(20)]
        replies.append((readings, host.hello().boot_id))

    (noise_1, boot_1), (noise_2, boot_2) = replies
    assert noise_1 != noise_2
    assert boot_1 != boot_2
