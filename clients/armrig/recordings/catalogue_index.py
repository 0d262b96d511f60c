"""What is known of the recordings of a folder, kept from one look to the next.

It lies in this user's cache and not beside the recordings: a folder may be read-only, and what
another user writes there is not believed. Whatever is wrong with it, it is made anew.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

import msgspec
import platformdirs
from armrig_core.bounded import read_bounded

from armrig.recordings.recording_summary import RecordingSummary

SIZE_LIMIT = 128 << 20
"""Longest index that is read or written, in B; 10 000 recordings take about 4 MB."""
SETTLED_NS = 2_000_000_000
"""A file that was changed since so long before we looked may be changed again with the same times.

Those of a file system are as coarse as a clock tick, on some systems a second or two.
"""


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
