"""Notes about the signals of a table: their columns, their means, a constant output."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from armrig_core.errors import InputError

from armrig.cli.options import inform, tell
from armrig.numerics.quantities import listed

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals, Vector

Named = Sequence[tuple[str, "Vector"]]
"""Names of signals, with their measured values."""

_IS = ("is", "are")
_MIN_SAMPLES = 20
"""Smallest number of samples for which a note about the mean is printed."""


def check_varies(file: Path, output: str, y: Vector) -> None:
    """Refuse a constant output, because it contains no response to the input."""
    import numpy as np

    if y.size > 1 and np.ptp(y) == 0:
        msg = f"{file}: {output} is constant, {y[0]:.4g}, so it responds to no input; give "
        raise InputError(msg + "a column that varies (--signal), or record again")


def hint_at_means(
    outputs: Named,
    inputs: Named,
    *,
    may_offset: bool = False,
) -> None:
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
    from armrig.data.step import DOUBT, codes_of

    steps = list(zip(data.history, codes_of(data.history), strict=True))
    for text, code in steps:
        if code == DOUBT:
            tell(f"{file}: {text}")
    facts = [text for text, code in steps if code != DOUBT]
    parts = [f"{data.N} samples, {data.Ts:g} s apart", *columns]
    parts += [f"{data.missing} {missing}"] if data.missing else []
    inform(f"{file}: {'; '.join([*parts, *facts])}", dim=True)
