"""Own equations with a dead time, and with two outputs as a list or as rows of an array."""

from __future__ import annotations

from typing import Any

import armrig
import numpy as np
import pytest
from armrig.physics.grey_box.physical_models import Equations
from armrig.physics.grey_box.shooting import Segments
from armrig_core.errors import InputError
from armrig_core.rig.equations import integrate_ode

TRUTH = {"k": 8.0, "tau": 4.0}


def _heater(output: Any, delay: float = 0.0) -> armrig.Ode:
    return armrig.Ode(
        lambda t, x, u, p: [(p.k * u[0] - x[0]) / p.tau, (x[0] - x[1]) / 9.0],
        output=output,
        states=["block [K]", "sensor [K]"],
        parameters={"k": armrig.Parameter(4.0, low=0), "tau": armrig.Parameter(9.0, "s", low=0)},
        delay=delay,
    )


@pytest.mark.parametrize("delay", [2.0, 2.3])
def test_parameters_behind_a_dead_time_are_within_their_deviations(delay: float) -> None:
    """The step of a delay that is no multiple of Ts lies within an interval."""
    model = _heater(lambda t, x, u, p: x[0], delay)
    fine = np.repeat(np.random.default_rng(3).uniform(0, 5, 60), 200)  # 10 ms
    y = model.simulate(fine, Ts=0.01, values=TRUTH)[::20, 0]
    y += 0.02 * np.random.default_rng(4).standard_normal(y.size)
    data = armrig.Dataset(u=fine[::20], y=y, Ts=0.2, unit="K")

    fit = armrig.greybox(data, model)
    wrong = armrig.greybox(data, _heater(lambda t, x, u, p: x[0]))

    for name, value in TRUTH.items():
        assert abs(fit.values[name] - value) < 4 * fit.std[name]
    assert np.isnan(fit.errors(data)[: int(np.ceil(delay / 0.2))]).all()
    assert wrong.fit_percent < fit.fit_percent - 10


@pytest.mark.parametrize("delay", [0.03, 0.4, 0.57])
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_a_dead_time_between_samples_is_exact(delay: float, intersample: Any) -> None:
    """The dead time is a whole number of samples of the reference."""
    model = _heater(lambda t, x, u, p: [x[0], u[0]], delay)
    u, share = np.random.default_rng(5).uniform(0, 5, 12), np.arange(20) / 20
    between = u[:-1, None] + np.diff(u)[:, None] * share * (intersample == "foh")

    def outputs(u: Any, Ts: float) -> Any:
        data = armrig.Signals(u=u, y=np.zeros((u.size, 2)), Ts=Ts, intersample=intersample)
        course = Segments.of(Equations(model=model), [data], u.size - 1).course
        return integrate_ode(model, course, np.zeros((2, 1, 1)), model.values, 8).y[:, :, 0, 0]

    fine = outputs(np.append(between.ravel(), u[-1]), 0.01)

    np.testing.assert_allclose(outputs(u, 0.2), fine[::20], atol=1e-9)


@pytest.mark.parametrize(
    "output",
    [
        lambda t, x, u, p: [x[0], x[1]],
        lambda t, x, u, p: (x[0], x[1]),
        lambda t, x, u, p: x[:2],
        lambda t, x, u, p: np.stack([x[0], x[1]]),
    ],
)
def test_two_outputs_are_a_list_or_the_rows_of_an_array(output: Any) -> None:
    y = _heater(output).simulate(np.ones(50), Ts=0.5)

    assert y.shape == (50, 2)
    assert np.all(y[5:, 0] > y[5:, 1])


def test_the_refusal_of_an_output_says_which_one() -> None:
    model = _heater(lambda t, x, u, p: [x[0], x[:, None]])

    with pytest.raises(InputError, match=r"output 2 of 2 has the shape \(2, 1, 1, 1\)"):
        model.simulate(np.ones(5), Ts=0.5)


@pytest.mark.parametrize("delay", [-0.1, np.inf, np.nan])
def test_a_dead_time_that_is_none_is_refused(delay: float) -> None:
    with pytest.raises(InputError, match="must be a dead time in s, 0 or more"):
        _heater(lambda t, x, u, p: x[0], delay)
