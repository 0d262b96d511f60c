"""Names of the signals that commands read: names in options, and names in a saved model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import typer
from armrig_core.errors import InputError
from armrig_core.telemetry import OutputName

from armrig.cli.options import tell
from armrig.numerics.quantities import listed, plural

if TYPE_CHECKING:
    from armrig.data.dataset import Signals
    from armrig.models.fit import Fit

_INPUTS = ("u",)
"""Inputs of a recording."""


def names(option: str, text: str | None) -> tuple[str, ...]:
    """Return the names in a text with commas; refuse empty and repeated names."""
    found = tuple(name.strip() for name in text.split(",")) if text else ()
    if "" in found:
        raise typer.BadParameter(f"{option} {text}: a name is empty; give names with commas, A,B")
    if repeated := [name for name in dict.fromkeys(found) if found.count(name) > 1]:
        raise typer.BadParameter(f"{option} {text}: {repeated[0]} is repeated; name it once")
    return found


def recorded_outputs(chosen: Sequence[str]) -> list[OutputName]:
    """Return the names as outputs of a recording; refuse any other name."""
    known: dict[str, OutputName] = {name: name for name in get_args(OutputName)}
    if unknown := [name for name in chosen if name not in known]:
        raise typer.BadParameter(f"--signal {unknown[0]}: a recording has {', '.join(known)}")
    return [known[name] for name in chosen]


def modelled_outputs(model: Fit, chosen: Sequence[str]) -> list[OutputName]:
    """Return the model's outputs in the model's order; refuse a model of other signals."""
    known: dict[str, OutputName] = {name: name for name in get_args(OutputName)}
    if not set(model.outputs) <= known.keys() or model.inputs != _INPUTS:
        raise InputError(
            f"the model's inputs are {', '.join(model.inputs)} and its outputs "
            f"{', '.join(model.outputs)}, but a recording has the input u and the outputs "
            f"{', '.join(known)}; use data with the model's signals"
        )
    if chosen and set(chosen) != set(model.outputs):
        raise typer.BadParameter(
            f"--signal {','.join(chosen)}: the model's outputs are "
            f"{', '.join(model.outputs)}; leave --signal out"
        )
    return [known[name] for name in model.outputs]


def require_as_many(model: Fit, outputs: Sequence[str], inputs: Sequence[str]) -> None:
    """Refuse column names if their number differs from the number of the model's signals."""
    for option, what, chosen, own in (
        ("--signal", "output", outputs, model.outputs),
        ("--input", "input", inputs, model.inputs),
    ):
        if chosen and len(chosen) != len(own):
            raise typer.BadParameter(
                f"{option} {','.join(chosen)}: the model has {plural(len(own), what)}, "
                f"{listed(own)}; name a column for each, in this order"
            )


def as_modelled(file: Path, signals: Signals, model: Fit) -> Signals:
    """Return the signals with the model's names, in the model's order.

    If the user names other columns, these columns are used as the model's signals. A message lists
    the columns.
    """
    for own, found in ((model.outputs, signals.outputs), (model.inputs, signals.inputs)):
        if set(own) != set(found):
            tell(f"{file}: for the model's {', '.join(own)} the command reads {', '.join(found)}")
    same_outputs = set(model.outputs) == set(signals.outputs)
    same_inputs = set(model.inputs) == set(signals.inputs)
    ordered = signals.channels(
        model.outputs if same_outputs else None, model.inputs if same_inputs else None
    )
    return ordered.replaced(step=None, outputs=model.outputs, inputs=model.inputs)
