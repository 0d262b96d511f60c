"""One open file of a recording: what it is given is in it at each flush, all of it or nothing."""

from __future__ import annotations

import errno
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import IO, cast

from mcap.writer import CompressionType, Writer

from armrig_core import protobuf
from armrig_core.manifest import OUTCOME, RUN, Manifest, Outcome
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.file_lock import lock
from armrig_core.recording_file.outgoing import Outgoing
from armrig_core.recording_file.part_names import ACTIVE, COPY
from armrig_core.recording_file.reserve import Reserve
from armrig_core.recording_file.rewriting import compact, sync_directory
from armrig_core.topics import RECORDED, topic

PROFILE = "armrig"
"""Profile in the header of a recording, by which other programs recognise one."""
CHUNK = 128 * 1024
_ENDING = 4 * CHUNK  # B: what is pending when the disk is found full, and the end of the file
_INDEXED = 256  # B, and so much more for the index of each chunk
_FULL = (errno.ENOSPC, errno.EDQUOT)
_MEDIA_TYPES = {"csv": "text/csv", "json": "application/json", "gz": "application/gzip"}


class EndsHereError(Exception):
    """No more can be recorded, says why; all that was given is in the file, to be completed."""


class RemovedError(OSError):
    """The file has no name any more: what is written goes nowhere."""


