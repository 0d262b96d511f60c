"""Regressors that know their holes."""

from __future__ import annotations

import numpy as np
from armrig.numerics.regressors import arx_rows, in_blocks
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
