"""The structures that can be estimated: their orders, what they are by default, their names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

Family = Literal["arx", "armax", "oe", "bj", "iv4", "n4sid"]
"""A structure with a name of its own: what a command offers and a search tries."""
FAMILIES: tuple[Family, ...] = get_args(Family)
Name = Literal[Family, "pem"]

ARM_POLES = 4
"""Poles of the arm, one of them an integrator; its numerator has as many coefficients."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """One structure."""

    name: Name
    """As a program writes it, which is also the name of its estimator."""
    orders: Mapping[str, int | None]
    """Its orders by name, nk left out, each with its default for the arm; None is by the data."""
    poles: str
    """Name of the order that counts the poles from u to y."""
    may_integrate: bool
    """A pole can be 1 by construction."""
    may_offset: bool
    """The input's offset can be estimated along."""

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


def _kind(
    name: Name,
    orders: Mapping[str, int | None],
    poles: str,
    *,
    integrates: bool = False,
    offset: bool = False,
) -> Kind:
    return Kind(name=name, orders=orders, poles=poles, may_integrate=integrates, may_offset=offset)


_N = ARM_POLES
_KINDS = (
    _kind("arx", {"na": _N, "nb": _N}, "na"),
    _kind("armax", {"na": _N, "nb": _N, "nc": _N}, "na", integrates=True, offset=True),
    _kind("oe", {"nb": _N, "nf": _N}, "nf", integrates=True, offset=True),
    _kind("bj", {"nb": _N, "nc": 1, "nd": 1, "nf": _N}, "nf", integrates=True, offset=True),
    _kind("iv4", {"na": _N, "nb": _N}, "na"),
    _kind("n4sid", {"order": None}, "order", integrates=True),
    _kind("pem", {"na": 0, "nb": _N, "nc": 0, "nd": 0, "nf": _N}, "nf"),
)
KINDS: dict[str, Kind] = {kind.name: kind for kind in _KINDS}
"""All of them by name."""
