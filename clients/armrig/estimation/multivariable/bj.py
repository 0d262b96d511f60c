"""Box-Jenkins models with several inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from armrig.data.signals import Signals
from armrig.estimation.multivariable.orders import as_text, by_channel, by_output
from armrig.estimation.multivariable.plans import Shared, integrating_outputs, plans_of
from armrig.estimation.multivariable.search import estimated
from armrig.models.fit import Fit


def bj(
    data: Signals,
    *,
    nb: Any,
    nc: Any,
    nd: Any,
    nf: Any,
    nk: Any = 1,
    integrator: bool | str | Sequence[str] = False,
    initial: Literal["estimate", "zero"] = "estimate",
    shared: Shared = "",
) -> Fit:
    """Estimate B, C, D and F in y_i = sum of B_ij(q)/F_ij(q) u_j + C_i(q)/D_i(q) e_i.

    Parameters
    ----------
    data : Signals
        N samples of nu inputs and ny outputs. After a missing y the noise is predicted by a Kalman
        filter.
    nb, nf, nk : int, array_like (ny, nu) or mapping
        As for `oe`.
    nc, nd : int, array_like (ny,) or mapping
        Numbers of coefficients of C and D of each output.
    integrator : bool, str or sequence of str, default False
        Names of the outputs with one root of F at exactly 1, or True for all outputs. The noise is
        added to the integrated output.
    initial : {"estimate", "zero"}
        With "estimate" the state at the start of each experiment is estimated. With "zero" each
        experiment starts at rest.
    shared : {"", "denominator"}
        With "denominator" all outputs and inputs have the same F, of order `nf`, as for `oe`.

    Returns
    -------
    Fit
        Without a shared denominator each output is estimated separately.

    Raises
    ------
    ValueError
        An order has a wrong shape, or the data do not determine the parameters.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 4.2 and 10.2.
    """
    integrators = integrating_outputs(integrator, data)
    orders = {
        "nb": by_channel("nb", nb, data, least=0),
        "nc": by_output("nc", nc, data, least=0),
        "nd": by_output("nd", nd, data, least=0),
        "nf": by_channel("nf", nf, data, least=0),
        "nk": by_channel("nk", nk, data, least=0),
    }
    plans = plans_of(data, orders, integrators=integrators, initial=initial, shared=shared)
    return estimated(data, plans, name="bj", orders=as_text(**orders), shared=bool(shared))
