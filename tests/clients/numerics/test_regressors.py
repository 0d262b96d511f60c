"""Regressors that know their holes."""

from __future__ import annotations

import numpy as np
from armrig.numerics.polynomial import apply_filter
from armrig.numerics.regressors import arx_rows, in_blocks, long_arx
from hypothesis import given
from hypothesis import strategies as st

NAN = np.nan


@given(
    st.integers(0, 3), st.integers(1, 3), st.integers(0, 4), st.sets(st.integers(0, 19), max_size=5)
)
def test_a_row_is_usable_if_all_its_lagged_samples_were_measured(
    na: int, nb: int, nk: int, missing: set[int]
) -> None:
    rng = np.random.default_rng(3)
    u, y = rng.standard_normal((2, 20))
    y[list(missing)] = NAN

    rows = arx_rows(u, y, na=na, lags=range(nk, nk + nb))

    for t in range(20):
        outputs, inputs = range(t - na, t + 1), range(t - nk - nb + 1, t - nk + 1)
        known = min(*outputs, *inputs) >= 0 and not missing & set(outputs)
        assert rows.usable[t] == known
        if known:
            expected = [*(-y[t - k] for k in range(1, na + 1)), *(u[i] for i in inputs[::-1])]
            np.testing.assert_array_equal(rows.Phi[t], expected)
    np.testing.assert_array_equal(rows.y, y)


def test_blocks_of_rows_equal_the_regressor_matrix() -> None:
    M = np.arange(14.0).reshape(7, 2)

    blocks = list(in_blocks(M, 3))

    assert [b.shape[0] for b in blocks] == [3, 3, 1]
    np.testing.assert_array_equal(np.vstack(blocks), M)


def test_a_long_model_of_a_long_record_has_blocks_of_all_experiments() -> None:
    """e(t) in a block equals e(t) of all samples, though the model has a fraction of the rows."""
    rng = np.random.default_rng(4)
    u, e = rng.standard_normal((2, 400_000))
    y = apply_filter([0.0, 1.0, 0.5], [1.0, -1.2, 0.6], u) + apply_filter(
        [1.0], [1.0, -1.2, 0.6], 0.1 * e
    )
    y[20] = NAN
    parts = [(u[:150_000, None], y[:150_000]), (u[150_000:, None], y[150_000:])]

    model = long_arx(parts, 2, 0)

    A, B = model.polynomials(y)
    np.testing.assert_allclose(A, [1, -1.2, 0.6], atol=2e-3)
    np.testing.assert_allclose(B, [[0, 1, 0.5]], atol=2e-3)
    assert not model.rows[[0, 20, 21, 22, 150_000]].any()
    assert model.rows[[2, 19, 23, 150_002, 399_000]].all()
    assert model.errors(y).size == np.count_nonzero(model.rows) < 120_000
    np.testing.assert_allclose(model.errors(y), 0.1 * e[model.rows], atol=0.01)
