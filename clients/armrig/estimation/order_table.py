"""Losses of many ARX structures at once, from one decomposition of the largest structure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, get_args

import numpy as np
from armrig_core.errors import InputError
from scipy.linalg import qr
from scipy.linalg.lapack import dtrtrs

from armrig.data.columns import Matrix, Vector
from armrig.estimation.orders import Integers, require_samples
from armrig.numerics.checks import MAX_ORDER, require_integers, several
from armrig.numerics.criteria import (
    BATCHES,
    Criterion,
    aic,
    fpe,
    mdl,
    simplest_as_good,
    standard_error,
)
from armrig.numerics.least_squares import column_norms, triangle
from armrig.numerics.polynomial import Array
from armrig.numerics.quantities import digits, plural
from armrig.numerics.regressors import complete, in_blocks, past
from armrig.numerics.rounding import rounding_std

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Parts = Sequence[tuple[Array, Array]]
"""Inputs (N, nu) and output (N,) of each experiment; an unknown value is NaN."""

_MIN_INDEPENDENT_SHARE = 1e-10  # least share of a column that earlier columns do not explain
_BLOCK_ROWS = 4096  # rows decomposed at once; they fit into the cache


@dataclass(frozen=True, slots=True, kw_only=True)
class ArxOrders:
    """Orders of an ARX model, as arguments: ``arx(data, **orders)``."""

    na: int
    """Number of a's."""
    nb: int
    """Number of b's."""
    nk: int
    """Samples before u reaches y."""

    def keys(self) -> tuple[str, ...]:
        """Return the names of the orders, so that ``**orders`` is possible."""
        return ("na", "nb", "nk")

    def __getitem__(self, name: str) -> int:
        """Return an order by its name."""
        if name not in self.keys():
            raise KeyError(name)
        return int(getattr(self, name))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class OrderTable:
    """Losses and criteria of n ARX structures; print it or plot it."""

    na: Integers
    """Number of a's, (n,)."""
    nb: Integers
    """Number of b's, (n,)."""
    nk: Integers
    """Samples before u reaches y, (n,)."""
    loss: Vector
    """Mean squared error one step ahead on the estimation data, (n,); NaN if the data do not
    determine the parameters."""
    validation_loss: Vector | None
    """Mean squared error one step ahead on the validation data, (n,); None without validation
    data."""
    batch_losses: Matrix | None
    """Validation loss in each of up to 30 successive batches of the validation data, (n,
    batches)."""
    output_variance: float
    """Variance of y in the validation data, or in the estimation data if there are no validation
    data."""
    N: int
    """Number of samples in `loss`; every structure uses the same samples."""
    inputs: int = 1
    """Number of inputs; each has nb coefficients."""

    def __len__(self) -> int:
        """Return the number of structures."""
        return int(self.na.size)

    @property
    def parameters(self) -> Integers:
        """Number of parameters: na, plus nb for each input, (n,)."""
        return np.asarray(self.na + self.inputs * self.nb)

    @property
    def aic(self) -> Vector:
        """Akaike's criterion, -2 log likelihood + 2 d, (n,)."""
        return aic(self.loss, self.parameters, self.N)

    @property
    def mdl(self) -> Vector:
        """Rissanen's criterion (BIC), -2 log likelihood + d log N, (n,)."""
        return mdl(self.loss, self.parameters, self.N)

    @property
    def fpe(self) -> Vector:
        """Akaike's final prediction error, loss (1 + d/N) / (1 - d/N), (n,)."""
        return fpe(self.loss, self.parameters, self.N)

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """Available criteria; "validation" is the first if there are validation data."""
        without = tuple(c for c in get_args(Criterion) if c != "validation")
        return without if self.validation_loss is None else ("validation", *without)

    def values(self, criterion: Criterion) -> Vector:
        """Return the criterion of every structure, (n,); NaN if the parameters are undetermined.

        Raises
        ------
        ValueError
            The criterion is unknown, or it needs validation data and there are none.
        """
        if criterion not in self.criteria:
            msg = f"criterion={criterion!r} must be one of {', '.join(self.criteria)}"
            if criterion == "validation":
                msg += "; give select_orders the validation data"
            raise InputError(msg)
        criterion_values = (
            self.validation_loss if criterion == "validation" else getattr(self, criterion)
        )
        return np.asarray(criterion_values)

    def best(self, criterion: Criterion | None = None) -> ArxOrders:
        """Return the orders that a criterion chooses.

        The default criterion is "validation" if there are validation data, otherwise MDL. The
        lowest of many validation losses is also low by chance, and often belongs to a structure
        that is too large. "validation" therefore chooses the fewest parameters among the structures
        whose loss exceeds the lowest loss by at most one standard error of the difference [1]_. The
        other criteria contain a penalty for each parameter, so their lowest value decides.

        In 200 simulations with 600 structures (N = 1000 for estimation and for validation) this
        rule chose the true orders na=2, nb=2, nk=1 in 73 % of the simulations. The lowest
        validation loss chose these orders in 18 %, MDL in 99 %, and AIC and FPE in 49 % of the
        simulations. No criterion chose a structure that is too small.

        References
        ----------
        .. [1] T. Hastie, R. Tibshirani, J. Friedman, *The Elements of Statistical Learning*, 2nd
           ed., 2009, section 7.10 (one standard error).
        """
        return self.orders(self.chosen(criterion))

    def chosen(self, criterion: Criterion | None = None) -> int:
        """Return the index of the structure whose orders `best` returns."""
        criterion = criterion or self._default
        if criterion != "validation":
            return self._lowest(criterion)
        return simplest_as_good(*self._excess(), self.parameters)

    def _excess(self) -> tuple[Vector, Vector]:
        """Return each validation loss minus the lowest loss, and its standard error, (n,)."""
        lowest = self._lowest("validation")
        if self.validation_loss is None or self.batch_losses is None:
            return np.zeros(len(self)), np.zeros(len(self))
        std = standard_error(self.batch_losses - self.batch_losses[lowest])
        return self.validation_loss - self.validation_loss[lowest], std

    @property
    def _default(self) -> Criterion:
        return "mdl" if self.validation_loss is None else "validation"

    def _lowest(self, criterion: Criterion) -> int:
        return int(np.argmin(np.nan_to_num(self.values(criterion), nan=np.inf)))

    def explain(self) -> str:
        """Return a text with the choice and its reasons."""
        return "\n".join(f"- {line}" for line in self._reasons())

    def _reasons(self) -> Iterator[str]:
        i = self.chosen()
        if self.validation_loss is None:
            orders = _orders_text(self.orders(i))
            yield f"chosen: {orders}, by lowest MDL (log N for each parameter)"
            yield "validation data give a better choice: give select_orders validation=…"
        else:
            yield from self._about_validation(i)
        yield from self._about_bounds(i)

    def _about_validation(self, i: int) -> Iterator[str]:
        lowest, d = self._lowest("validation"), self.parameters
        excess, std = self._excess()
        loss, best = self.values("validation"), _orders_text(self.orders(lowest))
        yield f"lowest loss on the validation data: {best}, {loss[lowest]:.5g}"
        if i == lowest:
            yield "chosen: this structure, as no simpler structure is within one standard error"
        else:
            yield (
                f"chosen: {_orders_text(self.orders(i))}, {plural(d[i], 'parameter')} instead of "
                f"{d[lowest]}; its loss is higher by {digits(excess[i], 2)} ± {digits(std[i], 2)}, "
                "within the effect of chance"
            )
        fewer = np.flatnonzero((d < d[i]) & np.isfinite(loss))
        if fewer.size:
            k = int(fewer[np.argmin(loss[fewer])])
            off = excess[k] / max(std[k], np.finfo(np.float64).tiny)
            yield (
                f"fewer parameters are not enough: {_orders_text(self.orders(k))} is {off:.1f} "
                "standard "
                "errors above the lowest loss"
            )

    def _about_bounds(self, i: int) -> Iterator[str]:
        """Yield a hint for each order whose highest value was chosen."""
        for name, values in (("na", self.na), ("nb", self.nb), ("nk", self.nk)):
            if values[i] == values.max() > values.min():
                yield f"{name}={values[i]} is the highest that was tried: try higher values"

    def orders(self, i: int) -> ArxOrders:
        """Return the orders of the structure with index i."""
        return ArxOrders(na=int(self.na[i]), nb=int(self.nb[i]), nk=int(self.nk[i]))

    def envelope(self, criterion: Criterion | None = None) -> Integers:
        """Return the index of the best structure for each number of parameters, fewest first."""
        values = np.nan_to_num(self.values(criterion or self._default), nan=np.inf)
        d = self.parameters
        best = [int(np.flatnonzero(d == n)[np.argmin(values[d == n])]) for n in np.unique(d)]
        return np.array([i for i in best if np.isfinite(values[i])], dtype=np.int_)

    def plot(self, criterion: Criterion | None = None, *, ax: Axes | None = None) -> Figure:
        """Return a figure of the loss against the number of parameters."""
        from armrig.estimation.figures import plot_orders
        from armrig.plots.layout import figure_of

        return figure_of(plot_orders(self, criterion, ax=ax))

    def __repr__(self) -> str:
        """Return the choices and a table of the best structure for each number of parameters."""
        undetermined = int(np.count_nonzero(np.isnan(self.loss)))
        first = f"{plural(len(self), 'ARX structure')} on the same {plural(self.N, 'sample')}"
        first += f", {undetermined} not determined by the data" if undetermined else ""
        lines = [first]
        for c in self.criteria:
            o = self.best(c)
            lines.append(f"  {c:10} chooses na={o.na}, nb={o.nb}, nk={o.nk}")
        on_other = self.validation_loss is not None
        lines += [f"  {line}" for line in self.explain().splitlines()]
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


