"""Files of MATLAB, of numpy and of Parquet."""

from __future__ import annotations

import struct
import warnings
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from armrig import Dataset, FileError, load_data
from armrig.data.files import table
from scipy.io import savemat
from scipy.io.matlab import MatlabObject
from scipy.sparse import csc_array

U, Y = np.random.default_rng(1).standard_normal((2, 30))


def npz(folder: Path, **arrays: Any) -> Path:
    """Return a file that numpy has written, with pickles if it needs them."""
    path = folder / "data.npz"
    np.savez(path, **arrays)
    return path


def mat(folder: Path, values: dict[str, Any], **how: Any) -> Path:
    """Return a MAT-file, of version 5 by default."""
    path = folder / "data.mat"
    savemat(path, values, **how)
    return path


def iddata(**fields: Any) -> MatlabObject:
    """Return the object as MATLAB's older versions save it: cells of one experiment."""
    cells = {name: _cell(value) for name, value in fields.items()}
    array = np.empty((1, 1), dtype=[(name, object) for name in cells])
    for name, cell in cells.items():
        array[name][0, 0] = cell
    return MatlabObject(array, "iddata")


def _cell(value: Any) -> Any:
    cell = np.empty((1, 1), dtype=object)
    cell[0, 0] = value
    return cell


def assert_read(data: Dataset, Ts: float) -> None:
    """Check that the data are U and Y, to the last bit."""
    np.testing.assert_array_equal(data.u, U)
    np.testing.assert_array_equal(data.y, Y)
    assert data.Ts == Ts


COLUMN = {"u": U.reshape(-1, 1), "y": Y.reshape(-1, 1)}
NAMES = {"InputName": "heater", "OutputName": "temperature", "InterSample": "zoh"}
IDDATA = iddata(InputData=COLUMN["u"], OutputData=COLUMN["y"], Ts=np.array([[0.5]]), **NAMES)
MATRIX = np.column_stack([0.5 * np.arange(30), U, Y])
BY_NUMBER = {"input": "2", "signal": "X:3", "time": "1"}


def test_several_columns_are_refused_by_the_reader_of_one(tmp_path: Path) -> None:
    path = npz(tmp_path, t=0.5 * np.arange(30), u=np.column_stack([U, Y]), y=Y)

    with pytest.raises(FileError, match=r"2 inputs and 1 output are named.*load_signals"):
        load_data(path, input=["u:1", "u:2"])  # type: ignore[arg-type]


@pytest.mark.parametrize("how", [{}, {"do_compression": True}, {"format": "4"}], ids=str)
@pytest.mark.parametrize("shape", [(30, 1), (1, 30)], ids=str)
def test_vectors_of_matlab_are_columns_by_name(
    how: dict[str, Any], shape: tuple[int, int], tmp_path: Path
) -> None:
    values = {"volt": U.reshape(shape), "y": Y.reshape(shape), "Ts": 0.08}

    assert_read(load_data(mat(tmp_path, values, **how), input="volt"), 0.08)


@pytest.mark.parametrize(
    ("values", "columns"),
    [
        ({"X": MATRIX}, BY_NUMBER),
        ({"X": MATRIX.T}, BY_NUMBER),
        ({"z": {"u": U, "y": Y, "Ts": 0.5}, "note": "heater"}, {}),
        ({"z": {"u": U, "y": Y, "Ts": 0.5}}, {"input": "z.u"}),
        ({"dryer": IDDATA}, {}),
    ],
    ids=["a matrix", "a matrix of rows", "a structure", "a field", "iddata of older MATLAB"],
)
def test_a_matrix_a_structure_and_an_object_are_columns(
    values: dict[str, Any], columns: dict[str, str], tmp_path: Path
) -> None:
    data = load_data(mat(tmp_path, values), **columns)

    assert_read(data, 0.5)
    assert data.output == "z.y" or "z" not in values


def test_arrays_of_numpy_are_columns_by_name(tmp_path: Path) -> None:
    y = Y.copy()
    y[3] = np.nan
    t = (0.01 * np.arange(30)).astype(np.float32)

    data = load_data(npz(tmp_path, t=t, u=np.arange(30), y=y))

    assert data.u.tolist() == list(range(30))
    assert np.flatnonzero(~data.valid).tolist() == [3]
    assert data.Ts == pytest.approx(0.01, rel=1e-12)


def test_a_name_that_is_a_number_has_precedence_over_a_place(tmp_path: Path) -> None:
    assert_read(load_data(npz(tmp_path, **{"2": U, "1": Y, "Ts": 0.5}), input="2", signal="1"), 0.5)


