"""Recordings: one MCAP file a run, safe on the disk up to the last flush whatever dies.

Written to `NAME.mcap.active` and renamed when complete. A thread of its own writes, so that no
disk is ever waited for.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from armrig_core import protobuf
from armrig_core.manifest import OUTCOME, RUN, Manifest, Outcome
from armrig_core.topics import RECORDED, topic
from mcap.writer import CompressionType, Writer

from armrig_daemon.compact import compact
from armrig_daemon.messages import Outgoing

CHUNK = 128 * 1024
FLUSH_S = 0.1
SYNC_S = 1.0
QUEUE = 10_000  # batches; what finds no room is counted and reported
_MEDIA_TYPES = {"csv": "text/csv", "json": "application/json", "gz": "application/gzip"}


class RecordingError(OSError):
    """A recording cannot be begun; says where and why."""


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
    ) -> None:
        """Create the file with header, schemas, manifest and attachments, handed to the kernel.

        Parameters
        ----------
        path : Path
            Of the finished recording; must not exist.
        t_first_ns : int
            Monotonic time of the first sample.
        changed : callable
            Called from the writer's thread when `error` or `done` has changed.

        Raises
        ------
        RecordingError
            The file cannot be made.
        """
        self.path = path
        self.active = path.with_name(path.name + ".active")
        self.kept = self.active
        """Where the file is: under its own name once it is complete."""
        self.samples = 0
        self.dropped = 0
        self.error = ""
        """What the disk refused, for a person; nothing more is written then."""
        self.done = False
        """Whether the file is complete and has its name, or has failed for good."""
        self._offset_ns = manifest.clock_offset_ns
        self._sample_ns = t_first_ns
        self._changed = changed
        self._queue: queue.Queue[list[Outgoing] | Outcome] = queue.Queue()
        try:
            self._file: IO[bytes] = self.active.open("xb")
            self._writer = Writer(
                self._file,
                chunk_size=CHUNK,
                compression=CompressionType.ZSTD,
                enable_data_crcs=True,
            )
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # ours while we write
            self._channels = self._begin(manifest, attachments)
            self._good = self._file.tell()
        except FileExistsError as err:
            msg = f"{self.active}: {err.strerror}; set [recording] directory to another"
            raise RecordingError(msg) from err
        except OSError as err:
            self._discard()
            msg = f"{self.active}: {err.strerror}; free the disk, or set [recording] directory"
            raise RecordingError(msg) from err
        self._thread = threading.Thread(target=self._write, name="recording", daemon=True)
        self._thread.start()

    def _discard(self) -> None:
        """Leave nothing of a file that could not be begun."""
        with contextlib.suppress(AttributeError, OSError):
            _into_nowhere(self._file)
            self._file.close()
        with contextlib.suppress(OSError):
            self.active.unlink()

    def add(self, batch: list[Outgoing]) -> None:
        """Hand over messages to be written."""
        if self._queue.qsize() >= QUEUE:
            self.dropped += len(batch)
            return
        self._queue.put(batch)
        self.samples += sum(message.stream == "sample" for message in batch)

    def finish(self, outcome: str, missing: int) -> None:
        """Have the file completed and named; `done` tells when."""
        missing += self.dropped
        self._queue.put(Outcome(outcome=outcome, samples=self.samples, missing=missing))

    def join(self, timeout: float | None = None) -> None:
        """Wait until the file is complete, or for `timeout` s."""
        self._thread.join(timeout)

    def _begin(self, manifest: Manifest, attachments: dict[str, bytes]) -> dict[str, int]:
        writer, channels = self._writer, {}
        writer.start(profile="", library=f"armrig {manifest.armrig}")
        for stream in RECORDED:
            name = protobuf.OF_STREAM[stream]
            schema = writer.register_schema(name, "protobuf", protobuf.descriptor_set(name))
            channels[stream] = writer.register_channel(
                topic(manifest.rig, stream), "protobuf", schema
            )
        writer.add_metadata(RUN, manifest.metadata())
        now = time.time_ns()
        for name, data in attachments.items():
            kind = _MEDIA_TYPES[name.rpartition(".")[2]]
            writer.add_attachment(now, now, name, kind, data)
        writer.flush()
        return channels

    def _write(self) -> None:
        """Write what comes until the end, and complete the file; whatever fails is told."""
        outcome = None
        try:
            outcome = self._write_until_the_end()
            self._complete(outcome)
        except Exception as err:
            self._give_up(err, ended=outcome is not None)
        finally:
            self.done = True
            self._changed()

    def _write_until_the_end(self) -> Outcome:
        """Write what comes: flushed at 10 Hz, on the disk at 1 Hz, first of all what is there."""
        flushed = time.monotonic()
        synced = flushed - SYNC_S
        while True:
            try:
                batch = self._queue.get(timeout=FLUSH_S)
            except queue.Empty:
                batch = []
            if isinstance(batch, Outcome):
                return batch
            for message in batch:
                self._add(message)
            now = time.monotonic()
            if now - flushed >= FLUSH_S:
                self._writer.flush()
                self._good, flushed = self._file.tell(), now
            if now - synced >= SYNC_S:
                os.fdatasync(self._file.fileno())
                synced = now

    def _complete(self, outcome: Outcome) -> None:
        self._writer.add_metadata(OUTCOME, outcome.metadata())
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        compacted = self.path.with_name(self.path.name + ".compact")
        try:
            compact(self.active, compacted)
            compacted.replace(self.active)
        except OSError:  # no room for a second copy: the first is complete, too
            with contextlib.suppress(OSError):
                compacted.unlink(missing_ok=True)
        self.active.rename(self.path)
        self.kept = self.path
        _sync_directory(self.path.parent)

    def _add(self, message: Outgoing) -> None:
        # Log times do not go back in the file: what a sample in flight is overtaken by gets the
        # time of the sample before; its own is in its payload.
        if message.stream == "sample":
            t_ns = self._sample_ns = message.t_host_ns
        else:
            t_ns = min(message.t_host_ns, self._sample_ns)
        self._writer.add_message(
            channel_id=self._channels[message.stream],
            log_time=t_ns + self._offset_ns,
            publish_time=min(message.t_sched_ns, t_ns) + self._offset_ns,
            sequence=message.sequence & 0xFFFFFFFF,
            data=message.data,
        )

    def _give_up(self, err: Exception, *, ended: bool) -> None:
        """Keep what was flushed whole: a file that goes on would have a silent hole."""
        reason = err.strerror if isinstance(err, OSError) else repr(err)
        left = "what was flushed is kept there" if os.access(self.kept, os.F_OK) else "it is gone"
        self.error = f"{self.kept}: {reason}; {left}"
        with contextlib.suppress(OSError, ValueError):  # closed, or gone altogether
            os.ftruncate(self._file.fileno(), self._good)
            _into_nowhere(self._file)
            self._file.close()
        self._changed()
        while not ended:
            ended = isinstance(self._queue.get(), Outcome)


def _into_nowhere(file: IO[bytes]) -> None:
    """Let what is buffered go nowhere: it must not come back when there is room again."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, file.fileno())
    os.close(nowhere)


def left_over(directory: Path, rig: str) -> list[Path]:
    """Return the recordings of a rig that a daemon left unfinished: nobody writes them now."""
    try:
        return sorted(p for p in directory.glob(f"{rig}-*.mcap.active") if not _is_written(p))
    except OSError:  # where nothing can be read nothing is found; a run will be told why
        return []


def _is_written(path: Path) -> bool:
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        return False


def check_directory(directory: Path, needed: int) -> str:
    """Return why nothing can be recorded in `directory`, or nothing."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        free = os.statvfs(directory)
    except OSError as err:
        return f"{directory}: {err.strerror}; set [recording] directory"
    if not os.access(directory, os.W_OK | os.X_OK):
        return f"{directory}: not writable; set [recording] directory"
    room = free.f_bavail * free.f_frsize
    if room < needed:
        return f"{directory}: {room / 1e6:.0f} MB free, {needed / 1e6:.0f} MB needed; free the disk"
    return ""


def _sync_directory(directory: Path) -> None:
    fd: Any = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
