"""Collections: the progress, the end, and the message after an interruption."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zenoh
from armrig.rig.client import Rig
from armrig.rig.collection import Plan, TimingNote, _interruption_sentence, collect
from armrig.rig.replies import Progress
from armrig.rig.session import NoReplyError
from armrig_core.commands.codes import OutcomeCode
from armrig_core.commands.commands import ArmRequest, LastRun, RunRequest, Status, StatusReport
from msgspec.structs import replace

from tests.clients.fake_daemon import FakeDaemon, step_plan, unseen
from tests.clients.made_recordings import gap, sample, timing

NEW = LastRun(run_id="new", recording="new.mcap", finished=True, samples=7, outcome="stopped")
OLD = LastRun(run_id="old", recording="old.mcap", finished=True, samples=9, outcome="complete")


@pytest.mark.parametrize(
    ("before", "last", "said"),
    [
        (None, None, "nothing was recorded"),
        (OLD, OLD, "nothing was recorded"),
        (OLD, NEW, "the 7 samples before the stop are in new.mcap"),
        (None, NEW, "the 7 samples before the stop are in new.mcap"),
    ],
)
def test_an_interrupted_run_is_reported_with_its_own_recording(
    before: LastRun | None, last: LastRun | None, said: str
) -> None:
    rig: Any = SimpleNamespace(rig="1", status=lambda: SimpleNamespace(last_run=last))

    assert _interruption_sentence(rig, before) == (
        f"interrupted: a stop (0 V) was sent to rig 1; {said}"
    )


class _SlowDisk(FakeDaemon):
    """Has a run that lacks samples, whose last ones reach the disk while the motor still stops."""

    def status(self) -> StatusReport:
        """Return what `status` answers: the run is finished before the phase has changed."""
        found = super().status()
        if (last := found.last_run) is None or not last.finished:
            return found
        late = replace(last, samples=last.samples - 5, synced=last.samples - 7)
        is_done = self._polls > self.polls_per_run + 1
        return replace(found, last_run=late, phase="safe" if is_done else "active")


def test_a_collection_of_an_interrupted_run_ends_with_its_last_sample(where: str) -> None:
    shown: list[tuple[int, int]] = []

    @contextmanager
    def note(rig: Rig, experiment: str, N: int) -> Iterator[Progress]:
        shown.append((-1, N))
        yield lambda done, total: shown.append((done, total))

    plan = Plan(
        experiment="own",
        make=lambda N, Ts: np.full(N, 1.0 + Ts),
        details={"a": 2},
        seconds=0.6,
        Ts=0.04,
        pacing="exchange",
        owner="Ada",
    )
    with _SlowDisk(where) as daemon:
        told: list[str] = []
        found = collect(plan, rig="1", connect=where, tell=told.append, display=note)
        polls, [arm, run] = daemon._polls, [r for r in daemon.asked if not isinstance(r, Status)]

    assert arm == ArmRequest(owner="Ada", Ts=0.04)
    assert run == RunRequest(
        lease="0" * 32, n=1, u=[1.04] * 15, pacing="exchange", experiment="own", details={"a": 2}
    )
    assert (found.samples, found.Ts, found.synced, found.verdict) == (15, 0.04, 8, None)
    assert (found.path, found.run_id) == (Path("/nowhere/run.mcap"), "r1")
    assert shown == [(-1, 15), (5, 15), (10, 15), (15, 15), (15, 15), (15, 15)]
    assert polls == 5
    assert told == []


class _LowRig(FakeDaemon):
    """Allows at most 3 V."""

    def status(self) -> StatusReport:
        return replace(super().status(), u_max=3.0)


@pytest.mark.parametrize(
    ("default", "high", "u"), [(True, 4.5, 2.7), (False, 4.5, 4.5), (True, 2.5, 2.5)]
)
def test_default_levels_above_the_limit_of_the_rig_are_lowered(
    default: bool, high: float, u: float, where: str
) -> None:
    plan = Plan(
        experiment="own",
        make=lambda N, _: np.full(N, high),
        details={"low": 0.5, "high": high},
        seconds=0.1,
        Ts=0.01,
        pacing="exchange",
        owner="Ada",
        default_levels=default,
    )
    told: list[str] = []
    with _LowRig(where) as daemon:
        collect(plan, rig="1", connect=where, tell=told.append, display=unseen)
        [run] = [r for r in daemon.asked if isinstance(r, RunRequest)]

    assert (run.u, run.details["high"]) == (pytest.approx([u] * 10), pytest.approx(u))
    lowered = "the rig allows at most 3 V: the input is between 0.3 and 2.7 V"
    assert told == ([lowered] if u < high else [])


class _CutOff(FakeDaemon):
    """Answers nothing more after it has shown two thirds of a run."""

    def _answer(self, query: zenoh.Query) -> None:
        if self._polls < 2:
            super()._answer(query)
        else:
            query.drop()


def test_a_daemon_that_ends_during_a_run_leaves_its_partial_recording(where: str) -> None:
    plan = step_plan("Ada", seconds=3.0)
    with _CutOff(where), pytest.raises(NoReplyError) as told:
        collect(plan, rig="1", connect=where, tell=print, display=unseen)

    text = str(told.value)
    assert text.startswith("the run was cut off after 200 or more of 300 samples: no reply from")
    assert text.endswith(
        "; what was recorded is in `armrig ls`; start the rig with the options that it had "
        "before, then repeat the command"
    )


@pytest.mark.parametrize(
    ("code", "outcome", "is_complete"),
    [
        (OutcomeCode.COMPLETE, "all of it", True),
        (OutcomeCode.STOPPED, "complete", False),
        ("a code of tomorrow", "complete", False),
        ("", "complete", False),
    ],
)
def test_the_outcome_code_decides_whether_a_run_is_complete(
    code: str, outcome: str, is_complete: bool
) -> None:
    last = replace(NEW, code=code, outcome=outcome)

    assert last.is_complete == is_complete


def test_the_progress_shows_the_lateness_and_the_queue_of_the_last_report() -> None:
    def late(first: int, count: int, late_us: int) -> list[Any]:
        return [
            sample(k, t_host_ns=sample(k).t_sched_ns + late_us * 1000)
            for k in range(first, first + count)
        ]

    def report(p50: float, n: int) -> Any:
        made = timing(0)
        made.queue_depth.p50, made.queue_depth.n = p50, n
        return made

    lots = [
        [sample(6, flags=0)],
        [sample(6, flags=0), *late(7, 100, 5000)],
        late(107, 20, 300),
        late(127, 80, 50),
    ]
    gaps: list[list[Any]] = [[gap(5, 4, 1.0)], [], [gap(206, 9, 1.0)]]
    reports = [[report(3, 9)], [report(17, 100)], [report(17, 100), report(5, 0)]]
    pieces = [iter(each) for each in (lots, gaps, reports)]

    note = TimingNote(200, *(lambda piece=piece: next(piece) for piece in pieces))

    assert [note() for _ in range(4)] == [
        "",
        "host late p99 5000 µs, missing 2, queue 3",
        "host late p99 5000 µs, missing 2, queue 17",
        "host late p99 300 µs, missing 3",
    ]
