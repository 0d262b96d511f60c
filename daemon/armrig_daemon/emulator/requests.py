"""What each frame of the host does (PROTOCOL.md, sections 2 to 6)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from armrig_protocol.decoder import Received
from armrig_protocol.frame import Spoilt, Unknown, config_crc
from armrig_protocol.messages import (
    FULL_SCALE_MV,
    SCHEMA_HASH,
    TYPES,
    VERSION,
    Arm,
    Cal,
    Capability,
    Cause,
    ClearFault,
    Code,
    Config,
    ConfigReply,
    Estop,
    Exchange,
    Flag,
    Hello,
    HelloReply,
    Keepalive,
    Message,
    Ping,
    Pong,
    Setpoints,
    Start,
    State,
    Stop,
)

from armrig_daemon.emulator.configuration import (
    HEADER_FIELDS,
    NONE_IN_FORCE,
    verdict,
)
from armrig_daemon.emulator.firmware import U16, U32, UNNUMBERED, Firmware, Order
from armrig_daemon.emulator.guards import NOTHING_SEEN

UID = int.from_bytes(b"emulator", "little")
NO_IMAGE = 0  # an emulator has no image to take a CRC of
CAPABILITIES = int(Capability.EXCHANGE | Capability.ENABLE_LINE)


def take(fw: Firmware, now_ns: int, received: Received) -> list[Message]:
    """Return the answers to what the line brought; EXCHANGE puts a sample into `fw.orders`."""
    if isinstance(received, Spoilt):
        fw.counters.spoilt += 1
        fw.news |= int(Flag.CRC_ERR)
        return []
    fw.counters.frames += 1
    if isinstance(received, Unknown):
        return [fw.answer(received.type, received.seq, Code.UNKNOWN_TYPE)]
    kind = type(received)
    handler = _HANDLERS.get(kind)
    if handler is None:  # a type that only devices send
        return [fw.answer(TYPES[kind], received.seq, Code.UNKNOWN_TYPE)]
    # Where the motor may turn, a HELLO that was played again must not make old frames new.
    resynchronises = kind is Hello and fw.state not in (State.ARMED, State.RUN)
    if resynchronises or is_newer(received.seq, fw.newest, U16):
        fw.newest = received.seq
        fw.feed(now_ns)
    elif kind is not Stop and kind is not Estop:
        return [fw.answer(TYPES[kind], received.seq, Code.STALE)]
    return handler(fw, now_ns, received)


def is_newer(number: int, last: int | None, mask: int) -> bool:
    """Return whether `number` is ahead of `last` by 1 ... mask // 2, modulo mask + 1."""
    return last is None or 1 <= (number - last) & mask <= mask // 2


def makes_sample(fw: Firmware, m: Exchange) -> bool:
    """Return whether `m`, taken in the present state, is answered by a sample."""
    fresh = is_newer(m.seq, fw.newest, U16) and is_newer(m.k, fw.k, U32)
    return fresh and _trip(fw, m) is Cause.NONE


def _trip(fw: Firmware, m: Exchange) -> Cause:
    """Return the fault that the u of `m` is, or NONE; only in RUN is it looked at."""
    config = fw.config
    if fw.state is not State.RUN or config is None:
        return Cause.NONE
    if not config.u_min <= m.u <= config.u_max:
        return Cause.RANGE
    # Against the code as the host sent it: against the rounded duty an allowed ramp could trip.
    if config.slew and abs(m.u - fw.u) > config.slew:
        return Cause.SLEW
    return Cause.NONE


def _exchange(fw: Firmware, now_ns: int, m: Exchange) -> list[Message]:
    if not is_newer(m.k, fw.k, U32):
        return [fw.answer(TYPES[Exchange], m.seq, Code.STALE)]
    cause = _trip(fw, m)
    if cause is not Cause.NONE:
        return [fw.go(now_ns, State.FAULT, cause, detail=m.u)]
    drives = fw.state is State.RUN
    if drives:
        fw.u = m.u
    fw.k = m.k
    fw.orders.append(Order(now_ns, m.seq, m.k, m.u, drives))
    return []


def _hello(fw: Firmware, now_ns: int, m: Hello) -> list[Message]:
    if fw.state not in (State.ARMED, State.RUN):
        fw.k = None
    traits = fw.traits
    reply = HelloReply(
        fw.state,
        UNNUMBERED,
        version=VERSION,
        schema=SCHEMA_HASH,
        uid=UID,
        boot_id=fw.boot_id,
        firmware=NO_IMAGE,
        token=fw.token,
        ts_min_us=traits.ts_min_us,
        full_scale_mv=FULL_SCALE_MV,
        queue=0,
        capabilities=CAPABILITIES,
        skew_us=traits.skew_us,
        hold_us=traits.hold_us,
        adc_bits=traits.adc_bits,
        pwm_bits=traits.pwm_bits,
        cause=fw.cause,
        reset=fw.mcusr,
    )
    return [reply]


