"""A frequency response estimated without a structure, and what came with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.data.treatment.integrating import rate_name
from armrig.numerics.polynomial import summation

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]
Complex = NDArray[np.complex128]
COHERENT = 0.5
"""Least coherence at which u explains y: half of the power of y."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SpectralEstimate:
    """G(exp(i omega Ts)) at some frequencies, with standard deviations where they are known."""

    omega: Vector
    """Frequencies in rad/s, (n,), rising."""
    G: Complex
    """Response, (n,), in y's unit per u's; NaN where u has no power."""
    std_magnitude: Vector
    """Of |G|, (n,); NaN where it is not known."""
    std_phase: Vector
    """Of arg G, (n,), in rad."""
    noise_spectrum: Vector | None = None
    """Phi_v, (n,), in y's unit squared times s: its integral over omega/(2 pi) is the variance."""
    noise_std: Vector | None = None
    """Of Phi_v, (n,)."""
    coherence: Vector | None = None
    """|Phi_yu|² / (Phi_u Phi_y), (n,), 0 to 1: the share of y's power that u explains."""
    noise_only_std: Vector | None = None
    """Of G by the noise alone, |.|, (n,) (see `bla`)."""
    nonlinear_std: Vector | None = None
    """Of G from realisation to realisation beyond the noise, |.|, (n,) (see `bla`)."""
    method: str
    """How it was estimated, in words."""
    integrator: bool
    """Estimated as the rate's and divided by 1 - q^-1."""
    N: int
    """Samples used."""
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
    notes: tuple[str, ...] = ()
    """What a reader should know."""

    @property
    def magnitude(self) -> Vector:
        """|G|, (n,)."""
        return np.asarray(np.abs(self.G))

    @property
    def phase(self) -> Vector:
        """Arg G in rad, (n,), unwrapped along omega; NaN stays NaN."""
        angle = np.angle(self.G)
        known = np.isfinite(angle)
        angle[known] = np.unwrap(angle[known])
        return np.asarray(angle)

    def rate(self) -> SpectralEstimate:
        """Return that of (y(t) - y(t-1))/Ts: everything times |1 - exp(-i omega Ts)|/Ts."""
        S = 1 / summation(self.omega, self.Ts)
        size = np.abs(S)

        def scaled(x: Vector | None, by: Vector) -> Vector | None:
            return None if x is None else x * by

        return replace(
            self,
            G=self.G * S,
            std_magnitude=self.std_magnitude * size,
            noise_spectrum=scaled(self.noise_spectrum, size**2),
            noise_std=scaled(self.noise_std, size**2),
            noise_only_std=scaled(self.noise_only_std, size),
            nonlinear_std=scaled(self.nonlinear_std, size),
            output=rate_name(self.output),
            unit=f"{self.unit}/s" if self.unit else "",
            integrator=False,
        )

    def to_control(self) -> control.FrequencyResponseData:
        """Return it as python-control's frequency response data, where G is known."""
        import control

        known = np.isfinite(self.G)
        return control.frd(self.G[known], self.omega[known], self.Ts)

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of magnitude and phase with ±2 σ: see `armrig.plots.plot_spectral`."""
        from armrig.models.spectral_figure import plot_spectral
        from armrig.plots.layout import figure_of

        return figure_of(plot_spectral(self, ax=ax))

    def __repr__(self) -> str:
        """Say it in a few lines."""
        w = self.omega
        lines = [
            f"frequency response to {self.output}: {self.method}",
            f"  {w.size} frequencies, {w[0]:.4g} … {w[-1]:.4g} rad/s (Nyquist "
            f"{np.pi / self.Ts:.4g}), {self.N} samples at {self.Ts:g} s",
        ]
        if self.integrator:
            lines.append("  estimated as the rate's and integrated: y integrates its input")
        for i in np.unique(np.linspace(0, w.size - 1, 5).round().astype(int)):
            std, phase = self.std_magnitude[i], np.degrees(self.std_phase[i])
            known = f" ± {std:.2g}" if np.isfinite(std) else ""
            degrees = f" ± {phase:.2g}" if np.isfinite(phase) else ""
            coherence = f", coherence {self.coherence[i]:.3f}" if self.coherence is not None else ""
            lines.append(
                f"  {w[i]:9.4g} rad/s  |G| {abs(self.G[i]):.4g}{known}, "
                f"arg G {np.degrees(np.angle(self.G[i])):.1f}{degrees}°{coherence}"
            )
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])
