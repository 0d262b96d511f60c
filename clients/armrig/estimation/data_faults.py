"""What in the data spoils an estimate from them, seen in its residuals: wrong samples, an offset.

An estimate by least squares follows a few large errors as willingly as thousands of small ones, and
a level of y that no input makes as if it were an answer to the input. The first look costs next to
nothing; only where it raises doubt a model of high order is fitted, which takes the dynamics out
whatever the structure of the estimate is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.data.finding import EstimateFinding, warning
from armrig.data.treatment import INTEGRATING_OUTPUTS, hampel, integrating
from armrig.data.treatment.whitening import whitening
from armrig.numerics.quantities import percent, plural
from armrig.numerics.whiteness import WHITE_LEVEL, joined, ljung_box

Vector = NDArray[np.float64]

NO_OPTION = "remove the means, armrig.detrend(data), or take an estimator with offset=True"
"""Way out of an offset for an estimator that cannot estimate it along."""

_MAD_TO_STD = 1.4826  # of a normal distribution
_FAR = 10.0  # robust standard deviations beyond which normal residuals never are
_SHARE = 0.2  # of the sum of squares, from which those beyond decide the estimate
_TWO_LEVELS = 2
_FEWEST = 50  # residuals, to tell what is far
_LISTED = 5
_LAGS = 10  # that coloured residuals are looked for at
_ORDER = 12  # of the model that an offset is looked for with, where there are samples enough
_PART = 10_000  # samples that it is estimated from: an offset that matters shows in them
_MANY = 1000.0  # standard deviations, beyond which their number says nothing
_ROUNDING = 1e-9  # share of y's largest value, below which nothing is a level
_SURE = 4.0  # standard deviations: 6 of 100 000 estimates without an offset


def data_faults(
    data: Dataset, residuals: Sequence[Vector], *, way_out: str
) -> Iterator[EstimateFinding]:
    """Yield a warning for each fault of the data that the estimate suffers from.

    Parameters
    ----------
    residuals : sequence of ndarray (N_i,)
        Of each experiment, NaN where they are not known.
    way_out : str
        What to do about an offset, "" where one was estimated along.
    """
    yield from swapped(data)
    e = np.concatenate(residuals)
    e = e[np.isfinite(e)]
    if e.size < _FEWEST:
        return
    yield from _wrong_samples(data, e)
    if way_out and data.output not in INTEGRATING_OUTPUTS and _doubtful(residuals):
        level = level_without_input(data)
        if level and not integrating(data):
            yield replace(level, text=f"{level.text}, which the model cannot make: {way_out}")


def swapped(data: Dataset) -> Iterator[EstimateFinding]:
    """Yield a warning where y looks like an input, and u like what answers it."""
    y = data.y[data.valid]
    if np.unique(y).size == _TWO_LEVELS and np.unique(data.u).size > max(_FEWEST, y.size // 4):
        yield warning(
            "swapped",
            f"{data.output} has two levels and u many, as if they were swapped: the input is what "
            "was played, the output what was measured",
        )


def undetermined(data: Dataset) -> str:
    """Return why data do not determine the parameters asked for, and what to do."""
    for name, x in (("u", data.u), (data.output, data.y[data.valid])):
        if x.size and np.ptp(x) == 0:
            return f"{name} is {x[0]:.4g} throughout: give the column that varies, or record again"
    if np.array_equal(data.u, data.y):
        return f"{data.output} has the very numbers of u: give the column of the output"
    return "lower the orders or excite with a richer input"


def _wrong_samples(data: Dataset, e: Vector) -> Iterator[EstimateFinding]:
    """Yield a warning where few samples make much of the loss, and neighbours deny them."""
    size = np.abs(e)
    far = size > _FAR * _MAD_TO_STD * float(np.median(size))
    share = float(np.sum(e[far] ** 2)) / max(float(e @ e), 1e-300)
    if share < _SHARE:
        return
    try:
        found = hampel(data)
    except ValueError:
        return
    wrong = np.flatnonzero(data.valid & ~found.valid)
    if not wrong.size:
        return
    where = ", ".join(map(str, wrong[:_LISTED])) + (", …" if wrong.size > _LISTED else "")
    yield warning(
        "outliers",
        f"{plural(wrong.size, 'sample')} of {data.output} look wrong ({where}) and make "
        f"{percent(100 * share)} of the squared residuals: the model follows them; estimate from "
        "armrig.hampel(data), which marks them missing",
        count=wrong.size,
        share=share,
    )


def _doubtful(residuals: Sequence[Vector]) -> bool:
    """Tell whether the residuals are coloured, or have a mean."""
    e = joined(residuals, _LAGS)
    if ljung_box(e, _LAGS) < WHITE_LEVEL:
        return True
    e = e[np.isfinite(e)]
    return abs(float(np.mean(e))) > _SURE * float(np.std(e)) / sqrt(e.size)


def level_without_input(data: Dataset, least: float = _SURE) -> EstimateFinding | None:
    """Return what y is where u is 0, or None where that is within so many σ of 0.

    The model A(q) y(t) = B(q) u(t) + c + e(t) then has a constant c; y is c / A(1) where u is 0,
    and no state at the beginning explains it for long.
    """
    parts = [(part.u, part.y) for part in data[:_PART].experiments()]
    n = min(_ORDER, (data.N - data.missing) // 10)
    if n < 1:
        return None
    model = whitening(parts, n)
    std = float(np.sqrt(model.covariance[2 * n + 1, 2 * n + 1]))
    gain = float(np.sum(model.A))
    largest = float(np.max(np.abs(data.y[data.valid])))
    if not (std > 0 and gain > 0 and abs(model.c) > max(least * std, _ROUNDING * largest)):
        return None
    unit = f" {data.unit}" if data.unit else ""
    sigmas = min(abs(model.c) / std, _MANY)
    return warning(
        "level",
        f"{data.output} is about {model.c / gain:.3g}{unit} where u is 0 ({sigmas:.0f} standard "
        f"deviations {'or more ' if sigmas == _MANY else ''}from 0)",
        level=model.c / gain,
        sigmas=sigmas,
    )
