"""Advice in words: what is told, and what is not told of what is good."""

from __future__ import annotations

from typing import TYPE_CHECKING

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.models.cancellation import overlapping
from armrig.validation.advice.advice import Advice

if TYPE_CHECKING:
    from handout_plant import HandoutPlant


def told(found: Advice) -> set[str]:
    """Return what there is to act on."""
    return {f.about for f in found.findings if f.level != "good"}


def test_good_data_need_no_advice_but_on_arx(plant: HandoutPlant) -> None:
    """With noise on the angle ARX and OE disagree, and it is said which to take."""
    found = armrig.advice(plant.dataset(1))

    assert told(found) == {"ARX and OE"}
    assert "take OE" in repr(found)


@pytest.mark.parametrize("Ts", [0.5, 7.0, 3600.0])
def test_slow_data_are_advised_on_as_fast_ones(Ts: float) -> None:
    """An hour a sample: the frequencies looked at are those that the data can show."""
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], 1000)
    y = np.convolve(u, [0, 0.5, 0.3, 0.1])[:1000] + 0.1 * rng.standard_normal(1000)

    found = armrig.advice(Dataset(u=u, y=y, Ts=Ts))

    assert any(f.about == "ARX and OE" for f in found.findings)


def test_a_poor_input_is_told(plant: HandoutPlant) -> None:
    """A single step determines no dynamics of order four."""
    u = np.where(np.arange(1000) < 100, 1.0, 4.0)
    data = Dataset(u=u, y=plant.angle(u), Ts=0.01, output="theta_1", unit="rad")

    assert "excitation" in told(armrig.advice(data))


def test_outliers_are_told_with_their_place(plant: HandoutPlant) -> None:
    """One sample, 0.2 rad off."""
    data = plant.dataset(1)
    y = data.y.copy()
    y[1234] += 0.2

    found = armrig.advice(data.replaced(y=y, step=None))

    assert "outliers" in told(found)
    assert "1234" in repr(found)


def test_a_drift_of_an_output_that_does_not_integrate_is_told() -> None:
    """And how to remove it."""
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], 2000)
    y = np.convolve(u, [0, 0.5, 0.3])[:2000] + 1e-3 * np.arange(2000)
    y += 0.1 * rng.standard_normal(2000)
    said = armrig.advice(Dataset(u=u, y=y, Ts=1.0))

    assert "drift" in told(said)
    assert "detrend" in repr(said)


def test_the_right_model_needs_no_advice(plant: HandoutPlant) -> None:
    """The handout's own structure."""
    fit = armrig.oe(plant.dataset(1), nb=4, nf=4, integrator=True)

    assert told(armrig.advice(fit)) == set()


def test_an_order_too_high_shows_in_a_pole_and_a_zero_that_cancel(plant: HandoutPlant) -> None:
    """At two orders more most models show it, at the right order none."""
    data = [plant.dataset(seed, N=1500) for seed in range(3)]
    right = [overlapping(armrig.oe(d, nb=4, nf=4, integrator=True)) for d in data]
    high = [overlapping(armrig.oe(d, nb=6, nf=6, integrator=True)) for d in data]

    assert sum(map(bool, right)) == 0
    assert sum(map(bool, high)) >= 2


def test_an_arx_model_of_the_angle_is_told_all_that_is_wrong_with_it(plant: HandoutPlant) -> None:
    """A negative real pole, an integrator left to chance, coloured residuals."""
    found = armrig.advice(armrig.arx(plant.dataset(1), na=4, nb=4))

    assert {"residuals", "poles", "integrator", "structure"} <= told(found)


def test_a_first_coefficient_that_is_nothing_points_to_a_delay(plant: HandoutPlant) -> None:
    """Nk taken too small, with room for the last coefficient."""
    fit = armrig.oe(plant.dataset(1), nb=5, nf=4, nk=0, integrator=True)

    assert "delay" in told(armrig.advice(fit))


def test_what_is_neither_data_nor_a_model_is_refused() -> None:
    """With the way out."""
    with pytest.raises(TypeError, match=r"data is a str: give a Dataset"):
        armrig.advice("run.mcap")  # type: ignore[arg-type]
