"""Options of an estimation, the request that results from the options, and the estimated model."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armrig.cli.reading_options import grouped
from armrig.estimation.request import DEFAULTS, OPTIONS, Option, Request, flag
from armrig.models.structure_table import (
    COUNTED,
    OF_SEVERAL,
    OFFERED,
    OFFERED_NAMES,
    CommandName,
    OfferedName,
    users,
    with_article,
)
from armrig.numerics.quantities import listed

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.models.fit import Fit

Given = dict[str, Any]
"""Values of the estimation's options by name; None or False for options that were not given."""
_SEARCHED = ("structure", "nk", "integrator", "offset")
_NOT_SEARCHED = {"stable": "whose models are always stable"}
_NOT_WITH = {"stable": "; not with --search"}
_COUNTED_AS = {"nf": "; an integrator counts as one"}
_WAY_OUT = {
    "integrator": "{model} finds an integrator by itself",
    "offset": "subtract the means with --detrend",
    **dict.fromkeys(COUNTED, "{model} has {orders}"),
}
"""Advice to a user who gives an option that the structure does not have, by the option's name."""


def estimation_options(
    *, structure: OfferedName | None = None, nk: int | None = None, without_nk: str = ""
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that replaces the argument `given` by the options of an estimation.

    Parameters
    ----------
    structure, nk : optional
        Defaults of the options.
    without_nk : str
        Text for the default of nk in the help, if `nk` is None.
    """
    return grouped("given", _options(structure, nk, without_nk))


def _options(
    structure: OfferedName | None, nk: int | None, without_nk: str
) -> list[inspect.Parameter]:
    several = structure is None
    what = "Model structure"
    what += "; required without --search; ss is for several signals" if several else ""
    which = typer.Option("--structure", help=f"{what}.", show_default=not several)
    late = _option("nk", "Delay from u to y, in samples", without_nk)
    kinds = OfferedName if structure else CommandName | None
    others = [
        _parameter(name, kind, _choice(name, option, several=several), DEFAULTS[name])
        for name, (kind, option) in OPTIONS.items()
    ]
    return [
        _parameter("structure", kinds, which, structure),
        *(_parameter(name, int | None, _order(name, several=several)) for name in COUNTED),
        _parameter("nk", int | None if nk is None else int, late, nk),
        *others,
    ]


def _parameter(name: str, kind: Any, option: Any, default: Any = None) -> inspect.Parameter:
    annotation = Annotated[kind, option]
    keyword = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, keyword, default=default, annotation=annotation)


def _order(name: str, *, several: bool) -> Any:
    """Return the option of an order; if `several`, its help also lists several-signal models."""
    default = {OFFERED[user].title: OFFERED[user].orders[name] for user in users(name)}
    shown = {"by the data" if n is None else str(n) for n in default.values()}
    if len(shown) > 1:
        shown = {", ".join(f"{title} {n}" for title, n in default.items())}
    others = [row.title for row in OF_SEVERAL.values() if name in row.orders] if several else []
    more = _COUNTED_AS.get(name, "")
    return _option(name, f"Number of {COUNTED[name]}", shown.pop(), others, more)


def _choice(name: str, option: Option, *, several: bool) -> Any:
    """Return an option that is not an order; if `several`, its help names exceptions."""
    more = _NOT_WITH.get(name, "") if several else ""
    return _option(name, option.help, option.default, more=more)


def _option(
    name: str, what: str, default: str = "", others: Sequence[str] = (), more: str = ""
) -> Any:
    """Return an option; if only some structures have the option, its help names them."""
    titles = dict.fromkeys([*(OFFERED[user].title for user in users(name)), *others])
    which = "" if len(users(name)) == len(OFFERED_NAMES) else f" ({', '.join(titles)})"
    return typer.Option(flag(name), help=f"{what}{which}{more}.", show_default=default or True)


def requested(given: Given) -> Request:
    """Return the request from the options; refuse options that the structure does not have."""
    structure: CommandName | None = given["structure"]
    if structure is None:
        raise typer.BadParameter(
            "give --structure, such as --structure oe --integrator, or --search"
        )
    if structure not in OFFERED:
        raise typer.BadParameter(
            f"--structure {structure} is for several signals; name them, such as --signal y1,y2"
        )
    _check_taken(structure, given)
    asked = _asked(given)
    own = OFFERED[structure].orders
    orders = {name: asked.get(name, default) for name, default in own.items()}
    options = {name: value for name, value in asked.items() if name not in own}
    return Request(**(options | {"orders": orders}))


def requested_of_several(given: Given, *, integrating: Sequence[str], shared: bool) -> Request:
    """Return the request for a model of several signals from the options.

    Parameters
    ----------
    integrating : sequence of str
        Outputs that get an integrator if the options request an integrator.
    shared : bool
        True to give all outputs one denominator; the structure must allow this.
    """
    structure: CommandName | None = given["structure"]
    if structure is None:
        raise typer.BadParameter("give --structure, such as --structure ss, or --search")
    if structure not in OF_SEVERAL:
        raise typer.BadParameter(
            f"--structure {structure} has one output and one input; for several signals use "
            f"{listed([*OF_SEVERAL])}"
        )
    row = OF_SEVERAL[structure]
    takes = row.takes_several or ()
    asked = _asked(given) | ({"shared": True} if shared else {})
    for name, value in asked.items():
        if name not in ("structure", "nk", *row.orders, *takes):
            raise typer.BadParameter(
                f"{_typed(name, value)} does not go with {row.title} of several signals, which has "
                f"{listed([flag(x) for x in (*row.orders, 'nk', *takes) if x != 'noise'])}"
            )
    return Request(
        structure=structure,
        orders={name: asked.get(name, default) for name, default in row.orders.items()},
        nk=asked.get("nk", 1),
        weights=asked.get("weights"),
        offset=asked.get("offset", False),
        stable=asked.get("stable", False),
        integrating=tuple(integrating) if asked.get("integrator") else None,
        shared=shared or None,
    )


def searched_for(given: Given) -> dict[str, Any]:
    """Return the arguments that the options fix in a search; refuse options without effect."""
    asked = _asked(given)
    for name, value in asked.items():
        if name not in _SEARCHED:
            why = _NOT_SEARCHED.get(name, "which tries orders up to --max-order")
            raise typer.BadParameter(f"{_typed(name, value)} does not go with --search, {why}")
    if structure := asked.pop("structure", None):
        _check_taken(structure, given)
        asked["families"] = (structure,)
    return asked


def _asked(given: Given) -> Given:
    return {name: x for name, x in given.items() if x is not None and x is not False}


def _typed(name: str, value: Any) -> str:
    return flag(name) if value is True else f"{flag(name)} {value}"


def _check_taken(structure: OfferedName, given: Given) -> None:
    """Refuse options that the structure does not have."""
    kind = OFFERED[structure]
    for name, value in _asked(given).items():
        able = OFFERED_NAMES if name == "structure" else users(name)
        if structure not in able:
            way_out = _WAY_OUT.get(name, "").format(
                model=f"{with_article(kind.title)} model", orders=listed([*kind.orders, "nk"])
            )
            raise typer.BadParameter(
                f"{_typed(name, value)} goes with --structure {' or '.join(able)}"
                + (f"; {way_out}" if way_out else "")
            )


def estimated(data: Dataset, request: Request) -> Fit:
    """Return the estimated model; refuse orders that are too high for the data."""
    import numpy as np

    from armrig.cli.spinner import estimating, too_high

    request.check(data)
    named = listed([*request.orders])
    with estimating(named):
        fit = request.estimated(data)
    if not (np.isfinite(fit.theta).all() and np.isfinite(fit.loss)):
        raise too_high(named)
    return fit
