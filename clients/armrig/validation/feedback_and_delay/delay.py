"""The delay before the input acts, in samples (handout, assignment 3.8)."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from math import ceil, sqrt

import numpy as np
from armrig_core.errors import InputError
from armrig_core.telemetry.channels import SECOND_ORDER_OUTPUTS
from numpy.lib.stride_tricks import sliding_window_view

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset, Vector, labels
from armrig.data.step import laws_of, laws_text
from armrig.data.treatment.integrating import integration
from armrig.data.treatment.outliers import quantum
from armrig.estimation.data_faults import require_moving_output
from armrig.estimation.nonparametric.impulse import ImpulseResponse, impulse_response
from armrig.numerics.least_squares import column_norms, triangle
from armrig.numerics.quantities import plural
from armrig.numerics.regressors import in_blocks
from armrig.validation.feedback_and_delay.by_channel import each_channel, without_other_inputs
from armrig.validation.feedback_and_delay.delay_result import Delay
from armrig.validation.feedback_and_delay.lag_tests import (
    FIRST_LAGS,
    MOST_PAST,
    SURPRISING,
    LagTests,
    Progress,
    lag_tests,
    possible,
    smooth_onsets,
)
from armrig.validation.feedback_and_delay.open_loop import open_loop

_MIN_SAMPLES = 50  # with a known y
_LOSS_LAGS = 3  # number of lags after nk for which the result contains the loss
_MAX_SHAPED_LAGS = 8  # noise that hides more lags hides the shape of the onset, too
_MAX_FEW_CHANGES = 10  # changes of u; with more changes the error of quantisation averages out
_MIN_OWN_SHARE = 0.005  # least share of a lag of u that the earlier lags leave unexplained
_MIN_DETERMINED_LAGS = 28  # a sum of few sines determines fewer lags
_BLOCK = 4096  # rows decomposed at once: they stay in the cache
_LEAST_RANGE, _MOST_RANGE = 220, 500  # widths of the widest range of lags
_WIDER = 4  # growth of a range
_SAMPLES_PER_LAG = 50  # of a wide range; more samples take long
_END_LAGS = 5  # last lags of a range, which also represent later lags


@each_channel(without_other_inputs)
@takes_recordings
def delay(
    data: Dataset,
    *,
    integrator: bool | None = None,
    progress: Progress | None = None,
) -> Delay:
    """Find the first lag at which u acts: the first lag that a model of y needs.

    The model is ARX with lags of u from 0 on; AIC chooses its orders. For each k, `lag_tests` tests
    the hypothesis that u acts at none of the lags 0 … k ::

        H_k: b_0 = … = b_k = 0,      F test, level 0.1 %

    The first k for which H_k is rejected is the latest lag at which u can act first. At an earlier
    lag, the true coefficient may be too small to be significant. The lag is ruled out if a
    one-sided test (level 0.1 %) finds the coefficient smaller than a bound. The bound is
    1/(1 + 3 n) of the coefficient n samples later, with the n for which the bound is largest. For
    the slowest onset of a mechanical rig,
    t²/2 under a hold, this ratio is 1/(1 + 2 n). If the response begins more slowly, the bound is
    computed from an onset (t/Ts)^d, and d is estimated from the first lags. The first two
    coefficients of a plant of relative degree d have the ratio 1 to (2^d - 1). Such an onset is
    also tested in all lags from k to the first significant lag together. If several lags
    remain for an angle, or at most nine lags for an integrating y, the shape of the onset decides
    (`smooth_onsets`).

    nk is the least lag that is not ruled out, so an unproven delay is never claimed. A direct term,
    nk = 0, is claimed only if lag 0 itself is significant. If a control law drove the rig, or if
    `open_loop` finds feedback, which causes a coefficient at lag 0, the model begins at lag 1. If
    the data do not distinguish feedback from a direct term, `interval` begins at 0.

    Parameters
    ----------
    data : Dataset or Signals
        At least 50 samples with an exciting input. Samples may be missing, and the data may have
        several experiments. For Signals with several channels, each pair of an output and an
        input is tested separately, without the effects of the other inputs.
    integrator : bool, optional
        True if y integrates. The default is True for the turning angle of the arm. For any other y
        a test decides, and `remarks` contains its result. With several inputs this argument has no
        effect.
    progress : callable, optional
        Called before each slow estimate with the number of finished estimates, the number of all
        estimates, and the tested lag as text.

    Returns
    -------
    Delay
        `nk`, `delay` = nk - 1, `told`, `interval`, `p_values`, `explain()`, `plot()`. `delay` is
        the time delay (dead time) in whole samples, in addition to the sample of the hold. If
        `interval` contains several nk, `delay` is the least possible delay, but at least 0. For
        the response to a step, use `step_analysis`. For Signals with several channels, the result
        is `ByChannel`: `found["y", "u"]` is the `Delay` of one channel, and `refused` contains
        the channels without a visible response.

    Raises
    ------
    ValueError
        There are too few samples, u does not excite, or no response to u is visible above the
        noise.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 16.4 and 16.5.
    .. [2] S. Björklund, *A Survey and Comparison of Time-Delay Estimation Methods in Linear
       Systems*, Linköping, 2003, chapters 5 and 6.

    Examples
    --------
    >>> import armrig
    >>> found = armrig.delay(armrig.example_recording().dataset("alpha"))
    >>> found.nk, found.delay, found.interval
    (1, 0, (1, 1))
    """
    samples = data.N - data.missing
    if samples < _MIN_SAMPLES:
        raise InputError(
            f"the test for a delay needs at least {_MIN_SAMPLES} samples, got {samples}: record "
            "longer"
        )
    require_moving_output(data)
    decided = integration(data, integrator)
    response, tests, zero = _tests(data, samples, integrates=decided.integrates)
    first, onset = tests.first, tests.shown
    low, last, misfit = _onset(data, tests, progress, integrates=decided.integrates)
    step, largest_step = quantum(data), float(np.max(np.abs(np.diff(data.u)), initial=0.0))
    t_q = _hiding_time_s(data, np.abs(np.cumsum(response.g[low:])) * largest_step, step)
    changes = int(np.count_nonzero(np.diff(data.u)))
    low, remarks = _least_nk_by_steps(low, last, changes, t_q, data.Ts)
    either = zero is not None and zero.rig and bool(zero.remark)
    return Delay(
        nk=1 if either and first else max(low, min(1, last)),
        interval=(0 if either else low, last),
        may_be_feedback=either,
        p_values={k: float(tests.p_without_one[k - first]) for k in range(first, onset + 1)},
        before=tests.before(onset - 1) if onset > first else None,
        misfit=misfit,
        arx_loss={
            k: float(v) for k, v in enumerate(tests.loss[: onset - first + _LOSS_LAGS + 1], first)
        },
        response=response,
        integrator=decided.integrates,
        na=tests.na,
        quantum=step,
        largest_step=largest_step,
        t_q=t_q,
        remarks=(*decided.notes, *([zero.remark] if zero and zero.remark else []), *remarks),
        **labels(data),
    )


def _tests(
    data: Dataset, samples: int, *, integrates: bool
) -> tuple[ImpulseResponse, LagTests, _LagZero | None]:
    """Return the impulse response, the tests of the lags, and the causes of a coefficient at lag 0.

    The first model has at most `FIRST_LAGS` lags. The range grows while u acts at none of its lags,
    or first at one of the last. The last lag of a model also represents the later lags, because u
    is correlated with its past. The widest range has an eighth of the samples, at least 220 and at
    most 500 lags, but no more than a quarter of the samples.
    """
    widest, wanted, n = (
        min(max(_LEAST_RANGE, samples // 8), _MOST_RANGE, samples // 4),
        FIRST_LAGS,
        0,
    )
    while True:
        is_first = n == 0
        part = data if is_first else data[: _SAMPLES_PER_LAG * wanted]
        longest = max(experiment.N for experiment in part.experiments())
        most = min(wanted + MOST_PAST, samples // 3, longest // 2)
        determined = count_determined_lags(part, most)
        # The number of determined lags is divided between A and B in the ratio 20 to 50.
        share = 5 * determined // 7 if is_first else determined - MOST_PAST
        lags = min(wanted, samples // 10 if is_first else widest, share)
        if lags <= n:
            break
        n = lags
        response = impulse_response(part, n, kernel=None, integrator=integrates)
        tests = lag_tests(part, response, determined)
        zero = None if tests.shown and not laws_of(part.history) else _lag_zero(part)
        if zero is not None and zero.controller:
            later = lag_tests(part, response, determined, first=1)
            tests = tests if zero.rig and later.none_shown else later
        if not tests.none_shown and tests.shown < n - _END_LAGS:
            return response, tests, zero
        wanted *= _WIDER
    if tests.none_shown:
        raise InputError(
            f"the data do not determine the delay: {data.output} shows no response to u above the "
            f"noise up to lag {n - 1}. Record longer, or with more and larger changes of u"
        )
    if n > FIRST_LAGS:
        raise InputError(
            f"the data do not determine the delay: u acts first at lag {tests.shown} or later, and "
            f"the last lag that the data determine is {n - 1}; record longer"
        )
    return response, tests, zero


@dataclass(frozen=True, slots=True, kw_only=True)
class _LagZero:
    """Possible causes of a coefficient at lag 0: the rig's direct term, or a controller."""

    rig: bool
    """True if the rig may cause the coefficient."""
    controller: bool
    """True if a controller whose u(t) depends on y(t) may cause the coefficient."""
    remark: str = ""
    """Remark on the cause; "" without evidence of feedback."""


