"""Result of the tests of a model with several signals by its residuals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.finding import EstimateFinding
from armrig.numerics.polynomial import Array
from armrig.numerics.quantities import listed, p_relation
from armrig.numerics.whiteness import WHITE_LEVEL, Whiteness
from armrig.validation.power import lack_of_power

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DYNAMICS = "no dynamics missing", "dynamics missing"
_FEEDBACK = "no feedback", "feedback, or a delay too large"
_NOT_VALID = "until the dynamics are modelled, the test of feedback is not valid"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PairTest:
    """Correlation of the residuals of one output with one input."""

    output: str
    """Name of the output."""
    input: str
    """Name of the input."""
    lags: NDArray[np.int_]
    """Lags -L … L; at a positive lag the input precedes the residual."""
    correlation: Array
    """Correlation of e_i(t) with u_j(t - lag) at `lags`."""
    std: Array
    """Standard deviations of `correlation`, with the effect of the estimated parameters."""
    missing_dynamics: float
    """p value of the hypothesis that past and present input are uncorrelated with the residuals."""
    feedback: float
    """p value of the hypothesis that future input is uncorrelated with the residuals."""

    def __repr__(self) -> str:
        """Return the results of both tests."""
        return "\n".join(
            [
                f"{self.input} to {self.output}",
                f"  {_verdict(*_DYNAMICS, self.missing_dynamics)}",
                f"  {_verdict(*_FEEDBACK, self.feedback)}",
            ]
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SignalsResidualTest:
    """Correlations of the residuals of several outputs with themselves and with the inputs."""

    outputs: tuple[str, ...]
    """Names of the outputs."""
    inputs: tuple[str, ...]
    """Names of the inputs."""
    e: Array
    """Residuals one step ahead, (N, ny), NaN where they are not known."""
    lags: NDArray[np.int_]
    """Lags 0 … L."""
    autocorrelation: Array
    """Correlation of e_i(t) with e_k(t - lag) at `lags`, (ny, ny, L + 1); 1 at i = k and lag 0."""
    white_by_output: tuple[Whiteness, ...]
    """Test of the hypothesis that the residuals of each output are white."""
    white: Whiteness
    """Test of the hypothesis that the vector of residuals is white, for all outputs together."""
    cross_lags: NDArray[np.int_]
    """Lags -L … L; at a positive lag the input precedes the residual."""
    cross_correlation: Array
    """Correlation of e_i(t) with u_j(t - lag) at `cross_lags`, (ny, nu, 2 L + 1)."""
    cross_std: Array
    """Standard deviations of `cross_correlation`, with the effect of the estimated parameters."""
    missing_dynamics_by_pair: Array
    """For each output and input, the p value of the hypothesis that past and present input are
    uncorrelated with the residuals, (ny, nu)."""
    feedback_by_pair: Array
    """For each output and input, the p value of the hypothesis that future input is uncorrelated
    with the residuals, (ny, nu)."""
    missing_dynamics: float
    """p value of the hypothesis that no past or present input is correlated with any residual."""
    feedback: float
    """p value of the hypothesis that no future input is correlated with any residual."""
    allowance: float
    """Factor by which the parameters' uncertainty widens the band of a typical
    cross-correlation."""
    on_estimation_data: bool
    """True if the parameters were estimated from these data; the tests account for this."""
    source: str
    """Hash of the recording, or ""."""
    findings: tuple[EstimateFinding, ...] = ()
    """Warnings, with the code "overlap" if the model was also estimated from a part of these data.
    """

    @property
    def rejects(self) -> bool:
        """True if a joint test rejects the model."""
        p = self.white.p_value, self.missing_dynamics, self.feedback
        return any(value < WHITE_LEVEL for value in p)

    @property
    def poorest_pair(self) -> tuple[str, str]:
        """Output and input with the least p value of missing dynamics."""
        p = np.nan_to_num(self.missing_dynamics_by_pair, nan=1.0)
        i, j = np.unravel_index(int(np.argmin(p)), p.shape)
        return self.outputs[i], self.inputs[j]

    @property
    def powerless(self) -> str:
        """Reason why the tests have no power, with a remedy; "" if they have power."""
        return lack_of_power(self.allowance, on_estimation_data=self.on_estimation_data)

    def __getitem__(self, channel: tuple[str, str]) -> PairTest:
        """Return the tests of one output and input: tests["alpha", "u"].

        Raises
        ------
        ValueError
            There is no such output or input.
        """
        output, input = channel if isinstance(channel, tuple) else (channel, None)
        if output not in self.outputs or input not in self.inputs:
            raise InputError(
                f"{channel!r} is no channel; give an output of {listed(self.outputs)} and an input "
                f"of {listed(self.inputs)}"
            )
        i, j = self.outputs.index(output), self.inputs.index(input)
        return PairTest(
            output=output,
            input=input,
            lags=self.cross_lags,
            correlation=self.cross_correlation[i, j],
            std=self.cross_std[i, j],
            missing_dynamics=float(self.missing_dynamics_by_pair[i, j]),
            feedback=float(self.feedback_by_pair[i, j]),
        )

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure with a row for each output: autocorrelation, cross-correlations."""
        from armrig.plots.layout import figure_of
        from armrig.validation.multivariable.figures import plot_signals_residuals

        return figure_of(plot_signals_residuals(self, ax=ax))

    def _repr_html_(self) -> str:
        """Return text and figure as HTML for a notebook."""
        from armrig.plots.notebook import html

        return html(self)

    def __repr__(self) -> str:
        """Return a text: the joint tests, then a line for each output and each rejected pair."""
        where = "estimation" if self.on_estimation_data else "validation"
        counts = np.isfinite(self.e).sum(axis=0).tolist()
        missing = self.missing_dynamics < WHITE_LEVEL
        lines = [
            f"residuals on {where} data, {listed([str(n) for n in counts])} samples",
            f"  all outputs together: {self.white}",
            f"  {_verdict(*_DYNAMICS, self.missing_dynamics)}",
            f"  {_NOT_VALID if missing else _verdict(*_FEEDBACK, self.feedback)}",
            *([f"  no power: {self.powerless}"] if self.powerless else []),
        ]
        lines += [
            f"  {name}: {white}"
            for name, white in zip(self.outputs, self.white_by_output, strict=True)
        ]
        of_pairs = [(self.missing_dynamics_by_pair, _DYNAMICS[1])]
        if not missing:
            of_pairs.append((self.feedback_by_pair, _FEEDBACK[1]))
        for p, what in of_pairs:
            lines += [
                f"  {self.inputs[j]} to {self.outputs[i]}: {what} (p {p_relation(float(p[i, j]))})"
                for i, j in zip(*np.nonzero(p < WHITE_LEVEL / p.size), strict=True)
            ]
        return "\n".join([*lines, *(f"  {finding.text}" for finding in self.findings)])


def _verdict(good: str, bad: str, p: float) -> str:
    if not p >= 0:
        return f"{good}: too few samples to test"
    return f"{bad if p < WHITE_LEVEL else good} (p {p_relation(p)})"
