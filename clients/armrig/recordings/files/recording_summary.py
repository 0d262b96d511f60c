"""Summary of a complete recording, read without its samples."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from struct import Struct, error
from typing import IO

import msgspec
from armrig_core.commands.codes import OutcomeCode
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.file_records import (
    MAGIC,
    RECORD_HEAD,
    RECORD_LIMIT,
    CutOffError,
    FileRecord,
    Place,
)
from armrig_core.recording_file.manifest import (
    OUTCOME,
    RUN,
    Manifest,
    Outcome,
    check_whole_numbers,
)
from armrig_core.recording_file.opening import byte_source, regular_file
from armrig_core.recording_file.part_names import part_paths
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Metadata, MetadataIndex

from armrig.data.files import IMPORTED, RECORDING
from armrig.numerics.quantities import plural
from armrig.recordings.grid import check_sampling_time

VALIDATION_OF = "validation_of"
"""Key in a run's details; the value is the id of the run that this run validates."""
KINDS = ("blackbox", "greybox", "step", "staircase", "bla", "control", IMPORTED)
"""Kinds of recordings; a name that a person chose may follow the kind."""
REMOTE = "remote"
"""Kind of all recordings of `armrig record`."""
TEXT_LIMIT = 4096
"""Longest text in a summary, in characters."""

_EXPERIMENT = re.compile(rf"({'|'.join(KINDS)})(-validation)?(?:-(.+))?")
_HEAD_BYTES = 64  # a recording's header, with the profile and the library
_FOOTER = Struct("<BQQQI")  # opcode, length, start of the summary, start of the offsets, CRC
_FOOTER_BODY = 8 + 8 + 4
_PLACE = Struct("<QQ")  # offset and length of a record, in its index
_NAME_AT = 40  # place of the name in an attachment's index, after five numbers of 8 B
# By opcode of an index record: opcode of the record that it names, and position of the place.
_INDEXED: dict[int, tuple[int, int]] = {
    Opcode.CHUNK_INDEX: (Opcode.CHUNK, 16),
    Opcode.METADATA_INDEX: (Opcode.METADATA, 0),
    Opcode.ATTACHMENT_INDEX: (Opcode.ATTACHMENT, 0),
}


class ForeignError(DamageError):
    """Another program wrote the MCAP file."""


def is_recording(path: Path) -> bool:
    """Return True if the file at `path` is a recording of armrig, whatever its name is.

    If the file is empty or cannot be read, the suffix of its name decides.
    """
    first = part_paths(path)[0]
    try:
        with regular_file(first) as stream:
            magic = stream.read(len(MAGIC))
    except (OSError, DamageError):
        magic = b""
    if not magic:
        return RECORDING in path.suffixes
    return magic == MAGIC and not is_foreign(first)


def is_foreign(path: Path) -> bool:
    """Return True if another program wrote the MCAP file; False if the header is damaged.

    armrig writes its name into the header. If another program has rewritten a recording, the
    metadata of the run show that the file is a recording.
    """
    with byte_source(path) as source:
        head = source.read(_HEAD_BYTES) if source else b""
    if head[:1] != bytes([Opcode.HEADER]) or b"armrig" in head:
        return False
    try:
        return RUN not in read_metadata(path)
    except DamageError:
        return True


