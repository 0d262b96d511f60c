"""The structures that can be estimated: one specification each, from which all else follows.

The options and the help of `armrig identify` and `armrig batch`, what a search tries, the command
after `next:`, and the table in docs/experiments.md come from here. `--help` reads this module, so
it imports no array; the estimator of NAME is the function NAME in `armrig.estimation.NAME`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

Family = Literal["arx", "armax", "oe", "bj", "iv4", "n4sid", "ararx"]
"""A structure with a name of its own: what a command offers and a search tries."""
FAMILIES: tuple[Family, ...] = get_args(Family)
Name = Literal[Family, "pem"]

Initial = Literal["estimate", "backcast", "zero", "auto"]
Weights = Literal["cva", "moesp", "n4sid"]
Focus = Literal["prediction", "simulation"]
Starts = Literal["many", "few"]

ARM_POLES = 4
"""Poles of the arm, one of them an integrator; its numerator has as many coefficients."""

COUNTED = {
    "na": "a's",
    "nb": "b's",
    "nc": "c's",
    "nd": "d's",
    "nf": "f's, the integrator's included",
    "order": "states",
}
"""What each order is the number of; nk is not among them."""
EVERY = ("nk", "stable")
"""Arguments that every estimator has."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """One structure."""

    name: Name
    """As a program writes it, which is also the name of its estimator."""
    equation: str
    """What it says of y, without delays and levels."""
    orders: Mapping[str, int | None]
    """Its orders by name, nk left out, each with its default for the arm; None is by the data."""
    poles: str
    """Name of the order that counts the poles from u to y."""
    takes: tuple[str, ...] = ()
    """Arguments of its estimator besides the orders and those of `EVERY`."""
    closed_loop: bool = False
    """Feedback does not bias it, if its noise model is right."""
    searched: bool = True
    """A search for which no structures are given tries it."""

    @property
    def title(self) -> str:
        """Name for a person: OE."""
        return self.name.upper()

    def short(self, orders: Mapping[str, int]) -> str:
        """Return structure and orders in the shortest form: OE[4 4 1]."""
        return f"{self.title}[{' '.join(str(n) for n in orders.values())}]"

    def long(self, orders: Mapping[str, int]) -> str:
        """Return structure and orders by their names: OE(nb=4, nf=4, nk=1)."""
        return f"{self.title}({named(orders)})"


def named(orders: Mapping[str, int | None]) -> str:
    """Return orders by their names: nb=4, nf=4, nk=1; those that are None are left out."""
    return ", ".join(f"{name}={n}" for name, n in orders.items() if n is not None)


def with_article(title: str) -> str:
    """Return a structure's name as it is read aloud: an OE, a BJ."""
    return f"{'an' if title[0] in 'AEFHILMNORSX' else 'a'} {title}"


_N = ARM_POLES
_SEARCHED = ("integrator", "offset", "initial", "starts")
_KINDS = (
    Kind(
        name="arx",
        equation="A y = B u + e",
        orders={"na": _N, "nb": _N},
        poles="na",
        closed_loop=True,
    ),
    Kind(
        name="armax",
        equation="A y = B u + C e",
        orders={"na": _N, "nb": _N, "nc": _N},
        poles="na",
        takes=_SEARCHED,
        closed_loop=True,
    ),
    Kind(
        name="oe",
        equation="y = B/F u + e",
        orders={"nb": _N, "nf": _N},
        poles="nf",
        takes=_SEARCHED,
    ),
    Kind(
        name="bj",
        equation="y = B/F u + C/D e",
        orders={"nb": _N, "nc": 1, "nd": 1, "nf": _N},
        poles="nf",
        takes=_SEARCHED,
        closed_loop=True,
    ),
    Kind(
        name="iv4",
        equation="A y = B u + v, v of any colour",
        orders={"na": _N, "nb": _N},
        poles="na",
    ),
    Kind(
        name="n4sid",
        equation="a state space",
        orders={"order": None},
        poles="order",
        takes=("integrator", "weights", "horizon", "focus"),
    ),
    Kind(
        name="ararx",
        equation="A y = B u + 1/D e",
        orders={"na": _N, "nb": _N, "nd": 1},
        poles="na",
        takes=_SEARCHED,
        closed_loop=True,
        searched=False,  # IV4 and BJ cover its noise; it would make a search a quarter longer
    ),
    Kind(
        name="pem",
        equation="A y = B/F u + C/D e",
        orders={"na": 0, "nb": _N, "nc": 0, "nd": 0, "nf": _N},
        poles="nf",
        takes=("offset", "initial", "starts"),
        closed_loop=True,
    ),
)
KINDS: dict[str, Kind] = {kind.name: kind for kind in _KINDS}
"""All of them by name."""
OFFERED: dict[Family, Kind] = {name: KINDS[name] for name in FAMILIES}
"""Those that a command offers and a search tries."""


def users(argument: str) -> list[Family]:
    """Return the structures offered whose estimators take an order or another argument."""
    all_of = {name: (*EVERY, *kind.orders, *kind.takes) for name, kind in OFFERED.items()}
    return [name for name, arguments in all_of.items() if argument in arguments]
