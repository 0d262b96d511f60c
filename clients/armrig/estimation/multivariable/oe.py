"""Output-error models with several inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from armrig.data.signals import Signals
from armrig.estimation.multivariable.orders import as_text, by_channel
from armrig.estimation.multivariable.plans import Shared, integrating_outputs, plans_of
from armrig.estimation.multivariable.search import estimated
from armrig.models.fit import Fit


def oe(
    data: Signals,
    *,
    nb: Any,
    nf: Any,
    nk: Any = 1,
    integrator: bool | str | Sequence[str] = False,
    initial: Literal["estimate", "zero"] = "estimate",
    shared: Shared = "",
) -> Fit:
    """Estimate B and F in y_i(t) = sum of B_ij(q)/F_ij(q) u_j(t) + e_i(t).

    Parameters
    ----------
    data : Signals
        N samples of nu inputs and ny outputs. A missing y removes only the equation of its own
        sample.
    nb, nf : int, array_like (ny, nu) or mapping
        Numbers of coefficients for each output and input. nb is 0 if the input does not affect the
        output. The root of an integrator counts in nf, except with a shared denominator.
    nk : int, array_like (ny, nu) or mapping, default 1
        Number of samples before each input reaches each output; 0 means a direct term.
    integrator : bool, str or sequence of str, default False
        Names of the outputs with one root of F at exactly 1, or True for all outputs. Level and
        ramp of these outputs are estimated too.
    initial : {"estimate", "zero"}
        With "estimate" the state at the start of each experiment is estimated. With "zero" each
        experiment starts at rest.
    shared : {"", "denominator"}
        With "denominator" all outputs and inputs have the same F, of order `nf`, and the inverse
        covariance matrix of e weights the outputs. For an output with an integrator, F is
        multiplied by 1 - q^-1; this root does not count in nf.

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
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 7.2 and 10.2.
    """
    integrators = integrating_outputs(integrator, data)
    orders = {
        "nb": by_channel("nb", nb, data, least=0),
        "nf": by_channel("nf", nf, data, least=0),
        "nk": by_channel("nk", nk, data, least=0),
    }
    plans = plans_of(data, orders, integrators=integrators, initial=initial, shared=shared)
    return estimated(data, plans, name="oe", orders=as_text(**orders), shared=bool(shared))