class RecordingSummary(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """Summary of a complete recording."""

    folder: Path
    """Folder of the file."""
    file: str
    """Name of the file."""
    size: int
    """Size of the file, in B."""
    rig: str
    """Id of the rig."""
    run_id: str
    """Id of the run."""
    experiment: str
    """Kind of experiment, followed by the name that a person chose, such as blackbox-monday."""
    validation_of: str
    """Id of the run that this run validates; "" without a recorded id."""
    started: str
    """Wall-clock time of the start, ISO 8601 with the offset from UTC."""
    Ts: float
    """Sampling time, in s."""
    samples: int
    """Number of samples in this file."""
    missing: int
    """Number of missing samples in this file."""
    outcome: str
    """`complete`, or the reason for an early end; `continued` if the run has a further file."""
    part: int
    """Number of the file in a long run, from 1; 0 if one file contains the whole run."""
    pacing: str
    """Clock that paces the samples: `scheduled` means the device's timer, `exchange` the host."""
    device: str
    """Unique id of the device; "" if it has none."""
    calibration_sha256: str
    """Hash of the attached calibration."""
    description_sha256: str
    """Hash of the attached description of the rig; "" in a recording of an older release."""
    armrig: str
    """Version of armrig that made the recording."""
    outcome_code: str
    """Code of the outcome: an `armrig_core.commands.codes.OutcomeCode`."""
    every: int = 1
    """Number of samples in a Ts: see `Manifest.every`."""
    law_sha256: str = ""
    """Hash of the law of a run in control; "" without a law."""

    @property
    def is_complete(self) -> bool:
        """True if the run ended with the last sample of its input."""
        return self.outcome_code == OutcomeCode.COMPLETE

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.folder / self.file

    @property
    def kind(self) -> str:
        """Kind of experiment, such as blackbox, without the name that a person chose."""
        return _parts(self.experiment)[0]

    @property
    def is_validation(self) -> bool:
        """True if the run was recorded to validate the model of another run."""
        return _parts(self.experiment)[1]

    @property
    def name(self) -> str:
        """Name that a person gave to the experiment; "" without a name."""
        return _parts(self.experiment)[2]

    @property
    def seconds(self) -> float:
        """Length of the recording in s, including missing samples."""
        return (self.samples + self.missing) * self.Ts / self.every

    def names(self, *, validation: bool) -> set[str]:
        """Return all names that select the recording: its name, run id, experiment and file name.

        A validation recording has the name of the recording that it validates. This name selects
        only the validated recording. If `validation` is True, return the names of the validated
        recording, or an empty set if this recording is not a validation recording.
        """
        if not validation:
            own_names = {self.name} if self.name and not self.is_validation else set()
            return own_names | {self.run_id, self.experiment, Path(self.file).stem}
        if not self.is_validation:
            return set()
        run_ids = {self.validation_of} if self.validation_of else set()
        return run_ids | ({self.name, f"{self.kind}-{self.name}"} if self.name else {self.kind})


@lru_cache(maxsize=1000)
def _parts(experiment: str) -> tuple[str, bool, str]:
    """Return the kind of an experiment, True for a validation, and the name of the experiment."""
    match = _EXPERIMENT.fullmatch(experiment)
    return (match[1], bool(match[2]), match[3] or "") if match else (experiment, False, "")


def summary_of(path: Path) -> RecordingSummary:
    """Return the summary of a recording; only a few kilobytes of the file are read.

    Raises OSError if the file cannot be read. Raises ForeignError if another program wrote the
    file. Raises DamageError if the file is incomplete, or not a recording of armrig.
    """
    try:
        metadata = read_metadata(path)
        for name in (RUN, OUTCOME):
            if name not in metadata:
                raise DamageError(f"it contains no metadata named {name}")
    except DamageError as err:
        if is_foreign(path):
            raise ForeignError("not made by armrig") from err
        raise
    try:
        manifest, outcome = Manifest.of(metadata[RUN]), Outcome.of(metadata[OUTCOME])
        check_whole_numbers(manifest)
        check_whole_numbers(outcome)
    except (msgspec.DecodeError, ValueError, RecursionError) as err:
        raise DamageError("its metadata are not armrig's") from err
    return _summary(path, manifest, outcome)


def _summary(path: Path, manifest: Manifest, outcome: Outcome) -> RecordingSummary:
    texts = {
        "rig": manifest.rig,
        "run_id": manifest.run_id,
        "experiment": manifest.experiment,
        "validation_of": str(manifest.details.get(VALIDATION_OF, "")),
        "started": manifest.started,
        "outcome": outcome.outcome,
        "pacing": manifest.pacing,
        "device": str(manifest.device.get("uid", "")),
        "calibration_sha256": manifest.calibration_sha256,
        "description_sha256": manifest.description_sha256,
        "law_sha256": manifest.controller_sha256 or "",
        "armrig": manifest.armrig,
        "outcome_code": outcome.code,
    }
    for name, text in texts.items():
        if len(text) > TEXT_LIMIT:
            raise DamageError(
                f"its {name} has {plural(len(text), 'character')}, more than {TEXT_LIMIT}"
            )
    if manifest.kind != IMPORTED:
        check_sampling_time(manifest)
    return RecordingSummary(
        folder=path.parent,
        file=path.name,
        size=path.stat().st_size,
        Ts=manifest.every * manifest.Ts,
        every=manifest.every,
        samples=outcome.samples,
        missing=outcome.missing,
        part=manifest.part,
        **texts,
    )


def path_text(path: Path) -> str:
    """Return a path as text; bytes that are invalid in this system's encoding are escaped."""
    return str(path).encode("utf-8", "backslashreplace").decode()


def read_metadata(path: Path) -> dict[str, dict[str, str]]:
    """Return the existing metadata records of a run and of its outcome, by name.

    A few short reads suffice for a recording of any length. Damaged samples are not detected,
    because the samples are not read.

    Raises OSError if the file cannot be opened or read. Raises DamageError if the file is not an
    MCAP file, or the summary at its end is missing or damaged.
    """
    with regular_file(path) as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise DamageError("not an MCAP file")
        try:
            return _records(stream, os.fstat(stream.fileno()).st_size)
        except (McapError, error, ValueError, OverflowError) as err:
            raise DamageError(f"its index cannot be read ({err or type(err).__name__})") from err


def _records(stream: IO[bytes], size: int) -> dict[str, dict[str, str]]:
    metadata: dict[str, dict[str, str]] = {}
    entries = (body for kind, body in index_records(stream, size) if kind == Opcode.METADATA_INDEX)
    for index in map(MetadataIndex.read, map(data_stream, entries)):
        # Only the first record of each name is read, as in a read of the whole file. An index of a
        # hundred thousand entries must not cause a hundred thousand reads.
        if index.name in (RUN, OUTCOME) and index.name not in metadata:
            opcode, body = _record(stream, index.offset)
            if opcode != Opcode.METADATA:
                raise DamageError("its index points to a record other than metadata")
            metadata[index.name] = Metadata.read(data_stream(body)).metadata
    return metadata


def read_by_index(
    stream: IO[bytes], size: int, left: tuple[str, ...]
) -> Iterator[FileRecord | None]:
    """Yield the schemas and channels of a file's index, and the records that the index names.

    The index contains the length of each record, so that a damaged head of a record costs nothing.
    The content of the attachments `left` is not read. None means that a record is too long or
    overlaps with the previous record. Raises the exceptions of `index_records`.
    """
    places = []
    left_names = tuple(len(name).to_bytes(4, "little") + name.encode() for name in left)
    for opcode, entry in index_records(stream, size):
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            yield FileRecord(opcode, entry, Place(0, 0))
        elif opcode in _INDEXED:
            kind, place_at = _INDEXED[opcode]
            is_left = kind == Opcode.ATTACHMENT and entry.startswith(left_names, _NAME_AT)
            places.append((*_PLACE.unpack_from(entry, place_at), kind, is_left))
    end = len(MAGIC)
    for begin, length, opcode, is_left in sorted(places):
        place = Place(begin + RECORD_HEAD.size, length - RECORD_HEAD.size)
        # No byte is read twice: a forged index could name the same record again and again.
        is_short = is_left or place.length <= RECORD_LIMIT
        if end <= begin and 0 <= place.length <= size - place.at and is_short:
            end = begin + length
            stream.seek(place.at)
            yield FileRecord(opcode, b"" if is_left else stream.read(place.length), place)
        else:
            yield None


def index_records(stream: IO[bytes], size: int) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of each record of a file's index, which precedes the footer.

    Raises DamageError or struct.error if the file has no index, or if the index is damaged.
    """
    end = size - _FOOTER.size - len(MAGIC)
    if end < len(MAGIC):
        raise CutOffError("it ends without its footer")
    stream.seek(end)
    tail = stream.read(_FOOTER.size + len(MAGIC))
    opcode, length, start, _, _ = _FOOTER.unpack(tail[: _FOOTER.size])
    if (opcode, length, tail[_FOOTER.size :]) != (Opcode.FOOTER, _FOOTER_BODY, MAGIC):
        raise CutOffError("it ends without its footer")
    if not len(MAGIC) <= start <= end or end - start > RECORD_LIMIT:
        raise DamageError("its footer does not point to a summary")
    stream.seek(start)
    summary, at = stream.read(end - start), 0
    while at + RECORD_HEAD.size <= len(summary):
        opcode, length = RECORD_HEAD.unpack_from(summary, at)
        at += RECORD_HEAD.size
        yield opcode, summary[at : at + length]
        at += length


def _record(stream: IO[bytes], offset: int) -> tuple[int, bytes]:
    stream.seek(offset)
    head = stream.read(RECORD_HEAD.size)
    opcode, length = RECORD_HEAD.unpack(head) if len(head) == RECORD_HEAD.size else (0, 0)
    if length > RECORD_LIMIT:
        raise DamageError(f"a record of {length} B is longer than the {RECORD_LIMIT} B allowed")
    return opcode, stream.read(length)


def data_stream(data: bytes) -> ReadDataStream:
    """Return the bytes of a record as a stream, from which mcap reads the record."""
    return ReadDataStream(BytesIO(data))
