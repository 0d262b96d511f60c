"""The grey box from theta_1 and alpha together."""

from __future__ import annotations

from typing import Any

import armrig
import numpy as np
import pytest
from armrig import ArmParameters, Signals
from armrig.physics.grey_box.estimate import minimised
from armrig.physics.grey_box.least_squares_problem import GreyBox
from armrig.physics.grey_box.sampled_model import Physics
from armrig_core.errors import InputError

from tests.plants import ARM_PARAMETERS, simulated_arm


def estimated(signals: Any, **options: Any) -> armrig.GreyFit:
    return armrig.greybox(signals, armrig.arm, ARM_PARAMETERS, **options)


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_the_parameters_are_found_within_their_deviations(missing: float) -> None:
    rng = np.random.default_rng([3, 7])
    p, signals = simulated_arm(rng, 800, 2e-3)
    holed = signals.replaced(step=None, valid=rng.random(signals.y.shape) >= missing)

    fit = estimated(holed)

    for name in ARM_PARAMETERS:
        assert abs(fit.values[name] - getattr(p, name)) < 3.5 * fit.std[name]
    rms = [np.sqrt(q.loss) for q in fit.by_output.values()]
    np.testing.assert_allclose(rms, [5e-3, 2e-3], rtol=0.1)
    assert all(not q.white.coloured for q in fit.by_output.values())


def test_both_outputs_give_smaller_deviations_than_each_alone() -> None:
    _, signals = simulated_arm(np.random.default_rng([3, 8]), 800, 5e-3)

    both = estimated(signals)

    for output in signals.outputs:
        alone = estimated(signals.dataset(output, "u"), output=output)
        assert all(both.std[name] < 0.95 * alone.std[name] for name in ARM_PARAMETERS)
    assert repr(both).count(": fit ") == 2
    assert both.output == "theta_1"


def test_each_of_several_experiments_has_its_initial_state() -> None:
    p, signals = simulated_arm(np.random.default_rng([3, 9]), 900, 2e-3)
    two = armrig.merge([signals[100:500], signals[600:]])  # type: ignore[arg-type]

    fit = estimated(two, output="alpha")

    assert len(fit.initial) == len(fit.offset) == 2
    own = fit.by_output["alpha"]
    assert (fit.output, fit.unit, fit.N) == ("alpha", "rad", 700)
    assert (fit.loss, fit.fit_percent, fit.whiteness) == (
        own.loss,
        own.fit_percent,
        own.white.p_value,
    )
    assert fit.noise_variance == pytest.approx(fit.loss, rel=0.05)
    assert fit.by_output["theta_1"].loss != pytest.approx(fit.loss, rel=0.5)
    for name in ARM_PARAMETERS:
        assert abs(fit.values[name] - getattr(p, name)) < 3.5 * fit.std[name]


def test_arguments_incompatible_with_two_outputs_are_refused() -> None:
    _, signals = simulated_arm(np.random.default_rng([3, 9]), 100, 5e-3)
    twice = Signals(
        u=np.column_stack([signals.u, signals.u[::-1]]),
        y=signals.y,
        Ts=0.01,
        outputs=["theta_1", "alpha"],
        inputs=["u", "v"],
    )

    with pytest.raises(InputError, match='give friction="viscous"'):
        estimated(signals, friction="both")
    with pytest.raises(InputError, match="the inputs are u, v; the rig has one"):
        estimated(twice)
    with pytest.raises(InputError, match="output='velocity' is none of the data's"):
        estimated(signals, output="velocity")
    with pytest.raises(InputError, match="8 samples are too few"):
        estimated(signals[:8])


def test_fixed_parameters_carry_their_uncertainty_into_both_forms() -> None:
    """The shares of R_m and K_m add as squares; influences are in percent for one percent."""
    _, signals = simulated_arm(np.random.default_rng([3, 9]), 250, 2e-3)
    p = ArmParameters()
    shares = {"R_m": 0.01, "K_m": 0.02}
    known = {name: share * getattr(p, name) for name, share in shares.items()}

    plain, fit = (
        estimated(signals, friction="viscous"),
        estimated(signals, friction="viscous", fixed_std=known),
    )

    assert fit.names == (*ARM_PARAMETERS, "b_1")
    assert fit.std_noise == pytest.approx(plain.std)
    for name in ARM_PARAMETERS:
        carried = [fit.influence[name][k] * share for k, share in shares.items()]
        added = (fit.values[name] * np.linalg.norm(carried)) ** 2
        assert fit.std[name] ** 2 - plain.std[name] ** 2 == pytest.approx(added, rel=1e-6)
        robust = fit.std_robust[name] ** 2 - plain.std_robust[name] ** 2
        assert robust == pytest.approx(added, rel=1e-6)


def test_the_final_weights_of_the_outputs_do_not_depend_on_the_first() -> None:
    _, signals = simulated_arm(np.random.default_rng([3, 9]), 200, 2e-3)
    physics = tuple(
        Physics(model=armrig.arm, fixed=ArmParameters(), output=name) for name in signals.outputs
    )
    found = []
    for first in ((1e3, 1.0), (1.0, 1e3)):
        begun = GreyBox(
            physics=physics, names=ARM_PARAMETERS, experiments=(signals,), std=np.array(first)
        )
        start = begun.coordinates({name: getattr(ArmParameters(), name) for name in ARM_PARAMETERS})

        problem, best = minimised(begun, start)

        (e,) = problem.residuals(problem.at(best.theta).e)
        np.testing.assert_allclose(problem.std, np.sqrt(np.mean(e**2, axis=0)), rtol=1e-3)
        found.append(best.theta)
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6)