class Part:
    """One open file, NAME.mcap.active until it is complete."""

    def __init__(
        self, path: Path, manifest: Manifest, attachments: dict[str, bytes], t_first_ns: int
    ) -> None:
        """Create the file with header, schemas, manifest and attachments, handed to the kernel.

        Raises
        ------
        OSError
            The file cannot be made, or there is one of its name; nothing is left of it.
        """
        _check_free(path)
        self.path = path
        self.active = path.with_name(path.name + ACTIVE)
        self.manifest = manifest
        self.samples = self.missing = 0
        self.size = 0
        """Of the file, in B, up to the last flush."""
        self.is_named = False
        """Whether it is complete and has its name."""
        self._chunks = 0
        self._offset_ns = manifest.clock_offset_ns
        self._sample_ns = t_first_ns
        self._logged_ns = 0
        self._pending = _Pending()
        self._file = cast("IO[bytes]", self.active.open("xb", buffering=0))
        try:
            self._reserve = Reserve(path.parent)
        except BaseException:
            self._file.close()
            self.active.unlink()
            raise
        try:
            lock(self._file)  # ours while we write
            self._writer = Writer(
                cast("IO[bytes]", self._pending),
                chunk_size=CHUNK,
                compression=CompressionType.ZSTD,
                enable_data_crcs=True,
            )
            self._channels = self._begin(attachments)
            self._reserve.hold(_ENDING)
        except BaseException:
            self.discard()
            raise

    def _begin(self, attachments: dict[str, bytes]) -> dict[str, int]:
        writer, channels, manifest = self._writer, {}, self.manifest
        writer.start(profile=PROFILE, library=f"armrig {manifest.armrig}")
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
        self._write_pending()
        return channels

    def add(self, message: Outgoing) -> None:
        """Take a message, to be written at the next flush."""
        # Log times do not go back in the file: a message that overtakes a sample in flight gets
        # the time of the sample before, and one that a sample overtook gets that sample's time.
        # A message's own time is in its payload.
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
        """Return how many samples of the run a gap is short of."""
        gap = protobuf.message_class(protobuf.GAP).FromString(data)
        due, first, count = self.manifest.due, int(gap.k_first), int(gap.count)
        return max(0, min(first + count, due.stop) - max(first, due.start))

    @property
    def is_behind(self) -> bool:
        """Whether so much is pending that the reserve may not be enough for it."""
        return self._pending.size > CHUNK

    def flush(self) -> None:
        """Hand what was added to the kernel, all of it or nothing.

        Raises
        ------
        EndsHereError
            All of it is there, but the disk is full.
        OSError
            Nothing of it is there: the file ends with the last flush, and nothing may be added.
        """
        self._writer.flush()
        if not self._pending.size:
            return
        self._commit()
        self._chunks += 1
        try:
            self._reserve.hold(_ENDING + self._chunks * _INDEXED)
        except OSError as err:
            self._reserve.release()
            raise EndsHereError(err.strerror) from err

    def sync(self) -> None:
        """Have what was flushed on the disk, with no more of its dates and sizes than needed."""
        # Not every system has the first.
        getattr(os, "fdatasync", os.fsync)(self._file.fileno())

    def finish(self, outcome: Outcome) -> None:
        """Complete the file, and have it on the disk; raises OSError as `flush`."""
        with suppress(EndsHereError):
            self.flush()  # so that the outcome stands behind the last sample
        self._writer.add_metadata(OUTCOME, outcome.metadata())
        self._writer.finish()
        with suppress(EndsHereError):
            self._commit()
        self._reserve.release()
        os.fsync(self._file.fileno())

    def name(self) -> None:
        """Give the complete file its name, and close it; raises OSError where that is taken."""
        _check_free(self.path)
        if sys.platform == "win32":  # it renames no open file
            self._file.close()
        self.active.replace(self.path)
        self.is_named = True
        self._file.close()
        sync_directory(self.path.parent)

    def compact(self) -> None:
        """Write the complete file, that has its name or not, once more in full chunks.

        Where there is no room for a second copy, the first, which is complete, stays.
        """
        written = self.path if self.is_named else self.active
        if sys.platform == "win32":
            self._file.close()
        copy = self.path.with_name(self.path.name + COPY)
        try:
            compact(written, copy)
            copy.replace(written)
        except (OSError, DamageError):
            if not (self.is_named or self._file.closed):
                self.follow()
            with suppress(OSError):
                self.path.with_name(self.path.name + COPY).unlink(missing_ok=True)

    def follow(self) -> bool:
        """See that the open file is still the one of our name; else go where it was moved to.

        Returns
        -------
        bool
            Whether it was moved.

        Raises
        ------
        RemovedError
            It has no name any more.
        """
        if self._is_at(self.active):
            return False
        moved = Path(f"/proc/self/fd/{self._file.fileno()}").readlink()
        if not self._is_at(moved):
            raise RemovedError(errno.ENOENT, "removed while it was written")
        self.active = moved
        self.path = moved.with_name(moved.name.removesuffix(ACTIVE))
        return True

    def _is_at(self, path: Path) -> bool:
        """Return whether the open file is the one at `path`."""
        try:
            found = os.lstat(path)
        except (FileNotFoundError, NotADirectoryError):
            return False
        return os.path.samestat(found, os.fstat(self._file.fileno()))

    def discard(self) -> None:
        """Leave nothing of it."""
        self.give_up()
        with suppress(OSError):
            self.active.unlink()

    def give_up(self) -> None:
        """Close the file as it is up to the last flush."""
        with suppress(OSError, ValueError):  # closed, or gone altogether
            self._cut()
            self._file.close()
        self._reserve.release()

    def _commit(self) -> None:
        try:
            self._write_pending()
        except OSError as err:
            self._cut()
            if err.errno not in _FULL or not self._reserve.release():
                raise
            try:
                self._write_pending()
            except OSError:
                self._cut()
                raise
            raise EndsHereError(err.strerror) from err

    def _write_pending(self) -> None:
        data = memoryview(self._pending.taken())
        self._file.seek(self.size)
        while data:
            data = data[self._file.write(data) :]
        self.size = self._pending.written()

    def _cut(self) -> None:
        """End the file with its last flush: no reader meets half a record."""
        os.ftruncate(self._file.fileno(), self.size)


def _check_free(path: Path) -> None:
    """Refuse a name that is taken: its file would be lost."""
    if os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))


class _Pending:
    """What the MCAP writer has written since the last flush, as the stream that it writes to."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._before = 0
        self.size = 0

    def write(self, data: bytes) -> int:
        """Keep some bytes."""
        self._parts.append(data)
        self.size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return where the next byte will stand in the file."""
        return self._before + self.size

    def flush(self) -> None:
        """Do nothing: the file is written as a whole."""

    def taken(self) -> bytes:
        """Return all bytes since the last flush; they are kept until `written`."""
        self._parts = [b"".join(self._parts)]
        return self._parts[0]

    def written(self) -> int:
        """Forget what was taken: it is in the file. Return how long that is."""
        self._before += self.size
        self._parts, self.size = [], 0
        return self._before
