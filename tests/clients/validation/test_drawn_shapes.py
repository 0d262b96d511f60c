"""Models of drawn shapes: the residual tests on fresh data, and predictions by conditioning."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from tests.drawn_shapes import JUDGED, judged, prediction_error


def fresh_seed() -> int:
    return int(np.random.default_rng().integers(1_000_000))


def test_no_right_model_is_surely_rejected() -> None:
    """10 cases from a fresh seed; `python -m tests.drawn_shapes` counts the rejections."""
    seed = fresh_seed()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for i in range(10):
            shape, p, _ = judged(seed, i)

            least = min(p.values())
            assert least > 1e-7 or shape.kind not in JUDGED, f"seed {seed}, case {i}: {shape}, {p}"


@pytest.mark.parametrize("count", [12, pytest.param(100, marks=pytest.mark.exhaustive)])
def test_a_prediction_is_the_conditional_mean_of_the_known_samples(count: int) -> None:
    """Each structure and mask, one sample ahead and several, from a fresh seed."""
    seed = fresh_seed()
    for i in range(count):
        shape, error, share = prediction_error(seed, i)

        # The free response is estimated by normal equations: half of the digits are left.
        assert error < 1e-7, f"seed {seed}, case {i}: {shape}"
        assert share > 0.3, f"seed {seed}, case {i}: {shape}"
