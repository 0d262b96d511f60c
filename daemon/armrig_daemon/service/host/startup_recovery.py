"""Maintenance of the folder of recordings while the service runs.

First the unfinished recordings of this rig's earlier daemons are recovered. Then recordings beyond
the configured limits are removed: at the start, after each run and every hour.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from armrig_core.recording_file.recovery import Recovery, sentence
from armrig_core.recording_file.retention import Retention
from armrig_core.recording_file.unfinished import (
    NotOursError,
    RecoveryError,
    remove_copies,
    unfinished_files,
)

from armrig_daemon.config import RecordingTable

_RETENTION_PERIOD_S = 3600.0


class StartupRecovery:
    """Thread that recovers and removes files, one after the other; no other thread waits for it."""

    def __init__(
        self,
        directory: Path,
        rig: str,
        changed: Callable[[], None],
        config: RecordingTable = RecordingTable(),  # noqa: B008 - frozen
    ) -> None:
        """Create the thread, but do not start it; it calls `changed` after each new log line."""
        self._directory = directory
        self._rig = rig
        self._changed = changed
        self._lines: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
        self._may_go_on = threading.Event()
        self._may_go_on.set()
        self._is_due = threading.Event()
        self._retention = Retention(
            folder=directory,
            rig=rig,
            keep_days=config.keep_days,
            keep_gb=config.keep_gb,
            owner=os.geteuid(),
            breath=self._breath,
        )
        self._thread = threading.Thread(target=self._look_after, name="left over", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def rest(self) -> None:
        """Pause at the next record, because a run has priority; `go_on` ends the pause."""
        self._may_go_on.clear()
        self._is_due.set()

    def go_on(self) -> None:
        """Continue after a pause."""
        self._may_go_on.set()

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield level and text of the lines for the log that are new since the last call."""
        while not self._lines.empty():
            yield self._lines.get()

    def join(self, timeout: float | None = None) -> None:
        """Wait until all files are processed, but at most for `timeout` s."""
        self._thread.join(timeout)

    def _breath(self) -> None:
        self._may_go_on.wait()

    def _look_after(self) -> None:
        self._recover()
        while self._retention.is_asked:
            self._is_due.clear()
            self._breath()
            try:
                for is_removed, text in self._retention.apply(time.time()):
                    self._tell("info" if is_removed else "warning", text)
            except Exception as err:  # the next attempt may succeed
                self._tell("error", f"recordings are kept longer than configured: {err!r}")
            self._is_due.wait(_RETENTION_PERIOD_S)

    def _recover(self) -> None:
        recovery = Recovery(
            armrig=version("armrig"),
            now=lambda: datetime.now(UTC).astimezone().isoformat(timespec="milliseconds"),
            owner=os.geteuid(),
            rig=self._rig,
            breath=self._breath,
        )
        for path in unfinished_files(self._directory, self._rig):
            try:
                line = "info", sentence(recovery.recover(path))
            except NotOursError:
                continue
            except RecoveryError as err:
                line = "warning", str(err)
            except Exception as err:  # one file must not prevent the recovery of the others
                line = "error", f"{path}: {err!r}; the file stays as it is"
            self._tell(*line)
        for path in remove_copies(self._directory, self._rig, os.geteuid()):
            self._tell("info", f"{path}: incomplete copy of a complete recording, removed")

    def _tell(self, level: str, text: str) -> None:
        # A path may have any bytes, a message is UTF-8.
        self._lines.put((level, os.fsencode(text).decode(errors="replace")))
        self._changed()