def order_table(
    data: Parts, nas: Integers, nbs: Integers, nks: Integers, validation: Parts | None
) -> OrderTable:
    """Return the table of `select_orders` for one output and one or several inputs."""
    lags = range(int(nks[0]), int(nks[-1] + nbs[-1]))
    nu = int(data[0][0].shape[1])
    blocks, N, variance = _regressors(data, int(nas[-1]), lags)
    R = triangle(blocks, int(nas[-1]) + nu * len(lags) + 1)
    asked = f"na to {nas[-1]}, nb to {nbs[-1]}, nk to {nks[-1]}"
    require_samples(f"{asked} with the gaps left out", needed=R.shape[0], got=N)
    R_v, counts = np.zeros((0, *R.shape)), np.zeros(0, dtype=np.int_)
    if validation is not None:
        blocks, N_v, variance = _regressors(validation, int(nas[-1]), lags)
        require_samples(f"{asked} on validation data", needed=1, got=N_v)
        R_v, counts = _batches(np.vstack(blocks))
    orders, losses, errors = [], [], []
    for n in nas:
        for k in nks:
            columns = _columns(int(n), int(k), int(nbs[-1]), int(nas[-1]), lags, nu)
            loss_pairs = list(_losses(R, R_v, columns, int(n), nu))
            orders += [(n, m, k) for m in nbs]
            losses += [loss_pairs[m - 1][0] for m in nbs]
            errors += [loss_pairs[m - 1][1] for m in nbs]
    table, squared = np.array(orders, dtype=np.int_), np.array(errors)
    # Among structures without errors, rounding errors would choose.
    least = rounding_std(*(y for _, y in data)) ** 2
    return OrderTable(
        na=table[:, 0],
        nb=table[:, 1],
        nk=table[:, 2],
        loss=np.maximum(np.array(losses) / N, least),
        validation_loss=None
        if validation is None
        else np.maximum(squared.sum(axis=1) / counts.sum(), least),
        batch_losses=None if validation is None else squared / counts,
        output_variance=variance,
        N=N,
        inputs=nu,
    )


