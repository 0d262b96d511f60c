"""Collection of data: arm the rig, play an input and record, or report the reason for a failure."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from datetime import timedelta
from math import floor, isclose, isfinite
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from armrig_core.commands.commands import (
    LONGEST_SAMPLE_S,
    MOST_SAMPLES,
    UNTIL,
    LastRun,
    Rehearsal,
    RunAccepted,
    rehearsal_sentence,
    samples_of,
)
from armrig_core.control.control_law import ControlLaw
from armrig_core.errors import ParameterError
from armrig_core.recording_file.part_names import part_paths
from armrig_core.rig.calibration import BODY
from armrig_core.rig.description import Input
from armrig_core.rig.volts import U_MAX_V
from armrig_protocol.messages import Flag
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar

from armrig.numerics.quantities import number, plural
from armrig.recordings.files.control_run import control_run
from armrig.recordings.files.loading import load
from armrig.recordings.usability import DataVerdict, data_verdict
from armrig.rig.client import Rig
from armrig.rig.replies import (
    Progress,
    RefusedError,
    RunEndedError,
    refusal_sentence,
    reset_command,
)
from armrig.rig.session import (
    LostLinkError,
    NoReplyError,
    RigError,
    ServiceStoppedError,
    service_has_stopped,
)
from armrig.rig.settling import Settling

Shown = Callable[[Rig, str, int], AbstractContextManager[Progress]]
"""Function of rig, kind of experiment and N.

It returns a context manager that yields a progress callback.
"""

LONGEST_OWNER = 80
DEAD_MAN_S = (0.5, 60.0)
"""Shortest and longest dead-man time that the daemon allows, in s."""
_LONG_S = 600.0  # a longer run is announced with its end
_FINISH_TIMEOUT_S = 2.0  # until a stopped run is complete on the disk
_POLL_INTERVAL_S = 0.05
_TIMING_WINDOW_NS = 1_000_000_000
_Arrived = Callable[[], list[Any]]


class InterruptedRunError(KeyboardInterrupt):
    """Ctrl-C during a collection; the message contains the rig's state and the recording's path."""


class Collected(NamedTuple):
    """Result of a successful collection."""

    path: Path
    samples: int
    """Number of requested samples."""
    Ts: float
    """Sampling time, in s."""
    verdict: DataVerdict | None
    """Verdict on the data; None if the recording cannot be read on this machine."""
    run_id: str
    """Id of the run, which is part of the recording's name."""
    rehearsal: Rehearsal | None
    """Prediction of the daemon's model of the rig; None if the daemon made no rehearsal."""
    synced: int = 0
    """Number of samples on the disk; 0 if the daemon does not report this number."""
    shares: str = ""
    """Shares of the decisions of a law as text; "" for a run without a law."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Input to play, and its settings."""

    experiment: str
    """Kind of experiment, part of the recording's name."""
    make: Callable[[int, float], NDArray[Any]]
    """Function of N and of Ts in s; it returns u in V. The length of u may differ from N."""
    details: Mapping[str, Any]
    """Settings from which the input can be computed again."""
    seconds: float | None
    """Length of the input, in s; if None, `make` is called with N = 0 and determines the length."""
    Ts: float | None
    """Sampling time in s; None for the daemon's sampling time."""
    pacing: Literal["scheduled", "exchange"]
    """Source of the sampling: the device's timer, or the host."""
    owner: str
    """Name of the owner of the rig during the run."""
    dead_man: float | None = None
    """Time in s without a sign of life after which the daemon stops the run; None for no limit."""
    default_levels: bool = False
    """True if `low` and `high` in `details` are lowered on a rig whose highest voltage is lower."""
    is_bare: bool = False
    """True if a person gave voltages without the name of the input."""
    without_arm: bool = False
    """True if the experiment needs the rig without its arm."""
    of_arm: bool = False
    """True if the experiment calibrates the potentiometers of the arm."""
    law: ControlLaw | None = None
    """Law of a run in control; `make` then returns the reference in the law's unit."""
    unstable: bool = False
    """As in `Rig.control`."""
    unmonitored: bool = False
    """As in `Rig.control`."""
    new_reference: Callable[[], float | None] | None = None
    """Function that returns a new reference during a run under a law, or None for no change."""

    def __post_init__(self) -> None:
        """Raise ParameterError for settings that are invalid, whatever the sampling time."""
        for name, value in (("seconds", self.seconds), ("Ts", self.Ts)):
            if value is not None and not (isfinite(value) and value > 0):
                raise ParameterError(name, f"{value:g}", "must be a number of seconds, more than 0")
        low, high = DEAD_MAN_S
        if self.dead_man is not None and not low <= self.dead_man <= high:
            allowed = f"must be {low:g} to {high:g} s, or 0 for none"
            raise ParameterError("dead_man", f"{self.dead_man:g}", allowed)
        if self.Ts is not None:
            samples_of(self.Ts)
        if not 1 <= len(self.owner) <= LONGEST_OWNER:
            count = f"{plural(len(self.owner), 'character')}"
            raise ParameterError("owner", f"of {count}", f"must have 1 to {LONGEST_OWNER}")
        if self.seconds is None:
            return
        if self.Ts is not None or self.seconds > MOST_SAMPLES * LONGEST_SAMPLE_S:
            number_of_samples(self.seconds, self.Ts or LONGEST_SAMPLE_S)


