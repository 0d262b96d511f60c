"""The lock on a recording that is being written: who finds it knows that its daemon lives.

Where the system has no such locks (Windows), no file is seen as locked, and nobody is kept out.
"""

from __future__ import annotations

from typing import IO

try:
    import fcntl
except ImportError:  # virtual time runs where the rest of the daemon does not
    _HAS_LOCKS = False
else:
    _HAS_LOCKS = True


def lock(file: IO[bytes]) -> None:
    """Lock a file that we write; raises OSError where another process has it."""
    if _HAS_LOCKS:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_locked(fd: int) -> bool:
    """Return whether another process has locked the file."""
    if _HAS_LOCKS:
        try:
            fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
