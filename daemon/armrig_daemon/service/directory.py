"""Check that a recording can be stored in the directory of the recordings."""

from __future__ import annotations

import os
import pwd
import shutil
from pathlib import Path

from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import Refused, refused


def check_directory(directory: Path, needed: int) -> Refused | None:
    """Return the refusal if `directory` cannot store a recording of `needed` B, or None."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        room = shutil.disk_usage(directory).free
    except OSError as err:
        return _no_room(f"{directory}: {err.strerror}; {_way_out(directory)}")
    if not os.access(directory, os.W_OK | os.X_OK):
        return _no_room(f"{directory}: not writable; {_way_out(directory)}")
    if room < needed:
        free_mb, needed_mb = room / 1e6, needed / 1e6
        text = f"{directory}: {free_mb:.0f} MB free, {needed_mb:.0f} MB needed; free disk space"
        return _no_room(text)
    return None


def _no_room(text: str) -> Refused:
    return refused(RefusalCode.NO_ROOM, text)


def _way_out(directory: Path) -> str:
    try:
        user = pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # the user's id has no name
        user = str(os.getuid())
    made = f"`install -d -o {user} {directory}`"
    return f"{made} and restart the daemon, or set [recording] directory"
