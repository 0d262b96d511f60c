"""Sections 1 and 6: noise on the line, and a line that is full."""

from __future__ import annotations

from armrig_core.volts import applied_code
from armrig_protocol.crc import crc32
from armrig_protocol.messages import (
    SETPOINTS_PER_FRAME,
    Event,
    Flag,
    Ping,
    Pong,
    Sample,
    Start,
    State,
)

from armrig_daemon.conformance.byte_rules import next_status
from armrig_daemon.conformance.host import Host
from armrig_daemon.conformance.rule import expect, rule
from armrig_daemon.conformance.scheduled_rules import NOISE, armed, put_setpoints
from armrig_daemon.core.budget import scheduled_us

_LEAST_TS_US = 1_000
_RUN_US = 2_000_000
_PING_TICKS = 50
_NOISE_BYTES = 4_000
_LOST = Flag.UNDERRUN | Flag.TICK_LATE | Flag.CRC_ERR | Flag.RX_OVERFLOW | Flag.TX_DROP


@rule(1, "Bytes at random bring no answer, no other state, no other boot")
def _random_bytes(host: Host) -> None:
    host.reach(State.READY)
    boot_id = host.known.boot_id
    noise = bytes(crc32(bytes((n & 0xFF, n >> 8))) & 0xFF for n in range(_NOISE_BYTES))
    for n in range(0, _NOISE_BYTES, 50):
        host.write(noise[n : n + 50])
        came = host.listen(1)
        expect(not came, came)
    host.write(b"\0")
    came = host.fence()
    expect(not came and host.state == State.READY, came)
    expect(host.hello().boot_id == boot_id, "another boot")


@rule(6, "At 1 kHz, or what the line carries, nothing is lost or late beside PING and STATUS")
def _full_line(host: Host) -> None:
    least = scheduled_us(host.baud, host.known.skew_us)
    ts_us = max(_LEAST_TS_US, least, host.known.ts_min_us)
    n = _RUN_US // ts_us // SETPOINTS_PER_FRAME * SETPOINTS_PER_FRAME
    u = NOISE[:n]
    before, breaks = next_status(host), host.breaks
    armed(host, ts_us=ts_us)
    sent = _refill(host, u, 0, 0)
    host.fence()
    host.put(Start, k_stop=n)
    samples: list[Sample] = []
    pings = pongs = 0
    while True:
        came = host.until(lambda m: isinstance(m, Sample | Event | Pong), "SAMPLE of a run")[-1]
        if isinstance(came, Event) and came.was == State.RUN:
            break
        pongs += isinstance(came, Pong)
        if isinstance(came, Sample):
            samples.append(came)
            sent = _refill(host, u, sent, came.k + 1)
            if came.k % _PING_TICKS == 0:
                host.put(Ping, host_ns=came.k)
                pings += 1
    ks = [m.k for m in samples]
    expect(ks == list(range(n)), f"{len(ks)} of {n} samples at Ts {ts_us} us")
    bits = host.known.pwm_bits
    for m in samples:
        expect(m.u_k == applied_code(u[m.k], bits) and not m.flags & _LOST, [m])
    expect(pongs == pings and host.breaks == breaks, f"{pongs} PONG of {pings} PING")
    after = next_status(host)
    lost = after.rx_lost - before.rx_lost, after.tx_dropped - before.tx_dropped
    expect(lost == (0, 0), f"{lost[0]} bytes not received, {lost[1]} frames not sent")


def _refill(host: Host, u: list[int], sent: int, ahead_of: int) -> int:
    """Send what there is room for; return how many were sent by now."""
    while sent < len(u) and sent + SETPOINTS_PER_FRAME - ahead_of <= host.known.queue:
        put_setpoints(host, sent, u[sent : sent + SETPOINTS_PER_FRAME])
        sent += SETPOINTS_PER_FRAME
    return sent


RULES = (_random_bytes, _full_line)
