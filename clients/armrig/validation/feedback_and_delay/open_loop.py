"""Test for feedback from the output to the input (handout, assignment 3.7)."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset, OfDataset, labels
from armrig.data.step import laws_of, laws_text
from armrig.data.treatment.level_change import level_change
from armrig.estimation.data_faults import require_moving_output
from armrig.numerics.quantities import digits, p_relation, percent
from armrig.plots.layout import plot_method
from armrig.validation.feedback_and_delay.by_channel import each_channel
from armrig.validation.feedback_and_delay.sims import CannotTellError, Sims, sims

CHANCE_LEVEL = 1e-3
"""Level of findings without a test by name, and least p value for which another recording is
recommended: the level 0.05 finds feedback in one of twenty recordings in open loop."""
EXACT = (
    "u(t) = a y(t) + b in every sample, as under a P controller with a constant set point: such "
    "data show the controller, not the rig; change the set point"
)
"""Remark on data whose u follows from y of the same sample."""
_MAX_EXACT_REST = 1e-5  # share of u that y(t) may leave unexplained: rounding in a file
_MAX_FEW_LEVELS = 20  # a controller that carries the noise of y into u causes more levels of u
_MAX_SHOWN_F = 1e6
_PARTS, _LEAST_PARTED = 4, 600  # parts of a record, and samples from which they are tested
_GOOD_SHARE = 0.1  # of the logarithm of the p value of the whole, that of a part
_NOT_WITHIN_PARTS = (
    "the whole looks like feedback, but most of its four parts do not: the gain may change with "
    "the level"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class OpenLoop(OfDataset):
    """Result of the test for feedback from y to u."""

    feedback: bool | None
    """True if a law controlled the run, or if p_value < level; None if the data do not decide."""
    p_value: float
    """p value of Sims' test; H0: u(t), u(t + 1), … do not depend on y(t). NaN if the data do not
    decide."""
    level: float
    """Level of the test: share of open-loop experiments in which the test finds feedback by
    chance."""
    sims: Sims | None
    """Numbers of the test; None if the data do not decide."""
    exact: bool
    """True if u(t) = a y(t) + b in every sample, as under a P controller with a constant set
    point."""
    remarks: tuple[str, ...]
    """Limits of the answer, or the reason why there is no answer."""
    few_levels: bool
    """True if u has at most 20 levels; then only a relay can carry the noise of y into u."""
    laws: tuple[str, ...] = ()
    """SHA-256 of the laws that controlled the run, from the data's history; () without a law."""

    @property
    def verdict(self) -> str:
        """Answer in a few words."""
        if self.laws:
            return f"FEEDBACK, known without the test: controlled by {laws_text(self.laws)}"
        if self.feedback is None:
            return "no decision on feedback"
        direct = ", or a direct term" * self.may_be_direct_term
        return f"FEEDBACK{direct}" if self.feedback else "open loop: no feedback found"

    @property
    def sure(self) -> bool:
        """True if a law controlled the run, or if p < 0.1 %, whatever the level is."""
        return bool(self.laws) or self.p_value < CHANCE_LEVEL

    @property
    def may_be_direct_term(self) -> bool:
        """True if u(t) depends on y(t), but u(t + 1), … do not: a direct term looks the same."""
        s = self.sims
        if self.laws:  # u(t) depends on y(t - 1) and earlier
            return False
        return s is not None and not self.exact and s.p_value < self.level <= s.p_later

    def explain(self) -> str:
        """Return the question, the finding, and its meaning and limits."""
        if self.sims is None:
            consequences = self._so() if self.feedback else []
            return "\n".join([f"{self.verdict}.", *consequences, *(f"{r}." for r in self.remarks)])
        s, y = self.sims, self.output
        lines = [
            f"{self.verdict}.",
            f"Question: does the input from t on explain {y}(t) beyond the past? In open loop it "
            f"does not, because u was chosen without {y}.",
            self._finding_line(s),
        ]
        if self.feedback:
            lines += self._so()
        else:
            lines.append(
                f"So the data do not contradict open loop, at a level of {100 * self.level:g} %. "
                "This is no proof: feedback is visible only by the noise that it carries into u. "
                "If this noise is small in comparison with u, the test does not find feedback."
            )
        return "\n".join([*lines, *(f"Note: {r}." for r in self.remarks)])

    def _finding_line(self, s: Sims) -> str:
        if self.exact:
            return f"Finding: u(t) follows from {self.output}(t) exactly, in all samples."
        F = digits(s.F, 3) if s.F < _MAX_SHOWN_F else f"more than {_MAX_SHOWN_F:.0e}"
        return (
            f"Finding: it explains {percent(100 * max(s.explained, 0.0))} of the part of "
            f"{self.output} that the past does not explain; F = {F} with {s.q} and {s.degrees} "
            f"degrees of freedom, p {p_relation(self.p_value)}."
        )

    def _so(self) -> list[str]:
        """Return the consequences of feedback."""
        if self.laws:
            return [
                "So coloured noise in the loop biases OE, spectral analysis and correlation. "
                "Estimate BJ or ARMAX with nk >= 1, or armrig.two_stage with the reference."
            ]
        lines = [
            f"So the data look like feedback, at a level of {100 * self.level:g} %. A model of an "
            "input free of the noise (OE, spectral analysis, correlation) would be biased. "
            "Estimate with a noise model (ARMAX, BJ), by armrig.two_stage if the set point was "
            "recorded, or record with the controller off."
        ]
        if self.p_value >= CHANCE_LEVEL:
            lines.append(
                f"But one open-loop experiment in {1 / self.level:.0f} fails the test by chance, "
                "and p is not far below the level: record again, and test that recording, too."
            )
        return lines

    plot = plot_method("plot_open_loop", "the regression of y on u")

    def __repr__(self) -> str:
        """Return the answer in a line, the remedy if there is feedback, and the remarks."""
        how = ""
        if self.sims is not None:
            how = f" (Sims' F-test of {self.output} on future u: p {p_relation(self.p_value)}, "
            how += f"level {100 * self.level:g} %)"
        lines = [f"{self.verdict}{how}", *(self._so() if self.feedback else [])]
        return "\n".join([*lines, *(f"  note: {r}" for r in self.remarks)])


