"""Options of an estimation, the request that results from the options, and the estimated model."""

from __future__ import annotations

from typing import Any

import typer
from armrig_core.process.options import Group, option, parameter

import armrig
from armrig.cli.printing import estimating
from armrig.estimation.request import DEFAULTS, OPTIONS, Request, flag, too_high
from armrig.models.structure_table import (
    COUNTED,
    OFFERED,
    OFFERED_NAMES,
    OfferedName,
    users,
    with_article,
)
from armrig.numerics.quantities import join_names

Given = dict[str, Any]
"""Values of the estimation's options by name; None or False for options that were not given."""
_SEARCHED = ("structure", "nk", "integrator", "offset")
_NOT_SEARCHED = {
    "stable": "whose models are always stable",
    "two_stage": "which tries structures with a noise model in a closed loop",
}
_NOT_WITH = dict.fromkeys(_NOT_SEARCHED, "; not with --search")
_MAX_OTHERS = 3  # structures without an option that its help names
_COUNTED_AS = {"nf": "; an integrator counts as one"}
_WAY_OUT = {
    "integrator": "{model} finds an integrator by itself",
    "offset": "subtract the means with --detrend",
    "nk": "give --delay in seconds",
    "delay": "give --nk in samples",
    **dict.fromkeys(COUNTED, "{model} has {orders}"),
}
"""Advice to a user who gives an option that the structure does not have, by the option's name."""


def estimation_options(*, structure: OfferedName | None = None, default_nk: str = "1") -> Group:
    """Return the options of an estimation as a group, with the default of structure.

    `default_nk` is the text for the default of nk in the help.
    """
    searches = structure is None
    help_text = "Model structure" + "; required without --search" * searches
    which = option("--structure", f"{help_text}.", not searches)
    late = _option("nk", "Delay from u to y, in samples", default_nk)
    options = [
        parameter("structure", OfferedName | None if searches else OfferedName, which, structure),
        *(parameter(name, int | None, _order(name)) for name in COUNTED),
        parameter("nk", int | None, late),
    ]
    for name, (kind, row) in OPTIONS.items():
        if searches or row.channels == 1:
            more = _NOT_WITH.get(name, "") if searches else ""
            typed = bool if name == "integrator" else kind
            which = _option(name, row.help, row.default, more)
            options.append(parameter(name, typed, which, DEFAULTS[name]))
    return Group(options)


def _order(name: str) -> Any:
    default = {OFFERED[user].title: OFFERED[user].orders[name] for user in users(name)}
    decided = "one less than the poles" if name == "zeros" else "chosen from the data"
    default_texts = {decided if n is None else str(n) for n in default.values()}
    if len(default_texts) > 1:
        default_texts = {", ".join(f"{title} {n}" for title, n in default.items())}
    return _option(
        name, f"Number of {COUNTED[name]}", default_texts.pop(), _COUNTED_AS.get(name, "")
    )


def _option(name: str, text: str, default: str = "", more: str = "") -> Any:
    """Return an option; if only some structures have the option, its help names them."""
    titles = [OFFERED[user].title for user in users(name)]
    others = [row.title for row in OFFERED.values() if row.title not in titles]
    few = len(others) <= _MAX_OTHERS
    which = f" (not {', '.join(others)})" if few else f" ({', '.join(titles)})"
    which = which if others else ""
    return option(flag(name), f"{text}{which}{more}.", default or True)


def build_request(values: Given, ny: int = 1, nu: int = 1) -> Request:
    """Return the request for a model of ny outputs and nu inputs from the options.

    Options that the structure does not have, or does not have for these signals, are refused.
    """
    structure: OfferedName | None = values["structure"]
    if structure is None:
        raise typer.BadParameter(
            "give --structure, such as --structure oe --integrator, or --search"
        )
    asked = _active_options(values)
    _check_taken(structure, asked)
    _check_shape(structure, asked, ny, nu)
    if "form" in OFFERED[structure].takes and "form" not in asked:
        raise typer.BadParameter(f"--structure {structure} needs --form, such as --form P1D")
    default_orders = OFFERED[structure].orders
    orders = {name: asked.get(name, default) for name, default in default_orders.items()}
    options = {name: value for name, value in asked.items() if name not in default_orders}
    return Request(**(options | {"orders": orders}))


def search_arguments(values: Given, ny: int = 1, nu: int = 1) -> dict[str, Any]:
    """Return the arguments that the options fix in a search; refuse options without effect."""
    asked = _active_options(values)
    for name, value in asked.items():
        if name not in _SEARCHED:
            why = _NOT_SEARCHED.get(name, "which tries orders up to --max-order")
            raise typer.BadParameter(
                f"{_option_text(name, value)} does not go with --search, {why}"
            )
    tried = [name for name, row in OFFERED.items() if row.searched_of_several]
    structure = asked.pop("structure", None)
    if structure is not None:
        _check_taken(structure, asked)
        if OFFERED[structure].continuous:
            raise typer.BadParameter(
                f"--structure {structure}: --search tries models in discrete time, and process "
                "models that they suggest; leave out --structure or --search"
            )
        asked["families"] = (structure,)
    if (ny, nu) != (1, 1):
        if structure not in (None, *tried):
            raise typer.BadParameter(
                f"--structure {structure}: --search of several signals tries {', '.join(tried)}"
            )
        if "offset" in asked:
            raise typer.BadParameter("--offset does not go with --search of several signals")
    return asked


def option_texts(values: Given) -> list[str]:
    """Return the options that the user gave, as typed."""
    return [_option_text(name, value) for name, value in _active_options(values).items()]


def _active_options(values: Given) -> Given:
    return {name: x for name, x in values.items() if x is not None and x is not False}


def _option_text(name: str, value: Any) -> str:
    return flag(name) if value is True else f"{flag(name)} {value}"


def _check_taken(structure: OfferedName, asked: Given) -> None:
    """Refuse options that the structure does not have."""
    kind = OFFERED[structure]
    for name, value in asked.items():
        able = OFFERED_NAMES if name == "structure" else users(name)
        if structure not in able:
            of_form = "form" in kind.takes and name in (*COUNTED, "integrator")
            way_out = (
                "--form gives it"
                if of_form
                else _WAY_OUT.get(name, "").format(
                    model=f"{with_article(kind.title)} model",
                    orders=join_names([*kind.counts] or ["--form"]),
                )
            )
            raise typer.BadParameter(
                f"{_option_text(name, value)} goes with --structure {' or '.join(able)}"
                + (f"; {way_out}" if way_out else "")
            )


def _check_shape(structure: OfferedName, asked: Given, ny: int, nu: int) -> None:
    """Refuse a structure or an option that a model of ny outputs and nu inputs cannot have."""
    if (ny, nu) != (1, 1) and not OFFERED[structure].several:
        able = join_names([name for name, row in OFFERED.items() if row.several])
        raise typer.BadParameter(
            f"--structure {structure} has one output and one input; for several signals use {able}"
        )
    for name, value in asked.items():
        if name in OPTIONS and ny * nu < OPTIONS[name][1].channels:
            raise typer.BadParameter(
                f"{_option_text(name, value)} is for several outputs: name them, --signal A,B"
            )


def estimate_model(data: armrig.Dataset | armrig.Signals, request: Request) -> armrig.Fit:
    """Return the estimated model; refuse orders that are too high for the data."""
    import numpy as np

    request.check(data)
    named = join_names([*request.orders] or ["the number of time constants"])
    with estimating(named):
        fit = request.estimated(data)
    if not np.isfinite([*fit.theta, *(q.loss for q in fit.quality)]).all():
        raise too_high(named)
    return fit
