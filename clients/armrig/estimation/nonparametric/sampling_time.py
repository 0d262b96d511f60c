"""Which sampling time a process wants (handout, 3.1.1), with reasons and figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset, merge
from armrig.data.treatment import difference
from armrig.estimation.nonparametric.blackman_tukey import filled
from armrig.estimation.nonparametric.impulse import impulse_response, long_enough
from armrig.estimation.nonparametric.integrator import integration
from armrig.estimation.nonparametric.spectral import spa
from armrig.estimation.nonparametric.step_analysis import StepAnalysis, step_analysis
from armrig.estimation.nonparametric.welch import explained, welch
from armrig.models.spectral_estimate import COHERENT, SpectralEstimate
from armrig.numerics.quantities import times, with_std
from armrig.numerics.step_times import linear_crossing, rise_time
from armrig.numerics.stretches import constant

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]

SAMPLES_PER_PERIOD = 20  # handout 3.1.1: omega_s = 20 omega_B
LAGS = (100, 200, 400, 600)  # of the impulse response, the next where the last are too few
MOST_LAGS = 500  # of the impulse response of steps
FEWEST, MOST = 7, 10  # handout 3.1.1: samples in the transient
NEAR_NYQUIST = 0.8  # of it: what counts as near
FASTER = 5  # by how much where the response is over within a sample
ZERO = 0.05  # of the largest value of a step response: less is a final value of 0
ALIASING = 0.05  # share of power near Nyquist from which folding is suspected
# Share near Nyquist of 1 - cos(omega Ts), the spectrum of differences of white noise; and with the
# scatter of an estimated spectrum.
DIFFERENCED, MOST_DIFFERENCED = 0.39, 0.45


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SamplingTime:
    """A recommended sampling time and what it follows from."""

    Ts: float
    """Recommended, in s: one of 1, 2, 5 times a power of ten."""
    tau: float
    """63 % time of the step response (of the rate, if y integrates), less the dead time, in s."""
    omega_step: float
    """omega_B = 1/tau, in rad/s."""
    omega_first: float
    """Frequency at which |G| first falls below 1/sqrt(2) of its low-frequency value, rad/s."""
    omega_spectrum: float
    """omega_B from the spectrum: where |G| is above that for the last time, in rad/s."""
    settling: float
    """Length of the transient: the step response stays within 5 % from then on, in s."""
    settling_std: float
    """Its standard deviation; NaN where the response was not read from steps."""
    Ts_step: float
    """2 pi/(20 omega_B) with omega_B of the step, in s."""
    Ts_spectrum: float
    """2 pi/(20 omega_B) with omega_B of the spectrum, in s."""
    Ts_transient: tuple[float, float]
    """settling/10 and settling/7, in s."""
    near_nyquist: float
    """Share of the output's power (the rate's, if y integrates) above 0.8 pi/Ts in these data."""
    beyond: float
    """Share above pi/Ts of the recommendation; NaN where these data do not reach that far."""
    from_step: bool
    """The response was read from steps; else from a regularised impulse response."""
    recorded_at: float
    """Sampling time of the data, in s."""
    output: str
    """What was looked at."""
    t: Vector
    """Times of `response`, in s."""
    response: Vector
    """Step response over its final value; of steps 0 up to the step."""
    gain: float
    """What |G| is divided by: final value of the steps, else |G| at low frequency."""
    omega: Vector
    """Frequencies of `power`, in rad/s."""
    power: Vector
    """Spectrum of the output over its largest value."""
    spectrum: SpectralEstimate
    """Frequency response (of the rate, if y integrates)."""
    source: str
    """Hash of the recording, or ""."""
    notes: tuple[str, ...]
    """What a reader should know."""

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of step response and spectrum: `armrig.plots.plot_sampling_time`."""
        from armrig.estimation.nonparametric.figures import plot_sampling_time
        from armrig.plots.layout import figure_of

        return figure_of(plot_sampling_time(self, ax=ax))

    def _repr_html_(self) -> str:
        """Show itself in a notebook: what it says, and its figure."""
        from armrig.plots.notebook import html

        return html(self)

    def __repr__(self) -> str:
        """Give the recommendation and its reasons."""
        beyond = "unknown" if np.isnan(self.beyond) else f"{100 * self.beyond:.2g} %"
        how = "steps" if self.from_step else "regularised impulse response"
        lines = [
            f"sampling time: {times(self.Ts)} recommended (from {self.output} at "
            f"{times(self.recorded_at)}, {how})",
            f"  step:      {self._step_told()}",
            f"  spectrum:  -3 dB {self._band_told()} rad/s, omega_s = 20 omega_B: Ts "
            f"{times(self.Ts_spectrum)}",
            f"  transient: {self._transient_told()}",
            f"  aliasing:  {100 * self.near_nyquist:.2g} % of the power above 0.8 Nyquist now, "
            f"{beyond} above the recommendation's Nyquist",
        ]
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])

    def _step_told(self) -> str:
        if self.tau < self.recorded_at:
            return f"63 % time tau below a sample, {times(self.recorded_at)}"
        return (
            f"63 % time tau {times(self.tau)}, omega_B = 1/tau = {self.omega_step:.3g} rad/s, "
            f"omega_s = 20 omega_B: Ts {times(self.Ts_step)}"
        )

    def _transient_told(self) -> str:
        if self.settling < self.recorded_at:
            return "over within a sample"
        scale, unit = (1e3, "ms") if self.settling < 1 else (1.0, "s")
        length = f"{with_std(scale * self.settling, scale * self.settling_std)} {unit}"
        if np.isnan(self.settling_std):
            length = times(self.settling)
        return f"{length} to within 5 %, 10 to 7 samples in it: Ts {times(*self.Ts_transient)}"

    def _band_told(self) -> str:
        first, last = (f"{omega:.3g}" for omega in (self.omega_first, self.omega_spectrum))
        return f"at {last}" if first == last else f"first at {first}, last (omega_B) at {last}"


