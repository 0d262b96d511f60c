"""Facts of the recording machine for a run: name, time, host, and space on the disk."""

from __future__ import annotations

import os
import platform
import pwd
import secrets
import shutil
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

from armrig_core.commands.codes import RefusalCode
from armrig_core.commands.commands import Refused, build_refusal


class HostFacts(NamedTuple):
    """Facts about the machine and the time of a run."""

    run_id: Callable[[bytes], str]
    """Returns the name of a run, 8 hexadecimal digits; it may depend on the run's codes."""
    now: Callable[[timezone], datetime]
    """Returns the time of day in a time zone, which may be ignored."""
    host: dict[str, Any]
    """Description of the host in a recording, in addition to the loop's description."""


def of_this_host() -> HostFacts:
    """Return the facts of this machine."""
    uname = platform.uname()
    return HostFacts(
        run_id=lambda _: secrets.token_hex(4),
        now=datetime.now,
        host={
            "kernel": f"{uname.system} {uname.release} {uname.version}",
            "python": platform.python_version(),
        },
    )


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
    return build_refusal(RefusalCode.NO_ROOM, text)


def _way_out(directory: Path) -> str:
    try:
        user = pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # the user's id has no name
        user = str(os.getuid())
    made = f"`install -d -o {user} {directory}`"
    return f"{made} and restart the daemon, or set [recording] directory"
