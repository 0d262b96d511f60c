"""ARARX: prediction-error estimate of an ARX model whose equation error is an autoregression."""

from __future__ import annotations

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.estimation.prediction_error_fit import searched
from armrig.models.fit import Fit
from armrig.models.structure import Structure
from armrig.models.structure_table import Initial, Starts
from armrig.numerics.checks import require_flags, require_integers


@takes_recordings
def ararx(
    data: Dataset,
    *,
    na: int,
    nb: int,
    nd: int,
    nk: int = 1,
    integrator: bool = False,
    offset: bool = False,
    initial: Initial = "estimate",
    stable: bool = False,
    starts: Starts = "many",
) -> Fit:
    """Estimate A, B and D in A(q) y(t) = B(q) u(t) + 1/D(q) e(t).

    Generalised least squares uses the same structure: D whitens the error of an ARX model.

    Parameters
    ----------
    data : Dataset
        N samples. After each gap in y, the initial state of the noise model is estimated again.
    na, nb, nd : int
        Numbers of coefficients a, b and d: na >= 0, nb >= 1, nd >= 0. An integrator counts as one
        coefficient a.
    nk, integrator, offset, initial, stable, starts
        As in `armax`.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 for (a, b, d). `covariance_robust` is the estimate of
        Newey and West.

    Raises
    ------
    ValueError
        There are too few samples for the orders, or u does not excite the model.

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
    require_flags(integrator=integrator)
    require_integers(na=(na, int(integrator)), nb=(nb, 1), nd=(nd, 0), nk=(nk, 0))
    structure = Structure(
        na=na - int(integrator),
        nb=nb,
        nd=nd,
        nk=nk,
        integrator="a" if integrator else "",
        offset=offset,
    )
    orders = f"na={na}, nb={nb}, nd={nd}, nk={nk}"
    return searched(
        data, structure, name="ararx", orders=orders, initial=initial, stable=stable, starts=starts
    )
