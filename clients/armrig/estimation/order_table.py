"""Losses of many ARX structures at once, from one decomposition of the largest."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.linalg.lapack import dtrtrs

from armrig.checks import require_integers
from armrig.dataset import Dataset
from armrig.estimation.orders import require_samples
from armrig.least_squares import column_norms
from armrig.polynomial import Array, lagged
from armrig.triangular import triangle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Vector = NDArray[np.float64]
Integers = NDArray[np.int_]
Criterion = Literal["aic", "mdl", "fpe", "validation"]

_DEPENDENT = 1e-10  # share of a column's length that is left of it by those before it
_BLOCK = 4096  # rows decomposed at once: they stay in the cache


@dataclass(frozen=True, slots=True, kw_only=True)
class ArxOrders:
    """Orders of an ARX model, to be handed on: ``arx(data, **orders)``."""

    na: int
    """Number of a's."""
    nb: int
    """Number of b's."""
    nk: int
    """Samples before u reaches y."""

    def keys(self) -> tuple[str, ...]:
        """Return the names, as a mapping does."""
        return ("na", "nb", "nk")

    def __getitem__(self, name: str) -> int:
        """Return an order by its name."""
        if name not in self.keys():
            raise KeyError(name)
        return int(getattr(self, name))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class OrderTable:
    """Losses of n ARX structures and what the criteria make of them; print it or plot it."""

    na: Integers
    """Number of a's, (n,)."""
    nb: Integers
    """Number of b's, (n,)."""
    nk: Integers
    """Samples before u reaches y, (n,)."""
    loss: Vector
    """Mean squared error one step ahead on the estimation data, (n,); NaN where the data do not
    determine the parameters."""
    validation_loss: Vector | None
    """The same on validation data, which took no part in the estimation; None without any."""
    output_variance: float
    """Of y on the data that the criterion of choice is of."""
    N: int
    """Errors that `loss` was averaged over, the same ones for every structure."""

    def __len__(self) -> int:
        """Return the number of structures."""
        return int(self.na.size)

    @property
    def parameters(self) -> Integers:
        """Number of parameters, na + nb, (n,)."""
        return np.asarray(self.na + self.nb)

    @property
    def aic(self) -> Vector:
        """Akaike's criterion, -2 log likelihood + 2 d, (n,)."""
        return self._deviance + 2 * self.parameters

    @property
    def mdl(self) -> Vector:
        """Rissanen's criterion (BIC), -2 log likelihood + d log N, (n,)."""
        return self._deviance + self.parameters * float(np.log(self.N))

    @property
    def fpe(self) -> Vector:
        """Akaike's final prediction error, loss (1 + d/N) / (1 - d/N), (n,)."""
        share = self.parameters / self.N
        return np.asarray(self.loss * (1 + share) / (1 - share))

    @property
    def _deviance(self) -> Vector:
        loss = np.maximum(self.loss, np.finfo(np.float64).tiny)
        return np.asarray(self.N * (np.log(2 * np.pi * loss) + 1))

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """Those that can be asked for: "validation" where there are such data."""
        without = tuple(c for c in get_args(Criterion) if c != "validation")
        return without if self.validation_loss is None else ("validation", *without)

    def values(self, criterion: Criterion) -> Vector:
        """Return a criterion of every structure, (n,), NaN where it is not determined.

        Raises
        ------
        ValueError
            There is no such criterion, or it needs validation data.
        """
        if criterion not in self.criteria:
            msg = f"criterion={criterion!r} must be one of {', '.join(self.criteria)}"
            if criterion == "validation":
                msg += "; give select_orders the validation data"
            raise ValueError(msg)
        found = self.validation_loss if criterion == "validation" else getattr(self, criterion)
        return np.asarray(found)

    def best(self, criterion: Criterion | None = None) -> ArxOrders:
        """Return the orders of the lowest value, by default on validation data, else by MDL."""
        return self.orders(self._lowest(self._default if criterion is None else criterion))

    @property
    def _default(self) -> Criterion:
        return "mdl" if self.validation_loss is None else "validation"

    def _lowest(self, criterion: Criterion) -> int:
        return int(np.nanargmin(self.values(criterion)))

    def orders(self, i: int) -> ArxOrders:
        """Return the orders of structure number i."""
        return ArxOrders(na=int(self.na[i]), nb=int(self.nb[i]), nk=int(self.nk[i]))

    def envelope(self, criterion: Criterion | None = None) -> Integers:
        """Return the best structure for each number of parameters, fewest first."""
        values = np.nan_to_num(self.values(criterion or self._default), nan=np.inf)
        d = self.parameters
        best = [int(np.flatnonzero(d == n)[np.argmin(values[d == n])]) for n in np.unique(d)]
        return np.array([i for i in best if np.isfinite(values[i])], dtype=np.int_)

    def plot(self, criterion: Criterion | None = None, *, ax: Axes | None = None) -> Axes:
        """Show the share of y that is not explained against the number of parameters."""
        from armrig.plots.orders import plot_orders

        return plot_orders(self, criterion, ax=ax)

    def __repr__(self) -> str:
        """Say the choices, and the best structure for each number of parameters."""
        undetermined = int(np.count_nonzero(np.isnan(self.loss)))
        first = f"{len(self)} ARX structures on the same {self.N} samples"
        first += f", {undetermined} not determined by the data" if undetermined else ""
        lines = [first]
        for c in self.criteria:
            o = self.best(c)
            lines.append(f"  {c:10} chooses na={o.na}, nb={o.nb}, nk={o.nk}")
        on_other = self.validation_loss is not None
        lines.append(f"  best for each number of parameters, by {self._default}:")
        head = f"  {'d':>4} {'na':>3} {'nb':>3} {'nk':>3} {'loss':>12} {'FPE':>12} {'AIC':>11}"
        lines.append(head + f" {'MDL':>11}" + (f" {'validation':>12}" if on_other else ""))
        fpe, aic, mdl = self.fpe, self.aic, self.mdl
        for i in self.envelope():
            row = f"  {self.parameters[i]:4} {self.na[i]:3} {self.nb[i]:3} {self.nk[i]:3} "
            row += f"{self.loss[i]:12.5g} {fpe[i]:12.5g} {aic[i]:11.2f} {mdl[i]:11.2f}"
            if self.validation_loss is not None:
                row += f" {self.validation_loss[i]:12.5g}"
            lines.append(row)
        return "\n".join(lines)


