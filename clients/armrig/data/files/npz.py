"""The arrays of a file that numpy.savez has written."""

from __future__ import annotations

from io import BytesIO
from math import prod
from typing import IO, Any
from zipfile import ZipFile

import numpy as np
from armrig_core.errors import FileError

from armrig.data.files.arrays import ArrayTable, most_unpacked, table_of

_PICKLED = "holds Python objects, which are programs and never loaded; save numbers instead"


def read(data: bytes) -> ArrayTable:
    """Return the columns of an .npz; nothing that is pickled is loaded.

    Raises
    ------
    FileError
        It is a ZIP archive of other things, is damaged, or is too large once unpacked.
    """
    arrays: dict[str, Any] = {}
    refused: dict[str, str] = {}
    try:
        with ZipFile(BytesIO(data)) as archive:
            members = [m.filename for m in archive.infolist() if m.filename.endswith(".npy")]
            most = most_unpacked(len(data))
            if sum(_size(archive, member) for member in members) > most:
                msg = f"unpacked it has more than {most >> 20} MiB; save only input and "
                raise FileError(msg + "output")
            for member in members:
                with archive.open(member) as file:
                    array = _array(file)
                name = member.removesuffix(".npy")
                if array is None:
                    refused[name] = _PICKLED
                else:
                    arrays[name] = array
    except FileError:
        raise
    except Exception as err:  # whatever a damaged archive makes of its reader
        raise FileError(
            f"is a damaged .npz: {type(err).__name__}; save it again with numpy.savez"
        ) from err
    if not (arrays or refused):
        raise FileError(
            "is a ZIP archive without arrays, such as an Excel workbook; save its sheet as CSV"
        )
    return table_of(arrays, refused)


def _size(archive: ZipFile, member: str) -> int:
    """Return what an array takes once its numbers have 8 B each, by its head."""
    with archive.open(member) as file:
        is_first = np.lib.format.read_magic(file) == (1, 0)
        # The third version has the form of the second, and names in UTF-8.
        head = (
            np.lib.format.read_array_header_1_0 if is_first else np.lib.format.read_array_header_2_0
        )
        shape, _, kind = head(file)
    return prod(shape) * max(8, kind.itemsize)


def _array(file: IO[bytes]) -> Any:
    """Return the array of an .npy; None where it would have to be unpickled."""
    try:
        return np.lib.format.read_array(file, allow_pickle=False)
    except ValueError as err:
        if "allow_pickle" in str(err):
            return None
        raise
