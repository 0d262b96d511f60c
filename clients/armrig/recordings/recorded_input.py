"""The input of a run as it is attached to its recording: one voltage a line, under a heading."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.file_records import Place
from armrig_core.recording_file.opening import regular_file
from numpy.typing import NDArray

_BLOCK = 1 << 20  # B
_TIMES = 8 + 8  # B, before the name in an attachment
_LINE_LIMIT = 64  # B; a voltage takes 24 at most


def recorded_input(path: Path, place: Place, most: int) -> NDArray[np.float64]:
    """Return the voltages, (n,) in V, of the attachment at `place`; an hour at 1 kHz has 20 MB.

    Parameters
    ----------
    most : int
        How many there may be.

    Raises
    ------
    DamageError
        It is no list of voltages, its checksum is wrong, or there are more than `most`.
    """
    parts: list[NDArray[np.float64]] = []
    found = 0
    with regular_file(path) as file:
        file.seek(place.at)
        head, size = _head(file.read(min(place.length, _TIMES + 2 * 128)))
        if head + size + 4 != place.length:
            raise DamageError("the attached input has not the form of one")
        file.seek(place.at)
        crc, rest = zlib.crc32(file.read(head)), b""
        while size > 0:
            block = file.read(min(size, _BLOCK))
            size = size - len(block) if block else 0
            crc = zlib.crc32(block, crc)
            lines = (rest + block).split(b"\n")
            rest = lines.pop() if size else b""
            parts.append(_voltages(lines, first=not parts))
            found += parts[-1].size
            if found > most or len(rest) > _LINE_LIMIT:
                raise DamageError(
                    f"the attached input is longer than the {most} samples of the run"
                )
        expected = int.from_bytes(file.read(4), "little")
    if expected and expected != crc:
        raise DamageError("the checksum of the attached input is wrong")
    return np.concatenate(parts) if parts else np.zeros(0)


def _head(begin: bytes) -> tuple[int, int]:
    """Return where the data of an attachment begin, and their length, in B."""
    at = _TIMES
    for _ in range(2):  # name and media type
        at += 4 + int.from_bytes(begin[at : at + 4], "little")
    return at + 8, int.from_bytes(begin[at : at + 8], "little")


def _voltages(lines: list[bytes], *, first: bool) -> NDArray[np.float64]:
    if first:
        del lines[:1]
    try:
        return np.array([float(line) for line in lines if line], np.float64)
    except ValueError as err:
        raise DamageError(f"the attached input is no list of voltages ({err})") from err
