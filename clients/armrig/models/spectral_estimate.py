"""Nonparametric estimate of a frequency response, with noise spectrum, coherence and figure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import OfDataset
from armrig.data.step import with_notes
from armrig.data.treatment.integrating import rate_name
from armrig.models.state_space import Complex, Vector
from armrig.numerics.confidence_regions import HALF_WIDTH
from armrig.numerics.polynomial import summation
from armrig.numerics.quantities import digits, plural
from armrig.plots.captions import legend, sign
from armrig.plots.layout import (
    BLUE,
    GREEN,
    GREY,
    SKY,
    VERMILION,
    bare_minor,
    decibel_ticks,
    decibels,
    finish,
    hertz,
    panels,
    plot_method,
)

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes

COHERENT = 0.5
"""Least coherence at which u counts as explaining y. The coherence is the share of y's power that u
explains."""


def gain_unit(result: Any, *, rate: bool = False) -> str:
    """Return the unit of y, or of its rate, per unit of u."""
    unit = f"{result.unit}/s" if rate and result.unit else result.unit
    return f"{unit or '–'}/{result.input_unit}" if result.input_unit else unit or "–"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SpectralEstimate(OfDataset):
    """Estimate of G(exp(i omega Ts)) at some frequencies, with standard deviations if known."""

    omega: Vector
    """Frequencies in rad/s, (n,), in ascending order."""
    G: Complex
    """Response, (n,), in units of y per unit of u; NaN if u has no power."""
    std_magnitude: Vector
    """Standard deviation of |G|, (n,); NaN if it is not known."""
    std_phase: Vector
    """Standard deviation of arg G, (n,), in rad."""
    noise_spectrum: Vector | None = None
    """Noise spectrum Phi_v, (n,), in (unit of y)² s. The integral of Phi_v/(2 pi) over omega is the
    variance of the noise."""
    noise_std: Vector | None = None
    """Standard deviation of Phi_v, (n,)."""
    coherence: Vector | None = None
    """|Phi_yu|² / (Phi_u Phi_y), (n,), 0 to 1: the share of y's power that u explains."""
    noise_only_std: Vector | None = None
    """Standard deviation of G due to the noise alone, (n,) (see `bla`)."""
    nonlinear_std: Vector | None = None
    """Standard deviation of G due to the nonlinearity, (n,): the scatter between realisations
    without the part due to noise (see `bla`)."""
    method: str
    """Method of the estimate, as text."""
    integrator: bool
    """True if the response of the rate of y was estimated and then divided by 1 - q^-1."""
    N: int
    """Number of samples used."""
    notes: tuple[str, ...] = ()
    """Notes on the reliability of the estimate."""

    @property
    def magnitude(self) -> Vector:
        """Magnitude |G|, (n,)."""
        return np.asarray(np.abs(self.G))

    @property
    def phase(self) -> Vector:
        """Phase arg G in rad, (n,), unwrapped along omega; NaN stays NaN."""
        angle = np.angle(self.G)
        finite = np.isfinite(angle)
        angle[finite] = np.unwrap(angle[finite])
        return np.asarray(angle)

    def rate(self) -> SpectralEstimate:
        """Return the estimate for (y(t) - y(t-1))/Ts: G times (1 - exp(-i omega Ts))/Ts."""
        S = 1 / summation(self.omega, self.Ts)
        powers = {"std_magnitude": 1, "noise_only_std": 1, "nonlinear_std": 1}
        powers |= {"noise_spectrum": 2, "noise_std": 2}
        spectra = {name: x for name in powers if (x := getattr(self, name)) is not None}
        return replace(
            self,
            G=self.G * S,
            **{name: x * np.abs(S) ** powers[name] for name, x in spectra.items()},
            output=rate_name(self.output),
            unit=f"{self.unit}/s" if self.unit else "",
            integrator=False,
        )

    def to_control(self) -> control.FrequencyResponseData:
        """Return the known values of G as python-control frequency response data."""
        import control

        finite = np.isfinite(self.G)
        return control.frd(self.G[finite], self.omega[finite], self.Ts)

    plot = plot_method("plot_spectral", "magnitude and phase with 95 % bands")

    def __repr__(self) -> str:
        """Return the estimate as a few lines of text."""
        w = self.omega
        lines = [
            f"frequency response to {self.output}: {self.method}",
            f"  {w.size} frequencies, {w[0]:.4g} … {w[-1]:.4g} rad/s (Nyquist "
            f"{np.pi / self.Ts:.4g}), {plural(self.N, 'sample')} at {self.Ts:g} s",
        ]
        if self.integrator:
            lines.append("  y integrates: the response of its rate was estimated, then integrated")
        for i in np.unique(np.linspace(0, w.size - 1, 5).round().astype(int)):
            std, phase = self.std_magnitude[i], np.degrees(self.std_phase[i])
            deviation = f" ± {digits(std, 2)}" if np.isfinite(std) else ""
            degrees = f" ± {digits(phase, 2)}" if np.isfinite(phase) else ""
            coherence = f", coherence {self.coherence[i]:.3f}" if self.coherence is not None else ""
            lines.append(
                f"  {w[i]:9.4g} rad/s  |G| {abs(self.G[i]):.4g}{deviation}, "
                f"arg G {np.degrees(np.angle(self.G[i])):.1f}{degrees}°{coherence}"
            )
        return with_notes(lines, self.notes, "note")


