"""Result of the tests of a model by its residuals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armrig.data.finding import Finding, good, unusable, warning
from armrig.data.step import laws_text
from armrig.numerics.polynomial import Array
from armrig.numerics.quantities import digits, join_names, p_relation, plural
from armrig.numerics.whiteness import BAND_99_PERCENT, WHITE_LEVEL, Whiteness
from armrig.plots.layout import html, plot_method

_DYNAMICS = "dynamics missing", "the orders or the delay"
_HYPOTHESES = {
    "dynamics": ("no dynamics missing", *_DYNAMICS),
    "linear dynamics": ("no dynamics missing that are linear in u", *_DYNAMICS),
    "feedback": (
        "no feedback",
        "feedback, or a delay too large",
        "the experiment (was u held between samples, and recorded at the time of y?)",
    ),
}
"""Result of a passed test, result of a failed test, and what to look at then."""
UNKNOWN = "the data do not show whether dynamics are missing"
_NOT_VALID = "until the dynamics are modelled, the test of feedback (p {}) is not valid"
_OLDER = (
    "the model's file contains no noise, so the noise is that of these residuals: misfit is partly "
    "hidden. Estimate the model again"
)
MAX_ALLOWANCE = 10.0
"""Largest factor by which uncertain parameters may widen the bands of a test. With a larger factor,
the test has no power."""
_MIN_VALUES = 30
"""Least number of independent values from which the tests of the input find missing dynamics."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ResidualTest:
    """Correlation of the residuals with themselves and with the inputs.

    With one input and one output, the axes of the outputs and of the inputs are left out: `e` is
    (N,), and `cross_correlation` is (2 L + 1,).
    """

    outputs: tuple[str, ...]
    """Names of the ny outputs."""
    inputs: tuple[str, ...]
    """Names of the nu inputs."""
    e: Array
    """Residuals one step ahead, (N, ny), NaN where they are not known."""
    lags: NDArray[np.int_]
    """Lags 0 … L."""
    autocorrelation: Array
    """Correlation of e_i(t) with e_k(t - lag) at `lags`, (ny, ny, L + 1); 1 at i = k and lag 0."""
    autocorrelation_band: float | Array
    """Half width 2.58/sqrt(N) of the 99 % band for white residuals, (ny,), at all lags except 0."""
    white_by_output: tuple[Whiteness, ...]
    """Test of the hypothesis that the residuals of each output are white: portmanteau, or Ljung-Box
    if the portmanteau is unreliable."""
    white: Whiteness
    """Test of the hypothesis that the residuals of all outputs are white and uncorrelated with
    earlier residuals of other outputs; str() returns it as text."""
    ljung_box: float | Array
    """p value of the Ljung-Box test of each output, (ny,), for comparison with other programs."""
    cross_lags: NDArray[np.int_]
    """Lags -L … L; at a positive lag the input precedes the residual."""
    cross_correlation: Array
    """Correlation of e_i(t) with u_j(t - lag) at `cross_lags`, (ny, nu, 2 L + 1)."""
    cross_band: float | Array
    """Half width 2.58 sqrt(P / (N R_e(0) R_u(0))) of the 99 % band, (ny, nu), if the parameters are
    exactly known. `residuals` defines P."""
    cross_std: Array
    """Standard deviation of `cross_correlation`, including the effect of the estimated
    parameters."""
    missing_dynamics_by_pair: Array
    """For each output and input, the p value of the hypothesis that past and present input, lags
    0 … L, are uncorrelated with the residuals, (ny, nu). `residuals` says when lag 0 counts as
    feedback."""
    feedback_by_pair: Array
    """For each output and input, the p value of the hypothesis that future input, lags -L … -1, is
    uncorrelated with the residuals, (ny, nu)."""
    missing_dynamics: float
    """p value of the hypothesis that no past or present input is correlated with any residual."""
    feedback: float
    """p value of the hypothesis that no future input is correlated with any residual."""
    allowance: float
    """Factor by which the parameters' uncertainty widens the band of a typical
    cross-correlation."""
    error_ratio: float
    """Ratio of the rms error of an output to that at the estimation, with the allowance for the
    parameters; NaN on estimation data. Of several outputs, the one with the least p value."""
    larger_errors: float
    """p value of the hypothesis that the errors are not larger than at the estimation."""
    noise_of_estimation: bool
    """True if the noise is that of the estimation; False on estimation data and for a model from an
    older file, whose noise is found in these residuals."""
    on_estimation_data: bool
    """True if the parameters were estimated from these data; the tests account for this."""
    source: str
    """Hash of the recording, or ""."""
    laws: tuple[str, ...] = ()
    """SHA-256 of the laws that controlled the run; under a law, `feedback` rejects no model."""
    findings: tuple[Finding, ...] = ()
    """Warnings, with the code "overlap" if the model was also estimated from a part of these data.
    """

    @property
    def whiteness(self) -> float:
        """The p value of the hypothesis that all residuals are white."""
        return self.white.p_value

    @property
    def rejects(self) -> bool:
        """True if a joint test rejects the model."""
        p = [self.whiteness, self.missing_dynamics, self.larger_errors]
        p += [] if self.laws else [self.feedback]
        return any(value < WHITE_LEVEL for value in p)

    @property
    def poorest_pair(self) -> tuple[str, str]:
        """Output and input with the least p value of missing dynamics."""
        p = np.nan_to_num(self.missing_dynamics_by_pair, nan=1.0)
        i, j = np.unravel_index(int(np.argmin(p)), p.shape)
        return self.outputs[i], self.inputs[j]

    @property
    def powerless(self) -> str:
        """Reason why the tests have no power, with a remedy; "" if they have power.

        On other data the bands contain the deviations of the parameters. With huge deviations, such
        as that of a pole at 1, all residuals would pass.
        """
        if self.on_estimation_data or not self.allowance > MAX_ALLOWANCE:
            return ""
        finite = np.isfinite(self.allowance)
        by = f"by a factor of {self.allowance:.0f}" if finite else "without limit"
        return (
            f"the deviations of the parameters widen the bands of the correlations {by}, so these "
            "tests find nothing. Fix a pole near 1 (option integrator), lower the orders, or "
            "record more data"
        )

    @property
    def blind(self) -> str:
        """Reason why the data do not show whether dynamics are missing; "" if they do."""
        if not self.white.doubtful or self.missing_dynamics < WHITE_LEVEL:
            return ""
        values = int(np.min((BAND_99_PERCENT / np.maximum(self.cross_band, 1e-9)) ** 2))
        if values >= _MIN_VALUES:
            return self.powerless
        return (
            "the coloured residuals and u change so slowly that they are worth "
            f"{plural(values, 'independent value')}. Record longer, or change u more often"
        )

    @property
    def larger(self) -> str:
        """Sentence on errors that are larger than at the estimation; "" if they are not."""
        if not self.larger_errors < WHITE_LEVEL:
            return ""
        return (
            f"its errors one step ahead are {digits(self.error_ratio, 2)} times as large as on the "
            f"estimation data (p {p_relation(self.larger_errors)}): more noise, or the model does "
            "not hold for these data"
        )

    plot = plot_method("plot_residuals", "the correlations")

    _repr_html_ = html

    def __repr__(self) -> str:
        """Return a text: the lines of the tests, then the warnings."""
        return "\n".join([*self.lines(), *(f"  {finding.text}" for finding in self.findings)])

    def lines(self, *, every: bool = False) -> list[str]:
        """Return lines with the joint tests, then a line for each output and each rejected pair.

        If `every` is True, each pair has a line.
        """
        where = "estimation" if self.on_estimation_data else "validation"
        if self.powerless and not self.rejects:
            return [f"residuals on {where} data: no test has power: {self.powerless}"]
        counts = np.atleast_1d(np.isfinite(self.e).sum(axis=0))
        several = len(self.outputs) > 1
        white, *others = (f.text for f in results(self))
        lines = [
            f"residuals on {where} data, {join_names([str(n) for n in counts])} samples",
            f"  {'all outputs together: ' * several}{white}",
            *(f"  {text}" for text in others),
        ]
        if not (self.noise_of_estimation or self.on_estimation_data):
            lines.append(f"  {_OLDER}")
        if several:
            each = zip(self.outputs, self.white_by_output, strict=True)
            lines += [f"  {name}: {white}" for name, white in each]
        return [*lines, *self.pair_lines(every=every)]

    def pair_lines(self, *, every: bool = False) -> Iterator[str]:
        """Yield a line for each test that rejects one of several pairs of an output and an input.

        Bonferroni's correction accounts for the number of pairs. If dynamics are missing, the test
        of feedback is not valid. If `every` is True, all valid tests have a line.
        """
        if self.missing_dynamics_by_pair.size == 1:
            return
        tests = {"dynamics": self.missing_dynamics_by_pair}
        if not (self.laws or self.missing_dynamics < WHITE_LEVEL):
            tests["feedback"] = self.feedback_by_pair
        for about, p in tests.items():
            for (i, j), value in np.ndenumerate(p):
                level, pair = WHITE_LEVEL / p.size, f"{self.inputs[j]} to {self.outputs[i]}"
                if value < level or every:
                    yield f"  {pair}: {_verdict(about, value, level)}"


