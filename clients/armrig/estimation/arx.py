"""ARX: equation-error models by linear least squares."""

from __future__ import annotations

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.data.several_signals import accepts_signals
from armrig.estimation.data_faults import NO_OPTION, data_faults, undetermined
from armrig.estimation.orders import require_samples
from armrig.estimation.stability import reflection_warnings, stabilised, with_stability_warning
from armrig.models.fit import Fit
from armrig.numerics.checks import require_integers
from armrig.numerics.inference import infer, least_squares_residuals
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.regressors import arx_rows


@accepts_signals("armrig.estimation.multivariable.arx")
@takes_recordings
def arx(data: Dataset, *, na: int, nb: int, nk: int = 1, stable: bool = False) -> Fit:
    """Estimate A and B in A(q) y(t) = B(q) u(t) + e(t) by least squares.

    The method is a QR decomposition of the scaled regressors, not the normal equations. Rows that
    contain a missing y are not used. The first max(na, nb + nk - 1) rows of each experiment are not
    used either.

    Parameters
    ----------
    data : Dataset
        N samples, N > na + nb + max(na, nb + nk - 1).
    na : int
        Number of a's, >= 0; with 0 the model is a finite impulse response.
    nb : int
        Number of b's, >= 1.
    nk : int, default 1
        Number of samples before u reaches y; 0 means a direct term.
    stable : bool, default False
        Reflect poles outside the unit circle into the circle, and estimate B again. A finding of
        the fit reports the reflection.

    Returns
    -------
    Fit
        `covariance` is lambda (Phi^T Phi)^-1. `covariance_robust` is the estimate of Newey and
        West.

    Raises
    ------
    ValueError
        N is too small for the orders, or u does not excite the model.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 7.3.

    Examples
    --------
    The noise of the example is added to the output, so that the residuals of this model are
    coloured. `oe` and `bj` describe such noise. The table "When a model does not follow the data"
    on the page of the handout lists what to try next.

    >>> import armrig
    >>> data = armrig.example_recording().dataset("alpha")
    >>> fit = armrig.arx(data, na=3, nb=3)
    >>> fit.heading
    'ARX(na=3, nb=3, nk=1)'
    >>> print(f"{fit.fit_percent:.0f} % one step ahead, residuals {fit.white}")
    94 % one step ahead, residuals coloured (p < 0.001, Ljung-Box test)
    """
    require_integers(na=(na, 0), nb=(nb, 1), nk=(nk, 0))
    orders = f"na={na}, nb={nb}, nk={nk}"
    skipped = max(na, nb + nk - 1)
    require_samples(orders, needed=na + nb + skipped + 1, got=data.N)
    lags = range(nk, nk + nb)
    parts = [arx_rows(part.u, part.y, na=na, lags=lags) for part in data.experiments()]
    usable = np.concatenate([p.usable for p in parts])
    y = np.concatenate([p.y for p in parts])[usable]
    require_samples(f"{orders} with the gaps left out", needed=na + nb + 1, got=y.size)

    basis = orthonormal(np.vstack([p.Phi for p in parts])[usable])
    if basis.rank < na + nb:
        msg = f"{orders}: the data determine only {basis.rank} of {na + nb} parameters; "
        msg += undetermined(data)
        raise InputError(msg)
    theta = basis.coefficients(y)
    A = free = np.append(1.0, theta[:na])
    if stable and (A := stabilised(free)) is not free:
        Phi = np.vstack([p.Phi for p in parts])[usable]
        b = orthonormal(Phi[:, na:]).coefficients(y - Phi[:, :na] @ A[1:])
        theta = np.concatenate([A[1:], b])
    residuals = [np.where(p.usable, p.y - p.Phi @ theta, np.nan) for p in parts]
    experiments = least_squares_residuals(residuals, basis.spread(usable), y=data.y)
    found = infer(experiments, basis.W, score="correlated")
    fit = Fit.of_channel(
        structure="arx",
        A=A,
        B=np.append(np.zeros(nk), theta[na:]),
        nk=nk,
        Ts=data.Ts,
        findings=(
            *reflection_warnings(free, A),
            *data_faults(data, residuals, way_out=NO_OPTION),
        ),
        **found.of_one_output(),
        **data.origin(),
    )
    return with_stability_warning(fit)
