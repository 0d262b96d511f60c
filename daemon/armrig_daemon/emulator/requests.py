"""Effects of the host's frames (PROTOCOL.md, sections 2 to 6)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from armrig_core.rig.emulated import EMULATOR_UID
from armrig_protocol import messages as wire
from armrig_protocol.decoder import Received
from armrig_protocol.frame import Spoilt, Unknown
from armrig_protocol.messages import (
    FULL_SCALE_MV,
    SCHEMA_HASH,
    SETPOINTS_PER_FRAME,
    TYPES,
    VERSION,
    Capability,
    Cause,
    Code,
    Flag,
    State,
)

from armrig_daemon.emulator import transitions
from armrig_daemon.emulator.clock import U32
from armrig_daemon.emulator.firmware import (
    MOTOR_MAY_TURN,
    U16,
    UNNUMBERED,
    Firmware,
    PendingCal,
    PendingSample,
)

_RUN, _NONE = State.RUN, Cause.NONE
NO_IMAGE = 0  # an emulator has no image and thus no CRC
CAPABILITIES = int(
    Capability.EXCHANGE | Capability.SCHEDULED | Capability.CAL | Capability.ENABLE_LINE
)
MOST_READINGS = 1024


def handle(fw: Firmware, now_ns: int, received: Received) -> list[wire.Message]:
    """Return the answers to a received item; for an EXCHANGE, add a sample to `fw.pending`."""
    if isinstance(received, Spoilt):
        fw.counters.spoilt += 1
        fw.new_flags |= int(Flag.CRC_ERR)
        return []
    fw.counters.frames += 1
    if isinstance(received, Unknown):
        return [fw.answer(received.type, received.seq, Code.UNKNOWN_TYPE)]
    kind = type(received)
    handler = _HANDLERS.get(kind)
    if handler is None:  # a type that only devices send
        return [fw.answer(TYPES[kind], received.seq, Code.UNKNOWN_TYPE)]
    # While the motor may turn, a replayed HELLO must not make old frames valid.
    resynchronises = kind is wire.Hello and fw.state not in MOTOR_MAY_TURN
    if resynchronises or is_newer(received.seq, fw.newest, U16):
        fw.newest = received.seq
        if kind is not wire.Hello:  # HELLO asks for the identity and commands nothing
            fw.feed(now_ns)
    elif kind is not wire.Stop and kind is not wire.Estop:
        return [fw.answer(TYPES[kind], received.seq, Code.STALE)]
    return handler(fw, now_ns, received)


def is_newer(number: int, last: int | None, mask: int) -> bool:
    """Return whether `number` is newer than `last`: 1 to mask // 2 larger, modulo mask + 1."""
    return last is None or 1 <= (number - last) & mask <= mask // 2


def makes_sample(fw: Firmware, m: wire.Exchange) -> bool:
    """Return True if the device, in its present state, answers `m` with a sample."""
    fresh = is_newer(m.seq, fw.newest, U16) and is_newer(m.k, fw.k, U32)
    free = fw.timer is None and fw.cal is None
    return free and fresh and _trip(fw, m) is _NONE


def _trip(fw: Firmware, m: wire.Exchange) -> Cause:
    """Return the fault that the u of `m` causes in RUN; NONE if it causes none."""
    config = fw.config
    if fw.state is not _RUN or config is None:
        return _NONE
    if not config.u_min <= m.u <= config.u_max:
        return Cause.RANGE
    # The step counts from the last code as the host sent it. If it counted from the rounded duty,
    # an allowed ramp could trip.
    if config.slew and abs(m.u - fw.u) > config.slew:
        return Cause.SLEW
    return _NONE


def _exchange(fw: Firmware, now_ns: int, m: wire.Exchange) -> list[wire.Message]:
    if fw.timer is not None or fw.cal is not None:
        return [fw.answer(TYPES[wire.Exchange], m.seq, Code.WRONG_STATE)]
    if not is_newer(m.k, fw.k, U32):
        return [fw.answer(TYPES[wire.Exchange], m.seq, Code.STALE)]
    cause = _trip(fw, m)
    if cause is not _NONE:
        return [fw.enter(now_ns, State.FAULT, cause, detail=m.u)]
    drives = fw.state is _RUN
    if drives:
        fw.u = m.u
    fw.k = m.k
    fw.pending.append(PendingSample(fw.clock.device_ns(now_ns), m.k, m.seq, m.u, drives))
    return []


