"""Requests that change the state (PROTOCOL.md, sections 3 and 4)."""

from __future__ import annotations

from armrig_protocol import messages as wire
from armrig_protocol.messages import (
    TYPES,
    WATCHDOG_MAX_MS,
    WATCHDOG_MIN_MS,
    Cause,
    Code,
    Mode,
    State,
    Underrun,
)

from armrig_daemon.emulator.clock import Timer
from armrig_daemon.emulator.firmware import UNNUMBERED, Firmware
from armrig_daemon.emulator.guards import NOTHING_SEEN
from armrig_daemon.emulator.queue import SetpointQueue

HEADER_FIELDS = 2
NONE_IN_FORCE = (0,) * (len(wire.Config._fields) - HEADER_FIELDS)


def config(fw: Firmware, now_ns: int, m: wire.Config) -> list[wire.Message]:
    """Accept a configuration, or refuse it with a code."""
    code = Code.WRONG_STATE
    if fw.state is State.IDLE or fw.state is State.READY:
        code = check_config(m, ts_min_us=fw.hardware.ts_min_us, skew_us=fw.hardware.skew_us)
    events: list[wire.Message] = []
    if code is Code.OK:
        if fw.state is State.IDLE:
            events = [fw.enter(now_ns, State.READY, Cause.REQUEST)]
        fw.accept(m)
    else:
        fw.counters.refused += 1
    body = fw.config[HEADER_FIELDS:] if fw.config else NONE_IN_FORCE
    reply = wire.ConfigReply._make((fw.state, UNNUMBERED, code, 0, fw.config_crc, *body, fw.nonce))
    return [reply, *events]


def arm(fw: Firmware, now_ns: int, m: wire.Arm) -> list[wire.Message]:
    """Arm the device if the host sends the current boot id, configuration CRC and nonce."""
    if fw.state is not State.READY or fw.cal is not None:
        code = Code.WRONG_STATE
    elif m.boot_id != fw.boot_id:
        code = Code.WRONG_BOOT
    elif m.config_crc != fw.config_crc:
        code = Code.WRONG_CONFIG
    elif m.nonce != fw.nonce:
        code = Code.WRONG_NONCE
    else:
        if fw.config is not None and fw.config.mode == Mode.SCHEDULED:
            fw.queue = SetpointQueue(fw.config, fw.hardware.queue)
        return _transition(fw, now_ns, m, State.ARMED)
    return [fw.answer(TYPES[wire.Arm], m.seq, code)]


def start(fw: Firmware, now_ns: int, m: wire.Start) -> list[wire.Message]:
    """Apply u_rest to the motor; in scheduled mode start the timer."""
    if fw.state is not State.ARMED or fw.config is None:
        return [fw.answer(TYPES[wire.Start], m.seq, Code.WRONG_STATE)]
    if m.nonce != fw.nonce:
        return [fw.answer(TYPES[wire.Start], m.seq, Code.WRONG_NONCE)]
    scheduled = fw.config.mode == Mode.SCHEDULED
    if m.k_stop != 0 and not scheduled:
        return [fw.answer(TYPES[wire.Start], m.seq, Code.BAD_VALUE)]
    fw.u, fw.u_seq = fw.config.u_rest, 0 if scheduled else m.seq
    fw.guards = NOTHING_SEEN
    answers = _transition(fw, now_ns, m, State.RUN)
    if scheduled:
        fw.set_timer(_timer(fw, now_ns, fw.config.ts_us * 1000, m.k_stop))
    fw.board.latch(now_ns, fw.u, Cause.REQUEST)
    return answers


def _timer(fw: Firmware, now_ns: int, period_ns: int, k_stop: int) -> Timer:
    return Timer(
        first_ns=fw.clock.device_ns(now_ns) + period_ns,
        period_ns=period_ns,
        lead_ns=(fw.conversions - 1) * fw.hardware.conversion_ns,
        hold_ns=fw.hardware.hold_ns,
        k_stop=k_stop,
    )


def stop(fw: Firmware, now_ns: int, m: wire.Stop) -> list[wire.Message]:
    """Return to IDLE from every state except FAULT and ESTOP."""
    if fw.state in (State.FAULT, State.ESTOP):
        return [fw.answer(TYPES[wire.Stop], m.seq, Code.WRONG_STATE)]
    if fw.state is State.IDLE:
        return [fw.answer(TYPES[wire.Stop], m.seq, Code.OK)]
    return _transition(fw, now_ns, m, State.IDLE)


def clear_fault(fw: Firmware, now_ns: int, m: wire.ClearFault) -> list[wire.Message]:
    """Leave FAULT or ESTOP if the host sends the token."""
    if fw.state not in (State.FAULT, State.ESTOP):
        return [fw.answer(TYPES[wire.ClearFault], m.seq, Code.WRONG_STATE)]
    if m.token != fw.token:
        return [fw.answer(TYPES[wire.ClearFault], m.seq, Code.WRONG_TOKEN)]
    return _transition(fw, now_ns, m, State.IDLE)


def estop(fw: Firmware, now_ns: int, m: wire.Estop) -> list[wire.Message]:
    """Enter ESTOP, which latches 0 V."""
    if fw.state is State.ESTOP:
        return [fw.answer(TYPES[wire.Estop], m.seq, Code.OK)]
    return _transition(fw, now_ns, m, State.ESTOP)


def _transition(fw: Firmware, now_ns: int, m: wire.Message, state: State) -> list[wire.Message]:
    """Return ACK(OK) and the EVENT, in the order in which they are sent."""
    event = fw.enter(now_ns, state, Cause.REQUEST)
    return [fw.answer(TYPES[type(m)], m.seq, Code.OK), event]


def check_config(config: wire.Config, *, ts_min_us: int, skew_us: int) -> Code:
    """Return OK, or the code with which this device refuses `config`.

    `ts_min_us` and `skew_us` are values of HELLO_R.
    """
    pairs_more = config.oversampling - 1
    allowed = (
        config.ts_us >= ts_min_us + 2 * pairs_more * skew_us
        and config.u_min <= config.u_max
        # The device has an enable line, so u_rest may differ from 0.
        and (config.u_rest == 0 or config.u_min <= config.u_rest <= config.u_max)
        and WATCHDOG_MIN_MS <= config.watchdog_ms <= WATCHDOG_MAX_MS
        and config.mode in set(Mode)
        and config.underrun in set(Underrun)
        and config.oversampling >= 1
    )
    return Code.OK if allowed else Code.BAD_VALUE