@takes_recordings
def sampling_time(data: Dataset, *, integrator: bool | None = None) -> SamplingTime:
    """Recommend a sampling time from a first recording, by the handout's rules.

    omega_s = 20 omega_B gives Ts = 2 pi/(20 omega_B), with omega_B = 1/tau from the step response
    and omega_B from the spectrum; 7 to 10 samples in the transient give Ts = settling/10 …
    settling/7 (for a first-order system that is 0.3 to 0.43 tau, and the first rule 0.31 tau). The
    shortest of them is recommended, to the nearest of 1, 2, 5 times a power of ten: the fast part
    of a response that is fast first and slow after is lost otherwise, while short sampling
    costs an output-error model nothing but computation.

    omega_B of the spectrum is the frequency at which |G| is above 1/sqrt(2) of its low-frequency
    value for the last time: a notch, as the arm's, is no end of the band. Of an integrating y
    the rate is looked at, which has a gain and a time constant.

    Parameters
    ----------
    data : Dataset
        Steps, or any input that excites (telegraph); sampled faster than what it is to tell.
        Missing samples and several experiments are allowed.
    integrator : bool, optional
        Whether y integrates u; by default so for theta_1 and another y that behaves so, which
        the result then says.

    Returns
    -------
    SamplingTime
        .Ts in s; its repr gives the reasons, .plot() shows them.

    Raises
    ------
    ValueError
        The response never settles or cannot be estimated.

    References
    ----------
    .. [1] The lab's handout, section 3.1.1.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 13.7.
    """
    decided = integration(data, integrator)
    integrates = decided.integrates
    steps = _settled_steps(data, integrates=integrates)
    stepped = steps is not None
    curve = _from_impulse(data, integrates) if steps is None else _from_steps(steps)
    t, response, tau, transient = curve
    estimate = _spectrum(data, transient if stepped else None, integrates=integrates)
    if not stepped:
        explained(estimate)
    gain = abs(steps.gain) if steps else _low(estimate)
    first, last = _bandwidth(estimate, gain)
    Ts_step, Ts_spectrum = (2 * np.pi / (SAMPLES_PER_PERIOD * w) for w in (1 / tau, last))
    rules = (Ts_step, Ts_spectrum, transient / FEWEST)
    seen = tau >= data.Ts
    Ts = nearest_125(min(rules) if seen else data.Ts / FASTER)
    omega, power = _power(data, integrates=integrates)
    near = _share(omega, power, NEAR_NYQUIST * np.pi / data.Ts)
    return SamplingTime(
        Ts=Ts,
        tau=tau,
        omega_step=1 / tau,
        omega_first=first,
        omega_spectrum=last,
        settling=transient,
        settling_std=steps.settling_std if steps else float("nan"),
        gain=gain,
        Ts_step=Ts_step,
        Ts_spectrum=Ts_spectrum,
        Ts_transient=(transient / MOST, transient / FEWEST),
        near_nyquist=near,
        beyond=_share(omega, power, np.pi / Ts) if Ts >= data.Ts else float("nan"),
        from_step=stepped,
        recorded_at=data.Ts,
        output=f"the rate of {data.output}" if integrates else data.output,
        t=t,
        response=response,
        omega=omega,
        spectrum=estimate,
        power=power / power.max(),
        source=data.source,
        notes=(
            *(steps.warnings if steps else decided.notes),
            *_notes(
                Ts, data.Ts, rules, last, near, seen=seen, of=data.output if integrates else ""
            ),
        ),
    )


