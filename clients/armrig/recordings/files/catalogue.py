"""Catalogue of a folder: a table of its recordings, read without their samples.

An index stores the facts about the recordings for later calls. The index is in the user's cache and
not in the folder. The folder may be read-only, and an index that another user wrote there cannot be
trusted. A damaged or outdated index is built again.
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from time import localtime, strftime, time_ns
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
import platformdirs
from armrig_core.process.bounded import read_bounded
from armrig_core.process.imports import load_extra
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.unfinished import unfinished_files
from numpy.typing import NDArray

from armrig.numerics.quantities import plural
from armrig.recordings.files.recording_summary import (
    ForeignError,
    RecordingSummary,
    path_text,
    summary_of,
)

if TYPE_CHECKING:
    from pandas import DataFrame


WORTH_KEEPING = 100
"""Least number of newly read files for which an index is written; reading fewer takes 20 ms."""
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
    "law_sha256": np.object_,
    "armrig": np.object_,
    "bytes": np.int64,
}
"""Columns of the table and their types; `facts_of` returns the values of a row."""
_PROPERTIES = {"experiment": "kind", "validation": "is_validation", "bytes": "size"}
"""Property of a summary, for the columns that have another name."""
SIZE_LIMIT = 128 << 20
"""Largest index that is read or written, in B; 10 000 recordings take about 4 MB."""
SETTLED_NS = 2_000_000_000
"""Least age of a file, in ns, from which every further change gives the file other time stamps.

The time stamps of a file system have a resolution of up to 2 s. If a file is younger than this age,
it may change and keep its time stamps.
"""
_SUFFIX = ".mcap"
_STAMP = "%Y%m%dT%H%M%S"
_FILE_NAME = re.compile(r".*-(\d{8}T\d{6})-[0-9a-f]{8}\.mcap")  # file names of the daemon


class LeftOut(NamedTuple):
    """A file that has the name of a recording but is not in the table."""

    path: Path
    why: str
    is_foreign: bool = False
    """True if another program wrote the file."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Catalogue:
    """The recordings of a folder, newest first; `len` returns their number.

    Examples
    --------
    >>> table = armrig.catalogue(armrig.example_recording().path.parent)
    >>> len(table), table.unfinished
    (1, ())
    >>> table.recordings[0].experiment, table.recordings[0].samples
    ('blackbox', 3000)
    """

    folder: Path
    """Folder of the recordings."""
    recordings: tuple[RecordingSummary, ...]
    """Summary of each complete recording; a long run has a summary for each part."""
    left_out: tuple[LeftOut, ...]
    """Files that are incomplete, unreadable or not recordings of armrig, with the reasons."""
    unfinished: tuple[Path, ...]
    """Files `*.mcap.active`: recordings in progress, or recordings of a daemon that died."""

    def __len__(self) -> int:
        """Return the number of recordings."""
        return len(self.recordings)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns of the table, each (N,), by the names that `armrig ls --json` uses.

        `started` is in UTC, to the millisecond; NaT if a recording contains no valid time of its
        start.

        Examples
        --------
        >>> columns = armrig.catalogue(armrig.example_recording().path.parent).columns()
        >>> columns["samples"], columns["Ts"]
        (array([3000]), array([0.01]))
        """
        rows = [facts_of(summary) for summary in self.recordings]
        for row in rows:
            row["started"] = _utc(row["started"])
        return {name: np.array([r[name] for r in rows], kind) for name, kind in COLUMNS.items()}

    def to_pandas(self) -> DataFrame:
        """Return the table as a pandas.DataFrame.

        Raises
        ------
        ImportError
            pandas is not installed.

        Examples
        --------
        >>> table = armrig.catalogue(armrig.example_recording().path.parent)
        >>> table.to_pandas()[["experiment", "samples", "Ts"]]
          experiment  samples    Ts
        0   blackbox     3000  0.01
        """
        pandas = load_extra("pandas", "pandas")
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

        Examples
        --------
        >>> import pandas
        >>> armrig.catalogue(armrig.example_recording().path.parent).to_parquet("all.parquet")
        >>> pandas.read_parquet("all.parquet").shape
        (1, 21)
        """
        pyarrow = load_extra("pyarrow", "parquet")
        parquet = load_extra("pyarrow.parquet", "parquet")
        columns: dict[str, Any] = self.columns()
        for name, column in columns.items():
            if name == "started":
                columns[name] = pyarrow.array(column, type=pyarrow.timestamp("ms", tz="UTC"))
            elif column.dtype == np.object_:
                columns[name] = pyarrow.array(column, type=pyarrow.string())
        parquet.write_table(pyarrow.table(columns), str(path))

    def __repr__(self) -> str:
        """Describe the catalogue in one line."""
        parts = [f"{plural(len(self), 'recording')} in {self.folder}"]
        parts += [f"{len(self.left_out)} left out"] if self.left_out else []
        parts += [f"{len(self.unfinished)} unfinished"] if self.unfinished else []
        return f"<Catalogue: {', '.join(parts)}>"


