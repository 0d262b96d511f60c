"""Columns of pandas as arrays, without an import of pandas."""

from __future__ import annotations

from typing import Any

import numpy as np
from armrig_core.errors import InputError


def plain(name: str, values: Any) -> Any:
    """Return a pandas column as an array, NaN for missing values; return other values unchanged.

    Raises
    ------
    ValueError
        A value is not a number, or `values` is a table instead of a column.
    """
    if not is_pandas(values):
        return values
    if getattr(values, "ndim", 1) != 1:
        raise InputError(
            f"{name} is a table of pandas with shape {values.shape}; give one column, df[{name!r}]"
        )
    if getattr(values.dtype, "kind", "") == "c":
        return values.to_numpy()
    try:
        return values.to_numpy(dtype=np.float64, na_value=np.nan)
    except (TypeError, ValueError) as err:
        raise InputError(
            f"{name} is a column of {values.dtype}: {err}; give numbers, see pandas.to_numeric"
        ) from err


def is_pandas(values: Any) -> bool:
    """Return whether `values` is a pandas object, recognised by its methods."""
    return hasattr(values, "to_numpy") and hasattr(values, "isna")


def present(y: Any, valid: Any) -> Any:
    """Return `valid`; for a pandas column y, also set the mask to False where y is missing."""
    if is_pandas(valid):
        valid = valid.to_numpy(dtype=np.bool_, na_value=False)
    if not is_pandas(y):
        return valid
    there = np.asarray(y.notna(), dtype=np.bool_)
    return there if valid is None else np.asarray(valid, dtype=np.bool_) & there
