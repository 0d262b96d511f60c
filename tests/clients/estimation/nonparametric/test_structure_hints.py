"""Hints on order, integrator and delay are the true ones where data can show them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.data.merging import merge
from armrig.excitation import telegraph
from armrig.models.transfer_function import TransferFunction
from armrig.numerics.polynomial import apply_filter
from armrig.validation.recommended_structures import BARE, Recommended, _choose, recommend
from armrig.validation.structure_hints import call_of_all, structure_hints
from armrig_core.errors import InputError
from numpy.typing import NDArray

from tests.clients.handout_plant import converted
from tests.clients.validation.plants import under_control
from tests.plants import delayed_plant
from tests.same_numbers_calls import REAL, holed, of_a_system, switching
from tests.sampling import sampled


@pytest.mark.parametrize("output", sampled(["theta_1", "angle"]))
def test_hints_on_the_arm_are_its_four_poles_and_its_notch(arm: Any, output: str) -> None:
    """Four poles, one of them at 1; a notch near 15.7 rad/s; no delay."""
    data = arm.telegraph(N=2000).replaced(step=None, output=output)

    found = structure_hints(data)

    assert found.integrator
    assert (found.nf, found.nb, found.nk) == (4, 4, 1)
    assert found.low_slope == pytest.approx(-20, abs=2)
    assert found.high_slope == pytest.approx(-40, abs=5)
    assert any(14 < w < 17.5 for w in found.antiresonances)
    assert "oe(data, nb=4, nf=4, nk=1, integrator=True)" in repr(found)
    assert found.explain().startswith("- integrator: ")
    assert found.process == ""  # which has no notch


@pytest.mark.parametrize(
    ("F", "form", "name"),
    [
        ([1, -0.9], "P1D", "a first-order process with dead time"),
        ([1, -1.77, 0.8281], "P2DU", "a second-order process with dead time and a resonance"),
    ],
)
def test_hints_name_the_process_model_of_a_plant(F: list[float], form: str, name: str) -> None:
    u = telegraph(1500, 0.1, seed=1)
    e = np.random.default_rng(1).standard_normal(1500)
    y = apply_filter([*np.zeros(6), sum(F) / 2, sum(F) / 2], F, u) + 0.02 * e

    found = structure_hints(Dataset(u=u, y=y, Ts=1.0), integrator=False)

    assert found.process == form
    assert found.reasons[-1] == f'in s: {name}: process(data, "{form}")'


@pytest.mark.parametrize(("zero", "form"), [(-3.0, "P2Z"), (12.0, "P2Z"), (0.0, "P2")])
def test_a_plant_with_a_zero_is_a_process_with_a_zero(zero: float, form: str) -> None:
    """The zero is 1 + zero s; the time constants are 4 and 2 s."""
    system = TransferFunction(
        B=((np.array([zero, 1.0]) / 8,),), F=((np.array([1, 0.75, 0.125]),),), Ts=0.1
    )
    p, _ = system.sampled(0.1)
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([0.0, 4.0], 25), 40)
    y = apply_filter(p.B[0][0], p.F[0][0], u) + 0.02 * rng.standard_normal(u.size)

    found = structure_hints(Dataset(u=u, y=y, Ts=0.1))

    assert found.process == form


@pytest.mark.exhaustive
@pytest.mark.parametrize("pole", [0.985, 0.99, 1.0])
def test_a_slow_pole_is_not_an_integrator(pole: float) -> None:
    """The slope is an integrator's at all recorded frequencies, but the response decays."""
    integrates = pole == 1.0
    rng = np.random.default_rng(0)
    u = np.where(np.cumsum(rng.random(1500) < 0.1) % 2, 1.0, -1.0)
    y = apply_filter([0, 0.03], np.poly([pole, 0.7]), u)
    data = Dataset(u=u, y=y + 0.02 * np.std(y) * rng.standard_normal(1500), Ts=1.0)

    found = structure_hints(data)

    assert found.integrator is integrates
    assert found.low_slope is not None
    assert found.low_slope < -13
    assert ("a slow pole, since" in repr(found)) is not integrates


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", sampled([1, 2]))
def test_a_response_longer_than_its_lags_causes_no_false_resonance(
    sampled: Callable[[float], Any], seed: int
) -> None:
    """At 5 ms the arm swings for longer than 100 lags."""
    u = telegraph(6000, 0.05, seed=seed)
    data = converted(sampled(0.005).dataset(u), seed)

    found = structure_hints(data)

    assert len(found.resonances) == 1
    assert found.resonances[0] == pytest.approx(30.5, abs=2)
    assert len(found.antiresonances) == 1
    assert (found.nf, found.nb) == (4, 4)


@pytest.mark.exhaustive
def test_the_dryer_has_no_integrator(reference: Callable[[str], NDArray[np.float64]]) -> None:
    u, y = reference("dryer.dat").T

    found = structure_hints(Dataset(u=u, y=y, Ts=0.08))

    assert not found.integrator
    assert found.nk in (2, 3)


