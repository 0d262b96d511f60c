"""An output that is found to integrate is treated so, and the result reports it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.treatment.integrating import PoleTest, integration
from armrig.estimation.nonparametric.correlation import correlation
from armrig.estimation.nonparametric.etfe import bla, etfe
from armrig.estimation.nonparametric.impulse import impulse_response
from armrig.estimation.nonparametric.sampling_time import sampling_time
from armrig.estimation.nonparametric.spectral import spa
from armrig.estimation.nonparametric.step_analysis import step_analysis
from armrig.excitation import multisine
from armrig.numerics.polynomial import apply_filter

REASON = "behaves as an integrating output"


def unnamed(data: Dataset) -> Dataset:
    """Return the data with an uninformative name of the output."""
    return data.replaced(output="angle", step=None)


ESTIMATES: dict[str, tuple[Callable[..., Any], str]] = {
    "impulse_response": (lambda d, **k: impulse_response(d, 20, **k), "g"),
    "spa": (spa, "magnitude"),
    "etfe": (etfe, "magnitude"),
    "bla": (bla, "magnitude"),
    "correlation": (correlation, "g"),
    "step_analysis": (step_analysis, "y"),
    "sampling_time": (sampling_time, "response"),
}


@pytest.mark.parametrize("name", ESTIMATES)
def test_an_unnamed_output_is_found_to_integrate(arm: Any, name: str) -> None:
    estimate, of = ESTIMATES[name]
    of_input = {
        "step_analysis": arm.steps,
        "bla": lambda: arm.dataset(multisine(1200, seed=1, periods=6), 1e-3),
    }
    data = unnamed(of_input.get(name, lambda: arm.telegraph(N=1500))())

    found, said = estimate(data), estimate(data, integrator=True)

    np.testing.assert_array_equal(getattr(found, of), getattr(said, of))
    assert REASON in repr(found)
    assert REASON not in repr(said)


def test_the_data_decide_on_an_integrator_without_a_name_or_argument(arm: Any) -> None:
    data = arm.telegraph(N=1000)

    assert integration(data, None).notes == ()
    assert integration(unnamed(data), None).integrates
    assert not integration(unnamed(data), integrator=False).integrates
    assert integration(unnamed(data), integrator=True).notes == ()


def test_an_output_that_rests_after_a_step_settles() -> None:
    """Five time constants of 14.6 s are recorded, after a dead time of 10 s."""
    u = np.where(np.arange(100) < 9, 0.0, 2.0)
    pole = np.exp(-1 / 14.6)
    y = apply_filter([*np.zeros(11), 0.985 * (1 - pole)], [1.0, -pole], u)
    y += 0.01 * np.random.default_rng(5).standard_normal(100)
    data = Dataset(u=u, y=y, Ts=1.0)

    found = sampling_time(data)

    for most in (100, 65):  # the end of the response may be missing
        valid = np.arange(100) < most
        assert not integration(data.replaced(valid=valid, step=None), None).integrates
    assert found.tau == pytest.approx(14.6, abs=0.5)


@pytest.mark.parametrize("holds", [(30, 30, 60), (20, 60, 0)], ids=["pulse", "step"])
def test_an_integrator_at_rest_for_one_input_is_not_settling(holds: tuple[int, ...]) -> None:
    """The output rests at u = 0, but moves at u = 1."""
    u = np.repeat([0.0, 1.0, 0.0], holds)
    noise = 0.01 * np.random.default_rng(1).standard_normal(u.size)

    found = integration(
        Dataset(u=u, y=apply_filter([0.0, 0.1], [1.0, -1.0], u) + noise, Ts=1.0), None
    )

    assert found.integrates


def of_pole(pole: float, *, fast: float = 0.0, walk: float = 0.0, noise: float = 0.02) -> Dataset:
    """Return the response of two poles to a telegraph, with white noise and a random walk."""
    rng = np.random.default_rng(3)
    u = np.cumprod(np.where(rng.random(2000) < (0.2 if fast else 0.02), -1.0, 1.0))
    B = [0.0, (0.002 if pole == 1 else 1 - pole) * (1 - fast)]
    y = apply_filter(B, np.convolve([1.0, -pole], [1.0, -fast]), u)
    y += noise * rng.standard_normal(2000) + np.cumsum(walk * rng.standard_normal(2000))
    return Dataset(u=u, y=y, Ts=0.1)


@pytest.mark.parametrize(
    ("data", "integrates"),
    [
        (of_pole(0.998), False),
        (of_pole(0.998, fast=0.97, noise=0.001), False),
        (of_pole(0.9, walk=0.03), False),
        (of_pole(1.0), True),
        (of_pole(1.0, walk=0.01, noise=0.0), True),
    ],
    ids=["slow pole", "two poles", "random walk", "integrator", "integrator, random walk"],
)
def test_only_a_response_without_return_is_an_integrator(data: Dataset, integrates: bool) -> None:
    assert integration(data, None).integrates == integrates


@pytest.mark.parametrize(
    ("rise", "share", "p_effect", "integrates", "undecided"),
    [
        (1.0, 0.2, 1e-6, True, False),
        (1.0, 0.05, 1e-6, False, True),  # a slow pole looks the same
        (1.0, 0.2, 1e-3, False, True),  # u has hardly an effect through the pole
        (1.0, 0.2, 0.1, False, False),
        (20.0, 0.2, 1e-6, False, False),
    ],
)
def test_the_data_may_leave_open_whether_y_integrates(
    rise: float, share: float, p_effect: float, integrates: bool, undecided: bool
) -> None:
    found = PoleTest(rise=rise, share=share, p_effect=p_effect)

    assert (found.integrates, found.undecided) == (integrates, undecided)


def test_an_unstable_rig_is_no_integrator_and_its_advice_names_able_structures() -> None:
    rng = np.random.default_rng(13)
    r = np.cumprod(np.where(rng.random(1000) < 0.03, -1.0, 1.0))
    e = 0.05 * rng.standard_normal(1000)
    y = apply_filter([0.0, 0.3], [1.0, -0.75], r - e) + e  # pole 1.05 and u = 1.5 (r - y)
    u = 1.5 * (r - y)

    said = repr(armrig.advice(Dataset(u=u, y=y, Ts=0.1)))

    assert "OE and BJ cannot model it; take ARMAX or ARX" in said
    assert "integrating" not in said
    assert "ARMAX or BJ" not in said
