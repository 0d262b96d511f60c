"""Four-stage instrumental variables: estimates of A and B that coloured noise does not bias."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from armrig_core.errors import InputError

from armrig.data.argument import takes_recordings
from armrig.data.dataset import Dataset
from armrig.estimation.data_faults import NO_OPTION, data_faults, require_moving_output
from armrig.estimation.fit_warnings import with_doubts
from armrig.estimation.orders import require_samples
from armrig.estimation.stability import reflection_warnings, stabilise, with_stability_warning
from armrig.models.fit import Fit
from armrig.numerics.checks import MAX_ORDER, require_integers
from armrig.numerics.criteria import fit_percent
from armrig.numerics.inference import OutputResiduals, infer
from armrig.numerics.least_squares import column_norms, orthonormal
from armrig.numerics.polynomial import Array, apply_filter, lag_columns, reflect_roots
from armrig.numerics.quantities import plural
from armrig.numerics.regressors import arx_rows, complete
from armrig.numerics.whiteness import autoregression


@takes_recordings
def iv4(data: Dataset, *, na: int, nb: int, nk: int = 1, stable: bool = False) -> Fit:
    """Estimate A and B in A(q) y(t) = B(q) u(t) + v(t), v coloured, by instrumental variables.

    The first stage is least squares. The second stage uses instruments that contain the simulated
    output of the first model. The third stage fits an autoregression L to the residuals. The fourth
    stage filters instruments and regressors by L, so that the estimate is optimal for an
    autoregressive v. The estimate is consistent in open loop. Rows with an unknown regressor are
    not used, and the filter L starts again after a gap.

    Parameters
    ----------
    data : Dataset
        N samples.
    na, nb, nk, stable
        As in `arx`, for one output.

    Returns
    -------
    Fit
        `loss` and `noise_variance` are computed from v = A y - B u, which may be coloured.
        `whiteness` is the p value of the whiteness test of L v. The classic standard deviations
        assume that L v is white. `covariance` is var(L v) (Z^T Phi)^-1 Z^T Z (Phi^T Z)^-1, with the
        filtered instruments Z. In `covariance_robust` the estimate of Newey and West replaces var(L
        v) Z^T Z.

    Raises
    ------
    ValueError
        N is too small for the orders, or u does not excite the model.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, section 15.3 and equation (15.21).
    .. [2] T. Söderström, P. Stoica, *Instrumental Variable Methods*, 1983.

    Examples
    --------
    Noise on the output biases `arx`, but not `iv4` and `oe`.

    >>> data = armrig.example_recording().dataset("alpha")
    >>> armrig.iv4(data, na=3, nb=3).A.round(2)
    array([ 1.  , -2.51,  2.11, -0.59])
    >>> armrig.oe(data, nb=3, nf=3).F.round(2)
    array([ 1.  , -2.51,  2.11, -0.59])
    >>> armrig.arx(data, na=3, nb=3).A.round(2)
    array([ 1.  , -1.66,  0.46,  0.24])
    """
    require_integers(MAX_ORDER, na=(na, 0), nb=(nb, 1), nk=(nk, 0))
    require_moving_output(data)
    orders = f"na={na}, nb={nb}, nk={nk}"
    lags = range(nk, nk + nb)
    parts = [arx_rows(part.u, part.y, na=na, lags=lags) for part in data.experiments()]
    inputs = [part.u for part in data.experiments()]
    blocks = [p.block for p in parts]  # NaN in incomplete rows
    d, y = na + nb, np.concatenate([p.y[p.usable] for p in parts])
    N = y.size
    require_samples(f"{orders} with the gaps left out", needed=2 * d + 1, got=N)
    theta, *_ = _solve([p.Phi for p in parts], blocks, orders)  # least squares
    Z = _instruments(inputs, theta, na=na, nb=nb, nk=nk)
    theta, *_ = _solve(Z, blocks, orders)
    L, _ = autoregression(_residuals(blocks, theta))

    Z = [_filter(L, z) for z in _instruments(inputs, theta, na=na, nb=nb, nk=nk)]
    prewhitened = [_filter(L, block) for block in blocks]
    theta, inverse, instruments, e = _solve(Z, prewhitened, orders)
    A = free = np.append(1.0, theta[:na])
    if stable and (A := stabilise(free)) is not free:
        theta, e = _with_given_poles(A, prewhitened)
    basis = orthonormal(instruments)
    influences = np.split(basis.Q, np.cumsum([v.size for v in e])[:-1])
    inference = infer(
        [[OutputResiduals(e=v, H=H)] for v, H in zip(e, influences, strict=True)],
        inverse @ basis.W,
        score="correlated",
        test="ljung-box",
        prewhitening=L.size - 1,
    )
    sse = sum(float(np.nansum(v**2)) for v in _residuals(blocks, theta))
    fit = Fit.of_channel(
        structure="iv4",
        A=A,
        B=np.append(np.zeros(nk), theta[na:]),
        nk=nk,
        covariance=inference.covariance,
        covariance_robust=inference.covariance_robust,
        noise_covariance=np.array([[sse / (N - d)]]),
        quality=(
            replace(inference.quality[0], loss=sse / N, N=N, fit_percent=fit_percent(y, sse)),
        ),
        Ts=data.Ts,
        findings=(*reflection_warnings(free, A), *data_faults(data, e, way_out=NO_OPTION)),
        input=data.input,
        **data.origin(),
    )
    return with_stability_warning(with_doubts(fit))


def _with_given_poles(A: Array, blocks: Sequence[Array]) -> tuple[Array, list[Array]]:
    """Return theta and residuals for a given A, with B by least squares, as u has no noise."""
    na = A.size - 1
    rows = np.vstack([block[complete(block)] for block in blocks])
    left = rows[:, -1] - rows[:, :na] @ A[1:]
    b = orthonormal(rows[:, na:-1]).coefficients(left)
    theta = np.concatenate([A[1:], b])
    return theta, _residuals(blocks, theta)


def _residuals(blocks: Sequence[Array], theta: Array) -> list[Array]:
    """Return y - Phi theta of each experiment, NaN in incomplete rows."""
    return [block[:, -1] - block[:, :-1] @ theta for block in blocks]


def _instruments(
    inputs: Sequence[Array], theta: Array, *, na: int, nb: int, nk: int
) -> list[Array]:
    """Return the regressors in which the simulated output, without noise, replaces y."""
    A, B = reflect_roots(np.append(1.0, theta[:na])), np.append(np.zeros(nk), theta[na:])
    return [
        np.hstack(
            [
                -lag_columns(apply_filter(B, A, u), range(1, na + 1)),
                lag_columns(u, range(nk, nk + nb)),
            ]
        )
        for u in inputs
    ]


def _filter(L: Array, block: Array) -> Array:
    """Return the columns filtered by L, with NaN where a value depends on an unknown value."""
    out = np.column_stack([np.convolve(x, L)[: x.size] for x in block.T])
    out[: L.size - 1] = np.nan
    return out


def _solve(
    Z: Sequence[Array], blocks: Sequence[Array], orders: str
) -> tuple[Array, Array, Array, list[Array]]:
    """Return theta with Z^T (y - Phi theta) = 0, (Q^T Phi)^-1 and Q of Z = Q R, and residuals."""
    rows = [complete(z, block) for z, block in zip(Z, blocks, strict=True)]
    basis = orthonormal(np.vstack([z[r] for z, r in zip(Z, rows, strict=True)]))
    usable_rows = np.vstack([block[r] for block, r in zip(blocks, rows, strict=True)])
    d = usable_rows.shape[1] - 1
    projected = basis.Q.T @ usable_rows
    scale = np.maximum(column_norms(projected[:, :-1]), np.finfo(float).tiny)
    if basis.rank < d or np.linalg.matrix_rank(projected[:, :-1] / scale) < d:
        raise InputError(
            f"{orders}: the data determine fewer than {plural(d, 'parameter')}; "
            "lower the orders or excite with a richer input"
        )
    inverse = np.linalg.inv(projected[:, :-1])
    theta = inverse @ projected[:, -1]
    left = zip(rows, _residuals(blocks, theta), strict=True)
    e = [np.where(r, v, np.nan) for r, v in left]
    return theta, inverse, basis.spread(np.concatenate(rows)).Q, e
