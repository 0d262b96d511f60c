"""Orders of the service to the core; an order that is not allowed is refused with a reason."""

from __future__ import annotations

from armrig_core.commands.codes import OutcomeCode, RefusalCode
from armrig_core.rig.volts import volts_of
from armrig_protocol.messages import Capability
from armrig_protocol.messages import State as DeviceState
from msgspec.structs import replace

from armrig_daemon import pipe
from armrig_daemon.decisions import outcomes
from armrig_daemon.decisions.budget import check, min_exchange_us
from armrig_daemon.decisions.faults import name_of, sentence
from armrig_daemon.decisions.outcomes import NO_DEVICE, Step, Then, answer, refuse
from armrig_daemon.decisions.output_limits import blind, outside, too_slow
from armrig_daemon.decisions.state import (
    Action,
    DecisionState,
    Lease,
    PendingRequest,
    Phase,
    RequestKind,
)

NOT_HELD = "not the lease in force: arm first"
"""Refusal of a command from a client that does not hold the rig."""
BY_HAND = "the motor is driven by hand: disarm first"
_AT_REST = (DeviceState.IDLE, DeviceState.READY)


def handle(state: DecisionState, now_ns: int, order: pipe.Order) -> Step:
    """Carry out an order, or refuse it."""
    state = replace(state, service_ns=now_ns)
    match order:
        case pipe.Alive():
            return _alive(state, now_ns, order), []
        case pipe.Stop():
            return _stop(state, order)
        case pipe.Quit():
            return quit_(state)
        case pipe.Reset():
            return _reset(state, order)
        case pipe.Calibrate():
            return _calibrate(state, order)
        case pipe.Arm():
            return _arm(state, now_ns, order)
        case pipe.Leased():
            return _handle_leased(state, now_ns, order)
    return state, refuse(order, "not an order that this daemon knows")


def not_newer(n: int, last: int) -> str:
    """Return the refusal of a command whose number does not exceed the last number."""
    return f"n={n} must be greater than the last, {last}"


def holder_sentence(owner: str) -> str:
    """Return the refusal of an arming while an owner holds the rig."""
    return f"{owner} has the rig: wait until it is free, or end it with `armrig stop`"


def quit_(state: DecisionState) -> Step:
    """Stop the motor and exit; if a device answers, exit only after it has confirmed the stop."""
    if state.quitting:
        return state, []
    state = replace(state, quitting=True)
    if state.link is None or state.device is None:
        return state, [outcomes.EndRun(), Then.LEAVE]
    return state, [outcomes.Halt("the daemon was ended", code=OutcomeCode.DAEMON_ENDED)]


def _alive(state: DecisionState, now_ns: int, order: pipe.Alive) -> DecisionState:
    lease = state.lease
    if lease is None or state.phase is not Phase.ARMED or order.lease != lease.lease:
        return state
    return replace(state, lease=replace(lease, renewed_ns=now_ns))


def _stop(state: DecisionState, order: pipe.Stop) -> Step:
    may_turn = state.phase in (Phase.ARMED, Phase.ACTIVE) or state.asked is not None
    if state.device is None or state.phase is Phase.FAULT or not may_turn:
        return state, answer(order, {"done": True})  # at 0 V, or out of reach
    return state, [outcomes.Halt(order.reason, order, order.outcome_code)]


def _reset(state: DecisionState, order: pipe.Reset) -> Step:
    if state.phase is not Phase.FAULT:
        return state, answer(order, {"done": False})  # nothing is latched
    if state.device is None:
        return state, refuse(order, NO_DEVICE, RefusalCode.NO_DEVICE)
    if state.asked is not None:
        return state, _refuse_as_busy(order, state.asked)
    latched = state.device_state in (DeviceState.FAULT, DeviceState.ESTOP)
    return state, [outcomes.Ask(RequestKind.CLEAR if latched else RequestKind.HELLO, order)]


def _calibrate(state: DecisionState, order: pipe.Calibrate) -> Step:
    """Replace the calibration, at rest only; it converts samples, and changes no frame or limit."""
    if state.phase is Phase.FAULT:
        return state, _refuse_in_fault(order, state)
    if state.lease is not None:
        return state, _refuse_as_held(order, state.lease)
    if state.phase is Phase.INIT:
        return state, refuse(order, NO_DEVICE, RefusalCode.NO_DEVICE)
    if state.phase is not Phase.SAFE or state.asked is not None:
        text = "the rig is not at rest yet: try again"
        return state, refuse(order, text, RefusalCode.NOT_AT_REST)
    rules = replace(state.rules, calibration=order.calibration)
    return replace(state, rules=rules), answer(order, {"done": True})