class Bomb:
    """An object that must never be unpickled."""

    def __reduce__(self) -> Any:
        return (Path("/nonexistent/armrig-was-here").touch, ())


def test_a_pickle_is_never_loaded(tmp_path: Path) -> None:
    objects = np.empty(30, dtype=object)
    objects[0] = Bomb()
    path = npz(tmp_path, u=U, y=objects, z=Y)

    with pytest.raises(FileError, match="signal y: contains pickled Python objects"):
        load_data(path, Ts=1)
    np.testing.assert_array_equal(load_data(path, signal="z", Ts=1).y, Y)


@pytest.mark.usefixtures("_little_room")
@pytest.mark.parametrize("kind", [np.int8, np.float64])
def test_an_archive_that_unpacks_without_end_is_refused(tmp_path: Path, kind: type) -> None:
    """The declared length decides, before anything is unpacked."""
    n = (1 << 20) // 8
    whole, bomb = tmp_path / "whole.npz", tmp_path / "bomb.npz"
    np.savez_compressed(whole, u=np.arange(n - 100.0).astype(kind), y=np.ones(50, kind))
    np.savez_compressed(bomb, u=np.zeros(n - 50, kind), y=np.ones(51, kind))

    with pytest.raises(FileError, match="unpacked it has more than 1 MiB; save only input"):
        load_data(bomb, Ts=1)
    with pytest.raises(FileError, match="all need the same number"):  # it was read
        load_data(whole, Ts=1)


def element(kind: int, values: bytes, order: str = "<") -> bytes:
    return struct.pack(f"{order}II", kind, len(values)) + values + bytes(-len(values) % 8)


def mat5(elements: bytes, order: str = "<") -> bytes:
    """Return a MAT-file of version 5 that holds elements."""
    version = struct.pack(f"{order}H", 0x100) + (b"IM" if order == "<" else b"MI")
    return b"MATLAB 5.0 MAT-file".ljust(124) + version + elements


def doubles(name: str, values: list[int], order: str) -> bytes:
    """Return a vector of doubles that are whole numbers, in a byte each, as MATLAB saves them."""
    parts = element(6, struct.pack(f"{order}II", 6, 0), order)
    parts += element(5, struct.pack(f"{order}ii", len(values), 1), order)
    # A name of up to four letters is in its element's first 8 B.
    parts += struct.pack(f"{order}I", len(name) << 16 | 1) + name.encode().ljust(4, b"\0")
    return element(14, parts + element(2, bytes(values), order), order)


@pytest.mark.parametrize("order", ["<", ">"])
def test_numbers_of_mat_files_are_read_in_each_width_and_byte_order(
    order: str, tmp_path: Path
) -> None:
    path = tmp_path / "data.mat"
    path.write_bytes(mat5(doubles("u", [1, 2, 255], order) + doubles("y", [7, 8, 9], order), order))

    data = load_data(path, Ts=1)

    assert data.u.tolist() == [1, 2, 255]
    assert data.y.tolist() == [7, 8, 9]


def old(name: str, values: np.ndarray[Any, Any], order: str) -> bytes:
    """Return a vector as version 4 saves it."""
    kind = {"<": 0, ">": 1000}[order] + {"f8": 0, "f4": 10, "i2": 30}[values.dtype.str[1:]]
    head = struct.pack(f"{order}5i", kind, values.size, 1, 0, len(name) + 1)
    return head + name.encode() + b"\0" + values.astype(values.dtype.newbyteorder(order)).tobytes()


@pytest.mark.parametrize("order", ["<", ">"])
def test_version_4_is_read_in_every_width_and_order(order: str, tmp_path: Path) -> None:
    whole, single = np.arange(5, dtype="<i2"), np.linspace(0, 1, 5).astype("<f4")
    path = tmp_path / "data.mat"
    path.write_bytes(old("u", whole, order) + old("y", single, order))

    data = load_data(path, Ts=1)

    assert data.u.tolist() == whole.tolist()
    assert data.y.tolist() == single.tolist()


def cells_inside_each_other(depth: int) -> bytes:
    head = element(6, struct.pack("<II", 1, 0)) + element(5, struct.pack("<ii", 1, 1))
    inner, parts = 0, []
    for level in range(depth):
        name = element(1, b"x" if level == depth - 1 else b"")
        parts.append(struct.pack("<II", 14, len(head) + len(name) + inner) + head + name)
        inner += len(parts[-1])
    return b"".join(reversed(parts))


def array(*shape: int, values: bytes, kind: int = 6) -> bytes:
    """Return an element for an array `u` of this shape, of doubles by default."""
    head = element(6, struct.pack("<II", kind, 0))
    head += element(5, struct.pack(f"<{len(shape)}i", *shape))
    return element(14, head + element(1, b"u") + values)


