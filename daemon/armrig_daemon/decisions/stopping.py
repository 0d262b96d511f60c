"""All ways of bringing the motor to 0 V."""

from __future__ import annotations

from armrig_core.commands.codes import GapCode, OutcomeCode, RefusalCode
from msgspec.structs import replace

from armrig_daemon.decisions import gaps
from armrig_daemon.decisions.faults import Fault, sentence
from armrig_daemon.decisions.phases import On, moved
from armrig_daemon.decisions.requests import Step, ask, linked, log, refuse, report_state
from armrig_daemon.decisions.state import (
    Emit,
    Exit,
    MissingSamples,
    Phase,
    RequestKind,
    SetPeriod,
    State,
)
from armrig_daemon.pipe import Order, RunEnded


def end_run(state: State, now_ns: int) -> Step:
    """Report the end of the run; call this when no further sample of the run can arrive."""
    queue, run = state.queue, state.run
    done = refuse(queue.order, state.outcome or "stopped", RefusalCode.OVERTAKEN) if queue else []
    state = replace(linked(state, beats=()), queue=None)
    if run is None:
        return replace(state, outcome="", outcome_code=None), done
    if run.k_first >= 0:
        end = run.k_first + min(run.due, run.samples)
        waiting = state.link.sent if state.link else ()
        for sent in (s for s in waiting if s.k < end):
            state = gaps.note(state, gaps.lost(sent, now_ns))
        if run.scheduled and state.phase is Phase.FAULT:
            # Report the samples that the device would have taken by now without the fault.
            by_now = (now_ns - run.t_zero_ns) // (state.ts_us * 1000) + 1
            n = max(0, min(by_now, run.samples) - run.due)
            due_ns = gaps.due_ns(state, end)
            missing = MissingSamples(end, n, state.outcome, 0, due_ns, now_ns, GapCode.FAULT)
            state = gaps.note(state, missing)
            run, end = replace(run, due=run.due + n), end + n
        state, actions = gaps.report_missing(state, end, now_ns)
        done += actions
        state = linked(state, sent=tuple(s for s in waiting if s.k >= end))
    if run.scheduled and run.k_first >= 0:
        # The device has paced the samples: number the loop's next tick after the last sample.
        k = run.k_first + run.due - 1
        state = replace(state, k=k, pace_us=state.rules.ts_us)
        done.append(SetPeriod(state.rules.ts_us, k + 1))
    code, text = state.ending
    done.append(Emit(RunEnded(run_id=run.run_id, outcome=text, outcome_code=code)))
    return replace(state, run=None, outcome="", outcome_code=None), done


def ending(state: State, outcome: str, code: OutcomeCode) -> State:
    """Store the outcome of the run, unless an outcome is already stored."""
    if state.outcome or not outcome:
        return state
    return replace(state, outcome=outcome, outcome_code=code)


def stop(
    state: State,
    now_ns: int,
    outcome: str,
    order: Order | None = None,
    code: OutcomeCode = OutcomeCode.STOPPED,
) -> Step:
    """Stop the motor without a fault; the run ends when the device has stopped."""
    state = replace(ending(state, outcome, code), code=0)
    return ask(state, now_ns, RequestKind.STOP, order)


def leave(state: State) -> Step:
    """Remove the lease and exit, so that later frames of the same step cannot cause a fault."""
    return moved(state, On.ENDED, lease=None, code=0), [Exit()]


def trip(state: State, now_ns: int, fault: Fault) -> Step:
    """Stop the motor and latch the fault, which only a reset ends (S6 of ARCHITECTURE.md)."""
    state = ending(state, fault.cause, OutcomeCode.FAULT)
    state = moved(state, On.TRIPPED, fault=fault, lease=None, code=0)
    if state.link is not None:
        state, done = ask(state, now_ns, RequestKind.STOP)
    else:
        # The device cannot be reached: its own watchdog stops it.
        state, done = end_run(state, now_ns)
    text = f"stopped at 0 V: {sentence(fault)}; then `armrig reset`, then repeat"
    return state, [*done, log(now_ns, "error", text, cause=fault.id), report_state(state, now_ns)]
