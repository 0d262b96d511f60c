"""What daemons of this rig left unfinished is recovered, while the rig is served already."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from armrig_core.recording_file.recovery import Recovery, sentence
from armrig_core.recording_file.unfinished import (
    NotOursError,
    RecoveryError,
    remove_copies,
    unfinished,
)


class Line(NamedTuple):
    """What is said of a file."""

    level: str
    text: str


class LeftOver:
    """Recovers one file after the other in a thread of its own, which nobody waits for."""

    def __init__(self, directory: Path, rig: str, changed: Callable[[], None]) -> None:
        """Look at nothing yet; `changed` is called, from the thread, when something can be said."""
        self._directory = directory
        self._rig = rig
        self._changed = changed
        self._lines: queue.SimpleQueue[Line] = queue.SimpleQueue()
        self._may_go_on = threading.Event()
        self._may_go_on.set()
        self._thread = threading.Thread(target=self._recover, name="left over", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def rest(self) -> None:
        """Do nothing until `go_on`, from the next record on: a run is in hand, and comes first."""
        self._may_go_on.clear()

    def go_on(self) -> None:
        """Go on."""
        self._may_go_on.set()

    def lines(self) -> Iterator[Line]:
        """Give what has not been said yet."""
        while not self._lines.empty():
            yield self._lines.get()

    def join(self, timeout: float | None = None) -> None:
        """Wait until all are done, or for `timeout` s."""
        self._thread.join(timeout)

    def _breath(self) -> None:
        self._may_go_on.wait()

    def _recover(self) -> None:
        recovery = Recovery(
            armrig=version("armrig"),
            now=lambda: datetime.now(UTC).astimezone().isoformat(timespec="milliseconds"),
            owner=os.geteuid(),
            rig=self._rig,
            breath=self._breath,
        )
        for path in unfinished(self._directory, self._rig):
            try:
                line = Line("info", sentence(recovery.recover(path)))
            except NotOursError:
                continue
            except RecoveryError as err:
                line = Line("warning", str(err))
            except Exception as err:  # one file must not keep the others from being recovered
                line = Line("error", f"{path}: {err!r}; it stays as it is")
            self._tell(line)
        for path in remove_copies(self._directory, self._rig, os.geteuid()):
            self._tell(Line("info", f"{path}: half a copy of a whole recording, removed"))

    def _tell(self, line: Line) -> None:
        # A path may have any bytes, a message is UTF-8.
        self._lines.put(Line(line.level, os.fsencode(line.text).decode(errors="replace")))
        self._changed()
