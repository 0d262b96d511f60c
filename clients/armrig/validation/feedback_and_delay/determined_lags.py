"""How many lags of u the data tell apart: an input that excites little determines few."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.numerics.least_squares import column_norms, triangle
from armrig.numerics.regressors import in_blocks

Matrix = NDArray[np.float64]

_OWN = 0.005  # share of a lag of u that those before it must leave
_POOREST = 28  # lags of their own, what a PRBS of period 31 has; few sines have fewer
_BLOCK = 4096  # rows decomposed at once: they stay in the cache


def determined_lags(data: Dataset, most: int) -> int:
    """Return how many successive lags of u each have a share of their own, `most` at most.

    That of a lag is what those before it leave, sqrt(1 - R²) of its regression on them.

    Raises
    ------
    ValueError
        They are so few that u has power in a narrow band only: it follows from its own past, and
        what the model lacks far away would look like a coefficient near lag 0.
    """
    R = triangle(_windows_of_u(data, most), most)
    own = np.abs(np.diag(R)) > _OWN * column_norms(R)
    found = int(np.argmin(np.append(own, False)))
    if found < min(_POOREST, most):
        raise InputError(
            f"u determines {found} lags only: power in so narrow a band tells no delay; play a "
            "telegraph or a PRBS"
        )
    return found


def _windows_of_u(data: Dataset, length: int) -> Iterator[Matrix]:
    """Yield u(t), u(t - 1) … about its mean in each experiment, in blocks of rows."""
    for part in data.experiments():
        if length <= part.N:
            windows = np.lib.stride_tricks.sliding_window_view(part.u - part.u.mean(), length)
            yield from in_blocks(windows[:, ::-1], _BLOCK)
