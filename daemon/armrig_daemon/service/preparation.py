"""The run that a client waits for: it is planned, its file is created, then its order may leave.

A run is valid for as long as its client waits, judged when its order leaves. A stop, a reset or the
end of the lease cancels it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import (
    CommandRefusedError,
    Refused,
    Renew,
    RunAccepted,
    RunOptions,
    build_refusal,
)

from armrig_daemon import pipe
from armrig_daemon.service.client_watchdog import not_newer
from armrig_daemon.service.host.planner import Job, Planner
from armrig_daemon.service.listener import Command
from armrig_daemon.service.plan import RunPlan
from armrig_daemon.service.runs import Runs

UNTIMED_S = 10.0
"""Time for which a local command without a time of validity is valid, in s, from its arrival."""


class Ready(NamedTuple):
    """A run whose order may leave."""

    command: Command
    order: pipe.Run
    accepted: RunAccepted
    options: RunOptions
    valid_until_ns: int | None


class _PendingRun(NamedTuple):
    command: Command
    number: int
    Ts: float
    valid_until_ns: int | None = None
    n: int = -1
    """Number of the newest sign of life."""
    ready: Ready | None = None


Check = Callable[[Command, RunOptions, int | None], None]


class Preparation:
    """Preparation of at most one run; nothing here waits."""

    def __init__(self, runs: Runs, planner: Planner) -> None:
        """Prepare nothing yet."""
        self._runs, self._planner = runs, planner
        self._asked: _PendingRun | None = None
        self._numbers = 0

    @property
    def is_busy(self) -> bool:
        """True while a run is prepared."""
        return self._asked is not None

    def begin(self, command: Command, job: Job) -> None:
        """Prepare the run that a command requests; the job's number is set here."""
        if self._asked is not None:
            text = "another run is being prepared: stop it first, or wait for its end"
            raise CommandRefusedError(build_refusal(RefusalCode.RUNNING, text))
        if objection := self._runs.objection():
            raise CommandRefusedError(objection)
        self._runs.is_expected = True
        self._numbers += 1
        self._asked = _PendingRun(command, self._numbers, job.Ts)
        self._planner.plan(job._replace(number=self._numbers))

    def renew(self, sign: Renew) -> None:
        """Note that the client still waits, if a run is prepared."""
        asked = self._asked
        if asked is None:
            return
        if sign.n <= asked.n:
            raise not_newer(sign.n, asked.n)
        until_ns = sign.valid_until_ns or asked.valid_until_ns
        self._asked = asked._replace(n=sign.n, valid_until_ns=until_ns)

    def advance(self, check: Check) -> Ready | None:
        """Go on as far as possible; return the run whose order may leave now, or None.

        `check` raises CommandRefusedError if a run may not begin, as soon as its options are known.
        The caller must check the returned run again, and end the preparation by `drop`.
        """
        asked = self._asked
        if asked is None:
            return None
        try:
            if asked.ready is None:
                while isinstance(plan := self._planner.result(asked.number), RunOptions):
                    until_ns = asked.valid_until_ns or plan.valid_until_ns
                    self._asked = asked = asked._replace(valid_until_ns=until_ns)
                    check(asked.command, plan, until_ns)
                if plan is None:
                    return None
                if isinstance(plan, Refused):
                    raise CommandRefusedError(plan)
                asked = self._open_run(asked, plan)
            if asked.ready is None or not self._runs.is_file_ready():
                return None
            return asked.ready._replace(valid_until_ns=asked.valid_until_ns)
        except CommandRefusedError as err:
            self.cancel(err.refusal)
            return None

    def _open_run(self, asked: _PendingRun, plan: RunPlan) -> _PendingRun:
        order, accepted = self._runs.open(plan, asked.Ts)
        until_ns = asked.valid_until_ns or plan.options.valid_until_ns
        options = plan.options
        ready = Ready(asked.command, order, accepted, options, until_ns)
        self._asked = asked._replace(ready=ready, valid_until_ns=until_ns)
        return self._asked

    @property
    def valid_until_ns(self) -> int | None:
        """Time until which the client of the run waits, as far as it is known."""
        return self._asked.valid_until_ns if self._asked else None

    def drop(self) -> None:
        """End the preparation of a run whose order leaves."""
        self._asked = None

    def cancel(self, refusal: Refused) -> None:
        """Refuse the run, and drop what was prepared."""
        asked, self._asked = self._asked, None
        if asked is None:
            return
        self._runs.is_expected = False
        self._planner.cancel()
        if asked.ready is not None:
            self._runs.forget(asked.ready.order.run_id)
        asked.command.refuse(refusal)
