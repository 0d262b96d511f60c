"""Search for unfinished recordings by name, and exclusive access to a file for its recovery."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from armrig_core.errors import ArmrigError
from armrig_core.recording_file.opening import lock, no_link
from armrig_core.recording_file.part_names import ACTIVE, COPY


class RecoveryError(ArmrigError):
    """A file cannot be recovered and stays as it is; the message gives file, reason and advice."""


class NotOursError(RecoveryError):
    """A file is in use by its daemon, or belongs to another rig."""


def unfinished_files(folder: Path, rig: str = "") -> list[Path]:
    """Return the files of a folder that have the name of an unfinished recording, sorted.

    `rig` is the id of the rig; "" for any rig. For rig 1, the result also contains the files of rig
    1-b.
    """
    try:
        return sorted(folder.glob(f"{rig}-*.mcap{ACTIVE}" if rig else f"*.mcap{ACTIVE}"))
    except OSError:  # nothing can be read, so nothing is found
        return []


def remove_copies(folder: Path, rig: str, owner: int) -> list[Path]:
    """Remove the incomplete copies that dead processes have left; return the paths of the copies.

    The originals, which contain all data of the copies, stay.
    """
    removed = []
    for path in sorted(folder.glob(f"{rig}-*.mcap{COPY}")):
        with suppress(OSError, RecoveryError), open_locked(path, owner):
            path.unlink()
            removed.append(path)
    return removed


@contextmanager
def open_locked(path: Path, owner: int | None) -> Iterator[IO[bytes]]:
    """Lock a file and yield it open for reading; refuse a file that another process writes."""
    try:
        # Checked before the file is opened: opening a device may have an effect, and a link may
        # lead to another file.
        before = path.lstat()
        _check_regular(path, before, owner)
        with open(path, "rb", opener=no_link) as stream:
            inode = os.fstat(stream.fileno())
            _check_regular(path, inode, owner)
            try:
                lock(stream)
            except BlockingIOError as err:
                raise NotOursError(f"{path}: the file is being written; wait for its end") from err
            # The daemon may have renamed the file just before this process got the lock.
            if not os.path.samestat(path.lstat(), inode):
                raise NotOursError(f"{path}: the name now belongs to another file; try again")
            yield stream
    except FileNotFoundError as err:
        raise NotOursError(f"{path}: there is no such file") from err


def _check_regular(path: Path, inode: os.stat_result, owner: int | None) -> None:
    if not stat.S_ISREG(inode.st_mode):
        raise RecoveryError(f"{path}: not a regular file; it is skipped")
    if owner is not None and inode.st_uid != owner:
        raise RecoveryError(f"{path}: another user's file; it is skipped")