def _hello(fw: Firmware, now_ns: int, m: wire.Hello) -> list[wire.Message]:
    if fw.state not in MOTOR_MAY_TURN:
        fw.k = None
    hardware = fw.hardware
    reply = wire.HelloReply(
        fw.state,
        UNNUMBERED,
        version=VERSION,
        schema=SCHEMA_HASH,
        uid=EMULATOR_UID,
        boot_id=fw.boot_id,
        firmware=NO_IMAGE,
        token=fw.token,
        ts_min_us=hardware.ts_min_us,
        full_scale_mv=FULL_SCALE_MV,
        queue=hardware.queue,
        capabilities=CAPABILITIES,
        skew_us=hardware.skew_us,
        hold_us=hardware.hold_ns // 1000,
        adc_bits=hardware.adc_bits,
        pwm_bits=hardware.pwm_bits,
        cause=fw.cause,
        reset=fw.mcusr,
    )
    return [reply]


def _ping(fw: Firmware, now_ns: int, m: wire.Ping) -> list[wire.Message]:
    # `device` sets tx_us, because only it knows when the wire is free.
    return [wire.Pong(fw.state, UNNUMBERED, host_ns=m.host_ns, rx_us=fw.device_us(now_ns), tx_us=0)]


def _keepalive(fw: Firmware, now_ns: int, m: wire.Keepalive) -> list[wire.Message]:
    return []


def setpoints(fw: Firmware, now_ns: int, m: wire.Setpoints) -> list[wire.Message]:
    """Put the setpoints into the queue; do not answer valid setpoints, even if they are dropped."""
    if fw.queue is None:
        return [fw.answer(TYPES[wire.Setpoints], m.seq, Code.WRONG_STATE)]
    if not 1 <= m.n <= SETPOINTS_PER_FRAME or m.zero:
        return [fw.answer(TYPES[wire.Setpoints], m.seq, Code.BAD_VALUE)]
    cause, code = fw.queue.violation(m)
    if cause is not Cause.NONE:
        return [fw.enter(now_ns, State.FAULT, cause, detail=code)]
    if not fw.queue.add(m):
        return [fw.answer(TYPES[wire.Setpoints], m.seq, Code.BAD_VALUE)]
    return []


class Statistics(NamedTuple):
    """Statistics of the readings, as in CAL_R."""

    mean_256: int
    variance_256: int
    least: int
    greatest: int


def statistics(codes: list[int]) -> Statistics:
    """Return mean and variance in units of 1/256, ties rounded up; with one reading, variance 0."""
    n, total = len(codes), sum(codes)
    pairs = n * (n - 1)
    spread = n * sum(code * code for code in codes) - total * total
    return Statistics(
        mean_256=(256 * total + n // 2) // n,
        variance_256=min((256 * spread + pairs // 2) // pairs, U32) if pairs else 0,
        least=min(codes),
        greatest=max(codes),
    )


def cal(fw: Firmware, now_ns: int, m: wire.Cal) -> list[wire.Message]:
    """Request the conversions of CAL; the answer follows after the last conversion."""
    taken = fw.cal is not None or fw.pending
    if fw.state not in (State.IDLE, State.READY) or taken:
        return [fw.answer(TYPES[wire.Cal], m.seq, Code.WRONG_STATE)]
    if m.channel > 1 or m.zero or not 1 <= m.n <= MOST_READINGS:
        return [fw.answer(TYPES[wire.Cal], m.seq, Code.BAD_VALUE)]
    fw.cal = PendingCal(fw.clock.device_ns(now_ns), m.channel, m.n)
    return []


def cal_answer(fw: Firmware, codes: list[int]) -> wire.Message:
    """Return CAL_R, and release the converter for samples."""
    if fw.cal is None:
        raise RuntimeError("no CAL is in progress")
    channel, fw.cal = fw.cal.channel, None
    return wire.CalReply(fw.state, UNNUMBERED, channel, 0, len(codes), *statistics(codes))


_HANDLERS: dict[type[wire.Message], Callable[[Firmware, int, Any], list[wire.Message]]] = {
    wire.Exchange: _exchange,
    wire.Keepalive: _keepalive,
    wire.Ping: _ping,
    wire.Stop: transitions.stop,
    wire.Estop: transitions.estop,
    wire.Hello: _hello,
    wire.Config: transitions.config,
    wire.Arm: transitions.arm,
    wire.Start: transitions.start,
    wire.ClearFault: transitions.clear_fault,
    wire.Setpoints: setpoints,
    wire.Cal: cal,
}
