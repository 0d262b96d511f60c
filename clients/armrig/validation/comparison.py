"""Comparison of models with measured data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from armrig_core.errors import InputError, InputTypeError
from numpy.typing import NDArray

from armrig.data.argument import takes_data
from armrig.data.columns import index_of
from armrig.data.dataset import Dataset, Signals, Vector
from armrig.data.finding import Finding
from armrig.data.treatment import difference, integrates_by_name
from armrig.models.characteristics import ModelCharacteristics, model_characteristics
from armrig.models.fit import Fit
from armrig.models.prediction import findings_on_own_data
from armrig.numerics.criteria import fit_percent
from armrig.numerics.quantities import plural
from armrig.plots.layout import html, plot_method
from armrig.validation.model_differences import explanation, table

Mask = NDArray[np.bool_]

_OWN = "  (estimation data)"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """One output of one model, compared with measured data."""

    name: str
    """Label of the model; by default its structure and orders."""
    output: str = ""
    """Name of the output."""
    unit: str = ""
    """Unit of the output."""
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
    def channel(self) -> Fit:
        """The model of this output and its only input."""
        is_channel = (self.model.ny, self.model.nu) == (1, 1)
        return self.model if is_channel else self.model[self.output]

    @property
    def characteristics(self) -> ModelCharacteristics:
        """Gain, poles, resonances, bandwidth and step response, computed at each call."""
        return model_characteristics(self.channel)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ComparisonTable:
    """Comparison of models on one data set; iterate over the table or print the table."""

    rows: tuple[Comparison, ...]
    """A row for each model and output: model after model, in the order of the arguments."""
    horizon: int | None
    """Prediction horizon in samples; None for simulation."""
    note: str
    """Text that names the quantities estimated from the compared data."""
    data: Dataset | Signals
    """Data that the models were compared with."""

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.rows)

    def __iter__(self) -> Iterator[Comparison]:
        """Iterate over the rows."""
        return iter(self.rows)

    def __getitem__(self, i: int) -> Comparison:
        """Return row i, from 0."""
        return self.rows[i]

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the compared outputs."""
        return tuple(dict.fromkeys(row.output for row in self.rows))

    @property
    def models(self) -> tuple[tuple[Comparison, ...], ...]:
        """Rows of each model, one for each output."""
        ny = len(self.outputs)
        return tuple(self.rows[k : k + ny] for k in range(0, len(self.rows), ny))

    def of(self, output: str) -> ComparisonTable:
        """Return the comparison of one output."""
        index_of("output", output, self.outputs)
        return replace(self, rows=tuple(row for row in self.rows if row.output == output))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Warnings, code "own data" or "overlap", about models estimated from these data."""
        named = [(rows[0].name, rows[0].model) for rows in self.models]
        return tuple(findings_on_own_data(named, self.data))

    def table(self) -> str:
        """Return a table of gain, resonances, bandwidth, step response and poles of the models.

        Each of several outputs has a table.
        """
        return self._of_each(table)

    def explain(self, *, brief: bool = False) -> str:
        """Return the closest model and the significant differences from the reference, as text.

        The reference is the physical model, `armrig.physics.physical_model(p, data)` (handout,
        assignment 3.4), or else the last model. A brief text contains no causes of the differences.
        """
        return self._of_each(lambda rows: explanation(rows, brief=brief))

    def _of_each(self, text: Callable[[Sequence[Comparison]], list[str]]) -> str:
        if len(self.outputs) == 1:
            return "\n".join(text(self.rows))
        lines = [[f"{output}:", *text(self.of(output).rows)] for output in self.outputs]
        return "\n".join(line for of_output in lines for line in of_output)

    plot = plot_method("plot_compare", "data, models and errors")

    _repr_html_ = html

    def __repr__(self) -> str:
        """Return a line for each model; a model of several outputs has a line for each output."""
        kind = "simulation" if self.horizon is None else f"{plural(self.horizon, 'sample')} ahead"
        lines = [f"{kind}; {self.note}"]
        if len(self.outputs) == 1:
            width = max(len(row.name) for row in self.rows)
            return "\n".join([*lines, *(row_line(f"{r.name:{width}}", r) for r in self.rows)])
        width = max(len(name) for name in self.outputs)
        for rows in self.models:
            lines.append(f"  {rows[0].name}{_OWN * rows[0].on_estimation_data}")
            lines += [f"  {misfit_line(f'{row.output:{width}}', row)}" for row in rows]
        return "\n".join(lines)


def row_line(name: str, row: Comparison) -> str:
    """Return the row of a model as a line of text."""
    return misfit_line(name, row) + _OWN * row.on_estimation_data


def misfit_line(name: str, row: Comparison) -> str:
    """Return the errors of a row as a line of text."""
    velocity = row.velocity_fit_percent
    line = f"  {name}  fit {row.fit_percent:7.2f} %  rms {row.rms_error:.4g} {row.unit}".rstrip()
    return line if velocity is None else f"{line}  velocity fit {velocity:7.2f} %"


@takes_data
def compare(
    data: Dataset | Signals,
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
    data : Dataset or Signals
        N samples, preferably of an experiment that no model was estimated from.
    *models : Fit
        At least one model, with the outputs and inputs of the data.
    horizon : int, optional
        Number of samples to predict ahead, >= 1, from the measured past; simulation by default.
    labels : sequence of str, optional
        A name for each model; by default its structure and orders.

    Returns
    -------
    ComparisonTable
        A row for each model and output: fit in percent, rms error in y's unit, ŷ (N,). `table()`
        compares gain, poles, resonances, bandwidth and step response; `explain()` names the
        differences. `of("y")` is the comparison of one of several outputs.

    Raises
    ------
    ValueError
        No model was given, the numbers of labels and models differ, or a model has other channels,
        another unit or another sampling time than the data.

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
            f"{plural(len(names), 'label')} for {plural(len(models), 'model')}; give one label "
            "for each model"
        )
    several = isinstance(data, Signals) and (data.ny, data.nu) != (1, 1)
    for model, name in zip(models, names, strict=True):
        if several and (model.ny, model.nu) == (1, 1):
            raise InputTypeError(
                f"{name} has one output; compare it with signals.dataset(output, input)"
            )
    integrators = [model.form.integrators for model in models]
    note = "initial state" + " and input offset" * bool(np.any(integrators))
    rows = [
        _comparisons(data, model, name, horizon, np.any(integrators, axis=0))
        for model, name in zip(models, names, strict=True)
    ]
    return ComparisonTable(
        rows=tuple(row for of_model in rows for row in of_model),
        horizon=horizon,
        note=f"{note} estimated from these data by least squares",
        data=data,
    )


def _comparisons(
    data: Dataset | Signals,
    model: Fit,
    name: str,
    horizon: int | None,
    integrators: Mask,
) -> Iterator[Comparison]:
    """Yield the comparison of each output of a model."""
    y = model.predict(data, horizon).reshape(data.N, -1)
    if isinstance(data, Signals):
        each = [data.dataset(output, data.inputs[0]) for output in data.outputs]
    else:
        each = [data]
    on_estimation_data = model.estimated_from(data)
    for own_data, modelled, integrates in zip(each, y.T, integrators.tolist(), strict=True):
        percent, rms = _misfit(own_data.y, modelled)
        velocity = None
        if integrates or integrates_by_name(own_data.output):
            of_model = own_data.replaced(y=modelled, valid=np.isfinite(modelled), step=None)
            velocity, _ = _misfit(difference(own_data).y, difference(of_model).y)
        yield Comparison(
            name=name,
            output=own_data.output,
            unit=own_data.unit,
            fit_percent=percent,
            rms_error=rms,
            velocity_fit_percent=velocity,
            on_estimation_data=on_estimation_data,
            y=modelled,
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
