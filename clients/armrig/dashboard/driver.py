"""Commands of the page to the rig; the command line uses the same client, `armrig.Rig`."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from math import inf
from queue import Empty, SimpleQueue
from typing import Any

import msgspec
from armrig_core.errors import OperationError

from armrig.rig.client import Rig
from armrig.rig.collection import Plan, collect
from armrig.rig.replies import Progress, RunEndedError
from armrig.rig.session import NoReplyError, RigError


class RunState(msgspec.Struct, frozen=True, kw_only=True):
    """Current or last run that the page started."""

    experiment: str = ""
    is_going: bool = False
    reference: str = ""
    """Values of r that a run under a law allows, with their unit; "" for another run."""
    done: int = 0
    total: int = 0
    told: str = ""
    """Sentence that describes the rehearsal."""
    recording: str = ""
    """Name of the recording, also if the run ended early."""
    verdict: str = ""
    """Verdict on the data."""
    error: str = ""
    """Reason for a failure; "" without a failure."""


class BusyDriverError(OperationError):
    """Another command of the page is in progress."""


class CommandSender:
    """Sender of the page's commands, one at a time: arm, run, release. A stop is sent at once."""

    def __init__(self, *, rig: str, connect: str | None) -> None:
        """Prepare commands to a rig; the arguments have the same meaning as for `armrig.Rig`."""
        self._rig, self._connect = rig, connect
        self._held: Rig | None = None
        self._one = threading.Lock()
        self._stopper: Rig | None = None
        self._stopping = threading.Lock()
        self._stopped: tuple[float, str] = (-inf, "")  # time and name of the last stop
        self._runner = ThreadPoolExecutor(1, thread_name_prefix="run")
        self._references: SimpleQueue[float] = SimpleQueue()
        self.run = RunState()
        """The newest run of this page."""

    def arm(self, owner: str, Ts: float | None) -> None:
        """Arm the rig at 0 V; the daemon disarms the rig if no command follows.

        Raises RigError if the daemon refuses, or does not answer. Raises BusyDriverError if a run
        is in progress.
        """
        with self._alone():
            self._give_back()
            held = Rig(self._rig, connect=self._connect)
            held.__enter__()
            try:
                held.arm(owner, Ts)
            except BaseException:
                held.__exit__()
                raise
            self._held = held

    def release(self) -> bool:
        """Release the rig if this page has armed the rig; return True if the rig was released."""
        with self._alone():
            return self._give_back()

    def start(self, plan: Plan, *, asked_s: float) -> None:
        """Start a run in a thread; the attribute `run` contains the state of the run.

        A stop after the time of the request, `asked_s` of `time.monotonic`, prevents the run.

        Raises BusyDriverError if another run is in progress.
        """
        if not self._one.acquire(blocking=False):
            raise BusyDriverError(_BUSY)
        begun = RunState(
            experiment=plan.experiment, is_going=True, reference=_allowed_references(plan)
        )
        before, self.run, self._references = self.run, begun, SimpleQueue()
        plan = replace(plan, new_reference=self._new_reference)
        try:
            self._runner.submit(self._played, plan, asked_s)
        except RuntimeError as err:
            self.run = before
            self._one.release()
            raise BusyDriverError(_ENDS) from err

    def set_reference(self, r: float) -> None:
        """Let the current run under a law follow another reference: see `Rig.set_reference`.

        `run.told` has the reason if the daemon refuses the reference.

        Raises BusyDriverError if no run of this page is under a law.
        """
        if not (self.run.is_going and self.run.reference):
            raise BusyDriverError("no run of this page is under a law: start such a run first")
        self._references.put(r)

    def _new_reference(self) -> float | None:
        with suppress(Empty):
            return self._references.get_nowait()
        return None

    def stop(self, by: str) -> None:
        """Stop the rig at 0 V, even if another client is the owner; do not wait for other commands.

        Raises RigError if no daemon answers.
        """
        # If the rig is armed, the daemon stops it. If not, `_shown` prevents the run.
        self._stopped = time.monotonic(), by
        with self._stopping:
            for last in (False, True):
                try:
                    self._open_stopper().stop(by)
                except NoReplyError:
                    # The connection to a restarted daemon is opened again, once.
                    self._close_stopper()
                    if last:
                        raise
                else:
                    return

    def be_ready_to_stop(self) -> None:
        """If the rig answers, open a connection for later stops, so that a stop is sent at once."""
        opened = Rig(self._rig, connect=self._connect)
        try:
            opened.__enter__()
        except RigError:
            return
        with self._stopping:
            self._close_stopper()
            self._stopper = opened

    def reset(self) -> bool:
        """Clear a latched fault; return True if there was a fault."""
        with Rig(self._rig, connect=self._connect) as rig:
            return rig.reset()

    def note(self, text: str, owner: str) -> bool:
        """Write a note; return True if the recording contains the note: see `Rig.note`."""
        with Rig(self._rig, connect=self._connect) as rig:
            return rig.note(text, owner)

    def end(self) -> None:
        """Stop the current run, accept no other run, and release the rig."""
        self._runner.shutdown(wait=False)  # first: otherwise a run could begin after the stop
        if self.run.is_going:
            with suppress(RigError):  # without an answer, the dead-man time ends the run
                self.stop("the dashboard, which ends")
        self._runner.shutdown(wait=True)
        with self._one:  # only a short command, such as arm, can be in progress
            self._give_back()
        self._close_stopper()

    def _played(self, plan: Plan, asked_s: float) -> None:
        try:
            self._give_back()
            done = collect(
                plan,
                rig=self._rig,
                connect=self._connect,
                tell=lambda text: self._note(told=text),
                display=partial(self._shown, asked_s),
                way_out="press Reset",
            )
            said = done.verdict.summary if done.verdict else "", done.shares
            verdict = "; ".join(filter(None, said))
            self._note(done=done.samples, recording=done.path.name, verdict=verdict)
        except Exception as err:  # the page shows any error
            ended = err if isinstance(err, RunEndedError) else err.__cause__
            if isinstance(ended, RunEndedError):
                # The page shows the remedy of a fault once, with the fault.
                self._note(error=ended.why, recording=ended.recording.name)
            else:
                self._note(error=str(err) or repr(err))
        finally:
            self._note(is_going=False)
            self._one.release()

    @contextmanager
    def _shown(self, asked_s: float, rig: Rig, experiment: str, N: int) -> Iterator[Progress]:
        # The rig is armed: the daemon now refuses the run if a stop comes.
        stopped_s, by = self._stopped
        if stopped_s >= asked_s:
            raise RigError(f"not started: stopped by {by or 'somebody'}")
        yield lambda done, total: self._note(done=done, total=total)

    def _note(self, **changed: Any) -> None:
        self.run = msgspec.structs.replace(self.run, **changed)

    def _give_back(self) -> bool:
        held, self._held = self._held, None
        if held is None:
            return False
        held.__exit__()
        return True

    @contextmanager
    def _alone(self) -> Iterator[None]:
        if not self._one.acquire(blocking=False):
            raise BusyDriverError(_BUSY)
        try:
            yield
        finally:
            self._one.release()

    def _open_stopper(self) -> Rig:
        if self._stopper is None:
            opened = Rig(self._rig, connect=self._connect)
            opened.__enter__()
            self._stopper = opened
        return self._stopper

    def _close_stopper(self) -> None:
        stopper, self._stopper = self._stopper, None
        if stopper is not None:
            stopper.__exit__()


def _allowed_references(plan: Plan) -> str:
    """Return the values of r that the run of a plan allows, as text; "" without a law."""
    if plan.law is None:
        return ""
    levels = [plan.details[name] for name in ("low", "high") if name in plan.details]
    values = " to ".join(f"{level:g}" for level in levels)
    return f"{values} {plan.law.reference.unit}".strip() or "r"


_ENDS = "the dashboard is ending"
_BUSY = "another command of this page is in progress: wait for its end, or stop the rig"
