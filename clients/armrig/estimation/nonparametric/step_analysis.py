"""Step analysis: time constant, dead time and gain of y, or of its rate if y integrates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from armrig_core.errors import InputError
from armrig_core.rig.calibration import BODY
from armrig_core.telemetry.channels import ARM_OUTPUTS, RATES
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset, OfDataset, labels
from armrig.data.treatment import difference
from armrig.data.treatment.integrating import Integration, integration
from armrig.data.treatment.outliers import ENOUGH_NOISE, quantum
from armrig.estimation.data_faults import require_moving_output
from armrig.estimation.nonparametric.step_answer import NormalisedResponse, step_answer
from armrig.estimation.nonparametric.step_process import ProcessAnswer, step_process
from armrig.numerics.quantities import digits, plural, times, with_std
from armrig.numerics.rounding import rounding_std
from armrig.numerics.step_times import SHARE, area_above, lag_of_angle
from armrig.numerics.stretches import Mask, constant, stretches
from armrig.plots.layout import plot_method

Vector = NDArray[np.float64]

MIN_HOLD_SAMPLES = 8
"""Least number of samples of constant u before and after a step."""
MIN_GAP_SAMPLES, MIN_GAP_SHARE = 2, 0.1
"""Least length of a reported gap during the rise: in samples, and as a share of the 63 % time."""
SETTLING_BAND = 0.05
"""Half width of the band in which the response has settled, as a share of the final value."""
_LEAST_END = 0.7  # share of the final value from which a P1D or P2D fit extrapolates the rest
_SEEN = 2.0  # deviations of slow noise from which a response is seen
_COLOURED = 3.0  # deviations by which neighbouring samples of coloured noise are correlated
_SLOPE_SIGMAS = 5  # a slope before the step counts as 0 up to this many standard deviations
_MIN_UNSETTLED_SHARE = 0.005  # least reported motion before the step, as a share of the response
_CURVE_ERROR = 0.1
"""Standard deviation of tau due to the unknown curve between samples, divided by Ts²/tau.

