"""Columns of pandas as u and y."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from armrig import Dataset

U = [1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize(
    "y",
    [
        pd.Series([1.0, np.nan, 3.0, 4.0]),
        pd.Series([1, None, 3, 4], dtype="Int64"),
        pd.Series([1, pd.NA, 3, 4], dtype="Float64"),
        pd.Series([1.0, None, 3.0, 4.0], dtype=object),
        pd.Series([1.0, np.nan, 3.0, 4.0], index=[9, 8, 7, 6]),
    ],
    ids=["NaN", "Int64", "Float64", "object", "another index"],
)
def test_a_column_is_taken_and_what_it_lacks_is_missing(y: Any) -> None:
    data = Dataset(u=pd.Series(U), y=y, Ts=1)

    assert data.u.tolist() == U
    np.testing.assert_array_equal(data.y, [1, np.nan, 3, 4])
    assert data.valid.tolist() == [True, False, True, True]


def test_what_valid_leaves_out_is_missing_too() -> None:
    valid = pd.Series([True, True, False, None], dtype="boolean")

    data = Dataset(u=U, y=pd.Series([1.0, np.nan, 3.0, 4.0]), Ts=1, valid=valid)

    assert data.valid.tolist() == [True, False, False, False]


@pytest.mark.parametrize(
    ("u", "said"),
    [
        (
            pd.Series(["a", "b", "c", "d"]),
            "u is a column of .*; give numbers, see pandas.to_numeric",
        ),
        (
            pd.DataFrame({"u": U}),
            r"u is a table of pandas with shape \(4, 1\); give one column, df",
        ),
        (pd.Series([1.0, np.nan, 3.0, 4.0]), "u is not finite at 1 samples, first nan at 1"),
    ],
)
def test_what_is_no_column_of_numbers_is_refused(u: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Dataset(u=u, y=U, Ts=1)
