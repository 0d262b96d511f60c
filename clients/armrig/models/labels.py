"""What figures of models write: names, units, and how a band or region was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from armrig.models.model import Model
from armrig.numerics.confidence_regions import Band

if TYPE_CHECKING:
    from armrig.models.parameter_draws import Draws

Labels = Sequence[str] | None


def labels_of(models: Sequence[Any], labels: Labels) -> list[str]:
    """Return the labels given, or what each model calls itself."""
    if labels is not None:
        return list(labels)
    # A system of python-control has a name.
    return [
        model.label if isinstance(model, Model) else str(getattr(model, "name", "model"))
        for model in models
    ]


def sources_of(models: Sequence[Any]) -> list[str]:
    """Return the hashes of the recordings that the models are of."""
    return [getattr(model, "source", "") for model in models]


def gain_unit(models: Sequence[Any], *, rate: bool = False) -> str:
    """Return the unit of y's (or its rate's) per u's, of the first model that has both."""
    for model in models:
        if getattr(model, "unit", "") and getattr(model, "input_unit", ""):
            return f"{model.unit}{'/s' if rate else ''}/{model.input_unit}"
    return "–"


def with_method(name: str, band: Band) -> str:
    """Return a model's name with what its band is: 95 %, linearised or by draws."""
    return f"{name}, 95 % {'by draws' if band.method == 'sampled' else band.method}"


def left_out(of: Mapping[str, Draws | None], *, models: int) -> list[str]:
    """Return a line that says which draws were left out, if any, and of which model."""
    said = [
        f"{name}: {d.left_out}" if models > 1 else d.left_out
        for name, d in of.items()
        if d is not None and d.left_out
    ]
    return [f"draws left out: {'; '.join(said)}"] if said else []
