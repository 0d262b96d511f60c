"""Rules of sections 1 and 6: noise on the line, and a fully loaded line."""

from __future__ import annotations

from zlib import crc32

from armrig_core.process.printable import plural
from armrig_core.rig.volts import device_code
from armrig_protocol import frame
from armrig_protocol import messages as wire
from armrig_protocol.messages import SETPOINTS_PER_FRAME, Flag, State

from armrig_daemon.conformance.byte_rules import next_status
from armrig_daemon.conformance.host import LineHost
from armrig_daemon.conformance.rule import expect, rule
from armrig_daemon.conformance.scheduled_rules import NOISE, arm_scheduled, put_setpoints
from armrig_daemon.decisions.budget import min_scheduled_us

_MIN_TS_US = 1_000
_RUN_US = 2_000_000
_PING_TICKS = 50
_NOISE_BYTES = 4_000
_FLOOD_FRAMES, _SETTLING_MS = 300, 30
_LOSS_FLAGS = Flag.UNDERRUN | Flag.TICK_LATE | Flag.CRC_ERR | Flag.RX_OVERFLOW | Flag.TX_DROP


@rule(1, "Random bytes cause no answer, no change of state and no boot")
def _random_bytes(host: LineHost) -> None:
    host.reach(State.READY)
    boot_id = host.known.boot_id
    noise = bytes(crc32(bytes((n & 0xFF, n >> 8))) & 0xFF for n in range(_NOISE_BYTES))
    for n in range(0, _NOISE_BYTES, 50):
        host.write(noise[n : n + 50])
        answers = host.listen(1)
        expect(not answers, answers)
    host.write(b"\0")
    answers = host.fence()
    expect(not answers and host.state == State.READY, answers)
    expect(host.hello().boot_id == boot_id, "another boot")


@rule(6, "At 1 kHz, or the line's highest rate, with PING and STATUS, nothing is lost or late")
def _full_line(host: LineHost) -> None:
    ts_us = max(_MIN_TS_US, _shortest_us(host))
    n = _RUN_US // ts_us // SETPOINTS_PER_FRAME * SETPOINTS_PER_FRAME
    u = NOISE[:n]
    before, breaks = next_status(host), host.breaks
    arm_scheduled(host, ts_us=ts_us)
    sent = _refill(host, u, 0, 0)
    host.fence()
    host.put(wire.Start, k_stop=n)
    samples: list[wire.Sample] = []
    pings = pongs = 0
    while True:
        message = host.until(
            lambda m: isinstance(m, wire.Sample | wire.Event | wire.Pong), "SAMPLE of a run"
        )[-1]
        if isinstance(message, wire.Event) and message.was == State.RUN:
            break
        pongs += isinstance(message, wire.Pong)
        if isinstance(message, wire.Sample):
            samples.append(message)
            sent = _refill(host, u, sent, message.k + 1)
            if message.k % _PING_TICKS == 0:
                host.put(wire.Ping, host_ns=message.k)
                pings += 1
    ks = [m.k for m in samples]
    expect(ks == list(range(n)), f"{len(ks)} of {n} samples at Ts {ts_us} us")
    bits = host.known.pwm_bits
    for m in samples:
        expect(m.u_k == device_code(u[m.k], bits) and not m.flags & _LOSS_FLAGS, [m])
    expect(pongs == pings and host.breaks == breaks, f"{pongs} PONG of {pings} PING")
    after = next_status(host)
    lost = after.rx_lost - before.rx_lost, after.tx_dropped - before.tx_dropped
    expect(
        lost == (0, 0),
        f"{plural(lost[0], 'byte')} not received, {plural(lost[1], 'frame')} not sent",
    )


@rule(1, "Bytes lost in a flood are reported, by `rx_lost` in STATUS and RX_OVERFLOW in a SAMPLE")
def _flood(host: LineHost) -> None:
    before, seq = next_status(host), host.seq
    arm_scheduled(host, ts_us=_shortest_us(host))
    host.ask(wire.Start)
    host.put_together([wire.Keepalive(0, 0)] * _FLOOD_FRAMES)
    flood_ms = _FLOOD_FRAMES * frame.wire_length(wire.Keepalive) * 10_000 / host.baud
    messages = host.listen(flood_ms + _SETTLING_MS)
    host.write(b"\0")
    messages += host.alive(_SETTLING_MS)
    host.to_idle()
    after, sent = next_status(host), (host.seq - seq) & 0xFFFF
    frames, lost = after.frames - before.frames, after.rx_lost - before.rx_lost
    spoilt = after.spoilt - before.spoilt
    counts = f"{plural(lost, 'byte')} lost, {frames} of {sent} frames received, {spoilt} spoilt"
    expect(lost > 0 or (frames == sent and spoilt == 0), counts)
    flagged = any(isinstance(m, wire.Sample) and m.flags & Flag.RX_OVERFLOW for m in messages)
    expect(flagged == (lost > 0), f"{counts}, RX_OVERFLOW {'' if flagged else 'not '}set")


def _shortest_us(host: LineHost) -> int:
    """Return the shortest Ts of scheduled mode for this device and line, in µs."""
    return max(min_scheduled_us(host.baud, host.known.skew_us), host.known.ts_min_us)


def _refill(host: LineHost, u: list[int], sent: int, ahead_of: int) -> int:
    """Send the setpoints for which the queue has room; return the number sent so far."""
    while sent < len(u) and sent + SETPOINTS_PER_FRAME - ahead_of <= host.known.queue:
        put_setpoints(host, sent, u[sent : sent + SETPOINTS_PER_FRAME])
        sent += SETPOINTS_PER_FRAME
    return sent
