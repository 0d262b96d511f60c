"""The result of a grey-box estimation: parameters, how sure they are, and what that rests on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.arm import ArmParameters
from armrig_core.errors import InputError
from numpy.typing import ArrayLike, NDArray

from armrig.numerics.checks import column
from armrig.physics.grey_box.parameters import COULOMB, SIGNED, UNITS
from armrig.physics.grey_box.response import linear_parts
from armrig.physics.grey_box.sampled_model import Physics

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from armrig.data.dataset import Dataset

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
_SURE = 2.0  # standard deviations that a parameter must be from 0
_WAY_OUT = (
    "free fewer parameters, begin nearer to them, or record longer with an input that changes often"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class GreyFit:
    """Physical parameters from data, with their uncertainty."""

    method: str
    """"output error" or "inverse dynamics"."""
    names: tuple[str, ...]
    """Parameters that were free, in the order of the matrices."""
    values: dict[str, float]
    """Estimates by name, in SI units."""
    std: dict[str, float]
    """Standard deviations by name: noise, and the uncertainty of what was held fixed."""
    std_noise: dict[str, float]
    """The part of `std` that the noise makes; smaller with more data, the other part is not."""
    std_robust: dict[str, float]
    """As `std`, right also where the residuals are coloured."""
    covariance: Matrix
    """Of the estimates, (d, d), in products of their units."""
    covariance_robust: Matrix
    """As `covariance`, the sandwich form."""
    condition: float
    """Condition number of the scaled derivatives: how nearly the parameters stand in for each
    other; 1 is best."""
    influence: dict[str, dict[str, float]]
    """By free and fixed name: percent that the estimate moves where the fixed one is 1 % higher."""
    fixed: ArmParameters
    """All parameters, the estimates in their place."""
    fixed_std: dict[str, float]
    """What was given for those held fixed."""
    initial: tuple[tuple[float, ...], ...]
    """Initial state of each experiment."""
    offset: tuple[float, ...]
    """Input that each experiment answers with standstill (u0), in the input's unit."""
    noise_variance: float
    """Of the residuals, degrees of freedom subtracted."""
    loss: float
    """Mean squared residual."""
    fit_percent: float
    """100 (1 - |y - ŷ| / |y - mean y|), simulated, on the estimation data."""
    whiteness: float
    """p value of white residuals; for inverse dynamics of smoothed white noise."""
    whiteness_test: str
    """Name of the test that it is of."""
    quantum: float
    """Step in which the output was read, 0 where none is seen."""
    N: int
    """Samples used."""
    Ts: float
    """Sampling time, in s."""
    converged: bool = True
    """The search met its tolerance."""
    physics: Physics
    """The model."""
    width: float = np.nan
    """Standard deviation of the smoothing kernel in s; NaN where nothing was smoothed."""
    bias: dict[str, float] = field(default_factory=dict)
    """What the noise of the smoothed velocity adds to the estimates, by name; none is taken off."""
    warnings: tuple[str, ...] = ()
    """What a reader should know before trusting the numbers."""
    output: str = "y"
    """Name of y."""
    unit: str = ""
    """Unit of y."""
    input_unit: str = ""
    """Unit of u."""
    source: str = ""
    """Hash of the recording, or ""."""
    history: tuple[str, ...] = ()
    """Treatment of the data."""
    digest: str = ""
    """Fingerprint of the data."""

    def __post_init__(self) -> None:
        """Make the arrays as frozen as the rest."""
        for name in ("covariance", "covariance_robust"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def correlation(self) -> Matrix:
        """Correlation of the estimates, (d, d)."""
        s = np.sqrt(np.diag(self.covariance))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.covariance / np.outer(s, s))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters above 0 by definition that two standard deviations of the noise take to 0."""
        return tuple(
            name
            for name in self.names
            if name not in SIGNED | {COULOMB}
            and not _SURE * self.std_noise[name] < abs(self.values[name])
        )

    def require_result(self) -> None:
        """Refuse a search that did not end, and parameters that the data do not determine.

        Raises
        ------
        InputError
            With what to do.
        """
        if lost := self.undetermined:
            raise InputError(
                f"{', '.join(map(self._figure, lost))}: not identifiable from these {self.N} "
                f"samples, 2 standard deviations reach 0; {_WAY_OUT}"
            )
        if not self.converged:
            raise InputError(
                f"the search for {', '.join(self.names)} did not converge, so there is no "
                f"result; {_WAY_OUT}"
            )

    def _figure(self, name: str) -> str:
        unit = f" {UNITS.get(name, '')}".rstrip()
        return f"{name} = {self.values[name]:.3g} ± {self.std_noise[name]:.2g}{unit}"

    @property
    def relative_std(self) -> dict[str, float]:
        """Standard deviations as shares of the estimates."""
        return {n: self.std[n] / abs(v) if v else np.inf for n, v in self.values.items()}

    def to_control(self) -> control.StateSpace:
        """Return the model at the estimates, in continuous time; without Coulomb friction."""
        return self.physics.model(self.fixed)

    def simulate(self, u: ArrayLike) -> Vector:
        """Return the output (N,) for u held over Ts, from rest; without Coulomb friction."""
        model = self.physics.sampled(
            {k: v for k, v in self.values.items() if k != COULOMB}, (), self.Ts
        )
        return linear_parts(model, column("u", u))[0]

    def plot(self, data: Dataset, *, ax: Axes | None = None) -> Figure:
        """Return a figure of measured and simulated output and, below, the error."""
        from armrig.physics.grey_box.figures import plot_greybox
        from armrig.plots.layout import figure_of

        return figure_of(plot_greybox(self, data, ax=ax))

    def explain(self) -> str:
        """Say what was found and what it rests on."""
        parts = []
        for name in self.names:
            unit = f" {UNITS.get(name, '')}".rstrip()
            share = self.relative_std[name]
            parts.append(
                f"{name} = {self.values[name]:.5g} ± {self.std[name]:.2g}{unit} "
                f"(one standard deviation{f', {100 * share:.2g} %' if share < 1 else ''})."
            )
            moved = {k: v for k, v in self.influence.get(name, {}).items() if abs(v) >= 0.05}
            if moved:
                shares = ", ".join(f"{k} {v:+.2f} %" for k, v in moved.items())
                parts.append(f"On these data 1 % more of what was held fixed moves it: {shares}.")
        if np.isfinite(self.width):
            added = ", ".join(f"{v:+.2g} to {k}" for k, v in self.bias.items())
            parts.append(
                f"Smoothed over {self.width:.3g} s (one standard deviation of the kernel); the "
                f"noise of the velocity adds {added}."
            )
        if any(self.fixed_std.values()):
            noise = ", ".join(f"{k} {v:.2g}" for k, v in self.std_noise.items())
            parts.append(f"Standard deviations by the noise alone: {noise}.")
        return "\n".join([*parts, *(f"Note: {w}." for w in self.warnings)])

    def __repr__(self) -> str:
        """Show the estimates with both standard deviations."""
        unit = f"{self.unit}/s²" if self.method == "inverse dynamics" else self.unit
        lines = [
            f"grey box ({self.method}), {self.output}, {self.N} samples at {self.Ts:g} s, "
            f"fit {self.fit_percent:.2f} %, rms {np.sqrt(self.loss):.3g} {unit}",
            f"  {'':6} {'estimate':>12} {'std':>10} {'robust':>10}",
        ]
        lines += [
            f"  {n:6} {self.values[n]:12.6g} {self.std[n]:10.2g} {self.std_robust[n]:10.2g} "
            f"{UNITS.get(n, '')}".rstrip()
            for n in self.names
        ]
        return "\n".join([*lines, *(f"  warning: {w}" for w in self.warnings)])


def below_zero(values: dict[str, float], std: dict[str, float]) -> list[str]:
    """Return a warning for each friction that came out negative."""
    return [
        f"{n} = {v:.2g} is below 0, by {abs(v) / std[n]:.1f} standard deviations: take it as 0"
        for n, v in values.items()
        if n in SIGNED | {COULOMB} and v < 0 < std[n] < np.inf
    ]
