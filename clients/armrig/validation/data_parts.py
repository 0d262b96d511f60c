"""Division of data into a part for estimation and a part for validation."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from armrig_core.errors import InputError

from armrig.data.dataset import Dataset, Signals, Vector
from armrig.estimation.data_faults import CONSTANT_INPUT

Data = TypeVar("Data", Dataset, Signals)

_MIN_RANGE_SHARE = 0.1  # least range of u in a part, as a share of the range of u in the data
_MIN_PART_SHARE = 0.2  # least number of samples in a part, as a share of all samples


def estimation_and_validation(data: Data) -> tuple[Data, Data]:
    """Return two consecutive parts in which each input moves: the halves, if possible.

    Without an input that moves, a part does not distinguish models. If an input rests in one half,
    the cut is as near to the middle as possible.

    Raises
    ------
    ValueError
        u is constant, or there is no such cut between 20 % and 80 % of the samples.
    """
    u = data.u.reshape(data.N, -1)
    if not np.ptp(u):
        raise InputError(CONSTANT_INPUT)
    least = _MIN_RANGE_SHARE * np.ptp(u, axis=0)
    before, after = _range(u) >= least, _range(u[::-1])[::-1] >= least
    cuts = 1 + np.flatnonzero(np.all(before[:-1] & after[1:], axis=1))
    middle = round(data.N / 2)
    cut = int(cuts[np.argmin(np.abs(cuts - middle))]) if cuts.size else 0
    if not _MIN_PART_SHARE <= cut / data.N <= 1 - _MIN_PART_SHARE:
        raise InputError(
            "u moves in one part of the data only, and the other part cannot rank models: give "
            "other data for validation (validation=, --validate), or estimate one structure "
            "without a search"
        )
    return data[:cut], data[cut:]


def _range(u: Vector) -> Vector:
    """Return the range of each column of u (N, n) up to each sample."""
    return np.asarray(np.maximum.accumulate(u) - np.minimum.accumulate(u))
