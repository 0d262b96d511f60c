"""The directory of the recordings: whether it can take one, and what was left in it."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path


def left_over(directory: Path, rig: str) -> list[Path]:
    """Return the recordings of a rig that a daemon left unfinished: nobody writes them now."""
    try:
        return sorted(p for p in directory.glob(f"{rig}-*.mcap.active") if not _is_written(p))
    except OSError:  # where nothing can be read nothing is found; a run will be told why
        return []


def _is_written(path: Path) -> bool:
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        return False


def check_directory(directory: Path, needed: int) -> str:
    """Return why nothing can be recorded in `directory`, or nothing."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        free = os.statvfs(directory)
    except OSError as err:
        return f"{directory}: {err.strerror}; set [recording] directory"
    if not os.access(directory, os.W_OK | os.X_OK):
        return f"{directory}: not writable; set [recording] directory"
    room = free.f_bavail * free.f_frsize
    if room < needed:
        return f"{directory}: {room / 1e6:.0f} MB free, {needed / 1e6:.0f} MB needed; free the disk"
    return ""


def sync_directory(directory: Path) -> None:
    """Have the names in `directory` on the disk."""
    fd = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
