"""How many samples pass before the input acts (handout, assignment 3.8)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, sqrt

import numpy as np
from armrig_core.errors import InputError
from armrig_core.telemetry import ALPHA, THETA_1
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.quantisation import quantum
from armrig.estimation.nonparametric.impulse import ImpulseResponse, impulse_response
from armrig.estimation.nonparametric.integrator import integration
from armrig.numerics.least_squares import column_norms, triangle
from armrig.numerics.quantities import plural
from armrig.numerics.regressors import in_blocks
from armrig.validation.feedback_and_delay.delay_result import Delay
from armrig.validation.feedback_and_delay.lag_tests import (
    MOST_COEFFICIENTS,
    MOST_LAGS,
    LagTests,
    lag_tests,
)
from armrig.validation.feedback_and_delay.open_loop import open_loop
from armrig.validation.feedback_and_delay.smooth_onset import SURPRISING, possible, smooth_onsets

Vector = NDArray[np.float64]

SECOND_ORDER = frozenset({THETA_1, ALPHA})
"""Outputs whose second derivative is what a step of the voltage changes first."""
_FEWEST = 50  # samples
_FAR = 3  # lags past nk to which losses are kept
_FEW_CHANGES = 10  # of u, up to which an error of quantisation does not average out
Matrix = NDArray[np.float64]

_OWN = 0.005  # share of a lag of u that those before it must leave
_POOREST = 28  # lags of their own, what a PRBS of period 31 has; few sines have fewer
_BLOCK = 4096  # rows decomposed at once: they stay in the cache


@takes_recordings
def delay(data: Dataset, *, integrator: bool | None = None) -> Delay:
    """Find the first lag at which u acts: the first that a model cannot do without.

    In an ARX model with lags of u from 0 on, its orders by AIC, the hypothesis that u acts at none
    of the lags 0 … k is tested for each k (`lag_tests`) ::

        H_k: b_0 = … = b_k = 0,      F test, level 0.1 %

    and u acts at the first k that is rejected, at the latest. A coefficient that is not significant
    may only be too small to see, so an earlier lag is ruled out by its size: a first coefficient is
    at least 1/(1 + 3 n) of the one n samples later, the slowest onset of a mechanical rig (t²/2
    under a hold) having 1/(1 + 2 n), or, where the data begin more slowly, as small as an onset
    (t/Ts)^d makes it whose d is that of their first lags (a plant of relative degree d begins
    1 : 2^d - 1); the data must exclude so large a one (0.1 %, one-sided).
    Where that leaves several lags and y is an angle, or integrates, the shape of the onset decides
    (`smooth_onsets`).

    nk is the least lag that is not ruled out, so that no delay is claimed that is not shown; a
    direct term, nk = 0, is claimed only where lag 0 itself is shown. Where `open_loop` finds
    feedback, lag 0 would show the controller's answer: then the model begins at lag 1, and the
    interval at 0 where a direct term looks the same.

    Parameters
    ----------
    data : Dataset
        N samples of an input that excites, at least 50; missing ones and several experiments are
        allowed.
    integrator : bool, optional
        Whether y integrates; by default so for theta_1 and another y that behaves so, which the
        result then says.

    Returns
    -------
    Delay
        .nk, .delay = nk - 1, .told, .interval, .p_values, .explain(), .plot().

    Raises
    ------
    ValueError
        There are too few samples, u does not excite, or it acts at no lag that can be seen.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 16.4 and 16.5.
    .. [2] S. Björklund, *A Survey and Comparison of Time-Delay Estimation Methods in Linear
       Systems*, Linköping, 2003, chapters 5 and 6.
    """
    samples = _enough(data)
    decided = integration(data, integrator)
    longest = max(part.N for part in data.experiments())
    determined = determined_lags(data, min(MOST_COEFFICIENTS, samples // 3, longest // 2))
    # A, with 20 coefficients beside the 50 lags, has its share of what u determines.
    n = min(MOST_LAGS, samples // 10, 5 * determined // 7)
    response = impulse_response(data, n, kernel=None, integrator=decided.integrates)
    tests = lag_tests(data, response, determined)
    zero = None if tests.shown else _lag_zero(data)
    if zero is not None and zero.controller:
        later = lag_tests(data, response, determined, first=1)
        tests = tests if zero.rig and later.none_shown else later
    if tests.none_shown:
        raise InputError(
            f"{data.output} shows no answer to u that can be told from noise: record longer, "
            "or with a larger input"
        )
    first, shown = tests.first, tests.shown
    onset = _onset(data, tests, integrates=decided.integrates)
    read = _readings(data, response, onset.first)
    low, remarks = _hidden_by_steps(onset, read, data.Ts)
    either = zero is not None and zero.rig and bool(zero.remark)
    return Delay(
        nk=1 if either and first else max(low, min(1, onset.last)),
        interval=(0 if either else low, onset.last),
        may_be_feedback=either,
        p_values={k: float(tests.p_values[k - first]) for k in range(first, shown + 1)},
        before=tests.before(shown - 1) if shown > first else None,
        misfit=onset.misfit,
        arx_loss={k: float(v) for k, v in enumerate(tests.loss[: shown - first + _FAR + 1], first)},
        response=response,
        integrator=decided.integrates,
        na=tests.na,
        quantum=read.quantum,
        remarks=(*decided.notes, *([zero.remark] if zero and zero.remark else []), *remarks),
        output=data.output,
        Ts=data.Ts,
        unit=data.unit,
        input_unit=data.input_unit,
        source=data.source,
        t_q=read.t_q,
        largest_step=read.largest_step,
        acceleration=read.acceleration,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _LagZero:
    """What lag 0 shows, where it shows anything: the rig's direct term, or a controller."""

    rig: bool
    """It may be the rig's."""
    controller: bool
    """It may be the controller's, whose u(t) depends on y(t)."""
    remark: str = ""
    """Which, and why; "" where nothing speaks of feedback."""


