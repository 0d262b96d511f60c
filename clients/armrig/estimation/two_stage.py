"""Two-stage estimate of a plant in a closed loop, from the signal that excites the loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import ArrayLike

from armrig.data.argument import takes_data
from armrig.data.columns import reference_of
from armrig.data.dataset import Dataset, Signals
from armrig.data.merging import merge
from armrig.data.step import TWO_STAGE, Step
from armrig.estimation.orders import require_samples
from armrig.estimation.prediction_error import with_integrator
from armrig.estimation.request import estimator
from armrig.models.fit import Fit
from armrig.models.prediction import structure_of
from armrig.models.predictor import prediction_errors
from armrig.numerics.checks import require_known
from armrig.numerics.covariance import joint_score
from armrig.numerics.criteria import mdl
from armrig.numerics.least_squares import Basis, orthonormal
from armrig.numerics.polynomial import Array, apply_filter, lag_columns

StageTwo = Literal["oe", "tf", "process"]

_LENGTHS = (0, 8, 16, 32, 64, 128, 256)  # numbers of lags of r that are tried
_SAMPLES_PER_LAG = 5
_STEP = Step("u replaced by its part that r causes", TWO_STAGE)


@takes_data  # type: ignore[arg-type]  # any option may follow `data`
def two_stage(
    data: Dataset | Signals,
    r: ArrayLike | None = None,
    *,
    structure: StageTwo = "oe",
    **options: Any,
) -> Fit:
    """Estimate the plant of a closed loop from the part of u that the signal r causes.

    The first stage is the regression of u on r, r(t - 1), … and a constant. The number of lags is
    twice that of least MDL, because lags that are left out bias the plant. The second stage
    estimates the plant from the predicted u, on which the noise has no effect. The noise model need
    therefore not be right, unlike that of ARMAX or BJ. A level of y is estimated, too, unless y
    integrates or `offset` is False: the mean of slow noise would bias the plant.

    The covariance contains the errors of the first stage, and the correlation of these errors with
    the noise of y, which the controller carries into u. It is valid for noise of any colour.

    Parameters
    ----------
    data : Dataset or Signals
        N samples of u and y of one input and one output.
    r : array_like (N,), optional
        Set point, or a signal that was added to u. It must not depend on the noise. The default is
        `data.r`, the reference of a run under a control law.
    structure : {"oe", "tf", "process"}, default "oe"
        Estimator of the second stage.
    **options
        Orders and options of this estimator.

    Returns
    -------
    Fit
        The plant. Both covariances of the model are the same.

    Raises
    ------
    ValueError
        r is missing, has another size than u, is not known everywhere, or does not affect u. There
        are too few samples, or the estimator refuses an option.

    References
    ----------
    .. [1] P. M. J. Van den Hof, R. J. P. Schrama, Automatica 29 (1993) 1523-1527.
    .. [2] U. Forssell, L. Ljung, Automatica 35 (1999) 1215-1241.

    Examples
    --------
    A proportional controller follows a telegraph signal. The plant is 0.4 q^-1 / (1 - 0.8 q^-1).

    >>> import numpy as np
    >>> r, e = armrig.telegraph(2000, 0.1, 1.0, 4.0, seed=1), np.random.default_rng(1).normal
    >>> x, u, y = np.zeros((3, 2000))
    >>> for t in range(1, 2000):
    ...     x[t] = 0.8 * x[t - 1] + 0.4 * u[t - 1]
    ...     y[t] = x[t] + 0.3 * e()
    ...     u[t] = 2 * (r[t] - y[t])
    >>> data = armrig.Dataset(u=u, y=y, Ts=0.1, r=r)
    >>> fit = armrig.two_stage(data, nb=1, nf=1)
    >>> fit.theta.round(2)
    array([ 0.4, -0.8])
    """
    require_known(structure=(structure, get_args(StageTwo)))
    signals = data.signals()
    if (signals.nu, signals.ny) != (1, 1):
        raise InputError(
            f"two_stage needs one input and one output, got {signals.nu} and {signals.ny}; choose "
            "them with signals.dataset(output, input)"
        )
    data = signals.dataset()
    parts = list(data.experiments())
    reference = data.r if r is None else r
    if reference is None:
        raise InputError(
            "two_stage needs r, the set point or a signal that was added to u: these data have no "
            "reference of a control law, or a filter dropped it"
        )
    references = np.split(reference_of(reference, data.N), data.starts[1:])
    count = _count(parts, references)
    Phi = [_lags(x, count) for x in references]
    first = orthonormal(np.vstack(Phi))
    u = np.concatenate([part.u[count - 1 :] for part in parts])
    eta = first.coefficients(u)
    residuals = np.split(first.without(u), np.cumsum([len(x) for x in Phi])[:-1])
    pairs = zip(parts, Phi, strict=True)
    excited = merge([part[count - 1 :].replaced(step=_STEP, u=x @ eta) for part, x in pairs])
    integrates = options.get("integrator") or "I" in str(options.get("form", ""))
    fit = estimator(structure)(excited, **{"offset": not integrates, **options})
    P = _covariance(fit, excited, references, first, residuals)
    return replace(fit, covariance=P, covariance_robust=P, free=(), digest=data.digest)


def _lags(r: Array, count: int) -> Array:
    """Return r, r(t - 1), … and 1 from the first t at which all are known, (N - count + 1, m)."""
    return np.column_stack([lag_columns(r, range(count)), np.ones(r.size)])[count - 1 :]


def _count(parts: Sequence[Dataset], references: Sequence[Array]) -> int:
    """Return twice the number of lags of least MDL; refuse an r that does not affect u."""
    shortest = min(part.N for part in parts)
    require_samples("two_stage", needed=_LENGTHS[1] * _SAMPLES_PER_LAG, got=shortest)
    lengths = [n for n in _LENGTHS if n * _SAMPLES_PER_LAG <= shortest]
    most = lengths[-1]
    Phi = np.vstack([_lags(r, most) for r in references])
    u = np.concatenate([part.u[most - 1 :] for part in parts])
    criteria = []
    for n in lengths:
        e = orthonormal(np.delete(Phi, np.s_[n:most], axis=1)).without(u)
        criteria.append(float(mdl(max(float(e @ e), 1e-300) / u.size, n + 1, u.size)))
    best = int(np.argmin(criteria))
    if not best:
        raise InputError("r does not affect u: give the set point, or a signal that was added to u")
    return lengths[min(best + 1, len(lengths) - 1)]


def _covariance(
    fit: Fit, data: Dataset, references: Sequence[Array], first: Basis, residuals: Sequence[Array]
) -> Array:
    """Return the covariance of theta from the noise of both stages.

    With the derivatives Psi of the prediction and the effect g of the first stage on it ::

        theta - theta_0 = (Psi^T Psi)^-1 Psi^T (e_y - g (Phi^T Phi)^-1 Phi^T e_u)
    """
    errors = prediction_errors(fit, data)
    second = orthonormal(np.vstack([x.Psi[:, 0] for x in errors]))
    of_y = second.Q @ (_by_free(fit) @ second.W).T
    sampled = fit if fit.Ts else fit.to_discrete(data.Ts)
    # The effect of r before the first sample is a free response, to which Psi is orthogonal.
    B, F = sampled.B, sampled.denominator
    pairs = zip(references, errors, strict=True)
    g = np.vstack([_lags(apply_filter(B, F, r), r.size - len(x.e) + 1) for r, x in pairs])
    # A level of u is a level of y, or a ramp, which is a free response of an integrator.
    g[:, -1] = 0.0 if fit.integrator else np.sum(B) / np.sum(F)
    of_u = -first.Q @ (first.W.T @ (g.T @ of_y))
    ends = np.cumsum([len(x.e) for x in errors])[:-1]
    return joint_score(
        [*zip(np.split(of_y, ends), np.split(of_u, ends), strict=True)],
        [(x.e[:, 0], e) for x, e in zip(errors, residuals, strict=True)],
        parameters=second.rank + first.rank,
    )


def _by_free(fit: Fit) -> Array:
    """Return the derivatives of theta by the free parameters, of which a fixed root is none."""
    if fit.Ts:
        return with_integrator(structure_of(fit))
    identity = np.eye(fit.theta.size)
    return np.delete(identity, fit.slice_of("f").stop - 1, axis=1) if fit.integrator else identity
