"""How many samples pass before the input acts (handout, assignment 3.8)."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.data.quantisation import quantum
from armrig.estimation.arx import arx
from armrig.models.fit import Fit
from armrig.nonparametric.impulse import ImpulseResponse, impulse_response
from armrig.nonparametric.integrator import integration
from armrig.numerics.checks import require_integers
from armrig.numerics.quantile import two_sided
from armrig.numerics.quantities import p_relation, plural
from armrig.validation.feedback_and_delay.onset import (
    LEVEL,
    SECOND_ORDER,
    SURPRISING,
    Before,
    Candidates,
    Onset,
    onset,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Vector = NDArray[np.float64]

_MOST_LAGS = 30
_PER_PARAMETER = 10  # samples
_FAR = 3  # lags past nk to which losses are shown
_FEW_CHANGES = 10  # of u, up to which an error of quantisation does not average out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Delay:
    """The first lag at which u acts."""

    nk: int
    """First lag at which u acts, the least one that is not ruled out; 1 is a rig without delay
    under a zero-order hold."""
    interval: tuple[int, int]
    """Least and greatest nk that the data do not rule out, at a level of 1 %."""
    p_values: dict[int, float]
    """By lag k that was tested: of the hypothesis that u does not act at k, nor before."""
    before: Before | None
    """Of the lag before the first that was shown: would u be seen there? None at lag 0."""
    misfit: dict[int, float]
    """By first lag of a smooth onset: chi-squared, two degrees of freedom; empty where the
    coefficients are far above the noise, or the output is no angle."""
    oe_loss: dict[int, float]
    """OE loss by nk, nb and nf kept, in y's unit squared."""
    arx_loss: dict[int, float]
    """ARX loss by nk, for comparison: its noise model takes part in it."""
    response: ImpulseResponse
    """Plain impulse response, with bands."""
    nb: int
    """Of the OE models."""
    nf: int
    """Of the OE models, an integrator included."""
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
        """Of each test, 1 %."""
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
            "Asked: at which lag does u act first? A rig without delay acts at lag 1 under a "
            "zero-order hold: what is applied from one instant on shows at the next. Each test "
            f"has a level of {100 * self.level:g} %.",
            *(f"  {line}" for line in self._tests()),
            f"So {self._answer()}.",
            *([] if self.told else [self._way_out()]),
            "Beside it: the impulse response "
            + (f"of {self.output}'s rate " if self.response.integrator else "")
            + "at lags "
            + ", ".join(
                f"{k} {g[k] / std[k]:+.1f}σ" for k in range(min(self.nk + 3, g.size)) if std[k] > 0
            )
            + ". A coefficient within its band is not shown to be zero: before the arm has moved "
            "it is small, not absent, which is why the models decide, who know its shape.",
        ]
        if self.t_q is not None:
            lines.append(
                f"Quantisation is no delay: {self.output} is read in steps of "
                f"{_quantity(self.quantum, self.unit)}, and after a step of "
                f"{self.largest_step:.3g} {self.input_unit} the first is passed after t_q = sqrt(2 "
                f"LSB / (b Δu)) = {1e3 * self.t_q:.2g} ms, {self.t_q / self.Ts:.2g} samples. On a "
                "step response that looks like dead time; over many steps it averages out."
            )
        return "\n".join([*lines, *(f"Note: {r}." for r in self.remarks)])

    def _tests(self) -> list[str]:
        lines = [_lag_sentence(k, p, self.output) for k, p in self.p_values.items()]
        if self.before is not None and (self.misfit or not self.told):
            lines.append(_overlooked_sentence(self.before))
        return [*lines, *([_shape_sentence(self.misfit)] if self.misfit else [])]

    @property
    def nk_range(self) -> str:
        """Say which nk, or between which."""
        low, high = self.interval
        return f"nk = {low}" if self.told else f"nk between {low} and {high}"

    def _answer(self) -> str:
        if self.told:
            return f"{self.nk_range}: {_delay_sentence(self.delay, self.Ts)}"
        return f"{self.nk_range}: cannot be told at this Ts and noise"

    def _way_out(self) -> str:
        return (
            f"No delay is claimed that is not shown: take nk = {self.nk}, for a coefficient too "
            "many costs little. To tell, record longer, with more and larger changes of u "
            f"(telegraph, PRBS), or at a Ts above {1e3 * self.Ts:.3g} ms, where the first "
            "coefficient is larger."
        )

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Show impulse response and losses: see `armrig.plots.plot_delay`."""
        from armrig.validation.feedback_and_delay.figures import plot_delay

        return plot_delay(self, ax=ax)

    def __repr__(self) -> str:
        """Say it in a few lines."""
        lines = [f"{self._answer()} (level {100 * self.level:g} %)"]
        lines += [f"  {line}" for line in self._tests()]
        if self.t_q is not None:
            lines.append(f"  t_q = {1e3 * self.t_q:.2g} ms is hidden by quantisation: no delay")
        return "\n".join([*lines, *(f"  note: {r}" for r in self.remarks)])


def delay(data: Dataset, *, nb: int = 4, nf: int = 4, integrator: bool | None = None) -> Delay:
    """Find the first lag at which u acts, by OE models with and without a coefficient there.

    At lag k an OE model with b_k, b_k+1 … b_k+nb is tested against the one without b_k ::

        F = (N - d) (V_0 - V) / V,      one degree of freedom, level 1 %

    where V is the mean squared error and both reach to the same last lag, so that the smaller
    model is right if u acts at k + 1 or later. The search begins at the first lag that leaves its
    band in the plain impulse response (Bonferroni, 1 %).

    A coefficient that is not significant may only be too small to see. The lag before the first
    significant one is ruled out by what a rig that begins there would show, see `onset`; where it
    is not, nk lies between the two, and no delay is claimed.

    Parameters
    ----------
    data : Dataset
        N samples of an input that excites; missing ones and several experiments are allowed.
    nb, nf : int, default 4
        Of the OE models, the arm's by default; nf counts an integrator.
    integrator : bool, optional
        Whether y integrates; theta_1 is known to.

    Returns
    -------
    Delay
        .nk, .delay = nk - 1, .told, .interval, .p_values, .explain(), .plot().

    Raises
    ------
    ValueError
        There are too few samples, or u acts at no lag that can be seen.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 16.4 and 16.5.
    .. [2] S. Björklund, *A Survey and Comparison of Time-Delay Estimation Methods in Linear
       Systems*, Linköping, 2003, chapters 5 and 6.
    """
    integrates = integration(data, integrator).integrates
    require_integers(nb=(nb, 1), nf=(nf, int(integrates)))
    samples, needed = data.N - data.missing, _PER_PARAMETER * (nb + nf + 1)
    if samples < needed:
        msg = f"{samples} samples came, the test for a delay needs at least {needed} with "
        msg += f"nb={nb} and nf={nf}: record longer"
        raise ValueError(msg)
    n = min(_MOST_LAGS, samples // 10)
    response = impulse_response(data, n, kernel=None, integrator=integrates)

    candidates = Candidates(data, nb=nb, nf=nf, integrator=integrates)
    found = onset(candidates, _first(response), n)
    acceleration = _acceleration(candidates, found) / data.Ts**2
    read = _readings(data, acceleration)
    first, remarks = _least(found, read, data.Ts)
    remarks = [*_remarks(candidates.model(found.last, 1)), *remarks]
    return Delay(
        nk=first,
        interval=(first, found.last),
        p_values=found.p_values,
        before=found.before,
        misfit=found.misfit,
        oe_loss={j: candidates.model(j).loss for j in range(max(first - 1, 0), found.last + 2)},
        arx_loss={j: arx(data, na=nf, nb=nb, nk=j).loss for j in range(found.last + _FAR + 1)},
        response=response,
        nb=nb,
        nf=nf,
        quantum=read.quantum,
        remarks=tuple(remarks),
        output=data.output,
        Ts=data.Ts,
        unit=data.unit,
        input_unit=data.input_unit,
        source=data.source,
        t_q=read.t_q,
        largest_step=read.largest_step,
        acceleration=acceleration,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Readings:
    """In which steps y was read, and how long one of them hides the answer to u."""

    quantum: float
    """LSB, in y's unit; 0 where none is seen."""
    largest_step: float
    """|Δu|, in u's unit."""
    changes: int
    """Times that u changes."""
    t_q: float | None
    """sqrt(2 LSB / (b |Δu|)) in s; None where y is not read in steps."""