def require_level(level: float) -> None:
    """Refuse a level of significance that is not between 0 and 1."""
    if not 0 < level < 1:
        raise InputError(f"level={level!r} must lie between 0 and 1, such as 0.05")


@each_channel()
@takes_recordings
def open_loop(data: Dataset, level: float = 0.05) -> OpenLoop:
    """Test whether the rig ran in open loop: u(t), u(t + 1), … do not depend on y(t).

    The test (`sims`) finds feedback only by the noise that the controller carries from y into u.
    Without noise, closed and open loop look the same. If a control law drove the rig, the data's
    history names the law, and the answer is feedback, whatever the test finds.

    Parameters
    ----------
    data : Dataset or Signals
        u as applied and y as measured; y(t) is read before u(t) is applied. If y(t) is missing, the
        regression has no row for t. No row contains samples of two experiments. For Signals with
        several channels, each pair of an output and an input is tested. In open loop, one of twenty
        tests at the level 0.05 finds feedback by chance.
    level : float, default 0.05
        Level of the test, between 0 and 1.

    Returns
    -------
    OpenLoop
        .feedback (None if u follows from its own past, or if y has no noise), .p_value, .laws,
        .explain(), .plot(). For Signals with several channels, the result is `ByChannel`:
        `found["y", "u"]` is the `OpenLoop` of one channel.

    Raises
    ------
    ValueError
        level is outside 0 to 1, or there are too few samples.

    References
    ----------
    .. [1] C. A. Sims, American Economic Review 62 (1972) 540-552.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, section 13.4.

    Examples
    --------
    >>> import armrig
    >>> test = armrig.open_loop(armrig.example_recording().dataset("alpha"))
    >>> test.feedback, test.p_value > 0.05
    (False, True)
    """
    require_level(level)
    require_moving_output(data)
    test: Sims | None = None
    remarks: tuple[str, ...] = ()
    exact, laws = _is_exact(data), laws_of(data.history)
    try:
        test = sims(data)
    except InputError as err:
        if not (laws or isinstance(err, CannotTellError)):
            raise
        remarks = (str(err),)
    if test is not None and test.p_value < level and (exact or not laws):
        remarks = _remarks(test, level, exact=exact)
        if not exact and not laws and (p := _p_within_parts(data, test)) >= level:
            test = replace(test, p_value=p)
            remarks = (_NOT_WITHIN_PARTS,)
        elif not exact and (parted := _parted(data)) is not None:
            with suppress(InputError):
                test = sims(parted)
                text = f"the level of {data.output} changes at {parted.starts[1] * data.Ts:g} s, "
                remarks = (f"{text}as by a load, so the parts before and after it were tested",)
                if test.p_value < level:
                    remarks += _remarks(test, level, exact=exact)
    return OpenLoop(
        feedback=bool(laws) or (None if test is None else test.p_value < level),
        p_value=float("nan") if test is None else test.p_value,
        level=level,
        sims=test,
        exact=exact,
        few_levels=np.unique(data.u).size <= _MAX_FEW_LEVELS,
        remarks=remarks,
        laws=laws,
        **labels(data),
    )


def _p_within_parts(data: Dataset, whole: Sims) -> float:
    """Return the median p value of four parts of the data, if it is far above that of the whole.

    Feedback acts in each part. A rig whose gain changes with the level looks like feedback in the
    whole, and in few parts. Otherwise the result is the p value of the whole.
    """
    if data.N < _LEAST_PARTED:
        return whole.p_value
    try:
        median = float(np.median([sims(part).p_value for part in data.split(_PARTS)]))
    except InputError:
        return whole.p_value
    return median if median > whole.p_value**_GOOD_SHARE else whole.p_value


def _parted(data: Dataset) -> Dataset | None:
    """Return one experiment as two, before and after a change of level; None without a change."""
    at = level_change(data.u[:, None], data.y) if len(data.starts) == 1 else None
    return None if at is None else data.replaced(step=None, starts=(0, at))


def _is_exact(data: Dataset) -> bool:
    """Return whether u(t) = a y(t) + b in every sample."""
    u, y = data.u[data.valid], data.y[data.valid]
    if u.size < 2 or np.ptp(u) == 0 or np.ptp(y) == 0:
        return False
    u, y = u - u.mean(), y - y.mean()
    left = u - (u @ y) / (y @ y) * y
    return bool(np.linalg.norm(left) < _MAX_EXACT_REST * np.linalg.norm(u))


def _remarks(test: Sims, level: float, *, exact: bool) -> tuple[str, ...]:
    """Return a remark if u is computed from y(t), or if only u(t) and no later u depends on it."""
    if exact:
        return (EXACT,)
    if test.p_value < level <= test.p_later:
        return (
            "u(t) depends on y(t), but later u do not: a rig whose y is read after u is applied "
            "(nk = 0) looks the same; otherwise take nk = 1",
        )
    return ("an input that is not held between samples, or recorded later than y, looks the same",)
