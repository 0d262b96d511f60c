"""The transitions of the core: a state and an event, and all that the core makes of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from types import MappingProxyType
from typing import Any, NamedTuple

import pytest
from armrig_daemon import pipe
from armrig_daemon.decisions.faults import Fault, Id, of_device
from armrig_daemon.decisions.state import (
    ActiveRun,
    Emit,
    Event,
    Exit,
    LinkDown,
    Phase,
    Received,
    RequestKind,
    Send,
    ServiceGone,
    State,
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

Made = Callable[[State, HelloReply], Event]
"""An event, made for the state that it meets and for the device that was met."""
HELLO, CONFIGURE, ARMING, START, STOP, CLEAR = RequestKind
STALE, RESET = Fault(Id.STALE, "no answer"), Reset(order=8)


class Row(NamedTuple):
    """A transition."""

    make: Callable[[], Bench]
    event: Event | Made
    result: str
    awaits: tuple[RequestKind, Order | None] | None = None
    tries: int = 1
    change: Mapping[str, Any] = MappingProxyType({})


def _frame(message: Any) -> Event:
    return Received(b"\0" + encode(message))


def _ack(state: int, code: int = Code.OK, kind: type | None = None, seq: int = OURS) -> Event:
    return _frame(Ack(state, 0, TYPES[kind] if kind else 0, code, seq))


def _any_in(state: int) -> Event:
    return _ack(state, seq=1)


def _hello_r(**fields: int) -> Made:
    return lambda _, device: _frame(device._replace(**{"state": Device.IDLE, **fields}))


def _boot(s: State, device: HelloReply) -> Event:
    zero = DeviceEvent._make([0] * len(DeviceEvent._fields))
    return _frame(zero._replace(boot=device.boot_id + 1 & 0xFFFF))


def _sample_after_boot(s: State, device: HelloReply) -> Event:
    return _frame(device_sample(s, boot=device.boot_id + 1 & 0xFFFF))


def _config_r(**fields: int) -> Made:
    def made(s: State, _: HelloReply) -> Event:
        (sent,) = Decided(s, s.asked.sent_ns + 50 * MS, Wakeup()).sent
        reply = ConfigReply._make((3, 0, int(Code.OK), 0, config_crc(sent), *sent[2:], 77))
        return _frame(reply._replace(**fields))

    return made


def _end(s: State, _: HelloReply) -> Event:
    sample = device_sample(s)._replace(state=Device.IDLE)
    acks = [Ack(Device.IDLE, 0, TYPES[Stop], Code.OK, OURS)] * 2
    return Received(b"\0" + b"".join(map(encode, (acks[0], sample, acks[1]))))


@cache
def _world(make: Callable[[], Bench]) -> tuple[State, int, HelloReply]:
    bench = make()
    return bench.loop.state, bench.ports.now, bench.loop.state.device


def _told(decided: Decided) -> str:
    """Return the phase and the fault, the awaited request, the lease, and the actions in order."""
    state = decided.state
    fault = f" ({state.fault.id}: {state.fault.cause})" if state.fault else ""
    asked = f", awaits {state.asked.want}" if state.asked else ""
    told = [f"{state.phase}{fault}{asked}{', held' if state.lease else ''}"]
    for action in decided.actions:
        record = action.record if isinstance(action, Emit) else None
        if isinstance(action, Send):
            told += [f"sends {type(m).__name__}" for m in feed(b"", action.data)[1]]
        elif isinstance(record, Answer):
            error = "with the fault" if record.error == state.reason else record.error
            told.append(f"answers {record.order} {error or 'done'}")
        elif isinstance(record, Log):
            told.append(record.level)
        elif isinstance(record, RunEnded):
            told.append(f"ends run: {record.outcome}")
        elif record is not None or isinstance(action, Exit):
            told.append(type(record or action).__name__)
    return "; ".join(told)


RUN = ActiveRun("r", codes(1.0), -1)
IN_FAULT = {"phase": Phase.FAULT, "fault": STALE}
BOOTS = {"EVENT": _boot, "SAMPLE": _sample_after_boot}
REFUSED = "the device refuses the configuration: UNSUPPORTED"
UNMET = {"phase": Phase.INIT, "device": None}
FOUND = {**IN_FAULT, "device": None}
ROWS: dict[str, Row] = {
    "T1: HELLO is sent again for ever": Row(
        rested, Wakeup(), "safe, awaits HELLO; sends Hello", (HELLO, None), 1000
    ),
    "a request over a line that is down is given up": Row(
        rested,
        Wakeup(),
        "safe; answers 71 the link is down",
        (CONFIGURE, ARM),
        change={"link": None},
    ),
    "S6: a STOP without an answer is a fault": Row(
        driven,
        Wakeup(),
        "fault (request: the device does not answer STOP); ends run: ; sends Stop; error; State",
        (STOP, None),
        5,
        {"run": RUN},
    ),
    "a STOP without an answer after a trip keeps the fault": Row(
        rested, Wakeup(), "fault (stale: no answer); error; State", (STOP, None), 5, IN_FAULT
    ),
    "a STOP without an answer does not delay the end": Row(
        driven, Wakeup(), "init; Exit", (STOP, None), 5, {"quitting": True}
    ),
    "a STOP that is confirmed ends the daemon": Row(
        driven, _end, "init; Exit", (STOP, None), change={"quitting": True}
    ),
    **{
        f"a refused {want} of an armed rig is a fault": Row(
            armed,
            _ack(Device.ARMED, Code.WRONG_NONCE),
            f"fault (request: the device refuses {want}: WRONG_NONCE), awaits STOP; "
            "answers 72 with the fault; sends Stop; error; State",
            (want, SET),
        )
        for want in (START, ARMING, CONFIGURE)
    },
    "a refused ARM at rest is reported, and HELLO follows": Row(
        rested,
        _ack(Device.READY, 200),
        "safe, awaits HELLO; answers 71 the device refuses ARM: 200; warning; sends Hello",
        (ARMING, ARM),
    ),
    "ACK(STALE) refuses nothing": Row(
        rested, _ack(Device.READY, Code.STALE), "safe, awaits ARM", (ARMING, ARM)
    ),
    "the ACK of another frame refuses nothing": Row(
        rested,
        _ack(Device.READY, Code.WRONG_STATE, seq=OURS + 1),
        "safe, awaits ARM",
        (ARMING, ARM),
    ),
    "ACK(OK) without the new state confirms nothing": Row(
        rested, _ack(Device.READY), "safe, awaits ARM", (ARMING, ARM)
    ),
    "the new state confirms a request": Row(
        rested, _ack(Device.ARMED), "armed, held; State; answers 71 with the fault", (ARMING, ARM)
    ),
    "the new state in any frame confirms a request": Row(
        rested,
        _ack(Device.ARMED, Code.WRONG_STATE, seq=OURS + 1),
        "armed, held; State; answers 71 with the fault",
        (ARMING, ARM),
    ),
    "S6: a reset continues with CONFIG after STOP": Row(
        rested,
        _ack(Device.IDLE, kind=Stop),
        "fault (stale: no answer), awaits CONFIG; sends Config",
        (STOP, RESET),
        change={**IN_FAULT, "device_state": Device.RUN},
    ),
    "S6: STOP alone leaves the fault": Row(
        rested,
        _ack(Device.IDLE, kind=Stop),
        "fault (stale: no answer); State",
        (STOP, None),
        change={**IN_FAULT, "device_state": Device.RUN},
    ),
    "a device in FAULT is a fault": Row(
        driven,
        _any_in(Device.FAULT),
        "fault (device: the device is in FAULT), awaits STOP; sends Stop; error; State",
    ),
    **{
        f"S6: a device that leaves RUN for {name} unasked is a fault": Row(
            driven,
            _any_in(state),
            f"fault (state: the device is in {name}, which the daemon did not request), "
            "awaits STOP; sends Stop; error; State",
        )
        for name, state in {"READY": Device.READY, "IDLE": Device.IDLE, "99": 99}.items()
    },
    "a device that was latched before is not reported again": Row(
        rested, _any_in(Device.ESTOP), "safe", change={"device_state": Device.ESTOP}
    ),
    "S5: ARM without its order is a fault": Row(
        armed,
        _any_in(Device.ARMED),
        "fault (internal: armed without an owner), awaits STOP; sends Stop; error; State",
        (ARMING, None),
        change={"device_state": Device.READY},
    ),
    "S5: START without its order is a fault": Row(
        armed,
        _any_in(Device.RUN),
        "fault (internal: started without an owner), awaits STOP; sends Stop; error; State",
        (START, None),
        change={"device_state": Device.READY},
    ),
    "S5: a start without a lease is a fault": Row(
        armed,
        _any_in(Device.RUN),
        "fault (internal: started without an owner), awaits STOP; sends Stop; error; State",
        (START, SET),
        change={"lease": None},
    ),
    "S3: a device that is found in ARMED is stopped": Row(
        rested,
        _hello_r(state=Device.ARMED),
        "init, awaits STOP; sends Stop",
        (HELLO, None),
        change=UNMET,
    ),
    "S3: a device that is found in RUN is stopped": Row(
        rested,
        _hello_r(state=Device.RUN),
        "init, awaits STOP; sends Stop",
        (HELLO, None),
        change=UNMET,
    ),
    "S3: a device that is found in RUN during a fault is stopped": Row(
        rested,
        _hello_r(state=Device.RUN),
        "fault (stale: no answer), awaits STOP; sends Stop",
        (HELLO, None),
        change=FOUND,
    ),
    "a device that is met in FAULT reports its cause": Row(
        rested,
        _hello_r(state=Device.FAULT, cause=Cause.WATCHDOG),
        f"fault (device: the device is in FAULT: {of_device(Cause.WATCHDOG)}); error; State",
        (HELLO, None),
        change=UNMET,
    ),
    "T1: a device that is met again in FAULT is reported in the state": Row(
        rested,
        _hello_r(state=Device.FAULT),
        "fault (device: the device is in FAULT); State",
        (HELLO, None),
        change={**FOUND, "fault": Fault(Id.DEVICE, "the device is in FAULT")},
    ),
    "S6: a device that is met in a fault resets nothing": Row(
        rested, _hello_r(), "fault (stale: no answer); State", (HELLO, None), change=IN_FAULT
    ),
    "S6: a reset configures the device that is met": Row(
        rested,
        _hello_r(),
        "fault (stale: no answer), awaits CONFIG; sends Config",
        (HELLO, RESET),
        change=IN_FAULT,
    ),
    "a duty of 1 bit can be driven": Row(
        rested, _hello_r(pwm_bits=1), "safe, awaits CONFIG; sends Config", (HELLO, None)
    ),
    "a duty of 16 bits can be driven": Row(
        rested, _hello_r(pwm_bits=16), "safe, awaits CONFIG; sends Config", (HELLO, None)
    ),
    **{
        f"T1: a device at rest that boots is met again ({by})": Row(
            rested, event, "init, awaits HELLO; warning; State; sends Hello"
        )
        for by, event in BOOTS.items()
    },
    **{
        f"S6: a device in RUN that boots is a fault ({by})": Row(
            driven,
            event,
            "fault (reset: the device was reset), awaits HELLO; "
            "sends Stop; error; State; sends Hello",
        )
        for by, event in BOOTS.items()
    },
    "a boot leaves a latched fault": Row(
        rested, _boot, "fault (stale: no answer), awaits HELLO; sends Hello", change=IN_FAULT
    ),
    "CONFIG that is refused at rest is a fault": Row(
        rested,
        _config_r(code=Code.UNSUPPORTED),
        f"fault (request: {REFUSED}); error; State",
        (CONFIGURE, None),
    ),
    "CONFIG that is refused at a reset answers the reset": Row(
        rested,
        _config_r(code=Code.UNSUPPORTED),
        f"fault (request: {REFUSED}); answers 8 with the fault; error; State",
        (CONFIGURE, RESET),
    ),
    "CONFIG that is refused for an arming is reported, and HELLO follows": Row(
        rested,
        _config_r(code=Code.BAD_VALUE),
        "safe, awaits HELLO; answers 71 the device refuses the configuration: BAD_VALUE; "
        "warning; sends Hello",
        (CONFIGURE, ARM),
    ),
    **{
        f"{type(order).__name__} is done though CONFIG is refused": Row(
            rested,
            _config_r(code=Code.UNSUPPORTED),
            f"fault (request: {REFUSED}); answers 5 done; error; State",
            (CONFIGURE, order),
        )
        for order in (pipe.Stop(order=5), pipe.Disarm(order=5, lease=LEASE, n=1))
    },
    "S6: a link that goes at rest is no fault": Row(
        rested, LinkDown("unplugged"), "init; warning; State"
    ),
    "S6: a link that goes in a fault leaves the fault": Row(
        rested, LinkDown("unplugged"), "fault (stale: no answer); warning; State", change=IN_FAULT
    ),
    "a link that goes does not delay the end": Row(
        driven, LinkDown("unplugged"), "init; Exit", change={"quitting": True}
    ),
    "a daemon whose service is gone stops": Row(
        driven, ServiceGone(), "active, awaits STOP, held; sends Stop"
    ),
    "S4: no KEEPALIVE in a fault while the device drives": Row(
        driven, Wakeup(), "fault (stale: no answer), held", change=IN_FAULT
    ),
    "KEEPALIVE in a fault once the device is at rest": Row(
        driven,
        Wakeup(),
        "fault (stale: no answer), held; sends Keepalive",
        change={**IN_FAULT, "device_state": Device.IDLE},
    ),
}


@pytest.mark.parametrize("rule", ROWS)
def test_a_transition_of_the_core(rule: str) -> None:
    row = ROWS[rule]
    state, now_ns, device = _world(row.make)
    state = changed(state, **row.change)
    if row.awaits:
        state = awaiting(state, *row.awaits, tries=row.tries)
        if row.awaits[0] is CONFIGURE:
            state = changed(state, asked=state.asked._replace(ts_us=10_000))
    event = row.event(state, device) if callable(row.event) else row.event

    assert _told(Decided(state, now_ns, event)) == row.result
