"""The test of linearity: its level, its kinds, and the limits of its answers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import armrig
import numpy as np
import pytest
from armrig.numerics.polynomial import apply_filter

from tests.clients.validation.plants import of_second_order, switched
from tests.plants import drawn_model, nonlinear_rig


def test_linear_rigs_are_rejected_at_the_nominal_level() -> None:
    draws = [
        (kind, np.random.default_rng([seed, 52])) for kind in ("OE", "BJ") for seed in range(20)
    ]
    p = np.array([armrig.linearity(drawn_model(*draw)[0][:300]).p for draw in draws])

    assert np.count_nonzero(p < 0.05) <= 5


@pytest.mark.parametrize(
    ("kind", "name", "value", "within"),
    [
        ("dead zone", "to", 1.2, 0.15),
        ("saturation", "at", 3.1, 0.0),
        ("friction", "", 0.0, 0.0),
    ],
)
def test_the_kind_and_its_numbers_are_found(
    kind: str, name: str, value: float, within: float
) -> None:
    found = [armrig.linearity(nonlinear_rig(kind, seed)) for seed in range(3)]

    assert [(f.linear, f.kind) for f in found] == [(False, kind)] * 3
    assert all(abs(f.numbers.get(name, 0.0) - value) <= within for f in found)
    assert all(f.remedy in f.explain() for f in found)


def test_the_gains_at_both_ends_of_a_root_are_right() -> None:
    """The slope of a cubic was 1.5 to 2 times too large at the low end."""
    for seed in range(3):
        found: Any = armrig.linearity(nonlinear_rig("gain by level", seed))

        assert (found.kind, found.gain_of) == ("gain by level", "u")
        assert np.allclose(found.gains * np.sqrt(found.levels), 0.5, rtol=0.2)
        assert found.numbers["gain_1"] > 2 * found.numbers["gain_2"]


def test_an_effect_outside_of_nearly_all_samples_is_no_dead_zone() -> None:
    """The smallest zone that fits these data contains 0.9 % of u."""
    rng = np.random.default_rng(9)
    u = np.repeat(np.append(rng.uniform(1, 5, 198), [0.0, 0.05]), 8)
    y = apply_filter([0, 0.2], [1, -0.8], np.maximum(u, 0.9)) + 0.002 * rng.standard_normal(u.size)
    found: Any = armrig.linearity(armrig.Dataset(u=u, y=y, Ts=1.0))

    assert not found.linear
    assert found.kind != "dead zone"


def test_a_nonlinearity_between_two_levels_of_p_is_not_sure() -> None:
    found: Any = armrig.linearity(nonlinear_rig("dead zone", 1))
    doubtful = replace(found, p=0.02)

    assert found.line.startswith("NONLINEAR: a dead zone of u from")
    assert doubtful.line.startswith("perhaps nonlinear: a dead zone of u from")
    assert "(p = 0.020, level 5 %); one linear rig in 20 has such a p by chance" in doubtful.line


def test_an_output_that_integrates_has_no_static_gain() -> None:
    rig = nonlinear_rig("gain by level", 1)
    found: Any = armrig.linearity(armrig.Dataset(u=rig.u, y=np.cumsum(rig.y), Ts=1.0))

    assert (found.kind, found.numbers, found.gains.size) == ("gain by level", {}, 0)
    assert found.reason == "a response that changes with u"


def test_two_levels_cannot_show_a_static_nonlinearity_of_the_input() -> None:
    assert "two levels" in armrig.linearity(of_second_order(switched())).remarks[0]


def test_each_pair_of_an_output_and_an_input_is_tested() -> None:
    a, b = (nonlinear_rig(kind, seed) for kind, seed in (("linear", 1), ("gain by level", 2)))
    found: Any = armrig.linearity(
        armrig.Signals(u=np.c_[a.u, b.u], y=np.c_[a.y + b.y, b.y], Ts=1.0)
    )

    assert [found["y1", "u2"].kind, found["y2", "u2"].kind] == ["gain by level"] * 2


def test_a_slow_pole_does_not_look_nonlinear() -> None:
    """With 30 lags, half of the p values are below 0.01."""
    p = []
    for seed in range(8):
        rng = np.random.default_rng([seed, 53])
        u = armrig.telegraph(2000, 0.1, 1.0, 4.0, seed=rng)
        x = apply_filter([0, 1.0], np.poly([0.996, 0.986]), u)
        y = x + 0.1 * np.std(x) * rng.standard_normal(2000)
        p.append(armrig.linearity(armrig.Dataset(u=u, y=y, Ts=1.0)).p)

    assert min(p) > 0.01


@pytest.mark.parametrize("seed", range(4))
def test_data_without_noise_are_linear(seed: int) -> None:
    """The errors of the long model are rounding errors, which may depend on anything."""
    u = np.sign(np.random.default_rng(seed).standard_normal(400))

    assert armrig.linearity(armrig.Dataset(u=u, y=np.append(0.0, u[:-1]), Ts=0.01)).linear


def _heated(seed: int, *, res: float, hold: int, top: float = np.inf) -> armrig.Dataset:
    """Return the readings of a heater (5 K/V, 20 s) by a converter with steps of `res` K."""
    rng, a = np.random.default_rng(seed), np.exp(-1 / 20)
    u = np.repeat(rng.choice([0.0, 3.0], 1500 // hold), hold)
    x = np.minimum(apply_filter([0, 5 * (1 - a)], [1, -a], u), top)
    y = 22.2 + x + 0.05 * rng.standard_normal(1500)
    return armrig.Dataset(u=u, y=np.round(y / res) * res, Ts=1.0, output="heat", unit="K")


@pytest.mark.parametrize("hold", [60, 150])
def test_a_coarse_converter_is_no_nonlinearity(hold: int) -> None:
    """Without a simulation of the converter, 11 and 17 of 20 such records have p < 5 %."""
    p = [armrig.linearity(_heated(seed, res=0.5, hold=hold)).p for seed in range(8)]

    assert np.count_nonzero(np.array(p) < 0.05) <= 2


def test_a_limit_is_found_through_a_coarse_converter() -> None:
    found = [armrig.linearity(_heated(seed, res=0.5, hold=60, top=9.3)) for seed in range(4)]

    assert not any(result.linear for result in found)
    assert sum(result.sure for result in found) >= 3


def test_a_coarse_converter_at_rest_is_doubted_in_the_deviations() -> None:
    fit = armrig.process(_heated(1, res=0.5, hold=60), "P1", offset=True)
    fine = armrig.process(_heated(1, res=0.01, hold=60), "P1", offset=True)

    assert "trust neither std nor std_robust" in repr(fit)
    assert "may be three times too small" in fit.warnings[0]
    assert fine.warnings == ()


def test_a_narrow_band_makes_no_nonlinearity_sure() -> None:
    """A slow chirp and modes of little damping, more than a long linear model has."""
    u = np.sin(2e-4 * np.arange(1500) ** 2 / 2)
    poles = [r * np.exp(1j * w) for r, w in ((0.999, 0.11), (0.998, 0.17), (0.998, 0.24))]
    F = np.real(np.poly([*poles, *np.conj(poles)]))
    y = apply_filter([0.0, F.sum()], F, u) + 1e-6 * np.random.default_rng(1).standard_normal(1500)
    data = armrig.Dataset(u=u, y=y, Ts=1.0)

    found = armrig.linearity(data)

    assert found.narrow
    assert not found.sure
    assert armrig.linearity(data.replaced(step=None, u=np.sign(u))).narrow is False


@pytest.mark.parametrize("named", [False, True])
def test_a_column_that_is_not_named_may_explain_a_nonlinearity(named: bool, tmp_path: Path) -> None:
    """The square of the first input moves y; the second column does nothing."""
    rng = np.random.default_rng(1)
    u, v = np.repeat(rng.uniform(0, 2, 60), 20), rng.standard_normal(1200)
    y = apply_filter([0.0, 0.5], [1.0, -0.8], u**2) + 0.05 * rng.standard_normal(1200)
    path = tmp_path / "two.csv"
    columns = [u, y, v] if named else [u, y]
    np.savetxt(
        path, np.column_stack(columns), delimiter=",", header="u,y,v"[: 2 * len(columns) - 1]
    )

    found = armrig.linearity(armrig.load_data(path, Ts=1.0))

    assert found.others is named
    assert ("unless another column of the file moves y" in repr(found)) is named