def log_slope(omega: Vector, magnitude: Vector) -> float:
    """Return the slope of a line fitted to |G|, in dB per decade; NaN without frequencies."""
    if not omega.size:
        return float("nan")
    x = np.log10(omega) - np.mean(np.log10(omega))
    return float(x @ (20 * np.log10(magnitude)) / (x @ x))


def low_slope(estimate: SpectralEstimate, believed: NDArray[np.int_]) -> tuple[float, Vector]:
    """Return the slope of |G| at low frequency, and the frequencies.

    Of the frequencies with the indices `believed`, the lowest half decade is used. If the half
    decade contains fewer than three of these frequencies, the three lowest are used.
    """
    low = believed[estimate.omega[believed] <= estimate.omega[believed[:1]] * np.sqrt(10)]
    low = low if low.size >= 3 else believed[:3]
    return log_slope(estimate.omega[low], estimate.magnitude[low]), estimate.omega[low]


def high_slope(estimate: SpectralEstimate, believed: NDArray[np.int_]) -> float:
    """Return the slope of |G| over `high_band`, in dB per decade; NaN if `believed` is empty."""
    high = high_band(estimate, believed)
    return log_slope(estimate.omega[high], estimate.magnitude[high])


def high_band(estimate: SpectralEstimate, believed: NDArray[np.int_]) -> NDArray[np.int_]:
    """Return those indices in `believed` whose frequencies are in the highest third of a decade.

    If possible, the frequencies are below 0.6 times the Nyquist frequency. If fewer than three
    frequencies are in this range, the three highest frequencies are returned.
    """
    omega = estimate.omega[believed]
    top = np.minimum(omega[-1:], 0.6 * np.pi / estimate.Ts)
    high = believed[(omega <= top) & (omega >= top / 10 ** (1 / 3))]
    return high if high.size >= 3 else believed[-3:]


def plot_spectral(estimate: SpectralEstimate, *, ax: Axes | None = None) -> Axes:
    """Plot magnitude and phase with 95 % bands, and coherence if it is known."""
    ax, below = panels(ax, 0.36)
    w, G = estimate.omega, estimate.G
    usable = np.isfinite(G) & (w > 0) & (np.abs(G) > 0)
    w, magnitude = w[usable], np.abs(G[usable])
    phase = np.degrees(estimate.phase[usable])
    # The phase is unwrapped from the lowest frequency, at which it is between -360° and 0°.
    phase = phase - 360 * np.ceil(phase[0] / 360) if phase.size else phase
    lines = w.size < 200 and estimate.coherence is None
    style: dict[str, Any] = {"marker": "o", "ms": 2.5, "lw": 0.6} if lines else {"lw": 1.1}
    std, across = estimate.std_magnitude[usable], np.degrees(estimate.std_phase[usable])
    if np.isfinite(std).any():
        width = HALF_WIDTH * np.nan_to_num(std)
        low, high = np.maximum(magnitude - width, 0.03 * magnitude), magnitude + width
        shaded: dict[str, Any] = {"color": SKY, "alpha": 0.45, "lw": 0}
        ax.fill_between(w, decibels(low), decibels(high), label="95 %", **shaded)
        reach = np.minimum(HALF_WIDTH * np.nan_to_num(across), 180)
        below.fill_between(w, phase - reach, phase + reach, **shaded)
    ax.plot(w, decibels(magnitude), color=BLUE, label=estimate.method.split(",")[0], **style)
    below.plot(w, phase, color=BLUE, **style)
    distortion, noise = estimate.nonlinear_std, estimate.noise_only_std
    if distortion is not None and noise is not None and np.isfinite(distortion).any():
        for x, name, colour, dash in (
            (distortion, "nonlinear distortion (one realisation)", VERMILION, "--"),
            (noise, "noise", GREEN, ":"),
        ):
            curve = np.where(x[usable] > 0, x[usable], np.nan)
            ax.plot(w, decibels(curve), color=colour, ls=dash, lw=1.0, label=name)
    ax.set_xscale("log")
    if phase.size:
        ticks = 90 * np.arange(np.floor(phase.min() / 90), np.ceil(phase.max() / 90) + 1)
        below.set_yticks(ticks[:: max(1, ticks.size // 6)])
        below.set_ylim(phase.min() - 60, phase.max() + 60)
    ax.set_ylabel(f"$|G|$ [dB re 1 {gain_unit(estimate)}]")
    below.set_ylabel("arg $G$ [°]")
    decibel_ticks(ax)
    below.set_xlabel(r"$\omega$ [rad/s]")
    bare_minor(below.xaxis)
    finish(ax, below, xlim=(float(w[0]), float(w[-1])) if w.size > 1 else None)
    lift = hertz(ax)
    if estimate.coherence is not None:
        other = ax.twinx()
        other.plot(w, estimate.coherence[usable], color=GREY, lw=0.8, ls="--")
        other.set_ylim(0, 1.02)
        other.set_ylabel("coherence", color=GREY)
        other.tick_params(colors=GREY)
        other.spines["top"].set_visible(False)
        ax.plot([], [], color=GREY, lw=0.8, ls="--", label="coherence")
    return sign(ax, estimate.source, above=legend(ax, lift=lift))
