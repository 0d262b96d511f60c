"""Files of MATLAB, of numpy and of Parquet."""

from __future__ import annotations

import struct
import sys
import warnings
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pyarrow
import pytest
from armrig import Dataset, FileError, load_data, load_signals
from armrig.data.files import table
from armrig.data.files.kinds import table_of
from armrig.data.step import DOUBT, codes_of
from pyarrow import parquet
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


@pytest.fixture
def _little_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a file unpack to 1 MiB."""
    monkeypatch.setattr(table, "room", lambda _: 1 << 20)


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


def logged(time: Any, *signals: tuple[Any, str]) -> dict[str, Any]:
    """Return a structure with time as Simulink logs it; each signal has values and a label."""
    kinds = [("values", object), ("dimensions", object), ("label", object), ("title", object)]
    every = np.empty((1, len(signals)), dtype=kinds)
    for k, (values, label) in enumerate(signals):
        every[0, k] = (values, 1.0, label, "")
    return {"time": time, "signals": every, "blockName": "plant/Scope"}


T = 0.5 * np.arange(30).reshape(-1, 1)


def test_a_structure_with_time_of_simulink_is_columns_by_label(tmp_path: Path) -> None:
    both_columns = (np.column_stack([U, Y]), "u")
    scope = logged(T, (COLUMN["u"], "u"), (COLUMN["y"], "<y>"), both_columns)

    path = mat(tmp_path, {"ScopeData": scope})
    data = load_data(path)
    both = load_signals(path, inputs="signals:3", outputs="y")

    assert_read(data, 0.5)
    assert data.output == "ScopeData.y"
    np.testing.assert_array_equal(both.u, np.column_stack([U, Y]))


def test_two_structures_with_the_same_times_are_read_together(tmp_path: Path) -> None:
    cube = Y.reshape(1, 1, -1)  # as Simulink logs a signal that is a matrix
    values = {"yout": logged(T, (cube, "")), "uout": logged(T, (COLUMN["u"], ""))}
    path = mat(tmp_path, values, do_compression=True)

    assert_read(load_data(path, input="uout", signal="yout"), 0.5)
    other = mat(tmp_path, values | {"yout": logged(2 * T, (cube, ""))})
    data = load_data(other, input="uout", signal="yout")
    assert data.Ts == 1.0
    assert "uout has its own times, uout.time: held to the times of yout" in data.history[0]


def test_a_structure_without_times_needs_a_sampling_time(tmp_path: Path) -> None:
    path = mat(tmp_path, {"out": logged(np.zeros((0, 0)), (U, "u"), (Y, "y"))})

    assert load_data(path, Ts=2).y.tolist() == Y.tolist()
    with pytest.raises(FileError, match="sampling time is not known"):
        load_data(path)


def test_a_field_that_was_never_assigned_does_not_shift_the_others(tmp_path: Path) -> None:
    """MATLAB writes such a field as a matrix element of 0 B."""
    path = mat(tmp_path, {"z": {"a": np.zeros((0, 0)), "u": U, "y": Y, "Ts": 2.0}})
    whole = path.read_bytes()
    empty = whole.index(struct.pack("<II", 14, 48))  # the element of `a`, a matrix of 0 values
    parts = bytearray(whole[:empty] + struct.pack("<II", 14, 0) + whole[empty + 56 :])
    struct.pack_into("<I", parts, 132, struct.unpack_from("<I", whole, 132)[0] - 48)
    path.write_bytes(parts)

    assert_read(load_data(path), 2.0)


def structures(*fields: dict[str, Any]) -> np.ndarray[Any, Any]:
    """Return an array of structures with the same fields."""
    array = np.empty((1, len(fields)), dtype=[(name, object) for name in fields[0]])
    for k, values in enumerate(fields):
        for name, value in values.items():
            array[name][0, k] = value
    return array


def texts(*values: str) -> np.ndarray[Any, Any]:
    """Return a cell array of texts."""
    return np.array(values, dtype=object).reshape(-1, 1)


def of_get(**fields: Any) -> dict[str, Any]:
    """Return the structure that get(z) of an iddata returns, in minutes."""
    empty = np.zeros((0, 0))
    z = {"InputData": COLUMN["u"], "OutputData": COLUMN["y"], "y": "Same as OutputData"}
    z |= {"InputUnit": texts("V"), "OutputUnit": texts("degC"), "InterSample": "zoh"}
    return {"z": z | {"Ts": 0.5, "SamplingInstants": empty, "TimeUnit": "minutes"} | fields}


@pytest.mark.parametrize(
    ("fields", "Ts", "note"),
    [
        ({}, 30.0, "Ts = 0.5 minutes, by TimeUnit"),
        ({"Ts": np.uint8(30), "TimeUnit": "days"}, 2_592_000.0, "Ts = 30 days, by TimeUnit"),
        ({"Ts": 35, "TimeUnit": "Milliseconds"}, 0.035, "Ts = 35 milliseconds, by TimeUnit"),
        ({"TimeUnit": "seconds"}, 0.5, ""),
        ({"TimeUnit": ""}, 0.5, ""),
        (
            {"Ts": np.zeros((0, 0)), "SamplingInstants": 2 * T},
            60.0,
            "times in minutes, by TimeUnit",
        ),
    ],
    ids=["minutes", "uint8", "ms", "s", "no unit", "times"],
)
def test_the_fields_of_an_iddata_have_its_units(
    fields: dict[str, Any], Ts: float, note: str, tmp_path: Path
) -> None:
    path = mat(tmp_path, of_get(**fields))
    data = load_data(path)

    assert not table_of(path.read_bytes(), ".mat").refused
    assert_read(data, Ts)
    assert (data.input_unit, data.unit) == ("V", "degC")
    assert list(data.history[:1]) == [note] * bool(note)


def test_several_outputs_of_an_iddata_have_their_units(tmp_path: Path) -> None:
    several = {"OutputData": MATRIX, "OutputUnit": texts("s", "V", "K")}

    both = load_signals(mat(tmp_path, of_get(**several)), inputs="u", outputs="y")

    assert both.units == ("s", "V", "K")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (of_get(TimeUnit="fortnights"), "TimeUnit is 'fortnights', allowed are nanoseconds to"),
        (of_get() | {"x": {"Ts": 2.0}}, "the sampling time is not known: give it in s"),
    ],
    ids=["unit", "two"],
)
def test_a_doubtful_sampling_time_is_refused(
    values: dict[str, Any], said: str, tmp_path: Path
) -> None:
    with pytest.raises(FileError, match=said):
        load_data(mat(tmp_path, values))


def test_the_hold_of_an_iddata_is_doubted(tmp_path: Path) -> None:
    data = load_data(mat(tmp_path, of_get(InterSample="foh", TimeUnit="")))

    assert codes_of(data.history[:1]) == [DOUBT]


def channel(name: str, values: Any, **more: Any) -> dict[str, Any]:
    """Return a channel of a capture of dSPACE ControlDesk."""
    return {"Name": name, "Data": values.reshape(1, -1), **more}


def capture(*X: Any, of: tuple[int, int] = (1, 1)) -> dict[str, Any]:
    """Return a capture whose channels have the times of the given elements of X."""
    of_u, of_y = ({"Unit": unit, "XIndex": float(k)} for unit, k in zip("VK", of, strict=True))
    Y = structures(channel("motor voltage", U, **of_u), channel("speed", Y_, **of_y))
    return {"rec": {"X": structures(*X), "Y": Y, "Capture": "none"}}


Y_ = Y
BY_NAME = {"input": "motor voltage", "signal": "speed"}


def test_a_capture_of_dspace_is_columns_by_name(tmp_path: Path) -> None:
    data = load_data(mat(tmp_path, capture(channel("X", T))), **BY_NAME)
    in_ms = load_data(mat(tmp_path, capture(channel("", T, Unit="ms"))), **BY_NAME)

    assert_read(data, 0.5)
    assert (data.output, data.unit, data.input_unit) == ("rec.speed", "K", "V")
    assert in_ms.Ts == 5e-4


def test_channels_on_two_clocks_are_not_paired_by_row(tmp_path: Path) -> None:
    X = channel("", T), channel("", T + 0.1), channel("", T)
    path = mat(tmp_path, capture(*X, of=(1, 2)))

    with pytest.raises(FileError, match=r"speed: has the times X\(2\)\.Data, and most channels"):
        load_data(path, **BY_NAME)
    assert_read(load_data(mat(tmp_path, capture(*X, of=(1, 3))), **BY_NAME), 0.5)


def test_structures_with_names_are_columns_by_name(tmp_path: Path) -> None:
    fields = [
        {"name": name, "data": x.reshape(-1, 1)} for name, x in (("t", T), ("u", U), ("y", Y))
    ]

    assert_read(load_data(mat(tmp_path, {"log": structures(*fields)}), time="t"), 0.5)


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


def written(path: Path, **columns: Any) -> Path:
    """Write columns, and return the path, whose suffix is of another kind of file."""
    parquet.write_table(pyarrow.table(columns), path)
    return path


def test_columns_have_names_units_and_missing_values(tmp_path: Path) -> None:
    y = [None if k == 3 else value for k, value in enumerate(Y.tolist())]
    t = (0.01 * np.arange(30)).astype(np.float32)
    path = written(tmp_path / "data.csv", **{"t [s]": t, "u [V]": U, "y": y, "word": ["a"] * 30})

    data = load_data(path)

    np.testing.assert_array_equal(data.u, U)
    np.testing.assert_array_equal(np.flatnonzero(~data.valid), [3])
    assert (data.input_unit, data.missing) == ("V", 1)
    assert data.Ts == pytest.approx(0.01, rel=1e-12)
    with pytest.raises(FileError, match="input word: contains no numbers"):
        load_data(path, input="word")


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_time_stamps_are_in_seconds(unit: str, tmp_path: Path) -> None:
    ticks = 1_750_000_000 * 10 ** {"s": 0, "ms": 3, "us": 6, "ns": 9}[unit] + np.arange(30)
    stamps = pyarrow.array(ticks, pyarrow.timestamp(unit, tz="UTC"))
    path = written(tmp_path / "data", time=stamps, u=U > 0, y=np.arange(30, dtype=np.int8))

    data = load_data(path)

    assert data.Ts == pytest.approx({"s": 1, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit], rel=1e-12)
    assert (data.u.tolist(), data.y.tolist()) == ((U > 0).astype(float).tolist(), [*range(30)])


@pytest.mark.usefixtures("_little_room")
def test_a_damaged_parquet_file_is_refused_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path / "data.parquet", u=U, y=Y)
    (tmp_path / "cut.parquet").write_bytes(path.read_bytes()[:-9])

    with pytest.raises(FileError, match=r"cut\.parquet: is a damaged Parquet file"):
        load_data(tmp_path / "cut.parquet", Ts=1)
    parquet.write_table(
        pyarrow.table([U, U, Y], names=["u", "u", "y"]), tmp_path / "double.parquet"
    )
    with pytest.raises(FileError, match="two of its columns have the same name"):
        load_data(tmp_path / "double.parquet", Ts=1)
    long = np.zeros(1 << 16)
    with pytest.raises(FileError, match="unpacked it has more than"):
        load_data(written(tmp_path / "long.parquet", u=long, y=long, z=long), Ts=1)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(FileError, match=r"pyarrow is not installed: .* 'armrig\[parquet\]'"):
        load_data(path, Ts=1)
