"""Losses of all ARX structures from one decomposition."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import armrig
import numpy as np
import pytest
from armrig import Signals
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.estimation.arx import arx
from armrig.estimation.order_selection import select_orders
from armrig.estimation.order_table import OrderTable
from armrig.excitation import telegraph
from armrig.numerics.polynomial import apply_filter, lag_columns
from numpy.typing import NDArray

Vector = NDArray[np.float64]


def _data(seed: int, N: int = 600, nk: int = 2) -> Dataset:
    rng = np.random.default_rng(seed)
    u = telegraph(N, 0.3, 1.5, 3.5, seed=rng) - 2.5
    F, B = [1.0, -1.2, 0.6], np.append(np.zeros(nk), [1.0, 0.5])
    return Dataset(
        u=u, y=apply_filter(B, F, u) + apply_filter([1.0], F, 0.5 * rng.standard_normal(N)), Ts=1.0
    )


def _plainly(parts: list[Dataset], na: int, nb: int, nk: int, skip: int) -> tuple[Vector, Vector]:
    """Return regressors and y from sample `skip` of each part on, without holes."""
    Phi, y = [], []
    for part in parts:
        block = [-lag_columns(part.y, range(1, na + 1)), lag_columns(part.u, range(nk, nk + nb))]
        X = np.hstack(block)[skip:]
        # As for the largest regressor: all its past of y must be known.
        known = np.array(
            [np.isfinite(part.y[max(t - 4, 0) : t + 1]).all() for t in range(skip, part.N)]
        )
        Phi.append(X[known])
        y.append(part.y[skip:][known])
    return np.vstack(Phi), np.concatenate(y)


@pytest.mark.parametrize("orders", [(1, 1, 0), (4, 3, 3), (2, 2, 2), (0, 2, 1), (3, 1, 3)])
def test_each_loss_equals_that_of_a_separate_least_squares_fit(
    orders: tuple[int, int, int],
) -> None:
    valid = np.ones(600, dtype=np.bool_)
    valid[[50, 51, 300]] = False
    a, b, other = _data(1), _data(2), _data(3)
    gappy = Dataset(u=a.u, y=a.y, Ts=1.0, valid=valid)
    table = select_orders(
        merge([gappy, b]), na=range(5), nb=range(1, 4), nk=range(4), validation=other
    )
    i = next(k for k in range(len(table)) if tuple(dict(table.orders(k)).values()) == orders)

    Phi, y = _plainly([gappy, b], *orders, skip=5)
    theta = np.linalg.lstsq(Phi, y, rcond=None)[0]
    Phi_v, y_v = _plainly([other], *orders, skip=5)

    assert y.size == table.N
    assert table.loss[i] == pytest.approx(np.mean((y - Phi @ theta) ** 2), rel=1e-10)
    assert table.validation_loss is not None
    expected = np.mean((y_v - Phi_v @ theta) ** 2)
    assert table.validation_loss[i] == pytest.approx(expected, rel=1e-9)
    assert table.batch_losses is not None
    batches = np.array_split((y_v - Phi_v @ theta) ** 2, 30)
    np.testing.assert_allclose(table.batch_losses[i], [x.mean() for x in batches], rtol=1e-8)


def test_the_true_orders_are_found() -> None:
    table = select_orders(_data(1, 3000))

    chosen = table.best("mdl")

    assert dict(chosen) == {"na": 2, "nb": 2, "nk": 2}
    assert arx(_data(1), **chosen).orders == dict(chosen)
    assert "mdl        chooses na=2, nb=2, nk=2" in repr(table)


def test_validation_data_decide_on_the_order_if_given() -> None:
    table = select_orders(_data(1, 3000), validation=_data(2, 3000))

    best, i = table.best(), table.chosen()

    assert best == table.best("validation") == table.orders(i)
    assert best.na >= 2
    assert best.nk <= 2
    assert table.validation_loss is not None
    assert table.batch_losses is not None
    lowest = int(np.nanargmin(table.validation_loss))
    assert table.parameters[i] < table.parameters[lowest]
    off = table.batch_losses - table.batch_losses[lowest]
    excess, std = off.mean(axis=1), off.std(axis=1, ddof=1) / np.sqrt(30)
    assert excess[i] <= std[i]
    fewer = table.parameters < table.parameters[i]
    assert (excess[fewer] > std[fewer]).all()


def test_validation_data_with_few_rows_have_a_batch_for_each_row() -> None:
    validation = _data(2, 1000)[:20]

    table = select_orders(_data(1, 200), na=[1, 2], nb=[2], nk=[1], validation=validation)

    assert table.batch_losses is not None
    assert table.batch_losses.shape == (2, 18)
    assert np.isfinite(table.batch_losses).all()


def test_the_criteria_are_those_of_a_fit() -> None:
    data = _data(1)

    table = select_orders(data, na=[2], nb=[2], nk=[2])
    fit = arx(data, na=2, nb=2, nk=2)

    assert table.aic[0] == pytest.approx(fit.aic)
    assert table.mdl[0] == pytest.approx(fit.mdl)
    assert table.fpe[0] == pytest.approx(fit.fpe)


def test_a_structure_that_the_input_does_not_determine_is_not_chosen() -> None:
    """A period of three levels determines three b's."""
    rng = np.random.default_rng(1)
    u = np.tile([0.0, 1.0, 3.0], 100)
    y = apply_filter([0.0, 1.0], [1.0, -0.5], u) + 0.01 * rng.standard_normal(300)

    table = select_orders(Dataset(u=u, y=y, Ts=1.0), na=[1], nb=range(1, 6), nk=[1])

    np.testing.assert_array_equal(np.isfinite(table.loss), table.nb <= 3)
    assert table.best().nb <= 3
    assert "5 ARX structures on the same 295 samples, 2 not determined by the data" in repr(table)


