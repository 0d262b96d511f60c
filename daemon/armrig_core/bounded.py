"""Files of others: regular ones only, and never more of them than they may have."""

from __future__ import annotations

import codecs
import errno
import os
import stat
from collections.abc import Callable
from pathlib import Path

from armrig_core.errors import FileError

CONFIGURATION_LIMIT = 1 << 16
"""Longest configuration file, in B; the time of its reader grows with the square."""


def read_bounded(
    path: Path, most: int, check: Callable[[os.stat_result], None] = lambda found: None
) -> bytes:
    """Return the bytes of a regular file.

    Parameters
    ----------
    check : callable
        Takes the state of the file that is read, and raises where it may not be.

    Raises
    ------
    OSError
        It cannot be read, is none (a pipe would keep us waiting, a device never ends), or has
        more than `most` bytes.
    """
    # Without waiting for somebody to write to a pipe; Windows has neither of the two.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
    # Not os.fdopen, which calls a directory by the number of its descriptor.
    with open(path, "rb", opener=lambda name, _: os.open(name, flags)) as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        check(found)
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"more than the {most} B allowed", str(path))
    return data


def read_text(path: Path, most: int) -> str:
    """Return the text of a regular file, without the byte order mark of some editors.

    Raises
    ------
    FileError
        It is saved in another encoding than UTF-8.
    OSError
        As of `read_bounded`.
    """
    return decoded(read_bounded(path, most))


def decoded(data: bytes) -> str:
    """Return the text of bytes, without the byte order mark of some editors.

    Raises
    ------
    FileError
        They are in another encoding than UTF-8.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise FileError("it is saved as UTF-16: save it as UTF-8")
    try:
        return data.removeprefix(codecs.BOM_UTF8).decode("utf-8")
    except UnicodeDecodeError as err:
        line = err.object.count(b"\n", 0, err.start) + 1
        raise FileError(f"line {line} is not UTF-8: save it as UTF-8") from err
