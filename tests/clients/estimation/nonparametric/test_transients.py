"""A transient that outlasts the first period biases no line of a periodic input's response."""

from __future__ import annotations

from typing import Any

import armrig
import numpy as np
import pytest
from armrig.numerics.polynomial import apply_filter, evaluate

LINES = [1, 2, 3, 5, 8, 13]


def data(seed: int, B: Any, F: Any, *, missing: float = 0.0) -> armrig.Dataset:
    """Return five periods of 200 samples from rest, with noise of 0.002."""
    rng = np.random.default_rng(seed)
    u = armrig.multisine(1000, lines=LINES, periods=5, seed=seed)
    y = apply_filter(B, F, u) + 0.002 * rng.standard_normal(u.size)
    return armrig.Dataset(u=u, y=np.where(rng.random(u.size) < missing, np.nan, y), Ts=0.1)


@pytest.mark.parametrize("T", [[60.0], [20.0], [60.0, 15.0]])
@pytest.mark.parametrize("missing", [0.0, 0.1])
@pytest.mark.parametrize("estimator", [armrig.etfe, armrig.bla])
def test_a_slow_plant_has_its_response(T: list[float], missing: float, estimator: Any) -> None:
    """Three of 60 values of |G| are expected outside 95 % intervals."""
    F = np.real(np.poly(np.exp(-0.1 / np.array(T))))
    B = [0.0, 2 * F.sum()]

    estimates = [estimator(data(seed, B, F, missing=missing)) for seed in range(10)]

    z = np.exp(-0.1j * estimates[0].omega)
    truth = np.abs(evaluate(B, z) / evaluate(F, z))
    outside = [np.abs(np.abs(e.G) - truth) > 1.96 * e.std_magnitude for e in estimates]
    assert np.count_nonzero(outside) <= 10
    assert all("was subtracted" in e.notes[0] for e in estimates)


def test_a_fast_plant_has_no_transient_after_its_first_period() -> None:
    assert not armrig.etfe(data(1, [0.0, 0.2], [1, -0.9])).notes


def test_an_oscillation_that_outlasts_the_first_period_is_a_note() -> None:
    F = np.real(np.poly(0.998 * np.exp([0.21j, -0.21j])))

    notes = armrig.etfe(data(1, [0.0, F.sum()], F)).notes

    assert any("the next period differs more than later ones" in text for text in notes)


def test_a_period_that_is_left_out_keeps_the_time_of_the_others() -> None:
    a = np.exp(-0.1 / 20)
    x = data(1, [0.0, 2 * (1 - a)], [1, -a])
    lost = x.replaced(step=None, valid=~((x.t >= 40) & (x.t < 55)))

    found = armrig.etfe(lost)

    z = np.exp(-0.1j * found.omega)
    truth = np.abs(2 * (1 - a) * z / (1 - a * z))
    assert "3 periods" in found.method
    np.testing.assert_allclose(np.abs(found.G), truth, rtol=0.01)
