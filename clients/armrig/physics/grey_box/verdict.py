"""What a grey-box fit says against itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from armrig.data.dataset import Dataset
from armrig.data.quantisation import too_quiet
from armrig.numerics.goodness_of_fit import fit_percent
from armrig.numerics.inference import Inference
from armrig.physics.grey_box.least_squares_problem import bipolar

_CLEARLY = 10.0  # N ln of the ratio of two costs above which one is worse by more than chance
_TINY = 1e-300


def noise_warnings(step: float, found: Inference) -> Iterator[str]:
    """Yield a warning where the output was read in steps, or the residuals are coloured."""
    if quiet := too_quiet(step, found.noise_variance):
        yield quiet
    if found.white.coloured:
        yield (
            f"the residuals are {found.white}: the model leaves something of the rig out "
            "(friction?), or the noise is not white; prefer std_robust"
        )


def worse_with_friction(data: Dataset, without: float, best: float) -> tuple[str, ...]:
    """Return a warning where Coulomb friction has made the fit worse, by more than chance.

    `without` and `best` are |e|² without and with it.
    """
    samples = data.N - data.missing
    if not samples * np.log(max(best, _TINY) / max(without, _TINY)) > _CLEARLY:
        return ()
    y = data.y[data.valid]
    fits = [f"{fit_percent(y, cost):.1f} %" for cost in (best, without)]
    held = not all(bipolar(part.u) for part in data.experiments())
    way_out = (
        'the input has one sign and u0 is held at 0: take friction="viscous", or play an input of '
        "both signs"
        if held
        else "the search ended in a poorer minimum: begin nearer, with another `fixed`"
    )
    return (f"with Coulomb friction the fit is {fits[0]}, without it {fits[1]}: {way_out}",)
