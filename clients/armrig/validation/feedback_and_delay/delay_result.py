"""What is known of the first lag at which the input acts, and how it is said."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from armrig.estimation.nonparametric.impulse import ImpulseResponse
from armrig.numerics.quantities import p_relation, plural, times
from armrig.validation.feedback_and_delay.lag_tests import LEVEL, Before
from armrig.validation.feedback_and_delay.smooth_onset import SURPRISING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Delay:
    """The first lag at which u acts."""

    nk: int
    """First lag at which u acts, the least one that is not ruled out; 1 is a rig without delay
    under a zero-order hold, and 0 stands only where lag 0 itself is shown."""
    interval: tuple[int, int]
    """Least and greatest nk that the data do not rule out, each test at 0.1 %."""
    may_be_feedback: bool
    """A controller's u(t) that depends on y(t) would show at lag 0 as the direct term does."""
    p_values: dict[int, float]
    """By lag k up to the first that is shown: of the hypothesis that u does not act at k, nor
    before."""
    before: Before | None
    """Of the lag before the first that was shown: would u be seen there? None at lag 0."""
    misfit: dict[int, float]
    """By first lag of a smooth onset: chi-squared, two degrees of freedom; empty where the first
    coefficients tell enough, or the output has no such onset."""
    arx_loss: dict[int, float]
    """By nk: loss of the model whose lags of u begin there, the last one kept, in y's unit
    squared."""
    response: ImpulseResponse
    """Plain impulse response, with bands."""
    integrator: bool
    """y was taken as integrating; `remarks` say so where the data decided it."""
    na: int
    """Order of A in the ARX model, by AIC; 0 where so much is missing that the plain impulse
    response was tested instead."""
    t_q: float | None
    """Time in s for which a reading of y in steps hides the answer to the largest change of u,
    sqrt(2 LSB / (b |Δu|)); None where y is not read in steps."""
    quantum: float
    """LSB, the step in which y was read; 0 where none is seen."""
    largest_step: float
    """|Δu|, in u's unit."""
    remarks: tuple[str, ...]
    """What limits the answer."""
    acceleration: float
    """b, what y's second derivative is just after a unit step of u."""
    output: str
    """Name of y."""
    Ts: float
    """Sampling time, in s."""
    unit: str
    """Unit of y."""
    input_unit: str
    """Unit of u."""
    source: str
    """Hash of the recording, or ""."""

    @property
    def level(self) -> float:
        """Of each test, 0.1 %."""
        return LEVEL

    @property
    def told(self) -> bool:
        """Only one nk is possible."""
        return self.interval[0] == self.interval[1]

    @property
    def delay(self) -> int:
        """Samples of delay beyond the hold's own one, nk - 1; -1 is a direct term.

        No more of them than the data show: where several are possible, the least.
        """
        return self.nk - 1

    def explain(self) -> str:
        """Say what decides, what stands beside it, and what quantisation has to do with it."""
        g, std = self.response.decaying
        lines = [
            f"{self._answer()}.",
            "Asked: at which lag does u act first? Without a delay that is lag 1, under a "
            "zero-order hold: what is applied from one instant on shows at the next. Each test "
            f"has a level of {100 * self.level:g} %.",
            *(f"  {line}" for line in self._tests()),
            *([] if self.before is None else [_ASSUMED]),
            *([] if self.told else [self._way_out()]),
            "Beside it: the impulse response "
            + (f"of {self.output}'s rate " if self.response.integrator else "")
            + "at lags "
            + ", ".join(
                f"{k} {g[k] / std[k]:+.1f}σ"
                for k in range(min(self.p_values), min(self.nk + 3, g.size))
                if std[k] > 0
            )
            + ". A coefficient within its band is not shown to be zero: before "
            f"{self.output} has moved it is small, not absent.",
        ]
        if self.t_q is not None:
            lines.append(
                f"Quantisation is no delay: {self.output} is read in steps of "
                f"{_quantity(self.quantum, self.unit)}, and after a step of "
                f"{self.largest_step:.3g} {self.input_unit} the first is passed after t_q = sqrt(2 "
                f"LSB / (b Δu)) = {1e3 * self.t_q:.2g} ms, {self.t_q / self.Ts:.2g} samples, "
                "with the mean acceleration b per unit of input until then, of the impulse "
                "response. On a step response that looks like dead time; over many steps it "
                "averages out."
            )
        return "\n".join([*lines, *(f"Note: {r}." for r in self.remarks)])

    def brief(self) -> str:
        """Say the answer, the way out where there are several, and what limits the answer."""
        lines = [f"{self._answer()} (level {100 * self.level:g} %)"]
        lines += [] if self.told else [self._way_out()]
        lines += [f"  note: {r}" for r in self.remarks]
        return "\n".join(lines)

    def _tests(self) -> list[str]:
        least = min(self.p_values)
        lines = [_lag_sentence(least, k, p) for k, p in list(self.p_values.items())[-2:]]
        if self.before is not None:
            lines.append(_overlooked_sentence(self.before))
        return [*lines, *([_shape_sentence(self.misfit)] if self.misfit else [])]

    @property
    def nk_range(self) -> str:
        """Say which nk, or between which."""
        low, high = self.interval
        return f"nk = {low}" if self.told else f"nk between {low} and {high}"

    def _answer(self) -> str:
        if self.told and self.may_be_feedback:
            return f"{self.nk_range}: a direct term, or feedback, which looks the same"
        if self.told:
            return f"{self.nk_range}: {_delay_sentence(self.delay, self.Ts)}"
        return f"{self.nk_range}: cannot be told at this Ts and noise"

    def _way_out(self) -> str:
        if self.may_be_feedback:
            return "Take nk = 1 if y was read before u was applied, and nk = 0 if after."
        return (
            f"No delay is claimed that is not shown: take nk = {self.nk}, for a coefficient too "
            "many costs little. To tell, record longer, with more and larger changes of u "
            f"(telegraph, PRBS), or at a Ts above {times(self.Ts)}, where the first "
            "coefficient is larger."
        )

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of impulse response and losses: see `armrig.plots.plot_delay`."""
        from armrig.plots.layout import figure_of
        from armrig.validation.feedback_and_delay.figures import plot_delay

        return figure_of(plot_delay(self, ax=ax))

    def __repr__(self) -> str:
        """Say it in a few lines."""
        lines = [f"{self._answer()} (level {100 * self.level:g} %)"]
        lines += [f"  {line}" for line in self._tests()]
        if self.t_q is not None:
            lines.append(f"  t_q = {1e3 * self.t_q:.2g} ms is hidden by quantisation: no delay")
        return "\n".join([*lines, *(f"  note: {r}" for r in self.remarks)])


_ASSUMED = (
    "Assumed of a lag that is not shown: its coefficient is at least 1/(1 + 3 n) of that n samples "
    "later, or, where the data begin more slowly, that of an onset (t/Ts)^d as slow as their first "
    "lags. An onset that is slower still looks like a delay."
)


def _lag_sentence(least: int, k: int, p: float) -> str:
    said = "u acts there" if p < LEVEL else "not shown to matter"
    if k == least:
        return f"lag {k}: its coefficient, p {p_relation(p)}: {said}"
    which = f"lags {least} to {k}: their coefficients together"
    return f"{which}, p {p_relation(p)}: {said}"


def _overlooked_sentence(b: Before) -> str:
    said = "ruled out" if b.p_value < LEVEL else "not ruled out"
    return (
        f"lag {b.k} alone is {b.found:.1f}σ, and would be {b.predicted:.1f}σ or more if u acted "
        f"there first, p {p_relation(b.p_value)}: {said}"
    )


def _shape_sentence(misfit: dict[int, float]) -> str:
    lags, values = ", ".join(map(str, misfit)), ", ".join(f"{x:.3g}" for x in misfit.values())
    return (
        f"so near the noise the shape of the onset decides: a smooth one at lag {lags} leaves chi² "
        f"{values} ({SURPRISING:g} at 1 %)"
    )


def _delay_sentence(samples: int, Ts: float) -> str:
    if samples < 0:
        return "a direct term, u acts within its own sample"
    if samples == 0:
        return "no input delay"
    return f"{plural(samples, 'sample')} ({times(samples * Ts)}) beyond the hold's"


def _quantity(x: float, unit: str) -> str:
    return f"{1e3 * x:.3g} mrad" if unit == "rad" else f"{x:.3g} {unit}".rstrip()
