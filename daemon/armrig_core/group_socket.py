"""The mode of a Unix socket that its owner's group may open."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Final

_MASK: Final = 0o007  # a client connects by writing
_LOCK: Final = Lock()


@contextmanager
def group_may_open() -> Iterator[None]:
    """Let the owner's group open the sockets that the block makes.

    The mask of a process belongs to all its threads. One thread at a time changes it, so that the
    mask before the first block is the mask after the last one.

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
