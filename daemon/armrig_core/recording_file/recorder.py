"""Recordings: one MCAP file a run, or several, safe on the disk up to the last flush.

Written to `NAME.mcap.active` and renamed when complete. A thread of its own writes, so that no
disk is ever waited for.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from armrig_core.codes import CONTINUED, Ending, OutcomeCode
from armrig_core.errors import ArmrigError
from armrig_core.manifest import INPUT, Manifest, Outcome
from armrig_core.recording_file.outgoing import Outgoing
from armrig_core.recording_file.part_names import ACTIVE, part_path
from armrig_core.recording_file.recording_part import EndsHereError, Part, RemovedError

FLUSH_S = 0.1
SYNC_S = 1.0
QUEUE = 10_000  # batches; what finds no room is counted and reported


class RecordingError(ArmrigError, OSError):
    """A recording cannot be begun; says where and why."""


class PartLimits(NamedTuple):
    """When a part ends, and the next one begins."""

    samples: int
    """After so many samples that were due."""
    size: int
    """Or at so many bytes."""


class Recording:
    """One open recording; its maker never waits for the disk, though the kernel takes its bytes."""

    def __init__(
        self,
        path: Path,
        manifest: Manifest,
        attachments: dict[str, bytes],
        *,
        t_first_ns: int,
        changed: Callable[[], None],
        limits: PartLimits | None = None,
    ) -> None:
        """Create the file with header, schemas, manifest and attachments, handed to the kernel.

        Parameters
        ----------
        path : Path
            Of the finished recording; must not exist.
        t_first_ns : int
            Monotonic time of the first sample.
        changed : callable
            Called from the writer's thread when `error`, `moved` or `done` has changed.
        limits : PartLimits, optional
            When parts end; the run is recorded in one file without them.

        Raises
        ------
        RecordingError
            The file cannot be made.
        """
        self.path = path
        self.samples = 0
        """Samples handed over."""
        self.synced = 0
        """Samples that are on the disk: whatever dies, they are there."""
        self.missing = 0
        """Samples that the gaps are short of, as far as they are written."""
        self.dropped = 0
        self.error = ""
        """What the disk refused, for a person; nothing more is written then."""
        self.moved = ""
        """That somebody moved the file, for a person; it is written on where it is."""
        self.done = False
        """Whether the file is complete and has its name, or has failed for good."""
        self._limits = limits
        # The input is in the first part alone, and may have 80 MB.
        self._attachments = {n: data for n, data in attachments.items() if n != INPUT}
        self._changed = changed
        self._parts: list[Part] = []
        self._written = self._flushed = 0  # samples
        self._queue: queue.SimpleQueue[list[Outgoing] | Ending] = queue.SimpleQueue()
        if limits is not None:
            manifest = replace(manifest, part=1, part_k_first=manifest.k_first)
        path = part_path(path, manifest.part)
        try:
            self._part = Part(path, manifest, attachments, t_first_ns)
        except OSError as err:
            where, way_out = f"{path}{ACTIVE}", "free the disk, or set [recording] directory"
            if isinstance(err, FileExistsError):
                where, way_out = err.filename, "set [recording] directory to another"
            raise RecordingError(f"{where}: {err.strerror}; {way_out}") from err
        self._thread = threading.Thread(target=self._write, name="recording", daemon=True)
        self._thread.start()

    @property
    def kept(self) -> Path:
        """Where the file is: under its own name once it is complete, or where it was moved to."""
        part = self._part
        if not part.is_named:
            return part.active
        return part.path if self._limits is None else part.path.with_name(self.path.name)

    @property
    def active(self) -> Path:
        """The file that is being written."""
        return self._part.active

    @property
    def behind(self) -> int:
        """Batches that are not written yet."""
        return self._queue.qsize()

    def add(self, batch: list[Outgoing]) -> None:
        """Hand over messages to be written."""
        if self.behind >= QUEUE:
            self.dropped += len(batch)
            return
        self._queue.put(batch)
        self.samples += sum(message.stream == "sample" for message in batch)

    def finish(self, ended: Ending) -> None:
        """Have the file completed and named; `done` tells when."""
        self._queue.put(ended)

    def join(self, timeout: float | None = None) -> None:
        """Wait until the file is complete, or for `timeout` s."""
        self._thread.join(timeout)

    def _write(self) -> None:
        """Write what comes until the end, and complete the file; whatever fails is told."""
        try:
            self._write_run()
        except Exception as err:
            self._give_up(err)
        finally:
            self.done = True
            self._changed()

    def _write_run(self) -> None:
        try:
            ended = self._write_until_the_end()
        except EndsHereError as err:
            self._end_early(err)
            self._wait_for_the_end()
        except Exception as err:
            self._give_up(err)
            self._wait_for_the_end()
        else:
            self._part.missing += self.dropped
            self._end_part(ended)
            self._follow()
            self._part.compact()
            self._part.name()
        for part in self._parts:
            part.compact()

    def _wait_for_the_end(self) -> None:
        """Have the error seen, and pass over what still comes of the run."""
        self._changed()
        while isinstance(self._queue.get(), list):
            pass

    def _write_until_the_end(self) -> Ending:
        """Write what comes: flushed at 10 Hz, on the disk at 1 Hz, first of all what is there."""
        flushed = time.monotonic()
        synced = flushed - SYNC_S
        while True:
            try:
                batch = self._queue.get(timeout=FLUSH_S)
            except queue.Empty:
                batch = []
            if not isinstance(batch, list):
                return batch
            for message in batch:
                self._add(message)
            now = time.monotonic()
            if now - flushed >= FLUSH_S or self._part.is_behind:
                self._flush()
                flushed = now
            if now - synced >= SYNC_S:
                self._part.sync()
                self.synced, synced = self._flushed, now

    def _add(self, message: Outgoing) -> None:
        self._part.add(message)
        if message.stream == "sample":
            self._written += 1
            if self._is_full(message.sequence):
                self._begin_part(message.sequence + 1, message.t_host_ns)

    def _is_full(self, k: int) -> bool:
        """Return whether a part ends with sample `k`: behind a sample, so no gap lies over it."""
        part, limits = self._part, self._limits
        if limits is None or k + 1 >= part.manifest.due.stop:
            return False
        return k + 1 - part.manifest.due.start >= limits.samples or part.size >= limits.size

    def _begin_part(self, k_first: int, t_ns: int) -> None:
        """End the part, and begin the next one with sample `k_first`."""
        ended, number = self._part, self._part.manifest.part + 1
        manifest = replace(ended.manifest, part=number, part_k_first=k_first)
        try:
            part = Part(part_path(self.path, number), manifest, self._attachments, t_ns)
        except OSError as err:
            raise EndsHereError(f"{err.strerror}; part {number} cannot be begun") from err
        try:
            self._end_part(CONTINUED)
            ended.name()
        except BaseException:
            part.discard()
            raise
        self._parts.append(ended)
        self._part = part

    def _end_part(self, ended: Ending) -> None:
        part = self._part
        outcome = Outcome(
            outcome=ended.text, samples=part.samples, missing=part.missing, code=ended.code
        )
        part.finish(outcome)
        self.synced = self._written
        self.missing += part.missing

    def _end_early(self, err: EndsHereError) -> None:
        """Complete the file before the run has ended; full chunks, which take long, come later."""
        try:
            self._end_part(Ending(OutcomeCode.RECORDING, f"its recording ended: {err}"))
            self._follow()
            self._part.name()
        except Exception as worse:
            self._give_up(worse)
        else:
            self._parts.append(self._part)
            self.error = f"{self.kept}: {err}; the recording ends there, whole up to then: "
            self.error += "free the disk"

    def _flush(self) -> None:
        self._part.flush()
        self._flushed = self._written
        self._follow()

    def _follow(self) -> None:
        if self._part.follow():
            self.moved = "its recording was moved while it was written"
            self._changed()

    def _give_up(self, err: Exception) -> None:
        """Keep what was flushed whole: a file that goes on would have a silent hole."""
        reason = err.strerror if isinstance(err, OSError) else repr(err)
        # Another file may have our name by now: that ours was removed is known for sure.
        there = not isinstance(err, RemovedError) and os.access(self.kept, os.F_OK)
        left = "what was flushed is kept there" if there else "its samples are gone"
        self.error = f"{self.kept}: {reason}; {left}"
        self._part.give_up()
