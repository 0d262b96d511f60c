"""The lock on a recording that is being written: it shows that the file's daemon is running.

On a system without such locks (Windows), no file appears locked, and no process is excluded.
"""

from __future__ import annotations

from typing import IO

try:
    import fcntl
except ImportError:  # Windows also recovers recordings, and records virtual rigs
    _HAS_LOCKS = False
else:
    _HAS_LOCKS = True


def lock(file: IO[bytes]) -> None:
    """Lock a file; raise BlockingIOError if another process holds the lock."""
    if _HAS_LOCKS:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
