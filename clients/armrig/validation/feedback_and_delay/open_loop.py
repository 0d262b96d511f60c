"""Was the input free of the output? (handout, assignment 3.7)."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.data.treatment import INTEGRATING_OUTPUTS
from armrig.estimation.oe import oe
from armrig.nonparametric.impulse import ImpulseResponse, impulse_response
from armrig.numerics.quantities import p_relation
from armrig.numerics.whiteness import WHITE_LEVEL, joint_p_value
from armrig.validation.feedback_and_delay.granger import MOST_LAGS, Granger, granger
from armrig.validation.residuals import ResidualTest, residuals

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Vector = NDArray[np.float64]

SHOWN_LAGS = 10  # negative ones of the impulse response
_POLES = 4  # the arm's
_RAMP = 0.5  # least share of an angle's variance that a steady turn makes
_SURE = 1e-3  # p value from which on another recording is asked for
_BEYOND_DOUBT = 1e-4  # p value that no unit root makes


@dataclass(frozen=True, slots=True, kw_only=True)
class OtherTest:
    """A test that does not decide."""

    name: str
    """What is tested."""
    p_value: float
    """Of the hypothesis that there is no feedback; nan where it could not be tested."""
    remark: str
    """What to know of it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class OpenLoop:
    """Whether y was fed back to u, at a stated level."""

    feedback: bool
    """p_value < level."""
    p_value: float
    """Of Granger's test, which decides: H0 is that past y has no part in u."""
    level: float
    """Share of open-loop experiments that are called closed."""
    granger: Granger
    """The test in full."""
    others: tuple[OtherTest, ...]
    """For the reader; they have no part in the decision."""
    response: ImpulseResponse | None
    """Plain impulse response with negative lags, where there were samples enough."""
    remarks: tuple[str, ...]
    """What limits the answer."""
    output: str
    """Name of y."""
    Ts: float
    """Sampling time, in s."""
    source: str
    """Hash of the recording, or ""."""

    def explain(self) -> str:
        """Say what was asked, what came out, and what it can and cannot mean."""
        g = self.granger
        lags = f"{self.output}'s last {g.lags} samples explain"
        if g.lags == 1:
            lags = f"{self.output}'s last sample explains"
        share = 100 * max(g.explained, 0.0)
        lines = [
            f"Asked: is the input predicted better with {self.output}'s past than from its own "
            f"past alone? In open loop it is not: nobody who chose u looked at {self.output}.",
            f"Found: {lags} {share:.2g} % of what u's own past leaves of u; F = "
            f"{g.F:.3g} with {g.q} and {g.degrees} degrees of "
            f"freedom, p {p_relation(self.p_value)}.",
        ]
        if self.feedback:
            lines.append(
                f"So there is feedback, at a level of {100 * self.level:g} %: u answers to "
                f"{self.output}. A model that assumes an input free of the noise (OE, spectral "
                "analysis, correlation) is then biased; estimate with a noise model (ARMAX, BJ), "
                "or record with the controller off."
            )
            if self.p_value >= _SURE:
                lines.append(
                    f"But one open-loop experiment in {1 / self.level:.0f} is told the same, and p "
                    "is not far below the level: record another one, and see whether it says so "
                    "again."
                )
        else:
            lines.append(
                f"So nothing speaks against open loop, at a level of {100 * self.level:g} %. That "
                "is no proof: feedback that is weak beside the rest of u, or a controller that "
                "follows a moving setpoint, whose ramp hides in the constant, can go unseen."
            )
        lines.append("Beside it, for the reader (they do not decide):")
        for test in self.others:
            p = f"p {p_relation(test.p_value)}" if isfinite(test.p_value) else "not tested"
            lines.append(f"  {test.name}: {p}. {test.remark}")
        return "\n".join([*lines, *(f"Note: {r}." for r in self.remarks)])

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Show the response at negative and positive lags: see `armrig.plots.plot_open_loop`."""
        from armrig.validation.feedback_and_delay.figures import plot_open_loop

        return plot_open_loop(self, ax=ax)

    def __repr__(self) -> str:
        """Say it in two lines."""
        said = "FEEDBACK" if self.feedback else "open loop: no feedback found"
        lines = [
            f"{said} (Granger's F-test of u on past {self.output}, {self.granger.lags} lags: "
            f"p {p_relation(self.p_value)}, level {100 * self.level:g} %)"
        ]
        return "\n".join([*lines, *(f"  note: {r}" for r in self.remarks)])


def open_loop(data: Dataset, level: float = 0.05) -> OpenLoop:
    """Test whether the rig ran in open loop.

    One test decides, at one level: Granger's F-test of u on past y (`granger`), y in levels (an
    angle unwrapped, not its rate), a constant, no trend, up to ten lags by BIC. Tests joined by
    "or" would not keep the level. Beside it stand, for the reader: the coefficients of a
    non-causal impulse response at negative lags, jointly (Wald); the residuals of an OE model
    against future input; and against the present input, apart, for at lag 0 a direct term of the
    rig and a controller without delay look alike.

    Parameters
    ----------
    data : Dataset
        u and y as applied and measured, y unwrapped and not detrended. Missing samples cost the
        rows that they touch, and nothing is carried from one experiment to the next.
    level : float, default 0.05
        Between 0 and 1.

    Returns
    -------
    OpenLoop
        .p_value and .feedback of the test that decides, .others, .explain(), .plot().

    Raises
    ------
    ValueError
        level is outside 0 to 1, there are too few samples, or u follows from its own past.

    References
    ----------
    .. [1] C. W. J. Granger, Econometrica 37 (1969) 424-438.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, sections 13.4 and 16.6.
    """
    if not 0 < level < 1:
        msg = f"level={level!r} must lie between 0 and 1, such as 0.05"
        raise ValueError(msg)
    decides = granger(data, MOST_LAGS)
    response = _non_causal(data)
    return OpenLoop(
        feedback=decides.p_value < level,
        p_value=decides.p_value,
        level=level,
        granger=decides,
        others=(_negative_lags_test(response), *_residual_tests(data)),
        response=response,
        remarks=tuple(_remarks(data, decides.p_value)),
        output=data.output,
        Ts=data.Ts,
        source=data.source,
    )


def _integrates(data: Dataset) -> bool:
    return data.output in INTEGRATING_OUTPUTS


def _non_causal(data: Dataset) -> ImpulseResponse | None:
    try:
        return impulse_response(data, None, None, SHOWN_LAGS, integrator=_integrates(data))
    except ValueError:  # too few rows, or an input too poor for so many lags
        return None


def _negative_lags_test(response: ImpulseResponse | None) -> OtherTest:
    name = "coefficients at negative lags (u after y), jointly"
    if response is None:
        return OtherTest(name=name, p_value=np.nan, remark="The data do not determine so many.")
    g, _ = response.decaying
    found = response.covariance if response.rate_covariance is None else response.rate_covariance
    before = response.lags < 0
    return OtherTest(
        name=name,
        p_value=joint_p_value(g[before], found[np.ix_(before, before)]),
        remark="It has hardly any power where the noise is small beside what u does.",
    )


def _residual_tests(data: Dataset) -> tuple[OtherTest, OtherTest]:
    future, present = (
        "residuals of an OE model against future input",
        "the same residuals against present input",
    )
    try:
        integrator = _integrates(data)
        fit = oe(data, nb=_POLES, nf=_POLES, integrator=integrator)
        tests = residuals(fit, data)
    except (ValueError, np.linalg.LinAlgError):
        none = "No model could be estimated."
        return (
            OtherTest(name=future, p_value=np.nan, remark=none),
            OtherTest(name=present, p_value=np.nan, remark=none),
        )
    remark = "A delay taken too large looks the same."
    at_zero = "Lag 0 apart: a direct term of the rig and a controller without delay look alike."
    if tests.missing_dynamics < WHITE_LEVEL:
        remark = at_zero = "The model cannot be asked: its residuals hold past input too."
    return (
        OtherTest(name=future, p_value=tests.feedback, remark=remark),
        OtherTest(name=present, p_value=_lag_0_p_value(tests), remark=at_zero),
    )


def _lag_0_p_value(tests: ResidualTest) -> float:
    from scipy.special import erfc

    middle = tests.cross_lags.size // 2
    std = tests.cross_std[middle]
    if not std > 0:
        return float("nan")
    return float(erfc(abs(tests.cross_correlation[middle]) / std / np.sqrt(2)))


def _remarks(data: Dataset, p: float) -> list[str]:
    """Return what takes from the test its level."""
    said = []
    if _integrates(data) and p > _BEYOND_DOUBT and _ramp_share(data) < _RAMP:
        said.append(
            f"{data.output} integrates and does not turn at a steady rate: the F-test then rejects "
            "more often than its level says, which p < 0.0001 would outlast"
        )
    if data.output == "velocity":
        said.append("feedback of an angle hardly shows in its rate: test theta_1")
    if any("trend" in step for step in data.history):
        said.append("a trend was removed: what a controller feeds back went with it")
    return said


def _ramp_share(data: Dataset) -> float:
    """Return the share of y's variance about its levels that a straight line each explains."""
    left = total = 0.0
    for part in data.experiments():
        y, t = part.y[part.valid], part.t[part.valid]
        if y.size < 3:
            continue
        y, t = y - y.mean(), t - t.mean()
        total += float(y @ y)
        left += float(y @ y - (t @ y) ** 2 / max(float(t @ t), 1e-300))
    return 1 - left / total if total > 0 else 0.0
