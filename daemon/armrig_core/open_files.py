"""Number of files that this process has open, and the limit of this number."""

from __future__ import annotations

import os
import resource
from contextlib import suppress

MOST_FILES = 16_384
"""Limit on open files, as LimitNOFILE= in the unit; 1024 are too few for 1000 connections."""


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
