"""One collection: arm, play, record; and the reason where it does not end well."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from math import floor, isclose, isfinite
from pathlib import Path
from typing import Any, Literal, NamedTuple

from armrig_core.codes import RefusalCode
from armrig_core.commands import MOST_SAMPLES, LastRun, RunAccepted, StatusReport
from armrig_core.errors import InputError
from armrig_core.recording_file.part_names import part_paths
from armrig_core.rehearsal import Rehearsal, sentence
from numpy.typing import NDArray

from armrig.recordings.loading import load
from armrig.recordings.usability import DataVerdict, data_verdict
from armrig.rig.client import Rig
from armrig.rig.progress import bar, timing_note
from armrig.rig.replies import Progress, RefusedError, RunEndedError
from armrig.rig.session import NoReplyError, RigError, service_has_stopped

Shown = Callable[[Rig, str, int], AbstractContextManager[Progress]]
"""Takes the rig, the kind of experiment and N; gives, in a `with` block, what is told of progress.
"""

LONGEST_TS = 1.0
"""Longest sampling time that the daemon takes, in s."""
LONGEST_OWNER = 80
DEAD_MAN_S = (0.5, 60.0)
"""Shortest and longest dead-man that the daemon takes."""
_FINISHED_S = 2.0  # how long a stopped run may take to be complete on the disk
_POLL_S = 0.05


class InterruptedRunError(KeyboardInterrupt):
    """Ctrl-C in a collection; the message says how the rig was left and where the recording is."""


class Collected(NamedTuple):
    """A collection that ended well."""

    path: Path
    samples: int
    """Samples asked for."""
    Ts: float
    """Sampling time, in s."""
    verdict: DataVerdict | None
    """What the data are good for; None where the daemon's disk is not ours to read."""
    run_id: str
    """Id of the run, part of the recording's name."""
    rehearsal: Rehearsal | None
    """What the daemon's model of the rig did; None from a daemon that rehearses nothing."""
    synced: int = 0
    """Samples that are on the disk; 0 from a daemon that does not say."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What to play, and for whom."""

    experiment: str
    """Kind of experiment, part of the recording's name."""
    make: Callable[[int, float], NDArray[Any]]
    """N and Ts in s -> u in V; (N,), or whatever whole periods in N or a file make."""
    details: Mapping[str, Any]
    """What the input was made of, so that the same can be made again."""
    seconds: float | None
    """Length, in s; None is the input's own, and N is then 0."""
    Ts: float | None
    """Sampling time in s; None is the daemon's."""
    pacing: Literal["scheduled", "exchange"]
    """Who makes the samples."""
    owner: str
    """Who takes the rig."""
    dead_man: float | None = None
    """Silence of this process after which the daemon stops the run, in s; None plays on."""
    without_arm: bool = False
    """The experiment is for the chassis alone."""

    def __post_init__(self) -> None:
        """Refuse, before the daemon is asked, what is possible at no sampling time."""
        for name, value in (("--seconds", self.seconds), ("--Ts", self.Ts)):
            if value is not None and not (isfinite(value) and value > 0):
                raise InputError(f"{name} {value:g}: must be a number of seconds, more than 0")
        low, high = DEAD_MAN_S
        if self.dead_man is not None and not low <= self.dead_man <= high:
            raise InputError(
                f"--dead-man {self.dead_man:g}: must be {low:g} to {high:g} s, or 0 for none"
            )
        if self.Ts is not None and self.Ts > LONGEST_TS:
            raise InputError(
                f"--Ts {self.Ts:g}: at most {LONGEST_TS:g}, in seconds; of 10 ms it is --Ts 0.01"
            )
        if not 1 <= len(self.owner) <= LONGEST_OWNER:
            raise InputError(
                f"--owner has {len(self.owner)} characters: 1 to {LONGEST_OWNER} are allowed"
            )
        if self.seconds is None:
            return
        if self.Ts is not None or self.seconds > MOST_SAMPLES * LONGEST_TS:
            number_of_samples(self.seconds, self.Ts or LONGEST_TS)


