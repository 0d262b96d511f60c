"""ARMAX: the prediction-error estimate where noise and input share their poles."""

from __future__ import annotations

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.estimation.prediction_error_fit import searched
from armrig.models.fit import Fit
from armrig.models.structure import Structure
from armrig.models.structure_table import Initial, Starts
from armrig.numerics.checks import require_flags, require_integers


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
        After a gap in y the noise's past is unknown again: it is estimated anew.
    na, nb, nc : int
        Number of all a's, >= 0, of b's, >= 1, and of c's, >= 0.
    nk : int, default 1
        Samples before u reaches y; 0 is a direct term.
    integrator : bool, default False
        A = (1 - q^-1) Ã with one root at 1 exactly, so that input *and noise* integrate: the
        model of the differenced output, its input offset estimated along. Noise that does not
        integrate, such as a sensor's, is `oe` or `bj` with an integrator.
    offset : bool, default False
        Estimate the input's offset of each experiment along; with an integrator it always is.
    initial : {"estimate", "backcast", "zero", "auto"}
        Estimate what the predictor remembers of before each experiment, or take it as zero, or
        estimate it where an F-test says that it matters.
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
        `covariance` is lambda (Psi^T Psi)^-1 of (a, b, c), `covariance_robust` Newey and West's.

    Raises
    ------
    ValueError
        There are too few samples for the orders, or u does not excite the model.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.2, 7.2 and 10.2.
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
