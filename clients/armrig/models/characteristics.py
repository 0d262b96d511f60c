"""The figures by which models of one rig are told apart, with their uncertainty."""

from __future__ import annotations

from cmath import exp
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.models.parameter_draws import Draws, directions, drawn
from armrig.models.uncertainty import pole_regions
from armrig.numerics.confidence_regions import FEWEST, Band, band, linearised_band, sampled_band
from armrig.numerics.polynomial import evaluate, filtered, roots, without_integrator
from armrig.numerics.quantile import joint_p_value
from armrig.numerics.step_times import mean_lag, rise_time, slowest_time

if TYPE_CHECKING:
    from armrig.models.model import Model


Vector = NDArray[np.float64]
Complex = NDArray[np.complex128]

SCALARS = (
    "gain",
    "resonance",
    "antiresonance",
    "bandwidth",
    "rise_time",
    "equivalent_time",
    "slowest_time",
    "overshoot",
)
DRAWS = 400
"""Draws of the parameters that the figures are sampled with."""
GONE = 0.05
"""Share of draws without a figure (a resonance, say) from which its range is not known."""
_ROUNDING = 1e-9  # spread of draws that is no spread
_STEP = 1e-2  # of a standard deviation
_POINTS = 600
_LOWEST = 1 / 3000  # of Nyquist
_LONGEST = 2000  # samples of a step response
SAME = 0.01
"""p value above which a pole and a zero count as equal."""
_NEAR = 0.3  # largest distance in the z plane at which they are compared
_REAL = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelCharacteristics:
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
    """The 63 % time: from a step to 63 % of the gain, less the dead time of nk - 1 samples, in s.

    The times are defined in `armrig.numerics.step_times`, for data and physics, too.
    """
    equivalent_time: float
    """The area above the step response over the gain, less the same dead time, in s."""
    slowest_time: float
    """Of the slowest pole, 1/|Re s|, in s; the integrator's left out, NaN without one."""
    overshoot: float
    """Highest point of the step response over the gain, less 1, in percent."""
    std: dict[str, float]
    """Standard deviations by name, linearised; NaN where not known, 0 for a physics that claims to
    be exact."""
    ranges: dict[str, Band]
    """95 % ranges by name, linearised or, where that is poor, of draws of the parameters; NaN where
    not known."""
    poles_sampled: NDArray[np.bool_]
    """Poles whose `poles_std` is a poor one, in their order."""
    draws: Draws | None
    """What was drawn; None where nothing was estimated, or its covariance is not known."""


def model_characteristics(model: Model) -> ModelCharacteristics:
    """Return the figures of a model and their standard deviations.

    Frequencies are read off |G|, on a grid of 600 points up to Nyquist and then between them, and
    times off the step response. The standard deviations are g^T P g's roots, P the covariance that
    the verdict trusts and g the derivatives by theta, by central differences of a hundredth of a
    deviation. They are NaN where the figure comes or goes within that.
    Ranges are value ± 1.96 std, unless 400 draws of the parameters show that to be poor (see
    `armrig.numerics.confidence_regions`).
    """
    integrating = integrates(model)
    own = _scalars(model, model.theta, integrating=integrating)
    s = _continuous(model, integrating=integrating)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = model.poles().std / (np.abs(model.poles().values) * model.Ts)  # ds = dz / (z Ts)
    order = np.argsort(np.abs(s))
    std = _deviations(model, integrating=integrating)
    draws = drawn(model, n=DRAWS)
    sampled = np.array([r.method == "sampled" for r in pole_regions(model)], dtype=bool)
    return ModelCharacteristics(
        integrating=integrating,
        poles=s[order],
        poles_std=spread[order],
        poles_sampled=sampled[order],
        std=std,
        ranges=_ranges(model, own, std, draws, integrating=integrating),
        draws=draws,
        **own,
    )


def _ranges(
    model: Model,
    own: dict[str, float],
    std: dict[str, float],
    draws: Draws | None,
    *,
    integrating: bool,
) -> dict[str, Band]:
    if draws is None:
        return {name: band(own[name], std[name], None) for name in SCALARS}
    with np.errstate(all="ignore"):
        rows = [_scalars(model, theta, integrating=integrating) for theta in draws.theta]
    return {name: _range(own[name], std[name], np.array([r[name] for r in rows])) for name in own}


