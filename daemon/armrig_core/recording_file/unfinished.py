"""Files with the name of an unfinished recording: found, and held while they are recovered."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from armrig_core.errors import ArmrigError
from armrig_core.recording_file.file_lock import lock
from armrig_core.recording_file.opening import no_link
from armrig_core.recording_file.part_names import ACTIVE, COPY


class RecoveryError(ArmrigError):
    """A file cannot be recovered and stays as it is; says which, why, and what to do."""


class NotOursError(RecoveryError):
    """A file is somebody else's concern: its daemon writes it, or it is another rig's."""


def unfinished(folder: Path, rig: str = "") -> list[Path]:
    """Return what has the name of an unfinished recording in a folder, in its order.

    Parameters
    ----------
    rig : str
        Whose; "" for any. The files of rig 1-b look like those of rig 1.
    """
    try:
        return sorted(folder.glob(f"{rig}-*.mcap{ACTIVE}" if rig else f"*.mcap{ACTIVE}"))
    except OSError:  # where nothing can be read nothing is found
        return []


def remove_copies(folder: Path, rig: str, owner: int) -> list[Path]:
    """Remove copies that somebody died over, and return them: what they are of is there, whole."""
    removed = []
    for path in sorted(folder.glob(f"{rig}-*.mcap{COPY}")):
        with suppress(OSError, RecoveryError), held(path, owner):
            path.unlink()
            removed.append(path)
    return removed


@contextmanager
def held(path: Path, owner: int | None) -> Iterator[IO[bytes]]:
    """Give a file that nobody writes, locked while we have it."""
    try:
        # Seen before it is opened: opening a device may do something, and a link leads elsewhere.
        before = path.lstat()
        _check_regular(path, before, owner)
        with open(path, "rb", opener=no_link) as stream:
            found = os.fstat(stream.fileno())
            _check_regular(path, found, owner)
            try:
                lock(stream)
            except BlockingIOError as err:
                raise NotOursError(f"{path}: is being written; wait for its end") from err
            # Its daemon may have given it its name just before we had the lock.
            if not os.path.samestat(path.lstat(), found):
                raise NotOursError(f"{path}: another file has that name by now; try again")
            yield stream
    except FileNotFoundError as err:
        raise NotOursError(f"{path}: there is no such file") from err


def _check_regular(path: Path, found: os.stat_result, owner: int | None) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise RecoveryError(f"{path}: not a regular file; passed over")
    if owner is not None and found.st_uid != owner:
        raise RecoveryError(f"{path}: another user's file; passed over")
