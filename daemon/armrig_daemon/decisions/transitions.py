"""Transitions by requests: what follows the effect of a request, its refusal or its failure.

`request_table.py` has them by request; their first lines are its text.
"""

from __future__ import annotations

from armrig_core.commands.codes import RefusalCode
from armrig_core.control.evaluation import Latch, begin
from armrig_core.rig.emulated import EMULATOR_UID
from armrig_core.rig.volts import volts_of
from armrig_protocol import messages as wire
from armrig_protocol.frame import config_crc
from armrig_protocol.messages import FULL_SCALE_MV, SCHEMA_HASH, VERSION, Capability, Code
from armrig_protocol.messages import State as DeviceState
from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from armrig_daemon.decisions import outcomes
from armrig_daemon.decisions.faults import OF_DEVICE, Fault, Id, name_of, of_device, sentence
from armrig_daemon.decisions.outcomes import Step, Then, answer, log, refuse
from armrig_daemon.decisions.phases import On, change_phase
from armrig_daemon.decisions.state import (
    Action,
    ActiveRun,
    ClockComparison,
    Configuration,
    DecisionState,
    Emit,
    Lease,
    OwnControl,
    PendingRequest,
    Phase,
    RequestKind,
    Rules,
    RunLaw,
    SetPeriod,
)
from armrig_daemon.pipe import Arm, Disarm, Order, Reset, Run, RunStarted, Set, Stop

MAX_TRIES = 5
CARE_PERIOD_US = 10_000
"""Period of the loop's ticks during a scheduled run, in µs."""
EXPECTED_STATES = {Phase.ARMED: DeviceState.ARMED, Phase.ACTIVE: DeviceState.RUN}
DRIVING_STATES = (DeviceState.ARMED, DeviceState.RUN)
LATCHED_STATES = (DeviceState.FAULT, DeviceState.ESTOP)
_KNOWN = (DeviceState.IDLE, DeviceState.READY, *DRIVING_STATES, *LATCHED_STATES)


def reconnect(state: DecisionState, now_ns: int, error: str) -> Step:
    """Latch a fault if the motor may turn; otherwise send HELLO."""
    if state.phase in EXPECTED_STATES:
        return state, [outcomes.Trip(Fault(Id.REQUEST, error))]
    return state, [log(now_ns, "warning", error), outcomes.Ask(RequestKind.HELLO)]


def leave_to_watchdog(state: DecisionState, now_ns: int, error: str) -> Step:
    """Latch a fault; only the device's watchdog can stop the motor now."""
    end = outcomes.EndRun()
    if state.quitting:
        return state, [end, Then.LEAVE]
    if state.phase is Phase.FAULT:
        return state, [end, log(now_ns, "error", error), Then.REPORT]
    # The run is over: its outcome must not be the outcome of a later run.
    return state, [end, outcomes.Trip(Fault(Id.REQUEST, error)), Then.FORGET]


def handle_armed(state: DecisionState, now_ns: int, asked: PendingRequest) -> Step:
    """Give the lease to the owner, or fill the queue of a scheduled run."""
    order = asked.order
    if isinstance(order, Run):
        return state, [outcomes.Fill(order)]
    if not isinstance(order, Arm):
        return state, [outcomes.Trip(Fault(Id.INTERNAL, "armed without an owner"))]
    rules = state.rules
    ts_us = order.ts_us or rules.ts_us
    lease = Lease(order.lease, order.owner, ts_us, -1, now_ns, order.owner_checked)
    state = change_phase(state, On.ARMED, fault=None, lease=lease)
    granted = {
        "lease": order.lease,
        "period_s": rules.lease_ns(ts_us) / 1e9,
        "Ts": ts_us / 1e6,
        "u_min": round(volts_of(rules.code_min), 4),
        "u_max": round(volts_of(rules.code_max), 4),
    }
    if rules.rest_code:
        granted["rest_v"] = round(volts_of(rules.rest_code), 4)
    return state, [Then.REPORT, *answer(order, granted)]


def handle_started(state: DecisionState, now_ns: int, asked: PendingRequest) -> Step:
    """Begin the run, or apply the voltage that a client holds."""
    order = asked.order
    if state.lease is None or not isinstance(order, Run | Set):
        return state, [outcomes.Trip(Fault(Id.INTERNAL, "started without an owner"))]
    # The command has renewed the lease; the later effect of START does not renew it.
    state = change_phase(state.linked(beats=()), On.STARTED, outcome="", outcome_code=None)
    state = replace(state, code=state.rules.rest_code)
    done = [Then.REPORT, *answer(order, {"done": True})]
    if isinstance(order, Set):
        return replace(state, code=order.code), done
    if state.run is None or state.queue is None:
        control = _begin_control(state, order)
        u_own = order.reference and not control and OwnControl(order.reference, state.code, order.n)
        run = ActiveRun(order.run_id, order.codes, -1, control=control, own=u_own or UNSET)
        return replace(state, run=run), done
    # The device takes its first sample one Ts after it received START.
    heard_ns = (asked.sent_ns + now_ns) // 2
    run = replace(state.run, k_first=state.k + 1, t_zero_ns=heard_ns + state.ts_us * 1000)
    started = RunStarted(
        run_id=run.run_id, k_first=run.k_first, count=run.samples, t_host_ns=now_ns
    )
    queue = replace(state.queue, order=None)
    return replace(state, run=run, queue=queue), [*done, Emit(started)]


