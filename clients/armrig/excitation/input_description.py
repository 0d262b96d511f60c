"""Description of an input: levels, spectrum, order of persistence of excitation, and a figure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.data.columns import Vector, interval
from armrig.data.dataset import Dataset
from armrig.numerics.checks import column
from armrig.numerics.least_squares import triangle
from armrig.numerics.power_spectrum import power_spectrum
from armrig.numerics.quantities import digits, plural
from armrig.numerics.regressors import in_blocks
from armrig.plots.layout import BLUE, INK, SKY, finish, hertz, stack_panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure


HIGHEST_ORDER = 50
"""Highest tested order of persistence of excitation."""
# A singular value below this share of the largest singular value is a rounding error.
_RANK_TOLERANCE = 1e-8
_MAX_LEVELS = 20
_BINS = 10
_BLOCK_ROWS = 10_000
_MAX_SHOWN_SAMPLES = 1000  # more samples would look like a solid bar


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class InputDescription:
    """Result of `describe_input`, with a description in words (repr) and a figure (`plot`)."""

    u: Vector
    """Input (N,), in V."""
    Ts: float
    """Sampling time, in s."""
    mean: float
    """Mean, in V."""
    std: float
    """Standard deviation (effective value about the mean), in V."""
    crest_factor: float
    """Largest |u - mean| divided by `std`: 1 for two equally frequent levels; NaN for a constant
    u."""
    order: int
    """Order of persistence of excitation, 0 to `highest_order`."""
    highest_order: int
    """Highest tested order. If `order` equals this number, the true order may be higher."""
    weakest: float
    """Least eigenvalue of the covariance matrix of `order` consecutive samples, divided by var u.

    With white noise the ratio is 1. In the direction of the corresponding eigenvector, the variance
    of estimated parameters is 1/weakest times as large as with white noise of the same power.
    """
    omega: Vector
    """Frequencies of `spectrum`, in rad/s; empty if u is shorter than 16 samples."""
    spectrum: Vector
    """One-sided power density, in V² per rad/s."""
    levels: Vector
    """Values of u, in V, or the centres of ten bins if u has more than 20 values."""
    shares: Vector
    """Share of the time at each level, or in each bin; the sum is 1."""
    binned: bool
    """True if `levels` are centres of bins."""

    def plot(self) -> Figure:
        """Return a figure of the input against time, its spectrum and its levels."""
        return plot_input(self)

    def __repr__(self) -> str:
        """Describe the input in a few lines."""
        N = self.u.size
        at_least = "at least " if self.order == self.highest_order else ""
        kind = "in each tenth of the range" if self.binned else "at each level"
        times = ", ".join(
            f"{digits(v, 3)} V {100 * p:.0f} %"
            for v, p in zip(self.levels, self.shares, strict=True)
        )
        lines = [
            f"input of {plural(N, 'sample')} at {self.Ts:g} s ({N * self.Ts:g} s), "
            f"{self.u.min():.4g} to {self.u.max():.4g} V",
            f"  mean {self.mean:.4g} V, effective value about it {self.std:.4g} V, "
            f"crest factor {digits(self.crest_factor, 3)}",
            f"  persistently exciting of order {at_least}{self.order}: {self._meaning()}",
            f"  time {kind}: {times}",
        ]
        if self.omega.size and self.std > 0:
            total = np.cumsum(self.spectrum)
            half = float(self.omega[np.searchsorted(total / total[-1], 0.5)])
            lines.append(
                f"  half of the power below {digits(half, 3)} rad/s (Nyquist "
                f"{np.pi / self.Ts:.4g} rad/s)"
            )
        return "\n".join(lines)

    def _meaning(self) -> str:
        if self.order < 2:
            return "it determines a static gain, but no dynamics; use more switches"
        more = ", and perhaps for more" if self.order == self.highest_order else ""
        many = (
            f"enough for {plural(self.order, 'parameter')} of B and F (or B and A) together{more}"
        )
        return f"{many}; least power {digits(self.weakest, 2)} times the power of white noise"


def describe_input(u: ArrayLike, Ts: float) -> InputDescription:
    """Describe an input before a run: spectrum, crest factor, excitation and levels.

    An input is persistently exciting of order n if the covariance matrix of n consecutive samples
    is positive definite. A model with nb + nf parameters needs the order nb + nf. The order is
    computed for each half of u, and the lower order is returned. Therefore an input that moves only
    once, such as a step, has order 1. The computed order is limited by double precision. For sines
    in a narrow band (a chirp, a multisine of low frequencies) the computed order is less than twice
    the number of sines. The reason is that a few consecutive samples hardly distinguish the sines.

    Parameters
    ----------
    u : array_like, shape (N,)
        Input in V, including its mean.
    Ts : float
        Sampling time in s.

    Returns
    -------
    InputDescription
        Description with the order, the spectrum and the levels.

    Raises
    ------
    ValueError
        u does not have the shape (N,), u is not finite, or Ts is not > 0.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 13.2 and 13.3.

    Examples
    --------
    >>> import armrig
    >>> found = armrig.describe_input(armrig.telegraph(1000, 0.05), Ts=0.01)
    >>> found.order
    50
    >>> print(found)
    input of 1000 samples at 0.01 s (10 s), 0.5 to 4.5 V
      mean 2.744 V, effective value about it 1.985 V, crest factor 1.13
      ...
    """
    u_ = column("u", u)
    if not np.isfinite(u_).all():
        raise InputError(
            f"u is not finite at {int(np.argmax(~np.isfinite(u_)))}; every sample needs a voltage"
        )
    Ts = interval(Ts)
    u_.flags.writeable = False
    mean, std = float(np.mean(u_)), float(np.std(u_))
    std = 0.0 if np.ptp(u_) == 0 else std  # the computed std of a constant is a rounding error
    highest = max(1, min(HIGHEST_ORDER, (u_.size // 2 + 1) // 3))
    halves = np.split(u_, [u_.size // 2]) if u_.size > 1 else [u_]
    order, weakest = min(_excitation(half, highest) for half in halves)
    omega, spectrum = power_spectrum([u_], Ts) if u_.size >= 16 else (np.zeros(0), np.zeros(0))
    levels, shares, binned = _levels(u_)
    return InputDescription(
        u=u_,
        Ts=Ts,
        mean=mean,
        std=std,
        crest_factor=float(np.max(np.abs(u_ - mean))) / std if std > 0 else float("nan"),
        order=order,
        highest_order=highest,
        weakest=weakest / std**2 if std > 0 else 0.0,
        omega=omega,
        spectrum=spectrum,
        levels=levels,
        shares=shares,
        binned=binned,
    )


def excitation_order(data: Dataset) -> int:
    """Return the order of persistence of excitation of the best experiment."""
    return max(describe_input(part.u, data.Ts).order for part in data.experiments())


def _excitation(u: Vector, highest: int) -> tuple[int, float]:
    """Return the order n of excitation, and the least eigenvalue of the (n, n) covariance."""
    windows = np.lib.stride_tricks.sliding_window_view(u, highest)
    R = triangle(in_blocks(windows, _BLOCK_ROWS), highest) / np.sqrt(windows.shape[0])
    order, weakest = 0, 0.0
    for n in range(1, highest + 1):
        # R[:n, :n] is the triangular factor of the first n columns, so one QR is enough for all n.
        sizes = np.linalg.svd(R[:n, :n], compute_uv=False)
        if not sizes[-1] > _RANK_TOLERANCE * sizes[0]:
            break
        order, weakest = n, float(sizes[-1]) ** 2
    return order, weakest


def _levels(u: Vector) -> tuple[Vector, Vector, bool]:
    values, counts = np.unique(u, return_counts=True)
    if values.size <= _MAX_LEVELS:
        return values, counts / u.size, False
    counts, edges = np.histogram(u, bins=_BINS)
    return (edges[:-1] + edges[1:]) / 2, counts / u.size, True


def plot_input(description: InputDescription) -> Figure:
    """Return a figure of an input: its first samples, its spectrum, and the time at each level."""
    d = description
    figure, (time, spectrum, levels) = stack_panels((6.5, 7.0), (1, 1.2, 0.8))
    count = min(_MAX_SHOWN_SAMPLES, d.u.size)
    note = "" if count == d.u.size else f", the first {count} of {d.u.size} samples"
    time.step(d.Ts * np.arange(count), d.u[:count], where="post", color=INK, lw=0.8)
    time.set_xlabel(f"$t$ [s]{note}")
    time.set_ylabel("$u$ [V]")
    if d.omega.size and d.std > 0:
        # Omit both ends: a logarithmic axis has no 0, and the density at Nyquist is not doubled.
        omega, density = d.omega[1:-1], d.spectrum[1:-1]
        spectrum.plot(omega, np.maximum(density, 1e-300), color=BLUE, lw=1.0)
        spectrum.set_xscale("log")
        spectrum.set_yscale("log")
        top = float(density.max())
        bottom = max(float(density.min()), 1e-8 * top)
        spectrum.set_ylim(bottom / 2, 2 * top)
        spectrum.set_xlim(float(omega[0]), np.pi / d.Ts)
        hertz(spectrum)
    else:
        spectrum.text(
            0.5, 0.5, "no power except the mean's", ha="center", transform=spectrum.transAxes
        )
    spectrum.set_xlabel(r"$\omega$ [rad/s], up to the Nyquist frequency")
    spectrum.set_ylabel("power [V² s/rad]")
    span = float(np.ptp(d.levels)) or 1.0
    width = span / 10 if d.binned else span / 40
    levels.bar(d.levels, 100 * d.shares, width=width, color=SKY, edgecolor=BLUE, lw=0.5)
    levels.set_xlabel("$u$ [V]")
    levels.set_ylabel("time [%]")
    at_least = "at least " if d.order == d.highest_order else ""
    time.set_title(
        f"crest factor {d.crest_factor:.2f}, persistently exciting of order {at_least}{d.order}",
        loc="left",
        fontsize="medium",
    )
    for panel in (time, spectrum, levels):
        finish(panel)
    return figure
