"""Output-error structures that describe the data in the fewest bits: orders, delay, integrator."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, product
from operator import itemgetter
from typing import Any, Literal

import numpy as np
from armrig_core.errors import InputError
from numpy.typing import NDArray

from armrig.data.dataset import Dataset, Vector
from armrig.estimation.order_selection import select_orders
from armrig.estimation.orders import require_samples
from armrig.estimation.problem import PolynomialProblem
from armrig.estimation.start_values import start_values
from armrig.excitation.input_description import excitation_order
from armrig.models.innovations import prepare
from armrig.models.structure import Structure
from armrig.numerics.criteria import mdl
from armrig.numerics.polynomial import apply_filter
from armrig.numerics.rounding import SEARCH_SHARE, rounding_std
from armrig.numerics.whiteness import autoregression

RECOMMENDED = 3
BARE = 2.0  # difference of description length that hardly counts (Kass, Raftery 1995, BIC)
HIGHEST = 7  # largest number of poles that is tried
MAX_TIME_CONSTANTS = 3  # of a process model
_FIRST_ORDERS = (3, 6)  # orders of the models for the first estimate of the noise
_LEAST_PARAMETERS = 8  # the transient of a step with little noise determines four poles
_MAX_LAG = 30  # largest nk of the ARX models
_ARX_ORDERS = range(1, 7)  # na and nb of the ARX models that propose values of nk
_MAX_LAGS = 6  # values of nk that are tried with each order
_EXTRA_COEFFICIENTS = 2  # additional b's before lag nk, and after lag nk + nf - 1
_MAX_STEPS = 30  # steps of one search
_MAX_SAMPLES = 3000  # longer data are cut to the part in which u changes most


@dataclass(frozen=True, slots=True, kw_only=True)
class Recommended:
    """Orders of an output-error model."""

    nb: int
    """Number of coefficients b_k."""
    nf: int
    """Number of coefficients f_k, including the coefficient of an integrator."""
    nk: int
    """Number of samples before u affects y."""
    integrator: bool
    """True if one root of F is exactly 1."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OutputErrorFit:
    """An output-error model of prewhitened data."""

    structure: Recommended
    problem: PolynomialProblem
    f: Vector
    """Coefficients of F, without the integrator's factor."""
    cost: float
    """Sum of the squared residuals."""
    past: int
    """Number of quantities, such as initial states, that represent the unknown past in the fit."""
    N: int
    """Number of residuals."""

    @property
    def bits(self) -> float:
        """Description length (MDL): N log(loss), plus log N for each coefficient.

        Each dimension of one experiment's initial state costs log N, as a coefficient does.
        Otherwise a pair of poles on the unit circle and the initial state could fit any sine in the
        noise.
        """
        s, experiments = self.structure, len(self.problem.experiments)
        loss = max(self.cost / (self.N - self.past), self.rounding**2)
        d = s.nb + s.nf - s.integrator + self.past / experiments
        return float(mdl(loss, d, self.N))

    def G(self, omega: Vector, Ts: float) -> NDArray[np.complex128]:
        """Return the frequency response."""
        z = np.exp(-1j * omega * Ts)  # of one sample of delay
        B, F = self.problem.solve(self.f).ab, np.append(1.0, self.f)
        G = z**self.structure.nk * np.polyval(B[::-1], z) / np.polyval(F[::-1], z)
        return np.asarray(G / (1 - z) ** self.structure.integrator)

    @property
    def rounding(self) -> float:
        """Standard deviation of rounding errors, in the unit of the filtered y."""
        return _rounding(self.problem)

    def noise(self) -> Vector:
        """Return C of the autoregression C e = white noise of the residuals e."""
        solution = self.problem.solve(self.f)
        pairs = zip(self.problem.experiments, solution.parts, strict=True)
        residuals = [np.where(x.rows, p.e, np.nan) for (x,), (p,) in pairs]
        return autoregression(residuals, mdl, self.rounding)[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class _SharedSamples:
    """Experiments, with the largest nk, so that all structures describe the same samples of y.

    The difference of description lengths of other samples would depend on the unit of y.
    """

    parts: tuple[tuple[Vector, Vector], ...]
    """Signals u and y of each experiment; a missing y is NaN."""
    latest: int
    """Largest nk of a structure."""
    parameters: int
    """Largest number of parameters b and f of a structure."""

    def orders(self, candidates: Iterable[int]) -> list[int]:
        """Return the candidates nf = nb with few enough parameters."""
        return [n for n in candidates if 2 * n <= self.parameters]

    def require_samples(self, past: int = 0) -> None:
        """Refuse data whose experiments are too short for the lowest order of `_FIRST_ORDERS`."""
        needed = past + self.latest + 3 * (2 * _FIRST_ORDERS[0] + _EXTRA_COEFFICIENTS)
        longest = max(y.size for _, y in self.parts)
        require_samples("an experiment for structure hints", needed=needed, got=longest)

    def filtered(self, D: Vector) -> _SharedSamples:
        """Return the signals D u and D y, without the samples that need values before the start."""
        p = D.size - 1
        parts = [
            (apply_filter(D, [1.0], u)[p:], apply_filter(D, [1.0], y)[p:]) for u, y in self.parts
        ]
        return replace(self, parts=tuple(part for part in parts if part[1].size))

    def problem(self, s: Recommended) -> PolynomialProblem:
        """Return the estimation problem, with u shifted by its delay.

        Without the shift, unknown samples of u before the start would be estimated.
        """
        d, cut = max(s.nk - 1, 0), self.latest - 1
        letter: Literal["f", ""] = "f" if s.integrator else ""
        n = Structure(
            nb=(s.nb,), nf=(s.nf - s.integrator,), nk=(s.nk - d,), integrator=letter, offset=True
        )
        parts = [(u[cut - d : u.size - d], y[cut:]) for u, y in self.parts if cut < y.size]
        each = tuple((prepare(u, y, n),) for u, y in parts)
        return PolynomialProblem(experiments=each, rows=(n,))


def process_forms(poles: NDArray[Any], *, nk: int, integrator: bool) -> dict[int, str]:
    """Return the forms of process models by their number of time constants, for poles in z.

    A process model has the slowest of the poles, which do not contain the pole of an integrator. A
    process model with fewer poles has a dead time, which fast poles may imitate.
    """
    z = poles[(poles.real > 0) | (poles.imag != 0)].astype(np.complex128)  # others have no log
    z = z[np.argsort(np.abs(np.log(z)))]  # slowest first
    forms = {}
    for n in range(1, min(z.size, MAX_TIME_CONSTANTS) + 1):
        pairs, split = divmod(np.count_nonzero(z[:n].imag), 2)
        letters = {"D": nk > 1 or n < poles.size, "I": integrator, "U": pairs}
        if not split:
            forms[n] = f"P{n}{''.join(letter for letter, has in letters.items() if has)}"
    return forms


def recommend(
    data: Dataset, lags: Iterable[int], *, integrates: bool, decide: bool
) -> tuple[list[OutputErrorFit], bool, list[OutputErrorFit]]:
    """Return at most three models, best first, and whether the data decide on the integrator.

    The third result has the model with the shortest description for each number of poles.

    An autoregression 1/D describes the residuals of a first model, so that the noise of the
    filtered signals D u and D y is white. The output-error estimate then maximises the likelihood,
    and the description length (MDL) distinguishes the orders. Each order is fitted at the given
    lags, the likeliest first, and at the lags that ARX models prefer. If `decide` is True, the
    description length may decide against `integrates`, or for neither.
    """
    data = busiest(data)
    nks = [*dict.fromkeys([*lags, *_arx_lags(data)])][:_MAX_LAGS]
    # Each structure has an offset. Far from 0, y would lose digits in products with itself.
    parts = tuple((part.u, part.y - _level(part.y)) for part in data.experiments())
    many = max(excitation_order(data), _LEAST_PARAMETERS)
    record = _SharedSamples(parts=parts, latest=max(*nks, 1) + _EXTRA_COEFFICIENTS, parameters=many)
    record.require_samples()
    kinds = (False, True) if decide else (integrates,)
    first = [
        m for i in kinds for n in record.orders(_FIRST_ORDERS) for m in _full(record, n, nks, i)
    ]
    if not first:
        raise InputError("u excites no model of third order: play a telegraph or a PRBS")
    D = _join_scans([first])[0].noise()
    record.require_samples(past=D.size - 1)
    white = record.filtered(D)
    scans = [_refine(white, s) for i in kinds if (s := _scan_orders(white, nks, integrates=i))]
    C = _join_scans(scans)[0].noise()
    if C.size > 1:
        scans = [_refine(record.filtered(np.convolve(D, C)), s) for s in scans]
    ranked = _join_scans(scans)
    other = min((m.bits for m in ranked if m.structure.integrator != integrates), default=np.inf)
    is_clear = other - ranked[0].bits >= BARE
    chosen = _choose(scans, is_clear=is_clear)
    if not is_clear:
        chosen[:2] = sorted(chosen[:2], key=lambda m: m.structure.integrator != integrates)
    same = [m for m in ranked if m.structure.integrator == chosen[0].structure.integrator]
    shortest = {m.structure.nf: m for m in reversed(same)}
    return chosen, is_clear, [shortest[nf] for nf in sorted(shortest)]


def _level(y: Vector) -> float:
    """Return the median of the known values; 0 without one."""
    measured = y[np.isfinite(y)]
    return float(np.median(measured)) if measured.size else 0.0


def _choose(scans: list[list[OutputErrorFit]], *, is_clear: bool) -> list[OutputErrorFit]:
    """Return at most three structures with the shortest description lengths."""
    ranked = min(scans, key=lambda s: s[0].bits) if is_clear else _join_scans(scans)
    two = ranked[:2] if is_clear else _join_scans([s[:1] for s in scans])
    full = [m for m in ranked if is_clear and m.structure.nb == m.structure.nf]
    return [*dict.fromkeys([*two, *full[:1], *ranked])][:RECOMMENDED]


def _join_scans(scans: Iterable[list[OutputErrorFit]]) -> list[OutputErrorFit]:
    """Return the structures of all scans, least description length first."""
    return sorted(chain.from_iterable(scans), key=_rank)


def _rank(model: OutputErrorFit) -> tuple[float, int, int, int]:
    """Return the description length; among models without errors, the simplest is first."""
    s = model.structure
    return model.bits, s.nf, s.nb, s.nk


def busiest(data: Dataset) -> Dataset:
    """Return the data; if the data are long, return only the part in which u changes most."""
    if data.N <= _MAX_SAMPLES:
        return data
    moves = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(data.u, prepend=data.u[0])))])
    begins = np.linspace(0, data.N - _MAX_SAMPLES, 8).astype(int)
    begin = int(begins[np.argmax(moves[begins + _MAX_SAMPLES] - moves[begins])])
    return data[begin : begin + _MAX_SAMPLES]


