"""ARARX: prediction-error estimate of an ARX model whose equation error is an autoregression."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from armrig.data.argument import takes_data
from armrig.data.dataset import Dataset, Signals
from armrig.estimation.channel_orders import Shared
from armrig.estimation.prediction_error import estimated
from armrig.models.fit import Fit
from armrig.models.structure_table import Initial, Starts


@takes_data
def ararx(
    data: Dataset | Signals,
    *,
    na: Any,
    nb: Any,
    nd: Any,
    nk: Any = 1,
    integrator: bool | str | Sequence[str] = False,
    offset: bool = False,
    initial: Initial = "estimate",
    stable: bool = False,
    starts: Starts = "many",
    shared: Shared = "",
) -> Fit:
    """Estimate A, B and D in A_i(q) y_i(t) = sum of B_ij(q) u_j(t) + 1/D_i(q) e_i(t).

    Generalised least squares uses the same structure: D whitens the error of an ARX model.

    Parameters
    ----------
    data : Dataset or Signals
        N samples. After a missing y the noise is predicted by a Kalman filter, and the search is
        over A, too.
    na, nd : int, array_like (ny,) or mapping
        Numbers of coefficients a and d of each output, >= 0. An integrator counts as one
        coefficient a, except with a shared denominator.
    nb, nk, integrator, offset, initial, stable, starts, shared
        As in `armax`.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 for (a, b, d). `covariance_robust` is the estimate of
        Newey and West. Without a shared denominator each output is estimated
        separately.

    Raises
    ------
    ValueError
        An order has a wrong shape, there are too few samples for the orders, or u does not excite
        the model.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 4.2.

    Examples
    --------
    D whitens the noise. Without D the noise biases A.

    >>> import armrig
    >>> data = armrig.example_recording().dataset("alpha")
    >>> armrig.ararx(data, na=3, nb=3, nd=10).A.round(1)
    array([ 1. , -2.5,  2.1, -0.6])
    >>> armrig.arx(data, na=3, nb=3).A.round(1)
    array([ 1. , -1.7,  0.5,  0.2])
    """
    return estimated(
        data,
        "ararx",
        {"na": na, "nb": nb, "nd": nd, "nk": nk},
        integrator=integrator,
        offset=offset,
        initial=initial,
        stable=stable,
        starts=starts,
        shared=shared,
    )
