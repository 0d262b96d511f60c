"""Creation of Unix sockets that the group of their owner may open."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Final

_MASK: Final = 0o007  # to connect, a client needs permission to write
_LOCK: Final = Lock()


@contextmanager
def group_may_open() -> Iterator[None]:
    """Permit the owner's group to open the sockets that the block creates.

    All threads of a process share the mask of file modes. Only one thread at a time changes the
    mask, so that each block restores the original mask.

    Examples
    --------
    >>> with group_may_open():
    ...     pass
    """
    with _LOCK:
        before = os.umask(_MASK)
        try:
            yield
        finally:
            os.umask(before)
