"""Table of the structures that can be estimated, with one specification for each.

The table defines the options and help of `armrig identify` and `armrig batch`, the structures of a
search, the command that the programs print after `next:`, and the table in docs/experiments.md.
This module does not import numpy, because `--help` imports it and must be fast. The estimator of
NAME is the function NAME of `armrig`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Literal, get_args

OfferedName = Literal["arx", "armax", "oe", "bj", "iv4", "n4sid", "ararx", "ss", "tf", "process"]
"""Structures offered by the commands; `pem` is for Python only."""
OFFERED_NAMES: tuple[OfferedName, ...] = get_args(OfferedName)
StructureName = Literal[OfferedName, "pem"]

Initial = Literal["estimate", "backcast", "zero", "auto"]
Weights = Literal["cva", "moesp", "n4sid"]
Focus = Literal["prediction", "simulation"]
Starts = Literal["many", "few"]

ARM_POLES = 4
"""Number of poles of the arm, including the integrator. The number of numerator coefficients is
equal."""

COUNTED = {f"n{x}": f"coefficients {x}" for x in "abcdf"} | {"order": "states"}
COUNTED |= {"poles": "poles", "zeros": "zeros"}
"""Name of the items that an order counts, for each order except nk."""


@dataclass(frozen=True, slots=True)
class RegisteredStructure:
    """Specification of one structure."""

    name: StructureName | Literal["channel"]
    """Name of the structure and of its estimator, in small letters."""
    equation: str
    """Equation of y, without delays and levels."""
    orders: Mapping[str, int | None]
    """Default orders of models of the arm by name, without nk; None if the data or the other
    orders decide the order."""
    takes: tuple[str, ...] = ()
    """Arguments of the estimator in addition to the orders and nk."""
    _: KW_ONLY
    several: bool = True
    """True if the estimator takes several inputs and outputs."""
    closed_loop: bool = False
    """True if feedback does not bias the estimate, provided that the noise model is right."""
    searched: bool = True
    """True if a search with one input and one output includes this structure by default."""
    searched_of_several: bool = False
    """True if a search with several signals tries this structure."""
    continuous: bool = False
    """True if the model is in continuous time, without nk."""
    free_noise: bool = False
    """True if the noise may have any colour, so that the equation has v in place of e."""
    prewhitened: bool = False
    """True if the whiteness of the prewhitened residuals is tested."""
    equation_error: bool = False
    """True if e is the error of the equation of all outputs, so that noise of an output biases the
    estimate."""
    projection: bool = False
    """True if the estimator projects the data, and does not minimise the prediction errors."""
    second_stage: bool = False
    """True if the structure can be the second of two stages, which is an option of the commands."""

    @property
    def counts(self) -> tuple[str, ...]:
        """Names of the orders, with nk."""
        return tuple(self.orders) if self.continuous else (*self.orders, "nk")

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the options of the commands, except the orders."""
        return (*self.takes, *["two_stage"] * self.second_stage)

    @property
    def state_space(self) -> bool:
        """True if the model is a state space, whose coordinates are free."""
        return "order" in self.orders

    @property
    def poles(self) -> str:
        """Name of the order that is the number of poles from u to y; nb if there are no poles."""
        if self.continuous:
            return "poles"
        return next(name for name in ("order", "nf", "na", "nb") if name in self.orders)

    @property
    def title(self) -> str:
        """Name in capitals, such as OE."""
        return self.name.upper()

    def short(self, orders: Mapping[str, int]) -> str:
        """Return structure and orders in the shortest form, such as OE[4 4 1]."""
        return f"{self.title}[{' '.join(str(n) for n in orders.values())}]"


def orders_text(orders: Mapping[str, int | None]) -> str:
    """Return a text with the orders that are not None, such as nb=4, nf=4, nk=1."""
    return ", ".join(f"{name}={n}" for name, n in orders.items() if n is not None)


def with_article(title: str) -> str:
    """Return the name of a structure with its indefinite article, such as "an OE" or "a BJ"."""
    return f"{'an' if title[0] in 'AEFHILMNORSX' else 'a'} {title}"


_N = ARM_POLES
_ARX = {"na": _N, "nb": _N}
_ARARX = _ARX | {"nd": 1}
_OE = {"nb": _N, "nf": _N}
_BJ = {"nb": _N, "nc": 1, "nd": 1, "nf": _N}
_PEM = {"na": 0, "nb": _N, "nc": 0, "nd": 0, "nf": _N}
_STATES = {"order": None}
_SEARCHED = ("integrator", "offset", "initial", "stable", "starts", "shared")
_OF_N4SID = ("integrator", "weights", "horizon", "focus", "stable", "replicates", "seed")
_STABLE = ("stable",)
_OF_IV4 = {"several": False, "free_noise": True, "prewhitened": True}
_row = RegisteredStructure
_ROWS = (
    _row("arx", "A y = B u + e", _ARX, _STABLE, closed_loop=True, equation_error=True),
    _row("armax", "A y = B u + C e", _ARX | {"nc": _N}, _SEARCHED, closed_loop=True),
    _row("oe", "y = B/F u + e", _OE, _SEARCHED, searched_of_several=True, second_stage=True),
    _row("bj", "y = B/F u + C/D e", _BJ, _SEARCHED, closed_loop=True),
    _row("iv4", "A y = B u + v, v of any colour", _ARX, _STABLE, **_OF_IV4),
    _row("n4sid", "a state space", _STATES, _OF_N4SID, searched_of_several=True, projection=True),
    # IV4 and BJ cover this noise; ARARX would lengthen a search by a quarter.
    _row("ararx", "A y = B u + 1/D e", _ARARX, _SEARCHED, closed_loop=True, searched=False),
    # The searches of one channel were tested without ss.
    _row(
        "ss",
        "a state space of least prediction errors",
        _STATES,
        ("noise", "output_weights"),
        closed_loop=True,
        searched=False,
        searched_of_several=True,
    ),
    _row(
        "tf",
        "y = B(s)/F(s) u + e",
        {"poles": _N, "zeros": None},
        ("delay", "noise", "integrator", "offset"),
        several=False,
        searched=False,
        continuous=True,
        second_stage=True,
    ),
    _row(
        "process",
        "y = K/(1 + T s) u + e",
        {},
        ("form", "delay", "noise", "offset"),
        several=False,
        searched=False,
        continuous=True,
        second_stage=True,
    ),
    _row("pem", "A y = B/F u + C/D e", _PEM, _SEARCHED[1:], closed_loop=True),
)
STRUCTURES: dict[str, RegisteredStructure] = {row.name: row for row in _ROWS}
"""Specifications of all structures by name."""
CHANNEL = _row("channel", "y = B/F u + v", {"nb": None, "nf": None}, free_noise=True)
"""Specification of one channel of a model with several inputs or outputs. The noise of a channel
depends on several e, so the channel has no C and no D."""
_UNKNOWN = _row("channel", "", {})
DESCRIBED: dict[str, RegisteredStructure] = STRUCTURES | {CHANNEL.name: CHANNEL}
"""Specifications of all structures that a `Fit` may have, by name."""
OFFERED: dict[OfferedName, RegisteredStructure] = {name: STRUCTURES[name] for name in OFFERED_NAMES}
"""Specifications of the structures that the commands offer, by name."""


def row_of(structure: str) -> RegisteredStructure:
    """Return the specification of a structure, or one without orders if the name is not known."""
    return DESCRIBED.get(structure) or _UNKNOWN


def users(argument: str) -> list[OfferedName]:
    """Return the offered structures that have an order or an option of this name."""
    return [name for name, row in OFFERED.items() if argument in (*row.counts, *row.options)]
