"""Whether the directory of the recordings can take one."""

from __future__ import annotations

import os
import shutil
from pathlib import Path


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
