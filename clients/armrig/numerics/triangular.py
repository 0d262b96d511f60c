"""The triangle R of a tall matrix, block of rows by block, so that length costs no memory."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.linalg import qr

from armrig.numerics.polynomial import Array


def triangle(blocks: Iterable[Array], width: int) -> Array:
    """Return R (width, width) of Q R = M, for an M given as blocks of rows (n_i, width).

    R^T R is M^T M without having been squared; with fewer rows than columns the last rows are 0.
    """
    R = np.zeros((0, width))
    for block in blocks:
        R = qr(np.vstack([R, block]), mode="r", check_finite=False)[0][:width]
    return np.vstack([R, np.zeros((width - R.shape[0], width))])
