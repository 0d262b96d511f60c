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
    """Return the prefix of a line of this level; None if the journal does not read `fd`.

    $JOURNAL_STREAM contains device and inode of the stream that the journal reads.
    """
    if not (stream := os.environ.get("JOURNAL_STREAM", "")):
        return None
    inode = os.fstat(fd)
    return f"<{priority(level)}>" if stream == f"{inode.st_dev}:{inode.st_ino}" else None
