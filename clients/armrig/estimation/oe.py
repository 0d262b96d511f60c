"""Output error: prediction-error estimate of B/F for white noise on the output."""

from __future__ import annotations

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.several_signals import accepts_signals
from armrig.estimation.prediction_error_fit import searched
from armrig.models.fit import Fit
from armrig.models.structure import Structure
from armrig.models.structure_table import Initial, Starts
from armrig.numerics.checks import require_flags, require_integers


@accepts_signals("armrig.estimation.multivariable.oe")
@takes_recordings
def oe(
    data: Dataset,
    *,
    nb: int,
    nf: int,
    nk: int = 1,
    integrator: bool = False,
    offset: bool = False,
    initial: Initial = "estimate",
    stable: bool = False,
    starts: Starts = "many",
) -> Fit:
    """Estimate B and F in y(t) = B(q)/F(q) u(t) + e(t) by minimising the output error.

    Parameters
    ----------
    data : Dataset
        N samples. A missing y removes only the equation of its own sample. Each experiment has its
        own initial state.
    nb, nf : int
        Numbers of coefficients: nb >= 1, and nf >= 0. With an integrator nf >= 1, because the root
        at 1 counts as one coefficient.
    nk : int, default 1
        Number of samples before u reaches y; 0 means a direct term.
    integrator : bool, default False
        Set F = (1 - q^-1) F̃, with one root at exactly 1. The noise e is added to the integrated
        output. The level and the input offset u0 of each experiment are estimated too. The offset
        is estimated as a ramp of y.
    offset : bool, default False
        Also estimate an input offset for each experiment. With an integrator the offset is always
        estimated.
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

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 for (b, f), with the nuisance parameters marginalised.
        `covariance_robust` is the sandwich form with an autoregressive estimate of the residuals'
        autocorrelation. With an integrator both covariances are transformed linearly from F̃ to F.
        Both matrices are then singular in the direction that would move the root at 1.

    Raises
    ------
    ValueError
        There are too few samples for the orders, or u does not excite the numerator.

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
    require_flags(integrator=integrator)
    require_integers(nb=(nb, 1), nf=(nf, int(integrator)), nk=(nk, 0))
    structure = Structure(
        nb=nb,
        nf=nf - int(integrator),
        nk=nk,
        integrator="f" if integrator else "",
        offset=offset,
    )
    orders = f"nb={nb}, nf={nf}, nk={nk}"
    return searched(
        data, structure, name="oe", orders=orders, initial=initial, stable=stable, starts=starts
    )
