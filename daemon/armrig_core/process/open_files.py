"""Limits of this process on open files and on its address space."""

from __future__ import annotations

import os
import resource
from collections.abc import Callable
from contextlib import suppress

from armrig_core.errors import OperationError
from armrig_core.process.printable import plural

MOST_FILES = 16_384
"""Limit on open files, as LimitNOFILE= in the unit; 1024 are too few for 1000 connections."""
_SPARE = 8  # free entries that a recording and its checks need
MAX_IDLE_FILES = 512
"""Number of open files above which the network is shut while no client holds the rig."""
MAX_FILES = 12_288
"""Number of open files above which the network is always shut; a process may have 16384."""
SHUT_S = 10.0


def raise_limit(most: int = MOST_FILES) -> None:
    """Raise the limit on open files to `most`, or as far as the system permits."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = most if hard == resource.RLIM_INFINITY else min(most, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        with suppress(OSError, ValueError):  # forbidden in a sandbox, whose unit sets the limit
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def require(program: str, *, memory_mib: int, files: int) -> None:
    """Raise OperationError if this process may have too little address space or too few files.

    Must be called before the import of zenoh and numpy, which abort or block with too little
    memory. The soft limit on open files is raised to `files`.

    `memory_mib` is the necessary address space, in MiB; each thread reserves 64 MiB.
    """
    space = resource.getrlimit(resource.RLIMIT_AS)[0]
    if space != resource.RLIM_INFINITY and space < memory_mib << 20:
        raise OperationError(
            f"the address space is limited to {space >> 20} MiB, {program} needs {memory_mib} MiB: "
            "begin in a shell without `ulimit -v`, or remove LimitAS= from the unit"
        )
    raise_limit(files)
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if limit != resource.RLIM_INFINITY and limit < files:
        raise OperationError(
            f"open files are limited to {limit}, {program} needs {files}: begin in a shell with "
            f"`ulimit -n {files}` or more, or set LimitNOFILE= in the unit"
        )


def count() -> int:
    """Return the number of open files; the limit if the process cannot open another file."""
    try:
        with os.scandir("/proc/self/fd") as entries:
            return sum(1 for _ in entries)
    except OSError:
        return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


class FullTable:
    """Watch over the table of open files; a full table admits no client and no recording."""

    _is_full = False

    def look(self) -> tuple[str, str] | None:
        """Return a log line and its level if the table became full or has room again."""
        open_count, most = count(), resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        is_full = most != resource.RLIM_INFINITY and open_count > most - _SPARE
        if is_full == self._is_full:
            return None
        self._is_full = is_full
        files = f"{open_count} of {most} files are open: new clients"
        if not is_full:
            return "info", f"{files} can connect again"
        return "error", (
            f"{files} cannot connect, and no recording can begin; close clients (`ss -xp` shows "
            "them), or raise LimitNOFILE= or `ulimit -n`"
        )


class NetworkGuard:
    """Guard that shuts the network while too many files are open; call `look` once a second.

    Each connection is an open file from its beginning, long before its client shows a certificate.
    A process at its limit of open files accepts no client on its Unix socket and begins no
    recording.
    """

    def __init__(
        self, count: Callable[[], int], shut: Callable[[], None], open_again: Callable[[], str]
    ) -> None:
        """Start with an open network.

        `count` returns the number of open files. `shut` ends all links of the network, and stops
        listening. `open_again` listens again, and returns the reason of a failure, or an empty
        text.
        """
        self._count, self._shut, self._open_again = count, shut, open_again
        self._again_s = 0.0
        self._is_shut = False

    def look(self, now_s: float, *, is_busy: bool) -> tuple[str, str] | None:
        """Shut or open the network if necessary; after a change, return a log line and its level.

        `now_s` is the monotonic time, in s. `is_busy` is True if a client holds the rig.
        """
        if self._is_shut:
            return self._open(now_s) if now_s >= self._again_s else None
        open_count = self._count()
        if open_count <= (MAX_FILES if is_busy else MAX_IDLE_FILES):
            return None
        self._shut()
        self._is_shut, self._again_s = True, now_s + SHUT_S
        return "error", (
            f"[access] {plural(open_count, 'file is', 'files are')} open: a client holds unused "
            "connections; the network is "
            f"shut for {SHUT_S:g} s, the Unix socket stays open; `ss -tn` shows the client"
        )

    def _open(self, now_s: float) -> tuple[str, str]:
        why = self._open_again()
        if why:
            self._again_s = now_s + SHUT_S
            return "error", why
        self._is_shut = False
        return "info", "[access] the network is open again"