def _readings(data: Dataset, acceleration: float) -> _Readings:
    step, moves = quantum(data), np.abs(np.diff(data.u))
    change = float(np.max(moves, initial=0.0))
    hidden = _hidden(step, acceleration, change) if data.output in SECOND_ORDER else None
    return _Readings(
        quantum=step, largest_step=change, changes=int(np.count_nonzero(moves)), t_q=hidden
    )


def _least(found: Onset, read: _Readings, Ts: float) -> tuple[int, list[str]]:
    """Return the least nk that is not ruled out, and a remark where quantisation makes it less."""
    if read.t_q is None or read.changes >= _FEW_CHANGES or found.last <= 1:
        return found.first, []
    hidden = ceil(read.t_q / Ts)
    return min(found.first, max(found.last - hidden, 1)), [
        f"u changes {plural(read.changes, 'time')} only, which does not excite enough to tell a "
        f"delay from the first {hidden} samples that quantisation hides"
    ]


def _acceleration(candidates: Candidates, found: Onset) -> float:
    """Return b Ts²: from rest y = b u t²/2, so the first coefficient is b Ts²/2."""
    k = found.first
    return 2 * abs(float((candidates.smooth(k) if found.misfit else candidates.model(k)).B[k]))


def _first(response: ImpulseResponse) -> int:
    """Return the first lag outside its band, all lags together at 1 %, or the one farthest out.

    Of an integrating output the response itself is asked: its rate's jumps with the noise.
    """
    std = np.where(response.std > 0, response.std, np.inf)
    z = np.abs(response.g) / std
    outside = np.flatnonzero(z > two_sided(1 - LEVEL / z.size))
    return int(outside[0] if outside.size else np.argmax(z))


