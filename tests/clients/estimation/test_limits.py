"""Data without an answer, or with an answer at a limit."""

from __future__ import annotations

import warnings
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.numerics.polynomial import apply_filter

U = armrig.telegraph(500, 0.1, 1.0, 4.0, seed=1)
E = np.random.default_rng(28).standard_normal(500)
Y = apply_filter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], U) + 0.1 * E
ESTIMATORS: dict[str, dict[str, Any]] = {
    "arx": {"na": 2, "nb": 2},
    "iv4": {"na": 2, "nb": 2},
    "oe": {"nb": 2, "nf": 2, "starts": "few"},
    "armax": {"na": 2, "nb": 2, "nc": 1, "starts": "few"},
    "ararx": {"na": 2, "nb": 2, "nd": 1, "starts": "few"},
    "bj": {"nb": 2, "nc": 1, "nd": 1, "nf": 2, "starts": "few"},
    "n4sid": {"order": 2},
}


@pytest.mark.parametrize("of", ["u", "y"])
def test_numbers_whose_powers_overflow_are_refused(of: str) -> None:
    """Every estimator failed differently."""
    signals = {"u": U, "y": Y}
    signals[of] = signals[of] * 1e150

    with pytest.raises(ValueError, match=rf"the largest \|{of}\| is .*; use a unit in which it"):
        armrig.Dataset(**signals, Ts=1.0)


@pytest.mark.parametrize("of", ["u", "y"])
@pytest.mark.parametrize("name", ["arx", "oe", "n4sid", "search", "delay", "spa", "advice"])
def test_numbers_whose_powers_vanish_are_refused(name: str, of: str) -> None:
    """Their squares were 0."""
    signals = {"u": U, "y": Y}
    signals[of] = signals[of] * 1e-150
    data = armrig.Dataset(**signals, Ts=1.0)

    with pytest.raises(
        ValueError, match=rf"largest \|{of}\| is .*; use a unit in which it is from"
    ):
        getattr(armrig, name)(data, **ESTIMATORS.get(name, {}))


@pytest.mark.parametrize("factor", [1e25, 1e-25])
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_units_change_neither_fit_nor_whiteness(estimator: str, factor: float) -> None:
    estimate = getattr(armrig, estimator)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plain, other = (
            estimate(armrig.Dataset(u=U, y=Y * k, Ts=1.0), **ESTIMATORS[estimator])
            for k in (1.0, factor)
        )

    assert other.fit_percent == pytest.approx(plain.fit_percent, rel=1e-6)
    assert other.whiteness == pytest.approx(plain.whiteness, rel=1e-4)


def test_a_root_of_c_on_the_unit_circle_is_reported() -> None:
    """White noise of the differenced output has C = 1 - q^-1; the predictor stays stable."""
    y = np.diff(apply_filter([0.0, 1.0], [1.0, -0.5], U) + E)

    fit = armrig.armax(armrig.Dataset(u=np.diff(U), y=y, Ts=1.0), na=1, nb=1, nc=1)

    assert 1 - 1e-6 < np.abs(np.roots(fit.C)).max() < 1
    assert any(w.startswith("C has a root on the unit circle") for w in fit.warnings)