def _config(fw: Firmware, now_ns: int, m: Config) -> list[Message]:
    code = Code.WRONG_STATE
    if fw.state is State.IDLE or fw.state is State.READY:
        code = verdict(m, ts_min_us=fw.traits.ts_min_us)
    events: list[Message] = []
    if code is Code.OK:
        if fw.state is State.IDLE:
            events = [fw.go(now_ns, State.READY, Cause.REQUEST)]
        fw.config, fw.config_crc = m, config_crc(m)
    else:
        fw.counters.refused += 1
    body = fw.config[HEADER_FIELDS:] if fw.config else NONE_IN_FORCE
    reply = ConfigReply._make((fw.state, UNNUMBERED, code, 0, fw.config_crc, *body))
    return [reply, *events]


def _arm(fw: Firmware, now_ns: int, m: Arm) -> list[Message]:
    if fw.state is not State.READY:
        code = Code.WRONG_STATE
    elif m.boot_id != fw.boot_id:
        code = Code.WRONG_BOOT
    elif m.config_crc != fw.config_crc:
        code = Code.WRONG_CONFIG
    else:
        return _transition(fw, now_ns, m, State.ARMED)
    return [fw.answer(TYPES[Arm], m.seq, code)]


def _start(fw: Firmware, now_ns: int, m: Start) -> list[Message]:
    if fw.state is not State.ARMED or fw.config is None:
        return [fw.answer(TYPES[Start], m.seq, Code.WRONG_STATE)]
    if m.k_stop != 0:
        return [fw.answer(TYPES[Start], m.seq, Code.BAD_VALUE)]
    fw.u, fw.u_seq = fw.config.u_rest, m.seq
    fw.guards = NOTHING_SEEN
    answers = _transition(fw, now_ns, m, State.RUN)
    fw.board.latch(now_ns, fw.u, Cause.REQUEST)
    return answers


def _stop(fw: Firmware, now_ns: int, m: Stop) -> list[Message]:
    if fw.state in (State.FAULT, State.ESTOP):
        return [fw.answer(TYPES[Stop], m.seq, Code.WRONG_STATE)]
    if fw.state is State.IDLE:
        return [fw.answer(TYPES[Stop], m.seq, Code.OK)]
    return _transition(fw, now_ns, m, State.IDLE)


def _clear_fault(fw: Firmware, now_ns: int, m: ClearFault) -> list[Message]:
    if fw.state not in (State.FAULT, State.ESTOP):
        return [fw.answer(TYPES[ClearFault], m.seq, Code.WRONG_STATE)]
    if m.token != fw.token:
        return [fw.answer(TYPES[ClearFault], m.seq, Code.WRONG_TOKEN)]
    return _transition(fw, now_ns, m, State.IDLE)


def _estop(fw: Firmware, now_ns: int, m: Estop) -> list[Message]:
    if fw.state is State.ESTOP:
        return [fw.answer(TYPES[Estop], m.seq, Code.OK)]
    return _transition(fw, now_ns, m, State.ESTOP)


def _ping(fw: Firmware, now_ns: int, m: Ping) -> list[Message]:
    # tx_us is put in by `device`, which alone knows when the wire is free.
    return [Pong(fw.state, UNNUMBERED, host_ns=m.host_ns, rx_us=fw.device_us(now_ns), tx_us=0)]


def _keepalive(fw: Firmware, now_ns: int, m: Keepalive) -> list[Message]:
    return []


def _unsupported(fw: Firmware, now_ns: int, m: Setpoints | Cal) -> list[Message]:
    return [fw.answer(TYPES[type(m)], m.seq, Code.UNSUPPORTED)]


def _transition(fw: Firmware, now_ns: int, m: Message, state: State) -> list[Message]:
    """Return ACK(OK) and the EVENT, in the order in which they leave."""
    event = fw.go(now_ns, state, Cause.REQUEST)
    return [fw.answer(TYPES[type(m)], m.seq, Code.OK), event]


_HANDLERS: dict[type[Message], Callable[[Firmware, int, Any], list[Message]]] = {
    Exchange: _exchange,
    Keepalive: _keepalive,
    Ping: _ping,
    Stop: _stop,
    Estop: _estop,
    Hello: _hello,
    Config: _config,
    Arm: _arm,
    Start: _start,
    ClearFault: _clear_fault,
    Setpoints: _unsupported,
    Cal: _unsupported,
}
