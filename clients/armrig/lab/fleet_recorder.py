"""One recorder for many rigs: each in a thread and in files of its own.

Whatever becomes of one, the others are recorded on.
"""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

import zenoh
from armrig_core.codes import COMPLETE

from armrig.rig.live_rigs import ids_alive
from armrig.rig.remote_recorder import Ended, RemoteRecorder
from armrig.rig.remote_recording import (
    DiskError,
    RecordedFile,
    RemoteRecording,
    Tell,
    recorder_ended,
)

_LOOK_S = 1.0
_ASK_S = 0.2
_AGAIN_S = 60.0
"""Least time between the end of a rig's recording by a full disk and its next one, in s."""
_ROOM = 64 << 20
"""Free space that this next recording needs, in B."""


@dataclass(slots=True)
class RigRecorded:
    """What became of one rig."""

    rig: str
    files: list[RecordedFile]
    why: str = ""
    """Why its recording ended before the others; empty where it did not."""
    again_s: float = float("inf")
    """Earliest time of its next recording, on the monotonic clock; inf if there is none."""


class FleetRecorder:
    """Records the rigs of a session, each from when it is there."""

    def __init__(
        self,
        session: zenoh.Session,
        endpoint: str,
        path_of: Callable[[str], Path],
        tell: Tell,
        tell_error: Tell,
    ) -> None:
        """Record nobody yet.

        Parameters
        ----------
        endpoint : str
            Of the router, as the files name it.
        path_of : callable
            Returns the path of a rig's first file.
        tell, tell_error : callable
            Called with a line for a person, by one thread at a time; the second one if the
            recording of a rig ended early.
        """
        self._session, self._endpoint = session, endpoint
        self._path_of, self._tell_person, self._tell_error = path_of, tell, tell_error
        self._telling = threading.Lock()
        self._ended = threading.Event()
        self._threads: dict[str, threading.Thread] = {}
        self._recorded: dict[str, RigRecorded] = {}

    def record(
        self, ended: Ended, seconds: float | None, rigs: Collection[str] | None
    ) -> list[RigRecorded]:
        """Record until `ended` is set, or for `seconds`; return what became of each rig.

        Parameters
        ----------
        rigs : collection of str, optional
            Their ids; None are all that are there, and those that come. Where the recordings of
            all these have ended early, nothing is waited for.
        """
        until = float("inf") if seconds is None else time.monotonic() + seconds
        try:
            while not ended.is_set() and (now := time.monotonic()) < until:
                for rig in ids_alive(self._session) if rigs is None else rigs:
                    self._begin(rig)
                if rigs is not None and not any(t.is_alive() for t in self._threads.values()):
                    break
                ended.wait(min(_LOOK_S, until - now))
        finally:
            self._ended.set()
        for thread in self._threads.values():
            thread.join()
        return [self._recorded[rig] for rig in sorted(self._recorded)]

    def _tell(self, text: str) -> None:
        with self._telling:
            self._tell_person(text)

    def _fail(self, recorded: RigRecorded, err: Exception) -> None:
        recorded.why = str(err)
        if isinstance(err, DiskError):
            recorded.again_s = time.monotonic() + _AGAIN_S
        with self._telling:
            self._tell_error(f"rig {recorded.rig}: its recording ended: {err}")

    def _may_begin(self, rig: str) -> bool:
        """Return whether a rig may be recorded: the first time, or after a full disk has room."""
        if rig not in self._threads:
            return True
        if self._threads[rig].is_alive() or time.monotonic() < self._recorded[rig].again_s:
            return False
        try:
            return shutil.disk_usage(self._path_of(rig).parent).free >= _ROOM
        except OSError:
            return False

    def _begin(self, rig: str) -> None:
        if not self._may_begin(rig):
            return
        self._recorded.setdefault(rig, RigRecorded(rig, []))
        self._threads[rig] = thread = threading.Thread(
            target=self._record, args=(self._recorded[rig],), name=f"rig {rig}", daemon=True
        )
        thread.start()

    def _record(self, recorded: RigRecorded) -> None:
        rig = recorded.rig
        recording = RemoteRecording(
            path=self._path_of(rig),
            rig=rig,
            endpoint=self._endpoint,
            tell=lambda text: self._tell(text if text.startswith("rig ") else f"rig {rig}: {text}"),
        )
        recorded.again_s = float("inf")
        ended, error = COMPLETE, None
        try:
            recorder = RemoteRecorder(self._session, recording)
            while not recorder.begin():
                if self._ended.wait(_ASK_S):
                    break
            else:
                self._tell(f"recording rig {rig}")
                recorder.record(self._ended)
        except (RuntimeError, OSError) as err:
            ended, error = recorder_ended(err), err
        try:
            recording.finish(ended)
        except (RuntimeError, OSError) as err:
            error = error or err  # a full disk refuses the end of the file, too
        recorded.files += recording.done
        if error is not None:
            self._fail(recorded, error)
