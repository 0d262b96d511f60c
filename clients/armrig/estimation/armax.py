"""ARMAX: prediction-error estimate of a model with the same poles for the input and the noise."""

from __future__ import annotations

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.several_signals import accepts_signals
from armrig.estimation.prediction_error_fit import searched
from armrig.models.fit import Fit
from armrig.models.structure import Structure
from armrig.models.structure_table import Initial, Starts
from armrig.numerics.checks import require_flags, require_integers


@accepts_signals("armrig.estimation.multivariable.armax")
@takes_recordings
def armax(
    data: Dataset,
    *,
    na: int,
    nb: int,
    nc: int,
    nk: int = 1,
    integrator: bool = False,
    offset: bool = False,
    initial: Initial = "estimate",
    stable: bool = False,
    starts: Starts = "many",
) -> Fit:
    """Estimate A, B and C in A(q) y(t) = B(q) u(t) + C(q) e(t).

    Parameters
    ----------
    data : Dataset
        N samples. After each gap in y, the initial state of the noise model is estimated again.
    na, nb, nc : int
        Numbers of coefficients a, b and c: na >= 0, nb >= 1, nc >= 0. An integrator counts as one
        coefficient a.
    nk : int, default 1
        Number of samples before u reaches y; 0 means a direct term.
    integrator : bool, default False
        Set A = (1 - q^-1) Ã, with one root at exactly 1, so that input *and noise* are integrated.
        The model then describes the differenced output, with an estimated input offset. For noise
        that is not integrated, such as sensor noise, use `oe` or `bj` with an integrator.
    offset : bool, default False
        Also estimate an input offset for each experiment. With an integrator the offset is always
        estimated.
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

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 for (a, b, c). `covariance_robust` is the estimate of
        Newey and West.

    Raises
    ------
    ValueError
        There are too few samples for the orders, or u does not excite the model.

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
    require_flags(integrator=integrator)
    require_integers(na=(na, int(integrator)), nb=(nb, 1), nc=(nc, 0), nk=(nk, 0))
    structure = Structure(
        na=na - int(integrator),
        nb=nb,
        nc=nc,
        nk=nk,
        integrator="a" if integrator else "",
        offset=offset,
    )
    orders = f"na={na}, nb={nb}, nc={nc}, nk={nk}"
    return searched(
        data, structure, name="armax", orders=orders, initial=initial, stable=stable, starts=starts
    )