def select_orders(
    data: Dataset,
    na: Iterable[int] = range(1, 11),
    nb: Iterable[int] = range(1, 11),
    nk: Iterable[int] = range(6),
    validation: Dataset | None = None,
) -> OrderTable:
    """Return the losses of all ARX structures with these orders.

    One QR decomposition of the largest regressor and y reduces the data to a triangle R; each
    pair (na, nk) is then a small QR of R's columns, whose leading triangles are the structures
    nb = 1, 2, …: the loss is the squared rest of y below row na + nb. A second triangle, of the
    validation data, gives their loss there: |R_v [-theta; 1]|². All structures are judged on the
    same samples, those at which the largest regressor is known.

    Parameters
    ----------
    data : Dataset
        Missing samples cost the rows that look back on them; experiments do not look back on
        each other.
    na, nb, nk : iterable of int
        Orders to try, na >= 0, nb >= 1, nk >= 0.
    validation : Dataset, optional
        Other data of the same system.

    Returns
    -------
    OrderTable
        Losses, AIC, MDL and FPE of every structure; `best(criterion)` has the orders.

    Raises
    ------
    ValueError
        An order is out of range, there are too few samples, or Ts differs.

    References
    ----------
    .. [1] L. Ljung, *System Identification*, 2nd ed., 1999, sections 10.1 and 16.4.
    """
    wanted = [np.unique([*values]) for values in (na, nb, nk)]
    for name, values, lowest in zip(("na", "nb", "nk"), wanted, (0, 1, 0), strict=True):
        if values.size == 0:
            msg = f"{name} is empty; give the orders to try, such as {name}=range(1, 5)"
            raise ValueError(msg)
        for value in values.tolist():
            require_integers(**{name: (value, lowest)})
    nas, nbs, nks = wanted
    lags = range(int(nks[0]), int(nks[-1] + nbs[-1]))
    R, N, variance = _reduced(data, int(nas[-1]), lags)
    asked = f"na to {nas[-1]}, nb to {nbs[-1]}, nk to {nks[-1]}"
    require_samples(f"{asked} with the gaps left out", needed=R.shape[0], got=N)
    R_v, N_v = None, 0
    if validation is not None:
        if not np.isclose(validation.Ts, data.Ts, rtol=1e-9, atol=0.0):
            msg = f"the data have Ts={data.Ts:g} s and the validation data {validation.Ts:g} s; "
            msg += "resample one of them"
            raise ValueError(msg)
        R_v, N_v, variance = _reduced(validation, int(nas[-1]), lags)
        require_samples(f"{asked} on validation data", needed=1, got=N_v)
    rows = []
    for n in nas:
        for k in nks:
            chosen = _columns(int(n), int(k), int(nbs[-1]), int(nas[-1]), lags)
            found = list(_losses(R, R_v, chosen, int(n)))
            rows += [(n, m, k, *found[m - 1]) for m in nbs]
    table = np.array(rows)
    return OrderTable(
        na=table[:, 0].astype(np.int_),
        nb=table[:, 1].astype(np.int_),
        nk=table[:, 2].astype(np.int_),
        loss=table[:, 3] / N,
        validation_loss=None if R_v is None else table[:, 4] / N_v,
        output_variance=variance,
        N=N,
    )