def nearest_125(x: float) -> float:
    """Return the nearest of 1, 2, 5 times a power of ten, by ratio."""
    decade = int(np.floor(np.log10(x)))
    candidates = [m * 10.0**d for d in (decade, decade + 1) for m in (1, 2, 5)]
    return float(f"{min(candidates, key=lambda c: abs(np.log(c / x))):.1g}")


def _settled_steps(data: Dataset, *, integrates: bool) -> StepAnalysis | None:
    """Return the step analysis of a few long holds that the response settles in, else None.

    A telegraph's longest hold looks like a step; but its next switch comes before the transient of
    the last is over, and what is read there is that of several.
    """
    lengths = [[s.stop - s.start for s in constant(part.u)] for part in data.experiments()]
    switches = sum(len(n) - 1 for n in lengths)
    if switches == 0 or (switches + len(lengths)) * 50 > data.N:
        return None
    between = [n for held in lengths for n in held[1:-1]]
    if not between:
        return step_analysis(data, integrator=integrates)
    # Those before the first switch and after the last may have been cut short.
    if min(between) < max(between) / 2:
        return None
    try:
        found = step_analysis(data, integrator=integrates)
    except ValueError:
        return None
    return found if found.settling <= min(between) * data.Ts else None


def _from_steps(found: StepAnalysis) -> tuple[Vector, Vector, float, float]:
    t, y = np.append(0.0, found.smooth_t), np.append(0.0, found.smooth / found.gain)
    return t, y, found.tau, found.settling