def test_an_input_that_explains_nothing_is_refused() -> None:
    rng = np.random.default_rng(2)

    with pytest.raises(ValueError, match="record longer"):
        structure_hints(
            Dataset(u=rng.standard_normal(2000), y=rng.standard_normal(2000), Ts=1.0),
            integrator=False,
        )


@pytest.mark.exhaustive
def test_a_pure_integrator_has_a_single_pole_at_1() -> None:
    rng = np.random.default_rng(4)
    u = rng.standard_normal(2000)
    y = np.cumsum(np.append(0, 0.05 * u[:-1])) + 0.01 * rng.standard_normal(2000)

    found = structure_hints(Dataset(u=u, y=y, Ts=0.05))

    assert (found.integrator, found.nb, found.nf, found.nk) == (True, 1, 1, 1)
    assert "± 0.0 dB" not in found.explain()
    assert "order: nf = 1 has the shortest description (MDL); it is longer with" in found.explain()
    assert "longer" not in replace(found, excess={1: 0.0}).explain()


@pytest.mark.exhaustive
def test_dead_time_is_delay_and_not_poles() -> None:
    """A first-order plant with ten samples of delay is not of eleventh order."""
    rng = np.random.default_rng(11)
    u = telegraph(1000, 0.05, seed=11)
    y = apply_filter([0.0] * 11 + [0.1], [1.0, -0.9], u)
    y += 0.01 * np.std(y) * rng.standard_normal(1000)

    found = structure_hints(Dataset(u=u, y=y, Ts=0.1), integrator=False)

    assert (1, 1, 11) in [(s.nb, s.nf, s.nk) for s in found.structures]
    assert len(found.structures) <= 3
    assert found.nk_interval == (11, 11)


@pytest.mark.exhaustive
def test_a_slow_telegraph_causes_no_false_slope() -> None:
    """Its power is at low frequency, and the leakage from there has another slope."""
    said = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        u = telegraph(1000, 0.02, seed=seed)
        y = apply_filter([0.0, 0.05], [1.0, -0.95], u)
        y += 0.01 * np.std(y) * rng.standard_normal(1000)

        found = structure_hints(Dataset(u=u, y=y, Ts=0.05), integrator=False)

        said.append((found.high_slope, found.high_band))
    for slope, omega in said:
        z = np.exp(-1j * omega * 0.05)
        x, true = np.log10(omega), 20 * np.log10(np.abs(0.05 / (1 - 0.95 * z)))
        assert slope is None or slope == pytest.approx(np.polyfit(x, true, 1)[0], abs=5)


@pytest.mark.exhaustive
def test_the_true_structure_is_recommended_in_coloured_noise() -> None:
    """The colour of the noise is removed before the orders are compared."""
    rng = np.random.default_rng(5)
    u = rng.standard_normal(1000)
    F = np.real(np.poly([0.9 * np.exp(0.5j), 0.9 * np.exp(-0.5j), 0.6]))
    y = apply_filter([0.0, 0.0, 1.0, 0.4], F, u)
    y += 0.1 * np.std(y) * apply_filter([1.0], [1.0, -0.9], rng.standard_normal(1000))

    found = structure_hints(Dataset(u=u, y=y, Ts=1.0), integrator=False)

    assert (2, 3, 2) in [(s.nb, s.nf, s.nk) for s in found.structures]


@pytest.mark.exhaustive
def test_the_unit_of_y_does_not_change_the_recommended_structures() -> None:
    """Description lengths are compared on the same samples, at each delay that is tried."""
    plant = delayed_plant(2083)
    data = plant.data(40.0)

    found = structure_hints(data)
    scaled = structure_hints(data.replaced(step=None, y=1e4 * data.y))

    assert scaled.structures == found.structures
    assert found.structures[0].nk == plant.structure[2]


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", [2067, 4033, 4018])
def test_the_structure_of_a_drawn_plant_is_recommended(seed: int) -> None:
    """A model with more b's than are there ended in a poor minimum for the first two plants.

    By AIC the noise of the last plant, 300 samples of first order, was taken for one of order 35.
    """
    plant = delayed_plant(seed)

    found = structure_hints(plant.data(40.0))

    assert plant.structure in [(s.nb, s.nf, s.nk) for s in found.structures]


def short_experiments(count: int, length: int) -> Dataset:
    rng = np.random.default_rng(1)
    parts = []
    for _ in range(count):
        u = 2.5 + 2.0 * np.sign(rng.normal(size=length))
        y = apply_filter([0.0, 0.5, 0.3], [1.0, -1.2, 0.5], u) + rng.normal(0, 0.05, length)
        parts.append(Dataset(u=u, y=y, Ts=0.1))
    return merge(parts)


def test_experiments_that_are_too_short_are_refused() -> None:
    with pytest.raises(InputError, match="hints needs at least 28 samples, got 24"):
        recommend(short_experiments(30, 24), [0, 1, 2], integrates=False, decide=True)