def _arm(state: DecisionState, now_ns: int, order: pipe.Arm) -> Step:
    if state.quitting:
        return state, refuse(order, "the daemon is ending", RefusalCode.ENDING)
    if state.phase is Phase.FAULT:
        return state, _refuse_in_fault(order, state)
    if state.lease is not None:
        return state, _refuse_as_held(order, state.lease)
    link = state.link
    if state.phase is not Phase.SAFE or state.device is None or link is None:
        return state, refuse(order, NO_DEVICE, RefusalCode.NO_DEVICE)
    if state.asked is not None:
        return state, _refuse_as_busy(order, state.asked)
    age_ns, limit_ns = now_ns - link.last_round_trip_ns, state.rules.age_ns(state.ts_us)
    if age_ns > limit_ns:
        text = f"no answer from the device for {age_ns / 1e6:.0f} ms: try again"
        return state, refuse(order, text, RefusalCode.STALE, age_ms=age_ns / 1e6)
    if not state.sampled_ns or now_ns - state.sampled_ns > limit_ns:
        text = f"no sample of the device in the last {limit_ns / 1e6:.0f} ms: try again"
        return state, refuse(order, text, RefusalCode.STALE, limit_ms=limit_ns / 1e6)
    if limits := state.rules.limits:
        fault = outside(limits, state.watch) or blind(limits, state.watch, now_ns, state.ts_us)
        if fault is not None:
            text = sentence(fault, is_emulated=state.is_emulated)
            return state, refuse(order, text, RefusalCode.READINGS, output=fault.output)
    if link.device_state not in _AT_REST:
        # HELLO requests the device's state, after which the device is brought to rest.
        name = name_of(DeviceState, link.device_state)
        error = f"the device is in {name}, not at rest: try again"
        refusal = refuse(order, error, RefusalCode.NOT_AT_REST)
        return state, [*refusal, outcomes.Ask(RequestKind.HELLO)]
    return begin_arming(state, order)


def begin_arming(state: DecisionState, order: pipe.Arm) -> Step:
    """Configure the device for the owner's sampling time, then arm it."""
    device = state.device
    ts_us = order.ts_us or state.rules.ts_us
    if device is None:
        return state, refuse(order, NO_DEVICE, RefusalCode.NO_DEVICE)
    scheduled = bool(device.capabilities & Capability.SCHEDULED)
    baud, m = state.rules.baud, state.rules.oversampling
    try:
        check(ts_us, baud, device.skew_us, scheduled=scheduled, oversampling=m)
    except ValueError as err:
        return state, refuse(order, str(err))
    if state.rules.limits and (error := too_slow(state.rules.limits, ts_us)):
        return state, refuse(order, error)
    least_us = device.ts_min_us + 2 * (m - 1) * device.skew_us
    if ts_us < least_us:
        error = f"Ts={ts_us / 1e6:g} s is too short for the device: at least"
        return state, refuse(order, f"{error} {least_us / 1e6:g} s")
    # Until a run begins, the host paces the samples: at this Ts if the line is fast enough for it,
    # otherwise at the default Ts.
    fits = ts_us >= min_exchange_us(baud, device.skew_us, m)
    paced_us = ts_us if fits else state.rules.ts_us
    return state, [outcomes.Ask(RequestKind.CONFIGURE, order, paced_us)]


def _handle_leased(state: DecisionState, now_ns: int, order: pipe.Leased) -> Step:
    lease = state.lease
    held = lease is not None and state.phase in (Phase.ARMED, Phase.ACTIVE)
    if lease is None or not held or order.lease != lease.lease:
        return state, refuse(order, NOT_HELD, RefusalCode.NOT_HELD)
    if order.n <= lease.n:
        text = not_newer(order.n, lease.n)
        return state, refuse(order, text, RefusalCode.NOT_NEWER, n=order.n, last=lease.n)
    if state.asked is not None and not isinstance(order, pipe.Disarm):
        return state, _refuse_as_busy(order, state.asked)
    refusal = _refusal(state, order)
    if refusal:
        return state, refusal
    state = replace(state, lease=replace(lease, n=order.n, renewed_ns=now_ns))
    if isinstance(order, pipe.Disarm):
        return state, [outcomes.Halt("disarmed", order, OutcomeCode.DISARMED)]
    if isinstance(order, pipe.Set) and state.phase is Phase.ACTIVE:
        return replace(state, code=order.code), answer(order, {"done": True})
    if isinstance(order, pipe.SetReference) and state.run is not None and state.run.control:
        law = state.run.control.with_reference(order.r, order.n, first=state.run.due)
        state = replace(state, run=replace(state.run, control=law))
        return state, answer(order, {"done": True})
    if isinstance(order, pipe.Run) and order.scheduled:
        # First a stop: a device accepts another mode in IDLE and READY only.
        return state, [outcomes.Ask(RequestKind.STOP, order)]
    return state, [outcomes.Ask(RequestKind.START, order)]


def _refuse_as_busy(order: pipe.Order, asked: PendingRequest) -> list[Action]:
    text = f"busy with {asked.want}: try again"
    return refuse(order, text, RefusalCode.BUSY, want=asked.want)


def _refuse_as_held(order: pipe.Order, lease: Lease) -> list[Action]:
    return refuse(order, holder_sentence(lease.owner), RefusalCode.HELD, owner=lease.owner)