def opaque() -> bytes:
    """Return an object of current MATLAB, whose numbers are where scipy does not look."""
    numbers = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 1, 1))
    numbers += element(1, b"") + element(6, struct.pack("<I", 1))
    names = b"".join(element(1, name) for name in (b"dryer", b"MCOS", b"iddata"))
    return element(14, element(6, struct.pack("<II", 17, 0)) + names + element(14, numbers))


ONE = element(9, struct.pack("<d", 1.0))
HUGE, NO_VALUES = (1 << 30, 1 << 30, 0), r"input u.*: (is|there are no)"  # larger than numpy's
NO_FIELDS = element(5, struct.pack("<i", 8)) + element(1, b"")


@pytest.mark.parametrize(
    ("elements", "said"),
    [
        pytest.param(
            array(1, 1, values=element(9, b"\1" * 7)),
            "an element of kind 9 instead of numbers",
            id="a number is cut",
        ),
        pytest.param(
            array(-2, -3, 1, values=element(2, bytes(6))),
            r"6 numbers in a shape of \(-2, -3, 1\)",
            id="-2 times -3 equals the count of numbers",
        ),
        pytest.param(
            array(*[1] * 100_000, values=ONE),
            "an array of 100000 dimensions; at most 32 are allowed",
            id="dimensions",
        ),
        *(
            pytest.param(array(*HUGE, values=values, kind=kind), NO_VALUES, id=f"empty {kind}")
            for kind, values in ((1, b""), (2, NO_FIELDS), (6, element(9, b"")))
        ),
        # The reader of scipy would crash the interpreter.
        pytest.param(cells_inside_each_other(100_000), "nested too deeply", id="nested cells"),
        pytest.param(
            opaque(), r"object that only MATLAB reads; in MATLAB: u = data\.u; y =", id="opaque"
        ),
    ],
)
def test_an_array_that_cannot_be_read_is_reported(
    elements: bytes, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "data.mat"
    path.write_bytes(mat5(elements))

    with pytest.raises(FileError, match=said):
        load_data(path, Ts=1)


@pytest.mark.usefixtures("_little_room")
def test_a_mat_file_that_unpacks_without_end_is_refused(tmp_path: Path) -> None:
    packed = zlib.compress(bytes(1 << 22))
    path = tmp_path / "bomb.mat"
    path.write_bytes(mat5(struct.pack("<II", 15, len(packed)) + packed))

    with pytest.raises(FileError, match="unpacked it has more than 1 MiB"):
        load_data(path, Ts=1)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"u": U, "y": "words"}, "signal y: contains no numbers; save it as a vector"),
        ({"u": U, "y": np.zeros((0, 0))}, "signal y: is empty; save it with a value for each"),
        (
            {"u": U, "z": Y},
            "signal y: there is no such column; give --signal a name or a number of 1 u",
        ),
        ({"u": U, "y": 1.0}, "signal y: there is no such column"),
        (
            {"note": "nothing"},
            r"input u and signal y: .*there is no column of numbers \(note contains no numbers;",
        ),
        ({"u": U, "y": [{"a": 1}, {"a": 2}]}, "signal y: is a cell of 2 values; save one of them"),
        (
            {"u": U, "y": np.zeros(2, dtype=[("a", float)])},
            "signal y: is an array of 2 structures; save one of them",
        ),
        ({"u": U, "y": csc_array(COLUMN["y"])}, r"signal y: is sparse; save full\(…\) of it"),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_an_array_that_is_not_a_column_is_reported_with_the_remedy(
    values: dict[str, Any], said: str, tmp_path: Path
) -> None:
    with pytest.raises(FileError, match=said):
        load_data(mat(tmp_path, values), Ts=1)


def test_damage_is_reported_in_one_line(tmp_path: Path) -> None:
    values = {"u": U, "y": Y, "Ts": 1.0}
    whole = {
        "packed.mat": mat(tmp_path, values, do_compression=True).read_bytes(),
        "plain.mat": mat(tmp_path, values | {"z": values}).read_bytes(),
        "old.mat": mat(tmp_path, values, format="4").read_bytes(),
        "data.npz": npz(tmp_path, u=U, y=Y, Ts=1.0).read_bytes(),
    }
    for kind, data in whole.items():
        path, refused = tmp_path / f"spoilt-{kind}", 0
        for spoilt in [*_cut(data), *_spoilt(data)]:
            path.write_bytes(spoilt)
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                refusal = _refusal(path)
            assert len(refusal) - len(str(path)) < 400
            refused += bool(refusal)
        assert refused > 50


