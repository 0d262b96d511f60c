"""ARX models with several inputs and outputs, by generalised least squares."""

from __future__ import annotations

from typing import Any

import numpy as np
from armrig_core.errors import InputError

from armrig.data.signals import Signals
from armrig.estimation.multivariable.data_checks import instability, origin, require_informative
from armrig.estimation.multivariable.orders import as_text, by_channel, by_pair
from armrig.estimation.multivariable.whitening import spread, spread_apart, unspread, whitening
from armrig.estimation.orders import require_samples
from armrig.models.fit import Fit
from armrig.models.polynomials import Polynomials
from armrig.numerics.covariance import pairwise_covariance
from armrig.numerics.inference import OutputResiduals, infer
from armrig.numerics.least_squares import orthonormal
from armrig.numerics.polynomial import Array
from armrig.numerics.regressors import complete, past

_MAX_ROUNDS = 20
_SAME_TOLERANCE = 1e-8  # relative change of Lambda at which the iteration ends


def arx(data: Signals, *, na: Any, nb: Any, nk: Any = 1) -> Fit:
    """Estimate A and B in A(q) y(t) = B(q) u(t) + e(t) with full matrices of polynomials.

    The equations of the outputs are seemingly unrelated regressions, weighted by the inverse of
    Lambda, the covariance of e. The parameters are estimated for a given Lambda, and Lambda is
    estimated from the residuals. These two steps are repeated until Lambda hardly changes. If all
    outputs have the same regressors, the weights have no effect. Rows that contain a missing y are
    not used.

    Parameters
    ----------
    data : Signals
        N samples of nu inputs and ny outputs.
    na : int, array_like (ny, ny) or mapping
        Number of a's for each pair of outputs, >= 0: na[i][k] past values of output k affect
        output i. A mapping has keys such as ("alpha", "theta_1").
    nb : int, array_like (ny, nu) or mapping
        Number of b's for each output and input, >= 0; 0 if the input does not affect the output.
    nk : int, array_like (ny, nu) or mapping, default 1
        Number of samples before each input reaches each output; 0 means a direct term.

    Returns
    -------
    Fit
        `covariance` is the inverse of the sum of Phi^T inv(Lambda) Phi. `covariance_robust` is the
        estimate of Newey and West.

    Raises
    ------
    ValueError
        An order has a wrong shape, or the data do not determine the parameters.

    References
    ----------
    .. [1] A. Zellner, J. American Statistical Association 57 (1962) 348-368.
    .. [2] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.2 and 7.3.
    """
    na_, nb_ = by_pair("na", na, data, least=0), by_channel("nb", nb, data, least=0)
    nk_ = by_channel("nk", nk, data, least=0)
    orders = as_text(na=na_, nb=nb_, nk=nk_)
    require_informative(data)
    parts = list(data.experiments())
    blocks = [[_regressors(part, na_[i], nb_[i], nk_[i]) for i in range(data.ny)] for part in parts]
    usable = [
        np.column_stack([complete(X, part.y[:, i]) for i, X in enumerate(of)])
        for part, of in zip(parts, blocks, strict=True)
    ]
    widths = [X.shape[1] for X in blocks[0]]
    for i, name in enumerate(data.outputs):
        got = sum(int(u[:, i].sum()) for u in usable)
        require_samples(f"{orders} for {name}", needed=widths[i] + 1, got=got)
    X = [
        [np.where(u[:, i, None], B, 0.0) for i, B in enumerate(of)]
        for u, of in zip(usable, blocks, strict=True)
    ]
    y = [np.where(u, part.y, 0.0) for u, part in zip(usable, parts, strict=True)]
    Lambda = np.diag([float(np.nanvar(data.y[:, i])) or 1.0 for i in range(data.ny)])
    for _ in range(_MAX_ROUNDS):
        G = [whitening(Lambda, u) for u in usable]
        basis = orthonormal(np.vstack([spread_apart(g, of) for g, of in zip(G, X, strict=True)]))
        if basis.rank < sum(widths):
            raise InputError(
                f"{orders}: the data determine only {basis.rank} of {sum(widths)} parameters; "
                "lower the orders or excite with richer inputs"
            )
        right = [spread(g, [v[:, None] for v in of.T])[:, 0] for g, of in zip(G, y, strict=True)]
        theta = basis.coefficients(np.concatenate(right))
        rows = np.split(theta, np.cumsum(widths)[:-1])
        e = [
            np.column_stack(
                [np.where(u[:, i], t[:, i] - B @ rows[i], np.nan) for i, B in enumerate(of)]
            )
            for u, t, of in zip(usable, y, X, strict=True)
        ]
        before, Lambda = Lambda, pairwise_covariance(np.vstack(e))
        if np.abs(Lambda - before).max() <= _SAME_TOLERANCE * np.abs(Lambda).max():
            break
    Q = np.split(basis.Q, np.cumsum([data.ny * p.N for p in parts])[:-1])
    found = infer(
        [
            [
                OutputResiduals(e=e_[:, i], y=part.y[:, i], H=h, Psi=of[i])
                for i, h in enumerate(unspread(g, Q_))
            ]
            for e_, part, of, g, Q_ in zip(e, parts, X, G, Q, strict=True)
        ],
        basis.W,
        parameters=widths,
        score="correlated",
    )
    form = _form(rows, na_, nb_, nk_)
    return Fit(
        structure="arx",
        specification=orders,
        form=form,
        findings=tuple(instability(form)),
        **found.fields(),
        **origin(data),
    )


def _regressors(part: Signals, na: Array, nb: Array, nk: Array) -> Array:
    """Return [-y_k at lags 1 … na_k, u_j at lags nk_j … nk_j + nb_j - 1], NaN if not known."""
    y = [-past(part.y[:, k], range(1, n + 1)) for k, n in enumerate(na.tolist())]
    lags = zip(nb.tolist(), nk.tolist(), strict=True)
    u = [past(part.u[:, j], range(k, k + n)) for j, (n, k) in enumerate(lags)]
    return np.hstack([*y, *u])


def _form(rows: list[Array], na: Array, nb: Array, nk: Array) -> Polynomials:
    A, B = [], []
    for i, row in enumerate(rows):
        a = np.split(row, np.cumsum([*na[i], *nb[i]])[:-1])
        A.append(tuple(np.append(float(i == k), a[k]) for k in range(len(rows))))
        b = a[len(rows) :]
        B.append(tuple(np.append(np.zeros(k), x) for k, x in zip(nk[i].tolist(), b, strict=True)))
    ones = (np.ones(1),) * len(rows)
    return Polynomials(
        A=tuple(A),
        B=tuple(B),
        C=ones,
        D=ones,
        F=((np.ones(1),) * nb.shape[1],) * len(rows),
        nk=tuple(tuple(k) for k in nk.tolist()),
        integrators=(False,) * len(rows),
    )
