"""Texts in figures of models: names, units, and methods of the bands and regions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from armrig.models.estimate import Estimate
from armrig.numerics.confidence_regions import Band

if TYPE_CHECKING:
    from armrig.models.uncertainty import Draws

Labels = Sequence[str] | None


def labels_of(models: Sequence[Any], labels: Labels) -> list[str]:
    """Return the given labels, or the label of each model."""
    if labels is not None:
        return list(labels)
    # A python-control system has the attribute `name`.
    return [
        model.label if isinstance(model, Estimate) else str(getattr(model, "name", "model"))
        for model in models
    ]


def sources_of(models: Sequence[Any]) -> list[str]:
    """Return the hashes of the recordings that the models were identified from."""
    return [getattr(model, "source", "") for model in models]


def gain_unit(models: Sequence[Any], *, rate: bool = False) -> str:
    """Return the unit of y, or of its rate, per unit of u, from the first model with both units."""
    for model in models:
        if getattr(model, "unit", "") and getattr(model, "input_unit", ""):
            return f"{model.unit}{'/s' if rate else ''}/{model.input_unit}"
    return "–"


def with_method(name: str, band: Band) -> str:
    """Return a model's name, followed by the method of its 95 % band: linearised or by draws."""
    return f"{name}, 95 % {'by draws' if band.method == 'sampled' else band.method}"


def left_out(of: Mapping[str, Draws | None], *, models: int) -> list[str]:
    """Return a line with the numbers of rejected draws of each model, if there are any."""
    said = [
        f"{name}: {d.left_out}" if models > 1 else d.left_out
        for name, d in of.items()
        if d is not None and d.left_out
    ]
    return [f"draws left out: {'; '.join(said)}"] if said else []
