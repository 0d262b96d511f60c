"""Whether two estimates of the same parameters from the same data agree."""

from __future__ import annotations

from dataclasses import dataclass
from math import erfc, sqrt

from armrig.data.quantisation import too_quiet
from armrig.numerics.quantities import p_relation
from armrig.physics.grey_box.fit import GreyFit


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """How far apart two estimates of one parameter are."""

    name: str
    """Of the parameter."""
    difference: float
    """Second less first, in the parameter's unit."""
    std: float
    """Of the difference, were both right."""
    p_value: float
    """Chance of a difference as large, were both right."""
    note: str = ""
    """Why the p value must not be trusted, "" where it may."""

    def __repr__(self) -> str:
        """Say it in one line."""
        z = self.difference / self.std
        text = (
            f"{self.name}: {self.difference:+.3g} apart, {z:+.2f} sd, p {p_relation(self.p_value)}"
        )
        return f"{text} ({self.note})" if self.note else text


def agreement(efficient: GreyFit, other: GreyFit) -> tuple[Agreement, ...]:
    """Return for each common parameter how well another estimate agrees with the efficient one.

    Both come from the same noise. An efficient estimate is not correlated with its distance from
    another consistent one, so the variance of the difference is the difference of the variances;
    not their sum, with which two wrong estimates would seem to agree.

    Parameters
    ----------
    efficient : GreyFit
        Of `greybox`.
    other : GreyFit
        Of `inverse_dynamics`, from the same data.

    References
    ----------
    .. [1] J. A. Hausman, Econometrica 46 (1978) 1251-1271.
    """
    rows = []
    note = too_quiet(efficient.quantum, efficient.noise_variance)
    for name in efficient.names:
        if name not in other.names:
            continue
        variance = other.std_noise[name] ** 2 - efficient.std_noise[name] ** 2
        std = sqrt(max(variance, (0.1 * other.std_noise[name]) ** 2))
        difference = other.values[name] - efficient.values[name]
        p_value = erfc(abs(difference) / std / sqrt(2))
        rows.append(
            Agreement(name=name, difference=difference, std=std, p_value=p_value, note=note)
        )
    return tuple(rows)
