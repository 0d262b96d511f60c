"""Fisher information of physical parameters for a planned input."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from armrig_core.arm import ArmParameters
from armrig_core.errors import InputError
from armrig_core.telemetry import THETA_1
from numpy.typing import ArrayLike

from armrig.data.dataset import Dataset, Vector
from armrig.excitation.experiment_design import PredictedStd, inverted, planned_data
from armrig.models.structure import free_columns
from armrig.numerics.checks import require_numbers
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array, filtered
from armrig.physics.systems import transfer

_LOG_STEP = 1e-4  # change of a parameter's logarithm: truncation error 1e-9, smaller rounding error


def predicted_parameter_std(
    model: Callable[[ArmParameters], Any],
    u: ArrayLike | Dataset,
    *,
    Ts: float,
    noise_variance: float,
    free: Sequence[str] = ("J_1",),
    fixed: ArmParameters | None = None,
    output: str = THETA_1,
    initial: Literal["estimate", "zero"] = "estimate",
) -> PredictedStd:
    """Predict the standard deviations of physical parameters for a planned input.

    The function uses the method of `predicted_std`. The physical model is sampled exactly for an
    input held between samples, and the noise on the output is white. Derivatives are central
    differences with respect to the logarithms of the parameters.

    Parameters
    ----------
    model : callable
        Function that returns a continuous-time state-space model for given ArmParameters:
        `armrig.arm` or `armrig.chassis`.
    u : array_like, shape (N,), or Dataset
        Planned input, in V.
    Ts : float
        Sampling time, in s.
    noise_variance : float
        Variance of the noise on the output, in rad².
    free : sequence of str
        Names of the estimated parameters; all other parameters are known.
    fixed : ArmParameters, optional
        Values of all parameters; by default the values of the handout.
    output : str, default "theta_1"
        Measured output of the model.
    initial : {"estimate", "zero"}
        With "estimate" the initial state and the input offset are estimated too; with "zero" both
        are assumed to be known.

    Raises
    ------
    ValueError
        A parameter or output does not exist, or the input cannot determine all free parameters.

    Examples
    --------
    >>> import armrig
    >>> u = armrig.telegraph(1000, 0.05)
    >>> found = armrig.predicted_parameter_std(
    ...     armrig.arm, u, Ts=0.01, noise_variance=1e-5, free=("J_1", "K_lin"), output="alpha"
    ... )
    >>> print(found)
    predicted for 1000 samples in 10 s:
      J_1 = 0.0017 ± 4.5e-06 (0.27 %)
      K_lin = 1.19 ± 0.00059 (0.05 %)
    """
    require_numbers(noise_variance=noise_variance, Ts=Ts)
    p = ArmParameters() if fixed is None else fixed
    unknown = [name for name in free if not getattr(p, name, 0.0) > 0]
    if unknown or not free:
        raise InputError(
            f"free={tuple(free)} must name parameters that are > 0; the parameters are J_1, J_2, "
            "N, K_lin, R_m, K_m and b_1"
        )
    if not noise_variance > 0:
        raise InputError(
            f"noise_variance={noise_variance!r} must be > 0, in the squared unit of the output"
        )
    planned = planned_data(u, Ts)
    rows = []
    for part in planned.experiments():
        Psi, Z = _gradient(model, p, free, part, output), np.zeros((part.N, 0))
        if initial == "estimate":
            Z = _free_part(model(p), part, output)
        rows.append(orthonormal(Z[part.valid]).without(Psi[part.valid]))
    theta = np.array([getattr(p, name) for name in free])
    return inverted(np.vstack(rows), noise_variance, tuple(free), theta, planned, np.eye(len(free)))


def _gradient(
    model: Callable[[ArmParameters], Any],
    p: ArmParameters,
    free: Sequence[str],
    part: Dataset,
    output: str,
) -> Array:
    """Return the derivatives of the output with respect to the free parameters, (N, d)."""
    columns = []
    for name in free:
        value = getattr(p, name)
        up, down = (
            _output(model(replace(p, **{name: value * np.exp(h)})), part.u, part.Ts, output)
            for h in (_LOG_STEP, -_LOG_STEP)
        )
        columns.append((up - down) / (2 * _LOG_STEP * value))
    return np.column_stack(columns)


def _free_part(system: Any, part: Dataset, output: str) -> Array:
    """Return the responses to initial states and to an offset of the input, (N, n + 1)."""
    _, F = _transfer(system, part.Ts, output)
    states = free_columns(F, part.N, count=F.size - 1, drift=False)
    return np.column_stack([states, _output(system, np.ones(part.N), part.Ts, output)])


def _transfer(system: Any, Ts: float, output: str) -> tuple[Vector, Vector]:
    """Return B and F of one output of a state-space model, sampled for a held input."""
    labels = list(system.output_labels)
    if output not in labels:
        raise InputError(f"output={output!r} is not among the outputs {', '.join(labels)}")
    i = labels.index(output)
    return transfer(np.asarray(system.A), np.asarray(system.B), np.asarray(system.C)[i], Ts)


def _output(system: Any, u: Vector, Ts: float, output: str) -> Vector:
    return filtered(*_transfer(system, Ts, output), u)
