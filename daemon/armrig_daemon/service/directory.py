"""The directory of the recordings: whether it can take one, and what was left in it."""

from __future__ import annotations

import errno
import os
import shutil
import stat
import sys
from pathlib import Path
from typing import NamedTuple

from armrig_daemon.service.file_lock import is_locked


class LeftOver(NamedTuple):
    """What has the name of an unfinished recording."""

    path: Path
    error: str = ""
    """Why it cannot be looked at, for a person; empty for a recording that nobody writes."""


def left_over(directory: Path, rig: str) -> list[LeftOver]:
    """Return what a daemon of this rig left unfinished, and what only looks like it."""
    try:
        paths = sorted(directory.glob(f"{rig}-*.mcap.active"))
    except OSError:  # where nothing can be read nothing is found; a run will be told why
        return []
    found = []
    for path in paths:
        try:
            if not _is_written(path):
                found.append(LeftOver(path))
        except FileNotFoundError:  # its daemon has just finished it
            continue
        except OSError as err:
            found.append(LeftOver(path, err.strerror or str(err)))
    return found


def _is_written(path: Path) -> bool:
    """Return whether a recording is being written; raises OSError for what is no file."""
    # Seen before it is opened: opening a device may do something, and a link leads elsewhere.
    if not stat.S_ISREG(path.lstat().st_mode):
        raise OSError(errno.EINVAL, "not a regular file")
    # And should it be another one by now, a pipe is still not waited for.
    fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        return is_locked(fd)
    finally:
        os.close(fd)


def check_directory(directory: Path, needed: int) -> str:
    """Return why nothing can be recorded in `directory`, or nothing."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        room = shutil.disk_usage(directory).free
    except OSError as err:
        return f"{directory}: {err.strerror}; set [recording] directory"
    if not os.access(directory, os.W_OK | os.X_OK):
        return f"{directory}: not writable; set [recording] directory"
    if room < needed:
        return f"{directory}: {room / 1e6:.0f} MB free, {needed / 1e6:.0f} MB needed; free the disk"
    return ""


def sync_directory(directory: Path) -> None:
    """Have the names in `directory` on the disk, where the system can be asked for that."""
    if sys.platform == "win32":  # it opens no directory
        return
    fd = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
