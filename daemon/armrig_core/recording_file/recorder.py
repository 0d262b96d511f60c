"""Recording of a run into MCAP files; if the process dies, all flushed messages remain.

The file is `NAME.mcap.active` until it is complete. A thread writes the files and a second thread
syncs them, so that the caller never waits for the disk, and no flush waits for a sync.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from math import inf
from pathlib import Path

from msgspec.structs import replace

from armrig_core.commands.codes import CONTINUED, Ending, OutcomeCode
from armrig_core.errors import ArmrigError
from armrig_core.recording_file.manifest import INPUT, Manifest, Outcome
from armrig_core.recording_file.part_names import ACTIVE, part_path
from armrig_core.recording_file.recording_part import ChangedError, EndsHereError, Part
from armrig_core.telemetry.telemetry import Outgoing

FLUSH_S = 0.1
SYNC_S = 1.0
STALL_S = 30.0
"""Time without an answer of the disk after which the recording is given up."""
_LOOK_S, _REWRITE_S = 1.0, 300.0  # the rewriting of a long recording takes a while
QUEUE = 10_000  # in batches; further messages are discarded, counted and reported


class RecordingError(ArmrigError, OSError):
    """A recording cannot begin; the message gives file and reason."""


class Recording:
    """An open recording; after its creation, the caller never waits for the disk."""

    def __init__(
        self,
        path: Path,
        manifest: Manifest,
        attachments: dict[str, bytes],
        *,
        t_first_ns: int,
        changed: Callable[[], None],
        part_samples: int = 0,
    ) -> None:
        """Create the file and write header, schemas, manifest and attachments to the kernel.

        No file may exist at `path`, the path of the finished recording. `t_first_ns` is the
        monotonic time of the first sample. The writer's thread calls `changed` when `error`,
        `moved` or `done` has changed. A part ends after `part_samples` samples, recorded or
        missing; with 0, the run is recorded in one file.

        Raises RecordingError if the file cannot be created.
        """
        self.path = path
        self.samples = 0
        """Number of samples passed to `add`."""
        self.missing = 0
        """Number of missing samples in the gaps of the finished parts."""
        self.dropped = 0
        self.error = ""
        """Message about a failure of the disk; nothing is written after the failure."""
        self.moved = ""
        """Message that the file was moved; writing continues at its new path."""
        self.done = False
        """True if the file is complete under its final name, or if writing has failed and ended."""
        self._part_samples = part_samples
        # Only the first part contains the input, which may have 80 MB.
        self._attachments = {n: data for n, data in attachments.items() if n != INPUT}
        self._changed = changed
        self._parts: list[Part] = []
        self._written = self._flushed = 0  # samples
        self._busy_since_s = inf  # inf: the writer waits for messages, not for the disk
        self._queue: queue.SimpleQueue[list[Outgoing] | Ending] = queue.SimpleQueue()
        if part_samples:
            manifest = replace(manifest, part=1, part_k_first=manifest.k_first)
        path = part_path(path, manifest.part)
        try:
            self._part = Part(path, manifest, attachments, t_first_ns)
        except OSError as err:
            where, way_out = f"{path}{ACTIVE}", "free disk space, or set [recording] directory"
            if isinstance(err, FileExistsError):
                where, way_out = err.filename, "set [recording] directory to another"
            raise RecordingError(f"{where}: {err.strerror}; {way_out}") from err
        self._syncer = Syncer()
        self._thread = threading.Thread(target=self._write, name="recording", daemon=True)
        self._thread.start()

    @property
    def synced(self) -> int:
        """Number of samples that are safely on the disk."""
        return self._syncer.synced

    @property
    def kept(self) -> Path:
        """Path of the finished recording; before the end, path of the unfinished file."""
        part = self._part
        if not part.is_named:
            return part.active
        return part.path.with_name(self.path.name) if self._part_samples else part.path

    @property
    def active(self) -> Path:
        """Path of the file that is being written."""
        return self._part.active

    @property
    def behind(self) -> int:
        """Number of batches that are not written yet."""
        return self._queue.qsize()

    def add(self, batch: list[Outgoing]) -> None:
        """Queue messages for writing."""
        if self.behind >= QUEUE:
            self.dropped += len(batch)
            return
        self._queue.put(batch)
        self.samples += sum(message.stream == "sample" for message in batch)

    def finish(self, ended: Ending) -> None:
        """Complete and rename the file in the writer's thread; `done` then becomes True."""
        self._queue.put(ended)

    def join(self, timeout: float) -> None:
        """Wait until the file is complete; after `timeout` s or `STALL_S` give it up."""
        until_s = time.monotonic() + timeout
        while not self.done and time.monotonic() < until_s:
            self._thread.join(_LOOK_S)
            self.look()
        self.look(-inf)

    def look(self, limit_s: float = STALL_S) -> None:
        """Give the recording up if the disk has not answered for `limit_s`; call it each second."""
        waited_s = time.monotonic() - min(self._busy_since_s, self._syncer.begun_s)
        if waited_s < limit_s or self.done:
            return
        came = self.samples + self.dropped
        why = f"the disk did not answer for {waited_s:.0f} s" if waited_s > 0 else "not renamed"
        what = f"all {came} samples are on the disk; `armrig recover` the file"
        if lost := came - self.synced:
            what = f"up to {lost} of {came} samples are lost; `armrig recover` the others"
        if not self._part.is_named:  # a named file is complete; its chunks may still be short
            self.error = self.error or f"{self.kept}: {why}; {what}"
        self.done = True

    def _write(self) -> None:
        """Write the queued messages, and complete the file; report any failure in `error`."""
        try:
            self._write_run()
        except Exception as err:
            self._give_up(err)
        finally:
            self._busy_since_s = time.monotonic() + _REWRITE_S
            with suppress(Exception):  # `error` has the first failure
                self._syncer.join()
                for part in self._parts:
                    part.compact()
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
            self._end_run(ended)
            self._part.compact()
            self._part.name()

    def _wait_for_the_end(self) -> None:
        """Report the error, and discard the remaining messages of the run."""
        self._changed()
        self._busy_since_s = inf
        while isinstance(self._queue.get(), list):
            pass

    def _write_until_the_end(self) -> Ending:
        """Write the queued messages; flush at 10 Hz, and sync at 1 Hz from the first flush on."""
        flushed = time.monotonic()
        while True:
            self._busy_since_s = inf
            try:
                batch = self._queue.get(timeout=max(0.0, flushed + FLUSH_S - time.monotonic()))
            except queue.Empty:
                batch = []
            self._busy_since_s = time.monotonic()
            if not isinstance(batch, list):
                return batch
            if self.error or self._syncer.error is not None:
                raise self._syncer.error or RecordingError(self.error)
            for message in batch:
                self._add(message)
            now = time.monotonic()
            if now - flushed >= FLUSH_S or self._part.is_behind:
                self._flush()
                flushed = now
            if now - self._syncer.ended_s >= SYNC_S:
                self._syncer.request(self._part, self._flushed)

    def _add(self, message: Outgoing) -> None:
        self._part.add(message)
        if message.stream == "sample":
            self._written += 1
            if self._is_full(message.sequence):
                self._begin_part(message.sequence + 1, message.t_host_ns)

    def _is_full(self, k: int) -> bool:
        """Return whether the part ends with sample `k`; no part ends inside a gap."""
        due = self._part.manifest.due
        return 0 < self._part_samples <= k + 1 - due.start and k + 1 < due.stop

    def _begin_part(self, k_first: int, t_ns: int) -> None:
        """End the part, and begin the next part with sample `k_first`."""
        ended, number = self._part, self._part.manifest.part + 1
        manifest = replace(ended.manifest, part=number, part_k_first=k_first)
        try:
            part = Part(part_path(self.path, number), manifest, self._attachments, t_ns)
        except OSError as err:
            raise EndsHereError(f"{err.strerror}; part {number} cannot begin") from err
        try:
            self._end_part(CONTINUED)
        except BaseException:
            part.discard()
            raise
        self._syncer.request(ended, self._written, is_complete=True)
        self._parts.append(ended)
        self._part = part

    def _end_part(self, ended: Ending) -> None:
        part = self._part
        outcome = Outcome(
            outcome=ended.text, samples=part.samples, missing=part.missing, code=ended.code
        )
        part.finish(outcome)
        self._flushed = self._written
        self.missing += part.missing

    def _end_run(self, ended: Ending) -> None:
        """Complete the last part, and sync all parts."""
        self._end_part(ended)  # first: all samples then survive the death of the process
        self._syncer.join()
        self._part.sync_all()
        self._syncer.synced = self._written
        self._busy_since_s = time.monotonic() + _REWRITE_S
        self._follow()

    def _end_early(self, err: EndsHereError) -> None:
        """Complete the file before the end of the run; `_write` compacts the file later."""
        try:
            self._end_run(Ending(OutcomeCode.RECORDING, f"its recording ended: {err}"))
            self._part.name()
        except Exception as worse:
            self._give_up(worse)
        else:
            self._parts.append(self._part)
            self.error = f"{self.kept}: {err}; the recording ended early; all samples "
            self.error += "until then are in the file; free disk space"

    def _flush(self) -> None:
        self._part.flush()
        self._flushed = self._written
        self._follow()

    def _follow(self) -> None:
        if self._part.follow():
            self.moved = "its recording was moved while it was written"
            self._changed()

    def _give_up(self, err: Exception) -> None:
        """Cut the file at its last flush, and close it: later data would follow a hidden gap."""
        reason = err.strerror if isinstance(err, OSError) else repr(err)
        if not isinstance(err, ChangedError | FileNotFoundError):
            reason = f"{reason}; the flushed samples are kept there"
        where = self._syncer.failed if err is self._syncer.error else self.kept
        self.error = self.error or f"{where}: {reason}"
        self._part.give_up()


class Syncer:
    """Thread that syncs the parts of a recording in their order, so that no flush waits for it."""

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