@pytest.mark.exhaustive
def test_many_short_experiments_show_the_true_structure() -> None:
    models, _, tried = recommend(
        short_experiments(10, 60), [0, 1, 2], integrates=False, decide=False
    )

    first = models[0].structure
    assert (first.nb, first.nf, first.nk) == (2, 2, 1)
    excess = {model.structure.nf: model.bits - models[0].bits for model in tried}
    assert excess[2] == 0.0
    assert min(excess[1], excess[3]) > BARE


@pytest.mark.exhaustive
def test_poles_on_the_unit_circle_that_fit_the_noise_are_not_recommended_first() -> None:
    """A pair of poles and its initial state fit a sine of the noise at the best frequency."""
    data = of_a_system(
        *REAL, N=401, Ts=0.02, u=switching(401, 2, 0.2), seed=2, C=[1.0, 0.6], D=[1.0, -0.7]
    )

    first = structure_hints(holed(data)).structures[0]

    assert (first.nb, first.nf, first.nk, first.integrator) == (2, 2, 3, False)


@pytest.mark.exhaustive
def test_if_a_slow_pole_may_be_at_1_both_are_recommended() -> None:
    rng = np.random.default_rng(1)
    u = telegraph(150, 0.05, seed=1)
    y = apply_filter([0.0, 0.1], [1.0, -0.995], u - u.mean())
    data = Dataset(u=u, y=y + np.std(y) * rng.standard_normal(150), Ts=1.0)

    found = structure_hints(data)

    assert not found.integrator_shown
    assert {s.integrator for s in found.structures[:2]} == {True, False}
    assert (1, 1, 1, False) in [(s.nb, s.nf, s.nk, s.integrator) for s in found.structures]
    assert "not shown, because a slow pole looks the same: try both" in found.explain()


@pytest.mark.exhaustive
def test_a_spectrum_unexplained_by_u_keeps_the_recommended_structures() -> None:
    """A delay of twenty samples is longer than the window; `delay` finds it."""
    rng = np.random.default_rng(21)
    u = np.repeat(rng.choice([-1.0, 1.0], 1000), 2)[:1000]
    F = np.real(np.poly(0.99 * np.exp([2j, -2j])))
    y = apply_filter([0.0] * 21 + [0.1], F, u)
    y += 0.01 * np.std(y) * rng.standard_normal(1000)

    found = structure_hints(Dataset(u=u, y=y, Ts=1.0), integrator=False)

    assert (1, 2, 21) in [(s.nb, s.nf, s.nk) for s in found.structures]
    assert found.low_slope is None
    replace(found, trusted=0.0, high_slope=None).plot()


class _Fitted(NamedTuple):
    structure: Recommended
    bits: float


def _fitted(nb: int, nf: int, bits: float, *, integrator: bool = False) -> Any:
    return _Fitted(Recommended(nb=nb, nf=nf, nk=1, integrator=integrator), bits)


def test_the_third_structure_is_the_shortest_of_a_plant_with_a_hold() -> None:
    """Under a hold nb = nf, though the first or last b may be small."""
    orders = ((1, 3), (2, 3), (1, 4), (3, 3), (4, 4))
    free = [_fitted(*n, bits) for bits, n in enumerate(orders)]
    fixed = [_fitted(2, 2, 5, integrator=True), _fitted(2, 4, 6, integrator=True)]

    shown, both = (_choose([fixed, free], is_clear=shown) for shown in (True, False))

    assert shown == [free[0], free[1], free[3]]
    assert both == [free[0], fixed[0], free[1]]


def test_an_output_integrates_in_all_channels_of_the_call_if_it_does_in_one() -> None:
    settling = Recommended(nb=2, nf=2, nk=1, integrator=False)
    found: Any = {("y", "u"): settling, ("y", "v"): replace(settling, nf=3, integrator=True)}

    assert call_of_all(found) == "oe(data, nb=[[3, 2]], nf=3, nk=1, integrator=('y',))"


def test_hints_for_data_of_a_loop_begin_with_a_noise_model() -> None:
    found = structure_hints(under_control(3000))

    assert found.family == "bj"
    assert repr(found).startswith("structure hints: begin with bj(data, nb=")


def test_hints_about_an_unstable_plant_begin_with_armax() -> None:
    """Neither OE nor BJ has a pole outside the unit circle."""
    rng, N = np.random.default_rng([6, 1]), 800
    wanted, y, u = np.repeat(rng.choice([-1.0, 1.0], 20), 40), np.zeros(N), np.zeros(N)
    for t in range(N):
        if t:
            y[t] = 1.05 * y[t - 1] + 0.1 * u[t - 1] + 0.02 * rng.standard_normal()
        u[t] = np.clip(4 * (wanted[t] - y[t]), -5, 5)

    hints = armrig.structure_hints(armrig.Dataset(u=u, y=y, Ts=1.0))

    assert (hints.unstable, hints.family) == (True, "armax")
    assert "begin with armax(data, na=" in repr(hints)
