"""Files of Parquet."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
from armrig import FileError, load_data
from pyarrow import parquet

from tests.clients.data.files.test_arrays import U, Y


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
