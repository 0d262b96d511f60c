"""The MCAP file of imported data: named columns on one grid of instants, of no rig.

The file is a recording of the kind `imported`. Its only topic, `data`, has a JSON message for each
row: the values by the names of the columns, `null` if missing. The sequence number of a message is
the number of its instant. The manifest's details contain an `Import`.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import msgspec
import numpy as np
from armrig_core.commands.codes import COMPLETE, OutcomeCode
from armrig_core.errors import FileError
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.file_records import MESSAGE_HEAD, UNREADABLE
from armrig_core.recording_file.manifest import OUTCOME, RUN, Manifest, Outcome
from armrig_core.recording_file.recording_part import PROFILE
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Metadata
from mcap.writer import CompressionType, Writer

from armrig.data.columns import Matrix, Vector
from armrig.data.files import IMPORTED
from armrig.data.files.messages import mcap_records
from armrig.data.files.sampling_grid import Grid
from armrig.data.files.table import Column, Table, require_room
from armrig.data.step import Step

TOPIC = "data"
"""Topic of the rows."""
_SCHEMA = "armrig.Row"
_MAX_INSTANTS = 1 << 31


class ImportedSource(msgspec.Struct, frozen=True, kw_only=True):
    """A file from which data were imported."""

    name: str
    """Name of the file, without its folder."""
    sha256: str
    """Hash of the file, in hexadecimal digits."""


class Import(msgspec.Struct, frozen=True, kw_only=True):
    """Facts of an import, as the file contains them."""

    sources: tuple[ImportedSource, ...]
    """Files from which the data come."""
    options: dict[str, str] = {}
    """Reading options that the user gave, by name."""
    columns: tuple[Column, ...]
    """Names and units of the columns, in their order."""
    inputs: tuple[str, ...] = ()
    """Columns that the user named as inputs."""
    outputs: tuple[str, ...] = ()
    """Columns that the user named as outputs."""
    clock: str = ""
    """Column of the times; "" if the file has none, or its Ts is given elsewhere."""
    breaks: tuple[int, ...] = ()
    """Instants at which a new experiment begins."""
    history: tuple[tuple[str, str], ...] = ()
    """Steps of the reading: a sentence and its code."""
    values_sha256: str = ""
    """Hash of the instants and values, in hexadecimal digits."""

    def roles(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the inputs and the outputs that the user named, or else u and y, if they exist."""
        names = {column.name for column in self.columns}
        return self.inputs or (*{"u"} & names,), self.outputs or (*{"y"} & names,)


@dataclass(frozen=True, slots=True, kw_only=True)
class GridTable(Table):
    """Columns whose rows are on a known grid of instants."""

    grid: Grid
    """Grid of the rows."""


class ImportedData(msgspec.Struct, frozen=True, kw_only=True):
    """Imported columns on a grid of instants."""

    facts: Import
    """Facts of the import."""
    Ts: float
    """Sampling time, in s."""
    at: Any
    """Instant of each row, from 0, (N,)."""
    size: int
    """Number of instants; those without a row are missing."""
    values: Matrix
    """Values of the rows, (N, n), NaN where missing."""

    @property
    def sha256(self) -> str:
        """Hash of the instants and values, in hexadecimal digits."""
        parts = (np.asarray(self.at, "<i8"), np.asarray(self.values, "<f8") + 0.0)
        return hashlib.sha256(
            b"".join(np.ascontiguousarray(x).tobytes() for x in parts)
        ).hexdigest()

    def on_grid(self) -> dict[str, Vector]:
        """Return t, in s, and each column at all instants, NaN where missing, by name."""
        grid = Grid(Ts=self.Ts, at=self.at, size=self.size)
        names = [column.name for column in self.facts.columns]
        time = next(name for name in ("t", "time", "t_s", "time [s]") if name not in names)
        columns: dict[str, Vector] = {time: self.Ts * np.arange(self.size, dtype=np.float64)}
        return columns | {
            name: grid.place(x, held=False) for name, x in zip(names, self.values.T, strict=True)
        }

    def table(self) -> GridTable:
        """Return the data as a table on its grid."""
        return GridTable(
            columns=self.facts.columns,
            values=[*self.values.T],
            notes=[Step(text, code) for text, code in self.facts.history],
            grid=Grid(Ts=self.Ts, at=self.at, size=self.size, breaks=self.facts.breaks),
        )


