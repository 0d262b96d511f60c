"""How well models say what the rig does, on data that they have or have not seen."""

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
from armrig.data.treatment import INTEGRATING_OUTPUTS, difference
from armrig.models.characteristics import ModelCharacteristics, model_characteristics
from armrig.models.model import Model
from armrig.models.prediction import predicted
from armrig.numerics.criteria import fit_percent
from armrig.validation.model_differences import explanation, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """One model's output against measured data."""

    name: str
    """The label given, or what the model calls itself: structure and orders."""
    fit_percent: float
    """100 (1 - |y - ŷ| / |y - mean y|) over the samples that were measured."""
    rms_error: float
    """Root mean square of y - ŷ, in y's unit."""
    velocity_fit_percent: float | None
    """The same percentage for the rates of both, None where the output does not integrate."""
    on_estimation_data: bool
    """The model was estimated from these very data."""
    y: Vector
    """ŷ, (N,)."""
    model: Model
    """The model."""

    @property
    def characteristics(self) -> ModelCharacteristics:
        """Gain, poles, resonances, bandwidth and step response of the model, computed anew."""
        return model_characteristics(self.model)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ComparisonTable:
    """Models side by side on one data set; iterate over it or print it."""

    rows: tuple[Comparison, ...]
    """One a model, in the order asked for."""
    horizon: int | None
    """Prediction horizon in samples; None is simulation."""
    unit: str
    """Unit of the rms error."""
    note: str
    """What was estimated from the compared data themselves."""
    data: Dataset
    """What the models were compared with."""

    def __len__(self) -> int:
        """Return the number of models."""
        return len(self.rows)

    def __getitem__(self, i: int) -> Comparison:
        """Return number i."""
        return self.rows[i]

    def table(self, *, brief: bool = False) -> str:
        """Return the models' figures side by side: gain, resonances, bandwidth, step, poles.

        A brief one leaves out the poles, and gives a range by draws in place of its value.
        """
        return "\n".join(table(self.rows, brief=brief))

    def explain(self) -> str:
        """Say which is closest, and where each differs by more than chance from the physics.

        The physics is `armrig.physical_model(p, data)`, one of the models (handout, assignment
        3.4); without one each is held against the last.
        """
        return "\n".join(explanation(self.rows))

    def plot(self, *, ax: Axes | None = None) -> Figure:
        """Return a figure of data and models, and their errors: see `armrig.plots.plot_compare`."""
        from armrig.plots.layout import figure_of
        from armrig.validation.comparison_figure import plot_comparison

        return figure_of(plot_comparison(self.data, self.rows, ax=ax))

    def _repr_html_(self) -> str:
        """Show itself in a notebook: what it says, and its figure."""
        from armrig.plots.notebook import html

        return html(self)

    def __repr__(self) -> str:
        """Say it in a few lines."""
        what = "simulation" if self.horizon is None else f"{self.horizon} samples ahead"
        lines = [f"{what}; {self.note}"]
        width = max(len(row.name) for row in self.rows)
        for row in self.rows:
            velocity = row.velocity_fit_percent
            lines.append(
                f"  {row.name:{width}}  fit {row.fit_percent:7.2f} %  "
                f"rms {row.rms_error:.4g} {self.unit}".rstrip()
                + (f"  velocity fit {velocity:7.2f} %" if velocity is not None else "")
                + ("  (estimation data)" if row.on_estimation_data else "")
            )
        return "\n".join(lines)


@takes_recordings
def compare(
    data: Dataset,
    *models: Model,
    horizon: int | None = None,
    labels: Sequence[str] | None = None,
) -> ComparisonTable:
    """Compare models with data, by simulation unless a horizon is given.

    A model cannot know the state the rig was in when the data began, so the initial state of each
    experiment is estimated from these data by least squares, and with an integrator its input
    offset too. Missing samples do not count. For an integrating output the percentage flatters
    every model, because the ramp dominates |y - mean y|: read the rms error, and the fit of the
    velocity (measured and modelled angle both differenced, so the measured one carries the
    noise of two samples).

    Parameters
    ----------
    data : Dataset
        N samples, best of an experiment that no model has seen.
    *models : Fit
        At least one, of the output that the data show.
    horizon : int, optional
        Predict so many samples ahead, >= 1, from the measured past; by default simulate.
    labels : sequence of str, optional
        Names of the models, one each; structure and orders by default.

    Returns
    -------
    ComparisonTable
        One row a model: fit in percent, rms error in y's unit, ŷ (N,). Its `table()` puts gain,
        poles, resonances, bandwidth and step response side by side, `explain()` says what differs.

    Raises
    ------
    ValueError
        No model was given, the labels are not one a model, or a model has another output, unit or
        sampling time.
    """
    if not models:
        raise InputError("compare needs at least one model: compare(data, fit)")
    for model in models:
        if not hasattr(model, "label"):
            raise InputTypeError(
                f"a {type(model).__name__} is no model: give each by itself, "
                "compare(data, fit1, fit2); names are labels=(…)"
            )
    if isinstance(labels, str):
        raise InputTypeError(
            f"labels={labels!r} must be several names, one a model, such as labels=({labels!r},)"
        )
    names = [model.label for model in models] if labels is None else list(labels)
    if len(names) != len(models):
        raise InputError(f"{len(names)} labels for {len(models)} models; give one each")
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
    data: Dataset, model: Model, name: str, horizon: int | None, *, integrating: bool
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
    """Return fit percent and rms error over the samples that both have."""
    if np.isinf(modelled).any():
        return -np.inf, np.inf
    both = np.isfinite(measured) & np.isfinite(modelled)
    if not both.any():
        return float("nan"), float("nan")
    sse = float(np.sum((measured[both] - modelled[both]) ** 2))
    return fit_percent(measured[both], sse), sqrt(sse / np.count_nonzero(both))
