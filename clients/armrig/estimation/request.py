"""What to estimate, as one value: a command, a batch, a search and the page ask for it alike.

A field with an `Option` is an option of `armrig identify` and `armrig batch identify`, reaches the
estimator under its name, and comes back in the line after `next:`. `structure_table` says which
structures take it. `--help` reads this module, so it imports no array.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, Self, get_type_hints

import msgspec

from armrig.estimation.orders import require_sensible
from armrig.models.structure_table import EVERY, KINDS, Family, Focus, Starts, Weights

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset
    from armrig.models.fit import Fit


@dataclass(frozen=True, slots=True)
class Option:
    """What the command line says of a field."""

    help: str
    """What it does, without a period."""
    default: str = ""
    """What the estimator takes without it; "" where that need not be said."""


class Request(msgspec.Struct, frozen=True, kw_only=True):
    """A structure with its orders, and all that else is asked of its estimator."""

    structure: Family
    orders: dict[str, int | None]
    """By name, nk left out; None lets the data choose."""
    nk: int = 1
    # None, and False of a flag: not asked for.
    weights: Annotated[Weights | None, Option("Of the projection", "cva")] = None
    integrator: Annotated[bool, Option("One pole is 1 exactly")] = False
    offset: Annotated[bool, Option("Estimate the input's offset along")] = False
    stable: Annotated[bool, Option("Reflect poles that are outside the unit circle into it")] = (
        False
    )
    focus: Focus | None = None
    starts: Starts | None = None

    @property
    def asked(self) -> dict[str, Any]:
        """What is asked for besides structure, orders and nk, by name."""
        values = {name: getattr(self, name) for name in _ARGUMENTS}
        return {name: x for name, x in values.items() if x is not None and x is not False}

    def check(self, data: Dataset) -> None:
        """Refuse orders that are absurd for the data."""
        orders = {name: n for name, n in self.orders.items() if n is not None}
        samples = data.N - data.missing
        require_sensible(samples=samples, nk=self.nk, integrator=self.integrator, **orders)

    def estimated(self, data: Dataset) -> Fit:
        """Return the model of the data."""
        return estimator(self.structure)(data, **self.orders, nk=self.nk, **self.asked)

    def of_fit(self, fit: Fit) -> Self:
        """Return the request by which a model is estimated again, by the options of this one."""
        orders = dict(fit.orders)
        nk = orders.pop("nk")
        # With an integrator the offset always is estimated along.
        offset = fit.offset and not fit.integrator
        return msgspec.structs.replace(
            self, orders=orders, nk=nk, integrator=fit.integrator, offset=offset
        )

    def of_structure(self, structure: Family, orders: dict[str, int]) -> Self:
        """Return the request for another structure, without what that one does not take."""
        takes = (*EVERY, *KINDS[structure].takes)
        dropped = {name: DEFAULTS[name] for name in self.asked if name not in takes}
        return msgspec.structs.replace(self, structure=structure, orders=orders, **dropped)


_ARGUMENTS = Request.__struct_fields__[3:]
DEFAULTS: dict[str, Any] = {f.name: f.default for f in msgspec.structs.fields(Request)}
"""Of each field, NODEFAULT of structure and orders."""
_HINTS = get_type_hints(Request, include_extras=True)
OPTIONS: dict[str, tuple[Any, Option]] = {
    name: (hint.__origin__, option)
    for name, hint in _HINTS.items()
    for option in getattr(hint, "__metadata__", ())
}
"""Type and words of each field that is an option of the command line."""


def estimator(structure: str) -> Callable[..., Fit]:
    """Return the estimator of a structure."""
    module = import_module(f"armrig.estimation.{structure}")
    found: Callable[..., Fit] = getattr(module, structure)
    return found