def number_of_samples(seconds: float, Ts: float) -> int:
    """Return the whole number of samples nearest to a length.

    Raises
    ------
    ValueError
        There is not one sample, or there are more than one run may have.
    """
    N = floor(seconds / Ts + 0.5)
    if N < 1:
        raise InputError(
            f"--seconds {seconds:g}: too short for one sample of {Ts:g} s; at least {Ts:g}"
        )
    if N > MOST_SAMPLES:
        raise InputError(
            f"--seconds {seconds:g}: at most {MOST_SAMPLES} samples, that is "
            f"{MOST_SAMPLES * Ts:g} s at Ts = {Ts:g} s"
        )
    return N


@contextmanager
def on_the_terminal(rig: Rig, experiment: str, N: int) -> Iterator[Progress]:
    """Show the progress of a run of N samples as a bar, its timing behind it."""
    with timing_note(rig, N) as note, bar(experiment, note=note) as progress:
        yield progress


def collect(
    plan: Plan,
    *,
    rig: str,
    connect: str | None,
    tell: Callable[[str], None],
    shown: Shown = on_the_terminal,
    way_out: str = "",
) -> Collected:
    """Arm, play, record, and return what was recorded; tell the rehearsal when the run begins.

    Parameters
    ----------
    way_out : str, optional
        What a person does to leave a fault; by default the command that resets this rig.

    Raises
    ------
    InterruptedRunError
        Ctrl-C after the rig was armed; the rig has been told to stop.
    RigError
        The run was refused, or ended early; the message says why, and what to do.
    ValueError
        The length is not possible at the sampling time in force. The rig is given back.
    """
    with Rig(rig, connect=connect) as opened:
        status = opened.status()
        if plan.without_arm:
            _require_arm_off(status)
        elif status.arm_removed:
            tell(f"rig {status.rig} has no arm ([arm] removed): this is the chassis alone")
        armed = False
        try:
            granted = opened.arm(plan.owner, plan.Ts)
            armed = True
            u = planned_input(plan, granted.Ts, tell)
            path, run_id, rehearsal = _played(opened, plan, u, tell, shown)
        except KeyboardInterrupt as err:
            if not armed:
                raise
            raise InterruptedRunError(_interrupted_sentence(opened, status.last_run)) from err
        except NoReplyError:
            raise
        except RigError as err:
            raise RigError(_reason(opened, err, way_out or reset_command(rig, connect))) from err
    verdict = data_verdict(load(path)) if _is_readable(path) else None
    synced = opened.last_run.synced if opened.last_run else 0
    return Collected(path, u.size, granted.Ts, verdict, run_id, rehearsal, synced)


def _is_readable(path: Path) -> bool:
    """Tell whether a recording is on this machine, and ours to read: who drives need not be."""
    try:
        return all(part.is_file() and os.access(part, os.R_OK) for part in part_paths(path))
    except PermissionError:  # not even its folder
        return False


def _played(
    rig: Rig, plan: Plan, u: NDArray[Any], tell: Callable[[str], None], shown: Shown
) -> tuple[Path, str, Rehearsal | None]:
    """Play an input, show its progress; return recording, run id, and what was rehearsed."""
    rehearsal: Rehearsal | None = None
    run_id, taken = "", 0

    def accepted(run: RunAccepted) -> None:
        nonlocal rehearsal, run_id
        rehearsal, run_id = run.rehearsal, run.run_id
        if rehearsal is not None:
            tell(sentence(rehearsal))

    with shown(rig, plan.experiment, u.size) as progress:

        def counted(done: int, total: int) -> None:
            nonlocal taken
            taken = done
            progress(done, total)

        try:
            path = rig.run(
                u,
                pacing=plan.pacing,
                experiment=plan.experiment,
                details=plan.details,
                dead_man=plan.dead_man,
                accepted=accepted,
                progress=counted,
            )
        except NoReplyError as err:
            if not run_id or service_has_stopped(rig.rig, rig.endpoint):
                raise
            msg = f"the run was cut off after {taken} or more of {u.size} samples: {err}; what was "
            msg += "recorded is in `armrig ls`; start the rig with the options that it had before, "
            raise NoReplyError(f"{msg}then repeat the command") from err
    return path, run_id, rehearsal