def order_values(**orders: Iterable[int]) -> list[Integers]:
    """Return the values of na, nb and nk to try, each in rising order."""
    wanted = [np.unique(several(name, values)) for name, values in orders.items()]
    for name, values, lowest in zip(orders, wanted, (0, 1, 0), strict=True):
        for value in values.tolist():
            require_integers(MAX_ORDER, **{name: (value, lowest)})
    return wanted


def require_same_rate(Ts: float, validation_Ts: float) -> None:
    """Refuse validation data with another sampling time."""
    if not np.isclose(validation_Ts, Ts, rtol=1e-9, atol=0.0):
        raise InputError(
            f"the data have Ts={Ts:g} s and the validation data {validation_Ts:g} s; "
            "resample one of them"
        )


def _regressors(data: Parts, na: int, lags: range) -> tuple[list[Array], int, float]:
    """Return blocks of rows [-y, all inputs lag by lag, y], the number of rows, and var(y)."""
    blocks, outputs = [], []
    for u, y in data:
        inputs = np.stack([past(x, lags) for x in u.T], axis=-1).reshape(y.size, -1)
        block = np.hstack([-past(y, range(1, na + 1)), inputs, y[:, None]])
        rows = block[complete(block)]
        outputs.append(rows[:, -1])
        blocks += list(in_blocks(rows, _BLOCK_ROWS))
    y = np.concatenate(outputs)
    return blocks, y.size, float(np.var(y)) if y.size else float("nan")


