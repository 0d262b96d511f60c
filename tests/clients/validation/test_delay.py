"""At which lag the input acts first, and what only looks like a delay."""

from __future__ import annotations

from typing import TYPE_CHECKING

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset, merge
from armrig.numerics.polynomial import filtered

if TYPE_CHECKING:
    from handout_plant import HandoutPlant


def late(data: Dataset, samples: int) -> Dataset:
    """Return the data with the output so many samples later."""
    y = np.concatenate([np.full(samples, data.y[0]), data.y[: data.N - samples]])
    return data.replaced(y=y, step=None)


@pytest.mark.parametrize("samples", [0, 1, 5])
def test_the_delay_is_found(plant: HandoutPlant, samples: int) -> None:
    """And nk is one more, the hold's own sample."""
    found = armrig.delay(late(plant.dataset(1), samples))

    assert found.delay == samples
    assert found.nk == samples + 1
    assert found.interval == (samples + 1, samples + 1)
    assert found.p_values[found.nk] < 0.01 <= found.p_values[found.nk - 1]


def test_a_direct_term_is_a_delay_of_minus_one() -> None:
    """It acts within its own sample."""
    rng = np.random.default_rng(1)
    u = rng.standard_normal(1000)
    y = filtered([0.5, 0.3], [1.0, -0.7], u) + 0.1 * rng.standard_normal(1000)

    found = armrig.delay(Dataset(u=u, y=y, Ts=1.0), nb=2, nf=1, integrator=False)

    assert (found.nk, found.delay) == (0, -1)
    assert "direct term" in repr(found)


def test_holes_and_several_experiments_are_no_delay(plant: HandoutPlant) -> None:
    """Through the potentiometer, in two experiments, 20 ms late."""
    parts = [
        plant.through_potentiometer(late(plant.dataset(seed, N=1500), 2), seed) for seed in (1, 2)
    ]

    assert armrig.delay(merge(parts)).delay == 2


def test_the_time_that_quantisation_hides_is_told_apart(plant: HandoutPlant) -> None:
    """t_q = sqrt(2 LSB / (b Δu)) with the handout's b of 98.4 rad/s² per V, a step of 5 V."""
    found = armrig.delay(plant.through_potentiometer(plant.dataset(1), 1))
    lsb = np.deg2rad(352.0) / 1024

    assert found.quantum == pytest.approx(lsb)
    assert found.t_q == pytest.approx(np.sqrt(2 * lsb / (98.4 * 5.0)), rel=0.1)
    assert found.delay == 0
    assert "Quantisation is no delay" in found.explain()


def test_without_quantisation_there_is_nothing_to_tell_apart(plant: HandoutPlant) -> None:
    """No steps, no time hidden."""
    found = armrig.delay(plant.dataset(1))

    assert found.t_q is None
    assert "Quantisation" not in found.explain()


def test_an_input_that_does_not_act_is_told() -> None:
    """There is no first lag."""
    rng = np.random.default_rng(1)
    data = Dataset(u=rng.standard_normal(200), y=rng.standard_normal(200), Ts=1.0)

    with pytest.raises(ValueError, match="u acts at no lag up to"):
        armrig.delay(data, nb=1, nf=1, integrator=False)
