"""The general prediction-error estimate, with any of the five polynomials."""

from __future__ import annotations

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.estimation.prediction_error_fit import searched
from armrig.models.fit import Fit
from armrig.models.structure import Structure
from armrig.models.structure_table import Initial, Starts
from armrig.numerics.checks import require_integers


@takes_recordings
def pem(
    data: Dataset,
    *,
    nb: int,
    na: int = 0,
    nc: int = 0,
    nd: int = 0,
    nf: int = 0,
    nk: int = 1,
    offset: bool = False,
    initial: Initial = "estimate",
    stable: bool = False,
    starts: Starts = "many",
) -> Fit:
    """Estimate all polynomials of A(q) y(t) = B(q)/F(q) u(t) + C(q)/D(q) e(t) that are asked for.

    Parameters
    ----------
    data : Dataset
        After a gap in y the noise's past is unknown again: it is estimated anew.
    nb, na, nc, nd, nf : int
        Number of b's, >= 1, and of the others', >= 0. A and F, or A and D, together are for
        poles that are known to be shared; otherwise the data can hardly tell them apart.
    nk : int, default 1
        Samples before u reaches y; 0 is a direct term.
    offset : bool, default False
        Estimate the input's offset of each experiment along.
    initial : {"estimate", "backcast", "zero", "auto"}
        Estimate what is not known of before each experiment, or take it as zero, or estimate it
        where an F-test says that it matters.
        "backcast" is another name for "estimate": the state of least squares.
    stable : bool, default False
        Reflect poles outside the unit circle into it, and estimate B anew; the fit says so.
    starts : {"many", "few"}, default "many"
        Whether each mode of the model is tried at other places, too, or only where searches
        disagree. "few" takes a tenth to a half of the time, and ends more often in a poorer
        minimum.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 of (a, b, c, d, f), `covariance_robust` Newey and
        West's.

    Raises
    ------
    ValueError
        There are too few samples for the orders, or u does not excite the model.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.2, 7.2 and 10.2.
    """
    require_integers(nb=(nb, 1), na=(na, 0), nc=(nc, 0), nd=(nd, 0), nf=(nf, 0), nk=(nk, 0))
    structure = Structure(na=na, nb=nb, nc=nc, nd=nd, nf=nf, nk=nk, offset=offset)
    orders = f"na={na}, nb={nb}, nc={nc}, nd={nd}, nf={nf}, nk={nk}"
    return searched(
        data, structure, name="pem", orders=orders, initial=initial, stable=stable, starts=starts
    )
