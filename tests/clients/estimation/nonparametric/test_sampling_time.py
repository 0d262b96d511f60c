"""The sampling time by the handout's rules, with reasons."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation.nonparametric import sampling_time as sampling_time_module
from armrig.estimation.nonparametric.sampling_time import (
    DIFFERENCED,
    _analyse_long_steps,
    _bandwidth,
    _dead_time,
    _doubts,
    _from_impulse,
    _reasons,
    nearest_125,
    sampling_time,
)
from armrig.excitation import step, telegraph
from armrig.numerics.polynomial import apply_filter
from armrig.numerics.quantities import times
from numpy.typing import NDArray

from tests.clients.handout_plant import converted
from tests.sampling import sampled


def first_order(tau: float, Ts: float, u: Any, std: float = 0.01) -> Dataset:
    """Return the answer of 1/(1 + tau s) with noise."""
    a = np.exp(-Ts / tau)
    y = apply_filter([0.0, 1 - a], [1.0, -a], u)
    return Dataset(u=u, y=y + std * np.random.default_rng(1).standard_normal(u.size), Ts=Ts)


@pytest.mark.parametrize("stepped", [False, True])
def test_a_first_order_system_has_the_sampling_times_of_the_rules(stepped: bool) -> None:
    """0.31 tau by both bandwidths, 0.3 to 0.43 tau by the transient: 0.2 s to one digit."""
    tau, Ts = 0.6, 0.03
    u = (
        np.tile(np.repeat([1.0, 4.0], 150), 6)
        if stepped
        else telegraph(3000, 0.05, 0.0, 5.0, seed=2)
    )

    data = first_order(tau, Ts, u)
    data = data.replaced(y=-data.y, step=None) if stepped else data

    found = sampling_time(data, integrator=False)

    assert found.gain == pytest.approx(1.0, rel=0.1)
    rule = 2 * np.pi / 20 * tau
    assert found.from_step is stepped
    assert found.Ts_step == pytest.approx(rule, rel=0.15)
    assert found.Ts_spectrum == pytest.approx(rule, rel=0.3)
    assert found.Ts_transient == pytest.approx((0.3 * tau, 3 / 7 * tau), rel=0.25)
    assert found.Ts == 0.2


@pytest.mark.parametrize("Ts", [0.005, 0.01])
def test_the_recommended_sampling_time_of_the_arm_is_5_ms(
    sampled: Callable[[float], Any], Ts: float
) -> None:
    """The fast part of the arm decides, not its notch."""
    found = sampling_time(sampled(Ts).telegraph(N=round(30 / Ts)))

    assert found.Ts == 0.005
    assert found.omega_step == pytest.approx(48.0, rel=0.15)
    assert found.omega_first < 15 < 55 < found.omega_spectrum < 75
    assert "the fast part decides" in repr(found)


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", sampled([3, 1, 6, 9]))  # 3 once gave 0.2 ms
def test_a_step_through_converter_and_dead_band_gives_the_sampling_time_of_the_arm(
    sampled: Callable[[float], Any], seed: int
) -> None:
    """At 2 ms the rate of a 10-bit angle is mostly noise."""
    data = converted(sampled(0.002).dataset(step(5000, at=500)), seed)

    found = sampling_time(data)

    assert found.from_step
    assert found.Ts == 0.005
    assert found.settling < 0.5
    assert 50 < found.omega_spectrum < 80


def test_data_with_gaps_and_steps_give_the_sampling_time_of_the_arm(arm: Any) -> None:
    data = arm.telegraph()
    holed = data.replaced(step=None, valid=np.random.default_rng(1).random(data.N) > 0.1)

    steps = sampling_time(arm.steps().replaced(step=None, output="y"))
    assert {sampling_time(holed).Ts, steps.Ts} == {0.005}
    assert "taken as integrating" in repr(steps)


@pytest.mark.exhaustive
def test_the_noise_of_an_angle_does_not_shorten_the_recommended_time(
    sampled: Callable[[float], Any],
) -> None:
    """Differences of white noise have 39 % of their power near Nyquist at any sampling time."""
    omega = np.linspace(0, np.pi, 100_001)
    power = 1 - np.cos(omega)
    rates = sampled(0.002).steps(4e-3)

    [note] = [n for n in sampling_time(rates).notes if "near Nyquist" in n]

    assert power[omega > 0.8 * np.pi].sum() / power.sum() == pytest.approx(DIFFERENCED, abs=0.005)
    assert "White noise of theta_1, differenced for the rate, has 39 % of its power there" in note
    assert "before trusting" not in note


def test_power_near_nyquist_is_reported() -> None:
    """White noise on the output has a fifth of its power above 0.8 Nyquist of the data."""
    u = telegraph(3000, 0.05, 0.0, 5.0, seed=2)

    quiet, loud = (
        sampling_time(first_order(0.6, 0.03, u, std), integrator=False) for std in (0.001, 3.0)
    )

    assert quiet.near_nyquist < 0.01
    assert loud.near_nyquist > 0.1
    for found in (quiet, loud):
        shares = [
            np.sum(found.power[found.omega > omega]) / np.sum(found.power)
            for omega in (0.8 * np.pi / found.recorded_at, np.pi / found.Ts)
        ]
        assert [found.near_nyquist, found.beyond] == pytest.approx(shares)
    assert any("near Nyquist" in note for note in loud.notes)
    assert not any("near Nyquist" in note for note in quiet.notes)
    assert quiet.beyond < 0.05


def test_data_sampled_too_slowly_are_reported(sampled: Callable[[float], Any]) -> None:
    """At 40 ms the arm's band reaches Nyquist."""
    found = sampling_time(sampled(0.04).telegraph(N=1500, std=1e-3))

    assert any("record at" in note for note in found.notes)
    assert np.isnan(found.beyond)


