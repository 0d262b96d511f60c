"""A run that is planned in this process, and whose file exists."""

from __future__ import annotations

from armrig_core.commands.commands import RunAccepted, RunRequest
from armrig_daemon import pipe
from armrig_daemon.service.plan import make_plan, options_of
from armrig_daemon.service.runs import Runs


def open_run(
    runs: Runs, request: RunRequest, Ts: float, start_rad: float | None = None
) -> tuple[pipe.Run, RunAccepted]:
    """Plan a run and have its file created; return the order, and the client's answer."""
    options = options_of(request)
    plan = make_plan(options, request.u, Ts, runs.config, runs.description, start_rad)
    return runs.open(plan, Ts, waits=True)
