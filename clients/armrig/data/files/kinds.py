"""Recognition of a file's kind by its first bytes, and its table."""

from __future__ import annotations

import codecs
from dataclasses import replace

from armrig_core.errors import FileError, InputError
from armrig_core.process.bounded import decode_text
from armrig_core.recording_file.file_records import MAGIC

from armrig.data.files.arrays import read_mat, read_npz, read_parquet
from armrig.data.files.imported_file import read_imported
from armrig.data.files.mat_variables import MatDamageError
from armrig.data.files.messages import read_mcap
from armrig.data.files.table import Table
from armrig.data.files.text import read_text
from armrig.data.step import DOUBT, Step
from armrig.numerics.quantities import plural

_SAVE_IN_MATLAB = "save it in MATLAB with save('data.mat', 'u', 'y', 'Ts', '-v7')"
_UTF_16 = 'is saved as UTF-16, like Excel\'s "Unicode text"; save it as "CSV UTF-8"'
_FEATHER = (
    "is Arrow or Feather, which armrig does not read; pandas writes Parquet: python -c "
    "\"import pandas; pandas.read_feather('FILE').to_parquet('FILE.parquet')\""
)
_MDF_TO_CSV = (
    'asammdf writes a CSV for each clock: python -c "from asammdf import MDF; '
    "MDF('FILE').export('csv', 'FILE', time_from_zero=False, add_units=True)\""
)
_TDMS_TO_CSV = (
    "nptdms writes CSV (without time_index=True if the file contains no times): python -c "
    "\"from nptdms import TdmsFile; TdmsFile.read('FILE').as_dataframe(time_index=True)"
    ".to_csv('FILE.csv', index_label='time')\""
)
_DATAFLASH_TO_CSV = (
    "pymavlink writes a message type such as RATE as CSV: mavlogdump.py --format csv "
    "--types RATE FILE > RATE.csv"
)
_REFUSED_KINDS = (
    (b"MATLAB 7.3", f"is a MAT-file of version 7.3, which only MATLAB reads; {_SAVE_IN_MATLAB}"),
    (b"\x89HDF\r\n", f"is HDF5, which armrig does not read; if MATLAB wrote it, {_SAVE_IN_MATLAB}"),
    (b"# Created by Octave", "is Octave's text format; in Octave: save -v7 data.mat u y"),
    (b"\xd0\xcf\x11\xe0", "is an old Excel workbook; save its sheet as CSV"),
    (b"\x93NUMPY", "is an .npy, an array without a name; save it with numpy.savez(…, u=u, y=y)"),
    (b"\x1f\x8b", "is packed with gzip; unpack it first (gunzip)"),
    (b"ARROW1", _FEATHER),
    (b"FEA1", _FEATHER),
    (b"MDF     ", f"is MDF, which armrig does not read; {_MDF_TO_CSV}"),
    (b"TDSm", f"is TDMS, which armrig does not read; {_TDMS_TO_CSV}"),
    (b"ULog\x01\x12\x35", "is ULog, which armrig does not read; pyulog writes CSV: ulog2csv FILE"),
    (b"\xa3\x95\x80", f"is a DataFlash log, which armrig does not read; {_DATAFLASH_TO_CSV}"),
    (codecs.BOM_UTF16_LE, _UTF_16),
    (codecs.BOM_UTF16_BE, _UTF_16),
)
_KINDS = (
    (b"PAR1", read_parquet, "a damaged Parquet file", "write it again"),
    (b"PK\x03\x04", read_npz, "a damaged .npz", "save it again with numpy.savez"),
    (b"MATLAB 5.0", read_mat, "a damaged MAT-file", _SAVE_IN_MATLAB),
)
"""First bytes, reader, name and remedy of a kind."""


def table_of(
    data: bytes, suffix: str, decimal: str | None = None, topic: str | None = None
) -> Table:
    """Return the table in a file, whose kind is recognised by its first bytes.

    Only a MAT-file of version 4 is recognised by its suffix, because it begins with numbers.
    """
    for beginning, refusal in _REFUSED_KINDS:
        if data.startswith(beginning):
            raise FileError(refusal)
    if data.startswith(MAGIC):
        imported = read_imported(data)
        return imported.table() if imported else read_mcap(data, topic)
    if topic is not None:
        raise FileError(f"topic {topic}: only MCAP files have topics; leave out --topic")
    is_old = suffix == ".mat" and b"\0" in data[:128]
    for beginning, read, kind, remedy in _KINDS:
        if data.startswith(beginning) or (is_old and read is read_mat):
            try:
                return read(data)
            except InputError:
                raise
            except Exception as err:  # a damaged file can raise any exception in its reader
                why = err if isinstance(err, MatDamageError) else type(err).__name__
                raise FileError(f"is {kind} ({why}); {remedy}") from err
    text = data.rstrip(b"\0")  # of a file that its logger allocated in advance
    if b"\0" in text:
        raise FileError(
            "is not text, and not of another known kind; armrig reads tables of text, .mat (to "
            "-v7), .npz, Parquet and MCAP"
        )
    try:
        content = decode_text(text)
    except FileError as err:
        raise FileError(f'{err} (in Excel: "CSV UTF-8")') from err
    table = read_text(content, decimal)
    if not (count := len(data) - len(text)):
        return table
    note = Step(f"left out {plural(count, 'zero byte')} at the end")
    if not text.endswith((b"\n", b"\r")):
        note = Step(f"{note}, not after a line end: the last line may be cut short", DOUBT)
    return replace(table, notes=[*table.notes, note])
