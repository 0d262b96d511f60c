"""The figures by which models of one rig are told apart, with their uncertainty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.polynomial import evaluate, filtered, roots, without_integrator

if TYPE_CHECKING:
    from armrig.fit import Fit

Vector = NDArray[np.float64]
Complex = NDArray[np.complex128]

SCALARS = ("gain", "resonance", "antiresonance", "bandwidth", "rise_time", "overshoot")
_STEP = 1e-3  # of a standard deviation
_POINTS = 600
_LOWEST = 1 / 3000  # of Nyquist
_LONGEST = 2000  # samples of a step response
_RISE = 1 - 1 / np.e


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Traits:
    """What a model answers, in a few figures; of the rate where y integrates."""

    integrating: bool
    """The figures are those of y's rate."""
    gain: float
    """Steady answer to a constant input of 1, in y's unit (per s, if it integrates) per u's."""
    poles: Complex
    """In continuous time, 1/s, slowest first; NaN where sampling makes no such pole."""
    poles_std: Vector
    """Their spread in the complex plane, 1/s, linearised; 0 for a pole that was fixed."""
    resonance: float
    """Frequency of the largest peak of |G|, in rad/s; NaN without one."""
    antiresonance: float
    """Frequency of the deepest dip, in rad/s; NaN without one."""
    bandwidth: float
    """Lowest frequency at which |G| is the gain less 3 dB, in rad/s; NaN where it never is."""
    rise_time: float
    """Time to 63 % of the gain after a step, in s: the handout's time constant."""
    overshoot: float
    """Highest point of the step response over the gain, less 1, in percent."""
    std: dict[str, float]
    """Standard deviations by name, linearised; NaN where not known, 0 for a physics that claims to
    be exact."""


def traits(fit: Fit) -> Traits:
    """Return the figures of a model and their standard deviations.

    Frequencies are read off |G|, on a grid of 600 points up to Nyquist and then between them, and
    times off the step response. The standard deviations are g^T P g's roots, P the robust
    covariance and g the derivatives by each coefficient, by central differences of a thousandth
    of its own deviation. They are NaN where the figure comes or goes within that.
    """
    integrating = _integrates(fit)
    own = _scalars(fit, fit.theta, integrating=integrating)
    s = _continuous(fit, integrating=integrating)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = fit.poles().std / (np.abs(fit.poles().values) * fit.Ts)  # ds = dz / (z Ts)
    order = np.argsort(np.abs(s))
    return Traits(
        integrating=integrating,
        poles=s[order],
        poles_std=spread[order],
        std=_deviations(fit, integrating=integrating),
        **own,
    )


def _deviations(fit: Fit, *, integrating: bool) -> dict[str, float]:
    covariance = np.asarray(fit.covariance_robust)
    if not np.isfinite(covariance).all():
        return dict.fromkeys(SCALARS, float("nan"))
    if not covariance.any():
        return dict.fromkeys(SCALARS, 0.0)
    # By each coefficient, not along the covariance's axes: its condition number is that of
    # rounding (a root is fixed at 1), and the short axes, on which the gain depends, are noise.
    gradient = np.zeros((len(SCALARS), fit.theta.size))
    for j, std in enumerate(np.sqrt(np.maximum(np.diag(covariance), 0.0))):
        if std == 0:
            continue
        step = np.zeros(fit.theta.size)
        step[j] = _STEP * std
        above, below = (
            np.array(list(_scalars(fit, fit.theta + d, integrating=integrating).values()))
            for d in (step, -step)
        )
        gradient[:, j] = (above - below) / (2 * _STEP * std)
    variance = np.einsum("ij,jk,ik->i", gradient, covariance, gradient)
    return dict(zip(SCALARS, np.sqrt(np.maximum(variance, 0.0)).tolist(), strict=True))


def _continuous(fit: Fit, *, integrating: bool) -> Complex:
    """Return the poles in 1/s, log(z)/Ts, NaN where there is none."""
    z = fit.poles().values
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where((np.abs(z.imag) < 1e-9) & (z.real <= 0), np.nan, np.log(z) / fit.Ts)
    if integrating:
        s[np.argmin(np.abs(z - 1))] = 0.0
    return np.asarray(s)