def _hidden(step: float, acceleration: float, change: float) -> float | None:
    """Return the time that quantisation hides, sqrt(2 LSB / (b |Δu|))."""
    if not step * acceleration * change > 0:
        return None
    return sqrt(2 * step / (acceleration * change))


def _remarks(fit: Fit) -> list[str]:
    """Return what the F-test does not know."""
    if not fit.trusts_robust:
        return []
    z = abs(float(fit.B[fit.nk])) / float(fit.std_robust[0])
    return [
        "the OE model's residuals are coloured, so its F-test has not quite its level; by the "
        f"robust standard deviation the coefficient at lag {fit.nk} is {z:.1f} σ from zero"
    ]


def _lag_sentence(k: int, p: float, output: str) -> str:
    said = "u acts there" if p < LEVEL else "nothing is missed without it"
    how = f"OE of {output} with a coefficient there against without"
    return f"lag {k}: {how}, p {p_relation(p)}: {said}"


def _overlooked_sentence(b: Before) -> str:
    return (
        f"lag {b.k} is {b.found:+.1f}σ, and would be {b.predicted:+.1f}σ if u acted there first: "
        f"p {p_relation(b.p_value)}"
    )


def _shape_sentence(misfit: dict[int, float]) -> str:
    lags, values = ", ".join(map(str, misfit)), ", ".join(f"{x:.3g}" for x in misfit.values())
    return (
        f"so near the noise the shape of the onset decides: a smooth one at lag {lags} leaves chi² "
        f"{values} ({SURPRISING:g} at {100 * LEVEL:g} %)"
    )


def _delay_sentence(samples: int, Ts: float) -> str:
    if samples < 0:
        return "a direct term, u acts within its own sample"
    if samples == 0:
        return "no delay beyond the hold's own sample"
    return f"{plural(samples, 'sample')} ({1e3 * samples * Ts:.3g} ms) beyond the hold's"


def _quantity(x: float, unit: str) -> str:
    return f"{1e3 * x:.3g} mrad" if unit == "rad" else f"{x:.3g} {unit}".rstrip()
