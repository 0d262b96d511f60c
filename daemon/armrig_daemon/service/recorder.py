"""Recordings: one MCAP file a run, safe on the disk up to the last flush whatever dies.

Written to `NAME.mcap.active` and renamed when complete. A thread of its own writes, so that no
disk is ever waited for.
"""

from __future__ import annotations

import contextlib
import errno
import os
import queue
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

from armrig_core import protobuf
from armrig_core.manifest import OUTCOME, RUN, Manifest, Outcome
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.file_lock import lock
from armrig_core.recording_file.rewriting import compact, sync_directory
from armrig_core.recording_file.unfinished import ACTIVE, COPY
from armrig_core.topics import RECORDED, topic
from mcap.writer import CompressionType, Writer

from armrig_daemon.service.protobuf_out import Outgoing

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
            Called from the writer's thread when `error`, `moved` or `done` has changed.

        Raises
        ------
        RecordingError
            The file cannot be made.
        """
        self.path = path
        self.active = path.with_name(path.name + ACTIVE)
        self.kept = self.active
        """Where the file is: under its own name once it is complete, or where it was moved to."""
        self.samples = 0
        self.dropped = 0
        self.error = ""
        """What the disk refused, for a person; nothing more is written then."""
        self.moved = ""
        """That somebody moved the file, for a person; it is written on where it is."""
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
            lock(self._file)  # ours while we write
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
        began = self._sample_ns + self._offset_ns
        for name, data in attachments.items():
            kind = _MEDIA_TYPES[name.rpartition(".")[2]]
            writer.add_attachment(began, began, name, kind, data)
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
                self._follow()
            if now - synced >= SYNC_S:
                _sync(self._file.fileno())
                synced = now

    def _complete(self, outcome: Outcome) -> None:
        self._writer.flush()  # so that the outcome stands behind the last sample
        self._writer.add_metadata(OUTCOME, outcome.metadata())
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._good = self._file.tell()
        self._follow()
        if sys.platform == "win32":  # it renames no open file
            self._file.close()
        try:
            compact(self.active, self._compacted)
            self._compacted.replace(self.active)
        except (OSError, DamageError):  # no room for a second copy: the first is complete, too
            self._follow()
            with contextlib.suppress(OSError):
                self._compacted.unlink(missing_ok=True)
        self.active.replace(self.path)
        self._file.close()
        self.kept = self.path
        sync_directory(self.path.parent)

    @property
    def _compacted(self) -> Path:
        return self.path.with_name(self.path.name + COPY)

    def _follow(self) -> None:
        """See that the open file is still the one of our name; else go where it was moved to.

        Raises
        ------
        RecordingError
            It has no name any more: what is written goes nowhere.
        """
        if self._is_at(self.active):
            return
        moved = Path(f"/proc/self/fd/{self._file.fileno()}").readlink()
        if not self._is_at(moved):
            raise RecordingError(errno.ENOENT, "removed while it was written")
        self.active = self.kept = moved
        self.path = moved.with_name(moved.name.removesuffix(ACTIVE))
        self.moved = "its recording was moved while it was written"
        self._changed()

    def _is_at(self, path: Path) -> bool:
        """Return whether the open file is the one at `path`."""
        try:
            found = os.lstat(path)
        except (FileNotFoundError, NotADirectoryError):
            return False
        return os.path.samestat(found, os.fstat(self._file.fileno()))

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
        # Another file may have our name by now: that ours was removed is known for sure.
        there = not isinstance(err, RecordingError) and os.access(self.kept, os.F_OK)
        left = "what was flushed is kept there" if there else "its samples are gone"
        self.error = f"{self.kept}: {reason}; {left}"
        with contextlib.suppress(OSError, ValueError):  # closed, or gone altogether
            os.ftruncate(self._file.fileno(), self._good)
            _into_nowhere(self._file)
            self._file.close()
        self._changed()
        while not ended:
            ended = isinstance(self._queue.get(), Outcome)


def _sync(fd: int) -> None:
    """Have the bytes of a file on the disk, with no more of its dates and sizes than needed."""
    getattr(os, "fdatasync", os.fsync)(fd)  # not every system has the first


def _into_nowhere(file: IO[bytes]) -> None:
    """Let what is buffered go nowhere: it must not come back when there is room again."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, file.fileno())
    os.close(nowhere)
