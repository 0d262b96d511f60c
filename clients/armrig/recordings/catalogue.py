"""The catalogue of a folder: thousands of recordings as one table, read without their samples.

What is known of the recordings of a folder, kept from one look to the next.

It lies in this user's cache and not beside the recordings: a folder may be read-only, and what
another user writes there is not believed. Whatever is wrong with it, it is made anew.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
import platformdirs
from armrig_core.bounded import read_bounded
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.unfinished import unfinished
from numpy.typing import NDArray

from armrig.recordings.export import imported
from armrig.recordings.folder import found_files
from armrig.recordings.recording_summary import RecordingSummary, shown_path, summary_of

if TYPE_CHECKING:
    from pandas import DataFrame


WORTH_KEEPING = 100
"""So many files that were read anew are worth an index: to read fewer again takes 20 ms."""
COLUMNS: dict[str, Any] = {
    "recording": np.object_,
    "run_id": np.object_,
    "rig": np.object_,
    "started": "datetime64[ms]",
    "experiment": np.object_,
    "name": np.object_,
    "validation": np.bool_,
    "validation_of": np.object_,
    "seconds": np.float64,
    "Ts": np.float64,
    "samples": np.int64,
    "missing": np.int64,
    "outcome": np.object_,
    "outcome_code": np.object_,
    "part": np.int64,
    "pacing": np.object_,
    "device": np.object_,
    "calibration_sha256": np.object_,
    "armrig": np.object_,
    "bytes": np.int64,
}
"""Columns of the table and their types: what `facts_of` says of each recording."""
SIZE_LIMIT = 128 << 20
"""Longest index that is read or written, in B; 10 000 recordings take about 4 MB."""
SETTLED_NS = 2_000_000_000
"""A file that was changed since so long before we looked may be changed again with the same times.

Those of a file system are as coarse as a clock tick, on some systems a second or two.
"""


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


def columns(recordings: Sequence[RecordingSummary]) -> dict[str, NDArray[Any]]:
    """Return the table of these recordings by columns, each (N,)."""
    rows = [facts_of(summary) for summary in recordings]
    for row in rows:
        row["started"] = _utc(row["started"])
    return {name: np.array([r[name] for r in rows], kind) for name, kind in COLUMNS.items()}


def facts_of(summary: RecordingSummary) -> dict[str, Any]:
    """Return the facts of a recording by name, as `--json` prints them."""
    return {
        "recording": shown_path(summary.path),
        "run_id": summary.run_id,
        "rig": summary.rig,
        "started": summary.started,
        "experiment": summary.kind,
        "name": summary.name,
        "validation": summary.is_validation,
        "validation_of": summary.validation_of or None,
        "seconds": summary.seconds,
        "Ts": summary.Ts,
        "samples": summary.samples,
        "missing": summary.missing,
        "outcome": summary.outcome,
        "outcome_code": summary.outcome_code,
        "part": summary.part,
        "pacing": summary.pacing,
        "device": summary.device,
        "calibration_sha256": summary.calibration_sha256,
        "armrig": summary.armrig,
        "bytes": summary.size,
    }


def _utc(text: str) -> datetime | None:
    """Return a time of day in UTC, without saying so; None where the text names none."""
    try:
        when = datetime.fromisoformat(text)
        return when.astimezone(UTC).replace(tzinfo=None) if when.tzinfo else None
    except (ValueError, OverflowError):
        return None


class Known(msgspec.Struct, frozen=True, array_like=True):
    """What a file was found to be."""

    state: str
    """Size, times and number of the file at that time: another one has others."""
    found: RecordingSummary | str
    """What it says of itself, or why it cannot be listed."""


class _Index(msgspec.Struct, frozen=True):
    """The file, as JSON."""

    armrig: str
    """Version that wrote it; another one may read a recording differently."""
    folder: str
    files: dict[str, Known]
    """By the files' names."""


def state_of(found: os.stat_result) -> str:
    """Return what changes with a file, whatever replaces or changes it."""
    return f"{found.st_size} {found.st_mtime_ns} {found.st_ctime_ns} {found.st_ino}"


def is_settled(found: os.stat_result, looked_ns: int) -> bool:
    """Return whether a change of the file after `looked_ns` would show in its times."""
    return max(found.st_mtime_ns, found.st_ctime_ns) < looked_ns - SETTLED_NS


def now_ns() -> int:
    """Return the time on the clock that files have their times from."""
    return time.time_ns()


def read_index(folder: Path) -> dict[str, Known]:
    """Return what is known of a folder's files by their names; nothing where there is no index."""
    try:
        data = read_bounded(_path(folder), SIZE_LIMIT)
        index = msgspec.json.decode(data, type=_Index, dec_hook=lambda *_: folder)
    except (OSError, RuntimeError, msgspec.DecodeError, ValueError, RecursionError):
        return {}
    ours = index.armrig == version("armrig") and index.folder == str(folder.absolute())
    return index.files if ours else {}


def write_index(folder: Path, files: Mapping[str, Known]) -> None:
    """Keep what is known; where nothing can be written, nothing is kept.

    Two processes that do so at once leave the index of one of them, whole.
    """
    known = {name: file for name, file in files.items() if _is_text(name)}
    index = _Index(armrig=version("armrig"), folder=str(folder.absolute()), files=known)
    try:
        path = _path(folder)
        # Each row has the folder, which need not stand in the file ten thousand times.
        data = msgspec.json.encode(index, enc_hook=lambda _: None)
    except (RuntimeError, UnicodeEncodeError):  # no home; a folder whose name is no text
        return
    if len(data) > SIZE_LIMIT:
        return
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        file = tempfile.NamedTemporaryFile(dir=path.parent, delete=False)  # noqa: SIM115
        written = Path(file.name)
        try:
            with file:
                file.write(data)
            written.replace(path)
        except BaseException:
            written.unlink()
            raise


def _path(folder: Path) -> Path:
    name = hashlib.sha256(os.fsencode(folder.absolute())).hexdigest()[:32]
    return Path(platformdirs.user_cache_dir("armrig")) / "catalogues" / f"{name}.json"


def _is_text(name: str) -> bool:
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True
