"""Box-Jenkins: prediction-error estimate of a model with separate polynomials for the noise."""

from __future__ import annotations

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.several_signals import accepts_signals
from armrig.estimation.prediction_error_fit import searched
from armrig.models.fit import Fit
from armrig.models.structure import Structure
from armrig.models.structure_table import Initial, Starts
from armrig.numerics.checks import require_flags, require_integers


@accepts_signals("armrig.estimation.multivariable.bj")
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
        N samples. The output of B/F is simulated through a gap in y. After the gap, the initial
        state of the noise model is estimated again.
    nb, nc, nd, nf : int
        Numbers of coefficients: nb >= 1, nc >= 0, nd >= 0, nf >= 0. An integrator counts as one
        coefficient f.
    nk, offset, initial, starts
        As in `armax`.
    integrator : bool, default False
        Set F = (1 - q^-1) F̃, with one root at exactly 1. The noise is added to the integrated
        output. The level and the input offset of each experiment are estimated too.
    stable : bool, default False
        Reflect poles of D that are outside the unit circle into the circle. Move poles of F that
        are on the circle into the circle. Then estimate B again. During the search all poles of F
        stay inside or on the circle.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 for (b, c, d, f). `covariance_robust` is the estimate
        of Newey and West. For nc = nd = 0 both covariances equal the covariances of `oe`.

    Raises
    ------
    ValueError
        There are too few samples for the orders, or u does not excite the numerator.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.2, 7.2 and 10.2.

    Examples
    --------
    >>> import armrig, numpy as np
    >>> from scipy.signal import lfilter
    >>> data = armrig.example_recording().dataset("alpha")
    >>> noise = lfilter([1], [1, -0.9], 0.01 * np.random.default_rng(1).standard_normal(data.N))
    >>> noisy = armrig.Dataset(u=data.u, y=data.y + noise, Ts=data.Ts)
    >>> armrig.bj(noisy, nb=3, nc=0, nd=1, nf=3).D.round(1)
    array([ 1. , -0.9])
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
