"""Outliers of measured outputs (hampel), and the step of a converter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import treats_signals
from armrig.data.columns import Vector
from armrig.data.dataset import Dataset, Signals
from armrig.data.files.column_faults import rails_of
from armrig.data.treatment.wrong_samples import MOST, SAMPLES_PER_SPIKE, wrong_samples
from armrig.numerics.checks import require_integers, require_numbers
from armrig.numerics.polynomial import Array
from armrig.numerics.quantities import percent, plural
from armrig.numerics.rounding import rounding_std
from armrig.numerics.stretches import Mask

ENOUGH_NOISE = 0.32
"""Least noise (std in converter steps) for which the quantisation error is white.

The variance of the error is then step²/12. The theory requires a third of a step. The limit is a
little lower, because the noise is estimated with an error. B. Widrow, I. Kollár, *Quantization
Noise*, 2008, chapter 5: with Gaussian noise of this size, the first moments of the error differ
from the moments of uniform white noise by a few percent.
"""

_MOSTLY_AT_REST = 0.4  # share of unchanged samples from which the errors of rounding matter
FALSE_ALARM_PROBABILITY = 0.01  # of one or more outliers in a clean record
_MAX_LISTED_SAMPLES = 10


@treats_signals
def hampel(data: Signals, *, threshold: float | None = None, order: int | None = None) -> Signals:
    """Return the data with outliers of y marked missing.

    An ARX model of high order removes the dynamics, so a step of the input is not an outlier,
    however far y moves. A wrong y(t) appears in the residuals e(t) … e(t+n) with the pattern 1, a1
    … an. The size of the pattern in robust standard deviations is ::

        z(t) = x(t) / s,    x(t) = sum a_k e(t+k) / sqrt(sum a_k²),    s = 1.4826 median |x|

    The samples with the largest ``|z|`` are marked. For the rest of the search, these samples are
    set to the model's values. The errors of marked samples near each other are then estimated
    together. A sample with an insignificant error is unmarked. The returned data contain
    no interpolated value. If the noise grows with u or y, s is the value at the same level. The
    first n samples after the start or a gap are searched in the reversed data, with twice the
    threshold. No outlier can be found among samples at a limit of y (a saturated sensor), or in n
    or fewer consecutive samples between two gaps.

    Parameters
    ----------
    data : Dataset or Signals
        N samples. The experiments are searched separately, but with the same model and the same s.
        Each output of Signals is searched with a model that contains all inputs.
    threshold : float, optional
        Least ``|z|`` of an outlier. With the default, N normally distributed residuals are all
        below the threshold with a probability of 99 %. The default is 4.6 for N = 3000.
    order : int, optional
        Order n; by default 20, or N/10 if there are fewer than 200 samples.

    Returns
    -------
    Dataset or Signals
        N samples. `valid` is False at outliers; `history` contains the indices of the first ten.

    Raises
    ------
    ValueError
        There are too few samples, or more than a tenth of the samples would be outliers.

    References
    ----------
    .. [1] F. R. Hampel, J. Amer. Statist. Assoc. 69 (1974) 383-393.
    .. [2] I. Chang, G. C. Tiao, C. Chen, Technometrics 30 (1988) 193-204 (additive outliers).

    Examples
    --------
    >>> import numpy as np
    >>> data = armrig.example_recording().dataset("alpha")
    >>> y = data.y.copy()
    >>> y[100] += 1.0  # a wrong sample
    >>> found = armrig.hampel(data.replaced(step=None, y=y))
    >>> np.flatnonzero(~found.valid)
    array([100])
    """
    valid, steps = data.valid.copy(), []
    for i, name in enumerate(data.outputs):
        judged = data.valid.copy()
        if valid[:, i].any():
            judged[:, i] &= ~rails_of(data.y[:, i])[0]  # a linear model does not stop at a rail
        parts = [(p.u, p.y[:, i]) for p in data.replaced(step=None, valid=judged).experiments()]
        wrong, step = _outliers(parts, name, threshold, order)
        valid[:, i] &= ~wrong
        steps.append(step)
    return data.replaced(step=None, valid=valid, history=(*data.history, *steps))


def _outliers(
    parts: Sequence[tuple[Array, Vector]], name: str, threshold: float | None, order: int | None
) -> tuple[Mask, str]:
    """Return a mask of the outliers of an output, and a step for the history."""
    from scipy.special import ndtri

    count = sum(int(np.count_nonzero(np.isfinite(y))) for _, y in parts)
    n = max(min(20, count // 10), 1) if order is None else order
    require_integers(order=(n, 1))
    if count < 5 * n + 10:
        raise InputError(
            f"{plural(count, 'sample is', 'samples are')} too few to find outliers with order={n}; "
            f"{5 * n + 10} are needed: lower the order"
        )
    limit = float(-ndtri(FALSE_ALARM_PROBABILITY / (2 * count))) if threshold is None else threshold
    require_numbers(threshold=limit)
    if not limit > 0:
        raise InputError(f"threshold={threshold!r} must be > 0, in robust standard deviations")
    levels, counts = np.unique(
        np.concatenate([y[np.isfinite(y)] for _, y in parts]), return_counts=True
    )
    if levels.size == 2 and counts.min() > max(1, count // SAMPLES_PER_SPIKE):
        wrong = np.zeros(sum(y.size for _, y in parts), dtype=np.bool_)  # a relay's samples
    else:
        wrong = np.concatenate(wrong_samples(parts, n, limit))
    samples = np.flatnonzero(wrong)
    if samples.size > MOST * count:
        raise InputError(
            f"{samples.size} of {count} samples would be outliers at threshold={limit:.2f}, "
            "which is too many for outliers; plot the data, or raise the threshold"
        )
    where = ", ".join(map(str, samples[:_MAX_LISTED_SAMPLES]))
    where += ", …" if samples.size > _MAX_LISTED_SAMPLES else ""
    step = f"marked {samples.size} of {count} samples of {name} missing as outliers"
    step += f" (samples {where})" if samples.size else ""
    step += f": beyond {limit:.2f} robust standard deviations in the residuals of an ARX model of "
    return wrong, f"{step}order {n}"


def quantum(data: Dataset) -> float:
    """Return the quantisation step of y; 0 if changes of y are not whole multiples of one step."""
    change = np.abs(np.diff(data.y))
    change = change[np.isfinite(change)]
    moved = change[change > rounding_std(data.y)]
    if moved.size < 10:
        return 0.0
    step = float(moved.min())
    multiple = moved / step
    off = np.abs(multiple - np.round(multiple)) > 1e-4 * np.maximum(multiple, 1.0)
    return 0.0 if np.mean(off) > 1e-3 else step


def too_quiet(data: Dataset, noise_variance: float) -> str:
    """Return a warning if y rests, with noise below a third of a quantisation step; else "".

    The errors of rounding are then equal while y rests. With such steps of y in 1500 samples, the
    errors of a gain were 1.3 to 3.4 times its reported deviation (five converters, four inputs, 20
    records each). Of a moving y they are as good as white.
    """
    step, y = quantum(data), data.y[np.isfinite(data.y)]
    noise = float(np.sqrt(max(noise_variance - step**2 / 12, 0.0)))
    at_rest = float(np.mean(np.diff(y) == 0)) if y.size > 1 else 0.0
    if step == 0 or noise >= ENOUGH_NOISE * step or at_rest < _MOSTLY_AT_REST:
        return ""
    return (
        f"{data.output} rests in {percent(100 * at_rest)} of the samples, and its noise is "
        f"{noise / step:.2f} of the converter's step, less than a third. The rounding errors at "
        "rest are equal, so the standard deviations may be three times too small"
    )
