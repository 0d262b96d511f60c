"""The structures that a person can ask for: their options, and the model that comes of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from armrig.models.structure_table import FAMILIES, KINDS, Family, with_article
from armrig.numerics.quantities import listed

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.models.fit import Fit

Structure = Family
Weights = Literal["cva", "moesp", "n4sid"]

_KINDS = {name: KINDS[name] for name in FAMILIES}
_WITH_OFFSET = [name for name, kind in _KINDS.items() if kind.may_offset]


def _option(name: str, what: str, default: str) -> Any:
    used = ", ".join(s.upper() for s, kind in _KINDS.items() if name in kind.orders)
    return typer.Option(f"--{name}", help=f"Number of {what} ({used}).", show_default=default)


StructureOrNone = Annotated[
    Structure | None, typer.Option("--structure", help="Which model.", show_default=False)
]
# None: the option was not given. An option that does not apply is refused, not ignored.
NaOrNone = Annotated[int | None, _option("na", "a's", "4")]
NbOrNone = Annotated[int | None, _option("nb", "b's", "4")]
NcOrNone = Annotated[int | None, _option("nc", "c's", "ARMAX 4, BJ 1")]
NdOrNone = Annotated[int | None, _option("nd", "d's", "1")]
NfOrNone = Annotated[int | None, _option("nf", "f's, the integrator's included", "4")]
OrderOrNone = Annotated[int | None, _option("order", "states", "by the data")]
WeightsOrNone = Annotated[
    Weights | None,
    typer.Option("--weights", help="Of the projection (N4SID).", show_default="cva"),
]


def chosen_orders(structure: Structure, given: dict[str, int | None]) -> dict[str, int | None]:
    """Return the structure's orders; refuse those of another structure, without effect here."""
    own = _KINDS[structure].orders
    for name, value in given.items():
        if value is not None and name not in own:
            users = " or ".join(s for s, kind in _KINDS.items() if name in kind.orders)
            raise typer.BadParameter(
                f"--{name} {value} goes with --structure {users}; "
                f"{with_article(structure.upper())} model has {listed([*own, 'nk'])}"
            )
    return {**own, **{name: value for name, value in given.items() if value is not None}}


def check_integrator(structure: Structure) -> None:
    """Refuse an integrator where there is none by construction."""
    if not _KINDS[structure].may_integrate:
        able = " or ".join(name for name, kind in _KINDS.items() if kind.may_integrate)
        raise typer.BadParameter(
            f"--integrator goes with --structure {able}; "
            f"{with_article(structure.upper())} model finds its own"
        )


def check_single_estimate(
    structure: Structure | None, *, offset: bool, stable: bool, search: bool
) -> None:
    """Refuse options that a search, or another structure, would do nothing with."""
    if search and stable:
        raise typer.BadParameter("--stable does not go with --search, whose models always are")
    if offset and structure is not None and structure not in _WITH_OFFSET:
        msg = f"--offset goes with --structure {' or '.join(_WITH_OFFSET)}; take the means off, "
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
