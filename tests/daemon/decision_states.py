"""States of the core built for one test each, and what one step made of them."""

from __future__ import annotations

from collections.abc import Iterable
from struct import pack
from typing import Any

from armrig_core.control.evaluation import Program
from armrig_daemon.decisions import step
from armrig_daemon.decisions.state import (
    DecisionState,
    Emit,
    Event,
    Ordered,
    PendingRequest,
    Received,
    RequestKind,
    Send,
)
from armrig_daemon.pipe import Arm, Order, Run, Set
from armrig_protocol.decoder import feed
from armrig_protocol.frame import encode
from armrig_protocol.messages import Message
from armrig_protocol.messages import Sample as DeviceSample
from msgspec.structs import replace

from tests.daemon.virtual_bench import LEASE, Bench, codes

ARM = Arm(order=71, owner="a student", lease=LEASE, ts_us=0)
SET = Set(order=72, lease=LEASE, n=50, code=1000)
RUN = Run(order=73, lease=LEASE, n=50, run_id="r", codes=codes(1.0, 2.0))
LAW = Program(
    law_sha256="5" * 64,
    Ts_us=10_000,
    rows=((0.5, 0.2, 0.1, -0.4),),
    v_row=(1.0, 0.3),
    u0=1.5,
    x0=(0.0,),
    predictions=((0.1,),),
    channels=(1,),
    y0=(0.0,),
    turning=(False,),
    lo_code=0,
    hi_code=65_535,
    slew=0,
    input_delay=0,
    most_blind=20,
    most_limited=0,
    tracked=None,
    most_error=0.0,
    most_astray=0,
)
"""Law of one state on the second output."""
OURS = 4711
"""seq of the awaited request, if any."""


def control_run(law: Program = LAW, r: Iterable[float] = (1.0, 2.0)) -> Run:
    """Return the order of a run by a law, with its reference."""
    values = [*r]
    reference = pack(f"<{len(values)}d", *values)
    r_range = min(values, default=0.0), max(values, default=0.0)
    return changed(RUN, codes=b"", law=law, reference=reference, r_range=r_range)


def rested() -> Bench:
    """Return a bench at 0 V without a holder."""
    return Bench()


def armed() -> Bench:
    """Return a bench that is held, at 0 V."""
    bench = Bench()
    assert not bench.arm().error
    return bench


def driven() -> Bench:
    """Return a bench whose motor is held at 1 V by hand."""
    bench = armed()
    bench.order(Set(order=99, lease=LEASE, n=0, code=codes(1.0)[0] | codes(1.0)[1] << 8))
    bench.run_for(20)
    return bench


def changed(thing: Any, **fields: object) -> Any:
    """Return a state with these fields, wherever in it they are; of another struct, its own."""
    for name in ("link", "configuration", "clock") if isinstance(thing, DecisionState) else ():
        part = getattr(thing, name)
        own = {f: fields.pop(f) for f in [*fields] if part and f in part.__struct_fields__}
        if own:
            fields[name] = replace(part, **own)
    return replace(thing, **fields)


def awaiting(
    state: DecisionState, want: RequestKind, order: Order | None = None, **fields: int
) -> DecisionState:
    """Return the state with a request on its way, sent at 0."""
    asked = PendingRequest(want, fields.pop("sent_ns", 0), OURS, 1, 0, False, order)
    return replace(state, asked=asked._replace(**fields))


class Decided:
    """Decisions of the core on one event."""

    def __init__(self, state: DecisionState, now_ns: int, event: Event) -> None:
        self.state, self.actions = step.step(state, now_ns, [event])

    def of(self, kind: type) -> list:
        return [a for a in self.actions if isinstance(a, kind)]

    def told(self, kind: type) -> list:
        return [a.record for a in self.of(Emit) if isinstance(a.record, kind)]

    @property
    def sent(self) -> list[Message]:
        """Return the frames to the device."""
        received = [m for a in self.of(Send) for m in feed(b"", a.data)[1]]
        assert all(isinstance(m, tuple) for m in received)
        return received


def ordered(bench: Bench, order: Order, state: DecisionState | None = None) -> Decided:
    """Return the core's decisions on an order."""
    return Decided(state or bench.loop.state, bench.ports.now, Ordered(order))


def heard(bench: Bench, message: Message, state: DecisionState | None = None) -> Decided:
    """Return the core's reaction to a message of the device."""
    event = Received(b"\0" + encode(message))
    state = changed(state or bench.loop.state, pending=b"")
    return Decided(state, bench.ports.now, event)


def device_sample(state: DecisionState, **fields: int) -> DeviceSample:
    """Return a SAMPLE of the device that is met, of now on its clock, all else 0.

    The device has taken in every EXCHANGE that was sent.
    """
    zero = DeviceSample._make([0] * len(DeviceSample._fields))
    known = {
        "seq": ((state.link.device_seq or 0) + 1) & 0xFFFF,
        "state": state.link.device_state,
        "boot": state.device.boot_id & 0xFFFF,
        "t_us": state.t_us & 0xFFFFFFFF,
        "echo": state.link.sent[-1].seq if state.link.sent else 0,
    }
    return zero._replace(**{**known, **fields})