def _reduced(data: Dataset, na: int, lags: range) -> tuple[Array, int, float]:
    """Return the triangle of [-y lagged, u lagged, y], its number of rows, and y's variance."""
    blocks, N, known = [], 0, []
    for part in data.experiments():
        Phi = [-lagged(part.y, range(1, na + 1)), lagged(part.u, lags), part.y[:, None]]
        block = np.hstack(Phi)
        usable = np.isfinite(block).all(axis=1)
        usable[: max(na, lags.stop - 1)] = False
        block = block if usable.all() else block[usable]
        N += block.shape[0]
        known.append(block[:, -1])
        blocks += [block[i : i + _BLOCK] for i in range(0, block.shape[0], _BLOCK)]
    y = np.concatenate(known)
    return triangle(blocks, na + len(lags) + 1), N, float(np.var(y)) if y.size else float("nan")


def _columns(na: int, nk: int, nb: int, most: int, lags: range) -> Integers:
    """Return where y(t - 1) … y(t - na), u(t - nk) … u(t - nk - nb + 1) and y stand in R."""
    first = most + nk - lags.start
    return np.array([*range(na), *range(first, first + nb), most + len(lags)], dtype=np.int_)


def _losses(
    R: Array, R_v: Array | None, chosen: Integers, na: int
) -> Iterator[tuple[float, float]]:
    """Yield the squared errors, there and on validation data, for nb = 1, 2, ….

    The columns are scaled, so that what counts as dependent does not depend on units.
    """
    M = R[:, chosen]
    scale = column_norms(M)
    scale[scale == 0] = 1.0
    T = qr(M / scale, mode="r", check_finite=False)[0][: chosen.size]
    y = T[:, -1] * scale[-1]
    rest = np.cumsum(y[::-1] ** 2)[::-1]
    determined = np.abs(np.diag(T))[:-1] > _DEPENDENT
    V = None if R_v is None else R_v[:, chosen]
    for d in range(na + 1, chosen.size):
        if not determined[:d].all():
            yield float("nan"), float("nan")
            continue
        error = float("nan")
        if V is not None:
            theta = dtrtrs(T[:d, :d], y[:d])[0] / scale[:d]
            e = V[:, -1] - V[:, :d] @ theta
            error = float(e @ e)
        yield float(rest[d]), error
