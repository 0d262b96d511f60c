"""ARMAX models with several inputs and outputs."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from armrig.data.signals import Signals
from armrig.estimation.multivariable.orders import as_text, by_channel, by_output
from armrig.estimation.multivariable.plans import Shared, plans_of
from armrig.estimation.multivariable.search import estimated
from armrig.models.multivariable.fit import MultivariableFit


def armax(
    data: Signals,
    *,
    na: Any,
    nb: Any,
    nc: Any,
    nk: Any = 1,
    initial: Literal["estimate", "zero"] = "estimate",
    shared: Shared = "",
) -> MultivariableFit:
    """Estimate A, B and C in A_i(q) y_i(t) = sum of B_ij(q) u_j(t) + C_i(q) e_i(t).

    The roots of A are inside the unit circle.

    Parameters
    ----------
    data : Signals
        N samples of nu inputs and ny outputs. After a missing y the noise is predicted by a Kalman
        filter.
    na, nc : int, array_like (ny,) or mapping
        Numbers of coefficients of A and C of each output.
    nb, nk : int, array_like (ny, nu) or mapping
        As for `arx`.
    initial : {"estimate", "zero"}
        State at the start of each experiment: estimated, or at rest.
    shared : {"", "denominator"}
        With "denominator" all outputs have one A, and the outputs are weighted by the covariance
        of e.

    Returns
    -------
    MultivariableFit
        Without a shared denominator each output is estimated alone.

    Raises
    ------
    ValueError
        An order has a wrong shape, or the data do not determine the parameters.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.2 and 10.2.
    """
    na_ = by_output("na", na, data, least=0)
    orders = {
        "nb": by_channel("nb", nb, data, least=0),
        "nc": by_output("nc", nc, data, least=0),
        "nk": by_channel("nk", nk, data, least=0),
    }
    plans = plans_of(
        data,
        orders | {"nf": np.repeat(na_[:, None], data.nu, axis=1)},
        integrators=(False,) * data.ny,
        initial=initial,
        shared=shared,
        equation_error=True,
    )
    text = as_text(na=na_, **orders)
    return estimated(
        data, plans, name="armax", orders=text, shared=bool(shared), equation_error=True
    )
