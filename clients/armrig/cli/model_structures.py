"""The structures that a person can ask for: their options, and the model that comes of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from armrig.models.structure_table import COUNTED, OFFERED, Family, users, with_article
from armrig.numerics.quantities import listed

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.models.fit import Fit

Structure = Family
Weights = Literal["cva", "moesp", "n4sid"]


def _order(name: str) -> Any:
    """Return the option of an order; an option that does not apply is refused, not ignored."""
    default = {OFFERED[user].title: OFFERED[user].orders[name] for user in users(name)}
    shown = {"by the data" if n is None else str(n) for n in default.values()}
    if len(shown) > 1:
        shown = {", ".join(f"{title} {n}" for title, n in default.items())}
    return _option(name, f"Number of {COUNTED[name]}", show_default=shown.pop())


def _option(name: str, what: str, **more: Any) -> Any:
    """Return an option that some structures have, and say which."""
    titles = ", ".join(OFFERED[user].title for user in users(name))
    return typer.Option(f"--{name}", help=f"{what} ({titles}).", **more)


StructureOrNone = Annotated[
    Structure | None, typer.Option("--structure", help="Which model.", show_default=False)
]
# None: the option was not given.
NaOrNone = Annotated[int | None, _order("na")]
NbOrNone = Annotated[int | None, _order("nb")]
NcOrNone = Annotated[int | None, _order("nc")]
NdOrNone = Annotated[int | None, _order("nd")]
NfOrNone = Annotated[int | None, _order("nf")]
OrderOrNone = Annotated[int | None, _order("order")]
WeightsOrNone = Annotated[
    Weights | None, _option("weights", "Of the projection", show_default="cva")
]
Integrator = Annotated[bool, _option("integrator", "One pole is 1 exactly")]
Offset = Annotated[bool, _option("offset", "Estimate the input's offset along")]


def chosen_orders(structure: Structure, given: dict[str, int | None]) -> dict[str, int | None]:
    """Return the structure's orders; refuse those of another structure, without effect here."""
    own = OFFERED[structure].orders
    for name, value in given.items():
        if value is not None and name not in own:
            raise typer.BadParameter(
                f"--{name} {value} goes with --structure {' or '.join(users(name))}; "
                f"{with_article(structure.upper())} model has {listed([*own, 'nk'])}"
            )
    return {**own, **{name: value for name, value in given.items() if value is not None}}


def check_integrator(structure: Structure) -> None:
    """Refuse an integrator where there is none by construction."""
    if structure not in users("integrator"):
        raise typer.BadParameter(
            f"--integrator goes with --structure {' or '.join(users('integrator'))}; "
            f"{with_article(structure.upper())} model finds its own"
        )


def check_single_estimate(
    structure: Structure | None, *, offset: bool, stable: bool, search: bool
) -> None:
    """Refuse options that a search, or another structure, would do nothing with."""
    if search and stable:
        raise typer.BadParameter("--stable does not go with --search, whose models always are")
    if offset and structure is not None and structure not in users("offset"):
        msg = f"--offset goes with --structure {' or '.join(users('offset'))}; take the means off, "
        raise typer.BadParameter(msg + "--detrend")


def estimated(
    data: Dataset,
    structure: Structure,
    orders: dict[str, int | None],
    *,
    nk: int,
    integrator: bool,
    offset: bool = False,
    stable: bool = False,
    weights: Weights | None = None,
) -> Fit:
    """Return the model; orders that are too high for the data are refused."""
    import numpy as np

    from armrig.cli.spinner import estimating, too_high
    from armrig.estimation.estimators import ESTIMATORS
    from armrig.estimation.orders import require_sensible

    asked = {name: n for name, n in orders.items() if n is not None}
    require_sensible(samples=data.N - data.missing, nk=nk, integrator=integrator, **asked)
    asked_for = {"integrator": integrator, "offset": offset, "stable": stable}
    more: dict[str, Any] = {name: True for name, wanted in asked_for.items() if wanted}
    if weights is not None:
        more["weights"] = weights
    named = listed([*orders])
    with estimating(named):
        fit = ESTIMATORS[structure](data, **orders, nk=nk, **more)
    if not (np.isfinite(fit.theta).all() and np.isfinite(fit.loss)):
        raise too_high(named)
    return fit
