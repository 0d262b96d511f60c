"""The recordings in a folder, newest first."""

from __future__ import annotations

import os
import re
import stat
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from armrig_core.recording_file.budget import DamageError

from armrig.recordings.recording_summary import RecordingSummary, summary_of

_SUFFIX = ".mcap"
_STAMP = "%Y%m%dT%H%M%S"
_FILE_NAME = re.compile(r".*-(\d{8}T\d{6})-[0-9a-f]{8}\.mcap")  # as the daemon names them


class FoundFile(NamedTuple):
    """A file with the name of a recording."""

    name: str  # and no Path: to make ten thousand of them takes longer than to find the files
    state: os.stat_result
    """Of the file itself, where a link leads to it."""


def found_files(folder: Path) -> list[FoundFile]:
    """Return the finished recordings of a folder, by the time in their names, or of the files.

    A run that is still going writes to another name, `*.mcap.active`.

    Raises
    ------
    OSError
        There is no such folder, or it cannot be read.
    """
    found = []
    with os.scandir(folder) as entries:
        for entry in entries:
            if not entry.name.endswith(_SUFFIX) or entry.name == _SUFFIX:
                continue
            with suppress(OSError):  # it is gone by now, or a link that leads nowhere
                state = entry.stat()
                if stat.S_ISREG(state.st_mode):
                    found.append(FoundFile(entry.name, state))
    return sorted(found, key=_age, reverse=True)


def newest_first(folder: Path) -> list[Path]:
    """Return the paths of `found_files`; none where there is no such folder."""
    try:
        return [folder / file.name for file in found_files(folder)]
    except (FileNotFoundError, NotADirectoryError):
        return []


def summaries(paths: list[Path]) -> Iterator[RecordingSummary]:
    """Give the summaries of those that are whole, in the same order; read as they are asked for."""
    for path in paths:
        try:
            yield summary_of(path)
        except (OSError, DamageError):
            continue


def may_answer_to(path: Path, name: str, *, validation: bool) -> bool:
    """Return whether a file may be meant by a name: a name of the daemon's says that it is not."""
    wanted = "-validation" if validation else name
    return wanted in path.name or not _FILE_NAME.fullmatch(path.name)


def _age(file: FoundFile) -> tuple[str, float, str]:
    """Return what sorts by age: the stamp of the daemon's name, or of the file's own time."""
    changed = file.state.st_mtime
    found = _FILE_NAME.fullmatch(file.name)
    return found[1] if found else _local_stamp(changed), changed, file.name


def _local_stamp(changed: float) -> str:
    try:
        return time.strftime(_STAMP, time.localtime(changed))
    except (ValueError, OverflowError, OSError):  # a year that no calendar has
        return ""