def _begin_control(state: DecisionState, order: Run) -> RunLaw | UnsetType:
    """Return the law of a run before its first sample; unset for a run of codes."""
    law, rules = order.law, state.rules
    if not law or not order.reference:
        return UNSET
    bits = state.device.pwm_bits if state.device else 16
    latch = Latch(rules.rest_code, bits, rules.code_min, rules.code_max, rules.slew)
    return RunLaw(law, latch, order.reference, begin(law), order.r_range)


def handle_stopped(state: DecisionState, now_ns: int, asked: PendingRequest) -> Step:
    """End the run and the lease, then send CONFIG; a run in scheduled mode goes on."""
    if isinstance(asked.order, Run):
        # The device was stopped only to change to scheduled mode: CONFIG and ARM follow.
        ts_us = state.lease.ts_us if state.lease else state.rules.ts_us
        return state, [outcomes.Ask(RequestKind.CONFIGURE, asked.order, ts_us, scheduled=True)]
    return rest(state, asked.order, outcomes.EndRun())


def handle_cleared(state: DecisionState, now_ns: int, asked: PendingRequest) -> Step:
    """Send HELLO with the same order."""
    return state, [outcomes.Ask(RequestKind.HELLO, asked.order)]


def rest(state: DecisionState, order: Order | None, end: outcomes.EndRun) -> Step:
    """Continue at 0 V without a lease, once the device has stopped."""
    if state.quitting:
        return state, [end, Then.LEAVE]
    state = replace(state, lease=None)
    if state.phase is Phase.FAULT and not isinstance(order, Reset):
        return state, [end, Then.REPORT]
    return state, [end, outcomes.Ask(RequestKind.CONFIGURE, order, state.rules.ts_us)]


def handle_hello(
    state: DecisionState, now_ns: int, asked: PendingRequest, reply: wire.HelloReply
) -> Step:
    """Send CONFIG, after STOP to a device that drives; latch a fault if the device does not fit."""
    if reply.state == DeviceState.BOOT:
        return state, []  # the device still boots: HELLO stays pending, and is sent again
    clock = state.clock
    if clock is None or clock.boot_id != reply.boot_id:  # its clock has restarted
        clock = ClockComparison(reply.boot_id, clock.compared_ns if clock else 0)
        state = replace(state, clock=clock, t_us=0, device=None)
    if state.device is None:
        state = replace(state, sampled_ns=0)  # earlier samples were of another link or boot
    state = replace(state, asked=None, device=reply, device_uid=reply.uid).linked(
        token=reply.token,
        device_state=reply.state,
        last_round_trip_ns=asked.sent_ns,
        sent=(),
    )
    if (reply.version, reply.schema) != (VERSION, SCHEMA_HASH):
        error = (
            f"the firmware speaks version {reply.version}, schema {reply.schema:08x}; "
            f"this daemon speaks version {VERSION}, schema {SCHEMA_HASH:08x}"
        )
        return _latch(state, now_ns, asked, Fault(Id.FIRMWARE, error))
    if unfit := _unfit(reply, state.rules):
        return _latch(state, now_ns, asked, unfit)
    if reply.state in LATCHED_STATES:
        fault = Fault(Id.DEVICE, f"the device is in {DeviceState(reply.state).name}")
        if reply.cause in OF_DEVICE:
            fault = Fault(Id.DEVICE, f"{fault.cause}: {of_device(reply.cause)}", reply.cause)
        return _latch(state, now_ns, asked, fault)
    if reply.state in DRIVING_STATES:
        # The device still drives the motor, for another host or because each STOP was lost.
        return state, [outcomes.Ask(RequestKind.STOP, asked.order)]
    if state.phase is Phase.FAULT and asked.order is None:
        return state, [Then.REPORT]
    return state, [outcomes.Ask(RequestKind.CONFIGURE, asked.order, state.rules.ts_us)]


def _unfit(device: wire.HelloReply, rules: Rules) -> Fault | None:
    """Return the fault of a device that has this protocol, but must not be driven; else None."""
    if device.state not in _KNOWN:
        text = f"the device reports state {device.state}, which the protocol does not define"
    elif device.full_scale_mv != FULL_SCALE_MV:
        text = (
            f"the device's full scale is {device.full_scale_mv} mV, not {FULL_SCALE_MV} mV: "
            "each code would mean another voltage"
        )
    elif not device.capabilities & Capability.EXCHANGE:
        text = "the device has no exchange mode"
    elif rules.rest_code and not device.capabilities & Capability.ENABLE_LINE:
        text = (
            "the device has no enable line: in a reset its pin falls to 0 V, which is not this "
            "rig's rest"
        )
    elif not 1 <= device.pwm_bits <= 16:
        text = f"the device's duty has {device.pwm_bits} bits: 1 to 16 are possible"
    elif (image := rules.image) and not (device.uid == EMULATOR_UID or image.fits(device.firmware)):
        # Each image drives another pin; an emulated device has neither image nor pins.
        text = (
            f"the firmware on the board, {device.firmware:08x}, is not the image {image.name} "
            f"that the rig needs, which `armrig flash --image {image.name}` writes"
        )
    else:
        return None
    return Fault(Id.FIRMWARE, text)


