"""The report at the end of a run."""

from __future__ import annotations

import pytest
from armrig_core.codes import RefusalCode
from armrig_daemon.decisions.state import Emit, Queue
from armrig_daemon.decisions.stopping import end_run
from armrig_daemon.pipe import Answer

from tests.daemon.decision_states import RUN, changed, rested


@pytest.mark.parametrize(
    ("outcome", "error"), [("the lease ran out", "the lease ran out"), ("", "stopped")]
)
def test_a_run_that_never_began_is_refused_with_a_reason(outcome: str, error: str) -> None:
    state = changed(rested().loop.state, queue=Queue(RUN), outcome=outcome)

    state, done = end_run(state, 0)

    refusal = Answer(order=73, error=error, code=RefusalCode.OVERTAKEN)
    assert [a.record for a in done if isinstance(a, Emit)] == [refusal]
    assert (state.queue, state.outcome) == (None, "")
