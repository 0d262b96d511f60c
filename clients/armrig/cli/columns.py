"""Signals of a file: their names in options and in a saved model, and notes about their values."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import typer
from armrig_core.errors import InputError
from armrig_core.telemetry.telemetry import THETA_1, OutputName

from armrig.cli.printing import inform, tell
from armrig.data.step import DOUBT, codes_of
from armrig.numerics.quantities import listed, plural

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals, Vector
    from armrig.models.fit import Fit

Named = Sequence[tuple[str, "Vector"]]
"""Names of signals, with their measured values."""
UNNAMED = ("", "y")
"""Names of model outputs that may mean any signal."""
_INPUTS = ("u",)
"""Inputs of a recording."""
_OUTPUTS: dict[str, OutputName] = {name: name for name in get_args(OutputName)}
"""Outputs of a recording."""
_IS = ("is", "are")
_MIN_SAMPLES = 20
"""Smallest number of samples for which a note about the mean is printed."""


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
    if unknown := [name for name in chosen if name not in _OUTPUTS]:
        raise typer.BadParameter(f"--signal {unknown[0]}: a recording has {', '.join(_OUTPUTS)}")
    return [_OUTPUTS[name] for name in chosen]


def chosen_outputs(signal: Sequence[str] | None) -> list[OutputName]:
    """Return the outputs of a recording that a repeatable --signal names; by default theta_1."""
    return recorded_outputs(names("--signal", ",".join(signal or ())) or (THETA_1,))


def modelled_outputs(model: Fit, chosen: Sequence[str]) -> list[OutputName]:
    """Return the model's outputs in the model's order; refuse a model of other signals.

    If the only output of the model has no name, it is the chosen output, or theta_1.
    """
    if (model.ny, model.nu) == (1, 1) and model.output in UNNAMED:
        return recorded_outputs(chosen or (THETA_1,))
    if not set(model.outputs) <= _OUTPUTS.keys() or model.inputs != _INPUTS:
        raise InputError(
            f"the model's inputs are {', '.join(model.inputs)} and its outputs "
            f"{', '.join(model.outputs)}, but a recording has the input u and the outputs "
            f"{', '.join(_OUTPUTS)}; use data with the model's signals"
        )
    if chosen and set(chosen) != set(model.outputs):
        raise typer.BadParameter(
            f"--signal {','.join(chosen)}: the model has {plural(model.ny, 'output')}, "
            f"{listed(model.outputs)}; leave --signal out"
        )
    return [_OUTPUTS[name] for name in model.outputs]


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


def as_modelled(
    file: Path, data: Dataset | Signals, model: Fit, *, named: bool
) -> Dataset | Signals:
    """Return the data with the model's names, in the model's order.

    If the user names other columns, these columns are used as the model's signals. A message lists
    the columns.
    """
    from armrig.data.dataset import Dataset

    if isinstance(data, Dataset):
        # A column that the user named is the model's output.
        given = named and model.output not in UNNAMED
        return data.replaced(step=None, output=model.output) if given else data
    for own, found in ((model.outputs, data.outputs), (model.inputs, data.inputs)):
        if set(own) != set(found):
            tell(f"{file}: for the model's {', '.join(own)} the command reads {', '.join(found)}")
    same_outputs = set(model.outputs) == set(data.outputs)
    same_inputs = set(model.inputs) == set(data.inputs)
    ordered = data.channels(
        model.outputs if same_outputs else None, model.inputs if same_inputs else None
    )
    return ordered.replaced(step=None, outputs=model.outputs, inputs=model.inputs)


def check_varies(file: Path, output: str, y: Vector) -> None:
    """Refuse a constant output, because it contains no response to the input."""
    import numpy as np

    if y.size > 1 and np.ptp(y) == 0:
        msg = f"{file}: {output} is constant, {y[0]:.4g}, so it responds to no input; give "
        raise InputError(msg + "a column that varies (--signal), or record again")


def hint_at_means(outputs: Named, inputs: Named, *, may_offset: bool = False) -> None:
    """If the mean of a signal is far from 0, as at an operating point, suggest an option."""
    every = [*outputs, *inputs]
    if far_from_zero([x for _, x in every]):
        along = "estimate a level with --offset, or " if may_offset else ""
        means = ", ".join(f"the mean of {name} is {x.mean():.4g}" for name, x in every)
        y, u = listed([name for name, _ in outputs]), " = ".join(name for name, _ in inputs)
        tell(
            f"{means}; if {y} {_IS[len(outputs) > 1]} not 0 at {u} = 0, {along}subtract the means "
            "with --detrend"
        )


def far_from_zero(every: Sequence[Vector]) -> bool:
    """Return True if a mean is far from 0, as at an operating point, and all signals vary."""
    import numpy as np

    # Subtracting the mean of a constant signal would leave 0.
    if any(x.size < _MIN_SAMPLES or not np.ptp(x) for x in every):
        return False
    return any(abs(x.mean()) > 2 * x.std() for x in every)


def tell_of_reading(
    file: Path, data: Dataset | Signals, columns: Sequence[str], missing: str
) -> None:
    """Print first the doubts about the reading of a file, then its other facts."""
    steps = list(zip(data.history, codes_of(data.history), strict=True))
    for text, code in steps:
        if code == DOUBT:
            tell(f"{file}: {text}")
    facts = [text for text, code in steps if code != DOUBT]
    parts = [f"{data.N} samples, {data.Ts:g} s apart", *columns]
    parts += [f"{data.missing} {missing}"] if data.missing else []
    inform(f"{file}: {'; '.join([*parts, *facts])}", dim=True)
