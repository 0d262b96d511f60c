"""Bugs planted in core, codec or device: one or more for each invariant of the simulator."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from math import inf, isfinite, nan
from typing import Any
from unittest.mock import patch

from armrig_core.control import evaluation, monitor
from armrig_core.rig.channels import Conversion
from armrig_daemon.decisions import (
    control,
    gaps,
    orders,
    output_limits,
    own_control,
    step,
    stopping,
    transitions,
)
from armrig_daemon.decisions import requests as core_requests
from armrig_daemon.decisions.state import ActiveRun, Phase, Rules, RunLaw
from armrig_daemon.emulator import board, firmware, requests
from armrig_daemon.emulator.firmware import NEVER
from armrig_protocol import cobs, decoder, frame
from armrig_protocol.frame import Spoilt, Unknown
from armrig_protocol.messages import ARRAYS, MESSAGES
from msgspec import UNSET
from msgspec.structs import replace

from tests.simulator.options import KINDS


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """A bug, and the invariants that it breaks."""

    name: str
    puts: tuple[tuple[Any, str, Any], ...]
    """Owner, name and new value of each attribute that is replaced."""
    breaks: frozenset[str]
    faults: tuple[str, ...] = KINDS
    """Faults to draw from: those that show the bug soon."""


@contextmanager
def planted(mutant: Mutant) -> Iterator[None]:
    """Let the bug be in for a while."""
    with ExitStack() as stack:
        for owner, name, value in mutant.puts:
            stack.enter_context(patch.object(owner, name, value))
        yield


_leased, _report_missing, _carry_out = orders._handle_leased, gaps.report_missing, step.carry_out
_volts, _feed = board.volts, decoder.feed
_config, _decide = Rules.config, step._decide
_observe, _watched, _reset = output_limits.observe, output_limits._next_watch, orders._reset
_law_decide, _law_observe, _law_outputs = evaluation.decide, evaluation.observe, evaluation._outputs
_begin_control, _control_decide = transitions._begin_control, control.decide
_with_reference = RunLaw.with_reference
_own_decide = own_control.decide
_advance = evaluation._advance
_alarm, _monitor_advance = monitor.alarm, monitor.advance


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


def _no_gaps(*args: Any, **kwargs: Any) -> Any:
    state, _ = _report_missing(*args, **kwargs)
    return state, []


def _more_volts(code: int, pwm_bits: int) -> float:
    return _volts(code, pwm_bits) * 1.01


def _never_bites(fw: Any) -> None:
    fw.watchdog_ns = NEVER


def _unlatched(now_ns: int, decided: Any) -> Any:
    state, done = _carry_out(now_ns, decided)
    return (replace(state, phase=Phase.SAFE) if state.phase is Phase.FAULT else state), done


def _kept(pending: bytes, data: bytes) -> Any:
    _, received = _feed(b"", pending + data)
    return (pending + data).split(b"\0")[-1], received


def _no_retry(state: Any, now_ns: int) -> Any:
    return replace(state, asked=state.asked and state.asked._replace(sent_ns=now_ns)), []


def _wrong_channel(state: Any, limits: Any, sample: Any) -> Any:
    flipped = sample._replace(value_0=sample.value_1, value_1=sample.value_0)
    return _observe(state, limits, flipped)


def _strict(before: Any, limit: Any, sample: Any) -> Any:
    at_limit = (sample.value_0, sample.value_1)[limit.channel] in (limit.low, limit.high)
    high = -inf if at_limit else limit.high
    return _watched(before, replace(limit, high=high), sample)


def _seen_anyway(before: Any, limit: Any, sample: Any) -> Any:
    return replace(_watched(before, limit, sample), valid_ns=sample.t_host_ns)


def _other_end(before: Any, limit: Any, sample: Any) -> Any:
    return _watched(before, replace(limit, sides_of_rails=limit.sides_of_rails[::-1]), sample)


def _rests_at_0(self: Rules, *args: Any, **kwargs: Any) -> Any:
    return _config(self, *args, **kwargs)._replace(u_rest=0)


def _0_without_a_command(state: Any, now_ns: int, k: int) -> Any:
    state, code, done = _decide(state, now_ns, k)
    return state, 0 if code == state.rules.rest_code else code, done


def _0_after(decided: Any) -> Any:
    def after(*args: Any) -> Any:
        state, done = decided(*args)
        return replace(state, code=0), done

    return after


def _0_before(self: ActiveRun, i: int, rest_code: int) -> int:
    return self.code(i - 1) if i else 0


def _forgotten(state: Any, order: Any) -> Any:
    return _reset(replace(state, watch=UNSET), order)


def _in_counts(self: Conversion, counts: float) -> float:
    return counts - self.zero_counts


def _swapped(self: Rules) -> Any:
    return (self.described or self.calibration.channels)[::-1]


class _Unscheduled:
    """The module of the limits, which a scheduled run does not ask."""

    blind = staticmethod(output_limits.blind)

    @staticmethod
    def observe(state: Any, limits: Any, sample: Any) -> Any:
        """Observe in exchange mode only."""
        return (state, []) if state.scheduled else _observe(state, limits, sample)


def _no_law_limit(law: Any, *args: Any) -> Any:
    return _law_decide(replace(law, lo_code=0, hi_code=65_535), *args)


def _v_of_the_last_tick() -> Any:
    last: dict[str, Any] = {}

    def decide(law: Any, state: Any, *args: Any) -> Any:
        after, command = _law_decide(law, state, *args)
        late = last.get(law.law_sha256, command)
        last[law.law_sha256] = command
        return replace(after, codes=(*after.codes[:-1], late.code)), late

    return decide


def _no_turns(law: Any, state: Any, values: Any) -> Any:
    y, zeros, is_blind = _law_outputs(law, state, values)
    read = [values[c] if values else nan for c in law.channels]
    turned = [a if zero is None else a - zero for a, zero in zip(read, zeros, strict=True)]
    picked = zip(y, turned, law.turning, strict=True)
    return tuple(t if turns and isfinite(t) else a for a, t, turns in picked), zeros, is_blind


def _missing_as_0(law: Any, state: Any, values: Any) -> Any:
    y, zeros, is_blind = _law_outputs(law, state, values)
    return (0.0,) * len(y) if values is None else y, zeros, is_blind


def _v_fed_back(law: Any, *args: Any) -> Any:
    after, command = _law_decide(law, *args)
    v = round(min(max(command.v, -5.0), 10.0) * 13_107)
    return replace(after, codes=(*after.codes[:-1], v)), command


def _twice(law: Any, state: Any, k: int, *args: Any) -> Any:
    return _law_observe(law, replace(state, x=_law_observe(law, state, k, *args).x), k, *args)


def _begin_at_rest_0(*args: Any) -> Any:
    begun = _begin_control(*args)
    return replace(begun, latch=replace(begun.latch, rest_code=0)) if begun else begun


def _law_of_another_run() -> Any:
    first: list[Any] = []

    def begin(*args: Any) -> Any:
        begun = _begin_control(*args)
        if not begun:
            return begun
        first.append(begun.law)
        return replace(begun, law=first[0], state=evaluation.begin(first[0]))

    return begin


def _no_delay(law: Any, *args: Any) -> Any:
    return _advance(replace(law, input_delay=0), *args)


def _slew_of_the_newest(law: Any, state: Any, k: int, reference: Any, latch: Any) -> Any:
    most = min(law.slew or latch.slew, latch.slew or law.slew)
    free, rig = replace(law, slew=0), replace(latch, slew=0)
    after, command = _law_decide(free, state, k, reference, rig)
    if not most or not isfinite(command.v):
        return after, command
    *before, code = after.codes
    newest = before[-1] if before else latch.rest_code
    within = min(max(code, newest - most), newest + most)
    command = command._replace(code=within, is_slewed=within != code)
    return replace(after, codes=(*before, within)), command


def _as_commanded(law: Any, state: Any, values: Any, r: float, latch: Any) -> Any:
    return _advance(law, state, values, r, replace(latch, pwm_bits=16))


def _with_monitor(law: Any, **fields: Any) -> Any:
    """Return a law with another monitor; a law without a monitor stays as it is."""
    return replace(law, monitor=replace(law.monitor, **fields)) if law.monitor else law


def _gate_of_the_other_output(watched: Any, state: Any) -> Any:
    swapped = replace(state, unlike=state.unlike[::-1], astray=state.astray[::-1])
    return _alarm(watched, swapped)


def _no_gate(name: str) -> Any:
    def advance(*args: Any) -> Any:
        after = _monitor_advance(*args)
        return replace(after, **{name: (0,) * len(after.zeros)})

    return advance


def _missing_clears(watched: Any, state: Any, y: Any, valid: Any, u_v: float) -> Any:
    after = _monitor_advance(watched, state, y, valid, u_v)
    unlike = tuple(n if is_valid else 0 for n, is_valid in zip(after.unlike, valid, strict=True))
    return replace(after, unlike=unlike)


def _no_zero(watched: Any, state: Any, *args: Any) -> Any:
    zeros = tuple(0.0 for _ in state.zeros)
    return _monitor_advance(watched, replace(state, zeros=zeros), *args)


def _skipped_prelude(law: Any, *args: Any) -> Any:
    return _law_decide(_with_monitor(law, prelude=0), *args)


def _free_prelude(law: Any, state: Any, k: int, *args: Any) -> Any:
    """Leave the limits and the slew out during the prelude."""
    is_prelude = law.monitor and k < law.monitor.prelude
    free = replace(law, lo_code=0, hi_code=65_535, slew=0) if is_prelude else law
    return _law_decide(free, state, k, *args)


def _delay_of_the_law(law: Any, *args: Any) -> Any:
    return _advance(_with_monitor(law, input_delay=law.input_delay), *args)


def _astray_in_the_prelude(law: Any, *args: Any) -> Any:
    return _advance(_with_monitor(law, prelude=0), *args)


def _no_end(*_: Any) -> Any:
    return []


def _reference_of_the_past(law: Any, r: float, n: int, first: int) -> Any:
    """Replace also the reference of samples that are decided and have not arrived."""
    return _with_reference(law, r, n, min(first, law.state.k))


def _code_of_the_last_tick(state: Any, now_ns: int, n: int, run: Any, own: Any, i: int) -> Any:
    after, code, done = _own_decide(state, now_ns, n, run, own, i)
    return after, own.code if code != state.rules.rest_code else code, done


def _one_more(*args: Any) -> Any:
    state, code, done = _control_decide(*args)
    return state, code + 1, done


def _law(
    name: str,
    *puts: tuple[Any, str, Any],
    also: str = "S5",
    faults: tuple[str, ...] = KINDS,
) -> Mutant:
    """Return a bug of the evaluation of control laws."""
    breaks = frozenset({"S5", also})
    return Mutant(name=f"law: {name}", puts=puts, breaks=breaks, faults=faults)


def _rule(name: str, *puts: tuple[Any, str, Any]) -> Mutant:
    """Return a bug of the limits on measured outputs."""
    return Mutant(name=name, puts=puts, breaks=frozenset({"O1", "O2"}))


def _rest(where: str, *puts: tuple[Any, str, Any]) -> Mutant:
    """Return the bug that 0 V is the rest of each rig."""
    broken = frozenset({"S2", "S5", "S6", "A1"})
    return Mutant(name=f"0 V as the rest in {where}", puts=puts, breaks=broken)


MUTANTS = (
    Mutant(
        name="own controller: its code after its lease",
        puts=((own_control, "has_run_out", lambda *_: False),),
        breaks=frozenset({"S2", "S5"}),
    ),
    Mutant(
        name="own controller: the code before the newest",
        puts=((own_control, "decide", _code_of_the_last_tick),),
        breaks=frozenset({"S5"}),
    ),
    _law("no limit", (evaluation, "decide", _no_law_limit)),
    _law("v of the last tick", (evaluation, "decide", _v_of_the_last_tick())),
    _law("a jump at the wrap", (evaluation, "_outputs", _no_turns)),
    _law("missing as 0", (evaluation, "_outputs", _missing_as_0)),
    _law("v fed back for u", (evaluation, "decide", _v_fed_back), also="crash"),
    _law("x advanced twice", (evaluation, "observe", _twice)),
    _law("rest forgotten", (transitions, "_begin_control", _begin_at_rest_0)),
    _law("the law of another run", (transitions, "_begin_control", _law_of_another_run())),
    _law("no dead time", (evaluation, "_advance", _no_delay)),
    _law("the slew of the newest code only", (evaluation, "decide", _slew_of_the_newest)),
    _law("u as commanded, not as latched", (evaluation, "_advance", _as_commanded)),
    _law("no end by a bound", (control, "_consequences", _no_end)),
    _law("a code that the record does not have", (control, "decide", _one_more)),
    _law("the monitor off", (monitor, "alarm", lambda *_: None)),
    _law("a reference that was not rehearsed", (orders, "_refuse_reference", _no_end), also="A1"),
    _law("a reference of the past", (RunLaw, "with_reference", _reference_of_the_past)),
    _law("one lost output is not seen", (monitor, "find_lost_output", lambda *_: "")),
    _law("the gate of the other output", (monitor, "alarm", _gate_of_the_other_output)),
    _law("no innovation gate", (monitor, "advance", _no_gate("unlike"))),
    _law("no simulation gate", (monitor, "advance", _no_gate("astray"))),
    _law("a gate after 6 samples in a row", (monitor, "IN_A_ROW", 6)),
    _law("the whole range is allowed", (monitor, "RANGE_SHARE", 1.0)),
    _law(
        *("a missing output clears the count of a gate", (monitor, "advance", _missing_clears)),
        faults=("loss from_device", "flip from_device", "rail"),
    ),
    _law("the monitor's zero at 0", (monitor, "advance", _no_zero)),
    _law("the law's dead time in the monitor", (evaluation, "_advance", _delay_of_the_law)),
    _law("the prelude skipped", (evaluation, "decide", _skipped_prelude)),
    _law("a prelude outside the limits", (evaluation, "decide", _free_prelude)),
    _law("the control error of the prelude", (evaluation, "_advance", _astray_in_the_prelude)),
    _rule("a limit of the wrong channel", (output_limits, "observe", _wrong_channel)),
    _rule("a limit that is outside", (output_limits, "_next_watch", _strict)),
    _rule(
        "a blind time restarted by an invalid sample", (output_limits, "_next_watch", _seen_anyway)
    ),
    _rule("the wrong end of a range", (output_limits, "_next_watch", _other_end)),
    _rule("no blind time", (output_limits, "blind", lambda *_: None)),
    _rest("CONFIG", (Rules, "config", _rests_at_0)),
    _rest("a tick without a command", (step, "_decide", _0_without_a_command)),
    _rest("a stop", (stopping, "stop", _0_after(stopping.stop))),
    _rest("a trip", (stopping, "trip", _0_after(stopping.trip))),
    _rest("the first step of a run", (ActiveRun, "code_before", _0_before)),
    _rule("limits forgotten at a reset", (orders, "_reset", _forgotten)),
    _rule("limits in counts", (Conversion, "value", _in_counts)),
    _rule("channels in the wrong order", (Rules, "conversions", property(_swapped))),
    _rule("no limit while a run is scheduled", (step, "output_limits", _Unscheduled)),
    Mutant(
        name="no CRC",
        puts=((decoder, "decode", _decode_anyway),),
        breaks=frozenset({"S1", "S2", "S3", "S4", "S5", "S6", "L2", "crash"}),
        faults=("flip to_device", "flip from_device"),
    ),
    Mutant(
        name="no lease",
        puts=((orders, "_handle_leased", _any_lease),),
        breaks=frozenset({"A1", "S5"}),
        faults=("forgery",),
    ),
    Mutant(
        name="no staleness",
        puts=((Rules, "age_ns", lambda *_, **__: 1 << 60),),
        breaks=frozenset({"S4"}),
    ),
    Mutant(
        name="no timeout of the lease",
        puts=((Rules, "lease_ns", lambda *_: 1 << 60),),
        breaks=frozenset({"S2", "S5"}),
        faults=("hang",),
    ),
    Mutant(
        name="no firmware timeout",
        puts=((firmware.Firmware, "_set_watchdog", _never_bites),),
        breaks=frozenset({"S2", "S3"}),
        faults=("kill",),
    ),
    Mutant(
        name="replay of a frame accepted",
        puts=((requests, "is_newer", lambda *_: True),),
        breaks=frozenset({"S2", "S3", "S5", "S6"}),
        faults=("replay to_device",),
    ),
    Mutant(
        name="silent gap",
        puts=((gaps, "report_missing", _no_gaps),),
        breaks=frozenset({"L2"}),
    ),
    Mutant(
        name="wrong scale in the device",
        puts=((board, "volts", _more_volts),),
        breaks=frozenset({"S1", "S5"}),
    ),
    Mutant(
        name="a trip that does not latch",
        puts=((step, "carry_out", _unlatched),),
        breaks=frozenset({"S6"}),
    ),
    Mutant(
        name="a decoder that keeps all",
        puts=((step, "feed", _kept),),
        breaks=frozenset({"R1"}),
        faults=("garbage from_device",),
    ),
    Mutant(
        name="a request that is not sent again",
        puts=((core_requests, "retry", _no_retry),),
        breaks=frozenset({"T1", "S2", "S3", "S4", "S6"}),
    ),
)
