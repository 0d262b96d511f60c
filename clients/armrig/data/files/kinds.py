"""Which kind of file it is, told by how its bytes begin."""

from __future__ import annotations

import codecs

from armrig_core.bounded import decoded
from armrig_core.errors import FileError

from armrig.data.files import matlab, npz, text
from armrig.data.files.table import Table

_READ = "armrig reads CSV and other tables of text, .mat (to -v7) and .npz"
_AGAIN = "save it there with save('data.mat', 'u', 'y', '-v7')"
_UTF_16 = 'is saved as UTF-16, as Excel\'s "Unicode text" is; save it as "CSV UTF-8"'
_OTHERS = (
    (b"\x89MCAP0\r\n", "is a recording and no table; armrig.load(path).dataset() reads it"),
    (b"MATLAB 7.3", f"is a MAT-file of version 7.3, which only MATLAB reads; {_AGAIN}"),
    (b"\x89HDF\r\n", f"is HDF5, which armrig does not read; if MATLAB wrote it, {_AGAIN}"),
    (b"# Created by Octave", "is Octave's own text; save it there with save -v7 data.mat u y"),
    (b"\xd0\xcf\x11\xe0", "is an old Excel workbook; save its sheet as CSV"),
    (b"\x93NUMPY", "is an .npy, an array without a name; save it with numpy.savez(…, u=u, y=y)"),
    (b"PAR1", "is Parquet, which armrig does not read; save it as CSV"),
    (b"\x1f\x8b", "is packed with gzip; unpack it first (gunzip)"),
    (codecs.BOM_UTF16_LE, _UTF_16),
    (codecs.BOM_UTF16_BE, _UTF_16),
)


def table_of(data: bytes, suffix: str) -> Table:
    """Return the table in a file; its suffix, such as .mat, decides where its beginning does not.

    Raises
    ------
    FileError
        It is of another kind, or damaged.
    """
    for beginning, what in _OTHERS:
        if data.startswith(beginning):
            raise FileError(what)
    if data.startswith(b"PK\x03\x04"):
        return npz.read(data)
    if data.startswith(b"MATLAB 5.0") or (suffix == ".mat" and b"\0" in data[:128]):
        return matlab.read(data)
    if b"\0" in data:
        raise FileError(f"is no text, and no other kind of file that is known; {_READ}")
    try:
        content = decoded(data)
    except FileError as err:
        raise FileError(f'{err} (in Excel: "CSV UTF-8")') from err
    return text.table_of(content)
