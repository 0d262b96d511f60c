"""The lock on a recording that is being written: who finds it knows that its daemon lives.

Where the system has no such locks (Windows), no file is seen as locked, and nobody is kept out.
"""

from __future__ import annotations

from typing import IO

try:
    import fcntl
except ImportError:  # a recording is recovered, and made in virtual time, also on other systems
    _HAS_LOCKS = False
else:
    _HAS_LOCKS = True


def lock(file: IO[bytes]) -> None:
    """Lock a file; raises BlockingIOError where another process has it."""
    if _HAS_LOCKS:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
