"""Figures of models against data: outputs, errors and residuals."""

from __future__ import annotations

from typing import TYPE_CHECKING

from armrig.models.labels import Labels
from armrig.models.model import Model
from armrig.validation.comparison import ComparisonTable, compare
from armrig.validation.comparison_figure import plot_comparison
from armrig.validation.residual_figure import plot_residual_test
from armrig.validation.residuals import residuals

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from armrig.data.dataset import Dataset
    from armrig.models.fit import Fit


def plot_compare(
    data: Dataset,
    *models: Model,
    horizon: int | None = None,
    labels: Labels = None,
    table: ComparisonTable | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Show measured output and models, simulated unless a horizon is given.

    See `armrig.validation.comparison_figure.plot_comparison`; a table that is there is not computed
    again.
    """
    table = compare(data, *models, horizon=horizon, labels=labels) if table is None else table
    return plot_comparison(data, table.rows, labels=labels, ax=ax)


def plot_residuals(
    fit: Fit, data: Dataset, *, lags: int | None = None, ax: Axes | None = None
) -> Axes:
    """Show how a model's residuals correlate with each other and with the input.

    See `armrig.validation.residual_figure.plot_residual_test`.
    """
    return plot_residual_test(residuals(fit, data, lags), ax=ax)
