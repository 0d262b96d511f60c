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
from inspect import Parameter, Signature
from typing import TYPE_CHECKING, Annotated, Any, Self, get_type_hints

import msgspec
from armrig_core.errors import InputError

from armrig.models.structure_table import STRUCTURES, Focus, OfferedName, Starts, Weights
from armrig.numerics.quantities import plural

if TYPE_CHECKING:
    from armrig.data.dataset import Dataset, Signals
    from armrig.models.fit import Fit

SAMPLES_PER_PARAMETER = 10
"""Least number of samples per parameter that reliable standard deviations need."""
_COUNTS_INTEGRATOR = ("na", "nb", "nf")
"""Orders that are lower by one for an output that does not integrate."""


@dataclass(frozen=True, slots=True)
class Option:
    """Help of a field on the command line."""

    help: str
    """Help text without a final period."""
    default: str = ""
    """Default of the estimator as text; "" if the help does not mention a default."""
    channels: int = 1
    """Least number of channels of a model that has the option."""


class Request(msgspec.Struct, frozen=True, kw_only=True):
    """Structure of a model, its orders, and the options of its estimator.

    All outputs and inputs have the same orders. If some outputs integrate, the orders also count
    the root at 1 of these outputs. The orders na, nb and nf of the other outputs, such as alpha of
    the rig, are then lower by one.
    """

    structure: OfferedName
    orders: dict[str, int | None]
    """Orders by name, except nk; None means that the order is chosen from the data."""
    nk: int = 1
    # None, or False for a flag, means the default of the estimator.
    weights: Annotated[Weights | None, Option("Weights of the projection", "cva")] = None
    integrator: Annotated[bool | tuple[str, ...], Option("Fix one pole at 1")] = False
    """True for all outputs, or the names of the outputs that integrate."""
    offset: Annotated[bool, Option("Also estimate the offset of the input")] = False
    stable: Annotated[
        bool, Option("Move poles that are outside the unit circle inside, by reflection")
    ] = False
    focus: Focus | None = None
    starts: Starts | None = None
    shared: Annotated[bool | None, Option("One denominator for all outputs", channels=2)] = None
    noise: bool | None = None
    """False if a state-space model has no gain K of the innovations."""
    replicates: int | None = None
    """Number of replicates from which the covariance of a subspace model is computed."""
    delay: Annotated[str | None, Option('Delay from u to y, in s, or "estimate"', "0")] = None
    two_stage: Annotated[
        bool, Option("Estimate from the part of u that the recorded reference of the loop causes")
    ] = False
    """True to call `armrig.two_stage` with this structure, and with the reference in the data."""
    form: Annotated[
        str | None,
        Option(
            "Form of the process, such as P1D: number of time constants (0 to 3), dead time D, "
            "zero Z, integrator I, underdamped U"
        ),
    ] = None

    @property
    def counts(self) -> dict[str, int | None]:
        """Orders by name, with nk if the structure has it."""
        delay = {} if STRUCTURES[self.structure].continuous else {"nk": self.nk}
        return self.orders | delay

    @property
    def asked(self) -> dict[str, Any]:
        """Requested arguments by name, except structure, orders and nk."""
        values = {name: getattr(self, name) for name in _ARGUMENTS}
        return {name: x for name, x in values.items() if x != DEFAULTS[name]}

    def check(self, data: Dataset | Signals) -> None:
        """Refuse orders that are too high for the data."""
        orders = {name: n for name, n in self.orders.items() if n is not None}
        samples = data.N - data.missing // data.signals().ny
        require_sensible(samples=samples, nk=self.nk, integrator=bool(self.integrator), **orders)

    def arguments(self, data: Dataset | Signals) -> dict[str, Any]:
        """Return the arguments of the estimator; refuse an order that is too low for an output."""
        estimator_arguments: dict[str, Any] = self.counts | self.asked
        if self.shared:
            estimator_arguments["shared"] = "denominator"
        if "order" in self.orders and self.integrator:
            estimator_arguments["integrator"] = True  # one pole of the states of all outputs
        elif isinstance(self.integrator, tuple):
            for name in [x for x in _COUNTS_INTEGRATOR if x in self.orders]:
                estimator_arguments[name] = self._of_each(
                    name, estimator_arguments[name], self.integrator, data
                )
        return estimator_arguments

    def _of_each(
        self, name: str, n: int, integrating: tuple[str, ...], data: Dataset | Signals
    ) -> Any:
        """Return the order n of each output or channel, lower by one without an integrator."""
        if name in ("na", "nf") and self.shared:
            return n - 1
        inputs, outputs = data.signals().inputs, data.signals().outputs
        others = [output for output in outputs if output not in integrating]
        if others and n < 2:
            raise InputError(
                f"{name}={n} leaves no coefficient for {', '.join(others)}, because {name} also "
                f"counts the integrator of {', '.join(integrating)}; give {name} >= 2"
            )
        each = {output: n - (output in others) for output in outputs}
        if name == "na":
            return each
        return {(output, input): each[output] for output in outputs for input in inputs}

    def estimated(self, data: Dataset | Signals) -> Fit:
        """Return the model estimated from the data."""
        arguments = self.arguments(data)
        if arguments.pop("two_stage", False):
            return estimator("two_stage")(data, structure=self.structure, **arguments)
        return estimator(self.structure)(data, **arguments)

    def of_fit(self, fit: Fit) -> Self:
        """Return this request with the orders, the integrator and the offset of the model `fit`.

        The orders of several signals differ, so their request remains the same.
        """
        if (fit.ny, fit.nu) != (1, 1):
            return self
        row = STRUCTURES[self.structure]
        # With an integrator the offset is always estimated.
        offset = fit.offset and not fit.integrator
        return msgspec.structs.replace(
            self,
            orders={name: fit.orders[name] for name in row.orders},
            nk=fit.orders.get("nk", self.nk),
            integrator=fit.integrator and "form" not in row.takes,
            offset=offset,
        )

    def of_structure(self, structure: OfferedName, orders: dict[str, int]) -> Self:
        """Return this request for another structure, without options that `structure` lacks."""
        options = STRUCTURES[structure].options
        dropped = {name: DEFAULTS[name] for name in self.asked if name not in options}
        return msgspec.structs.replace(self, structure=structure, orders=orders, **dropped)


