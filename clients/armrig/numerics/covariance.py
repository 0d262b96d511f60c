"""Covariance of estimates that does not trust the residuals to be white (sandwich forms).

Both return C in W M W^T, where W W^T = (Psi^T Psi)^-1 is the bread and M the covariance of the
score Psi^T e; for white residuals both tend to the classic lambda (Psi^T Psi)^-1.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from armrig.numerics.polynomial import Array
from armrig.numerics.whiteness import autoregression, joined

_ROWS = 1 << 16  # filtered at once, so that length costs no memory
_FEW_ROWS = 1 << 11  # summed at once


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
    # Lists, not generators: one made in a comprehension would take the rows of the last Psi.
    whole = [[Psi[a:b] for a, b in _backwards(Psi.shape[0])] for Psi in blocks]
    return exogenous_score_in_blocks(whole, residuals, blocks[0].shape[1])


def exogenous_score_in_blocks(
    experiments: Iterable[Iterable[Array]], residuals: Sequence[Array], d: int
) -> Array:
    """Return the same for Psi given as blocks of rows (n, d), the last of an experiment first."""
    from scipy.signal import lfilter

    C, s2 = autoregression(joined(residuals, 40))
    total = np.zeros((d, d))
    for blocks in experiments:
        state = np.zeros((d, C.size - 1))
        for block in blocks:
            backwards = block.T[:, ::-1]
            if C.size > 1:
                backwards, state = lfilter([1.0], C, backwards, zi=state)
            total += s2 * (backwards @ backwards.T)
    return total


def _backwards(N: int) -> Iterator[tuple[int, int]]:
    """Yield where blocks of rows begin and end, the last first."""
    for end in range(N, 0, -_ROWS):
        yield max(end - _ROWS, 0), end


def correlated_score(blocks: Sequence[Array], residuals: Sequence[Array]) -> Array:
    """Return M for scores psi(t) e(t) that may depend on the noise (ARX): Newey-West.

    Bartlett weights 1 - k/(L + 1) up to L = floor(4 (N/100)^(2/9)), which is the mean square of
    all sums of L + 1 successive scores, those over the ends included.

    Parameters
    ----------
    blocks : sequence of ndarray (N_i, d)
        Psi of each experiment, zero in the rows where y is missing.
    residuals : sequence of ndarray (N_i,)
        Residuals of each experiment, NaN where y is missing.

    References
    ----------
    .. [1] W. K. Newey, K. D. West, Econometrica 55 (1987) 703-708.
    """
    N = sum(e.size for e in residuals)
    L = int(4 * (N / 100) ** (2 / 9))
    total = np.zeros((blocks[0].shape[1],) * 2)
    for Psi, e in zip(blocks, residuals, strict=True):
        # Few rows at once: fresh memory for all of them costs more than the sums.
        for begin in range(0, e.size + L, _FEW_ROWS):
            sums = _sums_of_scores(Psi, e, L, begin, min(begin + _FEW_ROWS, e.size + L))
            total += sums @ sums.T / (L + 1)
    return total


def _sums_of_scores(Psi: Array, e: Array, L: int, begin: int, end: int) -> Array:
    """Return the sums of psi(s) e(s), s = t - L … t, for t from `begin` to before `end`."""
    first = begin - L - 1
    a, b = max(first + 1, 0), min(end, e.size)
    scores = np.zeros((Psi.shape[1], end - first))
    np.multiply(Psi[a:b].T, np.nan_to_num(e[a:b]), out=scores[:, a - first : b - first])
    upto = np.cumsum(scores, axis=1)
    return np.asarray(upto[:, L + 1 :] - upto[:, : -L - 1])