def _range(value: float, std: float, samples: Vector) -> Band:
    there = samples[np.isfinite(samples)]
    if np.isnan(value) or there.size < max((1 - GONE) * samples.size, FEWEST):
        unknown = np.array(np.nan)
        return Band(low=unknown, high=unknown, method="sampled")
    if np.ptp(there) <= _ROUNDING * max(1.0, abs(value)):
        return linearised_band(value, std)
    return band(value, std, there) if np.isfinite(std) else sampled_band(there)


def _deviations(model: Model, *, integrating: bool) -> dict[str, float]:
    covariance = np.asarray(model.trusted_covariance)
    if not np.isfinite(covariance).all():
        return dict.fromkeys(SCALARS, float("nan"))
    if not covariance.any():
        return dict.fromkeys(SCALARS, 0.0)
    # Along the columns of W, W W^T = P, each a step of one deviation: by single coefficients the
    # derivatives are large, and cancel in g^T P g down to their rounding.
    variance = np.zeros(len(SCALARS))
    for column in directions(model).T:
        if not column.any():
            continue
        above, below = (
            np.array(list(_scalars(model, model.theta + d, integrating=integrating).values()))
            for d in (_STEP * column, -_STEP * column)
        )
        variance += ((above - below) / (2 * _STEP)) ** 2
    return dict(zip(SCALARS, np.sqrt(variance).tolist(), strict=True))


def _continuous(model: Model, *, integrating: bool) -> Complex:
    """Return the poles in 1/s, log(z)/Ts, NaN where there is none."""
    z = model.poles().values
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where((np.abs(z.imag) < 1e-9) & (z.real <= 0), np.nan, np.log(z) / model.Ts)
    if integrating:
        s[np.argmin(np.abs(z - 1))] = 0.0
    return np.asarray(s)


def integrates(model: Model) -> bool:
    """Tell whether y integrates: by construction, or by a pole at 1 as far as it can be told."""
    return model.integrator or bool(np.any(np.abs(roots(model.denominator) - 1) < 5e-3))


def _scalars(model: Model, theta: Vector, *, integrating: bool) -> dict[str, float]:
    B, F = _polynomials(model, theta)
    if integrating:
        F = (without_integrator(F) if model.integrator else _without_one(F)) * model.Ts
    gain = float(np.sum(B) / np.sum(F))
    nyquist = np.pi / model.Ts
    omega = np.geomspace(_LOWEST * nyquist, nyquist, _POINTS)

    x = np.exp(-1j * omega * model.Ts)
    of_grid = np.asarray(np.abs(evaluate(B, x) / evaluate(F, x)) ** 2)
    b, f = B[::-1].tolist(), F[::-1].tolist()

    def power(w: float) -> float:
        at = exp(-1j * w * model.Ts)
        return abs(_horner(b, at)) ** 2 / max(abs(_horner(f, at)) ** 2, 1e-300)

    modulus = np.abs(roots(F))
    y = filtered(B, F, np.ones(_length(modulus)))
    dead = max(model.nk - 1, 0)
    answer = y / gain
    # Of a rate, the mean of each interval, the area is exact; of an output by the trapezoidal rule.
    first = 1.0 if integrating else 0.5 * (1 - float(answer[dead]))
    shown = (model.Ts * np.cumsum(answer) if integrating else answer)[dead:]
    with np.errstate(divide="ignore"):
        decay = np.log(modulus) / model.Ts
    return {
        "gain": gain,
        "resonance": _extreme(omega, of_grid, power, sign=1),
        "antiresonance": _extreme(omega, of_grid, power, sign=-1),
        "bandwidth": _first_below(omega, of_grid, gain**2 / 2),
        "rise_time": rise_time(shown, model.Ts, integrated=integrating),
        "equivalent_time": model.Ts * (mean_lag(B, F) - first - dead),
        "slowest_time": slowest_time(decay),
        "overshoot": 100 * max(float(np.max(answer)) - 1, 0.0),
    }


