"""Requests and orders of several signals: the arguments of each channel, plans and tables."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import armrig
import numpy as np
import pytest
from armrig import Signals
from armrig.estimation.multivariable import search
from armrig.estimation.multivariable.armax import _require_complete
from armrig.estimation.multivariable.order_table import select_orders
from armrig.estimation.multivariable.orders import as_text, by_channel, by_output, by_pair
from armrig.estimation.multivariable.plans import integrating_outputs, plans_of
from armrig.estimation.multivariable.problem import Row, row_data
from armrig.estimation.multivariable.request import SignalsRequest
from armrig.estimation.multivariable.start_values import _differenced
from armrig.numerics.polynomial import Array, filtered, lagged
from armrig_core.errors import InputError


def signals(N: int = 120, seed: int = 1, Ts: float = 0.5) -> Signals:
    """Return two experiments with the outputs a, b and c and the inputs u and v."""
    rng = np.random.default_rng(seed)
    u, y = rng.standard_normal((N, 2)), rng.standard_normal((N, 3))
    y[1:, 0] += u[:-1, 0]
    y[3:, 1] += u[:-3, 1]
    return Signals(
        u=u, y=y, Ts=Ts, starts=(0, N // 3), outputs=["a", "b", "c"], inputs=["u", "v"],
        valid=np.arange(3 * N).reshape(N, 3) % 41 > 0,
    )  # fmt: skip


def each(a: int, b: int, c: int) -> dict[tuple[str, str], int]:
    return {(y, u): n for y, n in zip("abc", (a, b, c), strict=True) for u in "uv"}


@pytest.mark.parametrize(
    ("structure", "orders", "options", "expected"),
    [
        ("arx", {"na": 3, "nb": 2}, {"nk": 0}, {"na": 3, "nb": 2, "nk": 0}),
        (
            "oe",
            {"nb": 3, "nf": 2},
            {"integrating": ("b",)},
            {"nb": each(2, 3, 2), "nf": each(1, 2, 1), "integrator": ("b",), "shared": ""},
        ),
        (
            "oe",
            {"nb": 3, "nf": 2},
            {"integrating": ("a", "c"), "shared": True},
            {"nb": each(3, 2, 3), "nf": 1, "integrator": ("a", "c"), "shared": "denominator"},
        ),
        (
            "armax",
            {"na": 3, "nb": 2, "nc": 1},
            {"integrating": ("a",), "nk": 2},
            {
                "na": {"a": 3, "b": 2, "c": 2},
                "nb": each(2, 1, 1),
                "nc": 1,
                "nk": 2,
                "integrator": ("a",),
                "shared": "",
            },
        ),
        (
            "oe",
            {"nb": 1, "nf": 1},
            {"integrating": tuple("abc")},
            {"nb": each(1, 1, 1), "nf": each(1, 1, 1), "integrator": tuple("abc"), "shared": ""},
        ),
        ("ss", {"order": None}, {}, {"noise": True}),
        ("ss", {"order": 4}, {"noise": False}, {"order": 4, "noise": False}),
        ("n4sid", {"order": 4}, {}, {"order": 4, "weights": "cva"}),
        ("n4sid", {"order": 4}, {"weights": "moesp"}, {"order": 4, "weights": "moesp"}),
    ],
)
def test_an_output_that_does_not_integrate_has_one_root_less(
    structure: Any, orders: Any, options: dict[str, Any], expected: dict[str, Any]
) -> None:
    found = SignalsRequest(structure=structure, orders=orders, **options).arguments(signals())

    assert found == {"nk": 1} | expected
    takes = {"nb", "nf", "na", "nc"} & found.keys()
    assert {name: type(found[name]) for name in takes} == {
        name: type(expected[name]) for name in takes
    }


def test_an_order_without_a_free_coefficient_is_refused() -> None:
    of = {"structure": "oe", "integrating": ("b",)}
    request: Any = SignalsRequest(orders={"nb": 2, "nf": 1}, **of)  # type: ignore[arg-type]

    with pytest.raises(InputError) as refused:
        request.arguments(signals())

    assert str(refused.value) == (
        "nf=1 leaves no coefficient for a, c, because nf also counts the integrator of b; give "
        "nf >= 2"
    )
    high: Any = SignalsRequest(orders={"nb": 7, "nf": 7}, **of)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="13 parameters from 120 samples; at most 12 parameters"):
        high.arguments(signals())


def test_only_an_output_that_integrates_needs_all_its_values() -> None:
    data = signals()
    valid = np.ones((120, 3), bool)
    valid[[5, 9, 70], 1] = False
    holed = Signals(u=data.u, y=np.nan_to_num(data.y), Ts=0.5, valid=valid, outputs=data.outputs)

    _require_complete(holed, (True, False, True))
    with pytest.raises(InputError, match=r"^3 values of b are missing, and armax"):
        _require_complete(holed, (False, True, False))


def test_orders_are_given_by_a_number_an_array_or_names() -> None:
    data = signals()
    rows = [[1, 2], [3, 4], [5, 6]]
    named = {(y, u): rows[i][j] for i, y in enumerate("abc") for j, u in enumerate("uv")}

    for value in (rows, np.array(rows), named, dict(reversed(named.items()))):
        assert by_channel("nb", value, data, least=1).tolist() == rows
    assert by_channel("nk", {("b", "v"): 0, ("c", "u"): 3}, data, least=0).tolist() == [
        [1, 1], [1, 0], [3, 1],
    ]  # fmt: skip
    pairs = {(y, z): 10 * i + k for i, y in enumerate("abc") for k, z in enumerate("abc")}
    assert by_pair("na", pairs, data, least=0).tolist() == [[0, 1, 2], [10, 11, 12], [20, 21, 22]]
    assert by_output("nc", {"b": 2, "a": 1, "c": 0}, data, least=0).tolist() == [1, 2, 0]
    assert by_output("nc", [1, 2, 0], data, least=0).tolist() == [1, 2, 0]
    assert by_output("nc", 2, data, least=0).tolist() == [2, 2, 2]
    assert (
        as_text(na=np.array([[2, 2], [2, 2]]), nb=np.array(rows)) == "na=2, nb=[[1,2],[3,4],[5,6]]"
    )
    for value, told in (
        ({"b": 2, "a": 1}, "nc: 'c' is not named; name each of 'a', 'b', 'c'"),
        ([1, 2], r"nc needs 3 orders, one for each output, got \[1, 2\]"),
        (-1, "nc: -1 must be an integer >= 0"),
        (True, "nc: True must be an integer >= 0"),
    ):
        with pytest.raises(InputError, match=f"^{told}"):
            by_output("nc", value, data, least=0)
    with pytest.raises(InputError, match="nb is 3 × 2, got 2 × 3: a row for each output and a col"):
        by_channel("nb", np.array(rows).T, data, least=0)
    with pytest.raises(InputError, match="na is 3 × 3, got 3 × 2: a row and a column for each out"):
        by_pair("na", rows, data, least=0)


def test_integrating_outputs_are_named_or_all() -> None:
    data = signals()

    found = [integrating_outputs(x, data) for x in (True, False, "b", ["c", "a"], ())]

    t, f = True, False
    assert found == [(t, t, t), (f, f, f), (f, t, f), (t, f, t), (f, f, f)]


def plans(**of: Any) -> Any:
    """Return the plans of a Box-Jenkins model with unequal orders."""
    data = signals()
    orders = {
        "nb": by_channel("nb", [[2, 0], [1, 3], [1, 1]], data, least=0),
        "nf": by_channel("nf", of.pop("nf", [[2, 4], [1, 3], [2, 2]]), data, least=0),
        "nk": by_channel("nk", [[1, 2], [3, 4], [5, 0]], data, least=0),
        "nc": by_output("nc", [1, 0, 2], data, least=0),
        "nd": by_output("nd", [0, 3, 1], data, least=0),
    }
    fields = {"integrators": (False, True, False), "initial": "estimate", "shared": ""} | of
    return plans_of(data, orders, **fields)


def test_each_output_has_its_own_polynomials() -> None:
    """F of an input without coefficients b is 1, and an integrator is one of the roots of F."""
    found = plans()

    assert [plan.outputs for plan in found] == [(0,), (1,), (2,)]
    assert [plan.sizes for plan in found] == [(0, 2, 1), (0, 2, 3), (0, 2, 2, 2, 1)]
    assert [plan.bounded for plan in found] == [
        (False, True, True), (False, True, False), (False, True, True, True, False),
    ]  # fmt: skip
    rows = [plan.rows[0] for plan in found]
    assert rows == [
        Row(nb=(2, 0), nk=(1, 2), f=(1, 0), c=2, d=0),
        Row(nb=(1, 3), nk=(3, 4), f=(0, 1), c=0, d=2, integrator=True),
        Row(nb=(1, 1), nk=(5, 0), f=(1, 2), c=3, d=4),
    ]


def test_all_outputs_may_have_one_denominator() -> None:
    """Its order does not count the integrator."""
    [plan] = plans(shared="denominator", nf=2, initial="zero")

    assert plan.outputs == (0, 1, 2)
    assert plan.sizes == (0, 2, 1, 3, 2, 1)
    assert plan.bounded == (False, True, True, False, True, False)
    assert [(row.f, row.c, row.d) for row in plan.rows] == [
        ((1, 1), 2, 0), ((1, 1), 0, 3), ((1, 1), 4, 5),
    ]  # fmt: skip
    assert [row.integrator for row in plan.rows] == [False, True, False]
    assert all(row.at_rest for row in plan.rows)


def test_an_equation_error_has_its_denominator_for_the_noise_too() -> None:
    found = plans(equation_error=True, nf=[[2, 2], [3, 3], [1, 1]])

    assert [plan.sizes for plan in found] == [(0, 2, 1), (0, 2), (0, 1, 2)]
    assert [(p.rows[0].f, p.rows[0].c, p.rows[0].d) for p in found] == [
        ((1, 1), 2, 1), ((1, 1), 0, 1), ((1, 1), 2, 1),
    ]  # fmt: skip
    assert [p.rows[0].integrated_noise for p in found] == [False, True, False]
    with pytest.raises(InputError, match=r"^na must be at least 1 with an integrator"):
        plans(equation_error=True, nf=[[2, 2], [0, 0], [1, 1]])


@pytest.mark.parametrize("at_rest", [False, True])
def test_an_integrating_row_has_the_sums_of_the_inputs(at_rest: bool) -> None:
    """Their means are subtracted if a ramp is estimated."""
    u, y = np.random.default_rng(1).standard_normal((2, 30, 2))
    y[4] = np.nan
    row = Row(nb=(1, 1), nk=(1, 1), f=(0, 0), integrator=True, at_rest=at_rest)

    x = row_data(u + 2.0, y[:, 1], row)

    level = np.zeros(2) if at_rest else (u + 2.0).mean(axis=0)
    np.testing.assert_allclose(x.u, np.cumsum(u + 2.0 - level, axis=0), atol=1e-12)
    assert x.y[4] == 0.0
    assert np.flatnonzero(~x.rows).tolist() == [4]
    assert row.trend == (0 if at_rest else 2)


def test_the_rate_of_an_integrating_row_runs_through_gaps() -> None:
    """Missing outputs are interpolated before the differences are taken."""
    y = np.array([1.0, np.nan, np.nan, 7.0, 8.0, np.nan])
    row = Row(nb=(1,), nk=(1,), f=(1,), integrator=True)
    x = row_data(np.array([[1.0], [3.0], [2.0], [0.0], [4.0], [2.0]]), y, row)

    rate = _differenced(x)

    np.testing.assert_allclose(rate.y, [0, 2, 2, 2, 1, 0])
    np.testing.assert_allclose(rate.u[:, 0], [-1, 1, 0, -2, 2, 0], atol=1e-12)
    assert rate.rows.all()


def _losses(data: Signals, theta: Array | None, delays: tuple[int, int]) -> tuple[Array, float]:
    """Return theta of y_a with na=2 and nb=1 for these delays, and its loss on the data."""
    Phi, y = [], []
    for part in data.experiments():
        X = np.hstack(
            [
                -lagged(part.y[:, [1]][:, 0], range(1, 3)),
                *(lagged(part.u[:, j], [k]) for j, k in enumerate(delays)),
            ]
        )
        seen = part.valid[:, 1]
        known = [t for t in range(4, part.N) if seen[t - 2 : t + 1].all()]
        Phi.append(X[known])
        y.append(part.y[known, 1])
    X, right = np.vstack(Phi), np.concatenate(y)
    found = np.linalg.lstsq(X, right, rcond=None)[0] if theta is None else theta
    return found, float(np.mean((right - X @ found) ** 2))


def test_given_delays_hold_for_the_validation_data_too() -> None:
    """The delays of b are 4 and 3; others are not tried."""
    data, other = signals(seed=1), signals(seed=2)

    tables = select_orders(
        data,
        [2],
        [1],
        {("b", "u"): 4, ("b", "v"): 3},
        validation=other,  # type: ignore[dict-item]
    )

    theta, loss = _losses(data, None, (4, 3))
    _, on_other = _losses(other, theta, (4, 3))
    table = tables["b"]
    assert table.loss.tolist() == pytest.approx([loss])
    assert table.validation_loss is not None
    assert table.validation_loss.tolist() == pytest.approx([on_other])
    assert tables.best()["nk"] == [[1, 1], [4, 3], [1, 1]]
    assert tables.best()["na"] == [[2, 0, 0], [0, 2, 0], [0, 0, 2]]
    assert repr(tables).startswith("a: given delays 1, 1\na:\n")
    assert "\nb: given delays 4, 3\nb:\n" in repr(tables)
    with pytest.raises(InputError, match="resample one of them"):
        select_orders(data, [1], [1], [1], validation=signals(Ts=0.25))


@pytest.mark.parametrize(
    ("nc", "nd", "score"),
    [(0, 0, "exogenous"), ([1, 0], 0, "correlated"), (0, [0, 1], "correlated")],
)
def test_all_outputs_have_one_score_and_converge_together(
    nc: Any, nd: Any, score: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the noise of one output is coloured, the past of it is in the regressors."""
    rng = np.random.default_rng(3)
    u, e = rng.standard_normal((2, 120, 2))
    y = np.column_stack([filtered([0, 1.0], [1, -0.5], u[:, 0]), filtered([0, 0.3], [1], u[:, 1])])
    data = Signals(u=u, y=y + 0.1 * e, Ts=1.0, outputs=["a", "b"])
    scores, one_of = list[str](), search._estimated

    def infer(*of: Any, parameters: Any, score: Any) -> Any:
        scores.append(score)
        return search_infer(*of, parameters=parameters, score=score)

    def unfinished(data: Signals, plan: Any, orders: str) -> Any:
        found = one_of(data, plan, orders)
        name, end = found.ends[0]
        end = replace(end, converged=plan.outputs != (1,), iterations=7)
        return replace(found, ends=((name, end), *found.ends[1:]))

    search_infer = search.infer
    monkeypatch.setattr(search, "infer", infer)
    monkeypatch.setattr(search, "_estimated", unfinished)

    fit: Any = armrig.bj(data, nb=1, nc=nc, nd=nd, nf=[[1, 0], [0, 1]])

    assert scores == [score]
    assert not fit.converged
    assert [x.text for x in fit.findings] == ["the search of b did not converge in 7 steps"]


def test_the_loss_of_a_start_value_is_that_of_its_whitened_errors() -> None:
    """An output alone is weighted by its variance."""
    rng = np.random.default_rng(3)
    u, e = rng.standard_normal((2, 200, 2))
    y = np.column_stack([filtered([0, 1.0], [1, -0.5], u[:, 0]), filtered([0, 0.3], [1], u[:, 1])])
    y += [0.3, 0.1] * e
    valid = np.arange(400).reshape(200, 2) % 37 > 0
    data = Signals(u=u, y=y, Ts=1.0, valid=valid, outputs=["a", "b"])

    fit: Any = armrig.oe(data, nb=1, nf=[[1, 0], [0, 1]])

    for i, name in enumerate("ab"):
        loss = min(s.loss for s in fit.starts if s.name.startswith(f"{name}: "))
        assert loss * np.nanvar(data.y[:, i]) == pytest.approx(fit.quality[i].loss, rel=1e-6)
        assert valid[:, i].sum() == fit.quality[i].N