def catalogue(folder: str | Path) -> Catalogue:
    """Return the recordings of a folder as one table, newest first.

    The function reads only the summary at the end of each file, not the samples. The results of a
    large folder are stored in the user's cache. A later call then opens only new and changed files.

    Parameters
    ----------
    folder : str or Path
        Folder of the recordings; its subfolders are not read.

    Returns
    -------
    Catalogue
        `recordings`, `left_out` with reasons, `unfinished`; `columns()`, `to_pandas()`,
        `to_parquet(path)`.

    Raises
    ------
    OSError
        The folder does not exist or cannot be read.

    Examples
    --------
    The example uses the folder of the example recording.

    >>> folder = armrig.example_recording().path.parent
    >>> armrig.catalogue(folder)
    <Catalogue: 1 recording in ...>
    >>> [recording.run_id for recording in armrig.catalogue(folder).recordings]
    ['64ad4518']
    """
    folder = Path(folder)
    looked_ns, files = time_ns(), recording_files(folder)
    before = read_index(folder) if len(files) >= WORTH_KEEPING else {}
    rows: list[RecordingSummary] = []
    left_out: list[LeftOut] = []
    kept: dict[str, Known] = {}
    for name, state in files:
        facts = before.get(name)
        if facts is None or facts.state != state_of(state):
            try:
                facts = Known(state_of(state), summary_of(folder / name))
            except DamageError as err:
                facts = Known(state_of(state), str(err), isinstance(err, ForeignError))
            except OSError as err:  # the error may be temporary, so it is not kept
                left_out.append(LeftOut(folder / name, err.strerror or str(err)))
                continue
        # Each later change of a settled file gives the file other time stamps.
        if max(state.st_mtime_ns, state.st_ctime_ns) < looked_ns - SETTLED_NS:
            kept[name] = facts
        if isinstance(facts.found, str):
            left_out.append(LeftOut(folder / name, facts.found, facts.is_foreign))
        else:
            rows.append(facts.found)
    if sum(facts is not before.get(name) for name, facts in kept.items()) >= WORTH_KEEPING:
        write_index(folder, kept)
    return Catalogue(
        folder=folder,
        recordings=tuple(rows),
        left_out=tuple(left_out),
        unfinished=tuple(unfinished_files(folder)),
    )


def facts_of(summary: RecordingSummary) -> dict[str, Any]:
    """Return the facts of a recording by name, as `--json` prints them."""
    facts = {"recording": path_text(summary.path), "validation_of": summary.validation_of or None}
    return {
        name: facts[name] if name in facts else getattr(summary, _PROPERTIES.get(name, name))
        for name in COLUMNS
    }


def _utc(text: str) -> datetime | None:
    """Return a time, converted to UTC; None if the text is not a time with an offset from UTC."""
    try:
        when = datetime.fromisoformat(text)
        return when.astimezone(UTC).replace(tzinfo=None) if when.tzinfo else None
    except (ValueError, OverflowError):
        return None


