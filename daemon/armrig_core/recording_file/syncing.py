"""Syncs of a recording, in a thread of their own: no flush waits for a slow disk."""

from __future__ import annotations

import queue
import threading
import time
from math import inf
from pathlib import Path

from armrig_core.recording_file.recording_part import Part


class Syncer:
    """Thread that syncs the parts of a recording, in their order."""

    def __init__(self) -> None:
        """Start the thread."""
        self.synced = 0
        """Number of samples that are safely on the disk."""
        self.error: Exception | None = None
        """First failure; nothing is synced after the failure."""
        self.failed = Path()
        """Path of the file of the first failure."""
        self.begun_s = inf
        """Monotonic time at which the current sync began; inf between two syncs."""
        self.ended_s = -inf
        """Monotonic time at which the last sync ended; inf after a request."""
        self._requests: queue.SimpleQueue[tuple[Part, int, bool] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._sync, name="sync", daemon=True)
        self._thread.start()

    def request(self, part: Part, samples: int, *, is_complete: bool = False) -> None:
        """Request the sync of the first `samples` samples; a complete part is then named."""
        self.ended_s = inf
        self._requests.put((part, samples, is_complete))

    def join(self) -> None:
        """End the thread after the requested syncs; raise the first failure."""
        self._requests.put(None)
        self._thread.join()
        if self.error is not None:
            raise self.error

    def _sync(self) -> None:
        while (request := self._requests.get()) is not None:
            part, samples, is_complete = request
            self.begun_s = time.monotonic()
            try:
                if self.error is None:
                    if is_complete:
                        part.sync_all()
                        part.follow()
                        part.name()
                    else:
                        part.sync()
                    self.synced = samples
            except Exception as err:
                self.failed, self.error = part.path if part.is_named else part.active, err
            if self.error is not None and is_complete:
                part.give_up()
            self.begun_s, self.ended_s = inf, time.monotonic()