def _arx_lags(data: Dataset) -> list[int]:
    """Return the nk of the best ARX model, then the nk of the best ARX model of each order."""
    latest = min(_MAX_LAG, max(data.N // 10, 1))
    try:
        table: Any = select_orders(data, _ARX_ORDERS, _ARX_ORDERS, range(1, latest + 1))
    except ValueError:
        return []
    bits, delays = np.nan_to_num(table.mdl, nan=np.inf), []
    for n in reversed(_ARX_ORDERS):
        rows = np.flatnonzero((table.na == n) & (table.nb == n))
        delays.append(int(table.nk[rows[np.argmin(bits[rows])]]))
    return [int(table.nk[np.argmin(bits)]), *delays]


def _scan_orders(
    record: _SharedSamples, nks: list[int], *, integrates: bool
) -> list[OutputErrorFit]:
    """Return structures with nb = nf of all orders, least description length first."""
    scan, least = list[list[OutputErrorFit]](), [np.inf]
    for nf in record.orders(range(1, HIGHEST + 1)):
        models = _full(record, nf, nks, integrates)
        scan.append(models)
        least.append(min((m.bits for m in models), default=np.inf))
        if min(least[-2:]) > min(least[:-2], default=np.inf):
            break
    return _join_scans(scan)


def _full(
    record: _SharedSamples, nf: int, nks: list[int], integrates: bool
) -> list[OutputErrorFit]:
    """Return models with nb = nf at the likeliest lag, and at the two lags of least start cost."""
    structures = [Recommended(nb=nf, nf=nf, nk=k, integrator=integrates) for k in nks]
    begun = [start for s in structures if (start := _start(record, s))]
    likeliest = (*begun[:1], *sorted(begun[1:], key=itemgetter(0))[:2])
    return [model for start in likeliest if (model := _fit(*start[1:]))]


def _refine(record: _SharedSamples, ranked: list[OutputErrorFit]) -> list[OutputErrorFit]:
    """Fit structures one by one, until all neighbours of the best three are fitted."""
    shortest = {m.structure.nf: m for m in reversed(ranked)}
    models: dict[Recommended, OutputErrorFit | None] = {}
    coming = [m.structure for m in (*ranked[:RECOMMENDED], *shortest.values())]
    while coming:
        starts = {s: _start(record, s) for s in dict.fromkeys(coming)}
        models |= {s: _fit(*start[1:]) if start else None for s, start in starts.items()}
        fitted = _join_scans([[m for m in models.values() if m]])
        if not fitted:
            return ranked
        first = fitted[:RECOMMENDED]
        near = (s for m in first for s in _neighbours(m.structure) if s not in models)
        coming = [s for s in near if s.nb + s.nf <= record.parameters]
    return fitted


def _neighbours(s: Recommended) -> Iterator[Recommended]:
    """Yield structures that differ from s by at most 1 in nf, nb, and B's first and last lag."""
    for poles, first, last in product((-1, 0, 1), repeat=3):
        nb, nf, nk = s.nb + first + last, s.nf + poles, s.nk - first
        if abs(first + last) <= 1 and nb >= 1 and 1 <= nf <= HIGHEST and nk >= min(s.nk, 1):
            yield replace(s, nb=nb, nf=nf, nk=nk)


def _start(
    record: _SharedSamples, s: Recommended
) -> tuple[float, Recommended, PolynomialProblem, Vector] | None:
    """Return the start value f of least cost; None if there is none."""
    if s.nk > record.latest:
        return None
    problem = record.problem(s)
    try:
        starts = [f for _, f in start_values(problem)]
        costs = [max(problem.cost(f), _least_cost(problem)) for f in starts]
        priced = [(cost, s, problem, f) for cost, f in zip(costs, starts, strict=True)]
    except (ValueError, np.linalg.LinAlgError):
        return None
    return min(priced, key=itemgetter(0))


def _rounding(problem: PolynomialProblem) -> float:
    """Return the standard deviation of rounding errors, in the unit of the filtered y."""
    return rounding_std(*(x.y[x.rows] for (x,) in problem.experiments), share=SEARCH_SHARE)


def _least_cost(problem: PolynomialProblem) -> float:
    """Return the cost below which rounding errors decide between two models."""
    rows = sum(int(np.count_nonzero(x.rows)) for (x,) in problem.experiments)
    return rows * _rounding(problem) ** 2


def _fit(s: Recommended, problem: PolynomialProblem, f: Vector) -> OutputErrorFit | None:
    """Return the model that a search from f finds; None if there are too few residuals."""
    N = sum(int(np.count_nonzero(x.rows)) for (x,) in problem.experiments)
    if 3 * (s.nb + s.nf) >= N:
        return None
    end = problem.minimise(f, most=_MAX_STEPS)
    past = sum(past.rank for past in problem.solve(end.theta).past)
    if past + s.nb + s.nf >= N:
        return None
    return OutputErrorFit(structure=s, problem=problem, f=end.theta, cost=end.cost, past=past, N=N)
