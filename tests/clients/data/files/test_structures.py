"""Structures that Simulink, dSPACE and MATLAB's iddata save."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from armrig import FileError, load_data, load_signals
from armrig.data.files.kinds import table_of
from armrig.data.step import DOUBT, codes_of

from tests.clients.data.files.test_arrays import COLUMN, MATRIX, U, Y, assert_read, mat


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
        (of_get() | {"x": {"Ts": 2.0}}, "not known .Ts has several values: 2, 30.: give it"),
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