def write_imported(
    data: ImportedData, *, name: str, started: str, armrig: str
) -> tuple[str, bytes]:
    """Return the run's id and the bytes of a file.

    Parameters
    ----------
    data : ImportedData
        Columns to write.
    name : str
        Name of the recording, as in `@lamp`.
    started : str
        Wall-clock time of the import, ISO 8601 with the offset from UTC.
    armrig : str
        Version of armrig.
    """
    digest = hashlib.sha256(started.encode())
    for source in data.facts.sources:
        digest.update(source.sha256.encode())
    run_id = digest.hexdigest()[:8]
    facts = msgspec.structs.replace(data.facts, values_sha256=data.sha256)
    manifest = Manifest(
        rig="",
        run_id=run_id,
        experiment=f"{IMPORTED}-{name}",
        details={IMPORTED: msgspec.to_builtins(facts)},
        Ts=data.Ts,
        samples=data.size,
        started=started,
        clock_offset_ns=0,
        armrig=armrig,
        protocol="",
    )
    rows = len(data.at)
    outcome = Outcome(
        outcome=COMPLETE.text,
        samples=rows,
        missing=data.size - rows,
        code=OutcomeCode.COMPLETE,
    )
    stream = BytesIO()
    writer = Writer(stream, compression=CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(profile=PROFILE, library=f"armrig {armrig}")
    names = [column.name for column in facts.columns]
    properties = {name: {"type": ["number", "null"]} for name in names}
    schema = msgspec.json.encode({"type": "object", "properties": properties})
    of_schema = writer.register_schema(_SCHEMA, "jsonschema", schema)
    channel = writer.register_channel(TOPIC, "json", of_schema)
    writer.add_metadata(RUN, manifest.metadata())
    for k, row in zip(data.at.tolist(), data.values.tolist(), strict=True):
        log_time = round(k * data.Ts * 1e9)
        content = msgspec.json.encode(dict(zip(names, row, strict=True)))  # NaN becomes null
        writer.add_message(channel, log_time, content, log_time, sequence=k)
    writer.add_metadata(OUTCOME, outcome.metadata())
    writer.finish()
    return run_id, stream.getvalue()


def import_in(manifest: Manifest) -> Import | None:
    """Return the facts of the import, or None if the recording is of a rig.

    Raises FileError if the facts are not those of an import.
    """
    if manifest.kind != IMPORTED:
        return None
    try:
        return msgspec.convert(manifest.details[IMPORTED], Import)
    except (KeyError, msgspec.ValidationError) as err:
        raise FileError("is not a whole import; import the original file again") from err


def read_imported(data: bytes) -> ImportedData | None:
    """Return the columns of an imported file; None if the MCAP file is another one.

    Raises FileError if the file is damaged.
    """
    if RUN.encode() not in data or f"{IMPORTED}-".encode() not in data:
        return None
    try:
        return _read(data)
    except (DamageError, *UNREADABLE, msgspec.MsgspecError, ValueError, RecursionError) as err:
        why = err if isinstance(err, DamageError | FileError) else type(err).__name__
        raise FileError(f"is damaged ({why}); import the original file again") from err


def _read(data: bytes) -> ImportedData | None:
    manifest, facts, names = None, None, list[str]()
    at, rows, is_whole = list[int](), list[list[float]](), False
    decoder = msgspec.json.Decoder(dict[str, float | None])
    for opcode, body in mcap_records(data):
        if opcode == Opcode.METADATA:
            record = Metadata.read(ReadDataStream(BytesIO(body)))
            is_whole |= record.name == OUTCOME
            if record.name == RUN:
                manifest = Manifest.of(record.metadata)
                if (facts := import_in(manifest)) is None:
                    return None
                names = [column.name for column in facts.columns]
        elif opcode == Opcode.MESSAGE:
            if facts is None:
                raise DamageError("a row before the manifest")
            row = decoder.decode(body[MESSAGE_HEAD.size :])
            at.append(MESSAGE_HEAD.unpack_from(body)[1])
            rows.append([np.nan if (x := row.get(name)) is None else x for name in names])
            require_room(8 * len(names) * len(rows), len(data))
    if manifest is None or facts is None:
        return None
    if not is_whole:
        raise DamageError("it ends too early")
    instants, size = np.array(at, dtype=np.int64), manifest.samples
    if not at or size > _MAX_INSTANTS or np.any(np.diff(instants) <= 0) or at[-1] >= size:
        raise DamageError("its rows are not in order")
    values = np.array(rows, dtype=np.float64).reshape(len(rows), len(names))
    imported = ImportedData(facts=facts, Ts=manifest.Ts, at=instants, size=size, values=values)
    if imported.sha256 != facts.values_sha256:
        raise DamageError("its values are not those of the import")
    return imported
