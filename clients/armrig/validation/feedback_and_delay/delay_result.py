"""Result of the test for a delay, and its explanation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from armrig.data.dataset import OfDataset
from armrig.estimation.nonparametric.impulse import ImpulseResponse
from armrig.numerics.quantities import digits, p_relation, plural, times
from armrig.plots.layout import plot_method
from armrig.validation.feedback_and_delay.lag_tests import LEVEL, SURPRISING, Before


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Delay(OfDataset):
    """The first lag at which u acts."""

    nk: int
    """First lag at which u acts: the least lag that is not ruled out. Under a zero-order hold, a
    rig without delay has nk = 1. nk is 0 only if lag 0 itself is significant."""
    interval: tuple[int, int]
    """Least and greatest nk that the data do not rule out; each test has the level 0.1 %."""
    may_be_feedback: bool
    """True if feedback may cause the coefficient at lag 0: a u(t) that depends on y(t) looks like a
    direct term."""
    p_values: dict[int, float]
    """p value for each lag k, up to the first significant lag. The hypothesis is that u does not
    act at lag k or at an earlier lag. If one sample is left out, no p value is larger."""
    before: Before | None
    """Test for a weak effect of u one lag before the first significant lag. None if the first
    significant lag is 0."""
    misfit: dict[int, float]
    """Chi-squared, with two degrees of freedom, of a model with a smooth onset, for each first lag.
    The mapping is empty if the tests of the first coefficients determine nk, or if the onset of the
    output is not smooth."""
    arx_loss: dict[int, float]
    """Loss of the ARX model for each nk, in y's unit squared; all models have the same last lag of
    u."""
    response: ImpulseResponse
    """Impulse response by least squares without regularisation."""
    integrator: bool
    """True if y was taken as integrating; `remarks` contains the reason if the data decided."""
    na: int
    """Order of A in the ARX model, by AIC. If too many samples are missing, the order is 0, and the
    coefficients of `response` were tested instead."""
    quantum: float
    """LSB, the quantisation step of y; 0 if none is found."""
    largest_step: float
    """Largest change |Δu| between two samples, in u's unit."""
    t_q: float | None
    """Time in s for which quantisation hides the response to the largest change of u, sqrt(2 LSB /
    (b |Δu|)); None if y is not quantised. b is the second derivative of y just after a unit step
    of u."""
    remarks: tuple[str, ...]
    """Limits of the answer."""

    @property
    def level(self) -> float:
        """Level of each test, 0.1 %."""
        return LEVEL

    @property
    def told(self) -> bool:
        """True if only one nk is possible."""
        return self.interval[0] == self.interval[1]

    @property
    def delay(self) -> int:
        """Delay in samples, in addition to the sample of the hold: nk - 1; -1 for a direct term.

        If several delays are possible, this value is the least possible delay.
        """
        return self.nk - 1

    def explain(self) -> str:
        """Return a text: results of the tests, other evidence, and effect of quantisation."""
        g, std = self.response.decaying
        lines = [
            f"{self.answer}.",
            "Question: at which lag does u act first? Without a delay this is lag 1: under a "
            "zero-order hold, a change of the input is visible at the next sample. Each test has a "
            f"level of {100 * self.level:g} %.",
            *(f"  {line}" for line in self._tests()),
            *([_ASSUMED] * (self.before is not None)),
            *self._way_out(),
            "Other evidence: the impulse response "
            + (f"of {self.output}'s rate " if self.response.integrator else "")
            + "at lags "
            + ", ".join(
                f"{k} {g[k] / std[k]:+.1f}σ"
                for k in range(min(self.p_values), min(self.nk + 3, g.size))
                if std[k] > 0
            )
            + ". A coefficient within its band need not be zero: before "
            f"{self.output} has moved, all coefficients are small.",
        ]
        if self.t_q is not None:
            lines.append(
                f"Quantisation is no delay: {self.output} is read in steps of "
                f"{_quantity(self.quantum, self.unit)} (1 LSB). After a step of "
                f"{digits(self.largest_step, 3)} {self.input_unit} in u, {self.output} changes by "
                f"one LSB at t_q = sqrt(2 LSB / (b Δu)) = {digits(1e3 * self.t_q, 2)} ms, "
                f"{plural(float(digits(self.t_q / self.Ts, 2)), 'sample')}. Here b is the mean "
                "acceleration per unit of input until t_q, from the impulse response. On one step "
                "response t_q looks like dead time; over many steps this effect averages out."
            )
        return "\n".join([*lines, *(f"Note: {r}." for r in self.remarks)])

    def _tests(self) -> Iterator[str]:
        least = min(self.p_values)
        for k, p in list(self.p_values.items())[-2:]:
            verdict = "u acts there" if p < LEVEL else "not shown to matter"
            which = f"lags {least} to {k}: their coefficients together"
            which = f"lag {k}: its coefficient" if k == least else which
            yield f"{which}, p {p_relation(p)}: {verdict}"
        if b := self.before:
            verdict = "ruled out" if b.p_value < LEVEL else "not ruled out"
            yield (
                f"lag {b.k} alone: its coefficient is {b.found:.1f}σ, and would be "
                f"{b.predicted:.1f}σ or more if u acted there first, p {p_relation(b.p_value)}: "
                f"{verdict}"
            )
        if self.misfit:
            lags = ", ".join(map(str, self.misfit))
            values = ", ".join(digits(x, 3) for x in self.misfit.values())
            yield (
                f"near the noise, the shape of the onset decides: a smooth onset at lag {lags} has "
                f"chi² {values} (limit {SURPRISING:g} at the level 1 %)"
            )

    @property
    def nk_range(self) -> str:
        """Return nk, or its range, as text."""
        low, high = self.interval
        return f"nk = {low}" if self.told else f"nk between {low} and {high}"

    @property
    def answer(self) -> str:
        """Answer in a few words, such as: nk = 1: no input delay."""
        if self.told and self.may_be_feedback:
            return f"{self.nk_range}: a direct term, or feedback, which looks the same"
        return first_lag(self.interval, self.Ts)

    def _way_out(self) -> Iterator[str]:
        """Yield a remedy if several nk are possible."""
        if self.told:
            return
        if self.may_be_feedback:
            yield "Take nk = 1 if y was read before u was applied, otherwise nk = 0."
            return
        yield (
            f"A delay is claimed only if it is shown: take nk = {self.nk}, since one coefficient "
            "too many does little harm. To determine nk, record longer, with more and larger "
            f"changes of u (telegraph, PRBS), or at a Ts above {times(self.Ts)}, where the first "
            "coefficient is larger."
        )

    plot = plot_method("plot_delay", "impulse response and losses")

    def __repr__(self) -> str:
        """Return the answer, a remedy if the answer is not unique, and the limits of the answer."""
        lines = [f"{self.answer} (level {100 * self.level:g} %)", *self._way_out()]
        return "\n".join([*lines, *(f"  note: {r}" for r in self.remarks)])


_ASSUMED = (
    "Assumption: the first coefficient is at least 1/(1 + 3 n) of the coefficient n samples later. "
    "If the response begins more slowly, the bound is computed from an onset (t/Ts)^d, with d from "
    "the first significant lags. An even slower onset looks like a delay."
)


def first_lag(interval: tuple[int, int], Ts: float) -> str:
    """Return the lags at which u may act first, and the delay that they mean, as text."""
    low, high = interval
    if low < high:
        return f"nk between {low} and {high}: not determined at this Ts and noise"
    late = "no input delay"
    if low == 0:
        late = "a direct term (u acts within its own sample), a Ts longer than the response, or u "
        late += "recorded later than y"
    elif low > 1:
        late = f"{plural(low - 1, 'sample')} ({times((low - 1) * Ts)}) in addition to the hold"
    return f"nk = {low}: {late}"


def _quantity(x: float, unit: str) -> str:
    return f"{digits(1e3 * x, 3)} mrad" if unit == "rad" else f"{digits(x, 3)} {unit}".rstrip()
