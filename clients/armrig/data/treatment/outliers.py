"""Single wrong samples, found where a model did not foresee them."""

from __future__ import annotations

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.treatment.wrong_samples import MOST, wrong_samples
from armrig.numerics.checks import require_integers, require_numbers

_FALSE_ALARM = 0.01  # chance of one or more in a clean record
_LISTED = 10


@takes_recordings
def hampel(data: Dataset, *, threshold: float | None = None, order: int | None = None) -> Dataset:
    """Return the data with outliers of y marked missing.

    An ARX model of high order takes the dynamics out: a step of the input is no outlier, however
    far y moves. A wrong y(t) shows in the residuals e(t) … e(t+n) with the pattern 1, a1 … an, and
    its size in robust standard deviations is ::

        z(t) = x(t) / s,    x(t) = sum a_k e(t+k) / sqrt(sum a_k²),    s = 1.4826 median |x|

    The largest |z| are marked, set to what the model expects (for this search alone), and the
    search goes on; those that their neighbours explain are let go. Nothing is interpolated in the
    data returned. The first n samples after the start or a gap are searched in the reversed data,
    for outliers of twice the size. In a stretch of n samples or fewer no outlier shows.

    Parameters
    ----------
    data : Dataset
        N samples; each experiment is searched by itself, with one model and one s for all.
    threshold : float, optional
        Least |z| of an outlier; by default the one that N normal residuals stay below with a
        chance of 99 % (4.6 for 3000).
    order : int, optional
        n, by default 20, or a tenth of the samples where they are fewer than 200.

    Returns
    -------
    Dataset
        N samples, the outliers with `valid` False, and in `history` which they were.

    Raises
    ------
    ValueError
        There are too few samples, or a tenth of them would be outliers.

    References
    ----------
    .. [1] F. R. Hampel, J. Amer. Statist. Assoc. 69 (1974) 383-393.
    .. [2] I. Chang, G. C. Tiao, C. Chen, Technometrics 30 (1988) 193-204 (additive outliers).
    """
    from scipy.special import ndtri

    count = data.N - data.missing
    n = max(min(20, count // 10), 1) if order is None else order
    require_integers(order=(n, 1))
    if count < 5 * n + 10:
        raise InputError(
            f"{count} samples are too few to find outliers with order={n}; "
            f"{5 * n + 10} are needed: lower the order"
        )
    limit = float(-ndtri(_FALSE_ALARM / (2 * count))) if threshold is None else threshold
    require_numbers(threshold=limit)
    if not limit > 0:
        raise InputError(f"threshold={threshold!r} must be > 0, in robust standard deviations")
    wrong = np.concatenate(wrong_samples([(d.u, d.y) for d in data.experiments()], n, limit))
    found = np.flatnonzero(wrong)
    if found.size > MOST * count:
        raise InputError(
            f"{found.size} of {count} samples would be outliers at threshold={limit:.2f}: that "
            "is another process, not outliers; plot the data, or raise the threshold"
        )
    where = ", ".join(map(str, found[:_LISTED])) + (", …" if found.size > _LISTED else "")
    return data.replaced(
        valid=data.valid & ~wrong,
        step=f"marked {found.size} of {count} samples of {data.output} missing as outliers"
        f"{f' (samples {where})' if found.size else ''}: beyond {limit:.2f} robust standard "
        f"deviations in the residuals of an ARX model of order {n}",
    )
