"""Models with poles outside the unit circle are reported, and reflected on request."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from armrig.data.dataset import Dataset
from armrig.estimation.arx import arx
from armrig.estimation.iv4 import iv4
from armrig.estimation.n4sid import n4sid
from armrig.estimation.polynomial_structures import armax, bj, oe, pem
from armrig.estimation.stability import (
    _way_out,
    largest_unstable,
    reflection_warnings,
    stabilise,
)
from armrig.models.fit import Fit
from armrig.numerics.polynomial import apply_filter

Estimator = Callable[..., Fit]
B = [0.0, 1.0, 0.5]


def _growing(pole: float = 1.03, N: int = 200) -> Dataset:
    """Return data of A y = B u + e of second order, one pole outside the circle."""
    rng = np.random.default_rng(1)
    A = np.convolve([1.0, -pole], [1.0, -0.5])
    u, e = rng.standard_normal((2, N))
    return Dataset(u=u, y=apply_filter(B, A, u) + apply_filter([1.0], A, 0.1 * e), Ts=1.0)


ESTIMATORS: dict[str, Estimator] = {
    "arx": lambda data, **more: arx(data, na=2, nb=2, **more),
    "iv4": lambda data, **more: iv4(data, na=2, nb=2, **more),
    "armax": lambda data, **more: armax(data, na=2, nb=2, nc=1, **more, starts="few"),
    "n4sid": lambda data, **more: n4sid(data, 2, **more),
    "pem": lambda data, **more: pem(data, na=2, nb=2, **more, starts="few"),
}


def test_an_unstable_pole_of_the_noise_is_reported_and_reflected() -> None:
    """A root of D outside the circle means noise without bound."""
    u, e = np.random.default_rng(3).standard_normal((2, 300))
    noise = apply_filter([1.0], [1.0, -1.02], 0.3 * e)
    data = Dataset(u=u, y=apply_filter(B, [1.0, -0.5], u) + noise, Ts=1.0)

    free, inside = (bj(data, nb=2, nc=0, nd=1, nf=1, stable=x) for x in (False, True))
    plain = oe(data, nb=2, nf=1, stable=True)

    assert np.roots(free.D)[0] > 1.01
    assert any(w.startswith("a pole is unstable, |z| = 1.0") for w in free.warnings)
    np.testing.assert_allclose(np.roots(inside.D), 1 / np.roots(free.D), rtol=1e-9)
    assert largest_unstable(inside) == largest_unstable(plain) == 0.0


@pytest.mark.parametrize("name", ESTIMATORS)
def test_unstable_poles_are_reported_or_reflected_with_the_option_stable(name: str) -> None:
    data = _growing()

    free, inside = ESTIMATORS[name](data), ESTIMATORS[name](data, stable=True)

    [said] = [w for w in free.warnings if w.startswith("a pole is unstable, |z| = 1.0")]
    assert said.endswith("else lower the orders, or set the option stable")
    expected = np.roots(free.A)
    expected = np.sort(np.where(np.abs(expected) > 1, 1 / expected, expected))
    np.testing.assert_allclose(np.sort(np.roots(inside.A)), expected, rtol=1e-9)
    assert any("1 of 2 poles were reflected" in w for w in inside.warnings)
    assert not any("unstable" in w for w in inside.warnings)
    assert not np.allclose(inside.B, free.B)
    assert inside.loss > free.loss


@pytest.mark.parametrize("name", ["arx", "armax", "n4sid", "pem"])
def test_b_is_the_best_for_the_reflected_poles(name: str) -> None:
    data = _growing()
    fit = ESTIMATORS[name](data, stable=True)

    e = _errors(fit, data, fit.B)

    for step in (np.array([0.0, 1e-3, 0.0]), np.array([0.0, 0.0, 1e-3])):
        for sign in (1, -1):
            assert _errors(fit, data, fit.B + sign * step) > e


def _errors(fit: Fit, data: Dataset, B: np.ndarray) -> float:
    """Return the sum of squared one-step errors, the predictor's first state fitted."""
    e = apply_filter(fit.A, fit.C, data.y) - apply_filter(B, fit.C, data.u)
    count = fit.A.size - 1
    if fit.C.size == 1:  # the first errors look back on what is not known
        return float(np.sum(e[count:] ** 2))
    pulses = np.column_stack([apply_filter([1.0], fit.C, np.eye(data.N)[k]) for k in range(count)])
    return float(np.linalg.lstsq(pulses, e, rcond=None)[1][0])


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_stable_model_is_unchanged(name: str) -> None:
    data = _growing(0.9)

    free, inside = ESTIMATORS[name](data), ESTIMATORS[name](data, stable=True)

    np.testing.assert_array_equal(free.theta, inside.theta)
    assert free.warnings == inside.warnings
    assert not any("unstable" in w or "reflected" in w for w in free.warnings)


