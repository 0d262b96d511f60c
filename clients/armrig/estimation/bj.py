"""Box-Jenkins: prediction-error estimate of a model with separate polynomials for the noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from armrig.data.argument import takes_data
from armrig.data.dataset import Dataset, Signals
from armrig.estimation.channel_orders import Shared
from armrig.estimation.prediction_error import estimated
from armrig.models.fit import Fit
from armrig.models.structure_table import Initial, Starts


@takes_data
def bj(
    data: Dataset | Signals,
    *,
    nb: Any,
    nc: Any,
    nd: Any,
    nf: Any,
    nk: Any = 1,
    integrator: bool | str | Sequence[str] = False,
    offset: bool = False,
    initial: Initial = "estimate",
    stable: bool = False,
    starts: Starts = "many",
    shared: Shared = "",
) -> Fit:
    """Estimate B, F, C and D in y_i = sum of B_ij(q)/F_ij(q) u_j + C_i(q)/D_i(q) e_i.

    Parameters
    ----------
    data : Dataset or Signals
        N samples. The output of B/F is simulated through a gap in y. After a missing y the noise is
        predicted by a Kalman filter.
    nb, nf, nk : int, array_like (ny, nu) or mapping
        As in `oe`. An integrator counts as one coefficient f, except with a shared denominator.
    nc, nd : int, array_like (ny,) or mapping
        Numbers of coefficients of C and D of each output, >= 0.
    offset, initial, starts, shared
        As in `oe`.
    integrator : bool, str or sequence of str, default False
        For all outputs or the named outputs, set F = (1 - q^-1) F̃, with one root at exactly 1. The
        noise is added to the integrated output. The level and the input offset of each experiment
        are estimated too.
    stable : bool, default False
        Reflect poles of D that are outside the unit circle into the circle. Move poles of F that
        are on the circle into the circle. Then estimate B again. During the search all poles of F
        stay inside or on the circle.

    Returns
    -------
    Fit
        `covariance` is lambda (Psi^T Psi)^-1 for (b, c, d, f). `covariance_robust` is the estimate
        of Newey and West. For nc = nd = 0 both covariances equal the covariances of `oe`.
        Without a shared denominator each output is estimated separately.

    Raises
    ------
    ValueError
        An order has a wrong shape, there are too few samples for the orders, or u does not excite
        the numerator.

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
    return estimated(
        data,
        "bj",
        {"nb": nb, "nc": nc, "nd": nd, "nf": nf, "nk": nk},
        integrator=integrator,
        offset=offset,
        initial=initial,
        stable=stable,
        starts=starts,
        shared=shared,
    )