def _from_impulse(data: Dataset, integrates: bool) -> tuple[Vector, Vector, float, float]:
    response = long_enough(data, LAGS, integrator=integrates)
    g, _ = response.decaying
    y = np.cumsum(g)
    t: Vector = data.Ts * (np.arange(y.size, dtype=np.float64) - 0.5 * integrates)
    gain = float(np.mean(y[-max(1, y.size // 10) :]))
    if abs(gain) <= ZERO * float(np.max(np.abs(y))):
        raise InputError(
            "the step response returns to about 0: it has no time to 63 % of a final value"
        )
    t, y = np.append(t[0] - data.Ts, t), np.append(0.0, y / gain)
    shown = data.Ts * np.cumsum(y[1:]) if integrates else y[1:]
    crossing = rise_time(shown, data.Ts, integrated=integrates)
    if np.isnan(crossing):
        raise InputError("the step response never reaches 63 % of its final value; record longer")
    dead, _ = _dead_time(t, y, linear_crossing(t, y, 0.5), data.Ts)  # counts for neither rule
    outside = np.flatnonzero(np.abs(y - 1) > 0.05)
    end = float(t[min(int(outside[-1]) + 1, y.size - 1)])
    return t, y, crossing - dead, end - dead


def _dead_time(t: Vector, y: Vector, half: float, Ts: float) -> tuple[float, tuple[float, float]]:
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


def _spectrum(data: Dataset, transient: float | None, *, integrates: bool) -> SpectralEstimate:
    """Return the frequency response (the rate's, if y integrates).

    By spectral analysis, but for steps, whose transient in s is known: their power at low frequency
    leaks through any lag window.
    """
    if transient is None:
        estimate = spa(data, "log", integrator=integrates)
    else:
        # One that is cut off before the transient is over swells at its last lags, and makes a band
        # of noise; where noise shortens the transient, it is over by twice its length.
        n = int(np.clip(2 * transient / data.Ts, LAGS[0], MOST_LAGS))
        n = min(n, (data.N - data.missing) // 5)
        response = impulse_response(data, n, integrator=integrates)
        # Below a period in the record nothing is known but the gain.
        shortest = min(part.N for part in data.experiments())
        omega = np.geomspace(2 * np.pi / (shortest * data.Ts), np.pi / data.Ts, 300)
        estimate = response.spectrum(omega)
    return estimate.rate() if integrates else estimate


def _low(estimate: SpectralEstimate) -> float:
    """Return |G| at low frequency, the mean of the lowest tenth of the frequencies."""
    magnitude = estimate.magnitude[np.isfinite(estimate.G)]
    return float(np.mean(magnitude[: max(1, magnitude.size // 10)]))


def _bandwidth(estimate: SpectralEstimate, gain: float) -> tuple[float, float]:
    """Return where |G| falls 3 dB below the gain first, and where it is surely above last."""
    known = np.isfinite(estimate.G)
    omega, magnitude = estimate.omega[known], estimate.magnitude[known]
    # Of many frequencies that noise alone makes some are above by chance: by 2 standard deviations
    # where the coherence says which they are, by 4 none of some hundred.
    width = 4 if estimate.coherence is None else 2
    sure = magnitude - width * np.nan_to_num(estimate.std_magnitude[known])
    if estimate.coherence is not None:
        sure = np.where(estimate.coherence[known] > COHERENT, sure, -np.inf)
    level = gain / np.sqrt(2)
    below, above = np.flatnonzero(magnitude < level), np.flatnonzero(sure > level)

    def fall(j: int) -> float:
        """Return where |G| meets the level before point j, by a straight line."""
        if j == 0 or not magnitude[j] < level <= magnitude[j - 1]:
            return float(omega[j])
        share = (magnitude[j - 1] - level) / (magnitude[j - 1] - magnitude[j])
        return float(omega[j - 1] + share * (omega[j] - omega[j - 1]))

    first = fall(int(below[0]) if below.size else omega.size - 1)
    if above.size == 0:
        return first, first
    # From the last sure point on, the first that is below.
    beyond = below[below > above[-1]]
    return first, fall(int(beyond[0]) if beyond.size else omega.size - 1)


def _power(data: Dataset, *, integrates: bool) -> tuple[Vector, Vector]:
    """Return frequencies and the spectrum of y (or its rate) there, by Welch's method."""
    whole = filled(data, integrator=integrates)
    if integrates:
        whole = merge([difference(part)[1:] for part in whole.experiments()])
    shortest = min(part.N for part in whole.experiments())
    omega = np.linspace(0, np.pi / data.Ts, 257)[1:]
    return omega, welch(whole, max(8, min(512, shortest // 2)), omega).y


def _share(omega: Vector, power: Vector, above: float) -> float:
    return float(np.sum(power[omega > above]) / np.sum(power))


def _notes(
    Ts: float,
    now: float,
    rules: tuple[float, float, float],
    bandwidth: float,
    near: float,
    *,
    seen: bool,
    of: str,
) -> Iterator[str]:
    """Say what a reader should know; `of` is the output whose rate was looked at, or ""."""
    if not seen:
        yield (
            f"63 % is reached within one sample of {times(now)}, so these data do not tell how "
            f"fast the response is: record at {times(Ts)} once and ask again; if it is still over "
            "within a sample then, any Ts will do"
        )
        return
    names = ("the step's time constant", "the spectrum's bandwidth", "the transient")
    least, most = int(np.argmin(rules)), int(np.argmax(rules))
    yield (
        f"the shortest is taken, {times(rules[least])} by {names[least]}, rounded to {times(Ts)} "
        "(1, 2 or 5 times a power of ten): a longer one loses dynamics"
    )
    if rules[most] > 4 * rules[least]:
        yield (
            f"the rules differ {rules[most] / rules[least]:.2g} times: the response rises fast and "
            "settles slowly, and the fast part decides"
        )
    if bandwidth > 0.4 * np.pi / now:
        yield (
            f"the band reaches {100 * bandwidth * now / np.pi:.0f} % of these data's Nyquist "
            f"frequency: record at {times(now / FASTER)} once and ask again"
        )
    if near > ALIASING and of and near < MOST_DIFFERENCED:
        yield (
            f"{100 * near:.2g} % of the power lies near Nyquist: white noise of {of} gives its "
            f"differences {100 * DIFFERENCED:g} % there, at any sampling time, so a faster "
            "recording shows it, too"
        )
    elif near > ALIASING:
        yield (
            f"{100 * near:.2g} % of the power lies near Nyquist: noise or folded frequencies; "
            "compare with a faster recording before trusting it"
        )
    if Ts < now:
        yield "it is shorter than these data's, which show nothing above their Nyquist frequency"
