"""General prediction-error estimate, with any of the five polynomials."""

from __future__ import annotations

from typing import Any

from armrig.data.argument import takes_data
from armrig.data.dataset import Dataset, Signals
from armrig.estimation.channel_orders import Shared
from armrig.estimation.prediction_error import estimated
from armrig.models.fit import Fit
from armrig.models.structure_table import Initial, Starts


@takes_data
def pem(
    data: Dataset | Signals,
    *,
    nb: Any,
    na: Any = 0,
    nc: Any = 0,
    nd: Any = 0,
    nf: Any = 0,
    nk: Any = 1,
    offset: bool = False,
    initial: Initial = "estimate",
    stable: bool = False,
    starts: Starts = "many",
    shared: Shared = "",
) -> Fit:
    """Estimate the polynomials in A_i y_i = sum of B_ij/F_ij u_j + C_i/D_i e_i for given orders.

    Parameters
    ----------
    data : Dataset or Signals
        N samples. After a missing y the noise is predicted by a Kalman filter, and the search is
        over A, too.
    nb, nf, nk : int, array_like (ny, nu) or mapping
        As in `oe`.
    na, nc, nd : int, array_like (ny,) or mapping
        Numbers of coefficients of A, C and D of each output, >= 0. Combine A with F, or A with D,
        only if input and noise are known to share some poles. Otherwise the data hardly distinguish
        A from F and D.
    offset, initial, stable, starts, shared
        As in `armax`.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 for (a, b, c, d, f). `covariance_robust` is the
        estimate of Newey and West.

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
    return estimated(
        data,
        "pem",
        {"na": na, "nb": nb, "nc": nc, "nd": nd, "nf": nf, "nk": nk},
        offset=offset,
        initial=initial,
        stable=stable,
        starts=starts,
        shared=shared,
    )
