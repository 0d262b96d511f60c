"""Files of others: regular ones only, and never more of them than they may have."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path


def read_bounded(path: Path, most: int) -> bytes:
    """Return the bytes of a regular file.

    Raises
    ------
    OSError
        It cannot be read, is none (a pipe would keep us waiting, a device never ends), or has
        more than `most` bytes.
    """
    # Without waiting for somebody to write to a pipe; Windows has neither of the two.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
    with os.fdopen(os.open(path, flags), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"more than the {most} B allowed", str(path))
    return data
