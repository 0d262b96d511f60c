"""The same estimate from the whole of the data, from halves, from quarters (handout 3.6)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.numerics.checks import require_integers, require_several
from armrig.numerics.quantities import p_relation, plural
from armrig.physics.grey_box.estimate import greybox
from armrig.physics.grey_box.fit import GreyFit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]
_LEVEL = 0.01  # below this p value the parts are called different
_OUTSIDE = 0.05  # of the interval of a scatter


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Split:
    """One parameter from the data cut into k parts."""

    k: int
    """Number of parts."""
    N: Vector
    """Samples with an output in each part, (k,)."""
    values: Vector
    """Estimates, (k,)."""
    std: Vector
    """Reported standard deviations, from the noise alone, (k,)."""

    @property
    def scaled_std(self) -> float:
        """Mean of std sqrt(N): the same for every k where the law 1/sqrt(N) holds."""
        return float(np.mean(self.std * np.sqrt(self.N)))

    @property
    def pooled(self) -> tuple[float, float]:
        """Mean with weights 1/std², and its standard deviation."""
        weights = self.std**-2
        return float(weights @ self.values / weights.sum()), float(weights.sum() ** -0.5)

    @property
    def scatter(self) -> float:
        """Standard deviation of the estimates among each other, nan for one part."""
        return float(np.std(self.values, ddof=1)) if self.k > 1 else float("nan")

    @property
    def scatter_interval(self) -> tuple[float, float]:
        """95 % interval of the deviation that `scatter` estimates, nan for one part.

        scatter² (k - 1) over that variance is chi-squared with k - 1 degrees of freedom.
        """
        from scipy.special import chdtri

        if self.k == 1:
            return float("nan"), float("nan")
        low, high = (
            self.scatter * sqrt((self.k - 1) / float(chdtri(self.k - 1, tail)))
            for tail in (_OUTSIDE / 2, 1 - _OUTSIDE / 2)
        )
        return low, high

    @property
    def chi2(self) -> float:
        """Sum of ((value - pooled) / std)²; chi-squared with k - 1 degrees of freedom."""
        return float(np.sum(((self.values - self.pooled[0]) / self.std) ** 2))

    @property
    def p_value(self) -> float:
        """Chance of parts that differ as much, were they of one rig; nan for one part."""
        from scipy.special import chdtrc

        return float(chdtrc(self.k - 1, self.chi2)) if self.k > 1 else float("nan")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SplitStudy:
    """How an estimate and its standard deviation change with the length of the data."""

    parameter: str
    """Which parameter."""
    splits: tuple[Split, ...]
    """In the order of `parts`."""
    source: str = ""
    """Hash of the recording, or ""."""

    @property
    def exponent(self) -> float:
        """Slope of log std against log N over all parts; -1/2 by the law. nan for one length."""
        N = np.concatenate([s.N for s in self.splits])
        std = np.concatenate([s.std for s in self.splits])
        if np.ptp(np.log(N)) < 0.1:
            return float("nan")
        return float(np.polyfit(np.log(N), np.log(std), 1)[0])

    @property
    def std_growth(self) -> float:
        """Mean standard deviation of the last split over that of the first."""
        return float(np.mean(self.splits[-1].std) / np.mean(self.splits[0].std))

    @property
    def verdict(self) -> str:
        """Whether the parts agree, and how the standard deviation goes with the length."""
        return "\n".join([*self._trend(), *self._agreement()])

    def explain(self) -> str:
        """Say what the trend is, why, and whether the parts agree."""
        lines = self._trend()
        if lines:
            lines.append(
                "Each sample adds its share to the information, sum of psi(t)²/lambda, and the "
                "covariance is its inverse: half the data, half the information, twice the "
                "variance. What deviates from it is the input, which does not excite each part "
                "alike, and the initial state, which every part has to estimate anew."
            )
        return "\n".join([*lines, *self._agreement(scatter=True), *self._pooled()])

    def _trend(self) -> list[str]:
        """Return how the standard deviation changes with the number of parts."""
        first, last = self.splits[0], self.splits[-1]
        if len(self.splits) == 1:
            return []
        ratio = self.std_growth
        expected = sqrt(float(np.mean(first.N) / np.mean(last.N)))
        return [
            f"From {first.k} to {last.k} parts the standard deviation of {self.parameter} "
            f"changes by a factor of {ratio:.2f}, its variance by {ratio**2:.2f}; with 1/N for "
            f"the variance they would change by {expected:.2f} and {expected**2:.2f}."
        ]

    def _agreement(self, *, scatter: bool = False) -> list[str]:
        """Return whether the parts of each split agree."""
        lines = []
        for s in self.splits:
            if s.k == 1:
                continue
            word = "agree" if s.p_value >= _LEVEL else "DIFFER"
            line = (
                f"The {s.k} parts {word} at a level of {100 * _LEVEL:g} % (chi² {s.chi2:.2f} "
                f"with {plural(s.k - 1, 'degree')} of freedom, p {p_relation(s.p_value)})"
            )
            if scatter:
                reported = sqrt(float(np.mean(s.std**2)))
                low, high = s.scatter_interval
                line += f"; they scatter by {s.scatter:.2g} (95 % interval {low:.2g} to "
                line += f"{high:.2g}), where {reported:.2g} is reported"
            lines.append(f"{line}.")
        if any(s.p_value < _LEVEL for s in self.splits):
            lines.append(
                "Parts that differ by more than their standard deviations allow point to a model "
                "that leaves something out (friction, drift); the standard "
                "deviations know of the noise alone."
            )
        return lines

    def _pooled(self) -> list[str]:
        """Return that the parts together tell as much as the whole."""
        last, whole = self.splits[-1], next((s for s in self.splits if s.k == 1), None)
        if whole is None or last.k == 1:
            return []
        value, std = last.pooled
        return [
            f"Pooled with weights 1/std², the {last.k} parts give {value:.6g} ± {std:.2g}, the "
            f"whole gives {whole.values[0]:.6g} ± {whole.std[0]:.2g}: cutting loses no "
            "information but that for the initial states."
        ]

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of the estimates with ±2 deviations and, below, the law 1/sqrt(N)."""
        from armrig.physics.grey_box.figures import plot_split
        from armrig.plots.layout import figure_of

        return figure_of(plot_split(self, ax=ax))

    def __repr__(self) -> str:
        """Show the table: a line a part, a line a split."""
        lines = [f"{'parts':>5} {'N':>7} {self.parameter:>12} {'std':>9} {'std sqrt(N)':>12}"]
        for s in self.splits:
            for N, value, std in zip(s.N, s.values, s.std, strict=True):
                lines.append(f"{s.k:5d} {N:7.0f} {value:12.6g} {std:9.2g} {std * sqrt(N):12.4g}")
            if s.k > 1:
                value, std = s.pooled
                lines.append(
                    f"{'':5} {'pooled':>7} {value:12.6g} {std:9.2g} {s.scaled_std:12.4g}  "
                    f"chi² {s.chi2:.2f}, p {p_relation(s.p_value)}"
                )
        return "\n".join(lines)


