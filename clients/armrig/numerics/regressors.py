"""Regressors of signals with missing samples; an unknown value is NaN, not zero."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from armrig.numerics.polynomial import Array, lagged
from armrig.numerics.stretches import Mask


@dataclass(frozen=True, slots=True, kw_only=True)
class ArxRows:
    """Regression y = Phi theta + e of one experiment."""

    block: Array
    """[-y(t-1) … -y(t-na), u at its lags, y], (N, na + len(lags) + 1)."""
    usable: Mask
    """Rows in which y and all regressors are known, (N,)."""

    @property
    def Phi(self) -> Array:
        """Regressors (N, na + len(lags)), a view of the block."""
        return self.block[:, :-1]

    @property
    def y(self) -> Array:
        """Output (N,), a view of the block."""
        return self.block[:, -1]


def past(x: Array, lags: Sequence[int]) -> Array:
    """Return an array (N, len(lags)) with x(t - lags[j]) in column j, NaN if t < lags[j]."""
    columns = lagged(np.asarray(x, dtype=np.float64), lags)
    for j, lag in enumerate(lags):
        columns[:lag, j] = np.nan
    return columns


def complete(*columns: Array) -> Mask:
    """Return a mask (N,) of the rows in which all columns, each (N,) or (N, k), are known."""
    known = [np.isfinite(c) if c.ndim == 1 else np.isfinite(c).all(axis=1) for c in columns]
    return np.asarray(np.logical_and.reduce(known))


def arx_rows(u: Array, y: Array, *, na: int, lags: Sequence[int]) -> ArxRows:
    """Return the rows of A y = B u + e, with na past outputs and the input at the given lags."""
    block = np.hstack([-past(y, range(1, na + 1)), past(u, lags), y[:, None]])
    return ArxRows(block=block, usable=complete(block))


def in_blocks(M: Array, rows: int) -> Iterator[Array]:
    """Yield successive blocks of M (N, d) with `rows` rows; the last block has the remainder."""
    for begin in range(0, M.shape[0], rows):
        yield M[begin : begin + rows]