@pytest.mark.parametrize(
    ("x", "expected"), [(0.0047, 0.005), (0.0031, 0.002), (0.0033, 0.005), (8.0, 10.0), (1.3, 1.0)]
)
def test_a_recommendation_is_a_round_number(x: float, expected: float) -> None:
    """The number is the nearest of 1, 2 and 5 by ratio."""
    assert nearest_125(x) == expected


def test_a_dead_time_belongs_to_no_rule() -> None:
    """The transient and the 63 % time begin after it."""
    u = telegraph(1000, 0.05, 0.0, 5.0, seed=2)
    prompt = first_order(0.3, 0.03, u, 0.002)
    late = prompt.replaced(y=np.append(np.zeros(8), prompt.y[:-8]), step=None)

    (_, _, _, *times), (_, _, _, *delayed) = (
        _from_impulse(x, integrates=False) for x in (prompt, late)
    )

    assert times == pytest.approx([0.3, 0.9], rel=0.1)
    assert delayed == pytest.approx(times, rel=0.1)


def test_a_dead_time_after_a_step_belongs_to_no_rule() -> None:
    """The transient contained the dead time, and the 63 % time if none was sure."""
    u = np.repeat([0.0, 2.0], [100, 700])
    prompt = first_order(1.0, 0.01, u, 0.005)
    late = prompt.replaced(y=np.append(np.zeros(80), prompt.y[:-80]), step=None)

    times, delayed = (sampling_time(x, integrator=False) for x in (prompt, late))

    assert delayed.tau == pytest.approx(times.tau, rel=0.03)
    assert delayed.settling == pytest.approx(times.settling, rel=0.03)
    assert delayed.settling == pytest.approx(3.0, rel=0.03)