def _batches(M: Array) -> tuple[Array, Integers]:
    """Return the triangular factor of each batch of rows, (batches, d, d), and its row count."""
    parts = np.array_split(M, min(BATCHES, M.shape[0]))
    triangles = np.stack([triangle([part], M.shape[1]) for part in parts])
    return triangles, np.array([part.shape[0] for part in parts], dtype=np.int_)


def _columns(na: int, nk: int, nb: int, most: int, lags: range, nu: int) -> Integers:
    """Return the columns of R for y(t - 1) … y(t - na), u(t - nk) … u(t - nk - nb + 1) and y."""
    first, last = most + nu * (nk - lags.start), most + nu * len(lags)
    return np.array([*range(na), *range(first, first + nu * nb), last], dtype=np.int_)


def _losses(
    R: Array, R_v: Array, columns: Integers, na: int, nu: int
) -> Iterator[tuple[float, Array]]:
    """Yield the sum of squared errors and that of each validation batch, for nb = 1, 2, …."""
    M = R[:, columns]
    scale = column_norms(M)  # so that the test for linear dependence does not depend on units
    scale[scale == 0] = 1.0
    T = qr(M / scale, mode="r", check_finite=False)[0][: columns.size]
    y = T[:, -1] * scale[-1]
    sse = np.cumsum(y[::-1] ** 2)[::-1]
    determined = np.abs(np.diag(T))[:-1] > _MIN_INDEPENDENT_SHARE
    K = R_v.shape[0]
    V = np.asfortranarray(R_v.reshape(-1, R.shape[1])[:, columns])
    for d in range(na + nu, columns.size, nu):
        if not determined[:d].all():
            yield float("nan"), np.full(K, np.nan)
            continue
        theta = dtrtrs(T[:d, :d], y[:d])[0] / scale[:d]
        e = (V[:, -1] - V[:, :d] @ theta).reshape(K, R.shape[1])
        yield float(sse[d]), np.einsum("ij,ij->i", e, e)


def _orders_text(orders: ArxOrders) -> str:
    return f"na={orders.na}, nb={orders.nb}, nk={orders.nk}"
