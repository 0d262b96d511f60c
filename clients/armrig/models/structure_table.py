"""Table of the structures that can be estimated, with one specification for each.

The table defines the options and help of `armrig identify` and `armrig batch`, the structures of a
search, the command that the programs print after `next:`, and the table in docs/experiments.md.
This module does not import numpy, because `--help` imports it and must be fast. The estimator of
NAME is the function NAME in `armrig.estimation.NAME`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

OfferedName = Literal["arx", "armax", "oe", "bj", "iv4", "n4sid", "ararx"]
"""Structures offered by the commands; `pem` is for Python only."""
OFFERED_NAMES: tuple[OfferedName, ...] = get_args(OfferedName)
StructureName = Literal[OfferedName, "pem"]
CommandName = Literal[OfferedName, "ss"]
"""Structures of `armrig identify`; `ss` is for several signals only."""

Initial = Literal["estimate", "backcast", "zero", "auto"]
Weights = Literal["cva", "moesp", "n4sid"]
Focus = Literal["prediction", "simulation"]
Starts = Literal["many", "few"]

ARM_POLES = 4
"""Number of poles of the arm, including the integrator. The number of numerator coefficients is
equal."""

COUNTED = {
    "na": "a's",
    "nb": "b's",
    "nc": "c's",
    "nd": "d's",
    "nf": "f's",
    "order": "states",
}
"""Name of the items that an order counts, for each order except nk."""
EVERY = ("nk", "stable")
"""Arguments of every estimator."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisteredStructure:
    """Specification of one structure."""

    name: StructureName | Literal["channel", "ss"]
    """Name of the structure and of its estimator, in small letters."""
    equation: str
    """Equation of y, without delays and levels."""
    orders: Mapping[str, int | None]
    """Default orders of models of the arm by name, without nk; None if the data decide the
    order."""
    poles: str
    """Name of the order that is the number of poles from u to y."""
    takes: tuple[str, ...] = ()
    """Arguments of the estimator in addition to the orders and `EVERY`."""
    takes_several: tuple[str, ...] | None = None
    """Arguments of the estimator of several signals in addition to the orders and nk.

    None if there is no such estimator.
    """
    closed_loop: bool = False
    """True if feedback does not bias the estimate, provided that the noise model is right."""
    searched: bool = True
    """True if a search without given structures includes this structure."""

    @property
    def title(self) -> str:
        """Name in capitals, such as OE."""
        return self.name.upper()

    def short(self, orders: Mapping[str, int]) -> str:
        """Return structure and orders in the shortest form, such as OE[4 4 1]."""
        return f"{self.title}[{' '.join(str(n) for n in orders.values())}]"

    def long(self, orders: Mapping[str, int]) -> str:
        """Return structure, and orders by their names, such as OE(nb=4, nf=4, nk=1)."""
        return f"{self.title}({named(orders)})"


def named(orders: Mapping[str, int | None]) -> str:
    """Return a text with the orders that are not None, such as nb=4, nf=4, nk=1."""
    return ", ".join(f"{name}={n}" for name, n in orders.items() if n is not None)


def with_article(title: str) -> str:
    """Return the name of a structure with its indefinite article, such as "an OE" or "a BJ"."""
    return f"{'an' if title[0] in 'AEFHILMNORSX' else 'a'} {title}"


_N = ARM_POLES
_SEARCHED = ("integrator", "offset", "initial", "starts")
_ROWS = (
    RegisteredStructure(
        name="arx",
        equation="A y = B u + e",
        orders={"na": _N, "nb": _N},
        poles="na",
        takes_several=("stable",),
        closed_loop=True,
    ),
    RegisteredStructure(
        name="armax",
        equation="A y = B u + C e",
        orders={"na": _N, "nb": _N, "nc": _N},
        poles="na",
        takes=(*_SEARCHED, "shared"),
        takes_several=(*_SEARCHED, "stable", "shared"),
        closed_loop=True,
    ),
    RegisteredStructure(
        name="oe",
        equation="y = B/F u + e",
        orders={"nb": _N, "nf": _N},
        poles="nf",
        takes=(*_SEARCHED, "shared"),
        takes_several=(*_SEARCHED, "stable", "shared"),
    ),
    RegisteredStructure(
        name="bj",
        equation="y = B/F u + C/D e",
        orders={"nb": _N, "nc": 1, "nd": 1, "nf": _N},
        poles="nf",
        takes=(*_SEARCHED, "shared"),
        takes_several=(*_SEARCHED, "stable"),
        closed_loop=True,
    ),
    RegisteredStructure(
        name="iv4",
        equation="A y = B u + v, v of any colour",
        orders={"na": _N, "nb": _N},
        poles="na",
    ),
    RegisteredStructure(
        name="n4sid",
        equation="a state space",
        orders={"order": None},
        poles="order",
        takes=("integrator", "weights", "horizon", "focus", "replicates", "seed"),
        takes_several=("weights",),
    ),
    RegisteredStructure(
        name="ararx",
        equation="A y = B u + 1/D e",
        orders={"na": _N, "nb": _N, "nd": 1},
        poles="na",
        takes=(*_SEARCHED, "shared"),
        takes_several=(*_SEARCHED, "stable"),
        closed_loop=True,
        searched=False,  # IV4 and BJ cover this noise; ARARX would lengthen a search by a quarter
    ),
    RegisteredStructure(
        name="pem",
        equation="A y = B/F u + C/D e",
        orders={"na": 0, "nb": _N, "nc": 0, "nd": 0, "nf": _N},
        poles="nf",
        takes=("offset", "initial", "starts", "shared"),
        closed_loop=True,
    ),
)
STRUCTURES: dict[str, RegisteredStructure] = {row.name: row for row in _ROWS}
"""Specifications of all structures by name."""
CHANNEL = RegisteredStructure(
    name="channel",
    equation="y = B/F u + v",
    orders={"nb": None, "nf": None},
    poles="nf",
)
"""Specification of one channel of a model with several inputs or outputs. The noise of a channel
depends on several e, so the channel has no C and no D."""
_SS = RegisteredStructure(
    name="ss",
    equation="a state space of least prediction errors",
    orders={"order": None},
    poles="order",
    takes_several=("noise",),
    closed_loop=True,
)
OF_SEVERAL: dict[str, RegisteredStructure] = {
    row.name: row for row in (*_ROWS, _SS) if row.takes_several is not None
}
"""Specifications of the structures that have an estimator of several signals."""
DESCRIBED: dict[str, RegisteredStructure] = STRUCTURES | OF_SEVERAL | {CHANNEL.name: CHANNEL}
"""Specifications of all structures that a `Fit` may have, by name."""
OFFERED: dict[OfferedName, RegisteredStructure] = {name: STRUCTURES[name] for name in OFFERED_NAMES}
"""Specifications of the structures that the commands offer, by name."""


def users(argument: str) -> list[OfferedName]:
    """Return the offered structures whose estimators have an order or argument of this name."""
    all_of = {name: (*EVERY, *row.orders, *row.takes) for name, row in OFFERED.items()}
    return [name for name, arguments in all_of.items() if argument in arguments]
