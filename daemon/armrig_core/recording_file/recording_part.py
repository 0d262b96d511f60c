"""One open file of a recording; each flush writes either all pending messages or none."""

from __future__ import annotations

import errno
import os
import stat
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import IO, Self, cast

from mcap.writer import CompressionType, Writer

from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.manifest import OUTCOME, RUN, Manifest, Outcome, description_of
from armrig_core.recording_file.opening import lock
from armrig_core.recording_file.part_names import ACTIVE, COPY
from armrig_core.recording_file.rewriting import compact, sync_directory
from armrig_core.telemetry import protobuf
from armrig_core.telemetry.telemetry import Outgoing
from armrig_core.telemetry.topics import RECORDED, topic

PROFILE = "armrig"
"""Profile in the header of a recording, by which programs recognise a recording."""
CHUNK_BYTES = 128 * 1024
_ENDING_BYTES = 4 * CHUNK_BYTES  # for the last messages on a full disk, and for the end of the file
_INDEX_BYTES = 256  # additional space for the index of each chunk
_FULL_ERRORS = (errno.ENOSPC, errno.EDQUOT)
_MEDIA_TYPES = {
    "csv": "text/csv",
    "json": "application/json",
    "gz": "application/gzip",
    "toml": "application/toml",
}


class EndsHereError(Exception):
    """The file cannot grow. It contains all messages so far and must be completed."""


class ChangedError(OSError):
    """Another program has removed the file, or cut it short; the message says what is lost."""


