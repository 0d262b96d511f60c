"""Choice of the orders of ARX models, with a table for each output."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from armrig.data.argument import as_dataset, as_signals, takes_data
from armrig.data.dataset import Dataset, Signals
from armrig.estimation.order_table import OrderTable, order_table, order_values, require_same_rate
from armrig.estimation.orders import Integers, by_channel
from armrig.numerics.criteria import Criterion
from armrig.numerics.polynomial import Array
from armrig.numerics.regressors import past


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class OrderTables:
    """A table of ARX structures for each output: `tables["y"]`."""

    tables: Mapping[str, OrderTable]
    """Table for each output; if delays were given, nk in the table is the least of these delays."""
    delays: Mapping[str, tuple[int, ...]]
    """Given delay of each input, for each output; empty if several delays were compared."""

    def __post_init__(self) -> None:
        """Make the mappings read-only."""
        for name in ("tables", "delays"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

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
        """Return the orders na, nb and nk of `arx` that a criterion chooses, a row for each output.

        In this row na is 0 for the other outputs.
        """
        best = {name: table.best(criterion) for name, table in self.tables.items()}
        chosen = [*best.values()]
        nu, ny = next(iter(self.tables.values())).inputs, len(chosen)
        return {
            "na": [[c.na if k == i else 0 for k in range(ny)] for i, c in enumerate(chosen)],
            "nb": [[c.nb] * nu for c in chosen],
            "nk": [[*self.delays.get(name, [c.nk] * nu)] for name, c in best.items()],
        }

    def __repr__(self) -> str:
        """Return the chosen orders of each output, with their reasons."""
        lines = []
        for name, table in self.tables.items():
            if name in self.delays:
                lines.append(f"{name}: given delays {', '.join(map(str, self.delays[name]))}")
            lines.append(f"{name}:\n{table.explain()}")
        return "\n".join(lines)


@takes_data
def select_orders(
    data: Dataset | Signals,
    na: Iterable[int] = range(1, 11),
    nb: Iterable[int] = range(1, 11),
    nk: Iterable[int] | Mapping[tuple[str, str], int] = range(6),
    validation: Dataset | Signals | None = None,
) -> OrderTable | OrderTables:
    """Return the losses of all ARX structures with these orders.

    One QR decomposition of y and the regressors of the largest structure reduces the data to a
    triangular matrix R. Each pair (na, nk) then needs only a small QR decomposition of columns of
    R. Triangular factors R_v of batches of the validation data give the loss on these batches,
    ``|R_v [-theta; 1]|²``. All structures are compared on the samples at which all regressors of
    the largest structure are known.

    Several signals have a table for each output, without the past of other outputs. All inputs of
    an output have the same nb, and the same nk unless the delays are given. Otherwise the number of
    combinations would grow exponentially with the number of channels.

    Parameters
    ----------
    data : Dataset or Signals
        N samples. Rows that depend on a missing sample are not used. No row depends on two
        experiments.
    na, nb : iterable of int
        Orders to try, na >= 0, nb >= 1.
    nk : iterable of int, or mapping
        Delays to try, >= 0. For several signals, a mapping such as {("y", "u"): 2} gives the
        delay of each channel, for example from `armrig.delay`; a channel that is not named has the
        delay 1.
    validation : Dataset or Signals, optional
        Other data of the same system.

    Returns
    -------
    OrderTable or OrderTables
        Losses, AIC, MDL and FPE of every structure. `best()` returns the orders to use, and
        `explain()` the reasons; `armrig.arx(data, **tables.best())` estimates the chosen model.

    Raises
    ------
    ValueError
        An order is out of range, there are too few samples, or the two data sets differ in Ts.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 10.1 and 16.4.

    Examples
    --------
    >>> first, second = armrig.example_recording().dataset("alpha").split(2)
    >>> table = armrig.select_orders(first, range(1, 6), range(1, 6), [1, 2], validation=second)
    >>> table.best()
    ArxOrders(na=5, nb=5, nk=1)
    >>> print(table.explain())
    - lowest loss on the validation data: na=5, nb=5, nk=1, 4.0...e-05
    ...
    - na=5 is the highest that was tried: try higher values
    - nb=5 is the highest that was tried: try higher values
    """
    signals = data.signals()
    single_channel = (signals.nu, signals.ny) == (1, 1)
    convert = as_dataset if single_channel else as_signals
    other = None if validation is None else convert(validation).signals()
    if other is not None:
        require_same_rate(signals.Ts, other.Ts)
    given_delays = None
    if isinstance(nk, Mapping):
        given_delays, nk = by_channel("nk", nk, data, least=0), [0]
    nas, nbs, nks = order_values(na=na, nb=nb, nk=nk)
    tables = {}
    for i, output in enumerate(signals.outputs):
        delays = np.zeros(signals.nu, dtype=np.int_) if given_delays is None else given_delays[i]
        first = delays.min(keepdims=True)
        rows = _rows(signals, i, delays - first)
        on_other = None if other is None else _rows(other, i, delays - first)
        tables[output] = order_table(rows, nas, nbs, nks + first, on_other)
    if single_channel:
        return tables[signals.outputs[0]]
    rows_of_delays = (
        [] if given_delays is None else zip(signals.outputs, given_delays.tolist(), strict=True)
    )
    return OrderTables(tables=tables, delays={name: tuple(row) for name, row in rows_of_delays})


def _rows(data: Signals, i: int, delays: Integers) -> list[tuple[Array, Array]]:
    """Return the delayed inputs (N, nu) and output i (N,) of each experiment, NaN if unknown."""
    return [
        (
            np.hstack([past(u, [lag]) for u, lag in zip(part.u.T, delays.tolist(), strict=True)]),
            part.y[:, i],
        )
        for part in data.experiments()
    ]
