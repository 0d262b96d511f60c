"""Requests and orders of several signals: the arguments of each channel, plans and tables."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import armrig
import numpy as np
import pytest
from armrig import Signals
from armrig.estimation import estimated_outputs, prediction_error
from armrig.estimation.order_selection import select_orders
from armrig.estimation.orders import (
    as_text,
    by_channel,
    by_output,
    by_pair,
    integrating_outputs,
    order_arrays,
)
from armrig.estimation.orders import (
    structures as structures_of,
)
from armrig.estimation.problem import PolynomialProblem
from armrig.estimation.request import Request
from armrig.models.structure import Structure
from armrig.numerics.polynomial import Array, apply_filter, lag_columns
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
            {"integrator": ("b",)},
            {"nb": each(2, 3, 2), "nf": each(1, 2, 1), "integrator": ("b",)},
        ),
        (
            "oe",
            {"nb": 3, "nf": 2},
            {"integrator": ("a", "c"), "shared": True},
            {"nb": each(3, 2, 3), "nf": 1, "integrator": ("a", "c"), "shared": "denominator"},
        ),
        (
            "armax",
            {"na": 3, "nb": 2, "nc": 1},
            {"integrator": ("a",), "nk": 2},
            {
                "na": {"a": 3, "b": 2, "c": 2},
                "nb": each(2, 1, 1),
                "nc": 1,
                "nk": 2,
                "integrator": ("a",),
            },
        ),
        (
            "oe",
            {"nb": 1, "nf": 1},
            {"integrator": tuple("abc")},
            {"nb": each(1, 1, 1), "nf": each(1, 1, 1), "integrator": tuple("abc")},
        ),
        ("ss", {"order": None}, {}, {"order": None}),
        ("ss", {"order": 4}, {"noise": False}, {"order": 4, "noise": False}),
        ("n4sid", {"order": 4}, {"integrator": ("a",)}, {"order": 4, "integrator": True}),
        ("n4sid", {"order": 4}, {"weights": "moesp"}, {"order": 4, "weights": "moesp"}),
    ],
)
def test_an_output_that_does_not_integrate_has_one_root_less(
    structure: Any, orders: Any, options: dict[str, Any], expected: dict[str, Any]
) -> None:
    found = Request(structure=structure, orders=orders, **options).arguments(signals())

    assert found == {"nk": 1} | expected
    takes = {"nb", "nf", "na", "nc"} & found.keys()
    assert {name: type(found[name]) for name in takes} == {
        name: type(expected[name]) for name in takes
    }


def test_an_order_without_a_free_coefficient_is_refused() -> None:
    of = {"structure": "oe", "integrator": ("b",)}
    request: Any = Request(orders={"nb": 2, "nf": 1}, **of)  # type: ignore[arg-type]

    with pytest.raises(InputError) as refused:
        request.arguments(signals())

    assert str(refused.value) == (
        "nf=1 leaves no coefficient for a, c, because nf also counts the integrator of b; give "
        "nf >= 2"
    )
    high: Any = Request(orders={"nb": 7, "nf": 7}, **of)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="13 parameters from 117 samples; at most 11 parameters"):
        high.check(signals())


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
        (-1, "nc=-1 must be an integer >= 0"),
        (True, "nc=True must be an integer >= 0"),
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


def structures(name: str, orders: Any, *, integrators: Any = False, **of: Any) -> Any:
    """Return the structure of each output."""
    data = signals()
    inside = integrating_outputs(integrators, data)
    given = order_arrays(data, name, orders, inside, "denominator" if of else "")
    return structures_of(given, name, inside, offset=False, shared=bool(of))


BOX_JENKINS = {
    "nb": [[2, 0], [1, 3], [1, 1]],
    "nf": [[2, 4], [1, 3], [2, 2]],
    "nk": [[1, 2], [3, 4], [5, 0]],
    "nc": [1, 0, 2],
    "nd": [0, 3, 1],
}


def test_each_output_has_its_own_polynomials() -> None:
    """F of an input without coefficients b is 1, and an integrator is one of the roots of F."""
    found = structures("bj", BOX_JENKINS, integrators="b")

    assert found == [
        Structure(nb=(2, 0), nk=(1, 2), nf=(2, 0), nc=1),
        Structure(nb=(1, 3), nk=(3, 4), nf=(0, 2), nd=3, integrator="f"),
        Structure(nb=(1, 1), nk=(5, 0), nf=(2, 2), nc=2, nd=1),
    ]
    assert [n.groups for n in found] == [((0,),), ((0,), (1,)), ((0,), (1,))]


def test_all_outputs_may_have_one_denominator() -> None:
    """Its order does not count the integrator."""
    found = structures("bj", BOX_JENKINS | {"nf": 2}, integrators="b", shared=True)

    assert [(n.nf, n.sizes, n.shared, n.integrator) for n in found] == [
        ((2, 0), (2,), True, ""),
        ((2, 2), (2,), True, "f"),
        ((2, 2), (2,), True, ""),
    ]
    rows = tuple(replace(n, at_rest=True) for n in found)
    p = PolynomialProblem(rows=rows, experiments=())
    assert "".join(p.letters) == "cffdddccd"
    assert [p.layout.searched[i].tolist() for i in range(3)] == [
        [0, 1, 2], [3, 4, 5, 1, 2], [6, 7, 8, 1, 2],
    ]  # fmt: skip


def test_an_equation_error_has_its_denominator_for_the_noise_too() -> None:
    orders = {"na": [2, 3, 1], "nb": [[2, 0], [1, 3], [1, 1]], "nc": [1, 0, 2], "nk": 1}

    found = structures("armax", orders, integrators="b")

    assert [(n.na, n.nf, n.integrator) for n in found] == [
        (2, (0, 0), ""), (2, (0, 0), "a"), (1, (0, 0), ""),
    ]  # fmt: skip
    with pytest.raises(InputError, match=r"^na must be at least 1 with an integrator"):
        structures("armax", orders | {"na": [2, 0, 1]}, integrators="b")


def _losses(data: Signals, theta: Array | None, delays: tuple[int, int]) -> tuple[Array, float]:
    """Return theta of y_a with na=2 and nb=1 for these delays, and its loss on the data."""
    Phi, y = [], []
    for part in data.experiments():
        X = np.hstack(
            [
                -lag_columns(part.y[:, [1]][:, 0], range(1, 3)),
                *(lag_columns(part.u[:, j], [k]) for j, k in enumerate(delays)),
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


def two_plants(N: int) -> Signals:
    """Return the outputs a and b of two plants, each with one input of its own."""
    u, e = np.random.default_rng(3).standard_normal((2, N, 2))
    y = np.column_stack(
        [apply_filter([0, 1.0], [1, -0.5], u[:, 0]), apply_filter([0, 0.3], [1], u[:, 1])]
    )
    return Signals(u=u, y=y + [0.3, 0.1] * e, Ts=1.0, outputs=["a", "b"])


@pytest.mark.parametrize(
    ("nc", "nd", "score"),
    [(0, 0, "exogenous"), ([1, 0], 0, "correlated"), (0, [0, 1], "correlated")],
)
def test_all_outputs_have_one_score_and_converge_together(
    nc: Any, nd: Any, score: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the noise of one output is coloured, the past of it is in the regressors."""
    data = two_plants(120)
    scores, one_of = list[str](), prediction_error._estimate_group

    def infer(*of: Any, score: Any, **options: Any) -> Any:
        scores.append(score)
        return search_infer(*of, score=score, **options)

    def unfinished(*of: Any) -> Any:
        found = one_of(*of)
        name, end = found.ends[0]
        end = replace(end, converged=found.outputs != (1,), iterations=7)
        return replace(found, ends=[(name, end), *found.ends[1:]])

    search_infer = estimated_outputs.infer
    monkeypatch.setattr(estimated_outputs, "infer", infer)
    monkeypatch.setattr(prediction_error, "_estimate_group", unfinished)

    fit: Any = armrig.bj(data, nb=1, nc=nc, nd=nd, nf=[[1, 0], [0, 1]])

    assert scores == [score]
    assert not fit.search.converged
    [search] = fit.findings
    assert search.text.startswith("the search of b did not converge in 7 steps: lower the orders")


def test_the_loss_of_a_start_value_is_that_of_its_errors() -> None:
    """The errors of an output alone have no weights."""
    valid = np.arange(400).reshape(200, 2) % 37 > 0
    data = two_plants(200).replaced(step=None, valid=valid)

    fit: Any = armrig.oe(data, nb=1, nf=[[1, 0], [0, 1]])

    for i, name in enumerate("ab"):
        loss = min(s.loss for s in fit.search.starts if s.name.startswith(f"{name}: "))
        assert loss == pytest.approx(fit.quality[i].loss, rel=1e-6)
        assert valid[:, i].sum() == fit.quality[i].N
