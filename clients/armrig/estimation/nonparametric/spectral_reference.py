"""What data themselves say of the frequency response, to hold a model against."""

from __future__ import annotations

import numpy as np

from armrig.data.dataset import Dataset
from armrig.estimation.nonparametric.spectral import spa
from armrig.models.spectral_estimate import SpectralEstimate

LONGEST = 300
"""Lag window in samples, at most."""
POINTS = 40


def spectral_reference(data: Dataset) -> SpectralEstimate:
    """Return the spectral analysis of data that a model is drawn beside.

    Its lag window is N/10, 300 samples at most, ten times what `spa` takes by itself: a blunted
    resonance would be held against the model, wide bars are not. The 40 frequencies are equally
    spaced on a logarithmic scale from the lowest that the window resolves, 2 pi/(window Ts).

    Raises
    ------
    ValueError
        u is constant, or there are too few samples.
    """
    window = max(2, min(data.N // 10, LONGEST))
    nyquist = np.pi / data.Ts
    return spa(data, window, np.geomspace(2 * nyquist / window, nyquist, POINTS))
