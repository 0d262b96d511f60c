"""Step analysis: time constant, dead time and gain, on the rate where y integrates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.data.treatment import difference
from armrig.nonparametric.integrator import integration
from armrig.numerics.quantities import plural
from armrig.numerics.stretches import constant

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Vector = NDArray[np.float64]

SHARE = 1 - np.exp(-1)  # 63.2 %: what a first-order system reaches after one time constant
SHORTEST_HOLD = 8  # samples before and after a step
SMOOTH = 0.03  # noise of the smoothed response, as a share of the final value


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class StepAnalysis:
    """The answer to a unit step, averaged over all steps of the record, and what it shows."""

    t: Vector
    """Time in s from the step, (n,); negative before it."""
    y: Vector
    """Mean answer less what was before, per unit of u, (n,)."""
    smooth: Vector
    """Moving average of y, (n,); NaN beside a hole, where only a few samples would make it."""
    window: int
    """Samples of the moving average."""
    gain: float
    """Final value, mean of the last third, in y's unit per u's (the rate's, if y integrates)."""
    gain_std: float
    """Its standard deviation from the scatter of that third."""
    dead_time: float
    """In s; 0.0 where it cannot be told from none."""
    dead_time_interval: tuple[float, float]
    """About 95 %, in s."""
    tau: float
    """Time to 63.2 % of the final value less the dead time, in s."""
    tau_std: float
    """Its standard deviation: noise at the crossing over the slope there."""
    settling: float
    """Time from which the smoothed answer stays within 5 % of its final value, in s."""
    overshoot: float
    """Largest smoothed value over the final one, less 1; 0 where there is none."""
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

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Show the answer with its figures: see `armrig.plots.plot_step_analysis`."""
        from armrig.nonparametric.figures import plot_step_analysis

        return plot_step_analysis(self, ax=ax)

    def __repr__(self) -> str:
        """Say it in a few lines."""
        low, high = self.dead_time_interval
        unit = f"{self.unit or '1'}/{self.input_unit or '1'}"
        lines = [
            f"step analysis of {self.output}, {plural(self.steps, 'step')}, Ts {self.Ts:g} s",
            f"  gain {self.gain:.4g} ± {self.gain_std:.2g} {unit}",
            f"  dead time {self.dead_time:.4g} s (95 %: {low:.4g} … {high:.4g} s)",
            f"  63 % time constant {self.tau:.4g} ± {self.tau_std:.2g} s, so omega_B = 1/tau = "
            f"{self.bandwidth:.4g} rad/s",
            f"  within 5 % after {self.settling:.4g} s, overshoot {100 * self.overshoot:.0f} %",
        ]
        return "\n".join([*lines, *(f"  warning: {w}" for w in self.warnings)])


def step_analysis(data: Dataset, *, integrator: bool | None = None) -> StepAnalysis:
    """Return the 63 % time constant, the dead time and the gain of the answer to a step.

    All changes of u with long holds before and after are used, each answer less its own level
    before and weighted by the size of its step. Of an integrating y the rate is analysed, whose
    sample (y(t) - y(t-1))/Ts belongs to the middle of its interval. A moving average, as short as
    brings the noise under 3 % of the final value, is looked at for the crossing; the dead time L
    is that of s (t - L)^p for t > L, p = 1 or 2, fitted to the rise up to one half.

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
    k, y, sizes = _averaged(treated)
    t: Vector = np.asarray(data.Ts * (k - 0.5 * integrates), dtype=np.float64)
    tail = y[k >= (2 * k[-1]) // 3]
    tail = tail[np.isfinite(tail)]
    gain = float(np.mean(tail)) if tail.size else float("nan")
    gain_std = float(np.std(tail) / np.sqrt(max(tail.size, 1)))
    if not np.isfinite(gain) or abs(gain) <= 4 * gain_std:
        msg = f"{treated.output} does not answer to the step: final value {gain:.3g} ± "
        msg += f"{gain_std:.2g}; make it larger, or hold it longer"
        raise ValueError(msg)
    smooth, window, noise = _smoothed(y, k, gain)
    crossing, slope = crossing_time(t, smooth / gain, SHARE)
    half, _ = crossing_time(t, smooth / gain, 0.5)
    L, interval = dead_time(t, y / gain, half, data.Ts)
    after = t > 0
    off = np.abs(smooth / gain - 1)
    # What the settled third does is noise: of thousands of samples some are beyond any 2 of its
    # standard deviations.
    outside = off[after] > 0.05 + np.nanmax(off[k >= (2 * k[-1]) // 3])
    last = int(np.flatnonzero(outside)[-1]) if outside.any() else -1
    times = t[after]
    settling = float(times[min(last + 1, times.size - 1)])
    return StepAnalysis(
        t=t,
        y=y,
        smooth=smooth,
        window=window,
        gain=gain,
        gain_std=gain_std,
        dead_time=L,
        dead_time_interval=interval,
        tau=crossing - L,
        tau_std=noise / abs(gain) / slope,
        settling=settling,
        overshoot=max(0.0, float(np.nanmax(smooth[after] / gain)) - 1),
        rate=integrates,
        steps=sizes,
        Ts=data.Ts,
        output=treated.output,
        unit=treated.unit,
        input_unit=data.input_unit,
        source=data.source,
        warnings=(*decided.notes, *_warnings(tail / gain, crossing, data.Ts)),
    )


def _averaged(data: Dataset) -> tuple[NDArray[np.int_], Vector, int]:
    """Return samples from the step on (negative before), the mean answer, and the steps."""
    found = []
    for part in data.experiments():
        for before, after in pairwise(constant(part.u)):
            pre, post = before.stop - before.start, after.stop - after.start
            known = int(np.count_nonzero(part.valid[before]))
            if min(known, post) >= SHORTEST_HOLD:
                found.append((part, after.start, pre, post))
    if not found:
        msg = f"u has no step with {SHORTEST_HOLD} constant samples before and after; record "
        msg += "armrig.step(N, at=50), or use impulse_response(data).step_response()"
        raise ValueError(msg)
    longest = max(min(pre, post) for _, _, pre, post in found)
    kept = [f for f in found if min(f[2], f[3]) >= longest // 2]
    pre, post = min(f[2] for f in kept), min(f[3] for f in kept)
    k = np.arange(-pre, post)
    total, weight = np.zeros(k.size), np.zeros(k.size)
    for part, at, _, _ in kept:
        size = part.u[at] - part.u[at - 1]
        level = np.nanmean(part.y[at - pre // 2 - 1 : at])
        y = part.y[at - pre : at + post] - level
        there = np.isfinite(y)
        total[there] += size * y[there]
        weight[there] += size**2
    with np.errstate(invalid="ignore"):
        return k, np.where(weight > 0, total / weight, np.nan), len(kept)


def _smoothed(y: Vector, k: NDArray[np.int_], gain: float) -> tuple[Vector, int, float]:
    """Return the shortest moving average that is quiet enough, its length, and its noise."""
    longest = max(1, k[-1] // 20)
    tail = k >= (2 * k[-1]) // 3
    for window in range(1, longest + 2, 2):
        smooth = _moving_average(y, window)
        noise = float(np.nanstd(smooth[tail]))
        if noise <= SMOOTH * abs(gain):
            break
    return smooth, window, noise


def _moving_average(y: Vector, window: int) -> Vector:
    """Return the mean of what is known within the window, NaN where that is hardly anything."""
    there = np.isfinite(y).astype(np.float64)
    box = np.ones(window)
    count = np.convolve(there, box, "same")
    # Beside a hole an average of a few is as loud as they are: it would cross any level early or
    # late. Where holes are scattered all over, half of the usual number is enough.
    enough = (count > 0) & (count > np.median(count) / 2)
    return np.convolve(np.nan_to_num(y), box, "same") / np.where(enough, count, np.nan)


def crossing_time(t: Vector, y: Vector, share: float) -> tuple[float, float]:
    """Return when y first reaches `share` after the step, and its slope there in 1/s."""
    known = np.isfinite(y)
    t, y = t[known], y[known]
    reached = np.flatnonzero((y >= share) & (t > 0))
    if reached.size == 0:
        msg = f"the answer never reaches {100 * share:.0f} % of its final value; hold u longer"
        raise ValueError(msg)
    i = int(reached[0])
    slope = (y[i] - y[i - 1]) / (t[i] - t[i - 1])
    return float(t[i - 1] + (share - y[i - 1]) / slope), float(slope)


def dead_time(t: Vector, y: Vector, half: float, Ts: float) -> tuple[float, tuple[float, float]]:
    """Return L of s (t - L)^p, p = 1 or 2, on the rise up to one half, and its interval."""
    rise = (t <= half + Ts) & np.isfinite(y)
    t, y = t[rise], y[rise]
    delays = np.linspace(0.0, half, 201)
    sse = np.full((2, delays.size), np.inf)
    for p in (1, 2):
        x = np.maximum(t[:, None] - delays, 0.0) ** p
        power = np.sum(x**2, axis=0)
        s = np.where(power > 0, y @ x / np.where(power > 0, power, 1.0), 0.0)
        sse[p - 1] = np.sum((y[:, None] - s * x) ** 2, axis=0)
    least = sse.min(axis=0)
    best = int(np.argmin(least))
    variance = least[best] / max(t.size - 2, 1)
    near = delays[least <= least[best] + 4 * variance]
    interval = (float(near[0]), float(near[-1]))
    return (0.0 if interval[0] <= 0 else float(delays[best])), interval


def _warnings(tail: Vector, crossing: float, Ts: float) -> Iterator[str]:
    half = tail.size // 2
    change = float(abs(np.mean(tail[half:]) - np.mean(tail[:half]))) if half else 0.0
    noise = float(np.std(np.diff(tail))) / np.sqrt(max(tail.size, 1))  # a slope does not count
    if change > 0.04 + 4 * noise:
        yield "the answer has not settled in the last third of the hold: hold u longer"
    if crossing < 3 * Ts:
        yield (
            f"63 % is reached within {crossing / Ts:.1f} samples: the time constant is coarse, "
            "record with a shorter Ts"
        )
