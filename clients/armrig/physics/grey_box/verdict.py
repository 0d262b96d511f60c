"""What a grey-box fit says against itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from armrig.data.dataset import Dataset
from armrig.data.quantisation import too_quiet
from armrig.numerics.criteria import fit_percent
from armrig.numerics.inference import Inference
from armrig.physics.grey_box.least_squares_problem import bipolar
from armrig.physics.grey_box.parameters import SIGNED

FURTHEST = 12.0
"""Logarithm of the factor by which a parameter may move from its start; e^12 is 160 000."""
_AT_BOUND = 0.98  # share of it from which on a search has ended there: its steps are halved
_CLEARLY = 10.0  # N ln of the ratio of two costs above which one is worse by more than chance
_TINY = 1e-300


def at_bound(names: Sequence[str], moved: NDArray[np.float64]) -> Iterator[str]:
    """Yield a warning for each parameter whose search ended at its bound.

    Parameters
    ----------
    names : sequence of str
        The free parameters.
    moved : ndarray (d,)
        How far each has moved from its start, as a logarithm unless it is signed; more may follow.
    """
    for name, by in zip(names, moved, strict=False):
        if name not in SIGNED and abs(float(by)) > _AT_BOUND * FURTHEST:
            yield (
                f"the search for {name} ended at its bound, a factor {np.exp(FURTHEST):.0f} from "
                "its start: begin nearer, with another `fixed`, or see whether the data show it"
            )


def no_model(fit: float) -> Iterator[str]:
    """Yield a warning where the model explains less than a constant does."""
    if fit < 0:
        yield (
            f"the fit is {fit:.1f} %, below 0: a constant explains the output better. See the "
            "units and the calibration of the data, the model, and the parameters held fixed"
        )


def noise_warnings(step: float, found: Inference, *, has_friction: bool) -> Iterator[str]:
    """Yield a warning where the output was read in steps, or the residuals are coloured."""
    if quiet := too_quiet(step, found.noise_variance):
        yield quiet
    if found.white.coloured:
        perhaps = "" if has_friction else " (friction?)"
        yield (
            f"the residuals are {found.white}: the model leaves something of the rig out"
            f"{perhaps}, or the noise is not white; prefer std_robust"
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
