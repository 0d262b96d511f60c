"""Output-error structures that describe the data in the fewest bits: orders, delay, integrator."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Literal

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray
from scipy.linalg import qr

from armrig.data.dataset import Dataset
from armrig.estimation.order_table import select_orders
from armrig.estimation.prediction_error import PredictionError
from armrig.estimation.steiglitz_mcbride import equation_error, steiglitz_mcbride
from armrig.models.innovations import prepared
from armrig.models.structure import Structure
from armrig.numerics.criteria import mdl
from armrig.numerics.polynomial import filtered, reflected
from armrig.numerics.whiteness import autoregression

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

RECOMMENDED = 3
BARE = 2.0  # difference of description length that hardly counts (Kass, Raftery 1995, BIC)
HIGHEST = 7  # order that is tried
_FIRST = (3, 6)  # orders of the models of which one leaves the first noise
_LATEST = 30  # lag at which u is looked for
_ARX = range(1, 7)  # orders that the lag is looked for with
_LAGS = 6  # lags that are tried with each order
_MORE = 2  # b's before the likeliest lag and after nf of them, to see which are there
_STEPS = 30
_ENOUGH = 3000  # samples that orders are tried on
_RANK = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Recommended:
    """Orders of an output-error model, to be handed on: ``oe(data, **orders)``."""

    nb: int
    """Number of b's."""
    nf: int
    """Number of all f's, an integrator's included."""
    nk: int
    """Samples before u reaches y."""
    integrator: bool
    """One root of F is 1 exactly."""

    def keys(self) -> tuple[str, ...]:
        """Return the names, as a mapping does."""
        return ("nb", "nf", "nk", "integrator")

    def __getitem__(self, name: str) -> int | bool:
        """Return an order by its name."""
        if name not in self.keys():
            raise KeyError(name)
        return getattr(self, name)  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tried:
    """A structure, its description length, and the model in which it was seen."""

    structure: Recommended
    bits: float
    """MDL: N log of the loss and log N for each coefficient."""
    fitted: _Fitted


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fitted:
    """An output-error model of prewhitened data."""

    structure: Recommended
    problem: PredictionError
    f: Vector
    """Of F, without the integrator's factor."""
    cost: float
    N: int

    @property
    def B(self) -> Vector:
        """From the lag 0 on."""
        ab = self.problem.solve(self.f).ab
        return np.append(np.zeros(self.structure.nk), ab)

    @property
    def F(self) -> Vector:
        """The integrator's factor included."""
        F = np.append(1.0, self.f)
        return np.convolve(F, [1.0, -1.0]) if self.structure.integrator else F

    def residuals(self) -> list[Vector]:
        """Return those of each experiment, NaN where there is none."""
        found = self.problem.solve(self.f)
        pairs = zip(self.problem.experiments, found.parts, strict=True)
        return [np.where(x.rows, p.e, np.nan) for x, p in pairs]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recommendation:
    """The structures of least description length, and the model of the first."""

    structures: tuple[Recommended, ...]
    """Best first."""
    shown: bool
    """The description length says of the integrator what was given."""
    B: Vector
    """Of the model of the first, from lag 0 on."""
    F: Vector
    """Of the same."""
    whitening: Vector
    """D of the noise e/D by which the signals were prewhitened."""

    def G(self, omega: Vector, Ts: float) -> NDArray[np.complex128]:
        """Return the model's frequency response."""
        z = np.exp(-1j * omega * Ts)
        return np.asarray(np.polyval(self.B[::-1], z) / np.polyval(self.F[::-1], z))


