"""Immediate storage of each computed row, so that a later start continues the batch."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from contextlib import suppress
from pathlib import Path

import msgspec
from armrig_core.errors import OperationError
from armrig_core.recording_file.opening import lock

from armrig.report.batch.tasks import Item, Row

OTHER = (
    "contains results of another folder, task or selection, or of other options or versions; "
    "choose another -o, or use --force to begin again"
)
"""Message if the header of earlier results differs from the header of this start."""
SUFFIX = ".progress"
"""Suffix of the file with the rows so far; the file's name begins with the name of the table."""


class Progress:
    """An open file with one row per line; the first line contains the header of the task."""

    def __init__(self, table: Path, header: dict[str, str], *, anew: bool = False) -> None:
        """Open the file, or create it; with `anew` the rows of an earlier start are discarded.

        Raises
        ------
        OperationError
            The file belongs to another task, is not a regular file, or is used by another process;
            or the disk is full.
        OSError
            The file cannot be opened.
        """
        self.path = table.with_name(table.name + SUFFIX)
        if self.path.exists() and not self.path.is_file():  # such as a link to an endless device
            raise OperationError(
                f"{self.path} exists and is not a file; remove it, or give another -o"
            )
        self._file = self.path.open("a+b")
        try:
            lock(self._file)
        except BlockingIOError as err:
            self._file.close()
            raise OperationError(
                f"{self.path}: another armrig batch uses it; wait for its end, or give another -o"
            ) from err
        self._file.seek(0)
        content = self._file.read()
        whole, _, torn = content.rpartition(b"\n")
        first, *lines = whole.split(b"\n") if whole else [b""]
        self.rows: list[Row] = []
        """Rows of an earlier start."""
        if anew or not first:
            self._file.truncate(0)
            self.add(header)
            return
        if _decoded(first) != header:
            self._file.close()
            raise OperationError(f"{self.path} {OTHER}")
        if torn:  # the process was killed within a line
            self._file.truncate(len(content) - len(torn))
        self.rows = [row for line in lines if (row := _decoded(line)) is not None]

    def add(self, row: Row) -> None:
        """Store a row; a stored row is not lost if this process dies."""
        try:
            self._file.write(msgspec.json.encode(row) + b"\n")
            self._file.flush()
        except OSError as err:
            raise OperationError(
                f"{self.path}: {err.strerror}; results so far are kept: repeat the command to "
                "continue"
            ) from err

    def remove(self) -> None:
        """Remove the file, because the table is complete."""
        self.path.unlink()

    def __enter__(self) -> Progress:
        """Return this object."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file without removing it."""
        with suppress(OSError):  # the error of a full disk was reported before
            self._file.close()


def still_right(
    rows: Iterable[Row], items: Iterable[Item], columns: Collection[str]
) -> dict[str, Row]:
    """Return the rows, by name, of the items whose files have not changed.

    An item without a returned row is computed again. A row with a problem is left out, because a
    killed process or a full disk may have caused the problem. A row without all columns is left
    out. The row of a report is left out if its validation recording has changed.
    """
    state = {item.name: (item.bytes, item.modified_ns) for item in items}
    validated_by = {item.name: Path(item.validation).name for item in items}
    return {
        row["recording"]: row
        for row in rows
        if row.keys() == set(columns)
        and not row["problem"]
        and state.get(name := str(row["recording"])) == (row["bytes"], row["modified_ns"])
        and row.get("validated_by", validated_by[name]) == validated_by[name]
    }


def _decoded(line: bytes) -> dict[str, object] | None:
    try:
        return msgspec.json.decode(line, type=dict[str, object])
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
