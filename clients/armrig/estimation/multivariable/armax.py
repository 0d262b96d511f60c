"""ARMAX models with several inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from armrig_core.errors import InputError

from armrig.data.signals import Signals
from armrig.estimation.multivariable.orders import as_text, by_channel, by_output
from armrig.estimation.multivariable.plans import Shared, integrating_outputs, plans_of
from armrig.estimation.multivariable.search import estimated
from armrig.models.fit import Fit


def armax(
    data: Signals,
    *,
    na: Any,
    nb: Any,
    nc: Any,
    nk: Any = 1,
    integrator: bool | str | Sequence[str] = False,
    initial: Literal["estimate", "zero"] = "estimate",
    shared: Shared = "",
) -> Fit:
    """Estimate A, B and C in A_i(q) y_i(t) = sum of B_ij(q) u_j(t) + C_i(q) e_i(t).

    The roots of A are inside the unit circle.

    Parameters
    ----------
    data : Signals
        N samples of nu inputs and ny outputs. After a missing y the noise is predicted by a Kalman
        filter.
    na, nc : int, array_like (ny,) or mapping
        Numbers of coefficients of A and C of each output. The root of an integrator counts in na,
        except with a shared denominator.
    nb, nk : int, array_like (ny, nu) or mapping
        As for `arx`.
    integrator : bool, str or sequence of str, default False
        Names of the outputs with one root of A at exactly 1, or True for all outputs. Inputs *and
        noise* of these outputs are integrated. Level and ramp of these outputs are estimated too.
        For noise that is not integrated, such as sensor noise, use `oe` or `bj` with an integrator.
        No value of an output with an integrator may be missing.
    initial : {"estimate", "zero"}
        With "estimate" the state at the start of each experiment is estimated. With "zero" each
        experiment starts at rest.
    shared : {"", "denominator"}
        With "denominator" all outputs have the same A, and the inverse covariance matrix of e
        weights the outputs. For an output with an integrator, A is multiplied by 1 - q^-1; this
        root does not count in na.

    Returns
    -------
    Fit
        Without a shared denominator each output is estimated separately.

    Raises
    ------
    ValueError
        An order has a wrong shape, the data do not determine the parameters, or values of an
        integrating output are missing.

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
    integrators = integrating_outputs(integrator, data)
    _require_complete(data, integrators)
    plans = plans_of(
        data,
        orders | {"nf": np.repeat(na_[:, None], data.nu, axis=1)},
        integrators=integrators,
        initial=initial,
        shared=shared,
        equation_error=True,
    )
    text = as_text(na=na_, **orders)
    return estimated(
        data, plans, name="armax", orders=text, shared=bool(shared), equation_error=True
    )


def _require_complete(data: Signals, integrators: tuple[bool, ...]) -> None:
    # With 20 % of the values missing, the reported standard deviations were 1.4 to 1.7 times the
    # scatter of the estimates in 40 runs.
    for i, name in enumerate(data.outputs):
        missing = int(np.count_nonzero(~data.valid[:, i]))
        if integrators[i] and missing:
            raise InputError(
                f"{missing} values of {name} are missing, and armax with an integrator needs all "
                "of them; use oe or bj with an integrator"
            )