def recommended(
    data: Dataset, lags: Iterable[int], *, integrates: bool, decide: bool
) -> Recommendation:
    """Return at most three structures, after the noise's colour was taken from u and y.

    The noise that a first model leaves is described by an autoregression 1/D; D u and D y then
    have white noise, for which output error is the maximum of the likelihood and the description
    length (MDL) tells orders apart. Each order is fitted at the lags given and at those that ARX
    models prefer; which b's are there then follows from their covariance, jointly.

    Parameters
    ----------
    lags : iterable of int
        nk to try, the likeliest first.
    integrates : bool
        y is the sum of its rate.
    decide : bool
        Whether the description length may say otherwise: then one of each is recommended.
    """
    data = _busiest(data)
    nks = [*dict.fromkeys([*lags, *_arx_lags(data)])][:_LAGS]
    parts = [*data.experiments()]
    kinds = (False, True) if decide else (integrates,)
    first = [m for i in kinds for n in _FIRST for m in _fits(parts, n, nks, integrates=i)]
    if not first:
        raise InputError(
            "u excites no model of third order: record with a richer input (telegraph, PRBS)"
        )
    D, _ = autoregression(np.concatenate(min(first, key=_bits).residuals()))
    parts, orders = _filtered(data, D), range(1, HIGHEST + 1)
    scans = [s for i in kinds if (s := _scanned(parts, nks, orders, integrates=i))]
    C, _ = autoregression(np.concatenate(_joined(scans)[0].fitted.residuals()))
    if C.size > 1:
        D = np.convolve(D, C)
        parts = _filtered(data, D)
        scans = [_again(parts, ranked) for ranked in scans]
    ranked = _joined(scans)
    best = ranked[0].fitted
    other = min((t.bits for t in ranked if t.structure.integrator != integrates), default=np.inf)
    shown = other - ranked[0].bits >= BARE
    return Recommendation(
        structures=tuple(
            sorted(
                (t.structure for t in _chosen(scans, shown=shown)),
                key=lambda s: not shown and s.integrator != integrates,  # the step's answer first
            )
        ),
        shown=shown,
        B=best.B,
        F=best.F,
        whitening=D,
    )


def _chosen(scans: list[list[Tried]], *, shown: bool) -> list[Tried]:
    """Return at most three: the shortest two, or one with and one without an integrator.

    After the shortest two the shortest with nb = nf comes, which a plant under a hold has.
    """
    ranked = min(scans, key=lambda s: s[0].bits) if shown else _joined(scans)
    two = ranked[:2] if shown else _joined([s[:1] for s in scans])
    full = [t for t in ranked if shown and t.structure.nb == t.structure.nf]
    return [*dict.fromkeys([*two, *full[:1], *ranked])][:RECOMMENDED]


def _joined(scans: Iterable[list[Tried]]) -> list[Tried]:
    """Return the structures of all, least description length first."""
    return sorted(chain.from_iterable(scans), key=lambda t: t.bits)


def _again(parts: Sequence[Dataset], ranked: list[Tried]) -> list[Tried]:
    """Return structures near the first, of data that are filtered once more."""
    s = ranked[0].structure
    orders = range(max(s.nf - 1, 1), min(s.nf + 1, HIGHEST) + 1)
    return _scanned(parts, [s.nk], orders, integrates=s.integrator) or ranked


def _busiest(data: Dataset) -> Dataset:
    """Return the part of long data in which u moves most."""
    if data.N <= _ENOUGH:
        return data
    moves = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(data.u, prepend=data.u[0])))])
    begins = np.linspace(0, data.N - _ENOUGH, 8).astype(int)
    begin = int(begins[np.argmax(moves[begins + _ENOUGH] - moves[begins])])
    return data[begin : begin + _ENOUGH]


