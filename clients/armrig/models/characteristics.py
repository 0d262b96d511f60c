"""Characteristic numbers of a model, with their uncertainty: gain, poles, resonances and times."""

from __future__ import annotations

from cmath import exp
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.models.responses import root_derivatives
from armrig.models.state_space import Complex, Vector
from armrig.models.uncertainty import Draws, directions, parameter_draws, pole_regions
from armrig.numerics.confidence_regions import MIN_DRAWS, Band, band, band_of_draws, linear_band
from armrig.numerics.polynomial import apply_filter, evaluate, roots, without_integrator
from armrig.numerics.step_times import mean_lag, rise_time, slowest_time
from armrig.numerics.whiteness import joint_p_value

if TYPE_CHECKING:
    from armrig.models.fit import Fit

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
"""Number of draws of the parameters from which a range is computed."""
MAX_INVALID_SHARE = 0.05
"""Largest share of the draws in which a characteristic, such as the resonance, may be undefined. If
it is undefined in more draws, the range of this characteristic is not known."""
_SPREAD_ROUNDING = 1e-9  # a relative spread of draws up to this limit counts as rounding
_NEAR_NYQUIST = 1e-6  # relative distance from the Nyquist frequency, where the slope is 0
_DIFFERENCE_SIGMAS = 1e-2  # step of the central differences, in standard deviations
_FREQUENCY_POINTS = 600
_MIN_NYQUIST_SHARE = 1 / 3000  # lowest frequency of the grid, as a share of the Nyquist frequency
_MAX_STEP_SAMPLES = 2000
CANCELLATION_LEVEL = 0.01
"""Level of the test for cancellation. A pole and a zero with a smaller p value are distinct."""
_MAX_PAIR_DISTANCE = 0.3  # largest distance in the z plane at which a pair is tested
_REAL_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelCharacteristics:
    """Characteristic numbers of the response from u to y, or to the rate of y if y integrates."""

    integrating: bool
    """True if the numbers characterise the rate of y."""
    gain: float
    """Steady response to a unit input, in units of y (per s if y integrates) per unit of u."""
    poles: Complex
    """Poles in continuous time, in 1/s, slowest first; NaN for a real z-plane pole <= 0."""
    poles_std: Vector
    """Linearised spread of the poles in the complex plane, in 1/s; 0 for a fixed pole."""
    resonance: float
    """Frequency of the most prominent peak of |G|, in rad/s; NaN if there is none."""
    antiresonance: float
    """Frequency of the most prominent dip of |G|, in rad/s; NaN if there is none."""
    bandwidth: float
    """Lowest frequency at which |G| is 3 dB below the gain, in rad/s; NaN if there is none."""
    rise_time: float
    """Time from a step to 63 % of the gain, minus the dead time of nk - 1 samples, in s.

    `armrig.numerics.step_times` defines the times for models, data and physics.
    """
    equivalent_time: float
    """Area between the step response and the gain, divided by the gain, minus the dead time
    (nk - 1 samples), in s."""
    slowest_time: float
    """1/|Re s| of the slowest pole other than the integrator, in s; NaN if there is none."""
    overshoot: float
    """Maximum of the step response divided by the gain, minus 1, in percent."""
    std: dict[str, float]
    """Linearised standard deviations by name; NaN if not known, 0 for a physical model."""
    ranges: dict[str, Band]
    """95 % ranges by name; NaN if not known. A range is linearised, or computed from draws of the
    parameters if the linearisation is poor."""
    poles_sampled: NDArray[np.bool_]
    """Mask of the poles for which the linearisation, and therefore `poles_std`, is poor."""
    draws: Draws | None
    """Draws of the parameters; None if nothing was estimated or the covariance is not known."""


def model_characteristics(model: Fit) -> ModelCharacteristics:
    """Return the characteristic numbers of a model, with standard deviations and ranges.

    The frequencies are found from |G|: first on a grid of 600 points up to the Nyquist frequency,
    then more exactly between neighbouring points. The times are computed from the step response.
    The standard deviation of a number is the square root of g^T P g. P is the trusted covariance,
    and g is the gradient of the number with respect to theta. The gradient is computed by central
    differences with a step of a hundredth of a standard deviation. If the number does not exist at
    one end of the step, its standard deviation is NaN. A range is value ± 1.96 std. If the
    linearisation is poor, the range is computed from 400 draws of the parameters (see
    `armrig.numerics.confidence_regions`).
    """
    if model.Ts == 0:
        model = model.to_discrete()
    integrating = integrates(model)
    scalars = _scalars(model, model.theta, integrating=integrating)
    s = _continuous(model, integrating=integrating)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = model.poles().std / (np.abs(model.poles().values) * model.Ts)  # ds = dz / (z Ts)
    order = np.argsort(np.abs(s))
    std = _deviations(model, integrating=integrating)
    draws = parameter_draws(model, n=DRAWS)
    sampled = np.array([r.method == "sampled" for r in pole_regions(model)], dtype=bool)
    return ModelCharacteristics(
        integrating=integrating,
        poles=s[order],
        poles_std=spread[order],
        poles_sampled=sampled[order],
        std=std,
        ranges=_ranges(model, scalars, std, draws, integrating=integrating),
        draws=draws,
        **scalars,
    )


