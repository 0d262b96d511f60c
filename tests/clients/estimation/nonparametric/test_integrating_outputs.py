"""An output that is found to integrate is treated so, and the result reports it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.treatment.integrating import integration
from armrig.estimation.nonparametric.bla import bla
from armrig.estimation.nonparametric.correlation import correlation
from armrig.estimation.nonparametric.etfe import etfe
from armrig.estimation.nonparametric.impulse import impulse_response
from armrig.estimation.nonparametric.sampling_time import sampling_time
from armrig.estimation.nonparametric.spectral import spa
from armrig.estimation.nonparametric.step_analysis import step_analysis
from armrig.excitation import multisine
from armrig.numerics.polynomial import filtered

REASON = "behaves as an integrating output"


def unnamed(data: Dataset) -> Dataset:
    """Return the data with an uninformative name of the output."""
    return data.replaced(output="angle", step=None)


ESTIMATES: dict[str, tuple[Callable[..., Any], str]] = {
    "impulse_response": (lambda d, **k: impulse_response(d, 20, **k), "g"),
    "spa": (spa, "magnitude"),
    "etfe": (etfe, "magnitude"),
    "correlation": (correlation, "g"),
    "step_analysis": (step_analysis, "y"),
    "sampling_time": (sampling_time, "response"),
}


@pytest.mark.parametrize("name", ESTIMATES)
def test_an_unnamed_output_is_found_to_integrate(arm: Any, name: str) -> None:
    estimate, of = ESTIMATES[name]
    data = unnamed(arm.steps() if name == "step_analysis" else arm.telegraph(N=1500))

    found, said = estimate(data), estimate(data, integrator=True)

    np.testing.assert_array_equal(getattr(found, of), getattr(said, of))
    assert REASON in repr(found)
    assert REASON not in repr(said)


def test_realisations_of_a_multisine_are_found_to_integrate(arm: Any) -> None:
    u = multisine(1200, seed=1, periods=6)
    data = unnamed(arm.dataset(u, 1e-3))

    found = bla(data)

    assert found.integrator
    assert REASON in repr(found)


def test_the_data_decide_only_where_nobody_else_does(arm: Any) -> None:
    data = arm.telegraph(N=1000)

    assert integration(data, None).notes == ()
    assert integration(unnamed(data), None).integrates
    assert not integration(unnamed(data), integrator=False).integrates
    assert integration(unnamed(data), integrator=True).notes == ()


def test_a_slow_output_that_is_pulled_back_is_not_taken_as_integrating() -> None:
    """A pole at 0.95 and 2000 samples are enough to see it."""
    rng = np.random.default_rng(1)
    u = rng.standard_normal(2000)
    y = filtered([0.0, 0.5], [1.0, -0.95], u) + 0.1 * rng.standard_normal(2000)

    found = integration(Dataset(u=u, y=y, Ts=1.0), None)

    assert not found.integrates
    assert found.notes == ()
