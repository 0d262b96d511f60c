"""Reading of untrusted files: only regular files, and at most a given number of bytes."""

from __future__ import annotations

import codecs
import errno
import os
import stat
from collections.abc import Callable
from pathlib import Path

from armrig_core.errors import FileError

CONFIGURATION_LIMIT = 1 << 16
"""Longest configuration file, in B; the time for reading grows with the square of the length."""


def read_bounded(
    path: Path, most: int, check: Callable[[os.stat_result], None] = lambda found: None
) -> bytes:
    """Return the bytes of a regular file.

    `check` is called with the stat result of the open file, and raises an exception if the file may
    not be read.

    Raises OSError if the file cannot be read, is not regular (a pipe may block, a device may never
    end), or has more than `most` bytes.
    """
    # Not os.fdopen: for a directory, its error contains a descriptor's number instead of the path.
    with open(path, "rb", opener=open_untrusted) as file:
        inode = os.fstat(file.fileno())
        if not stat.S_ISREG(inode.st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        check(inode)
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"more than the {most} B allowed", str(path))
    return data


def open_untrusted(path: str, flags: int) -> int:
    """Open an untrusted file; use this function as the `opener` of `open`."""
    # O_NONBLOCK: do not wait until somebody writes to a pipe. Of these flags Windows has only
    # O_BINARY; without this flag, Windows changes line ends.
    more = ("O_NONBLOCK", "O_NOCTTY", "O_BINARY")
    return os.open(path, flags | sum(getattr(os, name, 0) for name in more))


def read_text(path: Path, most: int) -> str:
    """Return the text of a regular file, without the byte order mark that some editors write.

    Raises FileError if the file is not encoded as UTF-8. Raises OSError if the file cannot be read,
    as in `read_bounded`.
    """
    return decode_text(read_bounded(path, most))


def decode_text(data: bytes) -> str:
    """Return the text that `data` encodes, without the byte order mark that some editors write.

    Raises FileError if `data` is not UTF-8.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise FileError("it is saved as UTF-16: save it as UTF-8")
    try:
        return data.removeprefix(codecs.BOM_UTF8).decode("utf-8")
    except UnicodeDecodeError as err:
        line = err.object.count(b"\n", 0, err.start) + 1
        raise FileError(f"line {line} is not UTF-8: save it as UTF-8") from err
