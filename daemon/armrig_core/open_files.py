"""Number of files that this process has open, and the limit of this number."""

from __future__ import annotations

import os
import resource
from contextlib import suppress

MOST_FILES = 16_384
"""Limit on open files, as LimitNOFILE= in the unit; 1024 are too few for 1000 connections."""
_SPARE = 8
"""Free entries of the table that a new connection, or a recording with its checks, needs."""


def raise_limit() -> None:
    """Raise the limit to `MOST_FILES`, or as far as the system permits."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_FILES if hard == resource.RLIM_INFINITY else min(MOST_FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        with suppress(OSError, ValueError):  # forbidden in a sandbox, whose unit sets the limit
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def count() -> int:
    """Return the number of open files; the limit if the process cannot open another file."""
    try:
        with os.scandir("/proc/self/fd") as entries:
            return sum(1 for _ in entries)
    except OSError:
        return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


class FullTable:
    """Watch over the table of open files; call `look` once a second."""

    _is_full = False

    def look(self) -> tuple[str, str] | None:
        """Return a log line and its level when the table becomes full, and when it has room again.

        A process with a full table accepts no client and begins no recording; the clients that are
        connected, and a recording that has begun, continue.
        """
        found, (most, _) = count(), resource.getrlimit(resource.RLIMIT_NOFILE)
        is_full = most != resource.RLIM_INFINITY and found > most - _SPARE
        if is_full == self._is_full:
            return None
        self._is_full = is_full
        if not is_full:
            return "info", f"{found} of {most} files are open: new clients can connect again"
        return "error", (
            f"{found} of {most} files are open: new clients cannot connect, and no recording can "
            "begin; close clients (`ss -xp` shows them), or raise LimitNOFILE= or `ulimit -n`"
        )
