"""Recorder for many rigs, with a separate thread and separate files for each rig.

If the recording of one rig fails, the recordings of the other rigs continue.
"""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

import zenoh
from armrig_core.commands.codes import COMPLETE

from armrig.rig.remote_recording import (
    DiskError,
    Ended,
    RecordedFile,
    RemoteRecorder,
    RemoteRecording,
    Tell,
    recorder_ended,
)
from armrig.rig.status import ids_alive

_LOOK_INTERVAL_S = 1.0
_BEGIN_INTERVAL_S = 0.2
_DISK_PAUSE_S = 60.0
"""Least pause, in s, between a recording that a full disk ended and the rig's next recording."""
_MIN_FREE_BYTES = 64 << 20
"""Free space, in B, needed to record a rig again after a full disk ended its recording."""


@dataclass(slots=True)
class RigRecorded:
    """Result of one rig's recording."""

    rig: str
    files: list[RecordedFile]
    why: str = ""
    """Reason for an early end; "" if the recording did not end early."""
    again_s: float = float("inf")
    """Earliest start of the rig's next recording, in s of the monotonic clock; inf for none."""


class FleetRecorder:
    """Recorder of all rigs in a session; a rig is recorded as soon as it appears."""

    def __init__(
        self,
        session: zenoh.Session,
        endpoint: str,
        path_of: Callable[[str], Path],
        tell: Tell,
        tell_error: Tell,
    ) -> None:
        """Prepare a recorder; no recording begins yet.

        Each recording contains the router's endpoint. `path_of` returns the path of a rig's first
        file. One thread at a time calls `tell` with a message for the user, and `tell_error` if the
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
        """Record until `ended` is set or `seconds` have passed; return the result of each rig.

        Without ids, all rigs are recorded, also those that appear later. With ids, the function
        also returns when the recordings of all these rigs have ended early.
        """
        until = float("inf") if seconds is None else time.monotonic() + seconds
        try:
            while not ended.is_set() and (now := time.monotonic()) < until:
                for rig in ids_alive(self._session) if rigs is None else rigs:
                    self._begin(rig)
                if rigs is not None and not any(t.is_alive() for t in self._threads.values()):
                    break
                ended.wait(min(_LOOK_INTERVAL_S, until - now))
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
            recorded.again_s = time.monotonic() + _DISK_PAUSE_S
        with self._telling:
            self._tell_error(f"rig {recorded.rig}: its recording ended: {err}")

    def _may_begin(self, rig: str) -> bool:
        """Return True for a rig's first recording, and if a disk that was full has space again."""
        if rig not in self._threads:
            return True
        if self._threads[rig].is_alive() or time.monotonic() < self._recorded[rig].again_s:
            return False
        try:
            return shutil.disk_usage(self._path_of(rig).parent).free >= _MIN_FREE_BYTES
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
                if self._ended.wait(_BEGIN_INTERVAL_S):
                    break
            else:
                self._tell(f"recording rig {rig}")
                recorder.record(self._ended)
        except (RuntimeError, OSError) as err:
            ended, error = recorder_ended(err), err
        try:
            recording.finish(ended)
        except (RuntimeError, OSError) as err:
            error = error or err  # a full disk also refuses the end of the file
        recorded.files += recording.done
        if error is not None:
            self._fail(recorded, error)