def _latch(state: DecisionState, now_ns: int, asked: PendingRequest, fault: Fault) -> Step:
    done = refuse(asked.order, fault.cause, RefusalCode.NO_EFFECT)
    if state.fault != fault:
        state = change_phase(state, On.TRIPPED, fault=fault)
        text = sentence(fault, is_emulated=state.is_emulated)
        done.append(log(now_ns, "error", text, cause=fault.id))
    # The state is reported even for the same fault, because `device` has changed.
    return state, [*done, Then.REPORT]


def handle_config(
    state: DecisionState, now_ns: int, asked: PendingRequest, reply: wire.ConfigReply
) -> Step:
    """Rest at 0 V, or send ARM for an owner; a refusal latches a fault."""
    if reply.code != Code.OK:
        error = f"the device refuses the configuration: {name_of(Code, reply.code)}"
        if state.rules.oversampling > 1:
            error += (
                f"; it may not permit [device] oversampling = {state.rules.oversampling}, or not "
                f"at Ts={asked.ts_us / 1e6:g} s: lower the oversampling, or sample slower"
            )
        if isinstance(asked.order, Arm | Run):
            return state, [outcomes.GiveUp(error)]
        return _latch_refusal(state, now_ns, asked, error)
    wanted = state.rules.config(asked.ts_us, 0, scheduled=asked.scheduled)
    if reply.config_crc != config_crc(wanted):
        if asked.tries < MAX_TRIES:
            return state, []  # a late answer to an earlier CONFIG; CONFIG is sent again later
        text = "the device accepted another configuration than was sent"
        return state, [outcomes.GiveUp(text)]
    before_us = state.pace_us
    pace_us = CARE_PERIOD_US if asked.scheduled else asked.ts_us
    arms = isinstance(asked.order, Arm | Run)
    # `tick_ns` is set to now, because earlier ticks had another period. The answer does not name
    # its CONFIG. Before arming, the answer is therefore no proof of a round trip.
    accepted = Configuration(
        asked.ts_us, asked.scheduled, reply.config_crc, reply.nonce, asked.sent_ns
    )
    proven = {} if arms else {"last_round_trip_ns": asked.sent_ns}
    state = replace(
        state.linked(beats=(), device_state=reply.state, **proven),
        asked=None,
        configuration=accepted,
        pace_us=pace_us,
        tick_ns=now_ns,
    )
    done: list[outcomes.Outcome] = [] if before_us == pace_us else [SetPeriod(pace_us, state.k + 1)]
    if arms:
        if done and state.phase is Phase.ARMED:
            done.append(Then.REPORT)
        return state, [*done, outcomes.Ask(RequestKind.ARM, asked.order)]
    on = On.RESET if isinstance(asked.order, Reset) else On.CONFIGURED
    state = change_phase(state, on, fault=None, lease=None)
    return state, [*done, Then.REPORT, *answer(asked.order, {"done": True})]


def _latch_refusal(state: DecisionState, now_ns: int, asked: PendingRequest, error: str) -> Step:
    """Latch a fault, because the device would refuse the same CONFIG after each HELLO."""
    done: list[Action] = []
    if isinstance(asked.order, Stop | Disarm):  # the device has stopped, so the order is done
        done, asked = answer(asked.order, {"done": True}), asked._replace(order=None)
    state = replace(state, asked=None)
    state, follow = _latch(state, now_ns, asked, Fault(Id.REQUEST, error))
    return state, [*done, *follow]


def handle_refusal(state: DecisionState, asked: PendingRequest, reply: wire.Ack) -> Step:
    """Give up; after STALE the request is sent again, with a newer seq."""
    if reply.code == Code.STALE:
        return state, []
    text = f"the device refuses {asked.want}: {name_of(Code, reply.code)}"
    return state, [outcomes.GiveUp(text)]


def handle_refusal_of_hello(state: DecisionState, asked: PendingRequest, reply: wire.Ack) -> Step:
    """Send STOP at once if repeated old frames keep the device driving."""
    if reply.code == Code.STALE and reply.state in DRIVING_STATES:
        return state, [outcomes.Transmit((wire.Stop(0, 0),))]
    return handle_refusal(state, asked, reply)


def handle_refusal_of_stop(state: DecisionState, asked: PendingRequest, reply: wire.Ack) -> Step:
    """Give up; in a fault, the device's state may show that it has stopped by itself."""
    if state.phase is Phase.FAULT and reply.code == Code.WRONG_STATE:
        return state, [outcomes.NoteState(reply.state)]
    return handle_refusal(state, asked, reply)