def _ranges(
    model: Fit,
    values: dict[str, float],
    std: dict[str, float],
    draws: Draws | None,
    *,
    integrating: bool,
) -> dict[str, Band]:
    if draws is None:
        return {key: band(values[key], std[key], None) for key in SCALARS}
    with np.errstate(all="ignore"):
        rows = [_scalars(model, theta, integrating=integrating) for theta in draws.theta]
    return {key: _range(values[key], std[key], np.array([r[key] for r in rows])) for key in values}


def _range(value: float, std: float, samples: Vector) -> Band:
    finite = samples[np.isfinite(samples)]
    if np.isnan(value) or finite.size < max((1 - MAX_INVALID_SHARE) * samples.size, MIN_DRAWS):
        unknown = np.array(np.nan)
        return Band(low=unknown, high=unknown, method="sampled")
    if np.ptp(finite) <= _SPREAD_ROUNDING * max(1.0, abs(value)):
        return linear_band(value, std)
    return band(value, std, finite) if np.isfinite(std) else band_of_draws(finite)


def _deviations(model: Fit, *, integrating: bool) -> dict[str, float]:
    covariance = np.asarray(model.trusted_covariance)
    if not np.isfinite(covariance).all():
        return dict.fromkeys(SCALARS, float("nan"))
    if not covariance.any():
        return dict.fromkeys(SCALARS, 0.0)
    # Derivatives along the columns of W, with W W^T = P; each column is a step of one standard
    # deviation. Derivatives with respect to single coefficients are large and would cancel in g^T P
    # g, so that only rounding remains.
    variance = np.zeros(len(SCALARS))
    for column in directions(model).T:
        if not column.any():
            continue
        above, below = (
            np.array(list(_scalars(model, model.theta + d, integrating=integrating).values()))
            for d in (_DIFFERENCE_SIGMAS * column, -_DIFFERENCE_SIGMAS * column)
        )
        variance += ((above - below) / (2 * _DIFFERENCE_SIGMAS)) ** 2
    return dict(zip(SCALARS, np.sqrt(variance).tolist(), strict=True))


def _continuous(model: Fit, *, integrating: bool) -> Complex:
    """Return the poles log(z)/Ts in 1/s, NaN for a z that is real and not positive."""
    z = model.poles().values
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where((np.abs(z.imag) < 1e-9) & (z.real <= 0), np.nan, np.log(z) / model.Ts)
    if integrating:
        s[np.argmin(np.abs(z - 1))] = 0.0
    return np.asarray(s)


def integrates(model: Fit) -> bool:
    """Return whether y integrates: by construction, or by a pole within 5e-3 of 1."""
    return model.integrator or bool(np.any(np.abs(roots(model.denominator) - 1) < 5e-3))


def _scalars(model: Fit, theta: Vector, *, integrating: bool) -> dict[str, float]:
    a, b, f = (theta[model.slice_of(letter)] for letter in "abf")
    B = np.append(np.zeros(model.nk), b)
    F = np.convolve(np.append(1.0, a), np.append(1.0, f))
    if integrating:
        F = (without_integrator(F) if model.integrator else _without_one(F)) * model.Ts
    gain = float(np.sum(B) / np.sum(F))
    nyquist = np.pi / model.Ts
    omega = np.geomspace(_MIN_NYQUIST_SHARE * nyquist, nyquist, _FREQUENCY_POINTS)

    x = np.exp(-1j * omega * model.Ts)
    of_grid = np.asarray(np.abs(evaluate(B, x) / evaluate(F, x)) ** 2)
    of_B, of_F = ((p[::-1].tolist(), (np.arange(p.size) * p)[::-1].tolist()) for p in (B, F))

    def slope(w: float) -> float:
        """Return d|G|²/dw, multiplied by a positive factor."""
        at = exp(-1j * w * model.Ts)
        (B_w, dB), (F_w, dF) = ([_horner(p, at) for p in pair] for pair in (of_B, of_F))
        by_B, by_F = B_w.conjugate() * dB, F_w.conjugate() * dF
        return by_B.imag * abs(F_w) ** 2 - by_F.imag * abs(B_w) ** 2

    modulus = np.abs(roots(F))
    y = apply_filter(B, F, np.ones(_length(modulus)))
    dead = max(model.nk - 1, 0)
    step_response = y / gain
    # The area of a rate is exact, because a rate is a mean over each interval. The area of an
    # output is computed by the trapezoidal rule.
    first = 1.0 if integrating else 0.5 * (1 - float(step_response[dead]))
    output_response = (model.Ts * np.cumsum(step_response) if integrating else step_response)[dead:]
    with np.errstate(divide="ignore"):
        decay = np.log(modulus) / model.Ts
    return {
        "gain": gain,
        "resonance": _extreme(omega, of_grid, slope, sign=1),
        "antiresonance": _extreme(omega, of_grid, slope, sign=-1),
        "bandwidth": _first_below(omega, of_grid, gain**2 / 2),
        "rise_time": rise_time(output_response, model.Ts, integrated=integrating),
        "equivalent_time": model.Ts * (mean_lag(B, F) - first - dead),
        "slowest_time": slowest_time(decay),
        "overshoot": 100 * max(float(np.max(step_response)) - 1, 0.0),
    }