def _integrates(fit: Fit) -> bool:
    """Tell whether y integrates: by construction, or by a pole at 1 as far as it can be told."""
    return fit.integrator or bool(np.any(np.abs(roots(fit.denominator) - 1) < 5e-3))


def _scalars(fit: Fit, theta: Vector, *, integrating: bool) -> dict[str, float]:
    B, F = _polynomials(fit, theta)
    if integrating:
        F = (without_integrator(F) if fit.integrator else _without_one(F)) * fit.Ts
    gain = float(np.sum(B) / np.sum(F))
    nyquist = np.pi / fit.Ts
    omega = np.geomspace(_LOWEST * nyquist, nyquist, _POINTS)

    def power(w: Vector) -> Vector:
        x = np.exp(-1j * w * fit.Ts)
        return np.asarray(np.abs(evaluate(B, x) / evaluate(F, x)) ** 2)

    of_grid = power(omega)
    y = filtered(B, F, np.ones(_length(F)))
    return {
        "gain": gain,
        "resonance": _extreme(omega, of_grid, power, sign=1),
        "antiresonance": _extreme(omega, of_grid, power, sign=-1),
        "bandwidth": _crossing(omega, of_grid, gain**2 / 2, falling=True),
        "rise_time": _crossing(
            fit.Ts * np.arange(y.size, dtype=np.float64), y / gain, _RISE, falling=False
        ),
        "overshoot": 100 * (float(np.max(y / gain)) - 1),
    }


def _without_one(F: Vector) -> Vector:
    """Return F without its root nearest to 1, which was estimated and is taken for 1."""
    z = roots(F)
    return np.atleast_1d(np.real(np.poly(np.delete(z, np.argmin(np.abs(z - 1))))))


def _polynomials(fit: Fit, theta: Vector) -> tuple[Vector, Vector]:
    """Return B and the denominator A F with other coefficients."""
    a, b, f = (theta[fit.slice_of(letter)] for letter in "abf")
    B = np.concatenate([np.zeros(fit.nk), b])
    return B, np.convolve(np.append(1.0, a), np.append(1.0, f))


def _length(F: Vector) -> int:
    """Return the samples in which a step response settles to a thousandth, 2000 at most."""
    slowest = float(np.abs(roots(F)).max(initial=0.0))
    if not 0 < slowest < 1:
        return _LONGEST
    return min(_LONGEST, max(50, int(np.log(1e-3) / np.log(slowest)) + 1))


def _extreme(
    omega: Vector, of_grid: Vector, power: Callable[[Vector], Vector], *, sign: int
) -> float:
    """Return the frequency of the most prominent peak (or dip, sign -1) inside, 1 dB at least.

    Found on the grid, then searched between its neighbours on |G|², which is smooth where |G|
    touches 0.
    """
    from scipy.optimize import minimize_scalar
    from scipy.signal import find_peaks

    level = sign * 10 * np.log10(np.maximum(of_grid, 1e-300))
    at, of = find_peaks(level, prominence=1.0)
    if at.size == 0:
        return float("nan")
    i = int(at[np.argmax(of["prominences"])])
    scale = sign * of_grid[i]
    found = minimize_scalar(
        lambda w: -float(power(np.array([w]))[0]) / scale if scale else 0.0,
        bounds=(omega[i - 1], omega[i + 1]),
        method="bounded",
        options={"xatol": 1e-7 * omega[i]},
    )
    return float(found.x)


def _crossing(x: Vector, y: Vector, level: float, *, falling: bool) -> float:
    """Return the first x at which y passes the level, between samples by a straight line."""
    beyond = y < level if falling else y >= level
    if not beyond.any():
        return float("nan")
    i = int(np.argmax(beyond))
    if i == 0:
        return float(x[0])
    share = (level - y[i - 1]) / (y[i] - y[i - 1])
    return float(x[i - 1] + share * (x[i] - x[i - 1]))