def test_the_published_dryer_is_chosen_from_many(
    reference: Callable[[str], NDArray[np.float64]],
) -> None:
    u, y = reference("dryer.dat").T
    data = Dataset(u=u - u.mean(), y=y - y.mean(), Ts=0.08)

    table = select_orders(data[:500], na=[2], nb=[2], nk=range(6), validation=data[500:])

    assert dict(table.best("validation")) == {"na": 2, "nb": 2, "nk": 3}


def test_a_table_without_structures_or_samples_is_refused() -> None:
    with pytest.raises(ValueError, match="give select_orders the validation data"):
        select_orders(_data(1)).best("validation")
    with pytest.raises(ValueError, match="needs at least 26 samples, got 12"):
        select_orders(_data(1, 26))
    with pytest.raises(ValueError, match="nb=0 must be an integer >= 1"):
        select_orders(_data(1), nb=range(3))
    with pytest.raises(ValueError, match="na is empty"):
        select_orders(_data(1), na=[])


def test_without_validation_data_mdl_decides() -> None:
    """AIC takes one parameter more, because 3 % less loss with 100 errors is worth 3.05."""
    table = OrderTable(
        na=np.array([1, 2]),
        nb=np.array([1, 1]),
        nk=np.array([1, 1]),
        loss=np.array([1.0, 0.97]),
        validation_loss=None,
        batch_losses=None,
        output_variance=2.0,
        N=100,
    )

    assert [table.best(criterion).na for criterion in ("aic", "fpe", "mdl")] == [2, 2, 1]
    assert table.best().na == 1


def test_each_output_has_separate_orders() -> None:
    rng = np.random.default_rng(6)
    u = rng.standard_normal((400, 2))
    y = np.column_stack(
        [
            apply_filter([0, 1.0], [1, -1.2, 0.5], u[:, 0])
            + apply_filter([0, 0.5], [1, -1.2, 0.5], u[:, 1])
            + apply_filter([0.2], [1, -1.2, 0.5], rng.standard_normal(400)),
            apply_filter([0, 0, 1.0, 0.5], [1, -0.7], u[:, 1])
            + apply_filter([0, 0, 0.3], [1, -0.7], u[:, 0])
            + apply_filter([0.2], [1, -0.7], rng.standard_normal(400)),
        ]
    )
    data = Signals(u=u, y=y, Ts=0.1, outputs=["a", "b"])

    found: Any = armrig.select_orders(data, range(1, 5), range(1, 5), range(4))

    assert found.best("mdl") == {
        "na": [[2, 0], [0, 1]],
        "nb": [[1, 1], [2, 2]],
        "nk": [[1] * 2, [2] * 2],
    }
    fit: Any = armrig.arx(data, **found.best("mdl"))  # type: ignore[arg-type]
    table = found["b"]
    at = int(np.flatnonzero((table.na == 1) & (table.nb == 2) & (table.nk == 2))[0])
    np.testing.assert_allclose(table.loss[at], fit.quality[1].loss, rtol=0.02)
    assert table.parameters[at] == 5
    assert len(found) == 2
    assert repr(found).startswith("a:\n- chosen")


def test_a_table_without_a_loss_is_printed() -> None:
    """Each loss of an output that is 0 is 0, and each criterion is not a number."""
    u = np.random.default_rng(1).standard_normal(100)

    table = select_orders(Dataset(u=u, y=np.zeros(100), Ts=1.0), range(1, 3), range(1, 3), [1])

    assert "chooses na=1, nb=1, nk=1" in repr(table)