@pytest.mark.parametrize(
    ("holds", "settling", "is_analysed"),
    [
        ([300, 100, 150, 100, 300], 9.9, True),
        ([300, 100, 150, 100, 300], 10.1, False),  # longer than the shortest hold
        ([300, 70, 150, 300], 1.0, False),  # a hold of less than half the longest
        ([30, 200, 150, 20], 1.0, True),  # the first and the last hold are cut off
        ([100, 400], 90.0, True),
        ([500], 1.0, False),
        ([48] * 20, 1.0, False),  # less than 50 samples for each hold
    ],
)
def test_holds_are_steps_if_y_settles_in_each(
    holds: list[int], settling: float, is_analysed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    u = np.repeat(np.arange(len(holds)) % 2.0, holds)
    found = SimpleNamespace(settling=settling)
    monkeypatch.setattr(sampling_time_module, "step_analysis", lambda *_, **__: found)

    steps = _analyse_long_steps(Dataset(u=u, y=u, Ts=0.1), integrates=False)

    assert steps is (found if is_analysed else None)


NOTES: list[tuple[dict[str, Any], list[str]]] = [
    ({}, []),
    ({"rules": (0.013, 0.07, 0.02)}, ["the rules differ by a factor 5.4: the response rises"]),
    ({"rules": (0.013, 0.05, 0.02)}, []),
    (
        {"bandwidth": 130.0},
        ["the bandwidth is 41 % of these data's Nyquist frequency: record at 2"],
    ),
    ({"bandwidth": 124.0}, []),
    ({"near": 0.06}, ["6 % of the power is near Nyquist: noise or aliasing; compare with a fa"]),
    ({"near": 0.05}, []),
    ({"near": 0.4, "rate_of": "y"}, ["40 % of the power is near Nyquist. White noise of y, d"]),
    ({"near": 0.46, "rate_of": "y"}, ["46 % of the power is near Nyquist: noise or aliasing"]),
    ({"Ts": 0.005}, ["the recommended Ts is below the data's Ts"]),
]


@pytest.mark.parametrize(("of", "told"), NOTES)
def test_notes_have_their_limits_and_numbers(of: dict[str, Any], told: list[str]) -> None:
    fields: dict[str, Any] = {
        "Ts": 0.02, "now": 0.01, "rules": (0.03, 0.021, 0.04), "bandwidth": 50.0, "near": 0.01,
        "seen": True, "rate_of": "",
    } | of  # fmt: skip

    bandwidth, seen = fields.pop("bandwidth"), fields.pop("seen")
    known = {name: fields[name] for name in ("Ts", "now", "near", "rate_of")}
    doubts = list(_doubts(bandwidth=bandwidth, seen=seen, **known))
    first, *notes = [x.replace("\xa0", " ") for x in _reasons(**fields)]
    notes = [x.replace("\xa0", " ") for x in doubts] + notes

    names = ("the step's time constant", "the spectrum's bandwidth", "the transient")
    least = int(np.argmin(fields["rules"]))
    decides = f"{times(fields['rules'][least])} by {names[least]}".replace("\xa0", " ")
    assert first.startswith(f"the shortest time decides, {decides}, rounded to ")
    assert len(notes) == len(told)
    assert all(note.startswith(text) for note, text in zip(notes, told, strict=True))
    [unseen] = _doubts(bandwidth=bandwidth, seen=False, **known)
    assert unseen.replace("\xa0", " ").startswith("63 % is reached within one sample of 10 ms, so")


def test_the_band_ends_where_the_response_falls_for_the_first_and_for_the_last_time() -> None:
    """A notch lies in between, and noise beyond; each crossing is between two frequencies."""
    omega = np.arange(1.0, 11.0)
    magnitude = np.array([1.0, 1.0, 0.8, 0.4, 0.3, 0.8, 0.9, 0.5, 0.2, 0.75])
    std = np.full(10, 0.02)
    level = np.sqrt(0.5)
    first, last = 3 + (0.8 - level) / 0.4, 7 + (0.9 - level) / 0.4

    def band(gain: float = 1.0, *, coherence: Any = None, G: Any = magnitude) -> Any:
        spectrum: Any = SimpleNamespace(
            G=G, magnitude=np.abs(G), omega=omega, std_magnitude=std, coherence=coherence
        )
        return _bandwidth(spectrum, gain)

    assert band() == pytest.approx((first, last))
    assert band(0.2) == (10.0, 10.0)
    assert band(2.0) == (1.0, 1.0)
    coherence = np.where(omega < 6, 1.0, 0.0)
    assert band(coherence=coherence) == pytest.approx((first, first))
    unknown = np.where(omega == 4, np.nan, magnitude)
    assert band(G=unknown)[0] == pytest.approx(3 + 2 * (0.8 - level) / 0.5)
    peak = np.where(omega == 10, 0.79, magnitude)  # 4 deviations, but not 5, above the level
    assert band(G=peak)[1] == 10.0


@pytest.mark.parametrize(("dead", "power"), [(0.0, 1), (0.0, 2), (0.31, 1), (0.52, 2)])
def test_a_dead_time_is_that_of_the_rise_or_none(dead: float, power: int) -> None:
    """Near 0 it is no dead time."""
    t = 0.05 * np.arange(40)
    y = np.maximum(t - dead, 0) ** power
    y /= 2 * np.interp(1.2, t, y)
    y += 2e-3 * np.random.default_rng(1).standard_normal(40)

    found = _dead_time(t, y, 1.2, 0.05)

    assert found == (0.0 if dead == 0 else pytest.approx(dead, abs=0.03))


def _telegraph(N: int = 1200) -> NDArray[np.float64]:
    return telegraph(N, 0.05, 1.0, 4.0, seed=3)


def test_an_output_that_u_does_not_explain_has_no_sampling_time() -> None:
    noise = np.random.default_rng(1).standard_normal(1200)

    with pytest.raises(ValueError, match="u explains y at no frequency"):
        sampling_time(Dataset(u=_telegraph(), y=noise, Ts=0.05))
    with pytest.raises(ValueError, match="record longer"):
        sampling_time(Dataset(u=_telegraph()[:12] + np.arange(12) % 2, y=noise[:12], Ts=0.05))


def test_a_response_that_returns_to_0_has_no_time_constant() -> None:
    """The final value of a differentiator is noise."""
    u = np.random.default_rng(2).standard_normal(1200)
    y = apply_filter([0, 1, -1], [1, -0.94], u) + 0.02 * np.random.default_rng(1).standard_normal(
        1200
    )

    with pytest.raises(ValueError, match="returns to about 0"):
        sampling_time(Dataset(u=u, y=y, Ts=0.05))


def test_a_response_within_one_sample_is_not_read_between_samples() -> None:
    """The rate of a pure integrator arrives within one sample."""
    u = _telegraph()
    y = np.cumsum(np.append(0, 0.05 * u[:-1]))
    y += 0.02 * np.random.default_rng(1).standard_normal(1200)

    found = sampling_time(Dataset(u=u, y=y, Ts=0.05))

    assert found.Ts == 0.01
    assert "63 % time tau below a sample, 50 ms" in repr(found)
    assert any("record at 10 ms and repeat the analysis" in note for note in found.notes)


def test_the_bandwidth_of_a_slow_plant_refers_to_its_static_gain() -> None:
    """The lowest frequency of the spectrum, 0.042 rad/s, is near the bandwidth, 0.05 rad/s."""
    Ts, tau, ratios = 0.5, 20.0, []
    for seed in range(5):
        u, pole = telegraph(1200, Ts / tau, seed=seed), np.exp(-Ts / tau)
        y = apply_filter(np.array([0, 4 * (1 - pole)]), np.array([1, -pole]), u)
        y = y + 0.02 * np.random.default_rng(seed).standard_normal(y.size)
        ratios.append(sampling_time(Dataset(u=u, y=y, Ts=Ts)).omega_spectrum * tau)

    assert 0.85 < np.median(ratios) < 1.25
