"""Step analysis: time constant, dead time and gain, on the rate where y integrates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.quantisation import quantum
from armrig.data.treatment import difference
from armrig.estimation.nonparametric.integrator import integration
from armrig.estimation.nonparametric.step_answer import Answer, step_answer
from armrig.estimation.nonparametric.step_lag import area_above, lag_of_angle
from armrig.numerics.quantities import plural, times, with_std
from armrig.numerics.stretches import Mask, constant, stretches

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]

SHORTEST_HOLD = 8  # samples before and after a step
SHORTEST_GAP, SMALL_GAP = 2, 0.1
"""Samples, and share of the 63 % time, from which on a gap on the rise is told."""
BAND = 0.05  # about the final value, in which the answer has settled
_SURE = 5  # standard deviations of a slope before the step
_UNSETTLED = 0.005  # share of the answer still to come before the step, from which on it is told
_BETWEEN = 0.1
"""Error of a curve between samples over Ts²/tau, seen without noise at 2 to 4 samples in tau."""
_LOUD = 0.03  # deviation of the highest value from which on it may be noise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class StepAnalysis:
    """The answer to a unit step, averaged over all steps of the record, and what it shows."""

    t: Vector
    """Time in s from the step, (n,); negative before it."""
    y: Vector
    """Mean answer less what was before, per unit of u, (n,)."""
    gain: float
    """Final value, mean of the last third, in y's unit per u's (the rate's, if y integrates)."""
    gain_std: float
    """Its standard deviation: the scatter of that third, and what had not settled before."""
    dead_time: float
    """In s; 0.0 unless none is almost ruled out."""
    dead_time_interval: tuple[float, float]
    """95 %, in s, whether one is claimed or not."""
    tau: float
    """The 63 % time: from the step to 63.2 % of the final value, less the dead time, in s."""
    tau_std: float
    """Its standard deviation: noise and gaps on the rise, and a dead time that may be there."""
    equivalent_time: float
    """The area above the answer over its final value, less the dead time, in s; of a rate how far
    the angle lags the ramp that it ends up on, which a gap on the rise does not touch."""
    equivalent_time_std: float
    """Its standard deviation."""
    smooth_t: Vector
    """Times of `smooth`, in s from the step on."""
    smooth: Vector
    """Mean of the curves that are likely given y, in y's unit per u's: 0 at the step."""
    smooth_std: Vector
    """Their standard deviation, which grows in a gap."""
    hidden: tuple[float, float] | None
    """Between which times y is missing on the rise, in s; None where it is not."""
    settling: float
    """Time from which the answer stays within 5 % of its final value, in s."""
    settling_std: float
    """Its standard deviation."""
    overshoot: float
    """Largest value over the final one, less 1: 0 where there is none, NaN where noise hides it."""
    overshoot_std: float
    """Its standard deviation."""
    rate: bool
    """y is the rate of an integrating output."""
    steps: int
    """Steps averaged."""
    Ts: float
    """Sampling time, in s."""
    output: str
    """Name of y."""
    unit: str
    """Unit of y."""
    input_unit: str
    """Unit of u."""
    source: str
    """Hash of the recording, or ""."""
    warnings: tuple[str, ...]
    """What a reader should know before trusting the numbers."""

    @property
    def bandwidth(self) -> float:
        """1/tau, in rad/s (handout, 3.1.1)."""
        return 1 / self.tau

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of the answer to a step: see `armrig.plots.plot_step_analysis`."""
        from armrig.estimation.nonparametric.figures import plot_step_analysis
        from armrig.plots.layout import figure_of

        return figure_of(plot_step_analysis(self, ax=ax))

    def __repr__(self) -> str:
        """Say it in a few lines."""
        low, high = self.dead_time_interval
        name = self.output
        if self.rate:  # as the choice of a sampling time names it
            name = "the rate of theta_1" if name == "velocity" else f"the {name}"
        unit = f"{self.unit or '1'}/{self.input_unit or '1'}".replace("1/1", "")
        lines = [
            f"step analysis of {name}, {plural(self.steps, 'step')}, Ts {self.Ts:g} s",
            f"  gain {with_std(self.gain, self.gain_std)} {unit}".rstrip(),
            f"  dead time {self.dead_time:.4g} s (95 %: {low:.4g} … {high:.4g} s)",
            f"  63 % time {with_std(self.tau, self.tau_std)} s, so omega_B = 1/tau = "
            f"{self.bandwidth:.3g} rad/s",
            f"  equivalent time {with_std(self.equivalent_time, self.equivalent_time_std)} s "
            "(area above the response)",
            f"  within 5 % after {with_std(self.settling, self.settling_std)} s, "
            f"{self._overshoot_told()}",
        ]
        return "\n".join([*lines, *(f"  warning: {w}" for w in self.warnings)])

    def _overshoot_told(self) -> str:
        if np.isnan(self.overshoot):
            return "noise hides whether it overshoots"
        # Of 3 standard deviations, not 2: it is the largest of many.
        if self.overshoot <= 3 * self.overshoot_std:
            about = f" (± {100 * self.overshoot_std:.2g} %)" if self.overshoot_std else ""
            return f"no overshoot seen{about}"
        return f"overshoot {with_std(100 * self.overshoot, 100 * self.overshoot_std)} %"


@takes_recordings
def step_analysis(data: Dataset, *, integrator: bool | None = None) -> StepAnalysis:
    """Return the 63 % time, the dead time and the gain of the answer to a step.

    All changes of u with long holds before and after are used, each answer less its own level
    before and weighted by the size of its step. Of an integrating y the rate is analysed, whose
    sample (y(t) - y(t-1))/Ts belongs to the middle of its interval. 63 % time, settling, overshoot
    and dead time are those of curves drawn from a Gaussian process given all of the record
    (`armrig.estimation.nonparametric.step_answer`), each from its own final value; their deviations
    are the curves', and grow where samples are missing. A dead time is claimed only where the
    probability of none is below 1 %; where none is claimed, the 63 % time's deviation has what may
    be there.

    Parameters
    ----------
    data : Dataset
        At least one step up or down with 8 samples of rest before it; missing samples and several
        experiments are allowed.
    integrator : bool, optional
        Whether y integrates u; by default so for theta_1 and another y that behaves so, which
        the result then says.

    Returns
    -------
    StepAnalysis
        Times in s; the answer (n,) in y's unit per u's.

    Raises
    ------
    ValueError
        u has no step with holds that long, or y does not answer.

    References
    ----------
    .. [1] The lab's handout, section 3.1.1.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 6.1.
    """
    decided = integration(data, integrator)
    integrates = decided.integrates
    treated = difference(data) if integrates else data
    steps = _steps(treated)
    k, y, weight = _averaged(treated, steps, slope=False)
    own = y
    if integrates:
        _, own, weight = _averaged(data, steps, slope=True)
    t: Vector = np.asarray(data.Ts * (k - 0.5 * integrates), dtype=np.float64)
    tail = y[k >= (2 * k[-1]) // 3]
    tail = tail[np.isfinite(tail)]
    gain = float(np.mean(tail)) if tail.size else float("nan")
    gain_std = float(np.std(tail) / np.sqrt(max(tail.size, 1)))
    if not np.isfinite(gain) or abs(gain) <= 4 * gain_std:
        raise InputError(
            f"{treated.output} does not answer to the step: final value {gain:.3g} ± "
            f"{gain_std:.2g}; make it larger, or hold it longer"
        )
    answer = _answer(own, k, weight, data, gain, integrates=integrates)
    crossing, L = answer.crossing, answer.dead_time
    low, high = answer.dead_time_interval
    L_std = (high - low) / 4 if L else 0.0
    lag, lag_std = _lag(own, k, data, steps, (gain, gain_std), integrates=integrates)
    unsettled = _left_to_settle(y, k, steps, crossing / data.Ts)
    hidden = _hidden(own, k, crossing, data.Ts)
    above, above_std = answer.overshoot
    above = above if above_std < _LOUD else float("nan")
    return StepAnalysis(
        t=t,
        y=y,
        gain=gain,
        gain_std=float(np.hypot(gain_std, unsettled)),
        dead_time=L,
        dead_time_interval=(low, high),
        tau=crossing - L,
        tau_std=float(np.hypot(answer.tau_std, _BETWEEN * data.Ts**2 / crossing)),
        equivalent_time=lag - L,
        equivalent_time_std=float(np.hypot(lag_std, L_std)),
        smooth_t=answer.t,
        smooth=answer.y * gain,
        smooth_std=answer.std * abs(gain),
        hidden=hidden,
        settling=answer.settling,
        settling_std=answer.settling_std,
        overshoot=above,
        overshoot_std=above_std,
        rate=integrates,
        steps=len(steps.at),
        Ts=data.Ts,
        output=treated.output,
        unit=treated.unit,
        input_unit=data.input_unit,
        source=data.source,
        warnings=(*decided.notes, *_warnings(tail / gain, unsettled / gain, answer, hidden, data)),
    )


class _Steps(NamedTuple):
    """The steps that are averaged."""

    at: list[tuple[int, int]]
    """Experiment, and the first sample of it with the new input."""
    pre: int
    """Samples before each."""
    post: int
    """Samples from each on."""


def _steps(data: Dataset) -> _Steps:
    found = []
    for i, part in enumerate(data.experiments()):
        for before, after in pairwise(constant(part.u)):
            pre, post = before.stop - before.start, after.stop - after.start
            known = int(np.count_nonzero(part.valid[before]))
            if min(known, post) >= SHORTEST_HOLD:
                found.append((i, after.start, pre, post))
    if not found:
        raise InputError(
            f"u has no step with {SHORTEST_HOLD} constant samples before and after; record "
            "armrig.step(N, at=50), or use impulse_response(data).step_response()"
        )
    longest = max(min(pre, post) for _, _, pre, post in found)
    kept = [f for f in found if min(f[2], f[3]) >= longest // 2]
    return _Steps([f[:2] for f in kept], min(f[2] for f in kept), min(f[3] for f in kept))


def _averaged(
    data: Dataset, steps: _Steps, *, slope: bool
) -> tuple[NDArray[np.int_], Vector, Vector]:
    """Return samples from the step on (negative before), and the mean answer to a unit step.

    The third is what divides the variance of each sample's noise. Each answer is less its level
    before; with `slope` less the straight line before.
    """
    k = np.arange(-steps.pre, steps.post)
    total, weight = np.zeros(k.size), np.zeros(k.size)
    parts = list(data.experiments())
    for i, at in steps.at:
        part = parts[i]
        size = part.u[at] - part.u[at - 1]
        near = slice(at - steps.pre // 2 - 1, at)
        y, known = part.y[at - steps.pre : at + steps.post], part.valid[near]
        there = np.arange(near.start - at, 0)[known]
        before = np.polyfit(there, part.y[near][known], 1 if slope else 0)
        y = y - np.polyval(before, k)
        known = np.isfinite(y)
        total[known] += size * y[known]
        weight[known] += size**2
    with np.errstate(invalid="ignore"):
        return k, np.where(weight > 0, total / weight, np.nan), weight


def _left_to_settle(y: Vector, k: NDArray[np.int_], steps: _Steps, crossing: float) -> float:
    """Return by how much the mean answer was still to move when u stepped; 0 where it rested.

    Its slope before the step times the 63 % time, in samples: what settles with that time constant.
    """
    near = (k < 0) & (k >= -(steps.pre // 2) - 1) & np.isfinite(y)
    if np.count_nonzero(near) <= 2:
        return 0.0
    x, y = k[near] - k[near].mean(), y[near] - y[near].mean()
    spread = float(x @ x)
    slope = float(x @ y) / spread
    std = float(np.linalg.norm(y - slope * x)) / np.sqrt((x.size - 2) * spread)
    return crossing * slope if abs(slope) > _SURE * std else 0.0


def _answer(
    y: Vector,
    k: NDArray[np.int_],
    weight: Vector,
    data: Dataset,
    gain: float,
    *,
    integrates: bool,
) -> Answer:
    """Return the answer over the gain."""
    y = np.where(_alone(np.isfinite(y)) & (k >= 0), np.nan, y / gain)
    # What a converter rounds looks smooth where y moves slowly, and would pass for signal.
    rounding = quantum(data) / (abs(gain) * np.sqrt(weight.max()))
    return step_answer(
        k,
        y,
        weight,
        data.Ts,
        integrates=integrates,
        band=BAND,
        least_variance=float(rounding**2 / 12),
    )


def _weight(data: Dataset, steps: _Steps) -> float:
    """Return what divides the noise of one sample in the mean answer to a unit step."""
    parts = list(data.experiments())
    sizes = [p.u[at] - p.u[at - 1] for p, at in ((parts[i], at) for i, at in steps.at)]
    return float(np.linalg.norm(sizes))


def _lag(
    y: Vector,
    k: NDArray[np.int_],
    data: Dataset,
    steps: _Steps,
    gain: tuple[float, float],
    *,
    integrates: bool,
) -> tuple[float, float]:
    """Return the equivalent time from the step on, and its deviation."""
    settled = k >= (2 * k[-1]) // 3
    if integrates:
        n = steps.pre // 2 + 1
        return lag_of_angle(
            data.Ts * k[settled],
            y[settled],
            before=(n, n * data.Ts),
            rounding=quantum(data) / _weight(data, steps),
        )
    value, std = gain
    rising = (k >= 0) & ~settled
    own = float(np.nanstd(y[settled])) / abs(value)
    return area_above(data.Ts * k[rising], y[rising] / value, own, std / abs(value))


def _alone(known: Mask) -> Mask:
    """Return which samples stand alone between two gaps: a wiper at the edge of its track lies."""
    alone = np.zeros_like(known)
    gaps = [g for g in stretches(~known) if g.stop - g.start >= SHORTEST_GAP]
    for before, after in pairwise(gaps):
        alone[before.stop : after.start] = after.start - before.stop == 1
    return alone


def _hidden(
    y: Vector, k: NDArray[np.int_], crossing: float, Ts: float
) -> tuple[float, float] | None:
    """Return between which times the longest gap on the rise lies, in s; None without one."""
    after = np.isnan(y[k >= 0])
    gaps = [s for s in stretches(after) if s.start * Ts <= crossing + Ts]
    longest = max(gaps, key=lambda s: s.stop - s.start, default=slice(0, 0))
    begin, end = Ts * (longest.start - 1), Ts * longest.stop
    few = longest.stop - longest.start < SHORTEST_GAP or end - begin < SMALL_GAP * crossing
    return None if few else (begin, end)


def _warnings(
    tail: Vector,
    unsettled: float,
    answer: Answer,
    hidden: tuple[float, float] | None,
    data: Dataset,
) -> Iterator[str]:
    if hidden:
        yield (
            f"{data.output} is missing {times(*hidden)} after the step, on the rise: the "
            f"63 % time is known to ± {times(answer.tau_std)} only; record the step again "
            "at another angle of the chassis (`armrig collect step --at SECONDS`)"
        )
    if abs(unsettled) > _UNSETTLED:
        yield (
            "the output had not settled before the step: it was still to move by "
            f"{100 * abs(unsettled):.2g} % of the answer; hold u longer before the step"
        )
    half = tail.size // 2
    change = float(abs(np.mean(tail[half:]) - np.mean(tail[:half]))) if half else 0.0
    noise = float(np.std(np.diff(tail))) / np.sqrt(max(tail.size, 1))  # a slope does not count
    if change > 0.04 + 4 * noise:
        yield "the answer has not settled in the last third of the hold: hold u longer"
    if answer.crossing < 3 * data.Ts:
        yield (
            f"63 % is reached within {answer.crossing / data.Ts:.1f} samples, which is coarse: "
            "record with a shorter Ts"
        )
