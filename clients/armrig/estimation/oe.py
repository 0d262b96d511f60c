"""Output-error models: prediction-error estimate with white noise on the output."""

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
def oe(
    data: Dataset | Signals,
    *,
    nb: Any,
    nf: Any,
    nk: Any = 1,
    integrator: bool | str | Sequence[str] = False,
    offset: bool = False,
    initial: Initial = "estimate",
    stable: bool = False,
    starts: Starts = "many",
    shared: Shared = "",
) -> Fit:
    """Estimate B and F in y_i(t) = sum of B_ij(q)/F_ij(q) u_j(t) + e_i(t).

    The method minimises the output error.

    Parameters
    ----------
    data : Dataset or Signals
        N samples. A missing y removes only the equation of its own sample. Each experiment has its
        own initial state.
    nb, nf : int, array_like (ny, nu) or mapping
        Numbers of coefficients of each output and input. A mapping has keys such as
        ("alpha", "u"). nb is 0 if the input does not affect the output. With an integrator nf >= 1,
        because the root at 1 counts as one coefficient, except with a shared denominator.
    nk : int, array_like (ny, nu) or mapping, default 1
        Number of samples before u reaches y; 0 means a direct term.
    integrator : bool, str or sequence of str, default False
        Set F = (1 - q^-1) F̃, with one root at exactly 1, for all outputs or for the named outputs.
        The noise e is added to the integrated output. The level and the input offset u0 of each
        experiment are estimated too. The offset is estimated as a ramp of y.
    offset : bool, default False
        Also estimate an input offset for each experiment: a level of the output. With an integrator
        the offset is always estimated.
    initial : {"estimate", "backcast", "zero", "auto"}
        Treatment of the initial state of each experiment. With "estimate" or "backcast" the state
        is estimated by least squares. With "zero" the experiment is assumed to begin at rest, at y
        = 0, without an input offset. With "auto" the state is estimated if an F-test finds it
        significant.
    stable : bool, default False
        Move poles on the unit circle into the circle, and estimate B again. During the search all
        poles of F stay inside or on the circle.
    starts : {"many", "few"}, default "many"
        With "many" the search starts again from changed copies of the best model. In each copy one
        mode has another frequency or damping. With "few" only complex root pairs of F are changed.
        These pairs are changed only if the first searches end in different minima or the noise is
        strong. "few" needs a tenth to a half of the time of "many", but ends in a poorer minimum
        more often.
    shared : {"", "denominator"}
        With "denominator" all outputs and inputs have the same F, of order `nf`, and the inverse
        covariance matrix of e weights the outputs. For an output with an integrator, F is
        multiplied by 1 - q^-1; this root does not count in nf.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 for (b, f), with the nuisance parameters marginalised.
        `covariance_robust` is the sandwich form with an autoregressive estimate of the residuals'
        autocorrelation. With an integrator both covariances are transformed linearly from F̃ to F.
        Both matrices are then singular in the direction that would move the root at 1.
        Without a shared denominator each output is estimated separately.

    Raises
    ------
    ValueError
        An order has a wrong shape, there are too few samples for the orders, or u does not excite
        the numerator.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 7.2, 9.3 and 10.2.

    Examples
    --------
    >>> import armrig
    >>> data = armrig.example_recording().dataset("theta_1")
    >>> fit = armrig.oe(data, nb=4, nf=4, integrator=True)
    >>> fit.heading, fit.white.coloured
    ('OE(nb=4, nf=4, nk=1)', False)
    >>> fit.F.round(2)
    array([ 1.  , -3.51,  4.62, -2.7 ,  0.59])
    >>> fit.poles().values.round(2)
    array([1.  +0.j  , 0.91+0.16j, 0.91-0.16j, 0.69+0.j  ])
    """
    return estimated(
        data,
        "oe",
        {"nb": nb, "nf": nf, "nk": nk},
        integrator=integrator,
        offset=offset,
        initial=initial,
        stable=stable,
        starts=starts,
        shared=shared,
    )