def _without_one(F: Vector) -> Vector:
    """Return F without its root nearest 1, which is assumed to be exactly 1."""
    z = roots(F)
    return np.atleast_1d(np.real(np.poly(np.delete(z, np.argmin(np.abs(z - 1))))))


def _length(modulus: Vector) -> int:
    """Return the number of samples in which a step response settles to 0.1 %, at most 2000."""
    slowest = float(modulus.max(initial=0.0))
    if not 0 < slowest < 1:
        return _MAX_STEP_SAMPLES
    return min(_MAX_STEP_SAMPLES, max(50, int(np.log(1e-3) / np.log(slowest)) + 1))


def _extreme(
    omega: Vector, of_grid: Vector, slope: Callable[[float], float], *, sign: int
) -> float:
    """Return the frequency of the most prominent peak (sign -1: dip); NaN if none reaches 1 dB."""
    from scipy.optimize import brentq
    from scipy.signal import find_peaks

    level = sign * 10 * np.log10(np.maximum(of_grid, 1e-300))
    peaks, properties = find_peaks(level, prominence=1.0)
    if peaks.size == 0:
        return float("nan")
    i = int(peaks[np.argmax(properties["prominences"])])
    # The slope is 0 at the Nyquist frequency, the last point.
    low, high = float(omega[i - 1]), float(omega[i + 1]) * (1 - _NEAR_NYQUIST)
    if slope(low) * slope(high) >= 0:
        return float(omega[i])
    return float(brentq(slope, low, high, xtol=1e-12 * low))


def _horner(p: list[float], x: complex) -> complex:
    """Return p(x), highest power first, 50 times as fast as `numpy.polyval`."""
    value = 0j
    for coefficient in p:
        value = value * x + coefficient
    return value


def _first_below(x: Vector, y: Vector, level: float) -> float:
    """Return the first x with y below the level, interpolated linearly; NaN if there is none."""
    beyond = y < level
    if not beyond.any():
        return float("nan")
    i = int(np.argmax(beyond))
    if i == 0:
        return float(x[0])
    share = (level - y[i - 1]) / (y[i] - y[i - 1])
    return float(x[i - 1] + share * (x[i] - x[i - 1]))


def overlapping(model: Fit) -> list[tuple[complex, complex, float]]:
    """Return the pole, zero and p value of each pair that cannot be distinguished at the 1 % level.

    The pair with the smallest distance is first. The difference between the pole and the zero has
    the covariance J P J^T. J contains the derivatives of the difference with respect to theta, and
    P is the trusted covariance of theta. If the order is too high, a pole and a zero cancel: both
    are uncertain, but they vary together, and their difference is small. Of a complex pole and its
    conjugate, only the pole above the real axis is listed.
    """
    zeros = _roots_by_theta(model, "b")
    pairs = []
    for letter in ("a", "f"):
        for pole, by_pole in _roots_by_theta(model, letter):
            if pole.imag < 0 or (letter == model.integrating and abs(pole - 1) < 1e-6):
                continue
            for zero, by_zero in zeros:
                apart = pole - zero
                if zero.imag < -_REAL_TOLERANCE or abs(apart) > _MAX_PAIR_DISTANCE:
                    continue
                d = by_pole - by_zero
                J = np.vstack([d.real, d.imag])
                s = np.array([apart.real, apart.imag])
                p = joint_p_value(s, J @ model.trusted_covariance @ J.T)
                if p >= CANCELLATION_LEVEL:
                    pairs.append((complex(pole), complex(zero), p))
    return sorted(pairs, key=lambda pair: abs(pair[0] - pair[1]))


def _roots_by_theta(model: Fit, letter: str) -> list[tuple[complex, Complex]]:
    """Return each root of one polynomial with its derivatives (d,) by theta."""
    z, dz = root_derivatives(model, letter)
    by_theta = np.zeros((z.size, model.theta.size), dtype=np.complex128)
    by_theta[:, model.slice_of(letter)] = dz
    return list(zip(z.tolist(), by_theta, strict=True))
