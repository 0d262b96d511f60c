"""Result of a search over model structures: ranking, choice and reasons."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Vector
from armrig.data.finding import Finding
from armrig.estimation.request import Request
from armrig.models.fit import Fit
from armrig.models.structure_table import row_of
from armrig.numerics.quantities import digits, plural
from armrig.validation.residual_test import ResidualTest, results

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MAX_ERROR_RATIO = 1.2
"""Greatest ratio of the chosen model's rms error to the least."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A structure with its orders, and the request that estimates it."""

    name: str
    """Structure and orders as text, in the same form as in comparisons of models."""
    order: int
    """Number of poles of B/F or B/A, without the poles at 1 of a model of several outputs."""
    request: Request
    """Request that estimates the model."""
    named_by_pole: bool = False
    """True if the search tries the structure with and without a pole at 1."""
    named_by_level: bool = False
    """True if `name` states the offset, which then counts as a parameter."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scored:
    """A candidate with a usable model, and its errors on data that did not estimate it."""

    candidate: Candidate
    """Structure and orders."""
    fit: Fit
    """The model; of halved data the first half estimated it, and all data the chosen one."""
    error: Vector
    """y - ŷ on other data, or on both halves, (N,) or (N, ny); NaN where it is unknown."""
    ahead: Vector
    """The same errors one step ahead."""

    @property
    def parameters(self) -> int:
        """Number of free parameters."""
        return free_parameters(self.fit) + self.candidate.named_by_level


def free_parameters(fit: Fit) -> int:
    """Return the number of free parameters; the choice of the state coordinates does not count."""
    if (fit.ny, fit.nu) == (1, 1):
        return fit.parameters
    if not row_of(fit.structure).state_space:
        return int(fit.theta.size)
    A, B, C, D, _ = fit.state_space()
    n, nu, ny = A.shape[0], B.shape[1], C.shape[0]
    return int(n * (nu + 2 * ny) + (ny * nu if D.any() else 0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SearchResult:
    """Models ranked on validation data, with the choice and its reasons.

    Examples
    --------
    >>> data = armrig.example_recording().dataset("alpha")
    >>> found = armrig.search(data, families=["arx", "oe"], orders=[2, 3])
    >>> [scored.candidate.name for scored in found.ranked]
    ['OE[3 3 1]', 'OE[3 3 1], level', 'OE[2 2 1]', 'ARX[3 3 1]', 'ARX[2 2 1]']
    """

    ranked: tuple[Scored, ...]
    """Candidates with a usable model, best first."""
    rms: Vector
    """Root mean square error of each candidate in `ranked`, in `unit`. The squared error of several
    outputs is the sum of (y - ŷ)² / var y."""
    excess: Vector
    """Mean squared error minus the mean squared error of the best candidate, (n,)."""
    excess_std: Vector
    """Standard error of `excess`, computed from the means of batches of samples, (n,)."""
    as_good: NDArray[np.bool_]
    """Mask of the candidates in `ranked` that are as good as the best, (n,). Their `excess` is at
    most its standard error, their rms error at most 1.2 times the least, and their fit at most 2
    points lower."""
    chosen_index: int
    """Index of the chosen candidate."""
    failed: dict[Candidate, str]
    """Reason why a candidate has no usable model, for each such candidate."""
    doubts: tuple[Finding, ...]
    """Findings about problems of the data, such as poor excitation, wrong samples or feedback."""
    notes: tuple[str, ...]
    """Sentences on decisions about the data, such as an integrator or an offset."""
    halved: bool
    """True if each half of the data estimated models that were ranked on the other half."""
    tests: ResidualTest
    """Tests of the chosen model's residuals on the validation data. Of halved data, the model of
    the first half is tested on the second half."""
    horizon: int | None
    """Number of samples that the models predict ahead; None for simulation."""
    unit: str
    """Unit of `rms`: the unit of y, or σ for several outputs."""

    @property
    def chosen(self) -> Scored:
        """The chosen candidate."""
        return self.ranked[self.chosen_index]

    @property
    def fit(self) -> Fit:
        """The chosen model."""
        return self.chosen.fit

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of error against number of parameters: see `armrig.plots.plot_search`.

        Examples
        --------
        >>> data = armrig.example_recording().dataset("alpha")
        >>> armrig.search(data, families=["arx", "oe"], orders=[2, 3]).plot()
        <Figure size ... with 1 Axes>
        """
        from armrig.plots import plot_search
        from armrig.plots.layout import figure_of

        return figure_of(plot_search(self, ax=ax))

    def explain(self) -> str:
        """Return the problems of the data, the choice and its reasons, as text.

        Examples
        --------
        >>> data = armrig.example_recording().dataset("alpha")
        >>> print(armrig.search(data, families=["arx", "oe"], orders=[2, 3]).explain())
        - best simulation of the validation data: OE[3 3 1], rms error 0.0035... rad
        - chosen: the best, since no simpler model is as good
        - fewer parameters are not enough: OE[2 2 1] has 4, rms error 0.0338..., ...
        """
        doubts = [f"doubt about the data, {f.about}: {f.text}" for f in self.doubts]
        return "\n".join(f"- {line}" for line in (*doubts, *self.reasons))

    @property
    def reasons(self) -> tuple[str, ...]:
        """Sentences about the choice and its reasons."""
        return tuple(_reasons(self))

    def table(self, most: int = 10) -> str:
        """Return a table of the best candidates, with a mark at the chosen candidate.

        Examples
        --------
        >>> data = armrig.example_recording().dataset("alpha")
        >>> print(armrig.search(data, families=["arx", "oe"], orders=[2, 3]).table())
        5 models, simulated, ranked by their error on the part of the data that did not ...
          model            parameters   rms [rad]  excess mean square ± se [rad²]
          OE[3 3 1]                 6   0.0035...                                  <- chosen
          OE[3 3 1], level          7   0.0035...               ...
          OE[2 2 1]                 4     0.0338...               0.0011... ± 9.4e-05
          ARX[3 3 1]                6    0.075...
        """
        method = f"predicted {plural(n, 'sample')} ahead" if (n := self.horizon) else "simulated"
        count = len(self.ranked) + len(self.failed)
        where = "part of the data that did not estimate them" if self.halved else "validation data"
        width = max(len(j.candidate.name) for j in self.ranked)
        unit = f" [{self.unit}]" if self.unit else ""
        square = f" [{f'({self.unit})' if '/' in self.unit else self.unit}²]" if self.unit else ""
        over = f"excess mean square ± se{square}"
        lines = [
            f"{plural(count, 'model')}, {method}, ranked by their error on the {where}",
            f"  {'model':{width}} {'parameters':>10} {f'rms{unit}':>11}  {over:>24}",
        ]
        indices = sorted({*range(min(most, len(self.ranked))), self.chosen_index})
        for i in indices:
            j = self.ranked[i]
            of_best = (
                "" if i == 0 else f"{digits(self.excess[i], 3)} ± {digits(self.excess_std[i], 2)}"
            )
            mark = "  <- chosen" if i == self.chosen_index else ""
            row = f"  {j.candidate.name:{width}} {j.parameters:10} {self.rms[i]:11.5g}  "
            lines.append(f"{row}{of_best:>{max(24, len(over))}}{mark}")
        if len(self.ranked) > len(indices):
            lines.append(f"  … and {len(self.ranked) - len(indices)} more")
        return "\n".join(lines)

    def __repr__(self) -> str:
        """Return the table of the best candidates, and the reasons for the choice."""
        return f"{self.table()}\n{self.explain()}"