_ARGUMENTS = Request.__struct_fields__[3:]
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


def options_of(request: Request) -> str:
    """Return the options of `armrig identify` for a request."""
    asked = {name: x for name, x in request.asked.items() if name in OPTIONS}
    values = {name: x for name, x in (request.counts | asked).items() if x is not None}
    flags = {name: x is True or isinstance(x, tuple) for name, x in values.items()}
    options = [flag(name) if flags[name] else f"{flag(name)} {x}" for name, x in values.items()]
    return " ".join([f"--structure {request.structure}", *options])


def too_high(orders: str) -> InputError:
    """Return the error for orders that are too high."""
    return InputError(f"the orders are too high for these data: lower {orders}")


def estimator(structure: str) -> Callable[..., Fit]:
    """Return the estimator of a structure: the function of its name in `armrig`, or `_of_row`."""
    function: Callable[..., Fit] | None = getattr(import_module("armrig"), structure, None)
    return function or _of_row(structure)


def _of_row(structure: str) -> Callable[..., Fit]:
    """Return a search for the polynomials that the row of a structure names."""
    row = STRUCTURES[structure]
    search = import_module("armrig.estimation.prediction_error").estimated

    def estimate(data: Dataset | Signals, *, nk: Any = 1, **arguments: Any) -> Fit:
        orders = {name: arguments.pop(name) for name in row.orders} | {"nk": nk}
        fit: Fit = search(data, structure, orders, **arguments)
        return fit

    keyword = Parameter.KEYWORD_ONLY
    names = ("nk", *row.orders, *row.takes)
    parameters = [Parameter("data", Parameter.POSITIONAL_OR_KEYWORD)]
    parameters += [Parameter(name, keyword) for name in names]
    estimate.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return estimate


def require_sensible(*, samples: int, nk: int, integrator: bool = False, **orders: int) -> None:
    """Refuse a model if nk or its number of parameters is above a tenth of the measured samples."""
    asked = ", ".join(f"{name}={n}" for name, n in orders.items())
    parameters, most = sum(orders.values()) - int(integrator), samples // SAMPLES_PER_PARAMETER
    if not most:
        needed = SAMPLES_PER_PARAMETER * max(parameters, nk, 1)
        raise InputError(
            f"{plural(samples, 'sample is', 'samples are')} too few for a model: record longer, at "
            f"least {plural(needed, 'sample')} for {asked or f'nk={nk}'}"
        )
    if parameters > most:
        raise InputError(
            f"{asked}: {plural(parameters, 'parameter')} from {plural(samples, 'sample')}; at most "
            f"{plural(most, 'parameter')}, one for each {SAMPLES_PER_PARAMETER} samples: lower "
            f"{' or '.join(orders)}, or record longer"
        )
    if nk > most:
        raise InputError(
            f"nk={nk}: at most {most} for {plural(samples, 'sample')}; lower nk, or record longer"
        )
