"""Searches and hints made by hand: tables, reasons, and the decisions before a search."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset, Signals
from armrig.estimation.request import Request
from armrig.models.structure_table import STRUCTURES
from armrig.numerics.criteria import batch_means
from armrig.numerics.whiteness import Whiteness
from armrig.validation import model_search
from armrig.validation.model_search import _rank_candidates
from armrig.validation.recommended_structures import OutputErrorFit, Recommended, busiest
from armrig.validation.search_result import Candidate, Scored, SearchResult, free_parameters
from armrig.validation.structure_hints import _confirm_slope, _extremes

from tests.clients.models.made_fits import made


def scored(family: str, order: int, **fields: Any) -> Scored:
    """Return a candidate with as many b's as poles."""
    poles = [1.0] + [0.1] * order
    p: dict[str, Any] = {"F": poles} if family in ("oe", "bj") else {"A": poles}
    fit = made(B=[0.0] + [1.0] * order, structure=family, **p, **fields)
    names: Any = {"oe": ("nb", "nf"), "n4sid": ("order",)}.get(family, ("na", "nb"))
    orders = dict.fromkeys(names, order)
    request = Request(structure=family, orders=orders)  # type: ignore[arg-type]
    name = STRUCTURES[family].short(orders | {"nk": 1})
    candidate = Candidate(name=name, order=order, request=request)
    return Scored(candidate=candidate, fit=fit, error=np.zeros(0), ahead=np.zeros(0))


_PASSED: Any = SimpleNamespace(
    powerless="",
    blind="",
    larger="",
    laws=(),
    missing_dynamics=0.5,
    feedback=0.5,
    white=Whiteness(p_value=0.5, test="portmanteau test"),
)


def result(**fields: Any) -> SearchResult:
    """Return a search whose third model is chosen."""
    values: dict[str, Any] = {
        "ranked": (scored("oe", 3), scored("arx", 4), scored("oe", 2), scored("arx", 1)),
        "rms": np.array([0.5, 0.51236, 0.52, 0.9]),
        "excess": np.array([0.0, 0.0125, 0.02, 0.56]),
        "excess_std": np.array([0.0, 0.02, 0.03, 0.1]),
        "as_good": np.array([True, True, True, False]),
        "chosen_index": 2,
        "failed": {},
        "doubts": (),
        "notes": (),
        "halved": False,
        "tests": _PASSED,
        "horizon": None,
        "unit": "rad/s",
    }
    return SearchResult(**(values | fields))


