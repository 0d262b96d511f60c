"""Priority of a line on standard error, for systemd's journal.

References
----------
.. [1] Linux man-pages of systemd, systemd.exec(5), under "$JOURNAL_STREAM"; sd-daemon(3), the
   prefixes of priorities.
"""

from __future__ import annotations

import os

_PRIORITIES = {"error": 3, "warning": 4, "info": 6, "debug": 7}
_NOTICE = 5


def priority(level: str) -> int:
    """Return the priority of a log line of this level."""
    return _PRIORITIES.get(level, _NOTICE)


def log_prefix(level: str, fd: int = 2) -> str | None:
    """Return the prefix of a line of this level; None if the journal does not read `fd`."""
    stream = os.environ.get("JOURNAL_STREAM", "")
    return journal_prefix(level, os.fstat(fd), stream) if stream else None


def journal_prefix(level: str, stderr: os.stat_result, stream: str) -> str | None:
    """Return the prefix with the priority of a line; None if the journal does not read `stderr`.

    `level` is the level of the log line, and `stderr` the state of standard error, from fstat.
    `stream` is $JOURNAL_STREAM: device and inode of the stream that the journal reads.
    """
    if stream != f"{stderr.st_dev}:{stderr.st_ino}":
        return None
    return f"<{priority(level)}>"