@takes_recordings
def split_study(
    data: Dataset,
    parts: Sequence[int] = (1, 2, 4),
    estimator: Callable[[Dataset], Any] | None = None,
    *,
    parameter: str | None = None,
    progress: Callable[[int, int, str], object] | None = None,
) -> SplitStudy:
    """Estimate from the data cut into 1, 2, 4 … parts, and study the standard deviations.

    Parameters
    ----------
    data : Dataset
        N samples.
    parts : sequence of int, default (1, 2, 4)
        Into how many parts of equal length to cut, each an estimate of its own.
    estimator : callable, optional
        Dataset -> fit; `armrig.greybox` with its defaults if left out. A `GreyFit` or a `Fit` of
        black-box models, whose standard deviations are then those of its noise.
    parameter : str, optional
        Name of the parameter to study; the first by default.
    progress : callable, optional
        Called with the number of estimates done, of all, and the name of the next one, "" after
        the last.

    Raises
    ------
    ValueError
        A number of parts is no integer >= 1, a part is too short, the parameter is unknown, or its
        standard deviation is not known.
    """
    require_several(parts=parts)
    if not parts:
        raise InputError("parts=() is empty; give numbers of parts, such as (1, 2, 4)")
    for k in parts:
        require_integers(parts=(k, 1))
    estimator = greybox if estimator is None else estimator
    tell = progress or (lambda done, total, name: None)
    splits, done, total = [], 0, sum(parts)
    for k in parts:
        pieces, fits = data.split(k), []
        for i, piece in enumerate(pieces, 1):
            part = f"part {i} of {k}"
            tell(done, total, part)
            fits.append(_estimated(estimator, piece, parameter, part))
            done += 1
        names, values, stds = zip(*fits, strict=True)
        splits.append(
            Split(
                k=k,
                N=np.array([float(d.N - d.missing) for d in pieces]),
                values=np.array(values),
                std=np.array(stds),
            )
        )
        parameter = names[0]
    tell(done, total, "")
    return SplitStudy(parameter=str(parameter), splits=tuple(splits), source=data.source)


def _estimated(
    estimator: Callable[[Dataset], Any], data: Dataset, parameter: str | None, part: str
) -> tuple[str, float, float]:
    """Return name, estimate and standard deviation from one part, or refuse it by its name."""
    try:
        fit = estimator(data)
        if isinstance(fit, GreyFit):
            fit.require_result()
    except ValueError as err:
        raise InputError(f"{part}: {err}") from err
    return _numbers(fit, parameter)


def _numbers(fit: Any, parameter: str | None) -> tuple[str, float, float]:
    """Return name, estimate and standard deviation of one parameter of a fit."""
    names = list(fit.names)
    name = names[0] if parameter is None else parameter
    if name not in names:
        raise InputError(f"parameter={name!r} is none of {', '.join(names)}")
    if hasattr(fit, "std_noise"):
        value, std = fit.values[name], fit.std_noise[name]
    else:
        i = names.index(name)
        value, std = float(fit.theta[i]), float(fit.std[i])
    if not (isfinite(value) and isfinite(std) and std > 0):
        raise InputError(
            f"{name} = {value:g} ± {std:g} in a part: there is no standard deviation to study"
        )
    return name, value, std
