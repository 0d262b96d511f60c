"""Orders of ARX models of several signals, a table for each output."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from armrig.data.signals import Signals
from armrig.estimation.order_table import OrderTable, order_table, require_same_rate
from armrig.numerics.criteria import Criterion
from armrig.numerics.polynomial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class OrderTables:
    """A table of ARX structures for each output: `tables["alpha"]`."""

    tables: Mapping[str, OrderTable]
    """Table for each output."""

    def __post_init__(self) -> None:
        """Make the mapping read-only."""
        object.__setattr__(self, "tables", MappingProxyType(dict(self.tables)))

    def __getitem__(self, output: str) -> OrderTable:
        """Return the table of one output."""
        return self.tables[output]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the outputs."""
        return iter(self.tables)

    def __len__(self) -> int:
        """Return the number of outputs."""
        return len(self.tables)

    def best(self, criterion: Criterion | None = None) -> dict[str, Any]:
        """Return the orders of `arx` that a criterion chooses: na, nb and nk with a row each.

        A row of na contains the chosen number for each output.
        """
        chosen = [table.best(criterion) for table in self.tables.values()]
        nu, ny = next(iter(self.tables.values())).inputs, len(chosen)
        return {
            "na": [[c.na if k == i else 0 for k in range(ny)] for i, c in enumerate(chosen)],
            "nb": [[c.nb] * nu for c in chosen],
            "nk": [[c.nk] * nu for c in chosen],
        }

    def __repr__(self) -> str:
        """Return the chosen orders of each output, with their reasons."""
        return "\n".join(f"{name}: {table.explain()}" for name, table in self.tables.items())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Row:
    """Inputs and one output of an experiment."""

    u: Array
    """Inputs (N, nu)."""
    y: Array
    """Output (N,), NaN where it is missing."""


def select_orders(
    data: Signals,
    na: Iterable[int] = range(1, 11),
    nb: Iterable[int] = range(1, 11),
    nk: Iterable[int] = range(6),
    validation: Signals | None = None,
) -> OrderTables:
    """Return the losses of ARX structures for each output, with all inputs.

    All inputs of an output have the same nb and nk, and the past of the other outputs is left out.
    The number of combinations would grow with the power of the number of channels otherwise.

    Parameters
    ----------
    data : Signals
        N samples of nu inputs and ny outputs.
    na, nb, nk : iterable of int
        Orders to try, as for one output.
    validation : Signals, optional
        Other data of the same system.

    Returns
    -------
    OrderTables
        `OrderTable` of each output; `armrig.arx(data, **tables.best())` estimates the choice.
    """
    if validation is not None:
        require_same_rate(data.equidistant(), validation.equidistant())
    nas, nbs, nks = [*na], [*nb], [*nk]
    tables = {}
    for i, output in enumerate(data.outputs):
        other = None if validation is None else _rows(validation, i)
        tables[output] = order_table(_rows(data, i), nas, nbs, nks, other)
    return OrderTables(tables=tables)


def _rows(data: Signals, i: int) -> list[_Row]:
    return [
        _Row(u=part.u, y=np.where(part.valid[:, i], part.y[:, i], np.nan))
        for part in data.experiments()
    ]