ARM_OFF = (
    "take the rotating part off (handout, figure 6), set [arm] removed = true in armrigd's "
    "configuration (of an emulated rig [emulator] arm_removed = true, too), and start it anew"
)
"""What a person does before an experiment on the chassis alone."""


def _require_arm_off(status: StatusReport) -> None:
    """Refuse a rig whose daemon was not told that the arm is off."""
    if not status.arm_removed:
        raise RigError(
            f"this is for the chassis alone, and rig {status.rig} has its arm on: {ARM_OFF}"
        )


def planned_input(plan: Plan, Ts: float, tell: Callable[[str], None]) -> NDArray[Any]:
    """Return the input at the sampling time in force, and tell where its length is not as asked."""
    if plan.seconds is None:
        u = plan.make(0, Ts)
        number_of_samples(u.size * Ts, Ts)
        return u
    u = plan.make(number_of_samples(plan.seconds, Ts), Ts)
    if not isclose(u.size * Ts, plan.seconds, rel_tol=1e-9):
        tell(
            f"{plan.seconds:g} s is not a whole number of samples of {Ts:g} s: "
            f"{u.size} samples are played, {u.size * Ts:g} s"
        )
    return u


def refusal_sentence(err: RigError, way_out: str) -> str:
    """Return why a command was refused; of a latched fault with the whole way out of it."""
    if isinstance(err, RefusedError) and err.code == RefusalCode.IN_FAULT:
        return f"in fault ({err.parameters.get('reason', '')}): mend it, then {way_out}"
    return str(err)


def reset_command(rig: str, connect: str | None) -> str:
    """Return what a person types to reset this very rig."""
    words = ["armrig", "reset"]
    if rig != "1":
        words += ["--rig", rig]
    if connect:
        words += ["--connect", connect]
    return f"`{' '.join(words)}`"


def _reason(rig: Rig, err: RigError, way_out: str) -> str:
    """Return why a collection failed. Of a trip the error shows only that lease or run are gone."""
    try:
        status = rig.status()
    except NoReplyError as gone:
        stopped = service_has_stopped(rig.rig, rig.endpoint)
        return f"{err}; {gone}" if stopped and stopped not in str(err) else str(err)
    except RigError:
        return str(err)
    if status.phase != "fault":
        again = "; nothing is latched: repeat the command" if isinstance(err, RunEndedError) else ""
        return refusal_sentence(err, way_out) + again
    remedy = f"{status.remedy or 'mend it'}; then {way_out}"
    if isinstance(err, RunEndedError):
        return f"{err}; {remedy}"
    return f"rig {rig.rig} is in fault: {status.reason}; {remedy}"


def _interrupted_sentence(rig: Rig, before: LastRun | None) -> str:
    """Return how an interrupted run has left the rig, once its recording is finished."""
    stopped = f"interrupted: rig {rig.rig} was told to stop (0 V)"
    until = time.monotonic() + _FINISHED_S
    try:
        while True:
            last = rig.status().last_run
            if last is None or (before is not None and last.run_id == before.run_id):
                return f"{stopped}; nothing was recorded"
            if last.finished:
                return f"{stopped}; the {last.samples} samples until then are in {last.recording}"
            if time.monotonic() > until:
                return f"{stopped}; its recording is still being written: {last.recording}"
            time.sleep(_POLL_S)
    except RigError:
        return f"{stopped}, but its daemon does not answer: look at the rig"
