"""The report at the end of a run."""

from __future__ import annotations

import pytest
from armrig_core.commands.codes import OutcomeCode, RefusalCode
from armrig_daemon.decisions.state import ActiveRun, Emit, Queue
from armrig_daemon.decisions.stopping import end_run, ending
from armrig_daemon.pipe import Answer, RunEnded

from tests.daemon.decision_states import RUN, changed, rested


@pytest.mark.parametrize("run", [None, ActiveRun("r", RUN.codes, -1), ActiveRun("r", RUN.codes, 4)])
def test_the_outcome_of_a_run_does_not_carry_over_to_the_next(run: ActiveRun | None) -> None:
    state = changed(rested().loop.state, run=run)

    ended, done = end_run(ending(state, "by hand", OutcomeCode.STOPPED), 0)

    told = [a.record for a in done if isinstance(a, Emit) and isinstance(a.record, RunEnded)]
    assert [(r.outcome, r.outcome_code) for r in told] == [("by hand", "stopped")] * bool(run)
    assert (ended.run, ended.outcome, ended.outcome_code) == (None, "", None)


@pytest.mark.parametrize(
    ("outcome", "error"), [("the lease ran out", "the lease ran out"), ("", "stopped")]
)
def test_a_run_that_never_began_is_refused_with_a_reason(outcome: str, error: str) -> None:
    state = changed(rested().loop.state, queue=Queue(RUN), outcome=outcome)

    state, done = end_run(state, 0)

    refusal = Answer(order=73, error=error, code=RefusalCode.OVERTAKEN)
    assert [a.record for a in done if isinstance(a, Emit)] == [refusal]
    assert (state.queue, state.outcome) == (None, "")
