"""Where the input explains the output: what spectral estimates may be read at."""

from __future__ import annotations

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.models.spectral_estimate import COHERENT, SpectralEstimate

FEWEST_FREQUENCIES = 3


def explained(estimate: SpectralEstimate) -> NDArray[np.int_]:
    """Return the indices up to the last frequency at which u explains y, known ones only.

    Raises
    ------
    ValueError
        u explains y at fewer than three frequencies.
    """
    coherence = np.nan_to_num(np.zeros(1) if estimate.coherence is None else estimate.coherence)
    good = np.flatnonzero(coherence > COHERENT)
    if good.size < FEWEST_FREQUENCIES:
        at = ("no frequency", "one frequency", "two frequencies")[good.size]
        raise InputError(
            f"u explains y at {at} (coherence above {COHERENT:g}), and {FEWEST_FREQUENCIES} are "
            "needed: record longer, or with a "
            "larger or richer input"
        )
    known = np.flatnonzero(np.isfinite(estimate.G))
    return np.asarray(known[(known >= good[0]) & (known <= good[-1])])