@pytest.mark.parametrize("asked", [None, False, True])
def test_an_offset_is_estimated_if_one_of_the_data_sets_has_a_level(
    asked: bool | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    flat, high = (Dataset(u=[0.0, 1.0], y=[level, level], Ts=1.0) for level in (0.0, 5.0))

    def level_of(data: Signals, *_: float) -> Any:
        return SimpleNamespace(text=f"y is about {data.y[0, 0]:g}") if data.y[0, 0] else None

    monkeypatch.setattr(model_search, "level_without_input", level_of)

    for data, validation in ((flat, flat), (high, flat), (flat, high), (high, high)):
        offset, notes = model_search._offset(data, validation, asked, ("arx", "oe", "bj"))

        has = data is high or validation is high
        assert offset == (has if asked is None else asked)
        assert len(notes) == (has and asked is not False)
        if notes:
            where = "in the validation data " if data is flat else ""
            assert notes == [f"{where}y is about 5: OE, BJ can estimate it (option offset)"]
            _, [note] = model_search._offset(data, validation, asked, ("arx",))
            assert note == f"{where}y is about 5: remove the means (detrend)"


@pytest.mark.parametrize("outputs", [1, 2])
def test_models_are_ranked_at_the_samples_that_all_of_them_predict(outputs: int) -> None:
    """The errors of several outputs are divided by the deviations of the outputs, and added."""
    rng = np.random.default_rng(2)
    N = 120
    y = rng.standard_normal((N, outputs)) * [1.0, 3.0][:outputs]
    signals = Signals(u=np.zeros((N, 2)), y=y, Ts=1.0)
    validation = Dataset(u=np.zeros(N), y=y[:, 0], Ts=1.0) if outputs == 1 else signals
    std = np.std(y, axis=0) if outputs > 1 else np.ones(1)
    errors = [rng.standard_normal((N, outputs)) * size for size in (2.0, 1.0, 1.02)]
    errors[0][:10, 0], errors[1][5:20], errors[2][0, 0] = np.nan, np.nan, 1e6
    shaped = [e[:, 0] if outputs == 1 else e for e in errors]
    pairs = zip((3, 4, 1), shaped, strict=True)
    candidates = [replace(scored("oe", n), error=e, ahead=e) for n, e in pairs]

    ranked, columns, _ = _rank_candidates(candidates, validation)
    rms, excess_, excess_std, _ = columns.values()

    both = np.isfinite(errors).all(axis=0)
    squares = {
        n: np.sum(np.where(both, e / std, 0.0) ** 2, axis=1)[both.any(axis=1)]
        for n, e in zip((3, 4, 1), errors, strict=True)
    }
    order = sorted(squares, key=lambda n: squares[n].mean())
    assert [j.candidate.order for j in ranked] == order
    np.testing.assert_allclose(rms, [np.sqrt(squares[n].mean()) for n in order])
    excess = [squares[n].mean() - squares[order[0]].mean() for n in order]
    np.testing.assert_allclose(excess_, excess)
    d = squares[order[1]] - squares[order[0]]
    means = np.asarray(batch_means(d))
    batches = [means, means.reshape(-1, 2).mean(axis=1), means[:28].reshape(-1, 4).mean(axis=1)]
    expected = max(m.std(ddof=1) / np.sqrt(m.size) for m in batches)
    assert excess_std[1] == pytest.approx(expected)
    assert excess_std[0] == pytest.approx(1e-6 * rms[0] ** 2)


@pytest.mark.parametrize(("rate", "chosen"), [(1.0, 1), (2.0, 0)])
def test_of_equally_good_simulations_the_best_predictor_is_chosen(rate: float, chosen: int) -> None:
    """The errors one step ahead of the simpler model are `rate` times those of the other."""
    rng = np.random.default_rng(4)
    judged = Dataset(u=np.zeros(300), y=rng.standard_normal(300), Ts=1.0)
    first, second, e = rng.standard_normal((3, 300))
    second *= np.sqrt(1.01 * np.sum(first**2) / np.sum(second**2))
    errors = {3: (first, e), 1: (second, rate * e)}
    candidates = [replace(scored("oe", n), error=x, ahead=a) for n, (x, a) in errors.items()]

    ranked, columns, index = _rank_candidates(candidates, judged)

    assert index == chosen
    found = result(ranked=tuple(ranked), chosen_index=index, **columns)
    told = "simpler models are as good, but predict worse one step ahead"
    assert (told in found.reasons) == (index == 0)


@pytest.mark.parametrize(
    ("std", "count", "chosen"),
    [(0.5, 8, 0), (10.0, 8, 1), (10.0, 20, 0)],
    ids=["3 points lower", "as good", "1.8 times the error"],
)
def test_a_simpler_model_is_chosen_only_if_its_error_is_hardly_larger(
    std: float, count: int, chosen: int
) -> None:
    """Both are within one standard error, since they differ in a few samples only."""
    rare, y = np.zeros(600), np.resize([std, -std], 600)
    rare[300 : 300 + count] = 1.0  # rms .12 or .18
    errors = {3: np.full(600, 0.1), 1: rare}
    candidates = [replace(scored("oe", n), error=e, ahead=np.ones(600)) for n, e in errors.items()]

    _, columns, found = _rank_candidates(candidates, Dataset(u=y, y=y, Ts=1.0))

    assert columns["excess"][1] < columns["excess_std"][1]
    assert found == chosen


def test_models_without_a_sample_in_common_are_not_compared() -> None:
    errors = [0.1, np.nan], [np.nan, 0.1]
    candidates = [replace(scored("arx", 1), error=np.array(e), ahead=np.ones(2)) for e in errors]

    with pytest.raises(ValueError, match="no validation sample is predicted by all models"):
        _rank_candidates(candidates, Dataset(u=[0.0, 0.0], y=[1.0, 1.0], Ts=1.0))


def fitted(B: Any, F: Any, *, integrator: bool = False) -> OutputErrorFit:
    """Return a model of nk = 0; F is without the integrator."""
    problem: Any = SimpleNamespace(solve=lambda _: SimpleNamespace(ab=np.array(B)))
    s = Recommended(nb=1, nf=1, nk=0, integrator=integrator)
    return OutputErrorFit(structure=s, problem=problem, f=np.array(F[1:]), cost=1.0, past=0, N=1)


def test_a_slope_is_reported_if_the_model_has_it_to_3_db_a_decade() -> None:
    """An integrator of Ts 0.01 s: -20 dB a decade at 1 to 3 rad/s."""
    best, omega = fitted([0, 0.01], [1.0], integrator=True), np.array([1.0, 2.0, 3.0])

    assert _confirm_slope(-17.1, best, omega, 0.01) == -17.1
    assert _confirm_slope(-22.9, best, omega, 0.01) == -22.9
    assert _confirm_slope(-16.9, best, omega, 0.01) is None
    assert _confirm_slope(-23.1, best, omega, 0.01) is None
    np.testing.assert_allclose(np.abs(best.G(omega, 0.01)), 1 / omega, rtol=1e-3)


@pytest.mark.parametrize("integrator", [False, True])
def test_the_extremes_of_a_model_are_those_of_its_roots(integrator: bool) -> None:
    poles, zeros = (np.exp(w * 0.01 * 1j) * r for w, r in ((20.0, 0.99), (40.0, 0.995)))
    B, F = (np.real(np.poly([z, z.conjugate()])) for z in (zeros, poles))
    best = fitted([0, 0, *B], F, integrator=integrator)

    found = _extremes(best, np.array([1.0, 200.0]), 0.01)

    np.testing.assert_allclose(found, [[20.0], [40.0]], rtol=0.02)
    assert _extremes(best, np.array([1.0, 10.0]), 0.01) == [(), ()]
    assert _extremes(best, np.zeros(0), 0.01) == [(), ()]


def test_long_data_are_shortened_to_the_part_with_input_changes() -> None:
    N = 9000
    u = np.zeros(N)
    u[5000:7500] = np.where(np.arange(2500) % 10 < 5, 1.0, -1.0)
    data = Dataset(u=u, y=np.arange(N, dtype=float), Ts=1.0)

    cut = busiest(data)

    assert cut.N == 3000
    assert cut.y[0] == 5142  # the sixth of eight begins from 0 to 6000
    assert busiest(data[:3000]).N == 3000


@pytest.mark.parametrize(("direct", "free"), [(False, 3 * (2 + 6)), (True, 3 * (2 + 6) + 6)])
def test_the_coordinates_of_the_state_do_not_count_as_parameters(direct: bool, free: int) -> None:
    """Three states, two inputs, three outputs."""
    D = np.full((3, 2), float(direct))
    matrices = np.zeros((3, 3)), np.zeros((3, 2)), np.zeros((3, 3)), D, np.zeros((3, 3))
    fit: Any = SimpleNamespace(
        structure="ss", theta=np.zeros(99), ny=3, nu=2, state_space=lambda: matrices
    )

    assert free_parameters(fit) == free
    assert free_parameters(SimpleNamespace(structure="oe", theta=np.zeros(7), ny=2, nu=1)) == 7  # type: ignore[arg-type]