@pytest.mark.parametrize(
    ("poles", "of", "remedy"),
    [
        ({1.2: 0.01}, {}, "if the rig is unstable, predict"),
        ({1.2: 0.3}, {}, "its standard deviation is 0.3, so the data do not determine"),
        ({1.2: 0.3}, {"integrator": True}, "if the rig is unstable, predict"),
        ({0.3: 0.5, 1.2: 0.01}, {}, "if the rig is unstable, predict"),
        ({1.002: 0.001}, {}, "the pole is 1 within its accuracy; if y integrates, use OE"),
        ({1.002: 0.001}, {"structure": "bj"}, "the pole is 1 within its accuracy; if y integ"),
        ({1.004: 0.001}, {}, "if the rig is unstable, predict"),
        ({1.004: 0.001}, {"output": "theta_1"}, "theta_1 integrates, so use OE"),
        ({1.002: 0.001}, {"output": "theta_1"}, "the pole is 1 within its accuracy; theta_1 integ"),
        ({1.03: 0.001}, {"output": "theta_1"}, "if the rig is unstable, predict"),
        ({-1.002: 0.001}, {}, "if the rig is unstable, predict"),
        ({0.9: 0.001, 1.0: 0.001}, {}, "the pole is 1 within its accuracy"),
        ({0.999: 0.05, 1.5: 0.01}, {}, "if the rig is unstable, predict"),
        ({1.0001: 0.001, 1.2: 0.01}, {}, "if the rig is unstable, predict"),
        ({1.0 + 0.01j: 0.05, 1.0 - 0.01j: 0.05}, {}, "if the rig is unstable, predict"),
    ],
)
def test_the_remedy_depends_on_which_polynomial_has_the_unstable_pole(
    poles: dict[complex, float], of: dict[str, Any], remedy: str
) -> None:
    found = SimpleNamespace(values=np.array([*poles], complex), std=np.array([*poles.values()]))
    fit = {"structure": "arx", "integrator": False, "output": "y", "poles": lambda: found} | of

    farthest = max(map(abs, poles))
    text, found_remedy = _way_out(SimpleNamespace(**fit), farthest)  # type: ignore[arg-type]

    assert text.startswith(remedy)
    expected = "structure" if "use OE" in text else ""
    expected = "integrator" if text.endswith("set the option integrator") else expected
    assert found_remedy == ("order" if "lower the orders" in text else expected)
    assert ("set the option integrator" in text) == (of.get("structure") == "bj")


def test_a_fixed_integrator_is_not_an_unstable_pole() -> None:
    data = _growing(1.0)

    fit = armax(data, na=2, nb=2, nc=1, integrator=True, stable=True)

    assert largest_unstable(fit) == 0.0
    assert abs(np.sum(fit.A)) < 1e-12
    assert not any("unstable" in w for w in fit.warnings)


@pytest.mark.parametrize(
    ("poles", "moved"),
    [([1.0, 0.3], "1 of 2"), ([-1.0, 1.2, 0.5], "2 of 3"), ([0.9999, 0.3], ""), ([1.1], "1 of 1")],
)
def test_poles_on_the_circle_are_counted_among_the_reflected(
    poles: list[float], moved: str
) -> None:
    before = np.poly(poles)

    told = list(reflection_warnings(before, stabilise(before)))

    assert [x.text.partition(" poles")[0] for x in told] == ([moved] if moved else [])
    assert all(f"the farthest from |z| = {max(np.abs(poles)):.4f}" in x.text for x in told)
    assert not list(reflection_warnings(before, before))


def test_roots_outside_the_circle_are_reflected_or_moved_inside() -> None:
    """Roots outside move to 1/z*, roots on the circle just inside; roots inside stay."""
    pair = 1.25 * np.exp(0.7j)
    inside = np.array([1.0, -0.5])

    mirrored = np.roots(stabilise(np.real(np.poly([pair, pair.conjugate(), 0.3]))))

    np.testing.assert_allclose(np.sort(np.abs(mirrored)), [0.3, 0.8, 0.8])
    np.testing.assert_allclose(np.abs(np.angle(mirrored[mirrored.imag != 0])), 0.7)
    assert 1 - 2e-6 < -stabilise(np.array([1.0, -1.0]))[1] < 1
    assert stabilise(inside) is inside
