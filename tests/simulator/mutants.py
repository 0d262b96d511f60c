"""Bugs to be planted: each takes one guard out of core, codec or device, in memory.

A schedule that fails with a bug shows that the checks can see it. Some guards are covered by
others: such a bug is planted without the layers that would mask it (`without`). It must be seen,
and the removal of those layers alone must not be.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

from armrig_daemon.decisions import (
    gaps,
    orders,
    phases,
    replies,
    sampling,
    setpoints,
    step,
    stopping,
    transitions,
)
from armrig_daemon.decisions import requests as core_requests
from armrig_daemon.decisions.phases import On
from armrig_daemon.decisions.state import ActiveRun, Emit, Lease, Phase, Rules
from armrig_daemon.emulator import board, firmware, requests
from armrig_daemon.emulator.firmware import NEVER
from armrig_daemon.pipe import Answer
from armrig_protocol import cobs, decoder, frame
from armrig_protocol.frame import Spoilt, Unknown
from armrig_protocol.messages import ARRAYS, MESSAGES, Cause
from msgspec.structs import replace

from tests.simulator.options import KINDS

Patch = Callable[[ExitStack], None]
AGES = 1 << 60


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """A bug, and which invariants it must be seen to break."""

    name: str
    plant: Patch
    breaks: frozenset[str]
    without: tuple[Patch, ...] = ()
    """Layers that mask it."""
    faults: tuple[str, ...] = KINDS
    """Faults that are drawn from: those that the bug is about, to find it soon."""
    first: int = 1000
    """Seed to begin with, where an early one does not show it."""


@contextmanager
def planted(*patches: Patch) -> Iterator[None]:
    """Let bugs be in for a while."""
    with ExitStack() as stack:
        for plant in patches:
            plant(stack)
        yield


def _put(owner: Any, name: str, value: Any) -> Patch:
    """Return what puts `value` in the place of an attribute."""

    def plant(stack: ExitStack) -> None:
        stack.enter_context(patch.object(owner, name, value))

    return plant


def _all(*patches: Patch) -> Patch:
    def plant(stack: ExitStack) -> None:
        for one in patches:
            one(stack)

    return plant


# -- the bugs ------------------------------------------------------------------------------------

_handle_reply, _arm, _leased = replies.handle, orders._arm, orders._leased
_report_missing, _trip, _end_run = gaps.report_missing, stopping.trip, stopping.end_run
_say_allows = Rules.allows


def _fresh_by_arrival(state: Any, now_ns: int, message: Any) -> Any:
    after, done = _handle_reply(state, now_ns, message)
    if after.link and state.link and after.link.last_round_trip_ns != state.link.last_round_trip_ns:
        after = core_requests.linked(after, last_round_trip_ns=now_ns)
    return after, done


def _as_known(kind: Any, *names: str) -> Patch:
    """Return a request in which the device finds its own values in these fields."""

    def plant(stack: ExitStack) -> None:
        handler = requests._HANDLERS[kind]

        def anyway(fw: Any, now_ns: int, m: Any) -> Any:
            return handler(fw, now_ns, m._replace(**{name: getattr(fw, name) for name in names}))

        stack.enter_context(patch.dict(requests._HANDLERS, {kind: anyway}))

    return plant


def _decode_anyway(stuffed: bytes) -> Any:
    text = cobs.unstuff(stuffed)
    if text is None or len(text) < 8:
        return Spoilt("length")
    body = frame._BODIES.get(text[0])
    if body is None:
        return Unknown(0, 0, text[0])
    if body.size != len(text) - 4:
        return Spoilt("length")
    fields = body.unpack_from(text)
    if text[0] in ARRAYS:
        fields = (*fields[: -ARRAYS[text[0]]], fields[-ARRAYS[text[0]] :])
    return MESSAGES[text[0]]._make(fields)


def _any_lease(state: Any, now_ns: int, order: Any) -> Any:
    lease = state.lease.lease if state.lease else order.lease
    return _leased(state, now_ns, replace(order, lease=lease))


def _any_number(state: Any, now_ns: int, order: Any) -> Any:
    if state.lease is not None:
        state = replace(state, lease=replace(state.lease, n=order.n - 1))
    return _leased(state, now_ns, order)


def _any_owner(state: Any, now_ns: int, order: Any) -> Any:
    if state.lease is None:
        return _arm(state, now_ns, order)
    lease = Lease(order.lease, order.owner, state.lease.ts_us, -1, now_ns)
    return replace(state, lease=lease), [
        Emit(Answer(order=order.order, body={"lease": lease.lease}))
    ]


def _no_gaps(*args: Any, **kwargs: Any) -> Any:
    state, _ = _report_missing(*args, **kwargs)
    return state, []


def _half(run: ActiveRun, i: int) -> int:
    return (run.codes[2 * i] | run.codes[2 * i + 1] << 8) // 2 if i >= 0 else 0


def _more_samples(run: ActiveRun) -> int:
    return len(run.codes) // 2 + 40


def _last_again(run: ActiveRun, i: int) -> int:
    i = min(i, len(run.codes) // 2 - 1)
    return run.codes[2 * i] | run.codes[2 * i + 1] << 8 if i >= 0 else 0


def _more_volts(code: int, pwm_bits: int) -> float:
    return _volts(code, pwm_bits) * 1.01


_volts = board.volts


def _never_bites(fw: Any) -> None:
    fw.watchdog_ns = NEVER


def _no_range(fw: Any, m: Any) -> Any:
    return Cause.NONE


def _unlatched(state: Any, now_ns: int, reason: str) -> Any:
    state, done = _trip(state, now_ns, reason)
    return replace(state, phase=Phase.SAFE), done


def _only_said(state: Any, now_ns: int, age_ns: int, *, driving: bool) -> Any:
    return state, []


def _calibrated(state: Any, order: Any) -> Any:
    rules = replace(state.rules, calibration=order.calibration)
    return replace(state, rules=rules), [Emit(Answer(order=order.order))]


def _out_of_fault(state: Any, now_ns: int, order: Any) -> Any:
    if state.phase is Phase.FAULT and state.device is not None and state.asked is None:
        return transitions.begin_arming(replace(state, lease=None), now_ns, order)
    return _arm(state, now_ns, order)


def _out_of_fault_in_the_table(stack: ExitStack) -> None:
    ways = {**phases.TRANSITIONS[On.ARMED], Phase.FAULT: Phase.ARMED}
    stack.enter_context(patch.dict(phases.TRANSITIONS, {On.ARMED: ways}))


def _all_beats(state: Any, now_ns: int, data: bytes, *exchange: Any) -> Any:
    with patch.object(core_requests, "MAX_REMEMBERED_FRAMES", 1 << 20):
        return _send(state, now_ns, data, *exchange)


_send = core_requests.send


def _kept(pending: bytes, data: bytes) -> Any:
    _, received = _feed(b"", pending + data)
    texts = (pending + data).split(b"\0")
    return texts[-1], received


_feed = decoder.feed
_is_newer = requests.is_newer


def _no_retry(state: Any, now_ns: int) -> Any:
    return replace(state, asked=state.asked and state.asked._replace(sent_ns=now_ns)), []


def _said_once(state: Any, now_ns: int, asked: Any, fault: Any) -> Any:
    if state.fault == fault:
        return state, core_requests.refuse(asked.order, fault.cause)
    return _latch(state, now_ns, asked, fault)


_latch = transitions._latch
NO_AGE = _put(Rules, "age_ns", lambda *_, **__: AGES)
NO_RANGE = _all(
    _put(orders, "_out_of_range", lambda *_: []), _put(Rules, "allows", lambda *_: True)
)

DESIGN = 13
"""Number of bugs that the simulator was designed to catch; they are the first ones.

