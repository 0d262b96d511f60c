"""Covariance of the score for the sandwich form, which is also valid for coloured residuals.

The covariance of an estimate is W W^T M W W^T. Here W W^T = (Psi^T Psi)^-1, and M is the covariance
of the score Psi^T e. For white residuals the sandwich form tends to the classic form,
lambda (Psi^T Psi)^-1.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from armrig.numerics.polynomial import Array
from armrig.numerics.whiteness import autoregression

_FILTER_ROWS = 1 << 16  # rows filtered at once, so that the memory does not grow with the data
_SUM_ROWS = 1 << 11  # rows summed at once


def exogenous_score(blocks: Sequence[Array], residuals: Sequence[Array]) -> Array:
    """Return M = Psi^T R Psi for a Psi that does not depend on the noise (output error).

    R is the covariance matrix of an autoregression fitted to the residuals (Yule-Walker, order by
    AIC). With R = s² H H^T, M is s² (H^T Psi)^T (H^T Psi). H^T Psi is computed by filtering Psi
    backwards in time. For white residuals the order is 0, and the sandwich form equals the classic
    form.

    Parameters
    ----------
    blocks : sequence of ndarray (N_i, d)
        Psi of each experiment, zero in the rows in which y is missing.
    residuals : sequence of ndarray (N_i,)
        Residuals of each experiment, NaN if y is missing.

    References
    ----------
    .. [1] T. Söderström, P. Stoica, *System Identification*, 1989, section 7.5 and C7.7.
    .. [2] W. J. den Haan, A. Levin, "A practitioner's guide to robust covariance matrix
       estimation", Handbook of Statistics 15, 1997 (the autoregressive estimate).
    """
    # Lists, not generators: a generator inside the comprehension would use only the last Psi.
    whole = [[Psi[a:b] for a, b in _backwards(Psi.shape[0])] for Psi in blocks]
    return exogenous_score_in_blocks(whole, residuals, blocks[0].shape[1])


def exogenous_score_in_blocks(
    experiments: Iterable[Iterable[Array]], residuals: Sequence[Array], d: int
) -> Array:
    """Return `exogenous_score` for Psi in blocks of rows (n, d), the last block first."""
    from scipy.signal import lfilter

    C, s2 = autoregression(residuals)
    total = np.zeros((d, d))
    for blocks in experiments:
        state = np.zeros((d, C.size - 1))
        for block in blocks:
            scores = block.T
            if C.size > 1:
                scores, state = lfilter([1.0], C, scores[:, ::-1], zi=state)
            total += s2 * (scores @ scores.T)
    return total


def _backwards(N: int) -> Iterator[tuple[int, int]]:
    """Yield the first row and the end of each block of rows, the last block first."""
    for end in range(N, 0, -_FILTER_ROWS):
        yield max(end - _FILTER_ROWS, 0), end


def correlated_score(blocks: Sequence[Array], residuals: Sequence[Array]) -> Array:
    """Return M by Newey and West's method, for a Psi that depends on past noise (ARX).

    The Bartlett weights are 1 - k/(L + 1) up to the lag L = floor(4 (N/100)^(2/9)). The estimate is
    computed from all sums of L + 1 successive scores. M is the total of s s^T over all these sums
    s, divided by L + 1. The incomplete sums at both ends of the data are included.

    Parameters
    ----------
    blocks : sequence of ndarray (N_i, d)
        Psi of each experiment, zero in the rows in which y is missing.
    residuals : sequence of ndarray (N_i,)
        Residuals of each experiment, NaN if y is missing.

    References
    ----------
    .. [1] W. K. Newey, K. D. West, Econometrica 55 (1987) 703-708.
    """
    N = sum(e.size for e in residuals)
    L = int(4 * (N / 100) ** (2 / 9))
    total = np.zeros((blocks[0].shape[1],) * 2)
    for Psi, e in zip(blocks, residuals, strict=True):
        # Few rows at once: to allocate memory for all rows would take longer than the sums.
        for begin in range(0, e.size + L, _SUM_ROWS):
            sums = _sums_of_scores(Psi, e, L, begin, min(begin + _SUM_ROWS, e.size + L))
            total += sums @ sums.T / (L + 1)
    return total


def _sums_of_scores(Psi: Array, e: Array, L: int, begin: int, end: int) -> Array:
    """Return the sum of psi(s) e(s) over s = t - L … t, for each t = begin … end - 1."""
    first = begin - L - 1
    a, b = max(first + 1, 0), min(end, e.size)
    scores = np.zeros((Psi.shape[1], end - first))
    np.multiply(Psi[a:b].T, np.nan_to_num(e[a:b]), out=scores[:, a - first : b - first])
    upto = np.cumsum(scores, axis=1)
    return np.asarray(upto[:, L + 1 :] - upto[:, : -L - 1])