def _lag_zero(data: Dataset) -> _LagZero:
    try:
        loop = open_loop(data)
    except ValueError:
        return _LagZero(rig=True, controller=False)
    if not loop.feedback:
        return _LagZero(rig=True, controller=False)
    if loop.exact:
        msg = f"u(t) is a multiple of {data.output}(t) in every sample, as under a P controller "
        msg += "whose set point rests: such data do not tell when the rig answers; move the set "
        raise InputError(msg + "point")
    if not loop.may_be_direct_term or data.output in SECOND_ORDER:
        return _LagZero(
            rig=False,
            controller=True,
            remark=f"there is feedback: u(t) answers to {data.output}(t), which would look as a "
            "direct term, so the lags from 1 on were tested",
        )
    return _LagZero(
        rig=True,
        controller=not loop.few_levels,
        remark="feedback looks the same as a direct term: if y was read before u was applied, nk "
        "is 1 or more, and a controller made u of y",
    )


def _enough(data: Dataset) -> int:
    """Return how many samples came, or refuse too few."""
    samples = data.N - data.missing
    if samples < _FEWEST:
        raise InputError(
            f"{samples} samples came, the test for a delay needs at least {_FEWEST}: record longer"
        )
    return samples


@dataclass(frozen=True, slots=True, kw_only=True)
class _Onset:
    """Where u acts first, as far as the data tell."""

    first: int
    """The least lag that is not ruled out."""
    last: int
    """The greatest."""
    misfit: dict[int, float]
    """By first lag of a smooth onset, where its shape was asked."""


def _onset(data: Dataset, tests: LagTests, *, integrates: bool) -> _Onset:
    first, last = tests.least(), tests.shown
    angle = data.output in SECOND_ORDER
    if first == last or not (angle or integrates):
        return _Onset(first=first, last=last, misfit={})
    misfit = smooth_onsets(data, first, last, integrator=integrates)
    if not angle and min(misfit.values()) > SURPRISING:
        return _Onset(first=first, last=last, misfit={})  # it is no smooth onset
    first, last = possible(misfit)
    return _Onset(first=first, last=last, misfit=misfit)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Readings:
    """In which steps y was read, and how long one of them hides the answer to u."""

    quantum: float
    """LSB, in y's unit; 0 where none is seen."""
    largest_step: float
    """|Δu|, in u's unit."""
    changes: int
    """Times that u changes."""
    acceleration: float
    """b, what y's second derivative is just after a unit step of u."""
    t_q: float | None
    """sqrt(2 LSB / (b |Δu|)) in s; None where y is not read in steps."""


def _readings(data: Dataset, response: ImpulseResponse, first: int) -> _Readings:
    """Return b of y = b |Δu| t²/2 from the sample at which that first exceeds LSB."""
    step, moves = quantum(data), np.abs(np.diff(data.u))
    change = float(np.max(moves, initial=0.0))
    rise = np.abs(np.cumsum(response.g[first:])) * change
    beyond = np.flatnonzero(rise >= step)
    at = int(beyond[0]) if beyond.size else rise.size - 1
    b = 2 * float(rise[at]) / (change * ((at + 1) * data.Ts) ** 2)
    hidden = sqrt(2 * step / (b * change)) if step * b * change > 0 else None
    return _Readings(
        quantum=step,
        largest_step=change,
        changes=int(np.count_nonzero(moves)),
        acceleration=b,
        t_q=hidden if data.output in SECOND_ORDER else None,
    )


def _hidden_by_steps(onset: _Onset, read: _Readings, Ts: float) -> tuple[int, list[str]]:
    """Return the least nk that is not ruled out, and a remark where quantisation makes it less."""
    if read.t_q is None or read.changes >= _FEW_CHANGES or onset.last <= 1:
        return onset.first, []
    hidden = ceil(read.t_q / Ts)
    return min(onset.first, max(onset.last - hidden, 1)), [
        f"u changes {plural(read.changes, 'time')} only, which does not excite enough to tell a "
        f"delay from the first {hidden} samples that quantisation hides"
    ]


def determined_lags(data: Dataset, most: int) -> int:
    """Return how many successive lags of u each have a share of their own, `most` at most.

    That of a lag is what those before it leave, sqrt(1 - R²) of its regression on them.

    Raises
    ------
    ValueError
        They are so few that u has power in a narrow band only: it follows from its own past, and
        what the model lacks far away would look like a coefficient near lag 0.
    """
    R = triangle(_windows_of_u(data, most), most)
    own = np.abs(np.diag(R)) > _OWN * column_norms(R)
    found = int(np.argmin(np.append(own, False)))
    if found < min(_POOREST, most):
        raise InputError(
            f"u determines {found} lags only: power in so narrow a band tells no delay; play a "
            "telegraph or a PRBS"
        )
    return found


def _windows_of_u(data: Dataset, length: int) -> Iterator[Matrix]:
    """Yield u(t), u(t - 1) … about its mean in each experiment, in blocks of rows."""
    for part in data.experiments():
        if length <= part.N:
            windows = np.lib.stride_tricks.sliding_window_view(part.u - part.u.mean(), length)
            yield from in_blocks(windows[:, ::-1], _BLOCK)