def _refuse_in_fault(order: pipe.Order, state: DecisionState) -> list[Action]:
    text = f"in fault ({state.reason}): correct the cause, then reset"
    fault = state.fault.id if state.fault else ""
    return refuse(order, text, RefusalCode.IN_FAULT, fault=fault, reason=state.reason)


def _refusal(state: DecisionState, order: pipe.Leased) -> list[Action]:
    """Return the refusal of an order of the lease's holder; [] for an allowed order."""
    match order:
        case pipe.Set():
            if state.run is not None and not state.run.own:
                text = f"the experiment {state.run.run_id} is running: stop it first"
                return refuse(order, text, RefusalCode.RUNNING)
            if state.lease is not None and state.ts_us != state.lease.ts_us:
                return _refuse_as_too_short(state, order)
            return _out_of_range(state, order)
        case pipe.SetReference():
            return _refuse_reference(state, order)
        case pipe.Run():
            if state.phase is not Phase.ARMED:
                return refuse(order, BY_HAND, RefusalCode.BY_HAND)
            if state.run is not None:
                text = f"the experiment {state.run.run_id} is about to start: stop it first"
                return refuse(order, text, RefusalCode.RUNNING)
            if refusal := _cannot_pace(state, order):
                return refusal
            # Each code is checked when it is sent, because the check of a million codes would delay
            # the tick.
            if order.law or order.reference:
                return _refuse_control(state, order)
            return [] if order.codes else refuse(order, "the experiment is empty")
    return []


def _refuse_reference(state: DecisionState, order: pipe.SetReference) -> list[Action]:
    """Return the refusal of a reference that was not rehearsed; [] for an allowed reference."""
    if state.run is None or not state.run.control:
        text = "no law controls the rig: begin a run in control, then change its reference"
        return refuse(order, text, RefusalCode.NOT_ALLOWED)
    low, high = state.run.control.r_range
    if not low <= order.r <= high:  # NaN fails this, too
        text = f"r = {order.r:g} was not rehearsed: this run allows {low:g} to {high:g}"
        return refuse(order, text, RefusalCode.NOT_ALLOWED)
    return []


def _refuse_control(state: DecisionState, order: pipe.Run) -> list[Action]:
    """Return the refusal of a run in control; [] for an allowed run."""
    rules, ts_us, law = state.rules, state.ts_us, order.law
    if order.scheduled:
        text = "a control law runs in exchange mode: request exchange mode"
        return refuse(order, text, RefusalCode.CANNOT_PACE)
    if law and law.Ts_us != ts_us:
        text = f"the law has Ts={law.Ts_us / 1e6:g} s, and the rig {ts_us / 1e6:g} s"
        return refuse(order, text)
    lowest, rest_code, highest = rules.code_min, rules.rest_code, rules.code_max
    if law and not lowest <= law.lo_code <= rest_code <= law.hi_code <= highest:
        codes = law.lo_code, law.hi_code, lowest, highest
        low, high, least, most = (f"{volts_of(code):.4g}" for code in codes)
        text = f"the law has {low} … {high} V; allowed are {least} … {most} V, with {rules.rest}"
        return refuse(order, text)
    if not order.reference or len(order.reference) % 8:
        n = len(order.reference or b"")
        return refuse(order, f"the reference has {n} bytes; 8 for each sample are needed")
    return []


def _cannot_pace(state: DecisionState, order: pipe.Run) -> list[Action]:
    """Return the refusal of a run that the device cannot pace; [] for any other run."""
    if order.scheduled:
        if state.device is not None and state.device.capabilities & Capability.SCHEDULED:
            return []
        text = "this device has no scheduled mode: request exchange mode"
        return refuse(order, text, RefusalCode.CANNOT_PACE)
    if state.lease is not None and state.ts_us != state.lease.ts_us:
        return _refuse_as_too_short(state, order)
    return []


def _refuse_as_too_short(state: DecisionState, order: pipe.Order) -> list[Action]:
    ts_s = state.lease.ts_us / 1e6 if state.lease else 0
    text = (
        f"Ts={ts_s:g} s cannot be carried in exchange mode: run scheduled, or arm with a longer Ts"
    )
    return refuse(order, text, RefusalCode.CANNOT_PACE)


def _out_of_range(state: DecisionState, order: pipe.Set) -> list[Action]:
    """Return the refusal of a voltage outside the limits; [] for an allowed voltage."""
    rules, before, code = state.rules, state.code, order.code
    if state.run is not None and state.run.own:
        before = state.run.own.code  # of several voltages before a tick, the last one acts
    low, high = volts_of(rules.code_min), volts_of(rules.code_max)
    if not rules.code_min <= code <= rules.code_max:
        return refuse(order, f"u={volts_of(code):.4g} V is outside {low:.4g} … {high:.4g} V")
    if not rules.allows(before, code):
        step, most = volts_of(abs(code - before)), volts_of(rules.slew)
        return refuse(order, f"u steps by {step:.4g} V: at most {most:.4g} V in a sample")
    return []
