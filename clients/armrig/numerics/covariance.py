"""Covariance of the noise of several outputs, and covariance of the score for the sandwich form.

The covariance of an estimate is W W^T M W W^T. Here W W^T = (Psi^T Psi)^-1, and M is the covariance
of the score Psi^T e. For white residuals the sandwich form tends to the classic form,
lambda (Psi^T Psi)^-1.

There is one Psi (N_i, d) and one e (N_i,) for each experiment, in `blocks` and `residuals`. If y is
missing, the row of Psi is 0 and e is NaN.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from armrig.numerics.polynomial import Array

Autoregression = tuple[Array, float]
"""C of the autoregression C e = white noise, and the variance of the white noise."""
_FILTER_ROWS = 1 << 16  # rows filtered at once, so that the memory does not grow with the data
_SUM_ROWS = 1 << 11  # rows summed at once
_MIN_WHITENED = 30  # least number of errors from which the correlation of outputs is estimated


def pairwise_covariance(e: Array) -> Array:
    """Return the positive definite covariance of e (N, ny) about 0; a missing value is NaN."""
    measured = np.isfinite(e)
    x, mark = np.where(measured, e, 0.0), measured.astype(np.float64)
    pairs = np.maximum(mark.T @ mark, 1.0)
    covariance = (x.T @ x) / pairs
    std = np.sqrt(np.diag(covariance))
    if not (std > 0).all():
        return np.diag(np.maximum(std, 1e-150) ** 2)
    values, axes = np.linalg.eigh(covariance / np.outer(std, std))
    # The missing samples differ between pairs of outputs, so the estimate can be indefinite.
    inside = (axes * np.maximum(values, 1e-8)) @ axes.T
    return np.asarray(inside * np.outer(std, std))


def exogenous_score(blocks: Sequence[Array], noise: Autoregression) -> Array:
    """Return M = Psi^T R Psi for a Psi that does not depend on the noise (output error).

    R is the covariance matrix of the noise. With R = s² H H^T, M is s² (H^T Psi)^T (H^T Psi). H^T
    Psi is computed by filtering Psi backwards in time. For white noise the order is 0, and the
    sandwich form equals the classic form.

    References
    ----------
    .. [1] T. Söderström, P. Stoica, *System Identification*, 1989, section 7.5 and C7.7.
    .. [2] W. J. den Haan, A. Levin, "A practitioner's guide to robust covariance matrix
       estimation", Handbook of Statistics 15, 1997 (the autoregressive estimate).
    """
    # Lists, not generators: a generator inside the comprehension would use only the last Psi.
    backward_blocks = [
        [Psi[max(b - _FILTER_ROWS, 0) : b] for b in range(len(Psi), 0, -_FILTER_ROWS)]
        for Psi in blocks
    ]
    return exogenous_score_in_blocks(backward_blocks, noise, blocks[0].shape[1])


def exogenous_score_in_blocks(
    experiments: Iterable[Iterable[Array]], noise: Autoregression, d: int
) -> Array:
    """Return `exogenous_score` for Psi in blocks of rows (n, d), the last block first."""
    from scipy.signal import lfilter

    C, s2 = noise
    total = np.zeros((d, d))
    for blocks in experiments:
        state = np.zeros((d, C.size - 1))
        for block in blocks:
            scores = block.T
            if C.size > 1:
                scores, state = lfilter([1.0], C, scores[:, ::-1], zi=state)
            total += s2 * (scores @ scores.T)
    return total


def joint_exogenous_score(
    H: Sequence[Sequence[Array]],
    e: Sequence[Sequence[Array]],
    noise: Sequence[Autoregression],
) -> Array:
    """Return the covariance of the sum of H_i(t) e_i(t) over t and outputs i.

    H and e have one array for each experiment and output. `noise` contains the autoregression of
    each output; the errors of the autoregressions are correlated at the same instant. H must not
    depend on the noise. For one output the result is `exogenous_score`.
    """
    from scipy.signal import lfilter

    ny = len(e[0])
    if ny == 1:
        return exogenous_score([h for (h,) in H], *noise)
    models, variances = zip(*noise, strict=True)
    # A value that depends on a missing sample is NaN.
    white = [
        np.column_stack(
            [np.convolve(x, C)[: x.size] for x, C in zip(experiment, models, strict=True)]
        )
        for experiment in e
    ]
    finite = np.isfinite(np.vstack(white))
    if np.min(finite.T.astype(int) @ finite) < _MIN_WHITENED:
        # Missing samples leave too few errors of the autoregressions.
        white = [np.column_stack(experiment) for experiment in e]
    Sigma = pairwise_covariance(np.vstack(white))
    Sigma *= np.sqrt(np.outer(variances, variances) / np.outer(np.diag(Sigma), np.diag(Sigma)))
    total = np.zeros((H[0][0].shape[1],) * 2)
    for experiment in H:
        back = [
            lfilter([1.0], C, h[::-1], axis=0) if C.size > 1 else h[::-1]
            for h, C in zip(experiment, models, strict=True)
        ]
        for i in range(ny):
            for k in range(ny):
                total += Sigma[i, k] * (back[i].T @ back[k])
    return total


def joint_score(
    H: Sequence[Sequence[Array]], e: Sequence[Sequence[Array]], *, parameters: int
) -> Array:
    """Return the covariance of the sum of H_i(t) e_i(t), for e_i that are correlated at all lags.

    H and e have one array for each experiment and signal. H must not depend on the noise. The
    covariances of the signals are estimated up to a lag of 4 sqrt(N), with Parzen's window, and
    corrected for the fitted `parameters`.

    References
    ----------
    .. [1] P. Stoica, R. Moses, *Spectral Analysis of Signals*, 2005, section 2.5.
    """
    N = sum(experiment[0].size for experiment in e)
    lags = int(4 * np.sqrt(N))
    size = 1 << (max(experiment[0].size for experiment in e) + lags).bit_length()
    signals = [np.fft.rfft(np.nan_to_num(np.array(experiment)), size) for experiment in e]
    marks = [np.fft.rfft(np.isfinite(np.array(experiment)).astype(float), size) for experiment in e]
    k = np.minimum(np.arange(size), size - np.arange(size)) / lags
    window = np.where(k <= 0.5, 1 - 6 * k**2 * (1 - k), 2 * np.maximum(1 - k, 0.0) ** 3)
    total = np.zeros((H[0][0].shape[1],) * 2)
    for i, j in np.ndindex(len(e[0]), len(e[0])):
        products, pairs = (
            np.fft.irfft(sum(x[i] * np.conj(x[j]) for x in transforms), size)
            for transforms in (signals, marks)
        )
        spectrum = np.fft.rfft(window * products / np.maximum(pairs, 1.0))
        for experiment in H:
            after = spectrum[:, None] * np.fft.rfft(experiment[j], size, axis=0)
            total += experiment[i].T @ np.fft.irfft(after, size, axis=0)[: len(experiment[i])]
    return total * N / max(N - parameters, 1)


def newey_west_score(blocks: Sequence[Array], residuals: Sequence[Array]) -> Array:
    """Return M by Newey and West's method, for a Psi that depends on past noise (ARX).

    The Bartlett weights are 1 - k/(L + 1) up to the lag L = floor(4 (N/100)^(2/9)). The estimate is
    computed from all sums of L + 1 successive scores. M is the total of s s^T over all these sums
    s, divided by L + 1. The incomplete sums at both ends of the data are included.

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


