"""Comparison of models of several outputs with measured signals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from armrig_core.errors import InputError, InputTypeError

from armrig.data.finding import EstimateFinding
from armrig.data.signals import Signals
from armrig.models.estimation_data import findings_on_own_data
from armrig.models.state_space import Matrix
from armrig.numerics.criteria import fit_percent
from armrig.numerics.quantities import plural

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class SignalsModel(Protocol):
    """Model with several outputs."""

    @property
    def label(self) -> str:
        """Name in tables and legends."""

    def predict(self, data: Signals, horizon: int | None = 1) -> Matrix:
        """Return ŷ(t) (N, ny)."""

    def estimated_from(self, data: Signals) -> bool:
        """Return whether the model was estimated from these data."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SignalsComparison:
    """Outputs of one model, compared with measured signals."""

    name: str
    """Label of the model; by default its structure and orders."""
    fit_percent: tuple[float, ...]
    """100 (1 - |y - ŷ| / |y - mean y|) of each output, over its measured samples."""
    rms_error: tuple[float, ...]
    """Root mean square of y - ŷ of each output, in the unit of the output."""
    on_estimation_data: bool
    """True if the model was estimated from these signals."""
    y: Matrix
    """Outputs ŷ of the model, (N, ny)."""
    model: SignalsModel
    """The model."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SignalsComparisonTable:
    """Comparison of models on one set of signals; iterate over the table or print the table."""

    rows: tuple[SignalsComparison, ...]
    """A row for each model, in the order of the arguments."""
    horizon: int | None
    """Prediction horizon in samples; None for simulation."""
    data: Signals
    """Signals that the models were compared with."""

    def __len__(self) -> int:
        """Return the number of models."""
        return len(self.rows)

    def __iter__(self) -> Iterator[SignalsComparison]:
        """Iterate over the models."""
        return iter(self.rows)

    def __getitem__(self, i: int) -> SignalsComparison:
        """Return the comparison of model i, from 0."""
        return self.rows[i]

    @property
    def findings(self) -> tuple[EstimateFinding, ...]:
        """Warnings, code "own data" or "overlap", about models estimated from these data."""
        named = [(row.name, row.model) for row in self.rows]
        return tuple(findings_on_own_data(named, self.data))

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure with a panel for each output, which shows the data and each model."""
        from armrig.models.multivariable.figures import plot_signals_comparison
        from armrig.plots.layout import figure_of

        return figure_of(plot_signals_comparison(self, ax=ax))

    def _repr_html_(self) -> str:
        """Return text and figure as HTML for a notebook."""
        from armrig.plots.notebook import html

        return html(self)

    def __repr__(self) -> str:
        """Return the table as text, a line for each model and output."""
        what = "simulation" if self.horizon is None else f"{plural(self.horizon, 'sample')} ahead"
        lines = [f"{what}; initial state estimated from these data by least squares"]
        width = max(len(name) for name in self.data.outputs)
        for row in self.rows:
            lines.append(f"  {row.name}" + ("  (estimation data)" * row.on_estimation_data))
            values = zip(
                self.data.outputs, self.data.units, row.fit_percent, row.rms_error, strict=True
            )
            lines += [
                f"    {name:{width}}  fit {fit:7.2f} %  rms {rms:.4g} {unit}".rstrip()
                for name, unit, fit, rms in values
            ]
        return "\n".join(lines)


def compare(
    data: Signals,
    *models: SignalsModel,
    horizon: int | None = None,
    labels: Sequence[str] | None = None,
) -> SignalsComparisonTable:
    """Compare models of several outputs with signals, by simulation unless a horizon is given.

    The initial state of each experiment, and a ramp of each integrating output, are estimated from
    these data by least squares. Missing samples are not compared.

    Parameters
    ----------
    data : Signals
        N samples, preferably of an experiment that no model was estimated from.
    *models : MultivariableFit
        At least one model, with the channels of the data.
    horizon : int, optional
        Number of samples to predict ahead, >= 1; simulation by default.
    labels : sequence of str, optional
        A name for each model; by default its structure and orders.

    Returns
    -------
    SignalsComparisonTable
        A row for each model: fit in percent and rms error of each output, and ŷ (N, ny).

    Raises
    ------
    ValueError
        No model was given, the numbers of labels and models differ, or a model has other channels
        or another sampling time than the data.
    """
    if not models:
        raise InputError("compare needs at least one model: compare(signals, fit)")
    for model in models:
        channels = getattr(model, "nu", data.nu) * getattr(model, "ny", data.ny)
        if not hasattr(model, "estimated_from") or channels == 1 < data.nu * data.ny:
            raise InputTypeError(
                f"a {type(model).__name__} has one output; compare it with "
                "signals.dataset(output, input)"
            )
    names = [model.label for model in models] if labels is None else list(labels)
    if isinstance(labels, str) or len(names) != len(models):
        raise InputError(f"labels={labels!r}: give a name for each of {len(models)} models")
    rows = []
    for model, name in zip(models, names, strict=True):
        y = model.predict(data, horizon).reshape(data.y.shape)
        quality = [_misfit(data.y[:, i], y[:, i]) for i in range(data.ny)]
        rows.append(
            SignalsComparison(
                name=name,
                fit_percent=tuple(fit for fit, _ in quality),
                rms_error=tuple(rms for _, rms in quality),
                on_estimation_data=model.estimated_from(data),
                y=y,
                model=model,
            )
        )
    return SignalsComparisonTable(rows=tuple(rows), horizon=horizon, data=data)


def _misfit(measured: Matrix, modelled: Matrix) -> tuple[float, float]:
    """Return fit percent and rms error over the measured samples."""
    known = np.isfinite(measured)
    if np.isinf(modelled[known]).any():
        return float("-inf"), float("inf")
    error = measured[known] - modelled[known]
    sse = float(error @ error)
    return fit_percent(measured[known], sse), float(np.sqrt(sse / error.size))