def _arx_lags(data: Dataset) -> list[int]:
    """Return the lags that ARX models of several orders prefer."""
    latest = min(_LATEST, max(data.N // 10, 1))
    try:
        table = select_orders(data, _ARX, _ARX, range(1, latest + 1))
    except ValueError:
        return []
    bits, found = np.nan_to_num(table.mdl, nan=np.inf), []
    for n in reversed(_ARX):
        of = np.flatnonzero((table.na == n) & (table.nb == n))
        found.append(int(table.nk[of[np.argmin(bits[of])]]))
    return [int(table.nk[np.argmin(bits)]), *found]


def _filtered(data: Dataset, D: Vector) -> list[Dataset]:
    """Return each experiment with D u and D y, from where D has its memory."""
    p, found = D.size - 1, []
    for part in data.experiments():
        if p < part.N:
            u, y = (filtered(D, [1.0], x)[p:] for x in (part.u, part.y))
            found.append(part[p:].replaced(step=None, u=u, y=y, valid=np.isfinite(y)))
    return found


def _scanned(
    parts: Sequence[Dataset], nks: list[int], orders: range, *, integrates: bool
) -> list[Tried]:
    """Return structures of all orders, least description length first."""
    found: dict[tuple[int, int, int], Tried] = {}
    best, worse = np.inf, 0
    near: Vector = np.ones(1)
    for nf in orders:
        models = [*_fits(parts, nf, nks, integrates=integrates, near=near)]
        for tried in (t for model in models for t in _trimmed(model)):
            s = tried.structure
            key = s.nb, s.nf, s.nk
            if key not in found or tried.bits < found[key].bits:
                found[key] = tried
        if models:
            near = np.append(1.0, min(models, key=lambda m: m.cost).f)
        lowest = min((t.bits for t in found.values() if t.structure.nf == nf), default=np.inf)
        worse = worse + 1 if lowest > best else 0
        best = min(best, lowest)
        if worse == 2:
            break
    return sorted(found.values(), key=lambda t: t.bits)


def _fits(
    parts: Sequence[Dataset],
    nf: int,
    nks: list[int],
    *,
    integrates: bool,
    near: Vector = np.ones(1),  # noqa: B008
) -> Iterator[_Fitted]:
    """Yield models of an order at the likeliest lags, with more b's than are thought to be there.

    Their covariance then tells which b's are.
    """
    if nf < integrates:
        return
    begun = [s for k in nks if (s := _begun(parts, nf, nf, k, integrates, near))]
    likeliest = [*begun[:1], *sorted(begun[1:], key=lambda s: s[0])[:2]]
    for nk, f in [(k, f) for _, k, f in likeliest]:
        first = max(nk - _MORE, min(nk, 1))
        problem = _problem(parts, nf + nk - first + _MORE, nf, first, integrates=integrates)
        n = problem.structure
        N = sum(int(np.count_nonzero(x.rows)) for x in problem.experiments)
        if 3 * (n.nb + nf) < N:
            end = problem.minimise(f, most=_STEPS)
            wide = Recommended(nb=n.nb, nf=nf, nk=first, integrator=integrates)
            yield _Fitted(structure=wide, problem=problem, f=end.theta, cost=end.cost, N=N)


def _problem(
    parts: Sequence[Dataset], nb: int, nf: int, nk: int, *, integrates: bool
) -> PredictionError:
    """Return the problem with u advanced by the delay, whose unknown past costs time."""
    d = max(nk - 1, 0)
    letter: Literal["f", ""] = "f" if integrates else ""
    n = Structure(nb=nb, nf=nf - integrates, nk=nk - d, integrator=letter, offset=True)
    later = [p[d:].replaced(step=None, u=p.u[: p.N - d]) for p in parts if d < p.N]
    return PredictionError(experiments=tuple(prepared(p, n) for p in later), structure=n)


def _begun(
    parts: Sequence[Dataset], nb: int, nf: int, nk: int, integrates: bool, near: Vector
) -> tuple[float, int, Vector] | None:
    """Return the cost at a start, nk and the start."""
    problem = _problem(parts, nb, nf, nk, integrates=integrates)
    n = problem.structure
    signals = [(x.u, x.y) for x in problem.experiments]
    try:
        F = reflected(equation_error(signals, np.ones(1), n)[0])
        starts = [F, *steiglitz_mcbride(signals, F, n, iterations=3)]
        if near.size == n.nf:
            starts.append(np.convolve(near, [1.0, -0.3]))
        return min(((problem.cost(F[1:]), nk, F[1:]) for F in starts), key=lambda s: s[0])
    except (ValueError, np.linalg.LinAlgError):
        return None


def _bits(model: _Fitted, more: float = 0.0, fewer: int = 0) -> float:
    s = model.structure
    loss = max((model.cost + more) / model.N, np.finfo(np.float64).tiny)
    return float(mdl(loss, s.nb + s.nf - s.integrator - fewer, model.N))


def _trimmed(model: _Fitted) -> Iterator[Tried]:
    """Yield the structure without the first and the last b's, by what the loss would rise."""
    solution = model.problem.solve(model.f)
    R: Matrix = qr(solution.Psi, mode="r", check_finite=False)[0][: solution.Psi.shape[1]]
    scale = np.sqrt(np.sum(R**2, axis=0))
    scale[scale == 0] = 1.0
    inverse = np.linalg.pinv(R / scale, rcond=_RANK) / scale[:, None]
    P, b, s = inverse @ inverse.T, solution.ab, model.structure
    for i in range(s.nb):
        for j in range(s.nb - i):
            out = [*range(i), *range(s.nb - j, s.nb)]
            rise = (
                b[out] @ np.linalg.lstsq(P[np.ix_(out, out)], b[out], rcond=None)[0] if out else 0
            )
            yield Tried(
                structure=replace(s, nb=s.nb - i - j, nk=s.nk + i),
                bits=_bits(model, float(max(rise, 0.0)), i + j),
                fitted=model,
            )