class RecordingPart:
    """One open file; its name is NAME.mcap.active until it is complete."""

    manifest: Manifest
    """Manifest of the run; available after `begin`."""

    def __init__(self, path: Path, mode: int = 0o666) -> None:
        """Create the empty file, and reserve space for its end.

        The file has no permissions beyond `mode` and the umask.

        Raises OSError if the file cannot be created, or a file with this name exists. No new file
        is left.
        """
        _check_free(path)
        self.path = path
        self.active = path.with_name(path.name + ACTIVE)
        self.samples = self.missing = 0
        self.size = 0
        """Size of the file up to the last flush, in B."""
        self.is_named = False
        """True if the file is complete and has its final name."""
        self._chunks = 0
        self._logged_ns = 0
        self._pending = _Pending()
        self._file = cast("IO[bytes]", self.active.open("xb", buffering=0))
        try:
            self._restrict(mode)
            self._reserve = Reserve(path.parent)
        except BaseException:
            self._file.close()
            self.active.unlink()
            raise
        try:
            lock(self._file)
            self._reserve.hold(_ENDING_BYTES)
        except BaseException:
            self.discard()
            raise

    def _restrict(self, mode: int) -> None:
        fd = self._file.fileno()
        now = stat.S_IMODE(os.fstat(fd).st_mode)
        if now & ~mode:
            os.fchmod(fd, now & mode)

    def begin(self, manifest: Manifest, attachments: dict[str, bytes], t_first_ns: int) -> Self:
        """Write header, schemas, manifest and attachments to the kernel; return this part.

        `t_first_ns` is the monotonic time of the first sample. If this fails with OSError, the file
        is removed.
        """
        self.manifest, self._sample_ns = manifest, t_first_ns
        self._offset_ns = manifest.clock_offset_ns
        self._writer = Writer(
            cast("IO[bytes]", self._pending),
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        try:
            self._channels = self._begin(attachments)
        except BaseException:
            self.discard()
            raise
        return self

    def _begin(self, attachments: dict[str, bytes]) -> dict[str, int]:
        writer, channels, manifest = self._writer, {}, self.manifest
        writer.start(profile=PROFILE, library=f"armrig {manifest.armrig}")
        self._rig = description_of(attachments).channels
        for stream in RECORDED:
            if stream != "control":  # only runs under a law have it: see `add`
                channels[stream] = self._register(stream)
        writer.add_metadata(RUN, manifest.metadata())
        began = self._sample_ns + self._offset_ns
        for name, data in attachments.items():
            kind = _MEDIA_TYPES[name.rpartition(".")[2]]
            writer.add_attachment(began, began, name, kind, data)
        writer.flush()
        self._write_pending()
        return channels

    def _register(self, stream: str) -> int:
        """Write the schema and the channel of a stream; return the number of the channel."""
        name, writer = protobuf.OF_STREAM[stream], self._writer
        schema = writer.register_schema(name, "protobuf", protobuf.descriptor_set(name, self._rig))
        number: int = writer.register_channel(topic(self.manifest.rig, stream), "protobuf", schema)
        return number

    def add(self, message: Outgoing) -> None:
        """Add a message, which the next flush writes."""
        if message.stream not in self._channels:
            self._channels[message.stream] = self._register(message.stream)
        # Log times never decrease in the file. A message newer than the last sample gets the log
        # time of this sample, because the next sample may be older than the message. A message
        # older than the last log time gets this log time. The payload keeps the original time.
        t_ns = message.t_host_ns
        if message.stream == "sample":
            self._sample_ns = t_ns
            self.samples += 1
        else:
            t_ns = min(t_ns, self._sample_ns)
            if message.stream == "gap":
                self.missing += self._missing(message.data)
        t_ns = self._logged_ns = max(t_ns, self._logged_ns)
        self._writer.add_message(
            channel_id=self._channels[message.stream],
            log_time=t_ns + self._offset_ns,
            publish_time=min(message.t_sched_ns, t_ns) + self._offset_ns,
            sequence=message.sequence & 0xFFFFFFFF,
            data=message.data,
        )

    def _missing(self, data: bytes) -> int:
        """Return the number of the run's samples that are missing in a gap."""
        gap = protobuf.message_class(protobuf.GAP).FromString(data)
        due, first, count = self.manifest.due, int(gap.k_first), int(gap.count)
        return max(0, min(first + count, due.stop) - max(first, due.start))

    @property
    def is_behind(self) -> bool:
        """True if the pending bytes exceed the size of a chunk, so that a flush is due."""
        return self._pending.size > CHUNK_BYTES

    def flush(self) -> None:
        """Write all pending messages to the kernel, or none of them.

        Raises EndsHereError if all messages are written, but the disk is full. Raises OSError if no
        message is written. The file ends with the last flush, and nothing may be added to it.
        """
        self._writer.flush()
        if not self._pending.size:
            return
        self._commit()
        self._chunks += 1
        try:
            self._reserve.hold(_ENDING_BYTES + self._chunks * _INDEX_BYTES)
        except OSError as err:
            self._reserve.release()
            raise EndsHereError(err.strerror) from err

    def sync(self) -> None:
        """Sync the flushed data to the disk, with as little metadata of the file as possible."""
        # Not every system has fdatasync.
        getattr(os, "fdatasync", os.fsync)(self._file.fileno())

    def finish(self, outcome: Outcome) -> None:
        """Complete the file, which is not synced yet; raise OSError as `flush` does."""
        with suppress(EndsHereError):
            self.flush()  # the outcome must follow the last sample
        self._writer.add_metadata(OUTCOME, outcome.metadata())
        self._writer.finish()
        with suppress(EndsHereError):
            self._commit()
        self._reserve.release()

    def sync_all(self) -> None:
        """Sync the complete file to the disk, with all its metadata."""
        os.fsync(self._file.fileno())

    def name(self) -> None:
        """Rename and close the complete file; raise OSError if it is cut, or if the name exists."""
        self._check_size(self.active.stat().st_size)
        _check_free(self.path)
        if sys.platform == "win32":  # Windows cannot rename an open file
            self._file.close()
        self.active.replace(self.path)
        self.is_named = True
        self._file.close()
        sync_directory(self.path.parent)

    def compact(self) -> None:
        """Rewrite the finished file in full chunks; the file keeps its active or final name.

        If the disk has no space for the rewritten copy, the original file, which is complete,
        stays.
        """
        written = self.path if self.is_named else self.active
        if sys.platform == "win32":
            self._file.close()
        copy = self.path.with_name(self.path.name + COPY)
        try:
            compact(written, copy)
            self.size = copy.stat().st_size
            copy.replace(written)
        except (OSError, DamageError):
            if not (self.is_named or self._file.closed):
                self.follow()
            with suppress(OSError):
                self.path.with_name(self.path.name + COPY).unlink(missing_ok=True)

    def follow(self) -> bool:
        """Check that the name still belongs to the open file; if not, find the file's new path.

        Return True if the file was moved. Raises ChangedError if the file was deleted.
        """
        if self._is_at(self.active):
            return False
        moved = Path(f"/proc/self/fd/{self._file.fileno()}").readlink()
        if not self._is_at(moved):
            msg = "the file was removed during the recording; its samples are lost"
            raise ChangedError(errno.ENOENT, msg)
        self.active = moved
        self.path = moved.with_name(moved.name.removesuffix(ACTIVE))
        return True

    def _check_size(self, size: int) -> None:
        if size < self.size:
            msg = f"another program cut the file to {size} of {self.size} B; the rest is lost"
            raise ChangedError(errno.EIO, msg)

    def _is_at(self, path: Path) -> bool:
        try:
            inode = os.lstat(path)
        except (FileNotFoundError, NotADirectoryError):
            return False
        return os.path.samestat(inode, os.fstat(self._file.fileno()))

    def discard(self) -> None:
        """Close and remove the file."""
        self.give_up()
        with suppress(OSError):
            self.active.unlink()

    def give_up(self) -> None:
        """Cut the file at the end of its last flush, and close it."""
        with suppress(OSError, ValueError):  # it is closed or does not exist any more
            self._cut()
            self._file.close()
        self._reserve.release()

    def _commit(self) -> None:
        try:
            self._write_pending()
        except OSError as err:
            self._cut()
            if err.errno not in _FULL_ERRORS or not self._reserve.release():
                raise
            try:
                self._write_pending()
            except OSError:
                self._cut()
                raise
            raise EndsHereError(err.strerror) from err

    def _write_pending(self) -> None:
        self._check_size(os.fstat(self._file.fileno()).st_size)
        data = memoryview(self._pending.taken())
        self._file.seek(self.size)
        while data:
            data = data[self._file.write(data) :]
        self.size = self._pending.written()

    def _cut(self) -> None:
        """Cut the file at the end of its last flush, so that the file has no incomplete record."""
        fd = self._file.fileno()
        os.ftruncate(fd, min(self.size, os.fstat(fd).st_size))


def _check_free(path: Path) -> None:
    """Refuse the name of an existing file, because renaming would delete this file."""
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))


