"""Transfer functions in s: the true system, its deviations, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset, Signals
from armrig.data.merging import merge
from armrig.estimation.n4sid import n4sid
from armrig.estimation.polynomial_structures import bj, oe
from armrig.estimation.ss import ss
from armrig.estimation.transfer_functions import process, tf
from armrig.models.transfer_function import TransferFunction
from armrig.numerics.polynomial import apply_filter
from armrig.recordings.files.loading import example_recording
from armrig.validation.model_search import search
from armrig_core.errors import InputError

TS = 0.1
TRUE = np.array([4.0, 2.8, 4.0])  # 4/(s² + 2.8 s + 4)


def data(
    seed: int = 1,
    *,
    delay: float = 0.0,
    N: int = 800,
    std: float = 0.05,
    B: tuple[float, ...] = (4.0,),
    F: tuple[float, ...] = (1, 2.8, 4.0),
    H: tuple[list[float], list[float]] = ([1.0], [1.0]),
    integrates: bool = False,
) -> Dataset:
    """Return the sampled response to a random telegraph signal, with noise H e."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], N), 6)[:N]
    known = {"B": ((np.array(B),),), "F": ((np.array(F),),), "integrators": (integrates,)}
    p, _ = TransferFunction(**known, delay=delay, Ts=TS).sampled(TS)
    y = apply_filter(p.B[0][0], p.F[0][0], u) + apply_filter(*H, std * rng.standard_normal(N))
    return Dataset(u=u, y=y, Ts=TS, output="speed", unit="rad/s", input_unit="V")


def scatter(fits: list[Any], true: np.ndarray) -> np.ndarray:
    """Return the errors in standard deviations, (runs, parameters)."""
    return np.array([(fit.theta - true) / fit.std for fit in fits])


def test_data_without_noise_give_the_true_system() -> None:
    fit = tf(data(std=0.0, delay=0.73), poles=2, zeros=0, delay="estimate")

    np.testing.assert_allclose(fit.theta, [*TRUE, 0.73], rtol=1e-6)
    assert fit.names == ("b0", "f1", "f2", "delay")
    assert fit.Ts == 0


def test_the_deviations_are_those_of_the_estimates() -> None:
    """Over 40 runs the errors have the reported deviations, also those of a delay."""
    fits = [
        tf(data(seed, delay=0.73, N=500), poles=2, zeros=0, delay="estimate") for seed in range(40)
    ]

    z = scatter(fits, np.append(TRUE, 0.73))
    assert np.all(np.abs(np.sqrt(np.mean(z**2, axis=0)) - 1) < 0.35)
    assert np.all(np.mean(np.abs(z) < 1.96, axis=0) >= 0.85)


def test_with_all_zeros_the_model_is_the_sampled_one() -> None:
    """The sampled output-error model has the same loss, parameters and deviations."""
    x = data(B=(1.0, 4.0))
    fit, converted = tf(x, poles=2), oe(x, nb=2, nf=2).to_continuous()

    assert fit.loss == pytest.approx(converted.loss, rel=1e-8)
    np.testing.assert_allclose(fit.theta, converted.theta, rtol=1e-4)
    np.testing.assert_allclose(fit.std, converted.std, rtol=1e-3)


def test_fewer_zeros_have_smaller_deviations() -> None:
    few, all_ = (tf(data(), poles=2, zeros=zeros) for zeros in (0, 1))

    assert np.all(few.std[few.slice_of("f")] < all_.std[all_.slice_of("f")])


@pytest.mark.parametrize("noise", [0, 1])
def test_gaps_experiments_noise_and_an_offset_are_those_of_the_discrete_estimators(
    noise: int,
) -> None:
    """With all zeros the model is the Box-Jenkins model, also after gaps (a Kalman filter)."""
    H = ([1.0, 0.5], [1.0, -0.8]) if noise else ([1.0], [1.0])
    x = merge([data(seed, B=(1.0, 4.0), H=H) for seed in (1, 2)])
    known = np.ones(x.N, dtype=bool)
    known[100:140] = known[1000:1003] = False
    x = Dataset(u=x.u + 0.5, y=np.where(known, x.y, np.nan), Ts=TS, starts=x.starts)

    fit = tf(x, poles=2, noise=(noise, noise), offset=True)
    sampled = bj(x, nb=2, nf=2, nc=noise, nd=noise, offset=True)

    assert fit.loss == pytest.approx(sampled.loss, rel=1e-7)
    assert [f.offset for f in fit.free] == pytest.approx([f.offset for f in sampled.free], rel=1e-3)
    np.testing.assert_allclose(fit.theta, sampled.to_continuous().theta, rtol=1e-3)
    np.testing.assert_allclose(fit.std, sampled.to_continuous().std, rtol=1e-3)


