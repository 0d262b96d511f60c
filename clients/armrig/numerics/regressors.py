"""Regressors of signals that may have holes (NaN): what is not known is NaN, and no zero."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from armrig.numerics.polynomial import Array, lagged
from armrig.numerics.stretches import Mask


@dataclass(frozen=True, slots=True, kw_only=True)
class ArxRows:
    """One experiment as y = Phi theta + e."""

    block: Array
    """[-y(t-1) … -y(t-na), u at its lags, y], (N, na + len(lags) + 1)."""
    usable: Mask
    """(N,), False where a regressor or y is missing or lies before the start."""

    @property
    def Phi(self) -> Array:
        """All of the block but y, a view."""
        return self.block[:, :-1]

    @property
    def y(self) -> Array:
        """(N,), a view."""
        return self.block[:, -1]


def past(x: Array, lags: Sequence[int]) -> Array:
    """Return (N, len(lags)): column j is x(t - lags[j]), NaN before the first sample."""
    columns = lagged(np.asarray(x, dtype=np.float64), lags)
    for j, lag in enumerate(lags):
        columns[:lag, j] = np.nan
    return columns


def complete(*columns: Array) -> Mask:
    """Return the rows (N,) in which all of the columns, each (N,) or (N, k), are known."""
    known = [np.isfinite(c) if c.ndim == 1 else np.isfinite(c).all(axis=1) for c in columns]
    return np.asarray(np.logical_and.reduce(known))


def arx_rows(u: Array, y: Array, *, na: int, lags: Sequence[int]) -> ArxRows:
    """Return the rows of A y = B u + e, with na past outputs and the input at its lags."""
    block = np.hstack([-past(y, range(1, na + 1)), past(u, lags), y[:, None]])
    return ArxRows(block=block, usable=complete(block))


def in_blocks(M: Array, rows: int) -> Iterator[Array]:
    """Yield successive blocks of M (N, d) with that many rows, the last one with the rest."""
    for begin in range(0, M.shape[0], rows):
        yield M[begin : begin + rows]
