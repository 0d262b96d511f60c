"""Recommendation of a sampling time (handout, 3.1.1) with the reasons for it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.step import BIASED, codes_of, in_loop
from armrig.data.treatment import difference
from armrig.estimation.nonparametric.impulse import impulse_response, long_enough
from armrig.estimation.nonparametric.spectra import coherent_range, fill_outputs
from armrig.estimation.nonparametric.spectral import spa
from armrig.estimation.nonparametric.step_analysis import (
    StepAnalysis,
    step_analysis,
    step_integration,
)
from armrig.models.spectral_estimate import COHERENT, SpectralEstimate
from armrig.numerics.quantities import digits, plural, times, with_std
from armrig.numerics.step_times import linear_crossing, rise_time
from armrig.numerics.stretches import constant
from armrig.plots.layout import html, plot_method

Vector = NDArray[np.float64]

SAMPLES_PER_PERIOD = 20  # handout 3.1.1: omega_s = 20 omega_B
LAGS = (100, 200, 400, 600)  # numbers of lags of the impulse response, tried one after the other
MAX_STEP_LAGS = 500  # largest number of lags of the impulse response from steps
MIN_TRANSIENT_SAMPLES, MAX_TRANSIENT_SAMPLES = 7, 10  # handout 3.1.1: samples in the transient
NYQUIST_SHARE = 0.8  # lower limit of the frequencies near Nyquist, as a share of Nyquist
SPEED_UP = 5  # factor of a faster recording, if the response ends within a sample
MIN_GAIN_SHARE = 0.05  # a final value below this share of the largest value counts as 0
MIN_ALIASING_SHARE = 0.05  # a larger share of power near Nyquist leads to a note on aliasing
# Differences of white noise have the spectrum 1 - cos(omega Ts). DIFFERENCED is the share of its
# power near Nyquist. In an estimate, scatter may increase this share to MOST_DIFFERENCED.
DIFFERENCED, MOST_DIFFERENCED = 0.39, 0.45


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SamplingTime:
    """Recommended sampling time with the reasons for it."""

    Ts: float
    """Recommended sampling time in s: 1, 2 or 5 times a power of ten."""
    tau: float
    """63 % time of the step response (of the rate if y integrates), less the dead time, in s."""
    omega_step: float
    """Bandwidth omega_B = 1/tau from the step response, in rad/s."""
    omega_first: float
    """Lowest frequency at which |G| falls below 1/sqrt(2) of its low-frequency value, in rad/s."""
    omega_spectrum: float
    """Highest frequency with |G| above 1/sqrt(2) of its low-frequency value, in rad/s (omega_B)."""
    settling: float
    """Length of the transient in s, from the dead time until the step response stays within 5 % of
    its final value."""
    settling_std: float
    """Standard deviation of `settling`; NaN if the response was not measured with steps."""
    Ts_step: float
    """Sampling time 2 pi/(20 omega_B) with omega_B from the step response, in s."""
    Ts_spectrum: float
    """Sampling time 2 pi/(20 omega_B) with omega_B from the spectrum, in s."""
    Ts_transient: tuple[float, float]
    """Sampling times settling/10 and settling/7, in s."""
    near_nyquist: float
    """Share of the power of y (or its rate if y integrates) above 0.8 of the Nyquist frequency."""
    beyond: float
    """Share of the power of y (or its rate if y integrates) above pi/`Ts`; NaN if `Ts` is less than
    `recorded_at`."""
    from_step: bool
    """True if `response` was measured with steps, False if it was computed from a regularised
    impulse response."""
    recorded_at: float
    """Sampling time of the data, in s."""
    output: str
    """Name of the analysed output."""
    t: Vector
    """Times of `response`, in s after the dead time."""
    response: Vector
    """Step response divided by its final value; 0 up to the step."""
    gain: float
    """Reference value for |G|: final value of the step response, at least |G| at low frequency."""
    omega: Vector
    """Frequencies of `power`, in rad/s."""
    power: Vector
    """Spectrum of the output divided by its largest value."""
    spectrum: SpectralEstimate
    """Frequency response (of the rate if y integrates)."""
    source: str
    """Hash of the recording, or ""."""
    doubts: tuple[str, ...]
    """Notes that make the recommendation doubtful."""
    notes: tuple[str, ...]
    """Notes about the recommendation; `doubts` are the first of these notes."""

    plot = plot_method("plot_sampling_time", "step response and spectrum")

    _repr_html_ = html

    def brief(self) -> str:
        """Return the recommendation, the result of each rule, and the doubts, as text."""
        return self._text(self._rules()[:4], self.doubts)

    def __repr__(self) -> str:
        """Return the recommendation with its reasons as text."""
        return self._text(self._rules(), self.notes)

    @staticmethod
    def _text(lines: Sequence[str], notes: Sequence[str]) -> str:
        """Return the lines, then the notes; a note that the data are biased is the first line."""
        biased = [n for n, code in zip(notes, codes_of(notes), strict=True) if code == BIASED]
        last = [f"  {note}" for note in notes if note not in biased]
        return "\n".join([*biased, *lines, *last])

    def _rules(self) -> list[str]:
        beyond = (
            "an unknown share" if np.isnan(self.beyond) else f"{digits(100 * self.beyond, 2)} %"
        )
        how = "steps" if self.from_step else "regularised impulse response"
        return [
            f"sampling time: {times(self.Ts)} recommended (from {self.output} at "
            f"{times(self.recorded_at)}, {how})",
            f"  step:      {self._step_text()}",
            f"  spectrum:  -3 dB {self._band_text()} rad/s, omega_s = 20 omega_B: Ts "
            f"{times(self.Ts_spectrum)}",
            f"  transient: {self._transient_text()}",
            f"  aliasing:  {digits(100 * self.near_nyquist, 2)} % of the power is above 0.8 of "
            f"Nyquist; {beyond} is above Nyquist at the recommended Ts",
        ]

    def _step_text(self) -> str:
        if self.tau < self.recorded_at:
            return f"63 % time tau below a sample, {times(self.recorded_at)}"
        return (
            f"63 % time tau {times(self.tau)}, omega_B = 1/tau = {digits(self.omega_step, 3)} "
            f"rad/s, omega_s = 20 omega_B: Ts {times(self.Ts_step)}"
        )

    def _transient_text(self) -> str:
        if self.settling < self.recorded_at:
            return "over within a sample"
        scale, unit = (1e3, "ms") if self.settling < 1 else (1.0, "s")
        length = f"{with_std(scale * self.settling, scale * self.settling_std)} {unit}"
        if np.isnan(self.settling_std):
            length = times(self.settling)
        return f"{length} to within 5 %, 10 to 7 samples in it: Ts {times(*self.Ts_transient)}"

    def _band_text(self) -> str:
        first, last = (digits(omega, 3) for omega in (self.omega_first, self.omega_spectrum))
        return f"at {last}" if first == last else f"first at {first}, last (omega_B) at {last}"


@takes_recordings
def sampling_time(data: Dataset, *, integrator: bool | None = None) -> SamplingTime:
    """Recommend a sampling time from a first recording, by the rules of the handout.

    By the rule omega_s = 20 omega_B, Ts is 2 pi/(20 omega_B). The bandwidth omega_B is estimated
    twice: as 1/tau of the step response, and from the spectrum. By the rule of 7 to 10 samples in
    the transient, Ts is settling/10 to settling/7, where settling is the length of the transient.
    For a first-order system the first rule leads to Ts = 0.31 tau, and the second rule to Ts
    between 0.3 tau and 0.43 tau. The recommendation is the shortest of three sampling times:
    settling/7, and 2 pi/(20 omega_B) for each omega_B. This time is rounded to 1, 2 or 5 times a
    power of ten. The shortest time is used because a longer sampling time loses the fast part of a
    response that is first fast and then slow. For an output-error model, the only cost of a short
    sampling time is more computation.

    omega_B of the spectrum is the highest frequency at which ``|G|`` is above 1/sqrt(2) of its
    low-frequency value. A notch below this frequency, such as the notch of the arm, does not lower
    omega_B. If y integrates, the rate of y is analysed, because only the rate has a gain and a time
    constant.

    Parameters
    ----------
    data : Dataset
        Data with steps or another exciting input (telegraph), with a sampling time shorter than the
        time constants. Missing samples and several experiments are allowed.
    integrator : bool, optional
        As in `etfe`.

    Returns
    -------
    SamplingTime
        `Ts` in s. The printed text and the figure of `plot` contain the reasons.

    Raises
    ------
    ValueError
        The response never settles or cannot be estimated.

    References
    ----------
    .. [1] The lab's handout, section 3.1.1.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 13.7.

    Examples
    --------
    >>> found = armrig.sampling_time(armrig.example_recording().dataset("theta_1"))
    >>> found.Ts
    0.005
    >>> print(found)
    sampling time: 5 ms recommended (from the rate of theta_1 at 10 ms, ...)
      step:      63 % time tau 21... ms, omega_B = 1/tau = 47... rad/s, ...
      spectrum:  -3 dB first at 9.9..., ..., ...
      ...
    """
    decided = step_integration(data, integrator)
    integrates = decided.integrates
    steps, static_gain = _analyse_long_steps(data, integrates=integrates), 0.0
    stepped = steps is not None
    if steps is None:
        t, response, static_gain, tau, transient = _from_impulse(data, integrates)
    else:
        t = np.append(0.0, steps.smooth_t) - steps.dead_time
        response = np.append(0.0, steps.smooth / steps.gain)
        tau, transient = steps.tau, steps.settling - steps.dead_time
        if np.isnan(transient):
            raise InputError(
                f"the step ends before {steps.output} settles, so its times are not determined: "
                "hold u longer after the step"
            )
    estimate = _spectrum(data, steps.settling if steps else None, integrates=integrates)
    if not stepped:
        coherent_range(estimate)
    magnitudes = estimate.magnitude[np.isfinite(estimate.G)]
    low = float(np.mean(magnitudes[: max(1, magnitudes.size // 10)]))  # over the lowest frequencies
    # The lowest frequency may be above the bandwidth, and smoothing lowers the magnitude there.
    gain = abs(steps.gain) if steps else max(low, abs(static_gain))
    first, last = _bandwidth(estimate, gain)
    Ts_step, Ts_spectrum = (2 * np.pi / (SAMPLES_PER_PERIOD * w) for w in (1 / tau, last))
    rules = (Ts_step, Ts_spectrum, transient / MIN_TRANSIENT_SAMPLES)
    seen = tau >= data.Ts
    Ts = nearest_125(min(rules) if seen else data.Ts / SPEED_UP)
    omega, power = _power(data, integrates=integrates)
    near = _share(omega, power, NYQUIST_SHARE * np.pi / data.Ts)
    rate_of = data.output if integrates else ""
    doubts = (
        *in_loop(
            data.history, "the loop biases the spectrum: record in open loop for a sampling time"
        ),
        *decided.notes,
        *(steps.warnings if steps else ()),
        *_doubts(Ts, data.Ts, last, near, seen=seen, rate_of=rate_of),
    )
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
        Ts_transient=(transient / MAX_TRANSIENT_SAMPLES, transient / MIN_TRANSIENT_SAMPLES),
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
        doubts=doubts,
        notes=(*doubts, *(_reasons(Ts, data.Ts, rules, near, rate_of=rate_of) if seen else ())),
    )


def nearest_125(x: float) -> float:
    """Return x rounded, on a logarithmic scale, to 1, 2 or 5 times a power of ten."""
    decade = int(np.floor(np.log10(x)))
    candidates = [m * 10.0**d for d in (decade, decade + 1) for m in (1, 2, 5)]
    return float(f"{min(candidates, key=lambda c: abs(np.log(c / x))):.1g}")


def _analyse_long_steps(data: Dataset, *, integrates: bool) -> StepAnalysis | None:
    """Return the step analysis if u consists of a few long holds in which y settles, else None."""
    # The longest hold of a telegraph signal is no step: its response is a sum of transients.
    lengths = [[s.stop - s.start for s in constant(part.u)] for part in data.experiments()]
    switches = sum(len(n) - 1 for n in lengths)
    if switches == 0 or (switches + len(lengths)) * 50 > data.N:
        return None
    between = [n for held in lengths for n in held[1:-1]]
    if not between:
        return step_analysis(data, integrator=integrates)
    # The holds before the first and after the last switch may be truncated.
    if min(between) < max(between) / 2:
        return None
    try:
        analysis = step_analysis(data, integrator=integrates)
    except ValueError:
        return None
    return analysis if analysis.settling <= min(between) * data.Ts else None


def _from_impulse(data: Dataset, integrates: bool) -> tuple[Vector, Vector, float, float, float]:
    """Return times, step response divided by its gain, the gain, 63 % time and transient."""
    response = long_enough(data, LAGS, integrator=integrates)
    g, _ = response.decaying
    y = np.cumsum(g)
    t: Vector = data.Ts * (np.arange(y.size, dtype=np.float64) - 0.5 * integrates)
    gain = float(np.mean(y[-max(1, y.size // 10) :]))
    if abs(gain) <= MIN_GAIN_SHARE * float(np.max(np.abs(y))):
        raise InputError("the step response returns to about 0, so it has no 63 % time")
    t, y = np.append(t[0] - data.Ts, t), np.append(0.0, y / gain)
    course = data.Ts * np.cumsum(y[1:]) if integrates else y[1:]
    crossing = rise_time(course, data.Ts, integrated=integrates)
    if np.isnan(crossing):
        raise InputError("the step response never reaches 63 % of its final value; record longer")
    dead = _dead_time(t, y, linear_crossing(t, y, 0.5), data.Ts)  # not part of any rule
    outside = np.flatnonzero(np.abs(y - 1) > 0.05)
    end = float(t[min(int(outside[-1]) + 1, y.size - 1)])
    return t - dead, y, gain, crossing - dead, end - dead


def _dead_time(t: Vector, y: Vector, half: float, Ts: float) -> float:
    """Return L from a fit of s (t - L)^p to the rise up to 50 %, p = 1 or 2; 0 if L may be 0."""
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
    return 0.0 if least[0] <= least[best] + 4 * variance else float(delays[best])


def _spectrum(data: Dataset, transient: float | None, *, integrates: bool) -> SpectralEstimate:
    """Return the frequency response (of the rate, if y integrates)."""
    # With `transient`, in s, u are steps, whose low-frequency power leaks through any lag window.
    if transient is None:
        estimate = spa(data, "log", integrator=integrates)
    else:
        # If the impulse response is truncated before the transient ends, its last lags are too
        # large, and noise appears in a band of frequencies. Noise may halve the measured transient,
        # so twice its length is used.
        n = int(np.clip(2 * transient / data.Ts, LAGS[0], MAX_STEP_LAGS))
        n = min(n, (data.N - data.missing) // 5)
        response = impulse_response(data, n, integrator=integrates)
        # At a frequency with less than one period in the shortest experiment, only the gain is
        # known.
        shortest = min(part.N for part in data.experiments())
        omega = np.geomspace(2 * np.pi / (shortest * data.Ts), np.pi / data.Ts, 300)
        estimate = response.spectrum(omega)
    return estimate.rate() if integrates else estimate


def _bandwidth(estimate: SpectralEstimate, gain: float) -> tuple[float, float]:
    """Return the first frequency with |G| < gain/sqrt(2), and the last with |G| > gain/sqrt(2)."""
    finite = np.isfinite(estimate.G)
    omega, magnitude = estimate.omega[finite], estimate.magnitude[finite]
    # By chance, |G| exceeds the level at some frequencies that contain only noise. If the coherence
    # excludes these frequencies, a margin of two standard deviations suffices; otherwise four are
    # needed.
    width = 4 if estimate.coherence is None else 2
    sure = magnitude - width * np.nan_to_num(estimate.std_magnitude[finite])
    if estimate.coherence is not None:
        sure = np.where(estimate.coherence[finite] > COHERENT, sure, -np.inf)
    level = gain / np.sqrt(2)
    below, above = np.flatnonzero(magnitude < level), np.flatnonzero(sure > level)

    def fall(j: int) -> float:
        """Return the interpolated frequency before point j at which |G| falls to the level."""
        if j == 0 or not magnitude[j] < level <= magnitude[j - 1]:
            return float(omega[j])
        share = (magnitude[j - 1] - level) / (magnitude[j - 1] - magnitude[j])
        return float(omega[j - 1] + share * (omega[j] - omega[j - 1]))

    first = fall(int(below[0]) if below.size else omega.size - 1)
    if above.size == 0:
        return first, first
    # Points below the level after the last point that is surely above the level.
    beyond = below[below > above[-1]]
    return first, fall(int(beyond[0]) if beyond.size else omega.size - 1)


def _power(data: Dataset, *, integrates: bool) -> tuple[Vector, Vector]:
    """Return frequencies and the spectrum of y (of its rate if y integrates), by Welch's method."""
    from scipy.signal import welch

    complete = fill_outputs(data, integrator=integrates)
    parts = [difference(part)[1:] if integrates else part for part in complete.experiments()]
    length = max(8, min(512, min(part.N for part in parts) // 2))
    taper = np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2
    omega, power = np.linspace(0, np.pi / data.Ts, 257)[1:], np.zeros(256)
    for y in (part.y for part in parts if length <= part.N):
        _, density = welch(
            y, window=taper, noverlap=length - length // 2, nfft=512, return_onesided=False
        )
        power += density[1:257] * ((y.size - length) // (length // 2) + 1)
    if not power.any():
        raise InputError(
            f"no {plural(length, 'sample')} in a row are of one experiment; record longer"
        )
    return omega, power


def _share(omega: Vector, power: Vector, above: float) -> float:
    return float(np.sum(power[omega > above]) / np.sum(power))


def _doubts(
    Ts: float, now: float, bandwidth: float, near: float, *, seen: bool, rate_of: str
) -> Iterator[str]:
    """Yield the reasons to record again; `rate_of` is the output whose rate was analysed, or ""."""
    if not seen:
        yield (
            f"63 % is reached within one sample of {times(now)}, so the data do not determine the "
            f"speed: record at {times(Ts)} and repeat the analysis. If the response then still "
            "ends within a sample, any Ts is suitable"
        )
        return
    if bandwidth > 0.4 * np.pi / now:
        yield (
            f"the bandwidth is {100 * bandwidth * now / np.pi:.0f} % of these data's Nyquist "
            f"frequency: record at {times(now / SPEED_UP)} and repeat the analysis"
        )
    if near > MIN_ALIASING_SHARE and not (rate_of and near < MOST_DIFFERENCED):
        yield (
            f"{digits(100 * near, 2)} % of the power is near Nyquist: noise or aliasing; compare "
            "with a faster recording before you trust the spectrum"
        )


def _reasons(
    Ts: float, now: float, rules: tuple[float, float, float], near: float, *, rate_of: str
) -> Iterator[str]:
    """Yield the reasons for the recommendation; `rate_of` as for `_doubts`."""
    names = ("the step's time constant", "the spectrum's bandwidth", "the transient")
    least, most = int(np.argmin(rules)), int(np.argmax(rules))
    yield (
        f"the shortest time decides, {times(rules[least])} by {names[least]}, rounded to "
        f"{times(Ts)} (1, 2 or 5 times a power of ten): a longer sampling time loses dynamics"
    )
    if rules[most] > 4 * rules[least]:
        yield (
            f"the rules differ by a factor {digits(rules[most] / rules[least], 2)}: the response "
            "rises fast and settles slowly, and the fast part decides"
        )
    if rate_of and MIN_ALIASING_SHARE < near < MOST_DIFFERENCED:
        yield (
            f"{digits(100 * near, 2)} % of the power is near Nyquist. White noise of {rate_of}, "
            f"differenced for the rate, has {100 * DIFFERENCED:g} % of its power there at any Ts, "
            "so a faster recording does not lower this share"
        )
    if Ts < now:
        yield "the recommended Ts is below the data's Ts; the data show nothing above their Nyquist"
