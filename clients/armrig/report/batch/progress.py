"""The rows that are done, kept as they come: whatever dies, the next start goes on behind them."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from contextlib import suppress
from pathlib import Path
from types import TracebackType

import msgspec
from armrig_core.errors import OperationError
from armrig_core.recording_file.file_lock import lock

from armrig.report.batch.items import Item
from armrig.report.batch.rows import Row

OTHER = (
    "holds what came of another folder, task or choice, of other options or versions; give another "
    "-o, or --force to begin anew"
)
"""What is said of results that are not mixed with those of another header."""
SUFFIX = ".progress"
"""Behind the name of the table while it is not complete."""


class Progress:
    """An open file of rows, one a line, behind a first line that says of which task they are."""

    def __init__(self, table: Path, header: dict[str, str], *, anew: bool = False) -> None:
        """Open it, or make it.

        Parameters
        ----------
        anew : bool
            What an earlier start has left is thrown away.

        Raises
        ------
        OperationError
            It is of another task, is no file, or is open elsewhere; the disk is full.
        OSError
            It cannot be opened.
        """
        self.path = table.with_name(table.name + SUFFIX)
        if self.path.exists() and not self.path.is_file():  # such as a link to what never ends
            raise OperationError(
                f"{self.path} is there and is no file; remove it, or give another -o"
            )
        self._file = self.path.open("a+b")
        try:
            lock(self._file)
        except BlockingIOError as err:
            self._file.close()
            raise OperationError(
                f"{self.path}: another armrig batch is at it; wait for it, or give another -o"
            ) from err
        self._file.seek(0)
        content = self._file.read()
        whole, _, torn = content.rpartition(b"\n")
        first, *lines = whole.split(b"\n") if whole else [b""]
        self.rows: list[Row] = []
        """Those that an earlier start has left."""
        if anew or not first:
            self._file.truncate(0)
            self._write(header)
            return
        if _decoded(first) != header:
            self._file.close()
            raise OperationError(f"{self.path} {OTHER}")
        if torn:  # the process was killed within a line
            self._file.truncate(len(content) - len(torn))
        self.rows = [row for line in lines if (row := _decoded(line)) is not None]

    def add(self, row: Row) -> None:
        """Keep a row; it survives the death of this process from here on."""
        self._write(row)

    def remove(self) -> None:
        """Remove the file: the table is complete."""
        self.path.unlink()

    def __enter__(self) -> Progress:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the file, which stays."""
        with suppress(OSError):  # of a row for which there was no room, and which was told
            self._file.close()

    def _write(self, value: object) -> None:
        try:
            self._file.write(msgspec.json.encode(value) + b"\n")
            self._file.flush()
        except OSError as err:
            raise OperationError(
                f"{self.path}: {err.strerror}; what is done is kept, and the same command goes on"
            ) from err


def still_right(
    rows: Iterable[Row], items: Iterable[Item], columns: Collection[str]
) -> dict[str, Row]:
    """Return, by name, the results of those items whose files have not changed since.

    What had a problem is tried again: a process may have been killed, a disk full. A row without
    all columns is none of ours. A report counts where it is of the validation that is there now.
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
