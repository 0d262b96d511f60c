"""Warnings about faults of the data: wrong samples, an offset, swapped columns.

In least squares a few large errors have as much weight as thousands of small errors. A model
without an offset explains an offset of y as a response to the input. If the residuals are coloured
or their mean is not zero, an ARX model of high order is fitted to estimate the offset.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import sqrt

import numpy as np
from armrig_core.errors import InputError

from armrig.data.columns import Vector
from armrig.data.dataset import Dataset, Signals
from armrig.data.finding import Finding, warning
from armrig.data.treatment import hampel, integrating, known_to_integrate
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.quantities import percent, plural
from armrig.numerics.regressors import whitening
from armrig.numerics.whiteness import WHITE_LEVEL, joined, ljung_box

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
_MIN_RESIDUALS = 50  # least number of residuals for the check of outliers
_MAX_LISTED = 5
_COLOUR_LAGS = 10  # lags of the test of whiteness
_MAX_OFFSET_ORDER = 12  # order of the model that estimates an offset
_MAX_OFFSET_SAMPLES = 10_000  # enough samples to detect an offset that matters
_MAX_SHOWN_SIGMAS = 1000.0
_MIN_LEVEL_SHARE = 1e-9  # a level below this share of the largest |y| is a rounding error
_MIN_LEVEL_SIGMAS = 4.0  # if there is no offset, 6 of 100 000 estimates exceed this limit


def data_faults(data: Dataset, residuals: Sequence[Vector], *, way_out: str) -> Iterator[Finding]:
    """Yield a warning for each fault of the data that spoils the estimate.

    An unknown residual is NaN. `way_out` is the remedy for an offset, or "" if it is estimated.
    """
    yield from swapped(data)
    if way_out and constant_input(data):
        yield warning("excitation", CONSTANT_INPUT)
    e = np.concatenate(residuals)
    e = e[np.isfinite(e)]
    if e.size < _MIN_RESIDUALS:
        return
    yield from _wrong_samples(data, e)
    if way_out and _doubtful(residuals) and not known_to_integrate(data.output):
        level = level_without_input(data)
        if level and not integrating(data):
            if data.trends:
                way_out = OFFSET_OF_TRANSIENT
            yield replace(level, text=f"{level.text}, which the model cannot represent: {way_out}")


def swapped(data: Dataset) -> Iterator[Finding]:
    """Yield a warning if y looks like an input and u like its response."""
    y = data.y[data.valid]
    if np.unique(y).size == _TWO_LEVELS and np.unique(data.u).size > max(
        _MIN_RESIDUALS, y.size // 4
    ):
        yield warning(
            "swapped",
            f"{data.output} has two levels and u has many, so the columns may be swapped: the "
            "input is the played signal, and the output is the measured signal",
        )


def constant_input(data: Dataset) -> bool:
    """Return whether u is constant in each experiment."""
    return all(np.ptp(part.u) == 0 for part in data.experiments())


def undetermined(data: Dataset | Signals) -> str:
    """Return the cause of undetermined parameters, or a remedy if the cause is unknown."""
    if isinstance(data, Signals):
        return "lower the orders or excite with richer inputs"
    if data.trends and constant_input(data):
        return CONSTANT_INPUT
    for name, x in (("u", data.u), (data.output, data.y[data.valid])):
        if x.size and np.ptp(x) == 0:
            return f"{name} is always {x[0]:.4g}: give the column that varies, or record again"
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


def looking_wrong(data: Signals) -> tuple[int, str]:
    """Return the number of outliers of an output, and a text; raise the errors of `hampel`."""
    wrong = np.flatnonzero(data.valid & ~hampel(data).valid)
    where = ", ".join([*map(str, wrong[:_MAX_LISTED]), *["…"] * (wrong.size > _MAX_LISTED)])
    return wrong.size, f"{plural(wrong.size, 'sample')} of {data.outputs[0]} look wrong ({where})"


def _doubtful(residuals: Sequence[Vector]) -> bool:
    """Return whether the residuals are coloured or their mean is significantly different from 0."""
    e = joined(residuals, _COLOUR_LAGS)
    if ljung_box(e, _COLOUR_LAGS) < WHITE_LEVEL:
        return True
    e = e[np.isfinite(e)]
    return abs(float(np.mean(e))) > _MIN_LEVEL_SIGMAS * float(np.std(e)) / sqrt(e.size)


def level_without_input(
    data: Dataset | Signals, least: float = _MIN_LEVEL_SIGMAS
) -> Finding | None:
    """Return a finding with the level of y at u = 0, or None if the level is within `least` σ of 0.

    At u = 0 the level of one output in A(q) y(t) = B(q) u(t) + c + e(t) is c / A(1). The result is
    None if an input is constant from lag n on, because c and its gain then have the same effect.
    """
    data = data.signals()
    parts = [(part.u, part.y[:, 0]) for part in data[:_MAX_OFFSET_SAMPLES].experiments()]
    n = min(_MAX_OFFSET_ORDER, int(np.count_nonzero(data.valid)) // (5 * (1 + data.nu)))
    moves = [np.ptp(u[n:], axis=0) for u, _ in parts if len(u) > n]
    if n < 1 or not moves or not np.max(moves, axis=0).all():
        return None
    model = whitening(parts, n)
    std = float(np.sqrt(model.covariance[-2, -2]))
    gain = float(np.sum(model.A))
    largest = float(np.max(np.abs(data.y[data.valid])))
    if not (std > 0 and gain > 0 and abs(model.c) > max(least * std, _MIN_LEVEL_SHARE * largest)):
        return None
    unit = f" {data.units[0]}" if data.units[0] else ""
    sigmas = min(abs(model.c) / std, _MAX_SHOWN_SIGMAS)
    return warning(
        "level",
        f"{data.outputs[0]} is about {model.c / gain:.3g}{unit} at u = 0 ({sigmas:.0f} standard "
        f"deviations {'or more ' if sigmas == _MAX_SHOWN_SIGMAS else ''}from 0)",
        "level",
        level=model.c / gain,
        sigmas=sigmas,
    )


def require_informative(data: Signals) -> None:
    """Refuse constant signals, and inputs that are linear combinations of other inputs."""
    for i, name in enumerate(data.outputs):
        y = data.y[data.valid[:, i], i]
        if np.ptp(y) == 0:
            raise InputError(
                f"{name} is always {y[0]:.4g}, so that it has no model; leave this output out, or "
                "record it again"
            )
    for j, name in enumerate(data.inputs):
        if np.ptp(data.u[:, j]) == 0:
            raise InputError(
                f"{name} is always {data.u[0, j]:.4g}, so that its effect cannot be estimated; "
                "leave this input out, or record again"
            )
    rank = orthonormal(data.u - data.u.mean(axis=0)).rank
    if rank < data.nu:
        raise InputError(
            f"the {data.nu} inputs have rank {rank}: some are copies or sums of others, so that "
            "their effects cannot be separated; leave inputs out, or record with independent "
            "inputs"
        )
