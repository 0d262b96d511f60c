"""A daemon that only answers: a real zenoh session without a rig."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Self

import msgspec
import numpy as np
import zenoh
from armrig.rig.collection import Plan
from armrig.rig.replies import Progress
from armrig_core.commands import commands
from armrig_core.commands.codes import TRY_AGAIN, OutcomeCode
from armrig_core.commands.commands import LastRun, Rehearsal, StatusReport
from armrig_core.telemetry import topics


def step_plan(owner: str, seconds: float = 1.0) -> Plan:
    """Return the plan of a step of 1 V from the first sample on."""
    return Plan(
        experiment="step",
        make=lambda N, _: np.ones(N),
        details={},
        seconds=seconds,
        Ts=None,
        pacing="scheduled",
        owner=owner,
    )


@contextmanager
def unseen(*_: object) -> Iterator[Progress]:
    """Show no progress of a run."""
    yield lambda done, total: None


def status_report(**of: Any) -> StatusReport:
    """Return the status of rig 7, which is at 0 V, with these changes."""
    fields: dict[str, Any] = dict.fromkeys(("reason", "owner", "version", "endpoint"), "")
    fields |= {"rig": "7", "phase": "safe", "Ts": 0.01, "u_min": 0.0, "u_max": 5.0, "device": {}}
    fields |= {"host": {}, "last_run": None, "recordings": "/of/mine"}
    return StatusReport(**fields | of)


class FakeDaemon:
    """Answers as the daemon does, and keeps the requests; for use in a `with` block."""

    def __init__(self, endpoint: str, rig: str = "1") -> None:
        self.endpoint, self.rig = endpoint, rig
        self.asked: list[commands.DaemonRequest] = []
        self.polls_per_run = 3
        self.limits_v = (0.0, 5.0)
        self.outcome = "complete"
        self.code = ""  # of the outcome, unless the outcome is "complete"
        self.recording = "/nowhere/run.mcap"
        self.refusals: dict[str, str | commands.Refused] = {}
        self.fault = self.remedy = ""
        self.arm_removed = False
        self.rehearsal: Rehearsal | None = None
        self.during_run: Callable[[], object] = lambda: None
        self._run: commands.RunRequest | None = None
        self._polls = 0

    def __enter__(self) -> Self:
        config = zenoh.Config()
        for key, value in (
            ("mode", "peer"),
            ("listen/endpoints", [self.endpoint]),
            ("scouting/multicast/enabled", False),
            ("scouting/gossip/enabled", False),
            ("transport/shared_memory/enabled", False),
        ):
            config.insert_json5(key, json.dumps(value))
        self.session = zenoh.open(config)
        self.session.declare_queryable(topics.command_key(self.rig, "*"), self._answer)
        self.alive = self.session.liveliness().declare_token(topics.alive_key(self.rig))
        return self

    def __exit__(self, *_: object) -> None:
        self.session.close()

    def names(self) -> list[str]:
        """Return the names of the commands that came, status left out."""
        return [r.name for r in self.asked if not isinstance(r, commands.Status)]

    def status(self) -> StatusReport:
        """Return what `status` answers."""
        last = None
        if self._run is not None:
            finished = self._polls >= self.polls_per_run
            total = len(self._run.u)
            last = LastRun(
                run_id="r1",
                recording=self.recording if finished else self.recording + ".active",
                finished=finished,
                samples=total if finished else total * self._polls // self.polls_per_run,
                synced=total if finished else 0,
                outcome=self.outcome if finished else "",
                code=self._outcome_code() if finished else "",
            )
        running = last is not None and not last.finished
        return StatusReport(
            rig=self.rig,
            version="0.1.0",
            phase="fault" if self.fault else "active" if running else "safe",
            reason=self.fault,
            remedy=self.remedy,
            arm_removed=self.arm_removed,
            owner="",
            Ts=0.01,
            u_min=self.limits_v[0],
            u_max=self.limits_v[1],
            endpoint=self.endpoint,
            device={"uid": "1"},
            host={"fifo": 0, "refused": ["SCHED_FIFO (set LimitRTPRIO=)"]},
            last_run=last,
            recordings="/nowhere",
        )

    def _outcome_code(self) -> str:
        return OutcomeCode.COMPLETE if self.outcome == "complete" else self.code

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            name = str(query.key_expr).rsplit("/", 1)[1]
            payload = query.payload.to_bytes() if query.payload else b""
            try:
                answer = self._carry_out(commands.parse(name, payload))
            except commands.CommandRefusedError as err:
                query.reply_err(msgspec.json.encode(err.refusal))
                return
            except ValueError as err:
                refusal = commands.Refused(error=str(err), passes=str(err).endswith(TRY_AGAIN))
                query.reply_err(msgspec.json.encode(refusal))
                return
            query.reply(query.key_expr, msgspec.json.encode(answer))

    def _carry_out(self, request: commands.DaemonRequest) -> Any:
        self.asked.append(request)
        if request.name in self.refusals:
            refusal = self.refusals[request.name]
            if isinstance(refusal, commands.Refused):
                raise commands.CommandRefusedError(refusal)
            raise ValueError(refusal)
        if isinstance(request, commands.Status):
            self._polls += self._run is not None
            if self._run is not None:
                self.during_run()
            return self.status()
        if isinstance(request, commands.ArmRequest):
            return commands.LeaseGranted(
                lease="0" * 32,
                period_s=0.1,
                Ts=request.Ts or 0.01,
                u_min=self.limits_v[0],
                u_max=self.limits_v[1],
            )
        if isinstance(request, commands.RunRequest):
            self._run, self._polls = request, 0
            return commands.RunAccepted(
                run_id="r1", recording=self.recording, rehearsal=self.rehearsal
            )
        if isinstance(request, commands.StopRequest):
            self.outcome, self.code, self.polls_per_run = "stopped", "", 0
        return commands.Done(done=True)
