"""The result of an estimation: a model, how sure it is, and what it says of itself and of data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from armrig.data.dataset import Dataset
from armrig.models.estimate import Estimate
from armrig.models.model import Vector

if TYPE_CHECKING:
    from os import PathLike

    from matplotlib.figure import Figure

    from armrig.models.summary import Summary


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Fit(Estimate):
    """A model A(q) y(t) = B(q)/F(q) u(t) + C(q)/D(q) e(t) with its uncertainty."""

    def predict(self, data: Dataset, horizon: int | None = 1) -> Vector:
        """Return ŷ(t) (N,) from u up to t and y up to t - horizon; None is simulation.

        The initial state is estimated from the data by least squares (with an integrator, or if
        it was with the model, the input offset too); NaN where the past is not yet known: at the
        beginning for a model without C, and with a noise model within `horizon` of a gap.
        """
        from armrig.models.prediction import predicted

        return predicted(self, data, horizon)

    def summary(self) -> Summary:
        """Return poles, zeros, gain, bandwidth and the like with 95 % ranges; print it.

        They are linearised, or by draws of the parameters where that is poor: see
        `armrig.numerics.confidence_regions`.
        """
        from armrig.models.summary import summary

        return summary(self)

    def plot(self) -> Figure:
        """Return a figure of frequency and step response, poles and zeros, with 95 % regions.

        For one of them, for several models and for axes of your own see `armrig.plots`.
        """
        from armrig.models.figures import plot_fit

        return plot_fit(self)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the model as JSON, every number to its last digit; `armrig.load_fit` reads it.

        The file holds the hash of the recording and the treatment of its data, too.
        """
        from armrig.models.model_writing import save_fit

        save_fit(self, path)

    def latex(self) -> str:
        """Return the equation with standard deviations as LaTeX, an `aligned` block."""
        from armrig.models.markup import latex

        return latex(self)

    def typst(self) -> str:
        """Return the equation with standard deviations as a block of Typst's mathematics."""
        from armrig.models.markup import typst

        return typst(self)

    def _repr_html_(self) -> str:
        """Show itself in a notebook."""
        from armrig.models.markup import html

        return html(self)

    def __repr__(self) -> str:
        """Say it in a few lines, equation first."""
        from armrig.models.equation import described

        return described(self)
