"""The search finds the lowest minimum, and reports its way."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation import prediction_error, search, start_values
from armrig.estimation.arx import arx
from armrig.estimation.polynomial_structures import bj
from armrig.estimation.problem import PolynomialProblem
from armrig.estimation.search import search_minima
from armrig.estimation.start_values import (
    Path,
    armax_start,
    equation_error,
    noise_start,
    steiglitz_mcbride,
)
from armrig.excitation import telegraph
from armrig.models.innovations import prepare
from armrig.models.structure import Structure
from armrig.numerics.levenberg_marquardt import FIRST_DAMPING, Optimum, levenberg_marquardt
from armrig.numerics.polynomial import EDGE_MODULUS, apply_filter, roots
from numpy.typing import NDArray

from tests.plants import drawn_model, estimated_model
from tests.sampling import sampled

BJ = Structure(nb=(4,), nc=2, nd=2, nf=(4,), nk=(1,))


def resonant(rng: np.random.Generator, pairs: int, low: float, high: float) -> NDArray[np.float64]:
    """Return a polynomial with so many pairs of complex roots."""
    z = rng.uniform(low, high, pairs) * np.exp(1j * rng.uniform(0.1, 2.8, pairs))
    return np.real(np.poly([*z, *z.conj()]))


def hard(seed: int) -> tuple[Dataset, NDArray[np.float64]]:
    """Return a random Box-Jenkins system of fourth order at 0 dB, and its (c, d, f)."""
    rng = np.random.default_rng([seed, 2026])
    F = resonant(rng, 2, 0.7, 0.98)
    clean_B = np.append(0.0, rng.standard_normal(4))
    u = telegraph(2000, 0.3, 1.5, 3.5, seed=rng) - 2.5
    clean = apply_filter(clean_B, F, u)
    C, D = resonant(rng, 1, 0.5, 0.9), resonant(rng, 1, 0.5, 0.9)
    v = apply_filter(C, D, rng.standard_normal(2000))
    v *= np.std(clean) / np.std(v)
    return Dataset(u=u, y=clean + v, Ts=1), np.concatenate([C[1:], D[1:], F[1:]])


def problem_of(data: Dataset, structure: Structure) -> PolynomialProblem:
    return PolynomialProblem(
        experiments=((prepare(data.u, data.y, structure),),), rows=(structure,)
    )


@pytest.mark.exhaustive
def test_a_mode_that_fits_noise_is_moved_to_the_lowest_minimum() -> None:
    """Every start ends 6 % above the loss of the truth; the lowest minimum is near."""
    data, truth = hard(11)
    lowest = problem_of(data, BJ).minimise(truth).cost / data.N

    fit = bj(data, nb=4, nc=2, nd=2, nf=4)

    assert fit.loss <= lowest * (1 + 1e-6)
    assert fit.search.starts[0].name == "mode at another frequency"
    assert all(s.loss > 1.01 * lowest for s in fit.search.starts[1:])
    assert not fit.search.agreed
    assert any("poorer minimum" in w for w in fit.warnings)


def test_a_minimum_is_uncertain_in_strong_noise_or_a_thorough_search() -> None:
    """With more than 30 coefficients it never is: a round of moved modes would take a minute."""
    rng = np.random.default_rng(1)
    u, e = rng.standard_normal((2, 400))
    y = apply_filter([0, 1, 0.5], [1, -1.2, 0.6], u)
    few = Structure(nb=(2,), nf=(2,), nk=(1,))
    clear, noisy = (problem_of(Dataset(u=u, y=y + k * e, Ts=1), few) for k in (0.1, 4.0))
    many = problem_of(Dataset(u=u, y=y + 4.0 * e, Ts=1), replace(few, nb=(31,), nf=(31,)))

    doubtful = [
        search._doubtful(problem, search.from_starts(problem), strict=strict)
        for problem, strict in ((clear, False), (clear, True), (noisy, False))
    ]

    assert doubtful == [False, True, True]
    assert not search._doubtful(many, [], strict=True)


@pytest.mark.exhaustive
def test_a_search_that_starts_on_a_part_ends_at_the_minimum_of_all_data() -> None:
    rng = np.random.default_rng(2)
    N = 2 * prediction_error.PART_SAMPLES + 1000
    u = telegraph(N, 0.3, 1.5, 3.5, seed=rng) - 2.5
    u[: N // 2] = 1.0  # nothing moves in the first half
    e = 0.5 * apply_filter([1, 0.5], [1, -0.7], rng.standard_normal(N))
    data = Dataset(u=u, y=apply_filter([0, 1, 0.5], [1, -1.2, 0.6], u) + e, Ts=1)
    structure = Structure(nb=(2,), nc=1, nd=1, nf=(2,), nk=(1,))
    whole, part = problem_of(data, structure), prediction_error._part(data, [structure], (0,))

    by_part, at_once = search_minima(whole, part), search_minima(whole)

    assert part is not None
    np.testing.assert_allclose(by_part[0][1].theta, at_once[0][1].theta, rtol=1e-7)
    assert {name for name, _ in by_part} == {name for name, _ in at_once}


@pytest.mark.exhaustive
def test_all_minima_on_a_part_are_continued_on_all_data() -> None:
    """A part of the data may mislead; the whole decides."""
    data, _ = hard(87)
    whole = problem_of(data, BJ)
    part = problem_of(data[:500], replace(BJ, at_rest=False))

    ends = search_minima(whole, part)

    assert len(ends) >= 3
    costs = [end.cost for _, end in ends]
    assert costs == sorted(costs)
    assert all(end.cost == pytest.approx(whole.cost(end.theta), rel=1e-9) for _, end in ends)


def test_the_steps_on_a_part_count_among_those_of_a_start() -> None:
    """The search on the whole begins where the search on the part ended."""
    data, _ = hard(87)
    structure = Structure(nb=(2,), nf=(2,), nk=(1,))
    whole = problem_of(data[:400], structure)
    part = problem_of(data[:200], replace(structure, at_rest=False))

    on_part = {name: end.iterations for name, end in search.from_starts(part)}
    through = dict(search._through(part, whole))

    assert through.keys() == on_part.keys()
    assert all(through[name].iterations > on_part[name] for name in on_part)


def test_the_lowest_of_the_moved_modes_are_searched_to_their_end() -> None:
    """After ten steps 16 of 20 searches go on, with their damping; another one had returned."""
    best = Optimum(theta=np.array([-1.0]), cost=50.0, iterations=1, converged=True)
    starts = [np.array([float(k)]) for k in np.random.default_rng(1).permutation(20)]
    asked: dict[int, list[float]] = {}

    def minimise(theta: NDArray[np.float64], most: int = 0, **limits: Any) -> Optimum:
        asked.setdefault(most, []).append(float(theta[0]))
        back = theta[0] == 3
        cost = 50.0 + 3e-6 if back else 48.5 + theta[0] - (most > 10) - 2 * (most == 0)
        assert limits.get("damping") == {10: FIRST_DAMPING, 40: theta[0]}.get(most)
        assert most == 0 or limits["best"] is best.theta
        found = Optimum(theta=theta, cost=cost, iterations=most - back, converged=most == 0)
        return replace(found, damping=float(theta[0]))

    problem: Any = SimpleNamespace(minimise=minimise)
    lowest = search.lowest_beside(problem, best, starts)

    assert sorted(asked[10]) == [float(k) for k in range(20)]
    assert asked[40] == [float(k) for k in range(17) if k != 3]
    assert asked[0] == [0.0]
    assert (lowest.theta[0], lowest.cost) == (0.0, 46.5)


@pytest.mark.parametrize("third", [3.0, 2.99])
def test_modes_are_moved_as_long_as_the_cost_falls_by_more_than_chance(
    monkeypatch: pytest.MonkeyPatch, third: float
) -> None:
    """The best end is the first, and each round begins at it."""
    costs = iter([4.0, 3.0, third, 1.0])
    begun: list[float] = []

    def end(cost: float) -> Optimum:
        return Optimum(theta=np.zeros(1), cost=cost, iterations=1, converged=True)

    def lowest(_: Any, best: Optimum, **__: Any) -> Optimum:
        begun.append(best.cost)
        return end(next(costs))

    monkeypatch.setattr(search, "from_starts", lambda _: [("ARX", end(5.0))])
    monkeypatch.setattr(search, "_doubtful", lambda *_, **__: True)
    monkeypatch.setattr(search, "_noise_matters", lambda *_: True)
    monkeypatch.setattr(search, "_lowest_without_gaps", lowest)
    problem: Any = SimpleNamespace(experiments=(), N=1000)

    found = search_minima(problem)

    moved = "mode at another frequency"
    lower = [(moved, third)] if third < 3 else []
    assert [(name, x.cost) for name, x in found] == [
        *lower,
        (moved, 3.0),
        (moved, 4.0),
        ("ARX", 5.0),
    ]
    assert begun == [5.0, 4.0, 3.0]


def test_a_later_search_may_end_above_the_least_cost() -> None:
    targets: list[float] = []

    def minimise(theta: NDArray[np.float64], earlier_cost: float, target: float) -> Optimum:
        targets.append(target)
        return Optimum(theta=theta, cost=float(theta[0]), iterations=1, converged=True)

    problem: Any = SimpleNamespace(cost=lambda theta: float(theta[0]), minimise=minimise)
    search.from_each(problem, [("OE", np.array([3.0])), ("ARX", np.array([2.0]))], 1e-4)

    assert targets == pytest.approx([np.nan, 2.0002], nan_ok=True)


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_modes_of_c_and_d_are_moved_in_coloured_noise_only(pole: float) -> None:
    rng = np.random.default_rng(1)
    u = np.cumprod(np.where(rng.random(400) < 0.2, -1.0, 1.0))
    noise = apply_filter([1.0], [1.0, -pole], 0.3 * rng.standard_normal(u.size))
    data = Dataset(u=u, y=apply_filter([0, 0.5, 0.3], [1, -1.2, 0.6], u) + noise, Ts=1.0)
    problem = problem_of(data, Structure(nb=(2,), nc=1, nd=1, nf=(2,), nk=(1,)))

    (_, best), *_ = search.from_starts(problem)

    assert search._noise_matters(problem, best) == (pole > 0)


def test_real_roots_of_c_and_d_move_together_inside_the_circle() -> None:
    """Each is moved to five values and the other near it, and the six of least cost are kept."""
    C, D, F = np.poly([0.2, 0.5 + 0.3j, 0.5 - 0.3j]).real, np.array([1.0, -0.7]), np.array([1, 0.4])
    moved: list[NDArray[np.float64]] = []

    def cost(theta: NDArray[np.float64]) -> float:
        moved.append(theta)
        return float(-np.abs(roots(np.append(1.0, theta[:3]))).max())

    parts = {"c": slice(0, 3), "d": slice(3, 4)}
    problem: Any = SimpleNamespace(slice_of=lambda letter, _: parts[letter], rows=[0], cost=cost)

    each = search._starts_with_close_roots(problem, np.concatenate([C[1:], D[1:], F[1:]]))
    starts = search.cheapest(problem, each, 6)

    assert len(moved) == 2 * len(search._REAL_ROOTS)
    assert len(starts) == 6
    pairs = set()
    for theta in moved:
        z = roots(np.append(1.0, theta[:3]))
        near = float(z[np.argmin(np.abs(z.imag))].real)
        pairs.add((round(near, 3), round(-float(theta[3]), 3)))
        assert theta[4] == 0.4
    assert pairs == {
        (round(float(np.clip(root * share, -0.998, 0.998)), 3), root)
        for root in search._REAL_ROOTS
        for share in (0.9, 1 / 0.9)
    }
    assert max(abs(roots(np.append(1.0, starts[0][:3])))) == pytest.approx(0.998)


def test_modes_are_moved_one_at_a_time() -> None:
    """A pair, or the two smallest real roots, gives way to a pair or to two real roots."""
    pair, reals = np.array([0.5 + 0.4j, 0.5 - 0.4j]), np.array([0.9, -0.2, 0.4])
    z = np.concatenate([pair, reals])

    kept = [set(np.round(x, 9).tolist()) for x in search._without_one_pair(z)]
    alone = [set(np.round(x, 9).tolist()) for x in search._without_one_real(z)]

    assert kept == [{0.9, -0.2, 0.4}, {*pair.tolist(), 0.9}]
    assert alone == [{*pair.tolist(), *reals.tolist()} - {x} for x in reals]
    others = list(search.other_pairs(z))
    assert len(others) == 2 * 3 * 15
    assert all(
        np.real(np.poly(x)).size == 6 and np.abs(np.poly(x).imag).max() < 1e-12 for x in others
    )
    assert len(list(search.other_real(z))) == 3 * 6
    assert len(list(search._other_reals(z))) == 2 * 15


def test_denominators_of_a_start_are_stable_though_the_data_grow() -> None:
    u = np.random.default_rng(2).standard_normal(80)
    parts = ((u[:, None], apply_filter([0, 1.0], [1, -1.1, 0.05], u)),)
    path = Path(parts=parts, lags=(range(1, 2),), pulses=2)

    F = equation_error([path], np.ones(1), 2)
    found = list(steiglitz_mcbride([path], np.ones(1), 2, iterations=4))

    assert np.abs(roots(F)).max() > 1.04
    assert all(np.abs(roots(x)).max() < 1 for x in found)


def test_a_denominator_of_rounding_errors_is_one() -> None:
    u = np.random.default_rng(2).standard_normal(80)
    path = Path(parts=((u[:, None], 3e9 * u),), lags=(range(3),), pulses=2)

    np.testing.assert_array_equal(equation_error([path], np.ones(1), 2), [1.0, 0.0, 0.0])


@pytest.mark.parametrize("gaps", [[], [30], [30, 31, 60]])
def test_a_start_at_rest_reserves_no_samples_for_the_past(gaps: list[int]) -> None:
    """After a gap the state of the noise is predicted, not estimated."""
    u, y = np.random.default_rng(2).standard_normal((2, 80))
    whole = Dataset(u=u, y=y, Ts=1.0)
    data = whole.replaced(valid=~np.isin(np.arange(80), gaps), step=None)
    free = Structure(nf=(0,), na=2, nb=(1,), nc=1, nk=(1,))

    needed = {
        at_rest: [
            prediction_error.nuisance(problem_of(x, replace(free, at_rest=at_rest)))
            for x in (data, whole)
        ]
        for at_rest in (True, False)
    }

    assert needed[True] == [0, 0]
    assert needed[False] == [2, 2]


def test_the_noise_model_of_a_start_is_fitted_to_the_equation_error() -> None:
    """The noise is A y - B u, with A and B by least squares, where y is known."""
    rng = np.random.default_rng(5)
    u, e = rng.standard_normal((2, 300))
    y = apply_filter([0, 1.0], [1, -0.8], u) + apply_filter([1, 0.6], [1, -0.8], e)
    valid = np.arange(300) != 200
    data = Dataset(u=u, y=y, Ts=1.0, valid=valid)
    problem = problem_of(data, Structure(nf=(0,), na=1, nb=(1,), nc=1, nk=(1,)))

    theta = start_values._with_noise(problem, np.zeros(0))

    of_arx = arx(data, na=1, nb=1)
    v = apply_filter(of_arx.A, [1.0], y) - apply_filter(of_arx.B, [1.0], u)
    v[[0, 200, 201]] = np.nan
    C, _ = noise_start([v], nc=1, nd=0)
    assert problem.letters == ("a", "c")
    np.testing.assert_allclose(theta, [of_arx.A[1], C[1]], atol=0.02)
    assert theta[1] > 0.2


@pytest.mark.parametrize("nk", [1, 3])
def test_the_long_model_of_a_start_has_the_past_inputs(nk: int) -> None:
    """Without past inputs, the residuals of the long model would contain their effect."""
    rng = np.random.default_rng(5)
    u, e = rng.standard_normal((2, 4000))
    A, C = [1, -1.5, 0.7], [1, -0.7, 0.3]
    y = apply_filter([0] * nk + [1.0, 0.5], A, u) + apply_filter(C, A, 0.5 * e)
    problem = problem_of(
        Dataset(u=u, y=y, Ts=1.0), Structure(nf=(0,), na=2, nb=(2,), nc=2, nk=(nk,))
    )

    found = armax_start([x for (x,) in problem.experiments], problem.rows[0])

    for start, p in zip(found, (A, C), strict=True):
        np.testing.assert_allclose(start, p, atol=0.06)


@pytest.mark.parametrize("begin", [0, 3, 7])
def test_a_search_starts_on_the_part_in_which_the_input_moves_most(begin: int) -> None:
    """The part is one of eight, evenly spaced."""
    N, size = 7000, prediction_error.PART_SAMPLES
    at = int(np.linspace(0, N - size, 8).astype(int)[begin])
    u = 1e-3 * np.random.default_rng(1).standard_normal(N)
    u[at + 5 : at + size - 5] += np.arange(size - 10) % 2
    u[: at - 1] += 100.0
    y = np.arange(float(N))
    data = Dataset(u=u, y=y, Ts=1.0)

    part = prediction_error._part(data, [Structure(nb=(1,), nf=(1,), nk=(1,), at_rest=True)], (0,))

    assert part is not None
    [[x]] = part.experiments
    np.testing.assert_array_equal(x.y, y[at : at + size])
    assert not part.rows[0].at_rest
    assert prediction_error._part(data[: 2 * size], part.rows, (0,)) is None


@pytest.mark.parametrize(
    ("F", "free", "matters"), [(3.0, 90, False), (3.2, 90, True), (0.0, 92, True)]
)
def test_the_state_at_the_start_matters_from_the_5_per_cent_point_of_f_on(
    F: float, free: int, matters: bool
) -> None:
    """With 2 and 90 degrees of freedom it is 3.10; a state that costs nothing is kept."""

    def estimated(sse: float, degrees: int) -> Any:
        solution = SimpleNamespace(e=np.array([np.sqrt(sse)]), past=[SimpleNamespace(rank=2)])
        problem = SimpleNamespace(N=degrees + 6, rows=[0], solve=lambda _: solution)
        return SimpleNamespace(problem=problem, solution=solution, theta=np.zeros(0), parameters=4)

    of_free, at_rest = estimated(90.0, free), estimated(90.0 + 2 * F, 92)

    assert prediction_error._state_matters(of_free, at_rest) is matters


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("kind", "seed"),
    sampled(
        [("ARMAX", 177), ("OE", 6139), ("BJ", 38), ("BJ", 2048), ("OE", 1108), ("ARMAX", 193)], 2
    ),
)
def test_the_minimum_is_as_low_as_the_one_that_the_truth_leads_to(kind: str, seed: int) -> None:
    """Plants of the bank; only a larger model leads to the minimum of the last one."""
    data, n, truth, _ = drawn_model(kind, np.random.default_rng([seed, 3]))
    least = problem_of(data, n).minimise(truth).cost

    fit = estimated_model(kind, data, n)

    assert fit.loss * fit.N < least * (1 + 1e-4)


def test_a_search_follows_the_unit_circle() -> None:
    """C has a root on the circle; shortening each step would miss the other roots."""
    data, n, truth, _ = drawn_model("ARMAX", np.random.default_rng([1139, 3]))
    problem = problem_of(data, n)

    end = problem.minimise(truth)
    cut = levenberg_marquardt(problem.linearise, truth, admissible=problem.circle.admits)

    assert end.converged
    assert end.cost < (1 - 1e-3) * cut.cost
    assert np.abs(roots(np.append(1.0, end.theta))).max() == pytest.approx(EDGE_MODULUS)