def _lag_zero(data: Dataset) -> _LagZero:
    loop = None
    with suppress(ValueError):
        loop = open_loop(data)
    if loop is None or not loop.feedback:
        return _LagZero(rig=True, controller=False)
    if loop.exact:
        msg = f"u(t) is a multiple of {data.output}(t) in every sample, as under a P controller "
        msg += "with a constant set point: such data do not determine a delay; change the set "
        raise InputError(msg + "point")
    if loop.laws:
        return _LagZero(
            rig=False,
            controller=True,
            remark=f"{laws_text(loop.laws)} computed u(t) from {data.output} up to t - 1, so the "
            "lags from 1 on were tested",
        )
    if not loop.may_be_direct_term or data.output in SECOND_ORDER_OUTPUTS:
        return _LagZero(
            rig=False,
            controller=True,
            remark=f"the data look as if u(t) depends on {data.output}(t), as under feedback, "
            "which looks like a direct term, so the lags from 1 on were tested",
        )
    return _LagZero(
        rig=True,
        controller=not loop.few_levels,
        remark="feedback looks the same as a direct term: if y was read before u was applied, a "
        "controller computed u(t) from y(t), and nk is 1 or more",
    )


def _onset(
    data: Dataset, tests: LagTests, progress: Progress | None, *, integrates: bool
) -> tuple[int, int, dict[int, float]]:
    """Return the least and the greatest lag that are not ruled out, and `Delay.misfit`."""
    first, last = tests.least(), tests.shown
    angle = data.output in SECOND_ORDER_OUTPUTS
    if first == last or not (angle or (integrates and last - first <= _MAX_SHAPED_LAGS)):
        return first, last, {}
    misfit = smooth_onsets(data, first, last, integrator=integrates, progress=progress)
    if not angle and min(misfit.values()) > SURPRISING:
        return first, last, {}  # it is no smooth onset
    least, latest = possible(misfit)
    if not latest:  # only a significant lag 0 is a direct term: a dead zone looks like a late onset
        return first, last, {}
    return least, latest, misfit


