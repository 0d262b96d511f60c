"""Fisher information of physical parameters for a planned input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
from armrig_core.errors import InputError
from armrig_core.rig.arm import ArmParameters
from armrig_core.rig.calibration import THETA_1
from numpy.typing import ArrayLike

from armrig.data.dataset import Dataset, Vector
from armrig.excitation.experiment_design import PredictedStd, cr_bound, input_dataset
from armrig.numerics.checks import require_numbers
from armrig.numerics.quantities import number
from armrig.physics.grey_box.physical_models import Model, Physics
from armrig.physics.grey_box.shooting import DERIVATIVE_ERROR, Shooting
from armrig.physics.systems import arm, chassis

_MAX_DESIGN_SAMPLES = 20_000  # limit for the predicted deviations: these take a second to compute
_NOISE_RAD = 2 * np.pi / 1024 / 12**0.5  # one step of a converter of 10 bit


def predicted_parameter_std(
    model: Model,
    u: ArrayLike | Dataset,
    *,
    Ts: float,
    noise_variance: float,
    free: Sequence[str] = ("J_1",),
    fixed: ArmParameters | None = None,
    output: str = THETA_1,
) -> PredictedStd:
    """Predict the standard deviations of physical parameters for a planned input.

    The function uses the method of `predicted_std`. The physical model is sampled exactly for an
    input held between samples, and the noise on the output is white. The derivatives are those of
    `greybox`. The initial state and the input offset are estimated too.

    Parameters
    ----------
    model : callable
        Function that returns a continuous-time state-space model for given ArmParameters:
        `armrig.physics.arm` or `armrig.physics.chassis`.
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

    Raises
    ------
    ValueError
        A parameter or output does not exist, or the input cannot determine all free parameters.

    Examples
    --------
    >>> import armrig
    >>> u = armrig.telegraph(1000, 0.05)
    >>> arm, free = armrig.physics.arm, ("J_1", "K_lin")
    >>> found = armrig.predicted_parameter_std(
    ...     arm, u, Ts=0.01, noise_variance=1e-5, free=free, output="alpha"
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
    planned = input_dataset(u, Ts)
    physics = Physics(model=model, fixed=p, outputs=(output,))
    physics.check()
    theta = {name: float(getattr(p, name)) for name in free}
    values = np.array([*theta.values()])
    parts = tuple(planned.signals().experiments())
    problem = Shooting.of(physics, (*theta,), asdict(p), parts).changed(std=np.ones(1))
    z = problem.from_rest(problem.coordinates.of(values.tolist()))
    Psi, slopes, _ = problem.at(z)
    eye = np.eye(values.size)
    return cr_bound(Psi / slopes, noise_variance, (*theta,), values, planned, eye, DERIVATIVE_ERROR)


def arm_deviations(u: Vector, Ts: float, *, alone: bool) -> list[str]:
    """Return texts with the predicted standard deviations of physical parameters, in percent."""
    if u.size > _MAX_DESIGN_SAMPLES:
        return []
    model, free = (chassis, ("J_1",)) if alone else (arm, ("J_1", "J_2"))
    try:
        prediction = predicted_parameter_std(
            model, u, Ts=Ts, noise_variance=_NOISE_RAD**2, free=free, fixed=ArmParameters()
        )
    except ValueError:
        return [f"nothing of {' and '.join(free)}"]
    return [
        f"{name} to ± {number(100 * std / value)} %" if std < value else f"nothing of {name}"
        for name, value, std in zip(prediction.names, prediction.theta, prediction.std, strict=True)
    ]
