"""The split study: the law, the test of the parts, and the words."""

from __future__ import annotations

import armrig
import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.numerics.polynomial import apply_filter
from armrig.physics.grey_box.split_study import Split
from armrig.physics.systems import ArmParameters
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from tests.clients.chassis_data import Make, Ts, angle


def test_each_part_has_the_estimate_of_its_slice(make: Make) -> None:
    data = make(N=2000)
    valid = np.arange(2000) >= 100
    holed = Dataset(u=data.u, y=data.y, Ts=Ts, valid=valid, output="theta_1", unit="rad")

    study = armrig.split_study(holed, (1, 2))
    whole, halves = study.splits
    assert study.std_growth == pytest.approx(np.mean(halves.std) / whole.std[0])

    assert [s.N.tolist() for s in study.splits] == [[1900.0], [900.0, 1000.0]]
    second = armrig.greybox(holed[1000:])
    assert study.splits[1].values[1] == second.values["J_1"]
    assert study.splits[1].std[1] == second.std["J_1"]


def test_pooling_and_the_homogeneity_test_match_the_manual_calculation() -> None:
    """Two estimates, 1 ± 1 and 4 ± 2."""
    split = Split(
        k=2, N=np.array([100.0, 100.0]), values=np.array([1.0, 4.0]), std=np.array([1.0, 2.0])
    )

    assert split.pooled == pytest.approx((1.6, 0.8**0.5))
    assert split.chi2 == pytest.approx(0.36 + 1.44)
    assert split.p_value == pytest.approx(0.17971, abs=1e-5)
    assert split.scatter == pytest.approx(3 / 2**0.5)


def test_the_scatter_of_few_parts_has_an_interval(make: Make) -> None:
    """Four parts have three degrees of freedom: 0.57 to 3.73 of the scatter."""
    study = armrig.split_study(make(), (1, 4))

    whole, parts = study.splits
    ratio = np.array(parts.scatter_interval) / parts.scatter
    np.testing.assert_allclose(ratio, [np.sqrt(3 / 9.348404), np.sqrt(3 / 0.2157953)])
    assert np.isnan(whole.scatter_interval).all()
    low, high = parts.scatter_interval
    assert f"(95 % interval {low:.2g} to {high:.2g})" in study.explain()
    below = study.plot(ax=Figure().add_subplot()).axes[1]
    [(bar,)] = [c.get_segments() for c in below.collections if isinstance(c, LineCollection)]
    np.testing.assert_allclose(bar[:, 1] / bar[0, 1], [1.0, high / low])


def test_a_rig_that_changes_half_way_is_reported() -> None:
    """The chassis becomes 10 % heavier."""
    u = armrig.telegraph(4000, 0.02, seed=5)
    y = angle(u, ArmParameters())
    y[2000:] = y[2000] + angle(u[2000:], ArmParameters(J_1=1.87e-3))
    y += 2e-3 * np.random.default_rng(0).standard_normal(4000)

    study = armrig.split_study(Dataset(u=u, y=y, Ts=Ts), (1, 2))

    assert study.splits[1].p_value < 1e-6
    assert "DIFFER" in study.explain()


def test_the_requested_parameter_is_studied() -> None:
    rng = np.random.default_rng(1)
    u, e = rng.standard_normal((2, 240))
    data = Dataset(u=u, y=apply_filter([0, 1.0, 0.3], [1, -0.6], u) + 0.3 * e, Ts=1.0)

    for name in ("a1", "b2"):
        study = armrig.split_study(
            data, (1, 3), lambda part: armrig.arx(part, na=1, nb=2), parameter=name
        )

        assert study.parameter == name
        pieces = ((data,), data.split(3))
        for split, parts in zip(study.splits, pieces, strict=True):
            fits = [armrig.arx(part, na=1, nb=2) for part in parts]
            i = fits[0].names.index(name)
            assert split.values.tolist() == [fit.theta[i] for fit in fits]
            assert split.std.tolist() == [fit.std[i] for fit in fits]
        thirds = study.splits[1]
        assert study.std_growth == pytest.approx(thirds.std.mean() / study.splits[0].std[0])
        assert f"{study.std_growth:.2f}, its variance by {study.std_growth**2:.2f}" in study.verdict
        assert "the factors would be 1.73 and 3.00" in study.verdict


def test_progress_is_reported_before_each_part_and_at_the_end() -> None:
    told: list[tuple[int, int, str]] = []
    rng = np.random.default_rng(1)
    data = Dataset(u=rng.standard_normal(200), y=rng.standard_normal(200), Ts=1.0)

    armrig.split_study(
        data,
        (1, 2),
        lambda part: armrig.arx(part, na=1, nb=1),
        progress=lambda *count: told.append(count),
    )

    assert told == [(0, 3, "part 1 of 1"), (1, 3, "part 1 of 2"), (2, 3, "part 2 of 2"), (3, 3, "")]
