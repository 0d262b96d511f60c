"""Box-Jenkins: the prediction-error estimate with a noise model of its own."""

from __future__ import annotations

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.estimation.prediction_error_fit import searched
from armrig.models.fit import Fit
from armrig.models.structure import Structure
from armrig.models.structure_table import Initial, Starts
from armrig.numerics.checks import require_flags, require_integers


@takes_recordings
def bj(
    data: Dataset,
    *,
    nb: int,
    nc: int,
    nd: int,
    nf: int,
    nk: int = 1,
    integrator: bool = False,
    offset: bool = False,
    initial: Initial = "estimate",
    stable: bool = False,
    starts: Starts = "many",
) -> Fit:
    """Estimate B, F, C and D in y(t) = B(q)/F(q) u(t) + C(q)/D(q) e(t).

    Parameters
    ----------
    data : Dataset
        B/F runs through a gap in y; the noise's past is unknown after it and estimated anew.
    nb, nc, nd, nf : int
        Number of b's, >= 1, of c's and d's, >= 0, and of all f's, >= 0.
    nk : int, default 1
        Samples before u reaches y; 0 is a direct term.
    integrator : bool, default False
        F = (1 - q^-1) F̃ with one root at 1 exactly, the noise on the integrated output; level and
        input offset of each experiment are estimated along.
    offset : bool, default False
        Estimate the input's offset of each experiment along; with an integrator it always is.
    initial : {"estimate", "backcast", "zero", "auto"}
        Estimate what is not known of before each experiment, or take it as zero, or estimate it
        where an F-test says that it matters.
        "backcast" is another name for "estimate": the state of least squares.
    stable : bool, default False
        Reflect poles of the noise, D, outside the unit circle into it, draw those of F on it
        inside, and estimate B anew; the search lets no pole of F pass the circle.
    starts : {"many", "few"}, default "many"
        Whether each mode of the model is tried at other places, too, or only where searches
        disagree. "few" takes a tenth to a half of the time, and ends more often in a poorer
        minimum.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 of (b, c, d, f), `covariance_robust` Newey and
        West's (of an output-error model, nc = nd = 0, as `oe` gives it).

    Raises
    ------
    ValueError
        There are too few samples for the orders, or u does not excite the numerator.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.2, 7.2 and 10.2.
    """
    require_flags(integrator=integrator)
    require_integers(nb=(nb, 1), nc=(nc, 0), nd=(nd, 0), nf=(nf, int(integrator)), nk=(nk, 0))
    structure = Structure(
        nb=nb,
        nc=nc,
        nd=nd,
        nf=nf - int(integrator),
        nk=nk,
        integrator="f" if integrator else "",
        offset=offset,
    )
    orders = f"nb={nb}, nc={nc}, nd={nd}, nf={nf}, nk={nk}"
    return searched(
        data, structure, name="bj", orders=orders, initial=initial, stable=stable, starts=starts
    )