def _hiding_time_s(data: Dataset, rise: Vector, step: float) -> float | None:
    """Return the time in s for which the quantisation `step` hides the largest step response."""
    beyond = np.flatnonzero(rise >= step)
    at = int(beyond[0]) if beyond.size else rise.size - 1
    # y = b |Δu| t²/2 at the first sample of the response above 1 LSB
    acceleration = 2 * float(rise[at]) / ((at + 1) * data.Ts) ** 2
    if data.output not in SECOND_ORDER_OUTPUTS or not step * acceleration > 0:
        return None
    return sqrt(2 * step / acceleration)


def _least_nk_by_steps(
    first: int, last: int, changes: int, t_q: float | None, Ts: float
) -> tuple[int, list[str]]:
    """Return the least nk that quantisation of slow changes does not rule out, and remarks."""
    if t_q is None or changes >= _MAX_FEW_CHANGES or last <= 1:
        return first, []
    hidden = ceil(t_q / Ts)
    return min(first, max(last - hidden, 1)), [
        f"u changes only {plural(changes, 'time')}, and quantisation may hide the first "
        f"{plural(hidden, 'sample')} of the response: this looks like a delay"
    ]


def is_narrow(data: Dataset) -> bool:
    """Return whether the band of u is too narrow for a long linear model."""
    most = min(_MIN_DETERMINED_LAGS, *(experiment.N // 2 for experiment in data.experiments()))
    try:
        count_determined_lags(data, most)
    except InputError:
        return True
    return False


def count_determined_lags(data: Dataset, most: int) -> int:
    """Return the number of lags of u, from lag 0 on, whose coefficients the data determine.

    The count, at most `most`, ends at the first lag k at which u(t - k) hardly differs from its
    regression on u(t), …, u(t - k + 1). A narrow band of u determines few lags, and the effect of
    coefficients after the last lag would appear near lag 0: such data are refused.
    """
    windows = (
        sliding_window_view(part.u - part.u.mean(), most)[:, ::-1]
        for part in data.experiments()
        if most <= part.N
    )
    R = triangle((block for rows in windows for block in in_blocks(rows, _BLOCK)), most)
    is_determined = np.abs(np.diag(R)) > _MIN_OWN_SHARE * column_norms(R)
    count = int(np.argmin(np.append(is_determined, False)))
    if count < min(_MIN_DETERMINED_LAGS, most):
        raise InputError(
            f"u determines {plural(count, 'lag')} only: the band of u is too narrow to find a "
            "delay; record with a telegraph or a PRBS"
        )
    return count