The value was found from data without noise, with 2 to 4 samples in the time tau.
"""
_MAX_OVERSHOOT_STD = 0.03  # with a larger std the overshoot may be noise
_MAX_SAMPLES = 1500  # samples after the step that the process model uses
_MAX_LENGTH = 20  # least length of a record that is cut, in 63 % times
_MIN_RISING_SHARE = 0.02  # least reported rise after the record, as a share of the gain
_UNKNOWN = "not determined"
_MAX_RELATIVE_STD = 0.2  # with a larger std, a number of a record that has not settled is unknown
_MAX_DISTINCT_SHARE = 0.5  # of the samples; with fewer distinct values y is rounded


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class StepAnalysis(OfDataset):
    """Response to a unit step, averaged over all steps of the data, with characteristic times."""

    t: Vector
    """Time in s from the step, (n,); negative before the step."""
    y: Vector
    """Mean response less the level before the step, per unit of u, (n,)."""
    form: str
    """Process model that fits the response, P1D or P2D; "" if neither fits, or if y integrates."""
    gain: float
    """Final value in units of y (per s if y integrates) per unit of u, by the process model or as
    mean of the last third. NaN if not determined, as are the times."""
    gain_std: float
    """Standard deviation of `gain`."""
    gain_interval: tuple[float, float]
    """95 % interval of the gain, also if `gain` is not determined."""
    time_constants: tuple[float, ...]
    """Time constants of a P2D response in s, longest first; () otherwise. The time constant of P1D
    is `tau`."""
    time_constants_std: tuple[float, ...]
    """Standard deviations of `time_constants`, in s."""
    dead_time: float
    """Dead time in s; 0.0 if there may be none, or if the record ends too early to show it."""
    dead_time_interval: tuple[float, float]
    """95 % interval of the dead time in s, which contains `dead_time`."""
    tau: float
    """63 % time: time from the step to 63.2 % of the final value, less the dead time, in s."""
    tau_std: float
    """Standard deviation of `tau` due to noise, gaps on the rise, and a possible dead time."""
    equivalent_time: float
    """Area between the response and its final value, divided by the final value, in s. The dead
    time is subtracted. For a rate, the area equals the time from the step to the zero of the final
    ramp of the angle, extended backwards. This time does not depend on gaps on the rise."""
    equivalent_time_std: float
    """Standard deviation of `equivalent_time`, in s."""
    smooth_t: Vector
    """Times of `smooth`, in s from the step on."""
    smooth: Vector
    """Mean of the posterior curves, in units of y per unit of u; 0 at the step."""
    smooth_std: Vector
    """Standard deviation of the posterior curves, which grows in a gap."""
    hidden: tuple[float, float] | None
    """Begin and end of the longest gap of y on the rise, in s from the step; None without a gap."""
    settling: float
    """Time after which the response stays within 5 % of its final value, in s."""
    settling_std: float
    """Standard deviation of `settling`, in s."""
    overshoot: float
    """Largest value divided by the final value, minus 1; 0 if negative, NaN if noise hides it."""
    overshoot_std: float
    """Standard deviation of `overshoot`."""
    rate: bool
    """True if y is the rate of an integrating output."""
    steps: int
    """Number of averaged steps."""
    warnings: tuple[str, ...]
    """Warnings about the reliability of the numbers."""

    @property
    def bandwidth(self) -> float:
        """Bandwidth 1/tau, in rad/s (handout, 3.1.1)."""
        return 1 / self.tau

    plot = plot_method("plot_step_analysis", "the step response")

    def __repr__(self) -> str:
        """Return the result as a few lines of text."""
        low, high = self.dead_time_interval
        name = self.output
        if self.rate:  # the name that `sampling_time` prints
            angle = next((output for output, rate in RATES.items() if rate == name), "")
            name = f"the rate of {angle}" if angle else f"the {name}"
        unit = f"{self.unit or '1'}/{self.input_unit or '1'}".replace("1/1", "")
        is_known = self.dead_time or (self.form and not np.isnan(self.gain))
        dead_time = f"{self.dead_time:.4g} s" if is_known else _UNKNOWN
        gain = f"{with_std(self.gain, self.gain_std)} {unit}".rstrip()
        if np.isnan(self.gain):
            least, most = self.gain_interval
            interval = f" (95 %: {least:.4g} … {most:.4g} {unit}".rstrip() + ")"
            gain = _UNKNOWN + interval * bool(np.isfinite(most))
        bandwidth = f", so omega_B = 1/tau = {digits(self.bandwidth, 3)} rad/s"
        constants = zip(self.time_constants, self.time_constants_std, strict=True)
        lines = [
            f"step analysis of {name}, {plural(self.steps, 'step')}, Ts {self.Ts:g} s"
            + f", {self.form} fit" * bool(self.form),
            f"  gain {gain}",
            f"  dead time {dead_time} (95 %: {low:.4g} … {high:.4g} s)",
            *(f"  time constant {i} {_seconds(*x)}" for i, x in enumerate(constants, 1)),
            f"  63 % time {_seconds(self.tau, self.tau_std)}{bandwidth * bool(self.tau > 0)}",
            f"  equivalent time {_seconds(self.equivalent_time, self.equivalent_time_std)} "
            "(area above the response)",
        ]
        if not np.isnan(self.settling):
            settled = f"within 5 % after {_seconds(self.settling, self.settling_std)}"
            lines.append(f"  {settled}, {self._overshoot_text()}")
        return "\n".join([*lines, *(f"  warning: {w}" for w in self.warnings)])

    def _overshoot_text(self) -> str:
        if np.isnan(self.overshoot):
            return "noise hides a possible overshoot"
        # Three standard deviations, not two, because the overshoot is the largest of many values.
        if self.overshoot <= 3 * self.overshoot_std:
            about = f" (± {digits(100 * self.overshoot_std, 2)} %)" if self.overshoot_std else ""
            return f"no visible overshoot{about}"
        return f"overshoot {with_std(100 * self.overshoot, 100 * self.overshoot_std)} %"


def _seconds(value: float, std: float) -> str:
    return _UNKNOWN if np.isnan(value) else f"{with_std(value, std)} s"


@takes_recordings
def step_analysis(data: Dataset, *, integrator: bool | None = None) -> StepAnalysis:
    """Return the 63 % time, the dead time and the gain of the response to a step.

    All changes of u between two long holds are used as steps. The level before each step is
    subtracted, and each response is weighted by the size of its step. If y integrates, the rate is
    analysed. The value (y(t) - y(t-1))/Ts of the rate belongs to the middle of the interval.

    If y settles like P1D or P2D (one or two time constants with a dead time), all numbers are those
    of this process model. Their deviations contain the steps of a converter (see
    `armrig.estimation.nonparametric.step_process`). The response may then end before it settles: a
    number that the record leaves open is NaN. Below 70 % of the final value all are NaN but the
    dead time, because three time constants look alike until then.

    Any other response, and a rate, is described by curves that are drawn from the posterior of a
    Gaussian process, given all samples. Each curve is divided by its own final value (see
    `armrig.estimation.nonparametric.step_answer`). The standard deviations are computed from the
    scatter of the curves, and increase if samples are missing. A dead time is reported only if the
    probability of no dead time is below 1 %; otherwise `dead_time` is 0. The standard deviation of
    the 63 % time then includes a possible dead time.

    Parameters
    ----------
    data : Dataset
        At least one step up or down after 8 samples of rest. Missing samples and several
        experiments are allowed. A step is left out if fewer than 2 samples of y just before the
        step are known.
    integrator : bool, optional
        As in `etfe`.

    Returns
    -------
    StepAnalysis
        Times in s, and the response (n,) in units of y per unit of u.

    Raises
    ------
    ValueError
        u has no step with long holds before and after, y is missing just before each step, or y
        does not respond.

    References
    ----------
    .. [1] The lab's handout, section 3.1.1.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 6.1.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy.signal import lfilter
    >>> u = armrig.step(300, at=50)
    >>> noise = 0.01 * np.random.default_rng(1).standard_normal(300)
    >>> data = armrig.Dataset(u=u, y=lfilter([0, 0.1], [1, -0.9], u) + noise, Ts=0.01)
    >>> found = armrig.step_analysis(data)
    >>> print(f"gain {found.gain:.1f}, 63 % time {1000 * found.tau:.0f} ms, {found.steps} step")
    gain 1.0, 63 % time 95 ms, 1 step
    """
    decided = step_integration(data, integrator)
    integrates = decided.integrates
    treated = difference(data) if integrates else data
    steps = _steps(treated)
    require_moving_output(data)
    k, y, weight = _mean_response(treated, steps, slope=False)
    measured = y
    if integrates:
        _, measured, weight = _mean_response(data, steps, slope=True)
    t: Vector = np.asarray(data.Ts * (k - 0.5 * integrates), dtype=np.float64)
    tail = y[k >= (2 * k[-1]) // 3]
    tail = tail[np.isfinite(tail)]
    gain = float(np.mean(tail)) if tail.size else float("nan")
    noise_std, gain_std, is_coloured = _tail_noise(tail, data, steps, rate=integrates)
    tail_std = float(np.std(tail) / np.sqrt(max(tail.size, 1)))
    if not abs(gain) > 4 * max(tail_std, rounding_std(y)):
        raise InputError(
            f"{treated.output} does not respond to the step: final value {digits(gain, 3)} ± "
            f"{digits(tail_std, 2)}; use a larger step, or hold u longer"
            + "; or y settles (--assume settling, integrator=False)"
            * bool(decided.reason)
        )
    process = None if integrates else _process(y, k, weight, data, steps)
    if process is None:
        answer = _answer(measured, k, weight, data, (gain, noise_std), integrates=integrates)
    else:
        answer = process.answer
    crossing, L = answer.crossing, answer.dead_time
    if not crossing > 0:
        raise InputError(
            f"{treated.output} is at its final value at the step, which is no response to it: use "
            "a larger step, or hold u longer"
        )
    unsettled = _left_to_settle(y, k, steps, crossing / data.Ts)
    rising = 0.0
    if not integrates and process is None:
        rising = _left_to_rise(y[k > 0] / gain, noise_std / abs(gain))
    hidden = _longest_gap(measured, k, crossing, data.Ts)
    # Slow noise may look like the begin of the response, and hide a dead time.
    low, high = answer.dead_time_interval
    unseen = 0.0
    if process is None and not integrates and is_coloured and not L:
        unseen = float(answer.t[np.argmax(answer.y > _SEEN * noise_std / abs(gain))])
        high = max(high, unseen)
    if process is not None and process.form == "P2D" and process.end < _LEAST_END:
        L = low = 0.0  # until then, a third time constant looks like a dead time
    notes = (
        *decided.notes,
        *(_warnings(tail / gain, unsettled / gain, answer, hidden, data, process, rising)),
    )
    common: dict[str, Any] = {
        "t": t,
        "y": y,
        "dead_time": L,
        "dead_time_interval": (low, high),
        "smooth_t": answer.t,
        "hidden": hidden,
        "rate": integrates,
        "steps": len(steps.at),
        "warnings": notes,
        **labels(treated),
    }
    if process is not None:
        return StepAnalysis(**common, **_process_numbers(process, unsettled))
    L_std = (high - low) / 4 if L else unseen / 2
    final = gain, gain_std, noise_std
    lag, lag_std = _lag(measured, k, data, steps, final, integrates=integrates)
    above, above_std = answer.overshoot
    above = above if above_std < _MAX_OVERSHOOT_STD else float("nan")
    gain_std = float(np.linalg.norm([gain_std, unsettled, rising * gain]))
    # A multiplication by `determined` makes a number NaN that the record does not determine.
    determined = 1.0 if rising < _MAX_RELATIVE_STD else np.nan
    return StepAnalysis(
        **common,
        form="",
        gain=determined * gain,
        gain_std=determined * gain_std,
        gain_interval=(gain - 1.96 * gain_std, gain + 1.96 * gain_std),
        time_constants=(),
        time_constants_std=(),
        tau=determined * (crossing - L),
        tau_std=float(
            np.linalg.norm(
                [
                    answer.tau_std,
                    _CURVE_ERROR * data.Ts**2 / crossing,
                    rising * crossing,
                    unseen / 2,
                ]
            )
        ),
        equivalent_time=determined * (lag - L),
        equivalent_time_std=float(np.linalg.norm([lag_std, L_std, rising * lag])),
        smooth=answer.y * gain,
        smooth_std=answer.std * abs(gain),
        settling=determined * answer.settling,
        settling_std=float(np.hypot(answer.settling_std, rising * answer.settling)),
        overshoot=above,
        overshoot_std=above_std,
    )


def _tail_noise(
    tail: Vector, data: Dataset, steps: _Steps, *, rate: bool
) -> tuple[float, float, bool]:
    """Return deviations by the noise of the settled response, and whether it is coloured.

    The deviations are those of a sample and of the gain, in units of y per unit of u. Coloured
    noise counts as white noise of the same spectrum at low frequencies. In a mean of a rate, only
    the noise of the first and the last value of the integrating output remains.
    """
    n, x = tail.size, np.linspace(-1.0, 1.0, tail.size)
    e = tail - np.polyval(np.polyfit(x, tail, 1), x) if n > 2 else np.zeros(n)
    variance = float(e @ e) / max(n - 2, 1)
    near = float(e[1:] @ e[:-1] / (e @ e)) if variance > rounding_std(tail) ** 2 else 0.0
    near = near + (2 + 4 * near) / n if near > _COLOURED / np.sqrt(n) else 0.0
    near = min(near, 1 - 3 / max(n, 6))  # no fewer than three independent samples
    variance *= (1 + near) / (1 - near)
    parts = list(data.experiments())
    sizes = np.array([parts[i].u[at] - parts[i].u[at - 1] for i, at in steps.at])
    # An error of rounding is the same in all samples at rest, and in all steps between two levels.
    q = 0.0 if rate else _converter_step(data) / float(np.sqrt(np.mean(sizes**2)))
    rounded = variance * sizes.size - q**2 / 12 < (ENOUGH_NOISE * q) ** 2
    power = 1 if near > 0 or not rate else 2
    of_means = variance * (max(n, 1) ** -power + (steps.pre // 2 + 1) ** -power)
    gain_std = float(np.sqrt(of_means + rounded * q**2 / 6))
    return float(np.sqrt(variance)), gain_std, near > 0


def _process(
    y: Vector, k: NDArray[np.int_], weight: Vector, data: Dataset, steps: _Steps
) -> ProcessAnswer | None:
    """Return the response as P1D or P2D; None if it is neither, or moved before the step."""
    y = np.where(_alone(np.isfinite(y)) & (k >= 0), np.nan, y)
    # A long record is cut well after it has settled, and then thinned.
    tail = y[(k >= (2 * k[-1]) // 3) & np.isfinite(y)]
    if not tail.size:
        return None
    reached = k[(k > 0) & (y * np.sign(np.mean(tail)) >= SHARE * abs(np.mean(tail)))]
    if not reached.size:
        return None
    last = min(int(k[-1]), max(_MAX_SAMPLES, _MAX_LENGTH * int(reached[0])))
    stride = -(-last // _MAX_SAMPLES)
    near = (k >= _before(0, steps.pre).start) & (k <= last) & ((k < 0) | (k % stride == 0))
    process = step_process(
        np.asarray(data.Ts * k[near], dtype=np.float64),
        y[near],
        weight[near],
        data.Ts * stride,
        quantum=_converter_step(data) / float(np.sqrt(weight.max())),
        steps=len(steps.at),
        band=SETTLING_BAND,
    )
    if process is None:
        return None
    moved = _left_to_settle(y, k, steps, process.answer.crossing / data.Ts)
    return None if abs(moved) > _MIN_UNSETTLED_SHARE * abs(process.scale) else process


def _converter_step(data: Dataset) -> float:
    """Return the quantisation step of y, also if the steps of its printed values differ."""
    y = data.y[np.isfinite(data.y)]
    values = np.unique(y)
    gaps = np.diff(values)
    gaps = gaps[gaps > rounding_std(y)]
    rounded = values.size < _MAX_DISTINCT_SHARE * y.size and gaps.size > 0
    return quantum(data) or (float(np.median(gaps)) if rounded else 0.0)


def _process_numbers(process: ProcessAnswer, unsettled: float = 0.0) -> dict[str, Any]:
    """Return the numbers of P1D or P2D that the record determines; NaN for any other."""
    answer = process.answer

    def number(draws: Vector, value: float) -> tuple[float, float]:
        # The 95 % interval may lie unevenly about the value; its farther end is 1.96 std away.
        low, high = np.quantile(draws, [0.025, 0.975])
        std = float(max(high - value, value - low)) / 1.96
        is_sure = std < _MAX_RELATIVE_STD * abs(value) and process.end >= _LEAST_END
        return (value, std) if is_sure else (np.nan, np.nan)

    lags = process.time_constants.sum(axis=1)
    gain, gain_std = number(process.gains, process.scale)
    tau, tau_std = number(answer.crossings - answer.delays, answer.crossing - answer.dead_time)
    lag, lag_std = number(lags, float(np.median(lags)))
    settling, settling_std = number(answer.settlings, answer.settling)
    constants = [number(draws, float(np.median(draws))) for draws in process.time_constants.T]
    if process.form != "P2D" or np.isnan(constants).any():
        constants = []
    low, high = np.quantile(process.gains, [0.025, 0.975])
    if process.end < _LEAST_END and high - low < 4 * _MAX_RELATIVE_STD * abs(process.scale):
        low, high = -np.inf, np.inf  # the interval holds for this form only
    last_std = float(answer.std[-1])
    return {
        "form": process.form,
        "gain": gain,
        "gain_std": float(np.hypot(gain_std, unsettled)),
        "gain_interval": (float(low), float(high)),
        "time_constants": tuple(value for value, _ in constants),
        "time_constants_std": tuple(std for _, std in constants),
        "tau": tau,
        "tau_std": tau_std,
        "equivalent_time": lag,
        "equivalent_time_std": lag_std,
        "smooth": answer.y * process.scale,
        "smooth_std": answer.std * abs(process.scale),
        "settling": settling,
        "settling_std": settling_std,
        "overshoot": 0.0 if last_std < _MAX_OVERSHOOT_STD else np.nan,
        "overshoot_std": last_std,
    }


def step_integration(data: Dataset, integrator: bool | None) -> Integration:
    """Decide whether y integrates; a step whose P1D or P2D has a gain shows that y settles."""
    decided = integration(data, integrator)
    if not decided.reason:
        return decided
    try:
        steps = _steps(data)
        k, y, weight = _mean_response(data, steps, slope=False)
    except InputError:
        return decided
    process = _process(y, k, weight, data, steps)
    settles = process is not None and _relative_std(process) < _MAX_RELATIVE_STD
    return Integration(integrates=False) if settles else decided


def _relative_std(process: ProcessAnswer) -> float:
    """Return the deviation of the final value by the farther end of its interval, as a share."""
    low, high = np.quantile(process.gains, [0.025, 0.975])
    farther = max(high - process.scale, process.scale - low)
    return float(farther) / 1.96 / abs(process.scale)


def _left_to_rise(y: Vector, noise_std: float) -> float:
    """Return the further rise of y, divided by its last third, that a decaying rise would have.

    `noise_std` is that of a sample of y, from `_tail_noise`.
    """
    last = [part[np.isfinite(part)] for part in np.array_split(y, 6)[3:]]
    if min(part.size for part in last) < MIN_HOLD_SAMPLES:
        return 0.0
    before, first, second = (float(np.mean(part)) for part in last)
    noise = noise_std / np.sqrt(last[2].size)
    change, earlier = second - first, first - before
    if not abs(change) > 4 * noise + rounding_std(y) or change * earlier <= 0:
        return 0.0
    ratio = change / earlier
    return abs(change) * (0.5 + ratio / (1 - ratio)) if ratio < 1 else float("inf")


class _Steps(NamedTuple):
    """Steps to average."""

    at: list[tuple[int, int]]
    """Index of the experiment and the first sample with the new input, for each step."""
    pre: int
    """Number of samples before each step."""
    post: int
    """Number of samples from each step on."""


def _steps(data: Dataset) -> _Steps:
    candidates = []
    for i, part in enumerate(data.experiments()):
        for before, after in pairwise(constant(part.u)):
            pre, post = before.stop - before.start, after.stop - after.start
            count = int(np.count_nonzero(part.valid[before]))
            if min(count, post) >= MIN_HOLD_SAMPLES:
                candidates.append((i, after.start, pre, post))
    if not candidates:
        raise InputError(
            f"u has no step with {MIN_HOLD_SAMPLES} constant samples before and after; record "
            "armrig.step(N, at=50), or use impulse_response(data).step_response()"
        )
    longest = max(min(pre, post) for _, _, pre, post in candidates)
    kept = [f for f in candidates if min(f[2], f[3]) >= longest // 2]
    pre, post = min(f[2] for f in kept), min(f[3] for f in kept)
    valid = [part.valid for part in data.experiments()]
    at = [f[:2] for f in kept if np.count_nonzero(valid[f[0]][_before(f[1], pre)]) >= 2]
    if not at:
        raise InputError(
            f"{data.output} has fewer than 2 samples just before each of u's "
            f"{plural(len(kept), 'step')}: record the step again{_elsewhere(data.output)}"
        )
    return _Steps(at, pre, post)


def _elsewhere(output: str) -> str:
    """Return where the arm's step is recorded again: not in the dead band of a potentiometer."""
    if output not in ARM_OUTPUTS:
        return ""
    return f" at another angle of the {BODY} (`armrig collect step --at SECONDS`)"


