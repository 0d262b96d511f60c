"""Voltages that the client sets, in a run or by hand: their lease, and the code of each sample."""

from __future__ import annotations

from armrig_core.commands.codes import OutcomeCode
from armrig_core.rig.volts import volts_of
from msgspec.structs import replace

from armrig_daemon import pipe
from armrig_daemon.decisions.faults import Fault, Id
from armrig_daemon.decisions.outcomes import Halt, Outcome, Trip
from armrig_daemon.decisions.state import ActiveRun, DecisionState, Emit, OwnControl

ARMED_NS = 10_000_000_000
"""Longest time at rest without a command of the lease's holder, in ns."""


def has_run_out(state: DecisionState, now_ns: int) -> bool:
    """Return whether the newest command of the lease's holder is too old (S2)."""
    lease, rules = state.lease, state.rules
    # A run begins at rest, and its client may take long to set the first voltage.
    rests = state.run is not None and state.code == rules.rest_code
    limit_ns = ARMED_NS if rests else rules.lease_ns(state.ts_us)
    return lease is not None and now_ns - lease.renewed_ns > limit_ns


def decide(
    state: DecisionState, now_ns: int, n: int, run: ActiveRun, control: OwnControl, i: int
) -> tuple[DecisionState, int, list[Outcome]]:
    """Return the code of the newest `set`, number `n`; rest if the client is gone (S2, S5)."""
    code, rest_code = state.code, state.rules.rest_code
    if has_run_out(state, now_ns):
        text = "its client went away: it set no voltage in time"
        return state, rest_code, [Halt(text, code=OutcomeCode.CLIENT_GONE)]
    if code != rest_code and not state.rules.allows(control.code, code):
        return state, rest_code, [Trip(Fault(Id.LIMITS, f"u[{i}] is not within the limits"))]
    control = OwnControl(control.reference, code, n, control.missed + (i > 0 and n == control.n))
    record = pipe.Control(
        t_host_ns=now_ns,
        k=run.k_first + i,
        r=memoryview(control.reference).cast("d")[i],
        v=volts_of(code),
        u_v=volts_of(code),
        predicted=control.missed,
    )
    return replace(state, run=replace(run, due=i + 1, own=control)), code, [Emit(record)]