def _without_one(F: Vector) -> Vector:
    """Return F without its root nearest to 1, which was estimated and is taken for 1."""
    z = roots(F)
    return np.atleast_1d(np.real(np.poly(np.delete(z, np.argmin(np.abs(z - 1))))))


def _polynomials(model: Model, theta: Vector) -> tuple[Vector, Vector]:
    """Return B and the denominator A F with other coefficients."""
    a, b, f = (theta[model.slice_of(letter)] for letter in "abf")
    B = np.concatenate([np.zeros(model.nk), b])
    return B, np.convolve(np.append(1.0, a), np.append(1.0, f))


def _length(modulus: Vector) -> int:
    """Return the samples in which a step response settles to a thousandth, 2000 at most.

    Parameters
    ----------
    modulus : ndarray, shape (n,)
        Of the poles.
    """
    slowest = float(modulus.max(initial=0.0))
    if not 0 < slowest < 1:
        return _LONGEST
    return min(_LONGEST, max(50, int(np.log(1e-3) / np.log(slowest)) + 1))


def _extreme(
    omega: Vector, of_grid: Vector, power: Callable[[float], float], *, sign: int
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
        lambda w: -power(float(w)) / scale if scale else 0.0,
        bounds=(omega[i - 1], omega[i + 1]),
        method="bounded",
        options={"xatol": 1e-7 * omega[i]},
    )
    return float(found.x)


def _horner(p: list[float], x: complex) -> complex:
    """Return a polynomial, highest power first, at one point; numpy takes 50 times as long."""
    value = 0j
    for coefficient in p:
        value = value * x + coefficient
    return value


def _first_below(x: Vector, y: Vector, level: float) -> float:
    """Return the first x at which y is below the level, between samples by a straight line."""
    beyond = y < level
    if not beyond.any():
        return float("nan")
    i = int(np.argmax(beyond))
    if i == 0:
        return float(x[0])
    share = (level - y[i - 1]) / (y[i] - y[i - 1])
    return float(x[i - 1] + share * (x[i] - x[i - 1]))


def overlapping(model: Model) -> list[tuple[complex, complex, float]]:
    """Return pole, zero and p value of the pairs that cannot be told apart (1 %), nearest first.

    The difference of a pole and a zero has the covariance J P J^T, J their derivatives by theta:
    where the order is too high both wander, together, and only this difference is small. A
    conjugate pair is told once.
    """
    poles = [(letter, z) for letter in ("a", "f") for z in _roots(model, letter)]
    found = []
    for letter, pole in poles:
        if pole.imag < 0 or (letter == model.integrating and abs(pole - 1) < 1e-6):
            continue
        for zero in _roots(model, "b"):
            apart = pole - zero
            if zero.imag < -_REAL or abs(apart) > _NEAR:
                continue
            d = _derivative(model, letter, pole) - _derivative(model, "b", zero)
            J = np.vstack([d.real, d.imag])
            s = np.array([apart.real, apart.imag])
            p = joint_p_value(s, J @ model.trusted_covariance @ J.T)
            if p >= SAME:
                found.append((complex(pole), complex(zero), p))
    return sorted(found, key=lambda pair: abs(pair[0] - pair[1]))


def _roots(model: Model, letter: str) -> Complex:
    p = getattr(model, letter.upper())
    return np.roots(p[model.nk :] if letter == "b" else p).astype(np.complex128)


def _derivative(model: Model, letter: str, root: complex) -> Complex:
    """Return the derivative of a root by theta (d,): dz = -z^(n-k) / p'(z) dp_k."""
    p = getattr(model, letter.upper())
    p, first = (p[model.nk :], 0) if letter == "b" else (p, 1)
    powers = p.size - 1 - np.arange(first, p.size)
    out = np.zeros(model.theta.size, dtype=np.complex128)
    with np.errstate(divide="ignore", invalid="ignore"):
        out[model.slice_of(letter)] = -(root**powers) / np.polyval(np.polyder(p), root)
    return out
