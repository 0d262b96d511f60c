"""The result of a grey-box estimation: parameters with their uncertainty and influences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.data.columns import Matrix, Vector
from armrig.data.dataset import Dataset, Signals
from armrig.data.step import in_loop
from armrig.numerics.inference import OutputQuality
from armrig.numerics.quantities import digits, join_names, plural
from armrig.physics.grey_box.physical_models import PhysicalModel

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MIN_SIGMAS = 2.0  # least distance of a determined parameter from 0, in standard deviations
_WAY_OUT = (
    "estimate fewer parameters, start nearer to them, or record longer with an input that changes "
    "often"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class GreyFit:
    """Physical parameters from data, with their uncertainty.

    Examples
    --------
    >>> import armrig
    >>> fit = armrig.greybox(armrig.example_recording().dataset("theta_1"), armrig.physics.arm)
    >>> print(fit)
    grey box (output error), theta_1, 2903 samples at 0.01 s, fit 99.99 %, rms 0.0035... rad
                 estimate        std     robust
      J_1      0.0017...    2.2e-06    2.2e-06 kg m²
    >>> fit.names, fit.converged, bool(fit.whiteness > 0.01)
    (('J_1',), True, True)
    """

    names: tuple[str, ...]
    """Estimated parameters, in the order of the covariance."""
    values: dict[str, float]
    """Estimates by name, in SI units."""
    std: dict[str, float]
    """Standard deviations by name, due to the noise and the uncertainty of fixed parameters."""
    std_noise: dict[str, float]
    """Standard deviations by name, due to the noise only; more data decrease them."""
    std_robust: dict[str, float]
    """Standard deviations by name, valid also if the residuals are coloured."""
    covariance: Matrix
    """Covariance of the estimates, (d, d), in products of their units."""
    covariance_robust: Matrix
    """Covariance of the estimates, sandwich form."""
    condition: float
    """Condition number of the scaled derivatives; 1 is best. It is large if the data hardly
    distinguish the parameters."""
    influence: dict[str, dict[str, float]]
    """Change of an estimate, in percent, if a fixed parameter is 1 % larger. The first key is the
    name of the estimate, and the second key is the name of the fixed parameter."""
    fixed: Any
    """All parameters, fixed and estimated: `ArmParameters`, or a mapping for own equations."""
    fixed_std: dict[str, float]
    """Standard deviations of fixed parameters, as given to the estimator."""
    initial: tuple[tuple[float, ...], ...]
    """Initial state of each experiment."""
    offset: tuple[float, ...]
    """Input u0 of each experiment at which the rig is at rest, in the input's unit."""
    noise_variance: float
    """Variance of the noise in the squared unit of y, from the residuals and their degrees of
    freedom."""
    loss: float
    """Mean squared residual, in the squared unit of y."""
    fit_percent: float
    """Fit of the simulated output to the estimation data, 100 (1 - |y - ŷ| / |y - mean y|)."""
    whiteness: float
    """p value of the hypothesis that the residuals are white."""
    whiteness_test: str
    """Name of the test of `whiteness`."""
    quantum: float
    """Quantisation step of the output, 0 if no step is visible."""
    N: int
    """Number of samples used."""
    Ts: float
    """Sampling time, in s."""
    converged: bool = True
    """True if the search met its tolerance."""
    physics: PhysicalModel
    """Physical model with its fixed parameters."""
    by_output: Mapping[str, OutputQuality] = field(default_factory=dict)
    """Quality for each output, if several outputs were used.

    `loss`, `fit_percent` and `whiteness` are the values for `output`.
    """
    warnings: tuple[str, ...] = ()
    """Warnings on the reliability of the numbers."""
    output: str = "y"
    """Name of y."""
    unit: str = ""
    """Unit of y."""
    input_unit: str = ""
    """Unit of u."""
    source: str = ""
    """Hash of the recording or data file, or ""."""
    history: tuple[str, ...] = ()
    """Treatment of the data."""
    digest: str = ""
    """Hash of the data, see `Dataset.digest`."""

    @property
    def correlation(self) -> Matrix:
        """Correlation of the estimates, (d, d)."""
        s = np.sqrt(np.diag(self.covariance))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.covariance / np.outer(s, s))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Positive parameters whose estimate is within two standard deviations of 0."""
        return tuple(
            name
            for name in self.names
            if self.physics.parameters[name].low >= 0
            and _MIN_SIGMAS * self.std_noise[name] >= abs(self.values[name])
        )

    def require_result(self) -> None:
        """Refuse a search that did not converge, and parameters that the data do not determine.

        Raises
        ------
        InputError
            The search did not converge, or a parameter is not determined.

        Examples
        --------
        The first 0.3 s of the data do not determine J_2.

        >>> import armrig
        >>> data = armrig.example_recording().dataset("theta_1")
        >>> armrig.greybox(data, armrig.physics.arm, free=["J_2", "K_lin"]).require_result()
        >>> armrig.greybox(data[:30], armrig.physics.arm, free=["J_2", "K_lin"]).require_result()
        Traceback (most recent call last):
            ...
        armrig_core.errors.InputError: J_2 = 0.0039... kg m²: not identifiable from these ...
        """
        lost = [
            f"{n} = {digits(self.values[n], 3)} ± {digits(self.std_noise[n], 2)} "
            f"{self.physics.parameters[n].unit}".rstrip()
            for n in self.undetermined
        ]
        if lost:
            raise InputError(
                f"{', '.join(lost)}: not identifiable from these {plural(self.N, 'sample')}, 2 "
                f"standard deviations reach 0; {_WAY_OUT}"
            )
        if not self.converged:
            raise InputError(
                f"the search for {', '.join(self.names)} did not converge, so there is no "
                f"result; {_WAY_OUT}"
            )

    @property
    def relative_std(self) -> dict[str, float]:
        """Standard deviations divided by the estimates, by name."""
        return {n: self.std[n] / abs(v) if v else np.inf for n, v in self.values.items()}

    def to_control(self) -> control.StateSpace:
        """Return the continuous model at the estimates, without Coulomb friction.

        Examples
        --------
        >>> import armrig
        >>> fit = armrig.greybox(armrig.example_recording().dataset("theta_1"), armrig.physics.arm)
        >>> system = fit.to_control()
        >>> system.input_labels, system.output_labels
        (['u'], ['theta_1', 'alpha'])
        >>> system.isctime()
        True
        """
        return self.physics.to_control(self.fixed)

    def simulate(self, u: ArrayLike) -> Vector:
        """Return the simulated output (N,) for a held u, from rest and without Coulomb friction.

        Examples
        --------
        >>> import armrig, numpy as np
        >>> fit = armrig.greybox(armrig.example_recording().dataset("theta_1"), armrig.physics.arm)
        >>> theta_1 = fit.simulate(2.0 * np.ones(101))
        >>> print(f"{theta_1[-1]:.1f} rad after {100 * fit.Ts:.0f} s at 2 V")
        3.5 rad after 1 s at 2 V
        """
        return self.physics.simulate(self._values, u, self.Ts)

    def errors(self, data: Dataset | Signals) -> Matrix:
        """Return measured minus simulated outputs (N, ny), NaN where an output is missing.

        The initial state of each experiment is estimated from `data`, and for a linear model the
        offset of the input. A linear model is simulated without Coulomb friction.

        Raises
        ------
        ValueError
            The data have other outputs than the model; the name y means any output.

        Examples
        --------
        >>> import armrig, numpy as np
        >>> data = armrig.example_recording().dataset("theta_1")
        >>> fit = armrig.greybox(data, armrig.physics.arm)
        >>> f"{np.sqrt(np.nanmean(fit.errors(data) ** 2)):.4f} rad"
        '0.003... rad'
        """
        from armrig.physics.grey_box.shooting import Shooting

        signals, outputs = data.signals(), (*self.by_output,) or (self.output,)
        if outputs != signals.outputs and not {"y"} & {*outputs, *signals.outputs}:
            raise InputError(
                f"the model's outputs are {join_names(outputs)} and the data have "
                f"{join_names(signals.outputs)}; give data with the model's outputs"
            )
        parts, nothing = tuple(signals.experiments()), np.zeros(0)
        with np.errstate(all="ignore"):
            problem = Shooting.of(self.physics, (), dict(self._values), parts)
            z = problem.solve_relaxed(nothing, problem.start_states(nothing))
            return problem.residuals(problem.searched(z).theta)

    @property
    def _values(self) -> Mapping[str, float]:
        return self.fixed if isinstance(self.fixed, dict) else self.values

    def plot(self, data: Dataset, *, ax: Axes | None = None) -> Figure:
        """Return a figure of measured and simulated output with the error below.

        Examples
        --------
        >>> import armrig
        >>> data = armrig.example_recording().dataset("theta_1")
        >>> armrig.greybox(data, armrig.physics.arm).plot(data)
        <Figure size ... with 2 Axes>
        """
        from armrig.plots import plot_greybox
        from armrig.plots.layout import figure_of

        return figure_of(plot_greybox(self, data, ax=ax))

    def explain(self) -> str:
        """Return a text with the estimates and their dependence on the fixed parameters.

        Examples
        --------
        >>> import armrig
        >>> data = armrig.example_recording().dataset("theta_1")
        >>> print(armrig.greybox(data, armrig.physics.arm).explain())
        J_1 = 0.0017... ± 2.2e-06 kg m² (one standard deviation, 0.13 %).
        If a fixed parameter is 1 % larger, J_1 changes: J_2 -2.8... %, N +0.9... %, ...
        """
        parts: list[str] = [
            *in_loop(self.history, "the loop biases an estimate without a noise model")
        ]
        for name in self.names:
            unit = f" {self.physics.parameters[name].unit}".rstrip()
            share = self.relative_std[name]
            if np.isnan(share):
                parts.append(f"{name} = {self.values[name]:.5g}{unit}, at its bound.")
                continue
            parts.append(
                f"{name} = {self.values[name]:.5g} ± {digits(self.std[name], 2)}{unit} "
                f"(one standard deviation{f', {digits(100 * share, 2)} %' if share < 1 else ''})."
            )
            moved = {k: v for k, v in self.influence.get(name, {}).items() if abs(v) >= 0.05}
            if moved:
                shares = ", ".join(f"{k} {v:+.2f} %" for k, v in moved.items())
                parts.append(f"If a fixed parameter is 1 % larger, {name} changes: {shares}.")
        if any(self.fixed_std.values()):
            noise = ", ".join(f"{k} {digits(v, 2)}" for k, v in self.std_noise.items())
            parts.append(f"Standard deviations due to the noise only: {noise}.")
        return "\n".join([*parts, *(f"Note: {w}." for w in self.warnings)])

    def __repr__(self) -> str:
        """Return a table of the estimates with classic and robust standard deviations."""
        lines = [
            f"grey box (output error), {self.output}, {plural(self.N, 'sample')} at {self.Ts:g} s, "
            f"fit {self.fit_percent:.2f} %, rms {digits(np.sqrt(self.loss), 3)} "
            f"{self.unit}".rstrip(),
            f"  {'':6} {'estimate':>12} {'std':>10} {'robust':>10}",
        ]
        lines += [
            f"  {n:6} {self.values[n]:12.6g} {digits(self.std[n], 2):>10} "
            f"{digits(self.std_robust[n], 2):>10} "
            f"{self.physics.parameters[n].unit}".rstrip()
            for n in self.names
        ]
        lines += [
            f"  {name}: fit {q.fit_percent:.2f} %, rms {digits(np.sqrt(q.loss), 3)}, N {q.N}, "
            f"{q.white}"
            for name, q in self.by_output.items()
        ]
        return "\n".join([*lines, *(f"  warning: {w}" for w in self.warnings)])
