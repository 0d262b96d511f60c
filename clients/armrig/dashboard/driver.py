"""What the page does to the rig, by the same client as the command line's."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from math import inf
from typing import Any

import msgspec
from armrig_core.errors import OperationError

from armrig.rig.client import Rig
from armrig.rig.collection import Plan, collect
from armrig.rig.replies import Progress
from armrig.rig.session import NoReplyError, RigError


class RunState(msgspec.Struct, frozen=True, kw_only=True):
    """The run that the page has begun, or its last one."""

    experiment: str = ""
    is_going: bool = False
    done: int = 0
    total: int = 0
    told: str = ""
    """What the rehearsal said."""
    recording: str = ""
    """Name of the file, once it is whole."""
    verdict: str = ""
    """What the data are good for."""
    error: str = ""
    """Why it did not end well."""


class BusyDriverError(OperationError):
    """The page does something to the rig already."""


class Driver:
    """Arms, runs and releases, one after the other; and stops beside all that."""

    def __init__(self, *, rig: str, connect: str | None) -> None:
        """Take the rig's id and endpoint, as `armrig.Rig` does."""
        self._rig, self._connect = rig, connect
        self._held: Rig | None = None
        self._one = threading.Lock()
        self._stopper: Rig | None = None
        self._stopping = threading.Lock()
        self._stopped: tuple[float, str] = (-inf, "")  # when last, and by whom
        self._runner = ThreadPoolExecutor(1, thread_name_prefix="run")
        self.run = RunState()
        """The newest run of this page."""

    def arm(self, owner: str, Ts: float | None) -> None:
        """Take the rig, at 0 V; without a command it falls back by itself.

        Raises
        ------
        RigError
            It is refused, or nobody answers.
        BusyDriverError
            A run is on.
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
        """Give the rig back where this page has it; return whether it had."""
        with self._alone():
            return self._give_back()

    def start(self, plan: Plan, *, asked_s: float) -> None:
        """Begin a run, which goes on in a thread; `run` says how it is.

        Parameters
        ----------
        asked_s : float
            When it was asked for, of `time.monotonic`: a stop that came later holds for it.

        Raises
        ------
        BusyDriverError
            Another one is on.
        """
        if not self._one.acquire(blocking=False):
            raise BusyDriverError(_BUSY)
        before, self.run = self.run, RunState(experiment=plan.experiment, is_going=True)
        try:
            self._runner.submit(self._played, plan, asked_s)
        except RuntimeError as err:
            self.run = before
            self._one.release()
            raise BusyDriverError(_ENDS) from err

    def stop(self, by: str) -> None:
        """Bring the rig to 0 V, whoever has it; waits for nothing else that the page does.

        Raises
        ------
        RigError
            Nobody answers.
        """
        # The daemon stops what is armed. A run that is not yet is turned away by us: see `_shown`.
        self._stopped = time.monotonic(), by
        with self._stopping:
            for last in (False, True):
                try:
                    self._open_stopper().stop(by)
                except NoReplyError:
                    # The way to a daemon that was started anew is opened anew, once.
                    self._close_stopper()
                    if last:
                        raise
                else:
                    return

    def be_ready_to_stop(self) -> None:
        """Open the way to the rig anew, so that a stop need not; where there is a rig."""
        opened = Rig(self._rig, connect=self._connect)
        try:
            opened.__enter__()
        except RigError:
            return
        with self._stopping:
            self._close_stopper()
            self._stopper = opened

    def reset(self) -> bool:
        """Leave a latched fault; return whether there was one."""
        with Rig(self._rig, connect=self._connect) as rig:
            return rig.reset()

    def note(self, text: str, owner: str) -> bool:
        """Write a note into the recording; return whether there is one: see `Rig.note`."""
        with Rig(self._rig, connect=self._connect) as rig:
            return rig.note(text, owner)

    def end(self) -> None:
        """Stop a run that is on, take no other, and give the rig back."""
        self._runner.shutdown(wait=False)  # first: a run that began behind the stop would go on
        if self.run.is_going:
            with suppress(RigError):  # then its dead-man stops it
                self.stop("the dashboard, which ends")
        self._runner.shutdown(wait=True)
        with self._one:  # who arms has it back in a moment
            self._give_back()
        self._close_stopper()

    def _played(self, plan: Plan, asked_s: float) -> None:
        try:
            self._give_back()
            done = collect(
                plan,
                rig=self._rig,
                connect=self._connect,
                tell=self._tell,
                shown=partial(self._shown, asked_s),
                way_out="press Reset",
            )
            verdict = done.verdict.summary if done.verdict else ""
            self._note(done=done.samples, recording=done.path.name, verdict=verdict)
        except Exception as err:  # told on the page, whatever it is
            self._note(error=str(err) or repr(err))
        finally:
            self._note(is_going=False)
            self._one.release()

    @contextmanager
    def _shown(self, asked_s: float, rig: Rig, experiment: str, N: int) -> Iterator[Progress]:
        # It is armed by now, at 0 V: the daemon refuses the run after a stop from here on.
        stopped_s, by = self._stopped
        if stopped_s >= asked_s:
            raise RigError(f"not begun: stopped by {by or 'somebody'}")
        yield lambda done, total: self._note(done=done, total=total)

    def _tell(self, text: str) -> None:
        self._note(told=text)

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


_ENDS = "the dashboard ends"
_BUSY = "this page does something to the rig already: wait for its end, or stop it"
