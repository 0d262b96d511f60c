"""The priority of a line on standard error that the journal of systemd reads.

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
    """Return the priority of a line of the log."""
    return _PRIORITIES.get(level, _NOTICE)


def log_prefix(level: str, fd: int = 2) -> str | None:
    """Return what stands before a line where the journal reads `fd`; None where it does not."""
    stream = os.environ.get("JOURNAL_STREAM", "")
    return journal_prefix(level, os.fstat(fd), stream) if stream else None


def journal_prefix(level: str, stderr: os.stat_result, stream: str) -> str | None:
    """Return the priority of a line as the journal reads it; None where it does not read us.

    Parameters
    ----------
    level : str
        Of a line of the log.
    stderr : os.stat_result
        Of standard error, as by fstat.
    stream : str
        $JOURNAL_STREAM: device and inode of what the journal reads.
    """
    if stream != f"{stderr.st_dev}:{stderr.st_ino}":
        return None
    return f"<{priority(level)}>"
