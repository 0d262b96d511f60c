"""Estimates of one parameter from all data, from halves and from quarters (handout 3.6)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite, sqrt
from typing import Any

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_recordings
from armrig.data.columns import Vector
from armrig.data.dataset import Dataset
from armrig.numerics.checks import require_integers, several
from armrig.numerics.quantities import digits, p_relation, plural
from armrig.physics.grey_box.estimate import greybox
from armrig.physics.grey_box.fit import GreyFit
from armrig.plots.layout import plot_method

_DIFFERENCE_LEVEL = 0.01  # p value below which the parts differ
_INTERVAL_OUTSIDE_SHARE = 0.05  # probability outside the confidence interval of `scatter`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Split:
    """Estimates of one parameter from the data cut into k parts."""

    k: int
    """Number of parts."""
    N: Vector
    """Number of samples with an output in each part, (k,)."""
    values: Vector
    """Estimates, (k,)."""
    std: Vector
    """Reported standard deviations of the estimates, due to the noise alone, (k,)."""

    @property
    def scaled_std(self) -> float:
        """Mean of std sqrt(N); equal for every k if the law 1/sqrt(N) holds."""
        return float(np.mean(self.std * np.sqrt(self.N)))

    @property
    def pooled(self) -> tuple[float, float]:
        """Mean of the estimates with weights 1/std², and standard deviation of this mean."""
        weights = self.std**-2
        return float(weights @ self.values / weights.sum()), float(weights.sum() ** -0.5)

    @property
    def scatter(self) -> float:
        """Standard deviation of the estimates about their mean, NaN for one part."""
        return float(np.std(self.values, ddof=1)) if self.k > 1 else float("nan")

    @property
    def scatter_interval(self) -> tuple[float, float]:
        """95 % confidence interval of the true standard deviation, from `scatter`; NaN for k = 1.

        scatter² (k - 1) divided by the true variance is chi-squared with k - 1 degrees of freedom.
        """
        from scipy.special import chdtri

        if self.k == 1:
            return float("nan"), float("nan")
        low, high = (
            self.scatter * sqrt((self.k - 1) / float(chdtri(self.k - 1, tail)))
            for tail in (_INTERVAL_OUTSIDE_SHARE / 2, 1 - _INTERVAL_OUTSIDE_SHARE / 2)
        )
        return low, high

    @property
    def chi2(self) -> float:
        """Sum of ((value - pooled) / std)²; chi-squared with k - 1 degrees of freedom."""
        return float(np.sum(((self.values - self.pooled[0]) / self.std) ** 2))

    @property
    def p_value(self) -> float:
        """Probability of at least this `chi2` if all true values are equal; NaN for one part."""
        from scipy.special import chdtrc

        return float(chdtrc(self.k - 1, self.chi2)) if self.k > 1 else float("nan")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SplitStudy:
    """Study of an estimate and its standard deviation as functions of the length of the data."""

    parameter: str
    """Name of the parameter."""
    splits: tuple[Split, ...]
    """Splits in the order of `parts`."""
    source: str = ""
    """Hash of the recording, or ""."""

    @property
    def exponent(self) -> float:
        """Slope of log std against log N over all parts; NaN if all parts have the same length.

        According to the law 1/sqrt(N), the slope is -1/2.
        """
        N = np.concatenate([s.N for s in self.splits])
        std = np.concatenate([s.std for s in self.splits])
        if np.ptp(np.log(N)) < 0.1:
            return float("nan")
        return float(np.polyfit(np.log(N), np.log(std), 1)[0])

    @property
    def std_growth(self) -> float:
        """Mean standard deviation in the last split, divided by the mean in the first split."""
        return float(np.mean(self.splits[-1].std) / np.mean(self.splits[0].std))

    @property
    def verdict(self) -> str:
        """Text on the trend of the standard deviation, and on the agreement of the parts."""
        return "\n".join(self._sentences(full=False))

    def explain(self) -> str:
        """Return a text on the trend, its reason, and the agreement of the parts."""
        return "\n".join(self._sentences(full=True))

    def _sentences(self, *, full: bool) -> list[str]:
        first, last, lines = self.splits[0], self.splits[-1], []
        cut = [s for s in self.splits if s.k > 1]
        if len(self.splits) > 1:
            ratio, expected = self.std_growth, sqrt(float(np.mean(first.N) / np.mean(last.N)))
            lines.append(
                f"From {first.k} to {plural(last.k, 'part')} the standard deviation of "
                f"{self.parameter} changes by a factor of {ratio:.2f}, its variance by "
                f"{ratio**2:.2f}. If the variance were proportional to 1/N, the factors would be "
                f"{expected:.2f} and {expected**2:.2f}."
            )
        if lines and full:
            lines.append(
                "Each sample adds its share psi(t)²/lambda to the information. The covariance is "
                "the inverse of the information: half the data have half the information and twice "
                "the variance. Deviations from this law have two reasons: the input does not "
                "excite all parts equally, and each part must estimate an initial state."
            )
        for s in cut:
            word = "agree" if s.p_value >= _DIFFERENCE_LEVEL else "DIFFER"
            line = (
                f"The {plural(s.k, 'part')} {word} at a level of {100 * _DIFFERENCE_LEVEL:g} % "
                f"(chi² {s.chi2:.2f} with {plural(s.k - 1, 'degree')} of freedom, "
                f"p {p_relation(s.p_value)})"
            )
            if full:
                reported = sqrt(float(np.mean(s.std**2)))
                low, high = s.scatter_interval
                line += (
                    f"; they scatter by {digits(s.scatter, 2)} (95 % interval {digits(low, 2)} to "
                    f"{digits(high, 2)}), and the reported standard deviation is "
                    f"{digits(reported, 2)}"
                )
            lines.append(f"{line}.")
        if any(s.p_value < _DIFFERENCE_LEVEL for s in cut):
            lines.append(
                "If parts differ by more than their standard deviations allow, the model probably "
                "lacks a property of the rig (friction, drift). The standard deviations contain "
                "only the noise."
            )
        return lines

    plot = plot_method(
        "plot_split", "the estimates with ±2 standard deviations and the law 1/sqrt(N)"
    )

    def __repr__(self) -> str:
        """Return a table with a line for each part and a line for each split."""
        lines = [f"{'parts':>5} {'N':>7} {self.parameter:>12} {'std':>9} {'std sqrt(N)':>12}"]
        for s in self.splits:
            for N, value, std in zip(s.N, s.values, s.std, strict=True):
                lines.append(
                    f"{s.k:5d} {N:7.0f} {value:12.6g} {digits(std, 2):>9} {std * sqrt(N):12.4g}"
                )
            if s.k > 1:
                value, std = s.pooled
                lines.append(
                    f"{'':5} {'pooled':>7} {value:12.6g} {digits(std, 2):>9} {s.scaled_std:12.4g}  "
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
    """Study estimates and standard deviations from data cut into 1, 2, 4 … parts.

    Parameters
    ----------
    data : Dataset
        N samples.
    parts : sequence of int, default (1, 2, 4)
        Numbers of equal parts into which the data are cut. The parameter is estimated from each
        part.
    estimator : callable, optional
        Function Dataset -> `GreyFit` or `Fit`; by default `armrig.greybox`. For a `GreyFit` the
        study uses the standard deviations due to noise only.
    parameter : str, optional
        Name of the parameter to study; by default the first parameter of the fit.
    progress : callable, optional
        Function of three arguments: the number of finished estimates, the number of all estimates,
        and the name of the next estimate ("" after the last estimate).

    Raises
    ------
    ValueError
        A number of parts is not an integer >= 1, a part is too short, the parameter is unknown, or
        its standard deviation is not known.

    Examples
    --------
    >>> import armrig
    >>> data = armrig.example_recording().dataset("theta_1")
    >>> arm = armrig.physics.arm
    >>> study = armrig.split_study(data, estimator=lambda part: armrig.greybox(part, arm))
    >>> [split.k for split in study.splits], round(study.exponent, 1)
    ([1, 2, 4], -0.5)
    >>> print(study.verdict)
    From 1 to 4 parts the standard deviation of J_1 changes by a factor of 2.0..., ...
    The 2 parts agree at a level of 1 % (...).
    The 4 parts agree at a level of 1 % (...).
    """
    parts = several("parts", parts)
    for k in parts:
        require_integers(parts=(k, 1))
    estimator = greybox if estimator is None else estimator
    report = progress or (lambda done, total, name: None)
    splits, done, total = [], 0, sum(parts)
    for k in parts:
        pieces, fits = data.split(k), []
        for i, piece in enumerate(pieces, 1):
            part = f"part {i} of {k}"
            report(done, total, part)
            fits.append(_estimate_part(estimator, piece, parameter, part))
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
    report(done, total, "")
    return SplitStudy(parameter=str(parameter), splits=tuple(splits), source=data.source)


def _estimate_part(
    estimator: Callable[[Dataset], Any], data: Dataset, parameter: str | None, part: str
) -> tuple[str, float, float]:
    """Return name, estimate and std of a parameter from one part; an error names the part."""
    try:
        fit = estimator(data)
        if isinstance(fit, GreyFit):
            fit.require_result()
    except ValueError as err:
        raise InputError(f"{part}: {err}") from err
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
