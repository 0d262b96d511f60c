"""Requests to the device, and the records about the state of the core."""

from __future__ import annotations

from typing import Any

from armrig_core.commands.codes import RefusalCode
from armrig_protocol.frame import encode
from armrig_protocol.messages import (
    SCHEMA_HASH,
    VERSION,
    Arm,
    ClearFault,
    Config,
    Hello,
    HelloReply,
    Message,
    Mode,
    Start,
    Stop,
    Underrun,
)
from armrig_protocol.messages import State as DeviceState
from msgspec.structs import replace

from armrig_daemon import pipe
from armrig_daemon.decisions.faults import REMEDIES
from armrig_daemon.decisions.state import (
    Action,
    Emit,
    PendingRequest,
    RequestKind,
    Rules,
    Send,
    Sent,
    State,
    Traffic,
    Unechoed,
)
from armrig_daemon.pipe import Answer, Log, Order
from armrig_daemon.pipe import State as StateRecord

NO_DEVICE = "no device answers; check that it is plugged in, and that its supply is on: try again"
"""Refusal of an order that needs a device while no device answers."""
Step = tuple[State, list[Action]]
"""Result of a function of the core: the next state, and the actions."""


MAX_REMEMBERED_FRAMES = 64  # frames without an echo; the fault STALE occurs with far fewer
NOTICE_TRIES = 18
"""Number of unanswered HELLOs, 0.1 s apart, after which the daemon reports a silent device."""


def linked(state: State, **changes: Any) -> State:
    """Return the state with changes in its link; a state without a link does not change."""
    link = state.link
    return state if link is None else replace(state, link=replace(link, **changes))


def is_newer(seq: int, known: int) -> bool:
    """Return whether a frame was sent after another one of the same sender, by their numbers."""
    return 0 < (seq - known) & 0xFFFF < 0x8000


def send(state: State, now_ns: int, data: bytes, exchange: Sent | None = None) -> Step:
    """Send the frame with the next seq; remember an EXCHANGE until its SAMPLE arrives."""
    link, in_force = state.link, state.configuration
    if link is None:
        return state, []
    beats, sent = link.beats, link.sent
    if in_force is not None and in_force.scheduled:
        beats = (*beats[1 - MAX_REMEMBERED_FRAMES :], Unechoed(link.seq, now_ns))
    if exchange is not None:
        sent = (*sent, exchange)
    seq = (link.seq + 1) & 0xFFFF
    link = replace(link, seq=seq, last_send_ns=now_ns, beats=beats, sent=sent)
    return replace(state, link=link), [Send(data)]


def log(now_ns: int, level: str, message: str, **fields: str) -> Action:
    """Return a record for the log: a line for a person, and the fields of the line."""
    return Emit(Log(t_host_ns=now_ns, level=level, message=message, fields=fields))


def answer(order: Order | None, body: dict[str, object]) -> list[Action]:
    """Return the answer to an order; [] if the order is None."""
    return [] if order is None else [Emit(Answer(order=order.order, body=body))]


def refuse(
    order: Order | None,
    error: str,
    code: RefusalCode = RefusalCode.NOT_ALLOWED,
    **parameters: str | int | float,
) -> list[Action]:
    """Return the refusal of an order; [] if the order is None."""
    if order is None:
        return []
    return [Emit(Answer(order=order.order, error=error, code=code, parameters=parameters))]


def device_facts(device: HelloReply | None) -> dict[str, object]:
    """Return the properties of the device in its HELLO_R, by name; identifiers are hexadecimal."""
    if device is None:
        return {}
    facts: dict[str, object] = dict(device._asdict())
    for name in ("state", "seq", "token", "cause"):
        del facts[name]
    for name in ("uid", "boot_id", "schema", "firmware"):
        facts[name] = f"{facts[name]:x}"
    return facts


def motor(state: State) -> str:
    """Return the state of the motor, as text for a person."""
    watchdog = f"its watchdog stops it within {state.rules.watchdog_ms} ms"
    if state.device is None or state.link is None:
        return f"not known: the device does not answer; {watchdog}"
    if state.device_state != DeviceState.RUN:
        return "at 0 V, as the device reports"
    if state.asked is not None and state.asked.want is RequestKind.STOP:
        return "stop sent, not confirmed yet"
    return f"stop sent, but not confirmed; {watchdog}" if state.fault else "driven"


