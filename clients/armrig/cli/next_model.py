"""What to estimate after a model: the same, to be kept, or what is said above asks for another."""

from __future__ import annotations

from collections.abc import Set
from typing import TYPE_CHECKING

from msgspec.structs import replace

from armrig.estimation.request import OPTIONS, Request
from armrig.models.structure_table import KINDS

if TYPE_CHECKING:
    from armrig.models.fit import Fit

CHECK = ""
"""In place of options: `armrig check` decides."""
_LOWER = {"order", "poles"}
_CHECKED = {"feedback", "delay", "unstable"}


def options_of(request: Request) -> str:
    """Return the options by which `armrig identify` estimates what is asked for."""
    orders = {**request.orders, "nk": request.nk}
    asked = {name: x for name, x in request.asked.items() if name in OPTIONS}
    values = {name: x for name, x in (orders | asked).items() if x is not None}
    typed = [f"--{name}" if x is True else f"--{name} {x}" for name, x in values.items()]
    return " ".join([f"--structure {request.structure}", *typed])


def options_after(
    fit: Fit, request: Request, about: Set[str], *, searched: bool, detrended: bool
) -> str:
    """Return the options of `armrig identify` that do what was said of a model.

    Parameters
    ----------
    fit : Fit
        The model.
    request : Request
        What estimates it again.
    about : set of str
        What there is to act on, by the names of the findings.
    searched : bool
        A search chose the model: what its residuals still hold, another search would not mend.
    detrended : bool
        It is of data without their means.

    Returns
    -------
    str
        `options_of` the request itself where there is nothing to act on; `CHECK` where the data are
        to be tested first.
    """
    kind = KINDS[fit.structure]
    orders = fit.orders
    if "structure" in about:
        oe = request.of_structure("oe", {"nb": orders["nb"], "nf": orders[kind.poles]})
        return options_of(replace(oe, integrator=True, offset=False))
    # A level that u does not make looks like an integrator; of an angle it is not looked for.
    level = "level" in about and not fit.integrator
    asked = "integrator" in about and not level
    integrator = fit.integrator or (asked and "integrator" in kind.takes)
    offset = (fit.offset or level) and "offset" in kind.takes and not integrator
    detrend = level and not (offset or detrended)
    # One that is seen although it is off the data, or estimated along, is an order too high.
    seen = level and not detrend and offset == fit.offset
    after = replace(request, integrator=integrator, offset=offset)
    if about & _LOWER or seen or not fit.converged:
        after = replace(after, orders=_lower(fit, integrator=integrator))
    options = options_of(after) + " --detrend" * detrend + " --hampel" * ("outliers" in about)
    if options != options_of(request):
        return options
    if about & _CHECKED:
        return CHECK
    if "residuals" in about and not searched and fit.structure != "pem":
        return f"--structure {fit.structure} --search"
    return options


def _lower(fit: Fit, *, integrator: bool) -> dict[str, int]:
    """Return the orders without the poles and zeros that cancel; the noise model's stay."""
    from armrig.validation.advice.model_advice import cancelling

    many = sum(2 if pole.imag else 1 for pole, _, _ in cancelling(fit)) or 1
    least = {"nb": 1, KINDS[fit.structure].poles: 1 + integrator}
    return {
        name: max(n - many, min(n, least[name])) if name in least else n
        for name, n in fit.orders.items()
        if name != "nk"
    }
