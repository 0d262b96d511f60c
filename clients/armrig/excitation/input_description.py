"""What an input can teach: its levels, its spectrum, and how many parameters it determines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

from armrig.numerics.checks import column
from armrig.numerics.least_squares import triangle
from armrig.numerics.power_spectrum import power_spectrum
from armrig.numerics.regressors import in_blocks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]

HIGHEST_ORDER = 50
"""Highest order of persistence of excitation that is looked for."""
# A singular value below this share of the largest is a rounding error, no excitation.
_RANK_TOLERANCE = 1e-8
_MOST_LEVELS = 20
_BINS = 10
_ROWS = 10_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class InputDescription:
    """What `describe_input` found; its repr says it in words, `plot` shows it."""

    u: Vector
    """The input (N,), in V."""
    Ts: float
    """Sampling time, in s."""
    mean: float
    """Mean, in V."""
    std: float
    """Effective value about the mean, in V."""
    crest_factor: float
    """Largest |u - mean| over `std`: 1 for two equal levels; NaN for a constant."""
    order: int
    """Order of persistence of excitation, 0 to `highest_order`."""
    highest_order: int
    """Highest order looked for; an `order` equal to it means at least that."""
    weakest: float
    """Power in the direction of `order` samples that has least of it, over the variance.

    1 for white noise; what it determines has a variance 1/weakest times as large.
    """
    omega: Vector
    """Frequencies of `spectrum`, in rad/s; empty where u is shorter than 16 samples."""
    spectrum: Vector
    """One-sided power density, in V² per rad/s."""
    levels: Vector
    """The values taken, in V, or where they are more than 20 the middles of ten bins."""
    shares: Vector
    """Share of the time at each level, or in each bin; they sum to 1."""
    binned: bool
    """`levels` are bins."""

    def plot(self) -> Figure:
        """Return a figure of the input against time, its spectrum and its levels."""
        from armrig.excitation.figures import plot_input

        return plot_input(self)

    def __repr__(self) -> str:
        """Say it in a few lines."""
        N = self.u.size
        at_least = "at least " if self.order == self.highest_order else ""
        kind = "in each tenth of the range" if self.binned else "at each level"
        times = ", ".join(
            f"{v:.3g} V {100 * p:.0f} %" for v, p in zip(self.levels, self.shares, strict=True)
        )
        lines = [
            f"input of {N} samples at {self.Ts:g} s ({N * self.Ts:g} s), "
            f"{self.u.min():.4g} to {self.u.max():.4g} V",
            f"  mean {self.mean:.4g} V, effective value about it {self.std:.4g} V, "
            f"crest factor {self.crest_factor:.3g}",
            f"  persistently exciting of order {at_least}{self.order}: {self._meaning()}",
            f"  time {kind}: {times}",
        ]
        if self.omega.size and self.std > 0:
            half = float(self.omega[np.searchsorted(_cumulated(self), 0.5)])
            lines.append(
                f"  half of the power below {half:.3g} rad/s (Nyquist {np.pi / self.Ts:.4g} rad/s)"
            )
        return "\n".join(lines)

    def _meaning(self) -> str:
        if self.order < 2:
            return "it determines a static gain, and no dynamics; switch it more often"
        more = ", and perhaps for more" if self.order == self.highest_order else ""
        many = f"enough for {self.order} parameters of B and F (or B and A) together{more}"
        return f"{many}; least power {self.weakest:.2g} of a white signal's"


def describe_input(u: ArrayLike, Ts: float) -> InputDescription:
    """Describe an input before it is played: spectrum, crest factor, excitation and levels.

    An input is persistently exciting of order n where the covariance matrix of n samples in a row
    is positive definite; a model with nb + nf parameters needs the order nb + nf. Here the rank of
    that matrix is found numerically, in either half of u, and the lower one counts: what moves
    once, as a step does, is of order 1 wherever it moves. The order is what double precision can
    tell: sines that lie close together in a narrow band (a chirp, a low multisine) count for fewer
    than twice their number, because so few samples in a row hardly show them apart.

    Parameters
    ----------
    u : array_like, shape (N,)
        Input in V; the mean counts.
    Ts : float
        Sampling time in s.

    Returns
    -------
    InputDescription
        Figures, with a repr in words and a plot.

    Raises
    ------
    ValueError
        u is not (N,), or not finite, or Ts is not > 0.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 13.2 and 13.3.
    """
    u_ = column("u", u)
    if not np.isfinite(u_).all():
        raise InputError(
            f"u is not finite at {int(np.argmax(~np.isfinite(u_)))}; every sample is played"
        )
    if not 0 < Ts < np.inf:
        raise InputError(f"Ts={Ts!r} must be finite and > 0, in s")
    u_.flags.writeable = False
    mean, std = float(np.mean(u_)), float(np.std(u_))
    std = 0.0 if np.ptp(u_) == 0 else std  # of a constant it is a rounding error
    highest = max(1, min(HIGHEST_ORDER, (u_.size // 2 + 1) // 3))
    order, weakest = min(_excitation(half, highest) for half in _halves(u_))
    omega, spectrum = power_spectrum([u_], Ts) if u_.size >= 16 else (np.zeros(0), np.zeros(0))
    levels, shares, binned = _levels(u_)
    return InputDescription(
        u=u_,
        Ts=float(Ts),
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


def _halves(u: Vector) -> tuple[Vector, ...]:
    return (u[: u.size // 2], u[u.size // 2 :]) if u.size > 1 else (u,)


def _excitation(u: Vector, highest: int) -> tuple[int, float]:
    """Return the order and the least eigenvalue of the covariance matrix of so many samples."""
    windows = np.lib.stride_tricks.sliding_window_view(u, highest)
    R = triangle(in_blocks(windows, _ROWS), highest) / np.sqrt(windows.shape[0])
    order, weakest = 0, 0.0
    for n in range(1, highest + 1):
        # The first n columns of M have the leading triangle of R: every order from one QR.
        sizes = np.linalg.svd(R[:n, :n], compute_uv=False)
        if not sizes[-1] > _RANK_TOLERANCE * sizes[0]:
            break
        order, weakest = n, float(sizes[-1]) ** 2
    return order, weakest


def _levels(u: Vector) -> tuple[Vector, Vector, bool]:
    values, counts = np.unique(u, return_counts=True)
    if values.size <= _MOST_LEVELS:
        return values, counts / u.size, False
    counts, edges = np.histogram(u, bins=_BINS)
    return (edges[:-1] + edges[1:]) / 2, counts / u.size, True


def _cumulated(d: InputDescription) -> Vector:
    total = np.cumsum(d.spectrum)
    return np.asarray(total / total[-1])
