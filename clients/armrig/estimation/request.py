"""Request for an estimate, in the form that commands, batches, searches and the dashboard use.

A field with an `Option` is an option of `armrig identify` and `armrig batch identify`. The
estimator has an argument of the same name. The option also appears in the command printed after
`next:`. `structure_table` lists the options of each structure. This module does not import numpy,
because `--help` imports it and must be fast.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, Self, cast, get_type_hints

import msgspec
from armrig_core.errors import InputError

from armrig.estimation.orders import require_sensible
from armrig.models.structure_table import (
    EVERY,
    OF_SEVERAL,
    STRUCTURES,
    CommandName,
    Focus,
    OfferedName,
    Starts,
    Weights,
)

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals
    from armrig.models.fit import Fit


@dataclass(frozen=True, slots=True)
class Option:
    """Help of a field on the command line."""

    help: str
    """Help text without a final period."""
    default: str = ""
    """Default of the estimator as text; "" if the help does not mention a default."""


class Request(msgspec.Struct, frozen=True, kw_only=True):
    """Structure of a model, its orders, and the options of its estimator."""

    structure: CommandName
    orders: dict[str, int | None]
    """Orders by name, except nk; None means that the order is chosen from the data."""
    nk: int = 1
    # None, or False for a flag, means the default of the estimator.
    weights: Annotated[Weights | None, Option("Weights of the projection", "cva")] = None
    integrator: Annotated[bool, Option("Fix one pole at 1")] = False
    offset: Annotated[bool, Option("Also estimate the offset of the input")] = False
    stable: Annotated[
        bool, Option("Move poles that are outside the unit circle inside, by reflection")
    ] = False
    focus: Focus | None = None
    starts: Starts | None = None

    # For several signals; with one output and one input these fields are None.
    integrating: tuple[str, ...] | None = None
    """Outputs with a pole at exactly 1, in place of `integrator`."""
    shared: bool | None = None
    """True if all outputs have one denominator."""
    noise: bool | None = None
    """False if a state-space model has no gain K of the innovations."""

    @property
    def asked(self) -> dict[str, Any]:
        """Requested arguments by name, except structure, orders and nk."""
        values = {name: getattr(self, name) for name in _ARGUMENTS}
        return {name: x for name, x in values.items() if x is not None and x is not False}

    def check(self, data: Dataset | Signals) -> None:
        """Refuse orders that are too high for the data."""
        orders = {name: n for name, n in self.orders.items() if n is not None}
        one = data.y.ndim == 1
        samples = data.N - data.missing if one else data.N
        integrator = self.integrator or bool(self.integrating)
        require_sensible(samples=samples, nk=self.nk, integrator=integrator, **orders)

    def arguments(self, data: Dataset | Signals) -> dict[str, Any]:
        """Return the arguments of the estimator.

        For several signals, all outputs and inputs have the same orders. If an output integrates,
        the orders also count the root at 1 of this output. The orders na, nb and nf of the outputs
        that do not integrate are then lower by one. In the rig, for example, the transfer function
        to alpha has one pole and one coefficient of B fewer than the transfer function to theta_1.

        Raises
        ------
        ValueError
            An order is too low, or an order of several signals is too high for the data.
        """
        if data.y.ndim == 1:
            return self.orders | {"nk": self.nk} | self.asked
        self.check(data)
        orders: dict[str, Any] = {name: n for name, n in self.orders.items() if n is not None}
        if self.integrating:
            for name in [x for x in _COUNTS_INTEGRATOR if x in orders]:
                orders[name] = self._without_root(name, orders[name], cast("Signals", data))
        options = self.asked | {
            "weights": self.weights or "cva",
            "integrator": self.integrating or (),
            "shared": "denominator" if self.shared else "",
            "noise": self.noise is not False,
        }
        takes = OF_SEVERAL[self.structure].takes_several or ()
        return orders | {"nk": self.nk} | {name: x for name, x in options.items() if name in takes}

    def _without_root(self, name: str, n: int, data: Signals) -> Any:
        """Return the order n for each channel, lowered by one if the output has no integrator."""
        if name in _DENOMINATORS and self.shared:
            return n - 1
        integrating = self.integrating or ()
        others = [output for output in data.outputs if output not in integrating]
        if others and n < 2:
            raise InputError(
                f"{name}={n} leaves no coefficient for {', '.join(others)}, because {name} also "
                f"counts the integrator of {', '.join(integrating)}; give {name} >= 2"
            )
        each = {output: n - (output in others) for output in data.outputs}
        if name == "na":
            return each
        return {(output, input): each[output] for output in data.outputs for input in data.inputs}

    def estimated(self, data: Dataset | Signals) -> Fit:
        """Return the model estimated from the data."""
        return estimator(self.structure)(data, **self.arguments(data))

    def of_fit(self, fit: Fit) -> Self:
        """Return this request with the orders, the integrator and the offset of the model `fit`."""
        orders = dict(fit.orders)
        nk = orders.pop("nk")
        # With an integrator the offset is always estimated.
        offset = fit.offset and not fit.integrator
        return msgspec.structs.replace(
            self, orders=orders, nk=nk, integrator=fit.integrator, offset=offset
        )

    def of_structure(self, structure: OfferedName, orders: dict[str, int]) -> Self:
        """Return this request for another structure, without options that `structure` lacks."""
        takes = (*EVERY, *STRUCTURES[structure].takes)
        dropped = {name: DEFAULTS[name] for name in self.asked if name not in takes}
        return msgspec.structs.replace(self, structure=structure, orders=orders, **dropped)


_ARGUMENTS = tuple(
    name for name in Request.__struct_fields__[3:] if name not in ("integrating", "shared", "noise")
)
_COUNTS_INTEGRATOR = ("na", "nb", "nf")
"""Orders that are lower by one for an output that does not integrate."""
_DENOMINATORS = ("na", "nf")
"""Orders of the denominators."""
DEFAULTS: dict[str, Any] = {f.name: f.default for f in msgspec.structs.fields(Request)}
"""Default of each field; NODEFAULT for structure and orders."""
_HINTS = get_type_hints(Request, include_extras=True)
OPTIONS: dict[str, tuple[Any, Option]] = {
    name: (hint.__origin__, option)
    for name, hint in _HINTS.items()
    for option in getattr(hint, "__metadata__", ())
}
"""Type and help of each field that is an option of the command line."""


def flag(name: str) -> str:
    """Return the name of an order or option on the command line, such as ``--initial``."""
    return f"--{name.replace('_', '-')}"


def estimator(structure: str) -> Callable[..., Fit]:
    """Return the estimator of a structure."""
    module = import_module(f"armrig.estimation.{structure}")
    found: Callable[..., Fit] = getattr(module, structure)
    return found
