"""The transitions of the core: a state and an event, and all that the core makes of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import pytest
from armrig_daemon import pipe
from armrig_daemon.decisions.faults import Fault, Id, of_device
from armrig_daemon.decisions.state import (
    ActiveRun,
    DecisionState,
    Emit,
    Event,
    Exit,
    LinkDown,
    Phase,
    Received,
    RequestKind,
    Send,
    ServiceGone,
    Wakeup,
)
from armrig_daemon.pipe import Answer, Log, Order, Reset, RunEnded
from armrig_protocol.decoder import feed
from armrig_protocol.frame import config_crc, encode
from armrig_protocol.messages import TYPES, Ack, Cause, Code, ConfigReply, HelloReply, Stop
from armrig_protocol.messages import Event as DeviceEvent
from armrig_protocol.messages import State as Device

from tests.daemon.decision_states import (
    ARM,
    OURS,
    SET,
    Decided,
    armed,
    awaiting,
    changed,
    device_sample,
    driven,
    rested,
)
from tests.daemon.virtual_bench import LEASE, MS, Bench, codes

Made = Callable[[DecisionState, HelloReply], Event]
"""An event, made for the state that it meets and for the device that was met."""
HELLO, CONFIGURE, ARMING, START, STOP, CLEAR = RequestKind
STALE, RESET = Fault(Id.STALE, "no answer"), Reset(order=8)


class Row(NamedTuple):
    """A transition."""

    make: Callable[[], Bench]
    change: dict[str, Any]
    awaits: tuple[RequestKind, Order | None] | None
    event: Event | Made
    result: str
    tries: int = 1


def _frame(message: Any) -> Event:
    return Received(b"\0" + encode(message))


def _ack(state: int, code: int = Code.OK, kind: type | None = None, seq: int = OURS) -> Event:
    return _frame(Ack(state, 0, TYPES[kind] if kind else 0, code, seq))


def _any_in(state: int) -> Event:
    return _ack(state, seq=1)


def _hello_r(**fields: int) -> Made:
    return lambda _, device: _frame(device._replace(**{"state": Device.IDLE, **fields}))


def _boot(s: DecisionState, device: HelloReply) -> Event:
    zero = DeviceEvent._make([0] * len(DeviceEvent._fields))
    return _frame(zero._replace(boot=device.boot_id + 1 & 0xFFFF))


def _sample_after_boot(s: DecisionState, device: HelloReply) -> Event:
    return _frame(device_sample(s, boot=device.boot_id + 1 & 0xFFFF))


def _config_r(**fields: int) -> Made:
    def made(s: DecisionState, _: HelloReply) -> Event:
        (sent,) = Decided(s, s.asked.sent_ns + 50 * MS, Wakeup()).sent
        reply = ConfigReply._make((3, 0, int(Code.OK), 0, config_crc(sent), *sent[2:], 77))
        return _frame(reply._replace(**fields))

    return made


def _end(s: DecisionState, _: HelloReply) -> Event:
    sample = device_sample(s)._replace(state=Device.IDLE)
    acks = [Ack(Device.IDLE, 0, TYPES[Stop], Code.OK, OURS)] * 2
    return Received(b"\0" + b"".join(map(encode, (acks[0], sample, acks[1]))))


@cache
def _world(make: Callable[[], Bench]) -> tuple[DecisionState, int, HelloReply]:
    bench = make()
    return bench.loop.state, bench.ports.now, bench.loop.state.device


def _told(before: DecisionState, decided: Decided) -> str:
    """Return the phase, a new fault, the awaited request, the lease, and the actions in order."""
    state = decided.state
    is_new = state.fault and state.fault != before.fault
    fault = f" ({state.fault.id}: {state.fault.cause})" if is_new else ""
    asked = f", awaits {state.asked.want}" if state.asked else ""
    told = [f"{state.phase}{fault}{asked}{', held' if state.lease else ''}"]
    for action in decided.actions:
        record = action.record if isinstance(action, Emit) else None
        if isinstance(action, Send):
            told += [f"sends {type(m).__name__}" for m in feed(b"", action.data)[1]]
        elif isinstance(record, Answer):
            is_cause = record.error and record.error == state.reason
            error = "with the fault" if is_cause else record.error or "done"
            told.append(f"answers {record.order} {error}")
        elif isinstance(record, Log):
            told.append(record.level)
        elif isinstance(record, RunEnded):
            told.append(f"ends run: {record.outcome}")
        elif record is not None or isinstance(action, Exit):
            told.append(type(record or action).__name__)
    return "; ".join(told)


RUN = ActiveRun("r", codes(1.0), -1)
IN_FAULT = {"phase": Phase.FAULT, "fault": STALE}
NONCE = _ack(Device.ARMED, Code.WRONG_NONCE)
BOOTS = {"EVENT": _boot, "SAMPLE": _sample_after_boot}
REFUSED = "the device refuses the configuration: UNSUPPORTED"
UNMET = {"phase": Phase.INIT, "device": None}
FOUND = {**IN_FAULT, "device": None}
ROWS: dict[str, Row] = {
    "T1: HELLO is sent again for ever": Row(
        rested, {}, (HELLO, None), Wakeup(), "safe, awaits HELLO; sends Hello", 1000
    ),
    "a request over a line that is down is given up": Row(
        rested, {"link": None}, (CONFIGURE, ARM), Wakeup(), "safe; answers 71 the link is down"
    ),
    "S6: a STOP without an answer is a fault": Row(
        driven,
        {"run": RUN},
        (STOP, None),
        Wakeup(),
        "fault (request: the device does not answer STOP); ends run: ; sends Stop; error; State",
        5,
    ),
    "a STOP without an answer after a trip keeps the fault": Row(
        rested, IN_FAULT, (STOP, None), Wakeup(), "fault; error; State", 5
    ),
    "a STOP without an answer does not delay the end": Row(
        driven, {"quitting": True}, (STOP, None), Wakeup(), "init; Exit", 5
    ),
    "a STOP that is confirmed ends the daemon": Row(
        driven, {"quitting": True}, (STOP, None), _end, "init; Exit"
    ),
    **{
        f"a refused {want} of an armed rig is a fault": Row(
            armed,
            {},
            (want, SET),
            NONCE,
            f"fault (request: the device refuses {want}: WRONG_NONCE), awaits STOP; "
            "answers 72 with the fault; sends Stop; error; State",
        )
        for want in (START, ARMING, CONFIGURE)
    },
    "a refused ARM at rest is reported, and HELLO follows": Row(
        rested,
        {},
        (ARMING, ARM),
        _ack(Device.READY, 200),
        "safe, awaits HELLO; answers 71 the device refuses ARM: 200; warning; sends Hello",
    ),
    "a refused STOP of a driven device leaves the motor to the watchdog": Row(
        rested,
        IN_FAULT,
        (STOP, None),
        _ack(Device.RUN, Code.BAD_VALUE, kind=Stop),
        "fault; error; State",
    ),
    "ACK(STALE) refuses nothing": Row(
        rested, {}, (ARMING, ARM), _ack(Device.READY, Code.STALE), "safe, awaits ARM"
    ),
    "the ACK of another frame refuses nothing": Row(
        rested,
        {},
        (ARMING, ARM),
        _ack(Device.READY, Code.WRONG_STATE, seq=OURS + 1),
        "safe, awaits ARM",
    ),
    "ACK(OK) without the new state confirms nothing": Row(
        rested, {}, (ARMING, ARM), _ack(Device.READY), "safe, awaits ARM"
    ),
    "the new state confirms a request": Row(
        rested,
        {},
        (ARMING, ARM),
        _ack(Device.ARMED),
        "armed, held; State; answers 71 done",
    ),
    "the new state in any frame confirms a request": Row(
        rested,
        {},
        (ARMING, ARM),
        _ack(Device.ARMED, Code.WRONG_STATE, seq=OURS + 1),
        "armed, held; State; answers 71 done",
    ),
    "S6: a reset continues with CONFIG after STOP": Row(
        rested,
        {**IN_FAULT, "device_state": Device.RUN},
        (STOP, RESET),
        _ack(Device.IDLE, kind=Stop),
        "fault, awaits CONFIG; sends Config",
    ),
    "S6: STOP alone leaves the fault": Row(
        rested,
        {**IN_FAULT, "device_state": Device.RUN},
        (STOP, None),
        _ack(Device.IDLE, kind=Stop),
        "fault; State",
    ),
    "a device in FAULT is a fault": Row(
        driven,
        {},
        None,
        _any_in(Device.FAULT),
        "fault (device: the device is in FAULT), awaits STOP; sends Stop; error; State",
    ),
    **{
        f"S6: a device that leaves RUN for {name} unasked is a fault": Row(
            driven,
            {},
            None,
            _any_in(state),
            f"fault (state: the device is in {name}, which the daemon did not request), "
            "awaits STOP; sends Stop; error; State",
        )
        for name, state in {"READY": Device.READY, "IDLE": Device.IDLE, "99": 99}.items()
    },
    "a device that was latched before is not reported again": Row(
        rested, {"device_state": Device.ESTOP}, None, _any_in(Device.ESTOP), "safe"
    ),
    "S5: ARM without its order is a fault": Row(
        armed,
        {"device_state": Device.READY},
        (ARMING, None),
        _any_in(Device.ARMED),
        "fault (internal: armed without an owner), awaits STOP; sends Stop; error; State",
    ),
    "S5: START without its order is a fault": Row(
        armed,
        {"device_state": Device.READY},
        (START, None),
        _any_in(Device.RUN),
        "fault (internal: started without an owner), awaits STOP; sends Stop; error; State",
    ),
    "S5: a start without a lease is a fault": Row(
        armed,
        {"lease": None},
        (START, SET),
        _any_in(Device.RUN),
        "fault (internal: started without an owner), awaits STOP; sends Stop; error; State",
    ),
    "S3: a device that is found in ARMED is stopped": Row(
        rested, UNMET, (HELLO, None), _hello_r(state=Device.ARMED), "init, awaits STOP; sends Stop"
    ),
    "S3: a device that is found in RUN is stopped": Row(
        rested, UNMET, (HELLO, None), _hello_r(state=Device.RUN), "init, awaits STOP; sends Stop"
    ),
    "S3: a device that is found in RUN during a fault is stopped": Row(
        rested, FOUND, (HELLO, None), _hello_r(state=Device.RUN), "fault, awaits STOP; sends Stop"
    ),
    "a device that is met in FAULT reports its cause": Row(
        rested,
        UNMET,
        (HELLO, None),
        _hello_r(state=Device.FAULT, cause=Cause.WATCHDOG),
        f"fault (device: the device is in FAULT: {of_device(Cause.WATCHDOG)}); error; State",
    ),
    "T1: a device that is met again in FAULT is reported in the state": Row(
        rested,
        {**FOUND, "fault": Fault(Id.DEVICE, "the device is in FAULT")},
        (HELLO, None),
        _hello_r(state=Device.FAULT),
        "fault; State",
    ),
    "S6: a device that is met in a fault resets nothing": Row(
        rested, IN_FAULT, (HELLO, None), _hello_r(), "fault; State"
    ),
    "S6: a reset configures the device that is met": Row(
        rested, IN_FAULT, (HELLO, RESET), _hello_r(), "fault, awaits CONFIG; sends Config"
    ),
    "a duty of 1 bit can be driven": Row(
        rested, {}, (HELLO, None), _hello_r(pwm_bits=1), "safe, awaits CONFIG; sends Config"
    ),
    "a duty of 16 bits can be driven": Row(
        rested, {}, (HELLO, None), _hello_r(pwm_bits=16), "safe, awaits CONFIG; sends Config"
    ),
    **{
        f"T1: a device at rest that boots is met again ({by})": Row(
            rested, {}, None, event, "init, awaits HELLO; warning; State; sends Hello"
        )
        for by, event in BOOTS.items()
    },
    **{
        f"S6: a device in RUN that boots is a fault ({by})": Row(
            driven,
            {},
            None,
            event,
            "fault (reset: the device was reset), awaits HELLO; "
            "sends Stop; error; State; sends Hello",
        )
        for by, event in BOOTS.items()
    },
    "a boot leaves a latched fault": Row(
        rested, IN_FAULT, None, _boot, "fault, awaits HELLO; sends Hello"
    ),
    "CONFIG that is refused at rest is a fault": Row(
        rested,
        {},
        (CONFIGURE, None),
        _config_r(code=Code.UNSUPPORTED),
        f"fault (request: {REFUSED}); error; State",
    ),
    "CONFIG that is refused at a reset answers the reset": Row(
        rested,
        {},
        (CONFIGURE, RESET),
        _config_r(code=Code.UNSUPPORTED),
        f"fault (request: {REFUSED}); answers 8 with the fault; error; State",
    ),
    "CONFIG that is refused for an arming is reported, and HELLO follows": Row(
        rested,
        {},
        (CONFIGURE, ARM),
        _config_r(code=Code.BAD_VALUE),
        "safe, awaits HELLO; answers 71 the device refuses the configuration: BAD_VALUE; "
        "warning; sends Hello",
    ),
    **{
        f"{type(order).__name__} is done though CONFIG is refused": Row(
            rested,
            {},
            (CONFIGURE, order),
            _config_r(code=Code.UNSUPPORTED),
            f"fault (request: {REFUSED}); answers 5 done; error; State",
        )
        for order in (pipe.Stop(order=5), pipe.Disarm(order=5, lease=LEASE, n=1))
    },
    "S6: a link that goes at rest is no fault": Row(
        rested, {}, None, LinkDown("unplugged"), "init; warning; State"
    ),
    "S6: a link that goes in a fault leaves the fault": Row(
        rested, IN_FAULT, None, LinkDown("unplugged"), "fault; warning; State"
    ),
    "a link that goes does not delay the end": Row(
        driven, {"quitting": True}, None, LinkDown("unplugged"), "init; Exit"
    ),
    "a daemon whose service is gone stops": Row(
        driven, {}, None, ServiceGone(), "active, awaits STOP, held; sends Stop"
    ),
    "no KEEPALIVE over a line that is down": Row(rested, {"link": None}, None, Wakeup(), "safe"),
    "S4: no KEEPALIVE in a fault while the device drives": Row(
        driven, IN_FAULT, None, Wakeup(), "fault, held"
    ),
    "KEEPALIVE in a fault once the device is at rest": Row(
        driven,
        {**IN_FAULT, "device_state": Device.IDLE},
        None,
        Wakeup(),
        "fault, held; sends Keepalive",
    ),
}


@pytest.mark.parametrize("rule", ROWS)
def test_a_transition_of_the_core_has_the_actions_of_its_row(rule: str) -> None:
    row = ROWS[rule]
    state, now_ns, device = _world(row.make)
    state = changed(state, **row.change)
    if row.awaits:
        state = awaiting(state, *row.awaits, tries=row.tries)
        if row.awaits[0] is CONFIGURE:
            state = changed(state, asked=state.asked._replace(ts_us=10_000))
    event = row.event(state, device) if callable(row.event) else row.event

    assert _told(state, Decided(state, now_ns, event)) == row.result
