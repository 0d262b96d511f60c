"""Checks of several signals before an estimate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from armrig_core.errors import InputError

from armrig.data.dataset import Dataset, Signals
from armrig.data.finding import EstimateFinding, warning
from armrig.models.estimate import Form
from armrig.numerics.inference import OutputQuality
from armrig.numerics.least_squares import orthonormal

_CIRCLE_TOLERANCE = 1e-6


def origin(data: Dataset | Signals) -> dict[str, Any]:
    """Return names, units, sampling time and history of the data, as fields of a fit."""
    if isinstance(data, Dataset):
        names = {"inputs": ("u",), "outputs": (data.output,)}
        names |= {"input_units": (data.input_unit,), "units": (data.unit,)}
        common = ("Ts", "source", "history", "digest")
        return names | {name: getattr(data, name) for name in common}
    return {
        "inputs": data.inputs,
        "outputs": data.outputs,
        "input_units": data.input_units,
        "units": data.units,
        "Ts": data.equidistant(),
        "source": data.source,
        "history": data.history,
        "digest": data.digest,
    }


def instability(form: Form) -> Iterator[EstimateFinding]:
    """Yield a warning if a pole is outside the unit circle."""
    largest = float(np.max(np.abs(np.linalg.eigvals(form.realised().A)), initial=0.0))
    if largest > 1 + _CIRCLE_TOLERANCE:
        yield warning(
            "unstable",
            f"a pole of modulus {largest:.4g} is outside the unit circle: simulations grow without "
            "bound",
            modulus=largest,
        )


def poor_fits(data: Signals, quality: Sequence[OutputQuality]) -> Iterator[EstimateFinding]:
    """Yield a warning for each output that the model predicts worse than a constant."""
    for name, found in zip(data.outputs, quality, strict=True):
        if found.fit_percent < 0:
            yield warning(
                "poor_fit",
                f"the model predicts {name} worse than the mean of {name} does "
                f"(fit {found.fit_percent:.2g} %): use another order, or ss",
                fit_percent=found.fit_percent,
            )


def require_informative(data: Signals) -> None:
    """Refuse constant signals, and inputs that are linear combinations of other inputs."""
    data.equidistant()
    for i, name in enumerate(data.outputs):
        y = data.y[data.valid[:, i], i]
        if np.ptp(y) == 0:
            raise InputError(
                f"{name} is always {y[0]:.4g}, so that it has no model; leave this output out, or "
                "record it again"
            )
    for j, name in enumerate(data.inputs):
        if np.ptp(data.u[:, j]) == 0:
            raise InputError(
                f"{name} is always {data.u[0, j]:.4g}, so that its effect cannot be estimated; "
                "leave this input out, or record again"
            )
    rank = orthonormal(data.u - data.u.mean(axis=0)).rank
    if rank < data.nu:
        raise InputError(
            f"the {data.nu} inputs have rank {rank}: some are copies or sums of others, so that "
            "their effects cannot be separated; leave inputs out, or record with independent "
            "inputs"
        )