class _Pending:
    """Output stream of the MCAP writer: the bytes since the last flush."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._before = 0
        self.size = 0

    def write(self, data: bytes) -> int:
        """Append some bytes."""
        self._parts.append(data)
        self.size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the position of the next byte in the file."""
        return self._before + self.size

    def flush(self) -> None:
        """Do nothing: `RecordingPart` writes the pending bytes."""

    def taken(self) -> bytes:
        """Return all pending bytes; keep them until `written` is called."""
        self._parts = [b"".join(self._parts)]
        return self._parts[0]

    def written(self) -> int:
        """Discard the pending bytes, which are now in the file; return the file's size."""
        self._before += self.size
        self._parts, self.size = [], 0
        return self._before


class Reserve:
    """Space reserved in a directory; the system frees it if the process dies."""

    def __init__(self, directory: Path) -> None:
        """Reserve no space yet."""
        # The file has no name, so nobody finds it, and the system frees it when the process dies.
        self._file = tempfile.TemporaryFile(dir=directory)  # noqa: SIM115 - open until released
        self._size = 0

    def hold(self, size: int) -> None:
        """Reserve `size` B until `release`; raise OSError if there is no space."""
        has_room = hasattr(os, "posix_fallocate")  # not every system has it
        if size > self._size and has_room and not self._file.closed:
            os.posix_fallocate(self._file.fileno(), 0, size)
            self._size = size

    def release(self) -> bool:
        """Release the space; return whether space was reserved."""
        held, self._size = self._size, 0
        self._file.close()
        return held > 0
