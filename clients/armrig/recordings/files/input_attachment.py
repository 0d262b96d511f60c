"""Attached input of a run, or reference of a law: a number per line, under a heading."""

from __future__ import annotations

import zlib
from io import BytesIO
from itertools import islice
from pathlib import Path

import numpy as np
from armrig_core.recording_file.budget import DamageError
from armrig_core.recording_file.file_records import Place
from armrig_core.recording_file.opening import regular_file
from numpy.typing import NDArray

from armrig.numerics.quantities import plural

_TIMES_BYTES = 8 + 8  # B; two times precede the name in an attachment
_MAX_HEAD_BYTES = 1 << 10  # B; times, name, media type, and the heading of the voltages
_MAX_LINE_BYTES = 64  # B; the text of a voltage has at most 24 B


def read_input(path: Path, place: Place, most: int) -> NDArray[np.float64]:
    """Read the attachment at `place`, and return its voltages, (n,) in V.

    Raises DamageError if the attachment is not a list of voltages, its checksum is wrong, or it
    contains more than `most` voltages.
    """
    with regular_file(path) as file:
        file.seek(place.at)
        content = file.read(min(place.length, _MAX_HEAD_BYTES + most * _MAX_LINE_BYTES))
    at = _TIMES_BYTES
    for _ in range(2):  # name and media type
        at += 4 + int.from_bytes(content[at : at + 4], "little")
    if at + 8 + int.from_bytes(content[at : at + 8], "little") + 4 != place.length:
        raise DamageError("the attached input does not have the form of an input")
    too_long = DamageError(
        f"the attached input is longer than the {plural(most, 'sample')} of the run"
    )
    if len(content) < place.length:
        raise too_long
    expected = int.from_bytes(content[-4:], "little")
    if expected and expected != zlib.crc32(content[:-4]):
        raise DamageError("the checksum of the attached input is wrong")
    lines = islice(BytesIO(content[at + 8 : -4]), 1, None)  # without the heading
    try:
        u = np.fromiter((float(line) for line in lines if line.strip()), np.float64)
    except ValueError as err:
        raise DamageError(f"the attached input is not a list of voltages ({err})") from err
    if u.size > most:
        raise too_long
    return u