class Known(msgspec.Struct, frozen=True, array_like=True):
    """Facts that the index stores about a file."""

    state: str
    """Size, times and inode number of the file: a text that changes if the file changes."""
    found: RecordingSummary | str
    """Summary of the recording, or the reason why the file cannot be listed."""
    is_foreign: bool = False
    """True if another program wrote the file."""


class _Index(msgspec.Struct, frozen=True):
    """Content of the index, as JSON."""

    armrig: str
    """Version of armrig that wrote the index; other versions may read a recording differently."""
    folder: str
    files: dict[str, Known]
    """Facts by the names of the files."""


def state_of(status: os.stat_result) -> str:
    """Return a text that changes if the file is changed or replaced."""
    return f"{status.st_size} {status.st_mtime_ns} {status.st_ctime_ns} {status.st_ino}"


def read_index(folder: Path) -> dict[str, Known]:
    """Return the facts about a folder's files by name; an empty dict without a valid index."""
    try:
        data = read_bounded(_path(folder), SIZE_LIMIT)
        index = msgspec.json.decode(data, type=_Index, dec_hook=lambda *_: folder)
    except (OSError, RuntimeError, msgspec.DecodeError, ValueError, RecursionError):
        return {}
    ours = index.armrig == version("armrig") and index.folder == str(folder.absolute())
    return index.files if ours else {}


def write_index(folder: Path, files: Mapping[str, Known]) -> None:
    """Store the facts about a folder's files, if the cache can be written.

    If two processes write at the same time, the complete index of one process remains.
    """
    stored_files = {name: file for name, file in files.items() if _is_text(name)}
    index = _Index(armrig=version("armrig"), folder=str(folder.absolute()), files=stored_files)
    try:
        path = _path(folder)
        # The folder is the same in all rows, so the file contains it only once.
        data = msgspec.json.encode(index, enc_hook=lambda _: None)
    except (RuntimeError, UnicodeEncodeError):  # no home, or a folder's name that is not text
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


class FoundFile(NamedTuple):
    """A file with the name of a recording."""

    name: str  # not a Path: creating 10 000 Paths takes longer than finding the files
    state: os.stat_result
    """Size, times and inode number of the file; a link is followed to its file."""


def recording_files(folder: Path) -> list[FoundFile]:
    """Return the finished recordings of a folder, newest first.

    A file is sorted by the time in its name if the daemon named it, and by its modification time
    otherwise. A recording in progress is left out: its name is `*.mcap.active`.

    Raises OSError if the folder does not exist or cannot be read.
    """
    files = []
    with os.scandir(folder) as entries:
        for entry in entries:
            if not entry.name.endswith(_SUFFIX) or entry.name == _SUFFIX:
                continue
            with suppress(OSError):  # the file was removed, or is a link to nothing
                state = entry.stat()
                if stat.S_ISREG(state.st_mode):
                    files.append(FoundFile(entry.name, state))
    return sorted(files, key=_age, reverse=True)


def newest_first(folder: Path) -> list[Path]:
    """Return the paths of `found_files`; an empty list if the folder does not exist."""
    try:
        return [folder / file.name for file in recording_files(folder)]
    except (FileNotFoundError, NotADirectoryError):
        return []


def summaries(paths: list[Path]) -> Iterator[RecordingSummary]:
    """Yield the summaries of the complete files, in the order of `paths`; leave out other files."""
    for path in paths:
        try:
            yield summary_of(path)
        except (OSError, DamageError):
            continue


def may_answer_to(path: Path, name: str, *, validation: bool) -> bool:
    """Return False if the daemon's file name shows that `name` does not select this file."""
    wanted = "-validation" if validation else name
    return wanted in path.name or not _FILE_NAME.fullmatch(path.name)


def _age(file: FoundFile) -> tuple[str, float, str]:
    """Return the sort key by age: the time in the daemon's file name, or the modification time."""
    changed = file.state.st_mtime
    match = _FILE_NAME.fullmatch(file.name)
    return match[1] if match else _local_stamp(changed), changed, file.name


def _local_stamp(changed: float) -> str:
    try:
        return strftime(_STAMP, localtime(changed))
    except (ValueError, OverflowError, OSError):  # a year outside the calendar
        return ""
