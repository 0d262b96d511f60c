"""The one measure of fit that all of the package quotes."""

from __future__ import annotations

import numpy as np

from armrig.numerics.polynomial import Array


def fit_percent(y: Array, sse: float) -> float:
    """Return 100 (1 - |y - ŷ| / |y - mean y|) for the squared error sse = |y - ŷ|²."""
    spread = float(np.linalg.norm(y - np.mean(y))) if y.size else 0.0
    if not np.isfinite(sse):
        return -np.inf
    return 100 * (1 - float(np.sqrt(sse)) / spread) if spread > 0 else float("nan")
