"""Comparison of models with measured data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from numpy.typing import NDArray

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.finding import EstimateFinding
from armrig.data.several_signals import accepts_signals
from armrig.data.treatment import INTEGRATING_OUTPUTS, difference
from armrig.models.characteristics import ModelCharacteristics, model_characteristics
from armrig.models.estimation_data import findings_on_own_data
from armrig.models.fit import Fit
from armrig.models.prediction import predicted
from armrig.numerics.criteria import fit_percent
from armrig.validation.model_differences import explanation, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """Output of one model, compared with measured data."""

    name: str
    """Label of the model; by default its structure and orders."""
    fit_percent: float
    """100 (1 - |y - ŷ| / |y - mean y|) over the samples that were measured."""
    rms_error: float
    """Root mean square of y - ŷ, in y's unit."""
    velocity_fit_percent: float | None
    """`fit_percent` for the rates of y and ŷ; None if the output does not integrate."""
    on_estimation_data: bool
    """True if the model was estimated from these data."""
    y: Vector
    """Output ŷ of the model, (N,)."""
    model: Fit
    """The model."""

    @property
    def characteristics(self) -> ModelCharacteristics:
        """Gain, poles, resonances, bandwidth and step response, computed at each call."""
        return model_characteristics(self.model)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ComparisonTable:
    """Comparison of models on one data set; iterate over the table or print the table."""

    rows: tuple[Comparison, ...]
    """A row for each model, in the order of the arguments."""
    horizon: int | None
    """Prediction horizon in samples; None for simulation."""
    unit: str
    """Unit of the rms error."""
    note: str
    """Text that names the quantities estimated from the compared data."""
    data: Dataset
    """Data that the models were compared with."""

    def __len__(self) -> int:
        """Return the number of models."""
        return len(self.rows)

    def __getitem__(self, i: int) -> Comparison:
        """Return the comparison of model i, from 0."""
        return self.rows[i]

    @property
    def findings(self) -> tuple[EstimateFinding, ...]:
        """Warnings, code "own data" or "overlap", about models estimated from these data."""
        named = [(row.name, row.model) for row in self.rows]
        return tuple(findings_on_own_data(named, self.data))

    def table(self, *, brief: bool = False) -> str:
        """Return a table of gain, resonances, bandwidth, step response and poles of the models.

        A brief table contains no poles. If a range is computed from draws, a brief table contains
        the range instead of the value.
        """
        return "\n".join(table(self.rows, brief=brief))

    def explain(self, *, brief: bool = False) -> str:
        """Return the closest model and the significant differences from the reference, as text.

        A brief text contains no causes of the differences.

        The reference is the physical model, `armrig.physical_model(p, data)` (handout, assignment
        3.4). Without a physical model, the reference is the last model.
        """
        return "\n".join(explanation(self.rows, brief=brief))

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of data, models and errors: see `armrig.plots.plot_compare`."""
        from armrig.plots.layout import figure_of
        from armrig.validation.comparison_figure import plot_comparison

        return figure_of(plot_comparison(self.data, self.rows, ax=ax))

    def _repr_html_(self) -> str:
        """Return text and figure as HTML for a notebook."""
        from armrig.plots.notebook import html

        return html(self)

    def __repr__(self) -> str:
        """Return a line for each model."""
        what = "simulation" if self.horizon is None else f"{self.horizon} samples ahead"
        lines = [f"{what}; {self.note}"]
        width = max(len(row.name) for row in self.rows)
        lines += [row_line(f"{row.name:{width}}", row, self.unit) for row in self.rows]
        return "\n".join(lines)


def row_line(name: str, row: Comparison, unit: str) -> str:
    """Return the row of a model as a line of text."""
    velocity = row.velocity_fit_percent
    line = f"  {name}  fit {row.fit_percent:7.2f} %  rms {row.rms_error:.4g} {unit}".rstrip()
    if velocity is not None:
        line += f"  velocity fit {velocity:7.2f} %"
    return line + "  (estimation data)" * row.on_estimation_data


@accepts_signals("armrig.models.multivariable.comparison")
@takes_recordings
def compare(
    data: Dataset,
    *models: Fit,
    horizon: int | None = None,
    labels: Sequence[str] | None = None,
) -> ComparisonTable:
    """Compare models with data, by simulation unless a horizon is given.

    The initial state of each experiment is estimated from these data by least squares. For a model
    with an integrator, the input offset of each experiment is also estimated. Missing samples are
    not compared. If the output integrates, the fit is near 100 % for every model, because the ramp
    of y dominates ``|y - mean y|``. In this case, use the rms error and the fit of the velocity.
    The velocity is computed from differences of the angle, so the measured velocity contains the
    noise of two samples.

    Parameters
    ----------
    data : Dataset
        N samples, preferably of an experiment that no model was estimated from.
    *models : Fit
        At least one model, with the output of the data.
    horizon : int, optional
        Number of samples to predict ahead, >= 1, from the measured past; simulation by default.
    labels : sequence of str, optional
        A name for each model; by default its structure and orders.

    Returns
    -------
    ComparisonTable
        A row for each model: fit in percent, rms error in y's unit, ŷ (N,). `table()` compares
        gain, poles, resonances, bandwidth and step response; `explain()` names the differences.

    Raises
    ------
    ValueError
        No model was given, the numbers of labels and models differ, or a model has another output,
        unit or sampling time than the data.

    Examples
    --------
    >>> import armrig
    >>> first, second = armrig.example_recording().dataset("alpha").split(2)
    >>> models = armrig.oe(first, nb=3, nf=3), armrig.arx(first, na=3, nb=3)
    >>> print(armrig.compare(second, *models))
    simulation; initial state estimated from these data by least squares
      OE[3 3 1]   fit   97.5... %  rms 0.0035... rad
      ARX[3 3 1]  fit   50.0... %  rms 0.072... rad
    """
    if not models:
        raise InputError("compare needs at least one model: compare(data, fit)")
    for model in models:
        if not hasattr(model, "label"):
            raise InputTypeError(
                f"a {type(model).__name__} is no model: give each model by itself, "
                "compare(data, fit1, fit2); give names as labels=(…)"
            )
    if isinstance(labels, str):
        raise InputTypeError(
            f"labels={labels!r} must be a name for each model, such as labels=({labels!r},)"
        )
    names = [model.label for model in models] if labels is None else list(labels)
    if len(names) != len(models):
        raise InputError(
            f"{len(names)} labels for {len(models)} models; give one label for each model"
        )
    integrating = data.output in INTEGRATING_OUTPUTS or any(m.integrator for m in models)
    note = "initial state" + (" and input offset" if any(m.integrator for m in models) else "")
    return ComparisonTable(
        rows=tuple(
            _compared(data, model, name, horizon, integrating=integrating)
            for model, name in zip(models, names, strict=True)
        ),
        horizon=horizon,
        unit=data.unit,
        note=f"{note} estimated from these data by least squares",
        data=data,
    )


def _compared(
    data: Dataset, model: Fit, name: str, horizon: int | None, *, integrating: bool
) -> Comparison:
    y = predicted(model, data, horizon)
    percent, rms = _misfit(data.y, y)
    velocity = None
    if integrating:
        modelled = data.replaced(y=y, valid=np.isfinite(y), step=None)
        velocity, _ = _misfit(difference(data).y, difference(modelled).y)
    return Comparison(
        name=name,
        fit_percent=percent,
        rms_error=rms,
        velocity_fit_percent=velocity,
        on_estimation_data=model.estimated_from(data),
        y=y,
        model=model,
    )


def _misfit(measured: Vector, modelled: Vector) -> tuple[float, float]:
    """Return fit percent and rms error, over the samples at which both outputs are known."""
    if np.isinf(modelled).any():
        return -np.inf, np.inf
    both = np.isfinite(measured) & np.isfinite(modelled)
    if not both.any():
        return float("nan"), float("nan")
    sse = float(np.sum((measured[both] - modelled[both]) ** 2))
    return fit_percent(measured[both], sse), sqrt(sse / np.count_nonzero(both))
