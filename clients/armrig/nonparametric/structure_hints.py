"""What spectrum, phase and resonances say on order, integrator and delay (handout, 3.2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.treatment import INTEGRATING_OUTPUTS
from armrig.models.spectral_estimate import SpectralEstimate
from armrig.nonparametric.coherence import explained
from armrig.nonparametric.impulse import ImpulseResponse, impulse_response, long_enough
from armrig.nonparametric.spectral import spa
from armrig.numerics.quantile import two_sided
from armrig.numerics.quantities import minus, plural, times

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

PROMINENT_DB = 2.0  # least height of a resonance over its surroundings
HIDDEN = 0.05  # share of the largest coefficient that may hide where a delay is claimed
SURE = 3.0  # standard deviations by which a resonance stands out from either side
STAYS = 0.3  # of the largest answer of the rate to a step: less is on its way to 0
DRAWS = 200  # of the impulse response's uncertainty
LAGS = (100, 200, 400)  # of the impulse response, the next where the last are too few


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class StructureHints:
    """Orders, integrator and delay suggested by estimates without a structure."""

    integrator: bool
    """The rate has a gain at low frequency, and stays up after a step: y integrates."""
    low_slope: float
    """Of |G| at low frequency, in dB a decade: 0 for a gain, -20 for an integrator."""
    low_slope_std: float
    """Its standard deviation."""
    high_slope: float
    """Of |G| over the last third of a decade in which u explains y, in dB a decade."""
    relative_degree: int
    """Poles less zeros, from the high slope; 0 where it does not fall."""
    resonances: tuple[float, ...]
    """Frequencies of peaks (of the rate's |G|, if y integrates), in rad/s."""
    antiresonances: tuple[float, ...]
    """Frequencies of dips, in rad/s."""
    phase_delay: float
    """Phase at the highest frequencies beyond what their slope accounts for, as a time in s."""
    first_lag: int
    """First lag at which u is seen to act (99 %): nk is not larger."""
    blind: float
    """99 % band of the coefficients before it over the largest: what may hide there."""
    nk: int
    """Suggested: `first_lag` where hardly anything can hide before it, else 1."""
    singular_values: Vector
    """Of the Hankel matrix of the response that dies out, over the largest."""
    threshold: float
    """What the response's uncertainty alone makes of them (95 %), over the largest."""
    order: int
    """Singular values above the threshold, and one for an integrator."""
    nf: int
    """Suggested: the largest of what the arguments ask for."""
    nb: int
    """Suggested: as many as poles, since sampling makes the zeros up to one less than poles."""
    trusted: float
    """Highest frequency at which u explains y, in rad/s."""
    spectrum: SpectralEstimate
    """Frequency response of y."""
    response: ImpulseResponse
    """Regularised impulse response."""

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of |G| with what was read off it: see `armrig.plots.plot_structure`."""
        from armrig.canvas import figure_of
        from armrig.nonparametric.figures import plot_structure

        return figure_of(plot_structure(self, ax=ax))

    def explain(self) -> str:
        """Return the argument, point by point."""
        return "\n".join(f"- {line}" for line in _reasons(self))

    def __repr__(self) -> str:
        """Say it in a few lines."""
        first = f"oe(data, nb={self.nb}, nf={self.nf}, nk={self.nk}, integrator={self.integrator})"
        return f"structure hints: begin with {first}\n" + "\n".join(
            f"  {line}" for line in _reasons(self)
        )


@takes_recordings
def structure_hints(
    data: Dataset,
    *,
    integrator: bool | None = None,
    seed: int | np.random.Generator = 0,
) -> StructureHints:
    """Read order, integrator and delay off estimates that assume no structure.

    - Integrator: the slope of |G| of the rate at low frequency. A rate with a gain (slope 0)
      belongs to a y that integrates (-20 dB a decade); without an integrator the rate's slope
      is +20 dB a decade. y itself, which drifts, is not looked at. A slow pole has the slope of an
      integrator, too, down to frequencies that the record hardly has; but the rate's answer to a
      step returns to 0 then, where that of an integrator stays up. theta_1 is known to integrate,
      and is taken so unless that answer surely returns: another rig has the arm's names.
    - Order: singular values of the Hankel matrix of the regularised impulse response above what
      draws from its own uncertainty make; twice the number of resonances at least.
    - Poles less zeros: the slope at the highest frequencies at which u explains y (coherence above
      one half), 20 dB a decade each; sampling hides it near Nyquist.
    - Delay: the first coefficient of the plain impulse response outside its 99 % band, and the
      phase beyond what the roll-off accounts for.

    Parameters
    ----------
    data : Dataset
        Of an input that excites; missing samples and several experiments are allowed.
    integrator : bool, optional
        Whether y integrates; by default read from the data.
    seed : int or numpy.random.Generator, default 0
        For the draws.

    Returns
    -------
    StructureHints
        Figures, and in words by its repr or explain().

    Raises
    ------
    ValueError
        There are too few samples, or u explains y at hardly any frequency.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 16.2 and 16.3.
    .. [2] S. Y. Kung, Proc. 12th Asilomar Conf., 1978, 705-714 (Hankel singular values).
    """
    rate = spa(data, "log", integrator=True).rate()
    slope, slope_std = _low_slope(rate, explained(rate))
    of_rate = None
    integrates = integrator
    if integrates is None:
        known = data.output in INTEGRATING_OUTPUTS
        integrates = known or slope < 10 - 2 * slope_std
        if integrates:
            of_rate = long_enough(data, LAGS, integrator=True)
            integrates = not _returns(of_rate) if known else _stays(of_rate)
    first_lag, blind = _first_lag(data, integrates=integrates)
    nk = first_lag if first_lag < 1 or blind < HIDDEN else 1
    spectrum = spa(data, "log", delay=max(nk - 1, 0), integrator=integrates)
    believed = explained(spectrum)
    response = of_rate if integrates else None
    response = response or long_enough(data, LAGS, integrator=integrates)
    peaks, dips = _extremes(response, spectrum.omega[believed])
    values, threshold = _hankel(response, max(nk, 1), np.random.default_rng(seed))
    order = int(np.count_nonzero(values > threshold))
    high = _high_slope(spectrum, believed)
    degree = max(0, round(-high / 20))
    nf = max(order, 2 * len(peaks), 0 if integrates else 1) + integrates
    return StructureHints(
        integrator=integrates,
        low_slope=slope - 20,
        low_slope_std=slope_std,
        high_slope=high,
        relative_degree=degree,
        resonances=peaks,
        antiresonances=dips,
        phase_delay=_phase_delay(
            spectrum, believed, high, sign=_sign(response), shown=max(nk - 1, 0) * data.Ts
        ),
        first_lag=first_lag,
        blind=blind,
        nk=nk,
        singular_values=values,
        threshold=threshold,
        order=order + integrates,
        nf=nf,
        nb=nf,
        trusted=float(spectrum.omega[believed][-1]),
        spectrum=spectrum,
        response=response,
    )


def _stays(of_rate: ImpulseResponse) -> bool:
    """Tell whether the rate's answer to a step ends above a share of its largest, and not at 0."""
    end, std = _end_of_step(of_rate)
    return end > max(STAYS, SURE * std)


def _returns(of_rate: ImpulseResponse) -> bool:
    """Tell whether the rate's answer to a step ends surely below a share of its largest value."""
    end, std = _end_of_step(of_rate)
    return end + SURE * std < STAYS


def _end_of_step(of_rate: ImpulseResponse) -> tuple[float, float]:
    """Return where the rate's answer to a step ends, and its deviation, over its largest value."""
    g, _ = of_rate.decaying
    steps = np.abs(np.cumsum(g))
    largest = float(np.max(steps))
    return float(steps[-1]) / largest, float(np.sqrt(_covariance(of_rate).sum())) / largest


def _first_lag(data: Dataset, *, integrates: bool) -> tuple[int, float]:
    """Return the first lag at which u is seen to act, and what may hide before it, by share."""
    plain = impulse_response(data, min(30, data.N // 10), kernel=None, integrator=integrates)
    first_lag = plain.first_lag() or 0
    g, std = plain.decaying
    return first_lag, two_sided(0.99) * float(np.max(std[: max(first_lag, 1)]) / np.max(np.abs(g)))


def _slope(omega: Vector, magnitude: Vector) -> tuple[float, float]:
    """Return the slope in dB a decade of a straight line, and its standard deviation."""
    x, y = np.log10(omega), 20 * np.log10(magnitude)
    x = x - x.mean()
    slope = float(x @ y / (x @ x))
    scatter = float(np.sum((y - y.mean() - slope * x) ** 2)) / max(x.size - 2, 1)
    return slope, float(np.sqrt(scatter / (x @ x)))


def _low_slope(rate: SpectralEstimate, believed: NDArray[np.int_]) -> tuple[float, float]:
    """Return the slope over the lowest half decade."""
    low = believed[rate.omega[believed] <= rate.omega[believed[0]] * np.sqrt(10)]
    low = low if low.size >= 3 else believed[:3]
    return _slope(rate.omega[low], rate.magnitude[low])


def _high_slope(spectrum: SpectralEstimate, believed: NDArray[np.int_]) -> float:
    """Return the slope over the last third of a decade, below 0.6 of Nyquist where possible."""
    high = _high(spectrum, believed)
    return _slope(spectrum.omega[high], spectrum.magnitude[high])[0]


def _high(spectrum: SpectralEstimate, believed: NDArray[np.int_]) -> NDArray[np.int_]:
    """Return the indices of the last third of a decade."""
    omega = spectrum.omega[believed]
    top = min(float(omega[-1]), 0.6 * np.pi / spectrum.Ts)
    high = believed[(omega <= top) & (omega >= top / 10 ** (1 / 3))]
    return high if high.size >= 3 else believed[-3:]


def _sign(response: ImpulseResponse) -> float:
    """Return the sign of the steady answer: of a negative one the phase begins at 180°."""
    return -1.0 if float(np.sum(response.decaying[0])) < 0 else 1.0


def _phase_delay(
    spectrum: SpectralEstimate,
    believed: NDArray[np.int_],
    slope: float,
    *,
    sign: float,
    shown: float,
) -> float:
    """Return -(arg sign G - 90° slope/20)/omega over the last third of a decade, in s.

    Only what exceeds the delay `shown`, in s, is read off the phase, which is known up to turns.
    A minimum-phase system's phase is 90° for each 20 dB a decade of slope, nearly so where the
    slope changes little (H. W. Bode, *Network Analysis and Feedback Amplifier Design*, 1945).
    """
    high = _high(spectrum, believed)
    expected = np.pi / 2 * slope / 20
    omega = spectrum.omega[high]
    excess = np.angle(sign * spectrum.G[high] * np.exp(1j * (omega * shown - expected)))
    return shown - float(np.mean(excess / omega))


def _extremes(
    response: ImpulseResponse, believed: Vector
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the frequencies of peaks and dips that surely stand out from both sides.

    From the transform of the impulse response: a lag window blunts them, the more the longer
    the delay. |G| at the extreme and at the foot on either side differ by `SURE` standard
    deviations of that difference, and the feet lie further apart than the n lags resolve,
    2 pi/(n Ts).
    """
    from scipy.signal import find_peaks

    omega = np.geomspace(believed[0], believed[-1], 300)
    g, _ = response.decaying
    turn = np.exp(-1j * np.outer(omega, response.lags) * response.Ts)
    G = turn @ g
    # d|G| = along @ dg
    along = np.real(turn * np.exp(-1j * np.angle(G))[:, None])
    magnitude, covariance = np.abs(G), _covariance(response)
    resolved = 2 * np.pi / (g.size * response.Ts)

    def sure(at: int, foot: int) -> bool:
        d = along[at] - along[foot]
        std = np.sqrt(max(float(d @ covariance @ d), 0.0))
        return bool(abs(magnitude[at] - magnitude[foot]) > SURE * std)

    found = []
    for x in (magnitude, 1 / magnitude):
        at, of = find_peaks(20 * np.log10(x), prominence=PROMINENT_DB)
        feet = zip(at, of["left_bases"], of["right_bases"], strict=True)
        found.append(
            tuple(
                float(omega[i])
                for i, left, right in feet
                if omega[right] - omega[left] > resolved and sure(i, left) and sure(i, right)
            )
        )
    return found[0], found[1]


def _covariance(response: ImpulseResponse) -> Matrix:
    """Return that of the response that dies out."""
    rate = response.rate_covariance
    return response.covariance if rate is None else rate


def _hankel(response: ImpulseResponse, nk: int, rng: np.random.Generator) -> tuple[Vector, float]:
    """Return singular values and the threshold, both over the largest, from lag nk on."""
    g, _ = response.decaying
    # The rate's backward difference is itself a state, a pole at 0 that acts on g(nk) alone.
    h = g[nk + 1 :] if response.integrator else g[nk:]
    m = (h.size + 1) // 2
    index = np.add.outer(np.arange(m), np.arange(h.size - m + 1))
    values = np.linalg.svd(h[index], compute_uv=False)
    draws = rng.multivariate_normal(
        np.zeros(g.size), _covariance(response), size=DRAWS, method="eigh"
    )[:, g.size - h.size :]
    norms = np.linalg.norm(draws[:, index], ord=2, axis=(1, 2))
    return values / values[0], float(np.quantile(norms, 0.95)) / float(values[0])


def _standing(n: int) -> str:
    return f"{n or 'none'} {'stands' if n <= 1 else 'stand'} out"


def _extremes_told(h: StructureHints) -> str:
    """Return which resonances and antiresonances stand out, and what they want."""
    told = []
    for x, name, wants in (
        (h.resonances, "resonance", "poles"),
        (h.antiresonances, "antiresonance", "zeros"),
    ):
        at = ", ".join(f"{w:.3g}" for w in x)
        several, each = ("s", " each") if len(x) > 1 else ("", "")
        told.append(f"{name}{several} at {at} rad/s (two {wants}{each})" if x else f"no {name}")
    return ", ".join(told)


def _reasons(h: StructureHints) -> Iterator[str]:
    what = "the rate" if h.integrator else "y"
    verdict = "y integrates: fix a pole at 1" if h.integrator else "no integrator"
    if not h.integrator and h.low_slope < -10:
        verdict = f"a slow pole, and {verdict}, since what a pulse of u does to y dies out"
    yield (
        f"integrator: |G| has a slope of {minus(f'{h.low_slope:.1f}')} ± {h.low_slope_std:.1f} dB "
        f"a decade at low frequency (0 without one, −20 with one): {verdict}"
    )
    yield f"shape of {what}: {_extremes_told(h)}"
    shown = ", ".join(f"{v:.2g}" for v in h.singular_values[:6])
    yield (
        f"order: Hankel singular values {shown} …, uncertainty alone makes {h.threshold:.2g}: "
        + _standing(h.order - h.integrator)
        + (", and the integrator" if h.integrator else "")
    )
    excess = plural(h.relative_degree, "more pole") if h.relative_degree else "no more poles"
    yield (
        f"roll-off: {minus(f'{h.high_slope:.0f}')} dB a decade below {h.trusted:.3g} rad/s, the "
        f"last frequency at which u explains y: {excess} than zeros up to there"
    )
    if h.phase_delay > h.spectrum.Ts / 2:
        yield (
            f"phase: beyond what the roll-off accounts for it lags like {times(h.phase_delay)} of "
            f"delay, {times(h.spectrum.Ts / 2)} of which are the hold's half sample"
        )
    else:
        yield "phase: it lags no more than roll-off and hold account for"
    known = f"u acts at lag {h.first_lag} at the latest (99 %)"
    if h.first_lag > 1 and h.nk == 1:
        hidden = f"before it {100 * h.blind:.0f} % of the largest coefficient could hide: no delay"
        yield f"delay: {known}; {hidden} is shown (armrig.delay, `armrig check` test it)"
    elif h.nk == 0:
        which = "a direct term, or feedback, which looks the same"
        yield f"delay: u acts at lag 0 (99 %): {which} (nk = 0)"
    else:
        delay = f"an input delay of {plural(h.nk - 1, 'sample')}"
        delay = delay if h.nk > 1 else "no input delay"
        yield f"delay: {known}: {delay} (nk = {h.nk})"
