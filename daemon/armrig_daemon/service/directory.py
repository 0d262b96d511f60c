"""Whether the directory of the recordings can take one."""

from __future__ import annotations

import os
import pwd
import shutil
from pathlib import Path


def check_directory(directory: Path, needed: int) -> str:
    """Return why nothing can be recorded in `directory`, or nothing."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        room = shutil.disk_usage(directory).free
    except OSError as err:
        return f"{directory}: {err.strerror}; {_way_out(directory)}"
    if not os.access(directory, os.W_OK | os.X_OK):
        return f"{directory}: not writable; {_way_out(directory)}"
    if room < needed:
        return f"{directory}: {room / 1e6:.0f} MB free, {needed / 1e6:.0f} MB needed; free the disk"
    return ""


def _way_out(directory: Path) -> str:
    try:
        user = pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # it has no name
        user = str(os.getuid())
    made = f"`install -d -o {user} {directory}`"
    return f"{made} and start the daemon anew, or set [recording] directory"
