"""Every way in which the motor is brought to 0 V."""

from __future__ import annotations

from armrig_daemon.asking import Step, ask, log, say_state
from armrig_daemon.records import Order, RunEnded
from armrig_daemon.state import Emit, Phase, State, Want


def end_run(state: State) -> Step:
    """Say that the run is over, once no sample of it can come any more."""
    if state.run is None:
        return state._replace(outcome=""), []
    ended = RunEnded(run_id=state.run.run_id, outcome=state.outcome)
    return state._replace(run=None, outcome=""), [Emit(ended)]


def stop(state: State, now_ns: int, outcome: str, order: Order | None = None) -> Step:
    """Go to 0 V in good order: the run ends when the device has stopped."""
    state = state._replace(outcome=state.outcome or outcome, code=0)
    return ask(state, now_ns, Want.STOP, order)


def trip(state: State, now_ns: int, reason: str) -> Step:
    """Go to 0 V and latch: only a reset, then arm, leads out (S6)."""
    state = state._replace(
        phase=Phase.FAULT, reason=reason, lease=None, code=0, outcome=state.outcome or reason
    )
    text = f"stopped at 0 V: {reason}; mend it, then `reset`, then arm again"
    done = [log(now_ns, "error", text), say_state(state, now_ns)]
    if state.link_up:
        state, actions = ask(state, now_ns, Want.STOP)
    else:
        # No way to tell the device: its own watchdog stops it.
        state, actions = end_run(state)
    return state, done + actions