def _reasons(result: SearchResult) -> Iterator[str]:
    best, chosen, i = result.ranked[0], result.chosen, result.chosen_index
    method = f"prediction {plural(n, 'sample')} ahead" if (n := result.horizon) else "simulation"
    of_best = f"rms error {result.rms[0]:.4g} {result.unit}".rstrip()
    yield f"best {method} of the validation data: {best.candidate.name}, {of_best}"
    fewer = [k for k, j in enumerate(result.ranked) if j.parameters < chosen.parameters]
    as_good = bool(result.as_good[fewer].any())
    if i:
        why = "which predicts better one step ahead"
        if chosen.parameters < best.parameters:
            why = f"{plural(chosen.parameters, 'parameter')} instead of {best.parameters}"
        text = f"chosen: {chosen.candidate.name}, {why}; its mean squared error is higher by "
        yield (
            f"{text}{digits(result.excess[i], 2)} ± {digits(result.excess_std[i], 2)}, within "
            "its standard error"
        )
    else:
        why = "" if as_good else ", since no simpler model is as good"
        yield f"chosen: the best{why}"
    if as_good:
        yield "simpler models are as good, but predict worse one step ahead"
    elif fewer:
        k, simpler = fewer[0], result.ranked[fewer[0]]
        sigmas = result.excess[k] / max(result.excess_std[k], 1e-300)
        text = f"fewer parameters are not enough: {simpler.candidate.name} has {simpler.parameters}"
        text += f", rms error {result.rms[k]:.4g}, and "
        square = f"a mean squared error {sigmas:.1f} standard errors above the least"
        ratio = result.rms[k] / result.rms[0]
        larger = "a fit more than 2 points lower"
        if ratio > MAX_ERROR_RATIO:
            larger = f"an rms error of {digits(ratio, 3)} times the least"
        yield text + (square if sigmas > 1 else larger)
    order = chosen.candidate.order
    if order == max(c.order for c in (*(j.candidate for j in result.ranked), *result.failed)):
        text = f"order {order} is the highest that was tried, so a higher order may be better: "
        text += f"search with --max-order {2 * order} "
        yield f"{text}(in Python, orders=range(1, {2 * order + 1}))"
    yield from result.notes
    if result.tests.powerless:
        yield f"the tests of its residuals have no power: {result.tests.powerless}"
    rejected = (f for f in results(result.tests) if f.level == "unusable")
    yield from (f"tests of its residuals: {f.text}" for f in rejected)
    if result.failed:
        first, reason = next(iter(result.failed.items()))
        yield f"without a usable model: {len(result.failed)}, such as {first.name}: {reason}"
    if result.halved:
        yield "the chosen model was then estimated from all the data"
