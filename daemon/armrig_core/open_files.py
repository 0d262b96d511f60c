"""How many files this process has open, and how many it may."""

from __future__ import annotations

import os
import resource
from contextlib import suppress

MOST = 16_384
"""As LimitNOFILE= of the unit; the usual 1024 are taken by a thousand connections."""


def raise_limit() -> None:
    """Have `MOST` files allowed, or as many as this system lets us have."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST if hard == resource.RLIM_INFINITY else min(MOST, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        with suppress(OSError, ValueError):  # a sandbox does not let us: its unit has set it
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def count() -> int:
    """Return how many files this process has open; all that it may where it can open no more."""
    try:
        with os.scandir("/proc/self/fd") as entries:
            return sum(1 for _ in entries)
    except OSError:
        return resource.getrlimit(resource.RLIMIT_NOFILE)[0]
