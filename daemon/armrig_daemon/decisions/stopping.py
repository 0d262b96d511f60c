"""All ways of bringing the input to rest: 0 V, or the rest of the rig's description."""

from __future__ import annotations

from armrig_core.commands.codes import OutcomeCode
from msgspec.structs import replace

from armrig_daemon.decisions import outcomes
from armrig_daemon.decisions.faults import Fault, sentence
from armrig_daemon.decisions.outcomes import Step, Then, log
from armrig_daemon.decisions.phases import On, change_phase
from armrig_daemon.decisions.state import DecisionState, Exit, RequestKind


def stop(state: DecisionState, halt: outcomes.Halt) -> Step:
    """Stop the motor without a fault; the run ends when the device has stopped."""
    state = replace(state.ending_with(halt.outcome, halt.code), code=state.rules.rest_code)
    return state, [outcomes.Ask(RequestKind.STOP, halt.order)]


def leave(state: DecisionState) -> Step:
    """Remove the lease and exit, so that later frames of the same step cannot cause a fault."""
    return change_phase(state, On.ENDED, lease=None, code=state.rules.rest_code), [Exit()]


def trip(state: DecisionState, now_ns: int, fault: Fault) -> Step:
    """Stop the motor and latch the fault, which only a reset ends (S6 of ARCHITECTURE.md)."""
    state = state.ending_with(fault.cause, OutcomeCode.FAULT)
    state = change_phase(state, On.TRIPPED, fault=fault, lease=None, code=state.rules.rest_code)
    fault_text = sentence(fault, is_emulated=state.is_emulated)
    text = f"stopped at {state.rules.rest}: {fault_text}; then `armrig reset`, then repeat"
    # A device that cannot be reached is stopped by its own watchdog.
    stopped = outcomes.Ask(RequestKind.STOP) if state.link is not None else outcomes.EndRun()
    facts = {"cause": str(fault.id)}
    if fault.output:
        facts |= {"output": fault.output, "value": f"{fault.value:.6g}"}
    return state, [stopped, log(now_ns, "error", text, **facts), Then.REPORT]
