"""The runs in a folder, each one item of a batch."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from armrig_core.recording_file.part_names import PART, part_number

from armrig.recordings.catalogue import Catalogue, catalogue
from armrig.recordings.folder import found_files
from armrig.recordings.recording_summary import shown_path

_LATEST_NS = (1 << 63) - 1
"""The last time that a table holds: in the year 2262."""


class Item(NamedTuple):
    """One run: a file, or all parts of it."""

    name: str
    """Of the file, in its folder; of a run in parts the name that stands for them all. Always text,
    though the name of a file need be none: bytes that are no UTF-8 are escaped.
    """
    path: str
    bytes: int
    modified_ns: int
    """When the file, or the youngest of its parts, was written last."""
    validation: str
    """Path of the recording that validates what this one gives; "" without one."""


def items_in(
    folder: Path, *, rigs: Collection[str] = (), kinds: Collection[str] = ()
) -> list[Item]:
    """Return the runs in a folder, by name.

    Parameters
    ----------
    rigs, kinds : collection of str
        Only these rigs, and kinds of experiment; empty for all. A file that does not say what it is
        of is in no such choice.

    Raises
    ------
    OSError
        There is no such folder, or it cannot be read.
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
    """Return the name of the run that a file is of, or is a part of."""
    return name.rpartition(PART)[0] + ".mcap" if part_number(Path(name)) else name


def _validations(known: Catalogue) -> dict[str, str]:
    """Return the paths of the validations, by the files of the recordings that they validate."""
    of_run = {s.run_id: s.file for s in known.recordings if not s.is_validation}
    return {
        of_run[s.validation_of]: str(s.path.with_name(_run(s.file)))
        for s in reversed(known.recordings)  # the newest counts
        if s.is_validation and s.validation_of in of_run
    }
