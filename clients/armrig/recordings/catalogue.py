"""The catalogue of a folder: thousands of recordings as one table, read without their samples."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.unfinished import unfinished
from numpy.typing import NDArray

from armrig.recordings.catalogue_columns import columns
from armrig.recordings.catalogue_index import (
    Known,
    is_settled,
    now_ns,
    read_index,
    state_of,
    write_index,
)
from armrig.recordings.export import imported
from armrig.recordings.folder import found_files
from armrig.recordings.recording_summary import RecordingSummary, summary_of

if TYPE_CHECKING:
    from pandas import DataFrame

WORTH_KEEPING = 100
"""So many files that were read anew are worth an index: to read fewer again takes 20 ms."""


class LeftOut(NamedTuple):
    """A file with the name of a recording that is not in the table."""

    path: Path
    why: str


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Catalogue:
    """The recordings of a folder, newest first; `len` counts them."""

    folder: Path
    """The folder."""
    recordings: tuple[RecordingSummary, ...]
    """What each whole recording says of itself; a long run has one for each of its parts."""
    left_out: tuple[LeftOut, ...]
    """Files that are not whole, or no recordings of armrig, and why."""
    unfinished: tuple[Path, ...]
    """Recordings that are being written, or were left by a daemon that died (`*.mcap.active`)."""

    def __len__(self) -> int:
        """Return the number of recordings."""
        return len(self.recordings)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the table by columns, each (N,), with the names of `armrig ls --json`.

        `started` is in UTC, to the millisecond; NaT where a recording names no such time.
        """
        return columns(self.recordings)

    def to_pandas(self) -> DataFrame:
        """Return the table as a pandas.DataFrame.

        Raises
        ------
        ImportError
            pandas is not installed.
        """
        pandas = imported("pandas", "pandas")
        frame: DataFrame = pandas.DataFrame(self.columns())
        frame["started"] = frame["started"].dt.tz_localize("UTC")
        return frame

    def to_parquet(self, path: str | Path) -> None:
        """Write the table as a Parquet file.

        Raises
        ------
        ImportError
            pyarrow is not installed.
        OSError
            The file cannot be written.
        """
        pyarrow = imported("pyarrow", "parquet")
        parquet = imported("pyarrow.parquet", "parquet")
        columns: dict[str, Any] = self.columns()
        for name, column in columns.items():
            if name == "started":
                columns[name] = pyarrow.array(column, type=pyarrow.timestamp("ms", tz="UTC"))
            elif column.dtype == np.object_:
                columns[name] = pyarrow.array(column, type=pyarrow.string())
        parquet.write_table(pyarrow.table(columns), str(path))

    def __repr__(self) -> str:
        """Say it in a line."""
        parts = [f"{len(self)} recordings in {self.folder}"]
        parts += [f"{len(self.left_out)} left out"] if self.left_out else []
        parts += [f"{len(self.unfinished)} unfinished"] if self.unfinished else []
        return f"<Catalogue: {', '.join(parts)}>"


def catalogue(folder: str | Path) -> Catalogue:
    """Return the recordings of a folder as one table, newest first.

    Built from what each file says of itself at its end; no sample is read. What was found is kept
    in this user's cache, so that next time only files that are new or changed are opened.

    Parameters
    ----------
    folder : str or Path
        The folder; those in it are not looked into.

    Returns
    -------
    Catalogue
        `recordings`, `left_out` with reasons, `unfinished`; `columns()`, `to_pandas()`,
        `to_parquet(path)`.

    Raises
    ------
    OSError
        There is no such folder, or it cannot be read.
    """
    folder = Path(folder)
    looked_ns, files = now_ns(), found_files(folder)
    before = read_index(folder) if len(files) >= WORTH_KEEPING else {}
    rows: list[RecordingSummary] = []
    left_out: list[LeftOut] = []
    kept: dict[str, Known] = {}
    for name, state in files:
        known = before.get(name)
        if known is None or known.state != state_of(state):
            try:
                known = Known(state_of(state), _said_by(folder / name))
            except OSError as err:  # it may be allowed, or be there again, next time
                left_out.append(LeftOut(folder / name, err.strerror or str(err)))
                continue
        if is_settled(state, looked_ns):
            kept[name] = known
        if isinstance(known.found, str):
            left_out.append(LeftOut(folder / name, known.found))
        else:
            rows.append(known.found)
    if sum(known is not before.get(name) for name, known in kept.items()) >= WORTH_KEEPING:
        write_index(folder, kept)
    return Catalogue(
        folder=folder,
        recordings=tuple(rows),
        left_out=tuple(left_out),
        unfinished=tuple(unfinished(folder)),
    )


def _said_by(path: Path) -> RecordingSummary | str:
    """Return what a file says of itself, or why it cannot be listed."""
    try:
        return summary_of(path)
    except DamageError as err:
        return str(err)
