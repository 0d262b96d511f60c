"""Warnings about faults of the data: wrong samples, an offset, swapped columns.

In least squares a few large errors have as much weight as thousands of small errors. A model
without an offset explains an offset of y as a response to the input. If the residuals are coloured
or their mean is not zero, an ARX model of high order is fitted to estimate the offset.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import exp, sqrt

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.columns import Vector, constancy
from armrig.data.dataset import Dataset, Signals
from armrig.data.files.column_faults import rows_of_each_value
from armrig.data.finding import Finding, warning
from armrig.data.treatment import hampel, integrates_by_name, integrating
from armrig.data.treatment.outliers import too_quiet
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.quantities import digits, join_names, percent, plural
from armrig.numerics.regressors import unique_whitening, whitening
from armrig.numerics.whiteness import WHITE_LEVEL, join_residuals, ljung_box

NO_OPTION = "remove the means (detrend), or take a structure with the option offset, such as OE"
"""Remedy for an offset if the estimator cannot estimate an offset."""
OFFSET_OF_TRANSIENT = (
    "the removed means contain a transient, so take a structure with the option offset, such as OE"
)
"""Remedy for an offset that remains after the means were removed."""

CONSTANT_INPUT = (
    "u is constant: gain and level cannot be distinguished; record a u that changes (step, "
    "telegraph, PRBS)"
)
"""Text for data whose u is constant in each experiment."""

_MAD_TO_STD = 1.4826  # ratio of the standard deviation to median |x| for a normal distribution
_OUTLIER_SIGMAS = 10.0  # Gaussian residuals never exceed this many robust std
_MIN_OUTLIER_SHARE = 0.2  # share of the sum of squares above which outliers dominate the estimate
_TWO_LEVELS = 2
_FEW_OUTLIERS, _INSTRUMENT_VALUES = 5, 3  # outliers, or values of outliers, that no state explains
_BEYOND = 0.5  # least distance of the values of an instrument from the others, in their range
_CLUSTERED, _FAR = 4.0, 1_000_000  # excess of outliers near others, in σ; distance beyond all data
_SINGLE_ORDER, _SINGLE_REST, _USUAL = 10, 0.1, 2.0  # largest rest: of the residuals, of the noise
_SMALL_REST, _UNUSUAL = 0.3, 3.3  # largest rest of both: a motion leaves more of the residuals
_MAX_TRIED, _MIN_SINGLE_SHARE = 50, 0.5  # outliers that are examined, and their share that is wrong
_STATE_LEVEL = 0.01  # of the tests whether outliers depend on the state
_MIN_RESIDUALS = 50  # least number of residuals for the check of outliers
_MAX_LISTED = 5
_COLOUR_LAGS = 10  # lags of the test of whiteness
_MAX_OFFSET_ORDER = 12  # order of the model that estimates an offset
_MAX_OFFSET_SAMPLES = 10_000  # enough samples to detect an offset that matters
_MAX_SHOWN_SIGMAS = 1000.0
_NEAR = 0.25  # share of the range beyond which a value is an extrapolation
_MIN_LEVEL_SIGMAS = 4.0  # if there is no offset, 6 of 100 000 estimates exceed this limit


def data_faults(data: Dataset, residuals: Sequence[Vector], *, way_out: str) -> Iterator[Finding]:
    """Yield a warning for each fault of the data that spoils the estimate.

    An unknown residual is NaN. `way_out` is the remedy for an offset, or "" if it is estimated.
    """
    yield from swap_warnings(data)
    if way_out and constant_input(data):
        yield warning("excitation", CONSTANT_INPUT)
    e = np.concatenate(residuals)
    e = e[np.isfinite(e)]
    if e.size < _MIN_RESIDUALS:
        return
    yield from _wrong_samples(data, e)
    if text := too_quiet(data, float(np.mean(e**2))):
        yield warning("converter", text)
    if way_out and _doubtful(residuals) and not integrates_by_name(data.output):
        level = level_without_input(data)
        if level and not integrating(data):
            if data.trends:
                way_out = OFFSET_OF_TRANSIENT
            yield replace(level, text=f"{level.text}, which the model cannot represent: {way_out}")


def swap_warnings(data: Dataset) -> Iterator[Finding]:
    """Yield a warning if y looks like an input and u like its response."""
    y = data.y[data.valid]
    if np.unique(y).size == _TWO_LEVELS and np.unique(data.u).size > max(
        _MIN_RESIDUALS, y.size // 4
    ):
        yield warning(
            "swapped",
            f"{data.output} has two levels and {data.input} has many, so the columns may be "
            "swapped: the input is the played signal, and the output is the measured signal",
        )


def constant_input(data: Dataset) -> bool:
    """Return whether u is constant in each experiment."""
    return all(np.ptp(part.u) == 0 for part in data.experiments())


def require_moving_output(data: Dataset | Signals) -> None:
    """Refuse an output that is constant, because nothing can be tested or estimated in it."""
    signals = data.signals()
    for name, y in zip(signals.outputs, signals.y.T, strict=True):
        if text := constancy(name, y):
            raise InputError(text)


def require_no_copies(data: Dataset) -> None:
    """Refuse data that contain each row, or the whole record, several times."""
    u, y = data.u, data.y
    if (rows := rows_of_each_value(y)) > 1:
        raise InputError(
            f"each value of {data.output} is in {plural(rows, 'row')}: if it was read less often "
            f"than the rows were written, keep one row of {rows}"
        )
    same = np.flatnonzero((y[2:] == y[0]) & (u[2:] == u[0])) + 2
    for k in same[same <= y.size // 2].tolist():
        if np.array_equal(u[k:], u[:-k]) and np.array_equal(y[k:], y[:-k], equal_nan=True):
            raise InputError(
                f"the data are the same again after {plural(k, 'row')}, so the repetition adds "
                "nothing: keep the rows before"
            )


def cause_of_indeterminacy(data: Dataset | Signals) -> str:
    """Return the cause of undetermined parameters, or a remedy if the cause is unknown."""
    if isinstance(data, Signals):
        return "lower the orders or excite with richer inputs"
    if data.trends and constant_input(data):
        return CONSTANT_INPUT
    for name, x in (("u", data.u), (data.output, data.y[data.valid])):
        if text := constancy(name, x):
            return text
    if np.array_equal(data.u, data.y):
        return f"{data.output} equals u: give the column of the output"
    return "lower the orders or excite with a richer input"


def _wrong_samples(data: Dataset, e: Vector) -> Iterator[Finding]:
    """Yield a warning if a few samples that differ from their neighbours dominate the loss."""
    size = np.abs(e)
    far = size > _OUTLIER_SIGMAS * _MAD_TO_STD * float(np.median(size))
    share = float(np.sum(e[far] ** 2)) / max(float(e @ e), 1e-300)
    if share < _MIN_OUTLIER_SHARE:
        return
    try:
        count, text = looking_wrong(data.signals())
    except ValueError:
        return
    if count:
        text += f" and make {percent(100 * share)} of the squared residuals: the model follows "
        text += "them; mark them missing (hampel)"
        yield warning("outliers", text, "outliers", count=count, share=share)


def looking_wrong(data: Signals, *, instrument: bool = False) -> tuple[int, str]:
    """Return the number of outliers of an output, and a text; raise the errors of `hampel`.

    The number is 0 if the outliers depend on the state of the rig. A nonlinear rig, or a
    disturbance, then differs from a linear model there, and the samples are right. With
    `instrument`, only values that an instrument gives count.
    """
    wrong = np.flatnonzero(data.valid & ~hampel(data).valid)
    if wrong.size and not _are_of_an_instrument(data, wrong):
        if instrument:
            return 0, ""
        alone = _distances(wrong) > _COLOUR_LAGS
        if wrong.size < _FEW_OUTLIERS:
            wrong = wrong[alone & _are_single(data, wrong, wrong)]
        elif _depend_on_the_state(data, wrong):
            return 0, ""
        elif alone.any():
            tried = wrong[alone][:: alone.sum() // _MAX_TRIED + 1]
            # After each step of a disturbance, such as another input, y moves for some time.
            if np.mean(_are_single(data, wrong, tried)) < _MIN_SINGLE_SHARE:
                return 0, ""
    where = ", ".join([*map(str, wrong[:_MAX_LISTED]), *["…"] * (wrong.size > _MAX_LISTED)])
    return wrong.size, f"{plural(wrong.size, 'sample')} of {data.outputs[0]} look wrong ({where})"


def _are_of_an_instrument(data: Signals, wrong: NDArray[np.intp]) -> bool:
    """Return whether a few values recur, such as -127, or are far beyond the other values."""
    values, others = data.y[wrong, 0], np.delete(data.y[:, 0], wrong)
    low, high = float(np.nanmin(others)), float(np.nanmax(others))
    beyond = np.maximum(values - high, low - values) > _BEYOND * (high - low)
    few = np.unique(values).size <= min(_INSTRUMENT_VALUES, wrong.size - 1)
    return bool(few or beyond.all())


def _depend_on_the_state(data: Signals, wrong: NDArray[np.intp]) -> bool:
    """Return whether outliers cluster, or are found at special values of the input or the output.

    A wrong sample is found at any time and in any state. Kolmogorov and Smirnov's test compares the
    values at the outliers with the other values.
    """
    from scipy.ndimage import maximum_filter1d
    from scipy.stats import ks_2samp

    y, right_samples = data.y[:, 0], np.setdiff1d(np.flatnonzero(data.valid), wrong)
    clustered = np.count_nonzero(_distances(wrong) <= _COLOUR_LAGS) / wrong.size
    by_chance = 1 - exp(-2 * _COLOUR_LAGS * wrong.size / data.N)
    if clustered > by_chance + _CLUSTERED * sqrt(by_chance * (1 - by_chance) / wrong.size):
        return True
    right = np.interp(np.arange(data.N), right_samples, y[right_samples])
    signals = [right, *data.u.T]
    moves = [np.abs(np.diff(x, prepend=x[0])) for x in signals]
    recent = [maximum_filter1d(x, _COLOUR_LAGS, origin=_COLOUR_LAGS // 2 - 1) for x in moves]
    states = [*signals, *(np.abs(x - np.median(x)) for x in signals), *recent]
    level = _STATE_LEVEL / len(states)
    return any(ks_2samp(x[wrong], x[right_samples]).pvalue < level for x in states)


def _are_single(
    data: Signals, wrong: NDArray[np.intp], tried: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Return whether each tried outlier is an error of its own sample, and no motion of the rig.

    An error b of y(t) makes b a_k of the residual k samples later. A motion makes other residuals.
    """
    y = np.where(data.valid[:, 0], data.y[:, 0], np.nan)
    right = y.copy()
    right[wrong] = np.nan
    n = max(min(_SINGLE_ORDER, data.N // 20), 1)
    model = whitening([(data.u, right)], n)
    all_errors = model.residuals(data.u, right)
    usual = (_MAD_TO_STD * float(np.nanmedian(np.abs(all_errors)))) ** 2
    single = np.zeros(tried.size, np.bool_)
    for i, t in enumerate(tried.tolist()):
        right[t] = y[t]
        e = model.residuals(data.u, right)[t : t + n + 1]
        right[t] = np.nan
        finite = np.isfinite(e)
        a, e = model.A[: e.size][finite], e[finite]
        sum_of_squares = float(e @ e)
        remainder = sum_of_squares - float(a @ e) ** 2 / max(float(a @ a), 1e-300)
        noise = e.size * usual
        both = min(_SMALL_REST * sum_of_squares, _UNUSUAL * noise)
        single[i] = remainder < max(_SINGLE_REST * sum_of_squares, _USUAL * noise, both)
    return single


def _distances(wrong: NDArray[np.intp]) -> NDArray[np.int_]:
    """Return the distance of each outlier to the nearest other one, in samples."""
    apart = np.diff(wrong, prepend=wrong[0] - _FAR, append=wrong[-1] + _FAR)
    return np.minimum(apart[:-1], apart[1:])


def _doubtful(residuals: Sequence[Vector]) -> bool:
    """Return whether the residuals are coloured or their mean is significantly different from 0."""
    e = join_residuals(residuals, _COLOUR_LAGS)
    if ljung_box(e, _COLOUR_LAGS) < WHITE_LEVEL:
        return True
    e = e[np.isfinite(e)]
    return abs(float(np.mean(e))) > _MIN_LEVEL_SIGMAS * float(np.std(e)) / sqrt(e.size)


def level_without_input(
    data: Dataset | Signals, least: float = _MIN_LEVEL_SIGMAS
) -> Finding | None:
    """Return a finding with the level of y at u = 0, or None if the level is within `least` σ of 0.

    The text states the level only if u and y come near it: otherwise it is an extrapolation.
    At u = 0 the level of one output in A(q) y(t) = B(q) u(t) + c + e(t) is c / A(1). The result is
    None if an input is constant from lag n on, because c and its gain then have the same effect.
    """
    data = data.signals()
    parts = [(part.u, part.y[:, 0]) for part in data[:_MAX_OFFSET_SAMPLES].experiments()]
    n = min(_MAX_OFFSET_ORDER, int(np.count_nonzero(data.valid)) // (5 * (1 + data.nu)))
    moves = [np.ptp(u[n:], axis=0) for u, _ in parts if len(u) > n]
    if n < 1 or not moves or not np.max(moves, axis=0).all():
        return None
    model = unique_whitening(parts, n)
    std = float(np.sqrt(model.covariance[-2, -2]))
    gain = model.at_1
    least = max(least, _MIN_LEVEL_SIGMAS) if model.exact else least
    if not (std > 0 and gain > 0 and not model.ambiguous and abs(model.c) > least * std):
        return None
    output, level = data.outputs[0], model.c / gain
    sigmas = min(abs(model.c) / std, _MAX_SHOWN_SIGMAS)
    more = f"{sigmas:.0f} standard deviations {'or more ' * (sigmas == _MAX_SHOWN_SIGMAS)}from 0"
    unit = f" {data.units[0]}" if data.units[0] else ""
    text = f"{output} is about {digits(level, 3)}{unit} at {' = '.join(data.inputs)} = 0 ({more})"
    if not (_is_near(level, data.y[data.valid]) and all(_is_near(0.0, u) for u in data.u.T)):
        text = f"a linear model from {join_names(data.inputs)} to {output} needs a level ({more})"
    return warning(
        "level",
        text,
        "level",
        level=model.c / gain,
        sigmas=sigmas,
    )


def _is_near(value: float, x: Vector) -> bool:
    """Return whether a value is in the range of x, or at most a quarter of the range beyond it."""
    low, high = float(np.min(x)), float(np.max(x))
    return abs(value - (low + high) / 2) <= (0.5 + _NEAR) * (high - low)


def require_informative(data: Signals) -> None:
    """Refuse constant signals, and inputs that are linear combinations of other inputs."""
    require_moving_output(data)
    for j, name in enumerate(data.inputs):
        if np.ptp(data.u[:, j]) == 0:
            raise InputError(
                f"{name} is always {data.u[0, j]:.4g}, so that its effect cannot be estimated; "
                "leave this input out, or record again"
            )
    rank = orthonormal(data.u - data.u.mean(axis=0)).rank
    if rank < data.nu:
        raise InputError(
            f"the {plural(data.nu, 'input has', 'inputs have')} rank {rank}: some are copies or "
            "sums of others, so that their effects cannot be separated; leave inputs out, or "
            "record with independent inputs"
        )
