"""How many samples pass before the input acts (handout, assignment 3.8)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import log, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.checks import require_integers
from armrig.dataset import Dataset
from armrig.estimation.arx import arx
from armrig.estimation.oe import oe
from armrig.fit import Fit
from armrig.grey_box.quantisation import quantum
from armrig.nonparametric.impulse import ImpulseResponse, impulse_response
from armrig.nonparametric.integration import settled
from armrig.quantities import p_relation
from armrig.whiteness import WHITE_LEVEL

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Vector = NDArray[np.float64]

LEVEL = 0.01
_MOST_LAGS = 30
_LIKELY = 3.841  # 95 % point of chi-squared, one degree of freedom
_FAR = 3  # lags past nk to which losses are shown
_SECOND_ORDER = frozenset({"theta_1", "alpha"})
"""Outputs whose second derivative is what a step of the voltage changes first."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Delay:
    """The first lag at which u acts."""

    nk: int
    """First lag at which u acts; 1 is a rig without delay under a zero-order hold."""
    interval: tuple[int, int]
    """Every nk whose OE loss, orders kept, is no worse than the best by chi-squared's 95 %."""
    p_values: dict[int, float]
    """By lag k that was tested: of the hypothesis that u does not act at k, nor before."""
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
    def delay(self) -> int:
        """Samples of delay beyond the hold's own one, nk - 1; -1 is a direct term."""
        return self.nk - 1

    def explain(self) -> str:
        """Say what decides, what stands beside it, and what quantisation has to do with it."""
        g, std = self.response.decaying
        lines = [
            "Asked: at which lag does u act first? A rig without delay acts at lag 1 under a "
            "zero-order hold: what is applied from one instant on shows at the next.",
            *(f"  {_tested(k, p, self.output)}" for k, p in sorted(self.p_values.items())),
            f"So nk = {self.nk}: "
            + _in_words(self.delay, self.Ts)
            + f"; by the loss alone, orders "
            f"kept, nk from {self.interval[0]} to {self.interval[1]} is possible (95 %).",
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

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Show impulse response and losses: see `armrig.plots.plot_delay`."""
        from armrig.plots.feedback_and_delay import plot_delay

        return plot_delay(self, ax=ax)

    def __repr__(self) -> str:
        """Say it in a few lines."""
        low, high = self.interval
        lines = [f"nk = {self.nk}: {_in_words(self.delay, self.Ts)} (95 %: {low} to {high})"]
        lines += [f"  {_tested(k, p, self.output)}" for k, p in sorted(self.p_values.items())]
        if self.t_q is not None:
            lines.append(f"  t_q = {1e3 * self.t_q:.2g} ms is hidden by quantisation: no delay")
        return "\n".join([*lines, *(f"  note: {r}" for r in self.remarks)])


def delay(data: Dataset, *, nb: int = 4, nf: int = 4, integrator: bool | None = None) -> Delay:
    """Find the first lag at which u acts, by OE models with and without a coefficient there.

    At lag k an OE model with b_k, b_k+1 … b_k+nb is tested against the one without b_k ::

        F = (N - d) (V_0 - V) / V,      one degree of freedom, level 1 %

    where V is the mean squared error and both reach to the same last lag, so that the smaller
    model is right if u acts at k + 1 or later. The search begins at the first lag that leaves its
    band in the plain impulse response (Bonferroni, 1 %), and goes down as long as lag k - 1 is
    significant, or else up until lag k is. On an angle the first coefficient can be far below its
    own σ in the impulse response (at Ts 2 ms) and be certain here.

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
        .nk, .delay = nk - 1, .interval, .p_values, .explain(), .plot().

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
    integrates = settled(data, integrator, "delay")
    require_integers(nb=(nb, 1), nf=(nf, int(integrates)))
    n = min(_MOST_LAGS, (data.N - data.missing) // 10)
    response = impulse_response(data, n, kernel=None, integrator=integrates)

    @cache
    def model(k: int, more: int) -> Fit:
        return oe(data, nb=nb + more, nf=nf, nk=k, integrator=integrates)

    k = _first(response)
    p_values: dict[int, float] = {}

    def acts(at: int) -> bool:
        p_values[at] = _nested(model(at + 1, 0), model(at, 1))
        return p_values[at] < LEVEL

    came_down = False
    while k > 0 and acts(k - 1):
        k, came_down = k - 1, True
    while not came_down and not acts(k):
        k += 1
        if k >= n:
            msg = f"u acts at no lag up to {n - 1} that can be told from nothing; record longer, "
            msg += "or with a larger input"
            raise ValueError(msg)
    loss, interval = _likely(lambda nk: model(nk, 0), k, n)
    step = quantum(data)
    change = float(np.max(np.abs(np.diff(data.u)), initial=0.0))
    # From rest y = b u t²/2, so the first coefficient is b Ts²/2.
    acceleration = 2 * abs(float(model(k, 0).B[k])) / data.Ts**2
    return Delay(
        nk=k,
        interval=interval,
        p_values=p_values,
        oe_loss=loss,
        arx_loss={j: arx(data, na=nf, nb=nb, nk=j).loss for j in range(k + _FAR + 1)},
        response=response,
        nb=nb,
        nf=nf,
        quantum=step,
        remarks=tuple(_remarks(model(k, 1))),
        output=data.output,
        Ts=data.Ts,
        unit=data.unit,
        input_unit=data.input_unit,
        source=data.source,
        t_q=_hidden(step, acceleration, change) if data.output in _SECOND_ORDER else None,
        largest_step=change,
        acceleration=acceleration,
    )


def _first(response: ImpulseResponse) -> int:
    """Return the first lag outside its band, all lags together at 1 %."""
    first = response.first_lag(1 - LEVEL / response.g.size)
    if first is None:
        g, std = response.decaying
        first = int(np.argmax(np.abs(g) / np.where(std > 0, std, np.inf)))
    return first


def _nested(small: Fit, large: Fit) -> float:
    """Return the p value of the one coefficient that the larger model has more."""
    from scipy.special import fdtrc

    degrees = large.N - large.parameters
    gained = max(small.loss / large.loss - 1, 0.0) if large.loss > 0 else 0.0
    return float(fdtrc(1, degrees, degrees * gained))


def _likely(
    model: Callable[[int], Fit], k: int, most: int
) -> tuple[dict[int, float], tuple[int, int]]:
    """Return losses about k, and the least and largest nk that the best does not rule out."""
    loss = {j: model(j).loss for j in range(max(k - 1, 0), k + 2)}

    def likely(j: int) -> bool:
        if j not in loss:
            loss[j] = model(j).loss
        return model(j).N * log(loss[j] / min(loss.values())) < _LIKELY

    low = high = k
    while low > 0 and likely(low - 1):
        low -= 1
    while high < most and likely(high + 1):
        high += 1
    return dict(sorted(loss.items())), (low, high)


def _hidden(step: float, acceleration: float, change: float) -> float | None:
    """Return the time that quantisation hides, sqrt(2 LSB / (b |Δu|))."""
    if not step * acceleration * change > 0:
        return None
    return sqrt(2 * step / (acceleration * change))


def _remarks(fit: Fit) -> list[str]:
    """Return what the F-test does not know."""
    if not fit.whiteness < WHITE_LEVEL:
        return []
    z = abs(float(fit.B[fit.nk])) / float(fit.std_robust[0])
    return [
        "the OE model's residuals are coloured, so its F-test has not quite its level; by the "
        f"robust standard deviation the coefficient at lag {fit.nk} is {z:.1f} σ from zero"
    ]


def _tested(k: int, p: float, output: str) -> str:
    said = "u acts there" if p < LEVEL else "nothing is missed without it"
    how = f"OE of {output} with a coefficient there against without"
    return f"lag {k}: {how}, p {p_relation(p)}: {said}"


def _in_words(samples: int, Ts: float) -> str:
    if samples < 0:
        return "a direct term, u acts within its own sample"
    if samples == 0:
        return "no delay beyond the hold's own sample"
    return f"{samples} sample{'s' * (samples > 1)} ({1e3 * samples * Ts:.3g} ms) beyond the hold's"


def _quantity(x: float, unit: str) -> str:
    return f"{1e3 * x:.3g} mrad" if unit == "rad" else f"{x:.3g} {unit}".rstrip()
