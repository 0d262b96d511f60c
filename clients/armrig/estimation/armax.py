"""ARMAX: prediction-error estimate of a model with the same poles for the input and the noise."""

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
def armax(
    data: Dataset | Signals,
    *,
    na: Any,
    nb: Any,
    nc: Any,
    nk: Any = 1,
    integrator: bool | str | Sequence[str] = False,
    offset: bool = False,
    initial: Initial = "estimate",
    stable: bool = False,
    starts: Starts = "many",
    shared: Shared = "",
) -> Fit:
    """Estimate A, B and C in A_i(q) y_i(t) = sum of B_ij(q) u_j(t) + C_i(q) e_i(t).

    Parameters
    ----------
    data : Dataset or Signals
        N samples. After a missing y the noise is predicted by a Kalman filter, and the search is
        over A, too.
    na, nc : int, array_like (ny,) or mapping
        Numbers of coefficients a and c of each output, >= 0. An integrator counts as one
        coefficient a, except with a shared denominator.
    nb : int, array_like (ny, nu) or mapping
        Number of coefficients b of each output and input; 0 if the input does not affect the
        output. A mapping has keys such as ("alpha", "u").
    nk : int, array_like (ny, nu) or mapping, default 1
        Number of samples before u reaches y; 0 means a direct term.
    integrator : bool, str or sequence of str, default False
        For all outputs or the named outputs, set A = (1 - q^-1) Ã, with one root at exactly 1, so
        that input *and noise* are integrated. The model then describes the differenced output, with
        an estimated input offset. For noise that is not integrated, such as sensor noise, use `oe`
        or `bj` with an integrator.
    offset : bool, default False
        Also estimate an input offset for each experiment: a level of A y. With an integrator the
        offset is always estimated.
    initial : {"estimate", "backcast", "zero", "auto"}
        Treatment of the unknown past (the signals before the first sample) of each experiment. With
        "estimate" or "backcast" the past is estimated by least squares. With "zero" the past is
        assumed zero. With "auto" the past is estimated if an F-test finds it significant.
    stable : bool, default False
        Reflect poles outside the unit circle into the circle, and estimate B again. A finding of
        the fit reports the reflection.
    starts : {"many", "few"}, default "many"
        With "many" the search starts again from changed copies of the best model. In each copy one
        mode has another frequency or damping. With "few" only complex root pairs of F (if the model
        has an F) are changed. These pairs are changed only if the first searches end in different
        minima or the noise is strong. "few" needs a tenth to a half of the time of "many", but ends
        in a poorer minimum more often.
    shared : {"", "denominator"}
        With "denominator" all outputs have the same A, and the inverse covariance matrix of e
        weights the outputs. For an output with an integrator, A is multiplied by 1 - q^-1; this
        root does not count in na.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 for (a, b, c). `covariance_robust` is the estimate of
        Newey and West. Without a shared denominator each output is estimated
        separately.

    Raises
    ------
    ValueError
        An order has a wrong shape, there are too few samples for the orders, or u does not excite
        the model.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.2, 7.2 and 10.2.

    Examples
    --------
    The noise of the example is white noise on the output, so that C equals A.

    >>> import armrig
    >>> data = armrig.example_recording().dataset("alpha")
    >>> fit = armrig.armax(data, na=3, nb=3, nc=3)
    >>> fit.A.round(1)
    array([ 1. , -2.5,  2.1, -0.6])
    >>> fit.C.round(1)
    array([ 1. , -2.5,  2.1, -0.6])
    """
    return estimated(
        data,
        "armax",
        {"na": na, "nb": nb, "nc": nc, "nk": nk},
        integrator=integrator,
        offset=offset,
        initial=initial,
        stable=stable,
        starts=starts,
        shared=shared,
    )