def results(tests: ResidualTest) -> Iterator[Finding]:
    """Yield the results of the joint tests: whiteness, dynamics, feedback and larger errors.

    The level of a rejected hypothesis is "unusable", and that of an unclear result is "warning".
    """
    white, dynamics = tests.white, tests.missing_dynamics
    if white.coloured:
        yield unusable("white", f"{white}: look at the noise model or the orders")
    elif white.unclear:
        yield warning("white", f"{white}: estimate from more data, or with lower orders")
    else:
        yield (good if white.p_value >= 0 else warning)("white", str(white))
    if tests.blind:
        yield warning("dynamics", f"{UNKNOWN}: {tests.blind}")
    else:
        yield _result("linear dynamics" if white.doubtful else "dynamics", dynamics)
    if tests.laws:
        p, text = f"p {p_relation(tests.feedback)}", f"feedback, by {laws_text(tests.laws)}"
        yield good("feedback", f"{text} ({p})" if tests.feedback >= 0 else text)
    # If u is not white, missing dynamics also affect the lags at which feedback is tested.
    elif dynamics < WHITE_LEVEL and tests.feedback < WHITE_LEVEL:
        yield warning("feedback", _NOT_VALID.format(p_relation(tests.feedback)))
    else:
        yield _result("feedback", tests.feedback)
    if tests.larger:
        yield unusable("errors", tests.larger)


def _result(about: str, p: float) -> Finding:
    text = _verdict(about, p)
    if p < WHITE_LEVEL:
        return unusable(about, f"{text}: look at {_HYPOTHESES[about][2]}")
    return (good if p >= WHITE_LEVEL else warning)(about, text)


def _verdict(about: str, p: float, level: float = WHITE_LEVEL) -> str:
    """Return the result of a test as text."""
    passed, failed, _ = _HYPOTHESES[about]
    if not p >= 0:
        subject = failed.partition(",")[0]
        return f"{subject}: not tested, because u is constant or the samples are few"
    return f"{failed if p < level else passed} (p {p_relation(p)})"
