"""Summary of a model: poles, zeros and characteristic numbers with their 95 % ranges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from armrig.models.characteristics import (
    SCALARS,
    ModelCharacteristics,
    model_characteristics,
    overlapping,
)
from armrig.models.uncertainty import Draws, parameter_draws, pole_regions, zero_regions
from armrig.numerics.confidence_regions import HALF_WIDTH, Region
from armrig.numerics.quantities import minus, plural, with_range

if TYPE_CHECKING:
    from armrig.models.fit import Fit

_UNITS = dict.fromkeys(SCALARS, "s") | {"gain": "", "overshoot": "%"}
_UNITS |= dict.fromkeys(("resonance", "antiresonance", "bandwidth"), "rad/s")
_NAMES = {
    "antiresonance": "anti-resonance",
    "rise_time": "63 % time",
    "equivalent_time": "equivalent time",
    "slowest_time": "slowest pole",
}
_RANGE_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Summary:
    """Poles, zeros and characteristic numbers of a model with 95 % ranges, as a table to print."""

    poles: tuple[Region, ...]
    """Regions of the poles in the z plane, in the order of `Fit.poles()`."""
    zeros: tuple[Region, ...]
    """Regions of the zeros in the z plane, in the order of `Fit.zeros()`."""
    figures: ModelCharacteristics
    """Gain, resonances, bandwidth, times, and the poles in 1/s."""
    cancelling: tuple[tuple[complex, complex, float], ...]
    """Pole, zero and p value of pairs that cannot be distinguished at the level 1 %."""
    draws: Draws | None
    """Draws of the parameters, for the regions; None if no covariance is known."""
    robust: bool
    """True if the covariance is the sandwich form, because the residuals are coloured."""
    gain_unit: str
    """Unit of y per unit of u, or ""."""

    def facts(self) -> dict[str, Any]:
        """Return the summary as values for JSON: numbers, and None for unknown values."""
        return {
            "covariance": "robust" if self.robust else "classic",
            "poles": [_root_facts(r) for r in self.poles],
            "zeros": [_root_facts(r) for r in self.zeros],
            "figures": {name: self._figure_facts(name) for name in SCALARS},
            "of_the_rate": self.figures.integrating,
            "cancelling": [
                {"pole": [a.real, a.imag], "zero": [b.real, b.imag], "p": p}
                for a, b, p in self.cancelling
            ],
            "draws": None
            if self.draws is None
            else {
                "made": self.draws.asked,
                "unstable": self.draws.unstable,
                "degenerate": self.draws.degenerate,
            },
        }

    def _figure_facts(self, name: str) -> dict[str, Any]:
        band = self.figures.ranges[name]
        return {
            "value": _finite(getattr(self.figures, name)),
            "low": _finite(float(band.low)),
            "high": _finite(float(band.high)),
            "method": band.method,
        }

    def __repr__(self) -> str:
        """Return the summary as a table."""
        form = "robust" if self.robust else "classic"
        lines = [f"95 % ranges, {form} covariance; * by draws, as the linearisation is poor"]
        for kind, regions in (("pole", self.poles), ("zero", self.zeros)):
            upper = [r for r in regions if r.centre.imag >= 0]
            lines += [f"  {kind:15} {_root(r)}" for r in upper]
        for name in SCALARS:
            of_rate = " (rate)" if self.figures.integrating and name == "gain" else ""
            lines.append(f"  {_NAMES.get(name, name) + of_rate:15} {self._figure(name)}")
        lines += [
            f"  cancel: pole {_complex(a, 3)} and zero {_complex(b, 3)} cannot be distinguished"
            for a, b, _ in self.cancelling
        ]
        if self.draws is not None:
            left_out = f"; rejected: {self.draws.left_out}" if self.draws.left_out else ""
            n = self.draws.theta.shape[0]
            lines.append(f"  checked by {plural(n, 'draw')} of the parameters{left_out}")
        return "\n".join(lines)

    def _figure(self, name: str) -> str:
        value, band = getattr(self.figures, name), self.figures.ranges[name]
        if np.isnan(value):
            return "none"
        unit = _UNITS[name] or self.gain_unit
        unit += "/s" if name == "gain" and self.figures.integrating and unit else ""
        return f"{_range(value, float(band.low), float(band.high), band.method)} {unit}".rstrip()


def summary(model: Fit) -> Summary:
    """Return poles, zeros and characteristic numbers of a model with their 95 % ranges.

    A range is linearised, or computed by draws from N(theta, P) if the linearisation is poor. There
    are 1000 draws for poles and zeros, and 400 draws for the other numbers. P is the trusted
    covariance. A range by draws is valid for a nonlinear function of theta, but not if the
    distribution of theta itself is far from normal. Therefore the range of a pole that nearly
    cancels with a zero is too narrow. A model in continuous time is sampled as its estimation data;
    its `quantities` have the numbers in s.
    """
    if model.Ts == 0:
        model = model.to_discrete()
    draws = parameter_draws(model)
    return Summary(
        poles=tuple(pole_regions(model, draws)),
        zeros=tuple(zero_regions(model, draws)),
        figures=model_characteristics(model),
        cancelling=() if draws is None else tuple(overlapping(model)),
        draws=draws,
        robust=model.trusts_robust,
        gain_unit=f"{model.unit}/{model.input_unit}" if model.unit and model.input_unit else "",
    )


def bounds(region: Region) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the 95 % range of the real part and the 95 % range of the imaginary part.

    If the region of a complex pair is computed by draws, both ranges are quantiles of the draws.
    The imaginary part belongs to the root above the real axis.
    """
    z = region.centre
    if region.densest is not None and region.draws is not None:
        points = region.draws.upper
        edges = [np.quantile(x, [0.025, 0.975]).tolist() for x in (points.real, points.imag)]
        return (edges[0][0], edges[0][1]), (edges[1][0], edges[1][1])
    if region.interval is not None:
        return region.interval, (0.0, 0.0)
    widths = HALF_WIDTH * np.sqrt(np.maximum(np.diag(region.covariance), 0.0))
    height = abs(z.imag)
    return ((z.real - widths[0], z.real + widths[0]), (height - widths[1], height + widths[1]))


def _root(region: Region) -> str:
    z, (real, imaginary) = region.centre, bounds(region)
    mark = region.method
    if real[0] == real[1]:
        return f"{minus(f'{z.real:.4f}')}, fixed"
    text = _range(z.real, *real, mark)
    if imaginary == (0.0, 0.0):
        return text
    return f"{text}  ± {_range(abs(z.imag), *imaginary, mark)} i"


def _root_facts(region: Region) -> dict[str, Any]:
    real, imaginary = bounds(region)
    return {
        "value": [region.centre.real, region.centre.imag],
        "real": [_finite(x) for x in real],
        "imaginary_magnitude": [_finite(x) for x in imaginary],
        "method": region.method,
    }


def _range(value: float, low: float, high: float, method: str) -> str:
    if not (np.isfinite(low) and np.isfinite(high)):
        return minus(f"{value:.5g}") + " (range not known)"
    if high - low <= _RANGE_ROUNDING * max(1.0, abs(value)):
        return minus(f"{0.0 if abs(value) < _RANGE_ROUNDING else value:.5g}")
    return minus(with_range(value, low, high)) + ("*" if method == "sampled" else "")


def _complex(z: complex, decimals: int) -> str:
    imaginary = f" ± {abs(z.imag):.{decimals}f}i" if abs(z.imag) > 1e-9 else ""
    return minus(f"{z.real:.{decimals}f}") + imaginary


def _finite(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None
