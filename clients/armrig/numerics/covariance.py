"""Covariance of estimates that does not trust the residuals to be white (sandwich forms).

Both return C in W M W^T, where W W^T = (Psi^T Psi)^-1 is the bread and M the covariance of the
score Psi^T e; for white residuals both tend to the classic lambda (Psi^T Psi)^-1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armrig.numerics.polynomial import Array, filtered
from armrig.numerics.whiteness import autoregression, joined


def exogenous_score(blocks: Sequence[Array], residuals: Sequence[Array]) -> Array:
    """Return M = Psi^T R Psi for a Psi that does not depend on the noise (output error).

    R is the covariance matrix of the noise, here that of an autoregression fitted to the
    residuals (Yule-Walker, order by AIC; order 0, and so the classic form, for white ones):
    R = s² H H^T, so M = s² |H^T Psi|², one filter run backwards in time.

    Parameters
    ----------
    blocks : sequence of ndarray (N_i, d)
        Psi of each experiment, zero in the rows where y is missing.
    residuals : sequence of ndarray (N_i,)
        Residuals of each experiment, NaN where y is missing.

    References
    ----------
    .. [1] T. Söderström, P. Stoica, *System Identification*, 1989, section 7.5 and C7.7.
    .. [2] W. J. den Haan, A. Levin, "A practitioner's guide to robust covariance matrix
       estimation", Handbook of Statistics 15, 1997 (the autoregressive estimate).
    """
    C, s2 = autoregression(joined(residuals, 40))
    total = np.zeros((blocks[0].shape[1],) * 2)
    for Psi in blocks:
        backwards = Psi.T[:, ::-1]
        whole = backwards if C.size == 1 else filtered([1.0], C, backwards)
        total += s2 * (whole @ whole.T)
    return total


def correlated_score(scores: Sequence[Array]) -> Array:
    """Return M for scores psi(t) e(t) that may depend on the noise (ARX): Newey-West.

    Bartlett weights 1 - k/(L + 1) up to L = floor(4 (N/100)^(2/9)), which is the mean square of
    all sums of L + 1 successive scores, those over the ends included.

    References
    ----------
    .. [1] W. K. Newey, K. D. West, Econometrica 55 (1987) 703-708.
    """
    N = sum(s.shape[0] for s in scores)
    L = int(4 * (N / 100) ** (2 / 9))
    total = np.zeros((scores[0].shape[1],) * 2)
    for s in scores:
        none = np.zeros((L + 1, s.shape[1]))
        upto = np.cumsum(np.vstack([none, s, none[1:]]), axis=0)
        sums = upto[L + 1 :] - upto[: -L - 1]
        total += sums.T @ sums / (L + 1)
    return total
