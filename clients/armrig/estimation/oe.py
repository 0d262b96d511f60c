"""Output error: the prediction-error estimate of B/F where the noise is white on the output."""

from __future__ import annotations

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.estimation.prediction_error_fit import searched
from armrig.models.fit import Fit
from armrig.models.structure import Structure
from armrig.models.structure_table import Initial, Starts
from armrig.numerics.checks import require_flags, require_integers


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
        Missing outputs only cost their own rows. Each experiment has its own initial state.
    nb, nf : int
        Number of b's, >= 1, and of all f's, >= 0.
    nk : int, default 1
        Samples before u reaches y; 0 is a direct term.
    integrator : bool, default False
        F = (1 - q^-1) F̃ with one root at 1 exactly, e white on the integrated output; level and
        input offset u0 of each experiment are estimated along (the offset as the ramp it makes).
    offset : bool, default False
        Estimate the input's offset of each experiment along; with an integrator it always is.
    initial : {"estimate", "backcast", "zero", "auto"}
        Estimate each experiment's initial state, or take the rig at rest at y = 0 (then an
        integrator has no offset either), or estimate it where an F-test says that it matters.
        "backcast" is another name for "estimate": the state of least squares.
    stable : bool, default False
        Draw poles on the unit circle into it, and estimate B anew; the search lets none pass it.
    starts : {"many", "few"}, default "many"
        Whether each mode of the model is tried at other places, too, or only where searches
        disagree. "few" takes a tenth to a half of the time, and ends more often in a poorer
        minimum.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 of (b, f) with the nuisance parameters marginalised;
        `covariance_robust` is the sandwich form with an autoregressive estimate of the
        residuals' autocorrelation. With an integrator both are carried from F̃ to F by the linear
        map between them, and so are singular in the direction that would move the root at 1.

    Raises
    ------
    ValueError
        There are too few samples for the orders, or u does not excite the numerator.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 7.2, 9.3 and 10.2.
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
