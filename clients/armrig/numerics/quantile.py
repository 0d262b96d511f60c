"""Quantiles and p values of normal variables, and refusals of impossible levels."""

from __future__ import annotations

from math import sqrt

import numpy as np
from armrig_core.errors import InputError

from armrig.numerics.polynomial import Array


def two_sided(level: float) -> float:
    """Return z with P(|x| < z) = level for a standard normal x: 1.96 for 0.95."""
    from scipy.special import erfinv

    if not 0 < level < 1:
        raise InputError(f"level={level!r} must lie between 0 and 1, for example 0.95")
    return sqrt(2) * float(erfinv(level))


def joint_p_value(s: Array, M: Array) -> float:
    """Return P(chi² >= s^T M^+ s), with the rank of M as degrees of freedom; NaN for rank 0."""
    from scipy.special import chdtrc

    scale = np.sqrt(np.maximum(np.diag(M), 0.0))
    used = scale > 1e-10 * max(float(scale.max(initial=0.0)), 1e-300)
    if not used.any():
        return float("nan")
    s, M = s[used] / scale[used], M[np.ix_(used, used)] / np.outer(scale[used], scale[used])
    value, vector = np.linalg.eigh(M)
    kept = value > 1e-8 * value[-1]
    z = vector[:, kept].T @ s
    return float(chdtrc(int(np.count_nonzero(kept)), np.sum(z**2 / value[kept])))
