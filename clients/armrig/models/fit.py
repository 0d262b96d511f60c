"""Result of an estimation: a model with uncertainty, texts and figures."""

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
        """Return ŷ(t) (N,) from u up to t and y up to t - horizon; with None, from u alone.

        The initial state is estimated from the data by least squares. With an integrator, or if the
        model has `offset`, the input offset is estimated too. ŷ is NaN if the past is not yet
        known. For a model without C, ŷ is NaN at the beginning. For a model with C or D, ŷ is NaN
        during a gap and for at least the next `horizon` - 1 samples.
        """
        from armrig.models.prediction import predicted

        return predicted(self, data, horizon)

    def summary(self) -> Summary:
        """Return poles, zeros, gain, bandwidth and times with 95 % ranges, as a table to print.

        The ranges are linearised, or computed by draws of the parameters if the linearisation is
        poor. See `armrig.numerics.confidence_regions`.
        """
        from armrig.models.summary import summary

        return summary(self)

    def plot(self) -> Figure:
        """Return a figure of frequency and step response, poles and zeros, with 95 % regions.

        The functions of `armrig.plots` draw each panel alone, for several models or in your own
        axes.
        """
        from armrig.models.figures import plot_fit

        return plot_fit(self)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the model as JSON, with all digits of each number; `armrig.load_fit` reads it.

        The file also contains the hash of the recording and the treatment of its data.
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
        """Return the model as HTML for a notebook."""
        from armrig.models.markup import html

        return html(self)

    def __repr__(self) -> str:
        """Return the model as a few lines of text with orders, equation and quality."""
        from armrig.models.equation import described

        return described(self)