def unanswered(state: State) -> str:
    """Return the reason why no device answers HELLO, and a remedy; "" if there is no problem."""
    link = state.link
    if link is None:
        return (
            "no rig is connected, and the daemon waits for one: check that the rig is plugged in, "
            "and that this is its port"
        )
    asked, came, baud = state.asked, link.came, state.rules.baud
    if asked is None or asked.want is not RequestKind.HELLO or asked.tries < NOTICE_TRIES:
        return ""
    if came.frames:
        found = (
            f"{came.frames} frames came, but no answer to HELLO; check that its firmware speaks "
            "this version of the wire, and that nothing else is on this port"
        )
    elif came.bytes:
        found = (
            f"{came.bytes} bytes came at {baud} baud, but no frame; check the [device] baud and "
            "the port; another sketch may run on the board: `armrig flash` writes armrig's firmware"
        )
    else:
        found = (
            f"{asked.tries} requests at {baud} baud had no answer; check that the device has "
            "power, that this is its port, and that it contains the firmware"
        )
    return f"the device does not answer: {found}"


def report_state(state: State, now_ns: int) -> Action:
    """Return the record of the state, with the sampling time."""
    paces_itself = state.scheduled and state.device_state == DeviceState.RUN
    return Emit(
        StateRecord(
            t_host_ns=now_ns,
            phase=state.phase,
            reason=state.reason,
            owner=state.lease.owner if state.lease else "",
            ts_us=state.ts_us if paces_itself else state.pace_us,
            device=device_facts(state.device),
            fault=state.fault.id if state.fault else "",
            motor=motor(state),
            remedy=REMEDIES[state.fault.id] if state.fault else "",
            line=unanswered(state),
            owner_checked=state.lease.owner_checked if state.lease else "",
            device_cause=state.fault.device_cause if state.fault else 0,
        )
    )


def config(rules: Rules, ts_us: int, seq: int, *, scheduled: bool) -> Config:
    """Return the CONFIG message that requests a configuration of the device."""
    return Config(
        state=0,
        seq=seq,
        ts_us=ts_us,
        # 0 V is always allowed, because the input is 0 V between START and the first sample.
        u_min=0,
        u_max=rules.code_max,
        u_rest=0,
        slew=rules.slew,
        watchdog_ms=rules.watchdog_ms,
        mode=Mode.SCHEDULED if scheduled else Mode.EXCHANGE,
        underrun=Underrun.ZERO,
        hold=0,
        oversampling=rules.oversampling,
        rail_ticks=rules.rail_ticks,
        turns=rules.turns,
    )


def ask(
    state: State,
    now_ns: int,
    want: RequestKind,
    order: Order | None = None,
    *,
    ts_us: int = 0,
    scheduled: bool = False,
    tries: int = 1,
) -> Step:
    """Send a request to the device, and remember the request until it takes effect.

    The request replaces a pending request; the order of the pending request is answered.
    """
    link, in_force = state.link, state.configuration
    if link is None:
        return replace(state, asked=None), refuse(order, "the link is down", RefusalCode.NO_LINK)
    seq = link.seq
    config_crc, nonce = (in_force.config_crc, in_force.nonce) if in_force else (0, 0)
    before = state.asked.order if state.asked else None
    overtaken = [] if before is order else _overtaken(before, want, state.outcome)
    if want is RequestKind.HELLO and tries == 1:
        state = linked(state, came=Traffic())
    boot_id = state.device.boot_id if state.device else 0
    request: Message
    match want:
        case RequestKind.HELLO:
            request = Hello(0, seq, VERSION, SCHEMA_HASH)
        case RequestKind.CONFIGURE:
            request = config(state.rules, ts_us, seq, scheduled=scheduled)
        case RequestKind.ARM:
            request = Arm(0, seq, boot_id, config_crc, nonce)
        case RequestKind.START:
            request = Start(0, seq, state.run.samples if state.run else 0, nonce)
        case RequestKind.STOP:
            request = Stop(0, seq)
        case RequestKind.CLEAR:
            request = ClearFault(0, seq, link.token)
    asked = PendingRequest(want, now_ns, seq, tries, ts_us, scheduled, order)
    # The line may hold noise before HELLO; a 00 ends the noise.
    lead = b"\0" if want is RequestKind.HELLO else b""
    state, sending = send(replace(state, asked=asked), now_ns, lead + encode(request))
    return state, [*overtaken, *sending]


def _overtaken(order: Order | None, want: RequestKind, outcome: str) -> list[Action]:
    """Return the answer to the replaced order: a stop is granted, any other order is refused."""
    if isinstance(order, pipe.Stop | pipe.Disarm):
        return answer(order, {"done": True})
    stopped = want is RequestKind.STOP and outcome
    text = f"not begun: {outcome}" if stopped else f"overtaken by {want}"
    return refuse(order, text, RefusalCode.OVERTAKEN)