def whitening(noise_covariance: Array, rows: Array) -> Array:
    """Return matrices G (N, ny, ny) so that G(t) e(t) is white with the identity as covariance.

    `rows` (N, ny) is False where an output is missing. G(t) is the inverse Cholesky factor of the
    covariance of the outputs measured at t, and 0 in the rows and columns of missing outputs.
    """
    N, ny = rows.shape
    if rows.all():
        factor = np.linalg.inv(np.linalg.cholesky(noise_covariance))
        return np.broadcast_to(factor, (N, ny, ny))
    G = np.zeros((N, ny, ny))
    for measured, times in patterns(rows):
        L = np.linalg.cholesky(noise_covariance[np.ix_(measured, measured)])
        factor = np.zeros((ny, ny))
        factor[np.ix_(measured, measured)] = np.linalg.inv(L)
        G[times] = factor
    return G


def colour_noise(rows: Array, white: Array, noise_covariance: Array) -> Array:
    """Return white values (N, ny, k) with the covariance of the outputs measured at `rows`.

    This is the inverse of `whitening`. Where an output is missing, the result is 0.
    """
    noise = np.zeros(white.shape)
    for o, times in patterns(rows):
        at = np.ix_(times, o)
        noise[at] = np.linalg.cholesky(noise_covariance[np.ix_(o, o)]) @ white[at]
    return noise


def patterns(rows: Array) -> Iterator[tuple[Array, Array]]:
    """Yield the outputs of each set that is measured at some instants, and these instants.

    `rows` (N, ny) is False where an output is missing. Instants without an output are left out.
    """
    bits = np.arange(rows.shape[1])
    codes = rows @ (1 << bits)
    for code in np.unique(codes[codes > 0]):
        yield np.flatnonzero(code >> bits & 1), np.flatnonzero(codes == code)


def spread(G: Array, blocks: Sequence[Array]) -> Array:
    """Return the whitened rows (ny N, k) of all outputs; each output has one block (N, k)."""
    ny = len(blocks)
    return np.vstack(
        [np.sum([G[:, i, j, None] * blocks[j] for j in range(ny)], axis=0) for i in range(ny)]
    )


def spread_apart(G: Array, blocks: Sequence[Array]) -> Array:
    """Return the whitened rows (ny N, sum of k_i); each output has its own columns (N, k_i)."""
    ny = len(blocks)
    return np.vstack(
        [np.hstack([G[:, i, j, None] * blocks[j] for j in range(ny)]) for i in range(ny)]
    )


def unspread(G: Array, M: Array) -> list[Array]:
    """Return the product G^T M as one block (N, k) for each output; M is (ny N, k)."""
    ny = G.shape[1]
    parts = np.split(M, ny)
    return [
        np.asarray(np.sum([G[:, i, j, None] * parts[i] for i in range(ny)], axis=0))
        for j in range(ny)
    ]