def _before(at: int, pre: int) -> slice:
    """Return the samples from which the level before a step is computed."""
    return slice(at - pre // 2 - 1, at)


def _mean_response(
    data: Dataset, steps: _Steps, *, slope: bool
) -> tuple[NDArray[np.int_], Vector, Vector]:
    """Return sample numbers from the step on, the mean response to a unit step, and weights."""
    # With `slope`, the line before each step is subtracted; otherwise the level. The weight is
    # inversely proportional to the noise variance of the mean.
    k = np.arange(-steps.pre, steps.post)
    total, weight = np.zeros(k.size), np.zeros(k.size)
    parts = list(data.experiments())
    for i, at in steps.at:
        part = parts[i]
        size = part.u[at] - part.u[at - 1]
        near = _before(at, steps.pre)
        y, valid = part.y[at - steps.pre : at + steps.post], part.valid[near]
        there = np.arange(near.start - at, 0)[valid]
        before = np.polyfit(there, part.y[near][valid], 1 if slope else 0)
        y = y - np.polyval(before, k)
        finite = np.isfinite(y)
        total[finite] += size * y[finite]
        weight[finite] += size**2
    with np.errstate(invalid="ignore"):
        return k, np.where(weight > 0, total / weight, np.nan), weight


def _left_to_settle(y: Vector, k: NDArray[np.int_], steps: _Steps, crossing: float) -> float:
    """Return the error of the response due to motion of y before the step; 0 if y was at rest."""
    rounding = rounding_std(y)
    near = (k < 0) & (k >= -(steps.pre // 2) - 1) & np.isfinite(y)
    if np.count_nonzero(near) <= 2:
        return 0.0
    x, y = k[near] - k[near].mean(), y[near] - y[near].mean()
    spread = float(x @ x)
    slope = float(x @ y) / spread
    error = float(np.linalg.norm(y - slope * x)) / np.sqrt(x.size - 2)
    std = max(error, rounding) / np.sqrt(spread)
    return crossing * slope if abs(slope) > _SLOPE_SIGMAS * std else 0.0


def _answer(
    y: Vector,
    k: NDArray[np.int_],
    weight: Vector,
    data: Dataset,
    gain_and_noise: tuple[float, float],
    *,
    integrates: bool,
) -> NormalisedResponse:
    """Return the posterior of the response divided by the gain."""
    gain, noise_std = gain_and_noise
    y = np.where(_alone(np.isfinite(y)) & (k >= 0), np.nan, y / gain)
    # Rounding by a converter looks smooth if y moves slowly, and would count as signal.
    rounding = quantum(data) / (abs(gain) * np.sqrt(weight.max()))
    return step_answer(
        k,
        y,
        weight,
        data.Ts,
        integrates=integrates,
        band=SETTLING_BAND,
        least_variance=max(rounding**2 / 12, 0.0 if integrates else (noise_std / gain) ** 2),
    )


def _lag(
    y: Vector,
    k: NDArray[np.int_],
    data: Dataset,
    steps: _Steps,
    final: tuple[float, float, float],
    *,
    integrates: bool,
) -> tuple[float, float]:
    """Return the equivalent time, measured from the step, and its standard deviation, in s.

    `final` is the gain, its standard deviation, and that of the noise.
    """
    settled = k >= (2 * k[-1]) // 3
    if integrates:
        n, parts = steps.pre // 2 + 1, list(data.experiments())
        sizes = [parts[i].u[at] - parts[i].u[at - 1] for i, at in steps.at]
        return lag_of_angle(
            data.Ts * k[settled],
            y[settled],
            before=(n, n * data.Ts),
            rounding=quantum(data) / float(np.linalg.norm(sizes)),
        )
    gain, gain_std, noise_std = final
    rising = (k >= 0) & ~settled
    y = y[rising] / gain
    return area_above(data.Ts * k[rising], y, noise_std / abs(gain), gain_std / abs(gain))


def _alone(valid: Mask) -> Mask:
    """Return a mask of single samples between gaps, as at the end of a potentiometer's track."""
    alone = np.zeros_like(valid)
    gaps = [g for g in stretches(~valid) if g.stop - g.start >= MIN_GAP_SAMPLES]
    for before, after in pairwise(gaps):
        alone[before.stop : after.start] = after.start - before.stop == 1
    return alone


def _longest_gap(
    y: Vector, k: NDArray[np.int_], crossing: float, Ts: float
) -> tuple[float, float] | None:
    """Return begin and end of the longest gap on the rise, in s, or None if there is no gap."""
    after = np.isnan(y[k >= 0])
    gaps = [s for s in stretches(after) if s.start * Ts <= crossing + Ts]
    longest = max(gaps, key=lambda s: s.stop - s.start, default=slice(0, 0))
    begin, end = Ts * (longest.start - 1), Ts * longest.stop
    few = longest.stop - longest.start < MIN_GAP_SAMPLES or end - begin < MIN_GAP_SHARE * crossing
    return None if few else (begin, end)


def _warnings(
    tail: Vector,
    unsettled: float,
    answer: NormalisedResponse,
    hidden: tuple[float, float] | None,
    data: Dataset,
    process: ProcessAnswer | None = None,
    rising: float = 0.0,
) -> Iterator[str]:
    if hidden:
        yield (
            f"{data.output} is missing {times(*hidden)} after the step, on the rise, so the "
            f"63 % time is known only to ± {times(answer.tau_std)}; record the step again"
            f"{_elsewhere(data.output)}"
        )
    if abs(unsettled) > _MIN_UNSETTLED_SHARE:
        yield (
            "the output had not settled before the step: the remaining motion was "
            f"{digits(100 * abs(unsettled), 2)} % of the response; hold u longer before the step"
        )
    half = tail.size // 2
    change = float(abs(np.mean(tail[half:]) - np.mean(tail[:half]))) if half else 0.0
    noise = float(np.std(np.diff(tail))) / np.sqrt(max(tail.size, 1))  # a slope does not count
    if process is not None and process.end < 1 - SETTLING_BAND:
        text = f"{data.output} ends before it settles, so its gain is not determined: hold u longer"
        if np.isfinite(_process_numbers(process)["gain"]):
            text = (
                f"{data.output} ends at {100 * process.end:.0f} % of its final value, so all "
                f"numbers rest on the {process.form} fit: hold u longer"
            )
        yield text
    elif process is None and (change > 0.04 + 4 * noise or rising > _MIN_RISING_SHARE):
        yield "the response has not settled in the last third of the hold: hold u longer"
    if answer.crossing < 3 * data.Ts:
        yield (
            f"63 % is reached within {answer.crossing / data.Ts:.1f} samples, which is coarse: "
            "record with a shorter Ts"
        )