def number_of_samples(seconds: float, Ts: float) -> int:
    """Return the number of samples whose total duration is nearest to `seconds`.

    Raises ValueError if the number is 0, or larger than the largest number of samples of a run.
    """
    N, every = floor(seconds / Ts + 0.5), samples_of(Ts)
    if N < 1:
        reason = f"too short for a sample of {Ts:g} s; must be at least {Ts:g}"
        raise ParameterError("seconds", f"{seconds:g}", reason)
    if N * every > MOST_SAMPLES:
        longest = MOST_SAMPLES // every * Ts
        most = f"must be at most {longest:g} s at Ts = {Ts:g} s ({MOST_SAMPLES} samples)"
        raise ParameterError("seconds", f"{seconds:g}", most)
    return N


@contextmanager
def bar(
    name: str, console: Console | None = None, *, note: Callable[[], str] = str
) -> Iterator[Progress]:
    """Show a progress bar on standard error, and yield the function that updates the bar.

    At each update, the text that `note` returns is shown after the bar.
    """
    columns = (
        TextColumn("{task.description:12}", markup=False),
        BarColumn(30),
        TaskProgressColumn(),
        TimeRemainingColumn(compact=True),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with ProgressBar(*columns, console=console or Console(stderr=True)) as display:
        task = display.add_task(name, total=None, note="")
        yield lambda done, total: display.update(task, completed=done, total=total, note=note())


class TimingNote:
    """Text on the timing of a run so far, computed from the rig's streams."""

    def __init__(self, N: int, samples: _Arrived, gaps: _Arrived, reports: _Arrived) -> None:
        """Store the run's length in samples.

        The other arguments are functions that return the new messages of their stream.
        """
        self._N = N
        self._samples, self._gaps, self._reports = samples, gaps, reports
        self._late: NDArray[np.int64] = np.zeros((0, 2), np.int64)
        self._k_first: int | None = None
        self._missing = 0
        self._queue = ""

    def __call__(self) -> str:
        """Return text: lateness in the last second, number of missing samples, queue depth."""
        arrived = [s for s in self._samples() if s.flags & Flag.RUN]
        if arrived and self._k_first is None:
            self._k_first = arrived[0].k
        if self._k_first is None:
            return ""
        late = [(s.t_sched_ns, s.t_host_ns - s.t_sched_ns) for s in arrived]
        self._late = np.concatenate([self._late, np.array(late, np.int64).reshape(-1, 2)])
        self._late = self._late[self._late[:, 0] > self._late[-1, 0] - _TIMING_WINDOW_NS]
        # As in the recording: samples missing before and after the run do not count.
        end = self._k_first + self._N
        for gap in self._gaps():
            first = max(gap.k_first, self._k_first)
            self._missing += max(0, min(gap.k_first + gap.count, end) - first)
        for report in self._reports():
            queue = report.queue_depth
            self._queue = f", queue {queue.p50:.0f}" if queue.n else ""
        p99_us = float(np.percentile(self._late[:, 1], 99)) / 1e3
        return f"host late p99 {number(p99_us)} µs, missing {self._missing}{self._queue}"


@contextmanager
def timing_note(rig: Rig, N: int) -> Iterator[TimingNote]:
    """Yield a `TimingNote` for a run of N samples, and receive the rig's streams in the block."""
    with (
        rig.arrivals("sample") as samples,
        rig.arrivals("gap") as gaps,
        rig.arrivals("timing") as reports,
    ):
        yield TimingNote(N, samples, gaps, reports)


@contextmanager
def on_the_terminal(rig: Rig, experiment: str, N: int) -> Iterator[Progress]:
    """Show the progress of a run of N samples as a bar, followed by the run's timing."""
    with timing_note(rig, N) as note, bar(experiment, note=note) as progress:
        yield progress


def collect(
    plan: Plan,
    *,
    rig: str,
    connect: str | None,
    tell: Callable[[str], None],
    display: Shown = on_the_terminal,
    way_out: str = "",
) -> Collected:
    """Arm the rig, play a plan's input, and record.

    When the run begins, `tell` gets the motion that the daemon predicts for this input. `way_out`
    is the remedy for a fault; by default the command that resets this rig.

    Raises InterruptedRunError at Ctrl-C after the rig was armed; the rig was stopped. Raises
    RigError if the run was refused or ended early; the message contains the reason and the remedy.
    Raises ValueError if the length is not possible at the sampling time. The rig is disarmed.
    """
    with Rig(rig, connect=connect) as opened:
        status = opened.status()
        described = status.described
        if (plan.without_arm or plan.of_arm) and not described.arm:
            name = described.channels[0].name
            two = f"--point {name}=A --point {name}=B"
            instead = f"`armrig calibrate {two}`" if plan.of_arm else "`armrig collect blackbox`"
            raise RigError(
                f"this experiment is for the arm, and rig {status.rig} is "
                f"'{described.title}': use {instead}"
            )
        if plan.without_arm and not status.arm_removed:
            raise RigError(
                f"this experiment needs the {BODY} alone, but rig {status.rig} has its arm on: "
                f"{ARM_OFF}"
            )
        if described.model is None:
            tell("not rehearsed: the description of this rig has no [model]")
        if status.arm_removed and not plan.without_arm:
            tell(f"rig {status.rig} has no arm ([arm] removed): this is the {BODY} alone")
        port = described.input
        if plan.is_bare and port.rest_v:
            raise RigError(
                f"rig {status.rig} rests at {port.rest_v:g} V, so a voltage without a name may be "
                f"its full reverse: give values in {port.unit} by name, such as --low "
                f"{port.name}={port.value(port.rest_v):.4g} --high {port.name}="
                f"{port.value((port.rest_v + status.u_max) / 2):.4g}. In a file, name the column "
                f"{port.name}"
            )
        if plan.default_levels and (port.rest_v or status.u_max < plan.details["high"]):
            plan = _fitting(plan, port.rest_v, status.u_max, tell)
        armed = False
        try:
            granted = opened.arm(plan.owner, plan.Ts)
            armed = True
            u = make_input(plan, granted.Ts, tell)
            if plan.law is not None:
                tell(f"the reference is {u.min():.4g} to {u.max():.4g} {plan.law.reference.unit}")
            elif port.is_scaled:
                tell(f"the input is {port.both(float(u.min()), float(u.max()))}")
            if (seconds := u.size * granted.Ts) > _LONG_S:
                most = "at most " * (UNTIL in plan.details)
                end = time.strftime("%a %H:%M", time.localtime(time.time() + seconds))
                tell(f"the rig is held for {most}{timedelta(seconds=round(seconds))}, until {end}")
            path, run_id, rehearsal = _play(opened, plan, u, granted.Ts, port, tell, display)
        except KeyboardInterrupt as err:
            if not armed:
                raise
            raise InterruptedRunError(_interruption_sentence(opened, status.last_run)) from err
        except NoReplyError:
            raise
        except RigError as err:
            raise RigError(_reason(opened, err, way_out or reset_command(rig, connect))) from err
    verdict, shares = None, ""
    if _is_readable(path):
        verdict = data_verdict(recording := load(path))
        decided = control_run(recording) if plan.law else None
        shares = decided.shares if decided else ""
    synced = opened.last_run.synced if opened.last_run else 0
    return Collected(path, u.size, granted.Ts, verdict, run_id, rehearsal, synced, shares)


def _fitting(plan: Plan, rest_v: float, u_max: float, tell: Callable[[str], None]) -> Plan:
    """Return a plan with levels that are the same shares of the rig's range as before of 5 V.

    Levels of a rig that rests at another voltage than 0 V are on both sides of the rest; those of a
    step or a staircase begin at rest.
    """
    before = plan.details["low"], plan.details["high"]
    share, middle = u_max / U_MAX_V, 0.0
    if rest_v:
        from_rest = plan.experiment.startswith(("step", "staircase"))
        reach = (u_max - rest_v) if from_rest else min(rest_v, u_max - rest_v)
        share = 0.8 * (1 if from_rest else 2) * reach / (before[1] - before[0])
        middle = rest_v - (0.0 if from_rest else 0.8 * reach) - share * before[0]
    low, high = (middle + share * level for level in before)
    why = f"the rig rests at {rest_v:g} V" if rest_v else f"the rig allows at most {u_max:g} V"
    tell(f"{why}: the input is between {low:g} and {high:g} V")
    return replace(
        plan,
        make=lambda N, Ts: middle + share * plan.make(N, Ts),
        details={**plan.details, "low": low, "high": high},
    )


def _is_readable(path: Path) -> bool:
    """Return True if a recording is on this machine and this user may read it."""
    try:
        return all(part.is_file() and os.access(part, os.R_OK) for part in part_paths(path))
    except PermissionError:  # not even the folder is readable
        return False


def _play(
    rig: Rig,
    plan: Plan,
    u: NDArray[Any],
    Ts: float,
    port: Input,
    tell: Callable[[str], None],
    display: Shown,
) -> tuple[Path, str, Rehearsal | None]:
    """Play an input and show its progress; return the recording, the run id and the rehearsal."""
    N = u.size * rig.every
    rehearsal: Rehearsal | None = None
    run_id, taken = "", 0

    def on_accepted(run: RunAccepted) -> None:
        nonlocal rehearsal, run_id
        rehearsal, run_id = run.rehearsal, run.run_id
        if rehearsal is not None:
            tell(rehearsal_sentence(rehearsal))

    until = _until_settled(rig, plan, Ts) if UNTIL in plan.details else nullcontext(bool)
    with display(rig, plan.experiment, N) as progress, until as settled:

        def on_progress(done: int, total: int) -> None:
            nonlocal taken
            taken = done
            progress(done, total)
            if run_id and plan.new_reference and (r := plan.new_reference()) is not None:
                try:
                    rig.set_reference(r)
                except RefusedError as err:
                    tell(str(err))
            if settled():
                raise _SettledError

        try:
            common: dict[str, Any] = {
                "experiment": plan.experiment,
                "details": plan.details,
                "accepted": on_accepted,
                "progress": on_progress,
                "tell": tell,
            }
            if plan.law is not None:
                path = rig.control(
                    plan.law,
                    u,
                    dead_man=plan.dead_man or DEAD_MAN_S[0],
                    unstable=plan.unstable,
                    unmonitored=plan.unmonitored,
                    **common,
                )
            else:
                path = rig.run(
                    **{port.name: port.value(u)} if port.rest_v else {"u": u},
                    pacing=plan.pacing,
                    dead_man=plan.dead_man,
                    **common,
                )
        except _SettledError:
            path = _after_the_stop(rig, run_id)
            tell("the outputs have settled: the rig is stopped")
        except NoReplyError as err:
            is_told = isinstance(err, LostLinkError) or service_has_stopped(rig.rig, rig.endpoint)
            if not run_id or is_told:
                raise
            msg = (
                f"the run was cut off after {taken} or more of {plural(N, 'sample')}: "
                f"{err}; what was "
            )
            msg += "recorded is in `armrig ls`; start the rig with the options that it had before, "
            raise NoReplyError(f"{msg}then repeat the command") from err
    return path, run_id, rehearsal


class _SettledError(Exception):
    """The outputs have settled, so that the run may end."""


@contextmanager
def _until_settled(rig: Rig, plan: Plan, Ts: float) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether the outputs have settled after the plan's step."""
    channels, at = rig.status().described.channels, float(plan.details["at"])
    settling = Settling(channels, at, Ts / rig.every)
    with rig.arrivals("sample") as samples:

        def is_settled() -> bool:
            settling.add(samples())
            return settling.has_settled()

        yield is_settled


def _after_the_stop(rig: Rig, run_id: str) -> Path:
    """Return the recording of a run that this client has stopped, when it is complete."""
    until = time.monotonic() + _FINISH_TIMEOUT_S
    while (last := rig.status().last_run) is None or last.run_id != run_id or not last.finished:
        if time.monotonic() > until:
            raise RigError(f"the recording of the run {run_id} is not finished: see `armrig ls`")
        time.sleep(_POLL_INTERVAL_S)
    return Path(last.recording)


ARM_OFF = (
    "remove the rotating part (handout, figure 6), set [arm] removed = true in armrigd's "
    "configuration (for an emulated rig also [emulator] arm_removed = true), and restart armrigd"
)
"""Instructions to the user, to remove the arm before an experiment without it."""


def make_input(plan: Plan, Ts: float, tell: Callable[[str], None]) -> NDArray[Any]:
    """Return the input of a plan at Ts; report a length that differs from the requested length."""
    if plan.seconds is None:
        u = plan.make(0, Ts)
        number_of_samples(u.size * Ts, Ts)
        return u
    u = plan.make(number_of_samples(plan.seconds, Ts), Ts)
    if not isclose(u.size * Ts, plan.seconds, rel_tol=1e-9):
        tell(
            f"{plan.seconds:g} s is not a whole number of samples of {Ts:g} s: "
            f"{plural(u.size, 'sample is', 'samples are')} played, {u.size * Ts:g} s"
        )
    return u


def _reason(rig: Rig, err: RigError, way_out: str) -> str:
    # After a safety trip, `err` reports only the loss of the lease.
    try:
        status = rig.status()
    except NoReplyError as gone:
        stopped = service_has_stopped(rig.rig, rig.endpoint)
        is_said = isinstance(err, ServiceStoppedError)
        return f"{err}; {gone}" if stopped and not is_said else str(err)
    except RigError:
        return str(err)
    if status.phase != "fault":
        again = (
            "; no fault is latched: repeat the command" if isinstance(err, RunEndedError) else ""
        )
        return refusal_sentence(err, way_out) + again
    remedy = f"{status.remedy or 'repair it'}; then {way_out}"
    if isinstance(err, RunEndedError):
        return f"{err}; {remedy}"
    return f"rig {rig.rig} is in fault: {status.reason}; {remedy}"


def _interruption_sentence(rig: Rig, before: LastRun | None) -> str:
    """Wait for the recording of an interrupted run, and return a sentence on its state."""
    stopped = f"interrupted: a stop (0 V) was sent to rig {rig.rig}"
    until = time.monotonic() + _FINISH_TIMEOUT_S
    try:
        while True:
            last = rig.status().last_run
            if last is None or (before is not None and last.run_id == before.run_id):
                return f"{stopped}; nothing was recorded"
            if last.finished:
                samples = plural(
                    last.samples, "sample before the stop is", "samples before the stop are"
                )
                return f"{stopped}; the {samples} in {last.recording}"
            if time.monotonic() > until:
                return f"{stopped}; its recording is still being written: {last.recording}"
            time.sleep(_POLL_INTERVAL_S)
    except RigError:
        return f"{stopped}, but its daemon does not answer: look at the rig"