def test_a_truncated_mat_file_is_reported(tmp_path: Path) -> None:
    path = mat(tmp_path, {"u": U, "y": Y})
    path.write_bytes(path.read_bytes()[:-1])

    with pytest.raises(FileError, match=r"is a damaged MAT-file \(it ends too early\); save it"):
        load_data(path, Ts=1)


def _refusal(path: Path) -> str:
    """Return the refusal of a file; "" if the file is read."""
    try:
        load_data(path)
    except FileError as err:
        return str(err)
    return ""


def _cut(data: bytes) -> list[bytes]:
    return [data[:n] for n in range(0, len(data), 23)]


def _spoilt(data: bytes) -> list[bytes]:
    found, rng = [], np.random.default_rng(2)
    for _ in range(100):
        spoilt = bytearray(data)
        for at in rng.integers(0, len(data), 3):
            spoilt[at] = rng.integers(256)
        found.append(bytes(spoilt))
    return found


def test_an_archive_without_arrays_is_reported(tmp_path: Path) -> None:
    buffer = BytesIO()
    with ZipFile(buffer, "w") as archive:
        archive.writestr("xl/workbook.xml", "<workbook/>")
    path = tmp_path / "data.xlsx"
    path.write_bytes(buffer.getvalue())

    with pytest.raises(FileError, match="is a ZIP archive without arrays, such as an Excel wor"):
        load_data(path, Ts=1)


def test_the_size_of_a_file_bounds_that_of_its_content() -> None:
    """Measured data do not compress a hundredfold."""
    assert table.room(500_000) == table.room(0) == 1 << 26
    assert table.room(1_000_000) == 100_000_000
    assert table.room(100_000_000) == 1 << 28


@pytest.mark.parametrize("unit", ["D", "h", "m", "s", "ms", "us", "ns"])
def test_times_of_numpy_are_in_seconds(unit: Any, tmp_path: Path) -> None:
    ticks = np.arange(30) * np.timedelta64(1, unit)
    for time in (np.datetime64("2025-03-30", unit) + ticks, ticks):
        data = load_data(npz(tmp_path, time=time, **{"u [V]": U, "y": Y}))

        assert_read(data, float(np.timedelta64(1, unit) / np.timedelta64(1, "s")))
        assert data.input_unit == "V"
    assert_read(load_data(npz(tmp_path, u=U, y=Y, Ts=np.timedelta64(250, "ms"))), 0.25)


def test_a_time_that_is_missing_in_numpy_is_reported(tmp_path: Path) -> None:
    time = np.arange(30).astype("M8[M]")
    time[3] = np.datetime64("NaT")

    with pytest.raises(FileError, match=r"row 4: .*no value here"):
        load_data(npz(tmp_path, time=time, u=U, y=Y))


@pytest.mark.parametrize(
    ("begin", "line"),
    [
        (b"MDF     4.10    ", r"asammdf .*MDF.'\S*data.bin'.*export"),
        (b"TDSm\x0e\0\0\0", r"nptdms .*TdmsFile.read.'\S*data.bin'.*to_csv"),
        (b"ULog\x01\x12\x35\x01", r"ulog2csv \S*data.bin"),
        (b"\xa3\x95\x80\x80", r"mavlogdump.py --format csv --types RATE \S*data.bin > RATE.csv"),
        (b"ARROW1\0\0", r"pandas.read_feather.'\S*data.bin'.*to_parquet"),
    ],
)
def test_a_foreign_kind_is_refused_with_the_line_that_converts_it(
    begin: bytes, line: str, tmp_path: Path
) -> None:
    path = tmp_path / "data.bin"
    path.write_bytes(begin + bytes(100))

    with pytest.raises(FileError, match=line):
        load_data(path)


def test_zeros_after_the_last_row_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_bytes(
        b"t,u,y\n" + b"".join(b"%d,%d,1\n" % (k, k % 3) for k in range(30)) + bytes(512)
    )

    data = load_data(path)

    assert (data.N, data.history[0]) == (30, "left out 512 zero bytes at the end")


@pytest.mark.parametrize("Ts", [np.nan, np.inf, -0.01, 0.0, 1e-320, 1e300])
def test_a_number_that_is_no_sampling_time_is_refused(tmp_path: Path, Ts: float) -> None:
    message = rf"not known \(Ts is {Ts:g}, which is no sampling time in s\): give it in s \(--Ts\)"

    with pytest.raises(FileError, match=message.replace("+", r"\+")):
        load_data(npz(tmp_path, u=U, y=Y, Ts=Ts))
