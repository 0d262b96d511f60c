"""Recording of a run into MCAP files; if the process dies, all flushed messages remain.

The file is `NAME.mcap.active` until it is complete. A thread creates and writes the files and a
second thread syncs them, so that the caller never waits for the disk, and no flush waits for a
sync.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from math import inf
from pathlib import Path
from typing import NamedTuple, Self

from msgspec.structs import replace

from armrig_core.commands.codes import CONTINUED, Ending, OutcomeCode
from armrig_core.errors import ArmrigError
from armrig_core.process.printable import plural
from armrig_core.recording_file.manifest import Manifest, Outcome
from armrig_core.recording_file.part_names import ACTIVE, part_path
from armrig_core.recording_file.recording_part import ChangedError, EndsHereError, RecordingPart
from armrig_core.telemetry.telemetry import Outgoing

FLUSH_S = 0.1
SYNC_S = 1.0
STALL_S = 30.0
"""Time without an answer of the disk after which the recording is given up."""
_LOOK_S, _REWRITE_S = 1.0, 300.0  # the rewriting of a long recording takes a while
QUEUE = 10_000  # in batches; further messages are discarded, counted and reported


class RecordingError(ArmrigError, OSError):
    """A recording cannot begin; the message gives file and reason."""


class _Beginning(NamedTuple):
    """Contents of the beginning of a file, and the time of the first sample."""

    manifest: Manifest
    attachments: dict[str, bytes]
    t_first_ns: int


class ActiveRecording:
    """A recording; its caller never waits for the disk."""

    _part: RecordingPart  # from the creation of its file on

    def __init__(
        self,
        path: Path,
        *,
        changed: Callable[[], None],
        check: Callable[[], str] = str,
        part_samples: int = 0,
        mode: int = 0o666,
    ) -> None:
        """Have the writer's thread create an empty file.

        No file may exist at `path`, the path of the finished recording. The thread first calls
        `check`, which returns the reason why nothing can be recorded, or an empty text. It calls
        `changed` when `is_created`, `error`, `moved` or `done` has changed. A part ends after
        `part_samples` samples, recorded or missing; with 0, the run is recorded in one file. The
        files have no permissions beyond `mode` and the umask.
        """
        self.path, self._mode = path, mode
        self.is_created = False
        """True if the empty file exists."""
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
        self._part_samples, self._check = part_samples, check
        self._attachments: dict[str, bytes] = {}
        self._changed = changed
        self._failure: OSError | None = None
        self._is_open = False
        self._parts: list[RecordingPart] = []
        self._written = self._flushed = 0  # samples
        self._busy_since_s = time.monotonic()  # inf: the writer waits for messages, not for a disk
        self._queue: queue.SimpleQueue[_Beginning | list[Outgoing] | Ending] = queue.SimpleQueue()
        self._has_tried, self._has_begun = threading.Event(), threading.Event()
        self._syncer = Syncer()
        self._thread = threading.Thread(target=self._write, name="recording", daemon=True)
        self._thread.start()

    @classmethod
    def create(
        cls,
        path: Path,
        manifest: Manifest,
        attachments: dict[str, bytes],
        *,
        t_first_ns: int,
        changed: Callable[[], None],
        part_samples: int = 0,
    ) -> Self:
        """Return a recording whose file exists and has begun; the arguments are those of both.

        Raises RecordingError if the file cannot be created.
        """
        recording = cls(path, changed=lambda: None, part_samples=part_samples)
        recording.begin(manifest, attachments, t_first_ns=t_first_ns)
        recording._has_begun.wait()
        if not recording._is_open:
            recording.finish(Ending(OutcomeCode.RECORDING, recording.error))
            raise RecordingError(recording.error) from recording._failure
        recording._changed = changed
        return recording

    def begin(self, manifest: Manifest, attachments: dict[str, bytes], *, t_first_ns: int) -> None:
        """Write header, schemas, manifest and attachments; messages may follow.

        `t_first_ns` is the monotonic time of the first sample.
        """
        if self._part_samples:
            manifest = replace(manifest, part=1, part_k_first=manifest.k_first)
        self._queue.put(_Beginning(manifest, attachments, t_first_ns))

    def wait_for_file(self) -> None:
        """Wait until the file exists, or `error` says why it does not."""
        self._has_tried.wait()

    def discard(self) -> None:
        """Remove the file of a recording that has not begun."""
        self.finish(Ending(OutcomeCode.RECORDING, "discarded"))

    @property
    def synced(self) -> int:
        """Number of samples that are safely on the disk."""
        return self._syncer.synced

    @property
    def kept(self) -> Path:
        """Path of the finished recording; before the end, path of the unfinished file."""
        if not self.is_created or not self._part.is_named:
            return self.active
        part = self._part
        return part.path.with_name(self.path.name) if self._part_samples else part.path

    @property
    def active(self) -> Path:
        """Path of the file that is being written."""
        if self.is_created:
            return self._part.active
        first = part_path(self.path, 1 if self._part_samples else 0)
        return first.with_name(first.name + ACTIVE)

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
            self._thread.join(min(_LOOK_S, max(0.0, until_s - time.monotonic())))
            self.look()
        self.look(-inf)

    def look(self, limit_s: float = STALL_S) -> None:
        """Give the recording up if the disk has not answered for `limit_s`; call it each second."""
        waited_s = time.monotonic() - min(self._busy_since_s, self._syncer.begun_s)
        if waited_s < limit_s or self.done:
            return
        N = self.samples + self.dropped
        why = f"the disk did not answer for {waited_s:.0f} s" if waited_s > 0 else "not renamed"
        sentence = (
            f"all {plural(N, 'sample is', 'samples are')} on the disk; `armrig recover` the file"
        )
        if lost := N - self.synced:
            sentence = f"up to {lost} of {N} samples are lost; `armrig recover` the others"
        if not (self.is_created and self._part.is_named):  # a named file is complete
            self.error = self.error or f"{self.kept}: {why}; {sentence}"
        self.done = True

    def _write(self) -> None:
        """Write the queued messages, and complete the file; report any failure in `error`."""
        try:
            if self._has_file() and self._is_begun():
                self._write_run()
        except Exception as err:
            self._give_up(err)
        finally:
            self._has_tried.set()
            self._has_begun.set()
            self._busy_since_s = time.monotonic() + _REWRITE_S
            with suppress(Exception):  # `error` has the first failure
                self._syncer.join()
                for part in self._parts:
                    part.compact()
            self.done = True
            self._changed()

    def _has_file(self) -> bool:
        """Create the file; on a failure, report it, wait for the end, and return False."""
        try:
            if objection := self._check():
                raise RecordingError(objection)
            name = self.active.name.removesuffix(ACTIVE)
            self._part = RecordingPart(self.active.with_name(name), self._mode)
        except OSError as err:
            self._fail(err)
            return False
        self.is_created = True
        self._has_tried.set()
        self._changed()
        return True

    def _is_begun(self) -> bool:
        """Wait for the beginning, and write it; return False without one, or if this fails."""
        self._busy_since_s = inf
        first = self._queue.get()
        self._busy_since_s = time.monotonic()
        if not isinstance(first, _Beginning):
            self._part.discard()
            return False
        # Only the first part contains the input, which may have 80 MB.
        source = first.manifest.source
        self._attachments = {n: data for n, data in first.attachments.items() if n != source}
        try:
            self._part.begin(*first)
        except OSError as err:
            self._fail(err)
            return False
        self._is_open = True
        self._has_begun.set()
        return True

    def _fail(self, err: OSError) -> None:
        """Report that there is no file, and wait for the end of the recording."""
        where, way_out = str(self.active), "free disk space, or set [recording] directory"
        if isinstance(err, FileExistsError):
            where, way_out = err.filename, "set [recording] directory to another"
        self._failure = err
        self.error = f"{where}: {err.strerror}; {way_out}"
        if isinstance(err, RecordingError):
            self.error = str(err)
        for event in (self._has_tried, self._has_begun):
            event.set()
        self._wait_for_the_end()

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
        while not isinstance(self._queue.get(), Ending):
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
            if isinstance(batch, Ending):
                return batch
            if isinstance(batch, _Beginning):
                raise TypeError("a recording begins once")
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
            part = RecordingPart(part_path(self.path, number), self._mode).begin(
                manifest, self._attachments, t_ns
            )
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
        if self.is_created:
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
        self._requests: queue.SimpleQueue[tuple[RecordingPart, int, bool] | None] = (
            queue.SimpleQueue()
        )
        self._thread = threading.Thread(target=self._sync, name="sync", daemon=True)
        self._thread.start()

    def request(self, part: RecordingPart, samples: int, *, is_complete: bool = False) -> None:
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
