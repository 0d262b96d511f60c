"""Runs in a folder, the items of a batch."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from armrig_core.recording_file.part_names import PART, part_number

from armrig.recordings.catalogue import Catalogue, catalogue, found_files
from armrig.recordings.recording_summary import shown_path

_LATEST_NS = (1 << 63) - 1
"""Latest time that a table can contain, in ns since 1970; this time is in the year 2262."""


class Item(NamedTuple):
    """A run, which was recorded in a single file or in several parts."""

    name: str
    """Name of the file in its folder, or the common name of a run's parts.

    Bytes of a file's name that are not UTF-8 are escaped.
    """
    path: str
    bytes: int
    modified_ns: int
    """Time of the last change of the file, or of the run's newest part, in ns."""
    validation: str
    """Path of the recording that validates this run's model; "" without such a recording."""


def items_in(
    folder: Path, *, rigs: Collection[str] = (), kinds: Collection[str] = ()
) -> list[Item]:
    """Return the runs in a folder, sorted by name.

    Parameters
    ----------
    rigs, kinds : collection of str
        Rigs and kinds of experiment of the returned runs; empty for all. An unreadable file is
        included only if `rigs` and `kinds` are both empty.

    Raises
    ------
    OSError
        The folder does not exist or cannot be read.
    """
    known = catalogue(folder)
    chosen = {
        s.file
        for s in known.recordings
        if s.rig in (rigs or (s.rig,)) and s.kind in (kinds or (s.kind,))
    }
    validations = _validations(known)
    runs: dict[str, list[tuple[str, int, int]]] = {}
    for name, state in found_files(folder):
        if name in chosen or not (rigs or kinds):
            runs.setdefault(_run(name), []).append((name, state.st_size, state.st_mtime_ns))
    return [
        Item(
            name=shown_path(Path(run)),
            path=str(folder / run),
            bytes=sum(size for _, size, _ in files),
            modified_ns=min(max(modified for _, _, modified in files), _LATEST_NS),
            validation=next((validations[n] for n, _, _ in files if n in validations), ""),
        )
        for run, files in sorted(runs.items())
    ]


def _run(name: str) -> str:
    """Return the name of the run to which a file belongs, from the name of the file."""
    return name.rpartition(PART)[0] + ".mcap" if part_number(Path(name)) else name


def _validations(known: Catalogue) -> dict[str, str]:
    """Return the paths of validation recordings, by the names of the files that they validate."""
    of_run = {s.run_id: s.file for s in known.recordings if not s.is_validation}
    return {
        of_run[s.validation_of]: str(s.path.with_name(_run(s.file)))
        for s in reversed(known.recordings)  # the newest validation of a run is used
        if s.is_validation and s.validation_of in of_run
    }
