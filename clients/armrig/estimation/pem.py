"""General prediction-error estimate, with any of the five polynomials."""

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
    """Estimate the polynomials in A(q) y(t) = B(q)/F(q) u(t) + C(q)/D(q) e(t) for given orders.

    Parameters
    ----------
    data : Dataset
        N samples. After each gap in y, the initial state of the noise model is estimated again.
    nb, na, nc, nd, nf : int
        Numbers of coefficients: nb >= 1, and the others >= 0. Combine A with F, or A with D, only
        if input and noise are known to share some poles. Otherwise the data hardly distinguish A
        from F and D.
    nk, offset, initial, stable, starts
        As in `armax`.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 for (a, b, c, d, f). `covariance_robust` is the
        estimate of Newey and West.

    Raises
    ------
    ValueError
        There are too few samples for the orders, or u does not excite the model.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.2, 7.2 and 10.2.

    Examples
    --------
    The noise of the example is white, so that d1 is 0 within two standard deviations.

    >>> import armrig
    >>> data = armrig.example_recording().dataset("alpha")
    >>> fit = armrig.pem(data, nb=3, nf=3, nd=1)
    >>> fit.names
    ('b1', 'b2', 'b3', 'd1', 'f1', 'f2', 'f3')
    >>> fit.F.round(2)
    array([ 1.  , -2.51,  2.11, -0.59])
    >>> bool(abs(fit.theta[3]) < 2 * fit.std[3])
    True
    """
    require_integers(nb=(nb, 1), na=(na, 0), nc=(nc, 0), nd=(nd, 0), nf=(nf, 0), nk=(nk, 0))
    structure = Structure(na=na, nb=nb, nc=nc, nd=nd, nf=nf, nk=nk, offset=offset)
    orders = f"na={na}, nb={nb}, nc={nc}, nd={nd}, nf={nf}, nk={nk}"
    return searched(
        data, structure, name="pem", orders=orders, initial=initial, stable=stable, starts=starts
    )
