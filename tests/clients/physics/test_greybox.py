"""The grey box gives back the parameters that made the data, and knows how sure it is."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import armrig
import numpy as np
import pytest
from armrig import Signals
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.data.step import law_step
from armrig.physics.grey_box.estimate import minimise, worse_with_friction
from armrig.physics.grey_box.physical_models import Friction, Physics, free_names
from armrig.physics.systems import ArmParameters, arm, chassis
from armrig_core.errors import InputError

from tests.clients.chassis_data import Make, Ts, angle
from tests.plants import ARM_PARAMETERS, simulated_arm

HANDOUT = ArmParameters()
RUBS = ArmParameters(b_1=5e-3)


def off(fit: Any, name: str = "J_1", truth: float = HANDOUT.J_1) -> float:
    """Return the error in reported standard deviations."""
    return float((fit.values[name] - truth) / fit.std[name])


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_noise_free_data_give_back_the_inertia(make: Make, factor: float) -> None:
    """The search starts ten times too high and ten times too low."""
    data = make(std=0.0)

    fit = armrig.greybox(data, fixed=replace(HANDOUT, J_1=factor * HANDOUT.J_1))

    assert fit.values["J_1"] == pytest.approx(HANDOUT.J_1, rel=1e-9)
    assert fit.converged


def test_the_whole_rig_gives_back_both_inertias_and_the_spring() -> None:
    u = armrig.telegraph(4000, 0.02, seed=1)
    start = replace(HANDOUT, J_1=1.2e-3, J_2=6e-3, K_lin=1.5)
    for output in ("theta_1", "alpha"):
        data = Dataset(u=u, y=angle(u, HANDOUT, arm, output), Ts=Ts)

        fit = armrig.greybox(data, arm, ("J_1", "J_2", "K_lin"), start, output)

        for name in fit.names:
            assert fit.values[name] == pytest.approx(getattr(HANDOUT, name), rel=1e-6)


@pytest.mark.exhaustive
def test_the_standard_deviation_is_that_of_repeated_experiments(make: Make) -> None:
    """Over 80 seeds: the ratio within its own 3 sigma (0.24), all errors below 4 deviations."""
    fits = [armrig.greybox(make(seed, N=2000)) for seed in range(80)]

    z = np.array([off(fit) for fit in fits])
    robust = np.array([(f.values["J_1"] - HANDOUT.J_1) / f.std_robust["J_1"] for f in fits])
    for errors in (z, robust):
        assert 0.76 < errors.std(ddof=1) < 1.24
        assert abs(errors.mean()) < 0.34
        assert np.abs(errors).max() < 4


def test_missing_samples_and_several_experiments_do_not_bias_the_estimate(make: Make) -> None:
    parts = [make(seed, N=2000, offset=0.1 * seed) for seed in (1, 2)]
    holes = np.random.default_rng(0).random(2000) > 0.3
    parts[0] = Dataset(
        u=parts[0].u, y=parts[0].y + 7.0, Ts=Ts, valid=holes, output="theta_1", unit="rad"
    )

    fit = armrig.greybox(merge(parts))

    assert abs(off(fit)) < 3
    assert fit.offset == pytest.approx((0.1, 0.2), abs=2e-3)
    assert fit.initial[0][0] == pytest.approx(7.0, abs=2e-3)
    assert 2000 + np.count_nonzero(holes) == fit.N


def test_the_influence_of_a_fixed_parameter_is_the_change_of_the_estimate(make: Make) -> None:
    data = make()
    fit = armrig.greybox(data, fixed_std={"R_m": 0.0321, "K_m": 8.39e-5})

    alone = armrig.greybox(data)
    shifted = armrig.greybox(data, fixed=replace(HANDOUT, K_m=1.001 * HANDOUT.K_m))
    by_K_m = fit.influence["J_1"]["K_m"]
    moved = (shifted.values["J_1"] / alone.values["J_1"] - 1) / 1e-3
    assert moved == pytest.approx(by_K_m, rel=0.02)
    assert fit.influence["J_1"]["R_m"] == pytest.approx(-1, abs=1e-6)
    assert "K_m +" in fit.explain()


def test_neglected_viscous_friction_biases_the_inertia(make: Make) -> None:
    """The hint of assignment 3.5 is to neglect the viscous friction."""
    data = make(p=ArmParameters(b_1=5e-3))

    neglected, estimated = armrig.greybox(data), armrig.greybox(data, friction="viscous")

    assert abs(neglected.values["J_1"] - HANDOUT.J_1) > 10 * estimated.std["J_1"]
    assert any("coloured" in w for w in neglected.warnings)
    assert abs(off(estimated)) < 3
    assert abs(off(estimated, "b_1", 5e-3)) < 3


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3, 1e4])
def test_friction_of_any_size_is_found(make: Make, scale: float) -> None:
    """In N m s the number may be 200."""
    truth = ArmParameters(J_1=1.7e-3 * scale, b_1=5e-3 * scale, R_m=HANDOUT.R_m / scale)
    data = make(p=truth)
    start = ArmParameters(J_1=5e-3 * scale, R_m=truth.R_m)

    fit = armrig.greybox(data, fixed=start, friction="viscous")

    assert fit.converged
    for name in ("J_1", "b_1"):
        assert abs(fit.values[name] - getattr(truth, name)) < 4 * fit.std[name]
        assert fit.std[name] < 0.05 * abs(getattr(truth, name))


def test_a_search_that_ends_at_its_bound_is_reported(make: Make) -> None:
    """The start is 600 000 times too large."""
    fit = armrig.greybox(make(), fixed=ArmParameters(J_1=1e3))

    [said] = [w for w in fit.warnings if "ended at its bound" in w]
    assert said.startswith("the search for J_1 ended at its bound, a factor 162755 from its start")


def test_coulomb_friction_is_estimated_from_stops_of_the_chassis(make: Make) -> None:
    data = make(p=ArmParameters(b_1=5e-3), coulomb_nm=0.02, low=0.0, high=5.0)

    neglected, fit = armrig.greybox(data), armrig.greybox(data, friction="both")

    assert abs(neglected.values["J_1"] - HANDOUT.J_1) > 10 * fit.std["J_1"]
    assert abs(off(fit)) < 3
    assert fit.values["T_c"] == pytest.approx(0.02, rel=0.01)
    assert fit.values["b_1"] == pytest.approx(5e-3, rel=0.01)


def test_an_input_of_both_signs_separates_friction_and_offset(make: Make) -> None:
    data = make(p=RUBS, coulomb_nm=0.02, shift=2.5, offset=0.3)

    poorer, fit = armrig.greybox(data, friction="viscous"), armrig.greybox(data, friction="both")

    for name, truth in (("J_1", HANDOUT.J_1), ("b_1", 5e-3), ("T_c", 0.02)):
        assert abs(off(fit, name, truth)) < 3
    assert fit.offset[0] == pytest.approx(0.3, abs=2e-3)
    assert fit.fit_percent > poorer.fit_percent
    assert fit.warnings == ()


def test_each_experiment_has_the_offset_that_its_input_shows(make: Make) -> None:
    both_ways = make(1, 2500, coulomb_nm=0.02, shift=2.5, offset=0.2)
    one_way = make(2, 2500, coulomb_nm=0.02, low=0.0, high=5.0)

    fit = armrig.greybox(merge([both_ways, one_way]), friction="coulomb")

    assert fit.offset == (pytest.approx(0.2, abs=2e-3), 0.0)
    assert abs(off(fit)) < 3
    assert fit.values["T_c"] == pytest.approx(0.02, rel=0.02)


def test_a_richer_model_that_fits_worse_is_reported(make: Make) -> None:
    """On an input of one sign T_c replaces the offset."""
    data = make(coulomb_nm=0.02, low=0.0, high=5.0, offset=0.5, N=2000)

    poorer, fit = armrig.greybox(data), armrig.greybox(data, friction="coulomb")

    assert fit.fit_percent < poorer.fit_percent
    [said] = [w for w in fit.warnings if w.startswith("with Coulomb friction")]
    percent = f"{fit.fit_percent:.1f} %, without it {poorer.fit_percent:.1f} %"
    assert said.startswith(f"with Coulomb friction the fit is {percent}: the input has one sign")
    assert "with Coulomb friction" not in repr(poorer)


def test_the_remedy_of_a_poorer_fit_depends_on_the_input() -> None:
    """Only a significant difference is reported: N ln(ratio) above 10."""
    u = armrig.telegraph(200, 0.1)
    data = Dataset(u=u, y=np.arange(200.0), Ts=Ts, valid=np.arange(200) >= 100)
    both_ways = data.replaced(u=u - 2.5, step=None)

    assert worse_with_friction(data.signals(), 1.0, np.exp(0.09)) == ()
    assert worse_with_friction(data.signals(), 2.0, 1.0) == ()
    [held] = worse_with_friction(data.signals(), 1.0, np.exp(0.11))
    [free] = worse_with_friction(both_ways.signals(), 1.0, np.exp(0.11))
    [mixed] = worse_with_friction(merge([both_ways, data]).signals(), 1.0, 2.0)

    assert held.endswith('use friction="viscous", or play an input of both signs')
    assert free.endswith("begin nearer, with another `fixed`")
    assert "the input has one sign" in mixed


def test_an_absent_friction_is_zero_within_its_deviation(make: Make) -> None:
    """Otherwise its standard deviation would be wrong."""
    values = [
        off(armrig.greybox(make(s, N=2000), friction="viscous"), "b_1", 0.0) for s in range(15)
    ]

    assert min(values) < 0 < max(values)
    assert np.abs(values).max() < 4


def test_quantised_readings_are_reported(make: Make) -> None:
    """A moving angle has white errors of rounding; a coarse converter lets it rest."""
    for lsb, noise, warned in ((6e-3, 0.1, False), (6e-3, 0.5, False), (0.5, 0.01, True)):
        data = make(std=noise * lsb)
        read = Dataset(u=data.u, y=np.round(data.y / lsb) * lsb, Ts=Ts, unit="rad")

        fit = armrig.greybox(read)

        assert fit.quantum == pytest.approx(lsb)
        assert any("three times too small" in w for w in fit.warnings) == warned
    assert armrig.greybox(make()).quantum == 0


def test_parameters_with_the_same_effect_are_refused(make: Make) -> None:
    """The chassis alone determines two numbers, a gain and a time constant."""
    with pytest.raises(ValueError, match="determine only 2 of 3 parameters"):
        armrig.greybox(make(), free=("J_1", "K_m", "R_m"))
    assert armrig.greybox(make(), free=("J_1", "K_m")).condition < 100


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"free": ("J",)}, "free='J' is none of J_1, J_2"),
        ({"free": ("J_1", "J_1")}, "none twice"),
        ({"free": ("J_2",)}, "do not determine J_2"),
        ({"output": "alpha"}, "output='alpha' is none of the model's outputs"),
        ({"friction": "dry"}, "friction='dry' must be None"),
        ({"fixed_std": {"J_1": 1.0}}, "fixed_std='J_1' is not a fixed parameter"),
        ({"fixed_std": {"K_m": -1.0}}, "must be finite and >= 0"),
        ({"model": lambda p: arm(p).sample(0.1)}, "continuous time"),
    ],
)
def test_impossible_arguments_are_refused(
    make: Make, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        armrig.greybox(make(N=200), **changes)


@pytest.mark.parametrize(
    ("free", "friction", "names"),
    [
        ("K_m", None, ("K_m",)),
        (("J_1", "N"), "viscous", ("J_1", "N", "b_1")),
        (("b_1", "J_1"), "viscous", ("b_1", "J_1")),
        (("b_1", "J_1"), "both", ("b_1", "J_1", "T_c")),
        (("J_1",), "both", ("J_1", "b_1", "T_c")),
        (("J_1",), "coulomb", ("J_1", "T_c")),
    ],
)
def test_frictions_are_listed_once_after_the_other_parameters(
    free: Any, friction: Friction | None, names: tuple[str, ...]
) -> None:
    assert free_names(free, friction) == names


def test_data_of_another_output_are_refused(make: Make) -> None:
    velocity = armrig.difference(make(N=200))

    with pytest.raises(
        ValueError, match="the data contain velocity, the model's output is theta_1"
    ):
        armrig.greybox(velocity)


def test_a_custom_model_is_estimated(make: Make) -> None:
    import control

    def mine(p: ArmParameters) -> control.StateSpace:
        return 2 * chassis(p)

    data = make(std=0.0)
    doubled = Dataset(u=data.u, y=2 * data.y, Ts=Ts)

    fit = armrig.greybox(doubled, mine, output="y[0]")

    assert fit.values["J_1"] == pytest.approx(HANDOUT.J_1, rel=1e-9)


def test_a_simulation_uses_the_model_of_the_fit(make: Make) -> None:
    fit, u = armrig.greybox(make()), np.ones(50)

    np.testing.assert_allclose(fit.simulate(u), angle(u, fit.fixed), atol=1e-12)
    assert fit.to_control().nstates == 2


def test_figures_of_a_fit_are_those_of_its_values_and_deviations(make: Make) -> None:
    """A friction may be negative or 0, and what fixed parameters add is no lack of data."""
    fit = armrig.greybox(make(N=1000), friction="viscous")
    plain = {"values": {"J_1": 2.0, "b_1": -0.5}, "std": {"J_1": 3.0, "b_1": 0.2}}
    other = replace(fit, **plain, std_noise={"J_1": 0.1, "b_1": 0.1})

    assert other.relative_std == {"J_1": 1.5, "b_1": 0.4}
    assert other.undetermined == ()
    assert replace(other, std_noise={"J_1": 1.1, "b_1": 9.0}).undetermined == ("J_1",)
    assert replace(other, values={"J_1": 2.0, "b_1": 0.0}).relative_std["b_1"] == np.inf
    said = replace(other, influence={"J_1": {"N": -0.5, "K_m": 0.04, "R_m": 2.0}}).explain()
    assert "J_1 = 2 ± 3 kg m² (one standard deviation)." in said
    assert "b_1 = -0.5 ± 0.2 Nms/rad (one standard deviation, 40 %)." in said
    assert "If a fixed parameter is 1 % larger, J_1 changes: N -0.50 %, R_m +2.00 %." in said
    [told] = other.physics.doubts(other.values, other.std, 0.0)
    assert told == "b_1 = -0.5 is below 0, by 2.5 standard deviations: take it as 0"
    assert not [*other.physics.doubts(other.values, {"J_1": 3.0, "b_1": np.inf}, 0.0)]


# Several outputs.


def estimated(signals: Any, **options: Any) -> armrig.GreyFit:
    return armrig.greybox(signals, armrig.physics.arm, ARM_PARAMETERS, **options)


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
    p = HANDOUT
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


def test_the_final_weights_of_the_outputs_are_the_deviations_of_their_residuals() -> None:
    _, signals = simulated_arm(np.random.default_rng([3, 9]), 200, 2e-3)
    physics = Physics(model=armrig.physics.arm, fixed=ArmParameters(), outputs=signals.outputs)

    problem, best, _ = minimise(physics, ARM_PARAMETERS, asdict(physics.fixed), (signals,))

    e = problem.residuals(best.theta)
    np.testing.assert_allclose(problem.std, np.sqrt(np.mean(e**2, axis=0)), rtol=1e-3)


def test_errors_of_another_output_are_refused() -> None:
    data = armrig.example_recording().signals()
    fit = armrig.greybox(data.dataset("theta_1"), armrig.physics.arm)

    with pytest.raises(ValueError, match="outputs are theta_1 and the data have alpha; give data"):
        fit.errors(data.dataset("alpha"))


def test_data_under_a_law_are_named_first_as_biased() -> None:
    data = armrig.example_recording().dataset("theta_1")
    data = data.replaced(step=law_step("ab" * 32))

    fit, sampling = armrig.greybox(data, armrig.physics.arm), armrig.sampling_time(data)

    assert fit.explain().startswith("controlled by the law abababababab: the loop biases an estim")
    assert str(sampling).startswith("controlled by the law abababababab: the loop biases the spec")
    assert sampling.brief().splitlines()[0] == str(sampling).splitlines()[0]