These are: freshness by arrival time, no boot nonce, no CRC; NaN let through, no lease, any owner,
no staleness. Also no firmware timeout, replay accepted, silent gap, wrong scale, no pause
detection, and no firmware clamp.
"""

MUTANTS = (
    Mutant(
        name="freshness by the time of arrival",
        plant=_put(replies, "handle", _fresh_by_arrival),
        breaks=frozenset({"S4"}),
        faults=("delay from_device",),
        first=1003,
    ),
    Mutant(
        name="no boot nonce",
        plant=_as_known(requests.Arm, "boot_id"),
        without=(_as_known(requests.Arm, "nonce"), _as_known(requests.Start, "nonce")),
        breaks=frozenset({"S6"}),
        faults=("played_again",),
        first=1005,
    ),
    Mutant(
        name="no CRC",
        plant=_put(decoder, "decode", _decode_anyway),
        breaks=frozenset({"S1", "S2", "S3", "S4", "S5", "S6", "L2", "crash"}),
        faults=("flip to_device", "flip from_device"),
    ),
    Mutant(
        name="what is no code is let through (NaN, an integer beyond u16)",
        plant=NO_RANGE,
        breaks=frozenset({"A1", "crash"}),
        faults=("out_of_range",),
    ),
    Mutant(
        name="no lease",
        plant=_put(orders, "_leased", _any_lease),
        breaks=frozenset({"A1", "S5"}),
        faults=("forgery",),
    ),
    Mutant(
        name="any owner",
        plant=_put(orders, "_arm", _any_owner),
        breaks=frozenset({"A1", "S5"}),
        faults=("intruder",),
    ),
    Mutant(name="no staleness", plant=NO_AGE, breaks=frozenset({"S4"})),
    Mutant(
        name="no firmware timeout",
        plant=_put(firmware.Firmware, "_set_watchdog", _never_bites),
        breaks=frozenset({"S2", "S3"}),
        faults=("kill",),
    ),
    Mutant(
        name="replay of a frame accepted",
        plant=_put(requests, "is_newer", lambda *_: True),
        breaks=frozenset({"S2", "S3", "S5", "S6"}),
        faults=("replay to_device",),
    ),
    Mutant(
        name="silent gap", plant=_put(gaps, "report_missing", _no_gaps), breaks=frozenset({"L2"})
    ),
    Mutant(
        name="wrong scale in the host",
        plant=_put(ActiveRun, "code", _half),
        breaks=frozenset({"S5"}),
    ),
    Mutant(
        name="no pause detection",
        plant=_put(Rules, "pause_ns", lambda *_, **__: AGES),
        breaks=frozenset({"S4"}),
        without=(NO_AGE,),
        faults=("pause",),
        first=1003,
    ),
    Mutant(
        name="no firmware clamp",
        plant=_put(requests, "_trip", _no_range),
        breaks=frozenset({"S1", "S5"}),
        without=(NO_RANGE,),
        faults=("out_of_range",),
        first=1019,
    ),
    Mutant(
        name="no timeout of the lease",
        plant=_put(Rules, "lease_ns", lambda *_: AGES),
        breaks=frozenset({"S2", "S5"}),
        faults=("hang",),
    ),
    Mutant(
        name="replay of an order accepted",
        plant=_put(orders, "_leased", _any_number),
        breaks=frozenset({"A1", "S5"}),
        faults=("forgery",),
    ),
    Mutant(
        name="wrong scale in the device",
        plant=_put(board, "volts", _more_volts),
        breaks=frozenset({"S1", "S5"}),
    ),
    Mutant(
        name="stale, and no STOP",
        plant=_put(step, "_stale", _only_said),
        breaks=frozenset({"S4"}),
    ),
    Mutant(
        name="a trip that does not latch",
        plant=_all(
            *(
                _put(m, "trip", _unlatched)
                for m in (step, replies, sampling, setpoints, transitions)
            )
        ),
        breaks=frozenset({"S6"}),
    ),
    Mutant(
        name="armed in a fault",
        plant=_put(orders, "_arm", _out_of_fault),
        without=(_out_of_fault_in_the_table,),
        breaks=frozenset({"S6"}),
        faults=("hang", "intruder"),
        first=1028,
    ),
    Mutant(
        name="a calibration taken in a run",
        plant=_put(orders, "_calibrate", _calibrated),
        breaks=frozenset({"A1"}),
        faults=("intruder",),
    ),
    Mutant(
        name="a queue without a bound",
        plant=_all(*(_put(m, "send", _all_beats) for m in (step, core_requests, setpoints))),
        breaks=frozenset({"R1"}),
        faults=("delay from_device", "loss from_device"),
        first=1008,
    ),
    Mutant(
        name="a decoder that keeps all",
        plant=_put(step, "feed", _kept),
        breaks=frozenset({"R1"}),
        faults=("garbage from_device",),
    ),
    Mutant(
        name="a request that is not sent again",
        plant=_put(transitions, "retry", _no_retry),
        breaks=frozenset({"T1", "S2", "S3", "S4", "S6"}),
    ),
    Mutant(
        name="no nonce of an arming",
        plant=_all(_as_known(requests.Arm, "nonce"), _as_known(requests.Start, "nonce")),
        breaks=frozenset({"S6"}),
        faults=("played_again", "old_frames", "unplug"),
    ),
    Mutant(
        name="an echo ahead of what was sent counts",
        plant=_put(sampling, "is_ahead", lambda *_: False),
        breaks=frozenset({"S4"}),
        faults=("old_frames",),
    ),
    Mutant(
        name="a latched device that is known again, and not said to be",
        plant=_put(transitions, "_latch", _said_once),
        breaks=frozenset({"T1"}),
        faults=("delay to_device",),
        first=1006,
    ),
    Mutant(
        name="a run that is over goes on",
        plant=_all(
            _put(ActiveRun, "samples", property(_more_samples)),
            _put(ActiveRun, "code", _last_again),
        ),
        breaks=frozenset({"S5"}),
        faults=("slow_service",),
    ),
)
