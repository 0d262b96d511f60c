"""Syncs of a recording, in a thread of their own: no flush waits for a slow disk."""

from __future__ import annotations

import queue
import threading
import time
from math import inf

from armrig_core.recording_file.recording_part import Part


class Syncer:
    """Thread that syncs the parts of a recording, in their order."""

    def __init__(self) -> None:
        """Start the thread."""
        self.synced = 0
        """Number of samples that are safely on the disk."""
        self.error: Exception | None = None
        """First failure; nothing is synced after the failure."""
        self.begun_s = inf
        """Monotonic time at which the current sync began; inf between two syncs."""
        self.ended_s = -inf
        """Monotonic time at which the last sync ended."""
        self._requested = self._ended = 0  # each has one writer: the caller, and the thread
        self._requests: queue.SimpleQueue[tuple[Part, int, bool] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._sync_all, name="sync", daemon=True)
        self._thread.start()

    @property
    def is_idle(self) -> bool:
        """True if no sync is requested or in progress."""
        return self._requested == self._ended

    def request(self, part: Part, samples: int, *, settle: bool = False) -> None:
        """Request a sync, which makes `samples` samples of the run safe.

        If `settle` is True, the part is complete, and gets its final name after the sync.
        """
        self._requested += 1
        self._requests.put((part, samples, settle))

    def join(self) -> None:
        """End the thread after the requested syncs; raise the first failure."""
        self._requests.put(None)
        self._thread.join()
        if self.error is not None:
            raise self.error

    def _sync_all(self) -> None:
        while (request := self._requests.get()) is not None:
            part, samples, settle = request
            self.begun_s = time.monotonic()
            try:
                if self.error is None:
                    part.settle() if settle else part.sync()
                    self.synced = samples
            except Exception as err:
                self.error = err
            if settle and self.error is not None:
                part.give_up()
            # The next sync is due a while after the end: a slow disk is not synced all the time.
            self.begun_s, self.ended_s = inf, time.monotonic()
            self._ended += 1