def test_an_integrator_is_exact() -> None:
    x = data(B=(4.0,), F=(1, 2.0, 0.0), integrates=True)
    fit = process(x, "P1I")

    assert fit.theta[-1] == fit.std[-1] == 0
    assert 0 in fit.poles().values
    gain, time = fit.quantities()["gain (rate)"], fit.quantities()["time constant"]
    assert gain.value == pytest.approx(2.0, abs=4 * gain.std)
    assert time.value == pytest.approx(0.5, abs=4 * time.std)
    assert gain.unit == "rad/s/s/V"
    alone = process(data(B=(2.0,), F=(1, 0.0), integrates=True), "P0I").quantities()
    assert alone["gain (rate)"].value == pytest.approx(2.0, abs=4 * alone["gain (rate)"].std)


def test_a_straight_line_between_samples_is_an_option_of_the_data() -> None:
    rng = np.random.default_rng(1)
    u = np.cumsum(rng.standard_normal(600)) / 3
    u[0] = 0.0
    form = TransferFunction(B=((TRUE[:1],),), F=((np.array([1, 2.8, 4.0]),),), Ts=TS, hold="foh")
    p, _ = form.sampled(TS)
    y = apply_filter(p.B[0][0], p.F[0][0], u)
    known = {"u": u, "y": y, "Ts": TS}

    fit = tf(Signals(**known, intersample="foh"), poles=2, zeros=0)
    held = tf(Signals(**known), poles=2, zeros=0)

    np.testing.assert_allclose(fit.theta, TRUE, rtol=1e-6)
    assert held.loss > 1e6 * fit.loss


def test_an_experiment_shorter_than_the_delay_does_not_limit_it() -> None:
    rng = np.random.default_rng(3)
    u = [np.repeat([0.0, 4.0], 3), *(np.repeat(rng.choice([0.0, 4.0], 20), 15) for _ in "ab")]
    y = [apply_filter(np.append(np.zeros(9), 0.3), [1, -0.85], x) for x in u]
    noisy = [x + 0.02 * rng.standard_normal(x.size) for x in y]
    x = merge([Dataset(u=a, y=b, Ts=0.5) for a, b in zip(u, noisy, strict=True)])

    searched, given = process(x, "P1D"), tf(x, poles=1, delay=4.0)

    delay = searched.quantities()["delay"]
    assert abs(delay.value - 4.0) < 4 * delay.std < 0.05
    for fit in (searched, given):
        for name, true in (("gain", 2.0), ("time constant", -0.5 / np.log(0.85))):
            estimate = fit.quantities()[name]
            assert abs(estimate.value - true) < 4 * estimate.std
    fits = (ss(x, order=1, nk=9, noise=False), n4sid(x, order=1, nk=9), search(x, orders=[1]).fit)
    for fit in fits:
        assert abs(fit.poles().values[0] - 0.85) < 0.01
    with pytest.raises(InputError, match="nk=302: no experiment has more than 301 samples"):
        ss(x, order=1, nk=302)


def test_a_delay_at_zero_is_no_parameter() -> None:
    fit = process(example_recording().dataset("theta_1"), "P1DI")

    assert "delay" not in fit.names
    assert [f.about for f in fit.findings] == ["no_delay"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"poles": 2, "zeros": 2}, "zeros=2 must be less than poles=2"),
        ({"poles": 0}, "poles=0"),
        ({"poles": 2, "delay": 81.0}, "shorter than the longest experiment, 80 s"),
        ({"poles": 2, "delay": -1.0}, "must be 0 or more"),
        ({"poles": 2, "delay": "guess"}, 'or "estimate"'),
        ({"poles": 2, "delay": [0.1]}, 'or "estimate"'),
        ({"poles": 2, "delay": True}, "must be 0 or more"),
        ({"poles": 2, "noise": 1}, "must be the numbers"),
        ({"poles": "2"}, "must be an integer"),
        ({"poles": 30}, "at most 20"),
    ],
)
def test_a_refusal_says_what_is_allowed(options: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        tf(data(), **options)


def test_a_plant_too_fast_for_its_sampling_has_a_gain_and_a_warning() -> None:
    fit = tf(data(B=(800.0,), F=(1, 400.0), std=0.01), poles=1)

    gain = fit.quantities()["gain"]
    assert abs(gain.value - 2) < 4 * gain.std < 0.1
    assert any("is above the Nyquist frequency, 31.4 rad/s" in text for text in fit.warnings)


@pytest.mark.parametrize("kind", ["P4", "PID", "P1DD", "P1U", "p1", None])
def test_an_unknown_process_is_refused(kind: Any) -> None:
    with pytest.raises(InputError, match=r"process model: give P|more poles"):
        process(data(), kind)


def test_the_letter_of_a_resonance_is_missed() -> None:
    assert process(data(), "P2U").warnings == ()
    assert "name it by the letter U" in process(data(), "P2").warnings[-1]
