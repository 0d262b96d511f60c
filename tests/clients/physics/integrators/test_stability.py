"""Stability limits: closed forms, the solution on both sides, and the odd cases."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from armrig.physics.integrators.methods import METHODS, amplification
from armrig.physics.integrators.stability import _positive_roots, stability_limit
from armrig.physics.integrators.stepping import integrate, system
from armrig_core.rig.arm import ArmParameters, arm_matrices
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

EXPLICIT = ("forward_euler", "ab2", "heun", "midpoint")
OSCILLATOR = np.array([[0.0, 1.0], [-4.0, 0.0]])
TWICE = np.kron(np.eye(2), OSCILLATOR)
COUPLED = TWICE + np.kron([[0.0, 1.0], [0.0, 0.0]], np.eye(2))


def pair(real: float, imaginary: float) -> np.ndarray:
    """Return a matrix with these two eigenvalues, real ± i imaginary."""
    return np.array([[real, imaginary], [-imaginary, real]])


@settings(max_examples=40)
@given(st.floats(-50.0, -1e-3), st.floats(0.0, 50.0))
def test_the_limit_of_forward_euler_follows_from_its_circle(real: float, imaginary: float) -> None:
    """|1 + h lambda| = 1 at h = -2 Re lambda / |lambda|²."""
    limit = stability_limit(pair(real, imaginary), "forward_euler")

    assert limit == pytest.approx(-2 * real / (real**2 + imaginary**2), rel=1e-6)


@given(st.floats(-50.0, -0.01), st.floats(0.0, 50.0), st.sampled_from(EXPLICIT))
def test_the_limit_is_where_the_largest_root_meets_the_circle(
    real: float, imaginary: float, method: str
) -> None:
    z = complex(real, imaginary) * stability_limit(pair(real, imaginary), method)

    sizes = amplification(METHODS[method], z * np.linspace(0.01, 0.9999, 100))
    assert sizes.max() <= 1
    assert amplification(METHODS[method], np.array(1.0001 * z)) > 1


def growth(A: ArrayLike, method: str, h: float, *, n: int) -> float:
    """Return the largest |x(k+1) - x(k)| of all modes at the end of n steps over the middle's."""
    A_, *_ = system(A, np.zeros(np.shape(A)[0]))
    x0 = np.real(np.linalg.eig(A_)[1].sum(axis=1))
    _, x = integrate(A_, np.zeros(x0.size), lambda t: 0.0, x0, h, n, method)
    with np.errstate(over="ignore", invalid="ignore"):
        speed = np.linalg.norm(np.diff(x, axis=0), axis=1)
    middle, last = (float(speed[k - n // 10 : k].max()) for k in (n // 2, n))
    return last / middle if np.isfinite(last) else inf


@pytest.mark.parametrize(
    ("method", "reach"),
    [("forward_euler", 2.0), ("ab2", 1.0), ("heun", 2.0), ("midpoint", 2.0), ("trapezoidal", inf)],
)
def test_a_decay_is_followed_as_far_as_the_region_reaches(method: str, reach: float) -> None:
    """On the real axis these are the textbook's intervals; twice the same decay is no growth."""
    for A in ([[-4.0]], [[-4.0, 1.0], [0.0, -4.0]], np.diag([-4.0, -4.0, 0.0])):
        assert stability_limit(A, method) == pytest.approx(reach / 4, rel=1e-6)


def test_the_stability_limits_of_the_arm_equal_the_handout() -> None:
    """The oscillation limits forward Euler and AB(2), the decay of -36.739 1/s limits RK(2)."""
    A, _, _ = arm_matrices(ArmParameters())

    limits = {m: stability_limit(A, m) for m in METHODS}

    assert limits["forward_euler"] == pytest.approx(2 * 8.0479 / (8.0479**2 + 17.081**2), rel=1e-3)
    assert limits["ab2"] == pytest.approx(1 / 36.739, rel=1e-4)
    assert limits["heun"] == limits["midpoint"] == pytest.approx(2 / 36.739, rel=1e-4)
    assert limits["trapezoidal"] == inf


@pytest.mark.parametrize("method", EXPLICIT)
def test_a_step_is_stable_just_inside_the_limit_and_not_just_outside(
    method: str, params: ArmParameters
) -> None:
    """The solution itself shows it, for the handout's arm and four others."""
    A, _, _ = arm_matrices(params)
    limit = stability_limit(A, method)

    assert growth(A, method, 0.999 * limit, n=5000) < 1
    assert growth(A, method, 1.001 * limit, n=5000) > 1


@given(st.floats(-50.0, 50.0), st.floats(0.0, 50.0), st.sampled_from(tuple(METHODS)))
def test_the_steps_obey_the_stability_polynomial(
    real: float, imaginary: float, method: str
) -> None:
    """Sum pi_j(h lambda) x(n+j) = 0 for x' = lambda x; two real states make a complex one."""
    h, eigenvalue = 0.01, complex(real, -imaginary)

    _, states = integrate(
        pair(real, imaginary), [0.0, 0.0], lambda _: 0.0, [1.0, 0.0], h, 6, method
    )

    x = states[:, 0] + 1j * states[:, 1]
    pi = [np.polyval(row[::-1], h * eigenvalue) for row in METHODS[method].stability_polynomial]
    left = sum(p * x[j : x.size - len(pi) + 1 + j] for j, p in enumerate(pi))
    assert np.abs(left).max() < 1e-12 * np.abs(x).max()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("A", "explicit", "trapezoidal"),
    [
        pytest.param([[0.0]], inf, inf, id="a constant"),
        pytest.param(np.zeros((2, 2)), inf, inf, id="two constants"),
        pytest.param([[0.0, 1.0], [0.0, 0.0]], 0.0, 0.0, id="double integrator"),
        pytest.param([[1e-9]], 0.0, 0.0, id="slow growth"),
        pytest.param([[2.0]], 0.0, 0.0, id="growth"),
        pytest.param(OSCILLATOR, 0.0, inf, id="oscillator"),
        pytest.param(TWICE, 0.0, inf, id="two oscillators"),
        pytest.param(COUPLED, 0.0, 0.0, id="oscillator that drives its like"),
    ],
)
def test_the_limit_of_a_marginal_or_unstable_system_depends_on_the_method(
    method: str, A: np.ndarray, explicit: float, trapezoidal: float
) -> None:
    assert stability_limit(A, method) == (trapezoidal if method == "trapezoidal" else explicit)


def test_only_real_roots_determine_the_limit() -> None:
    """(r - 2)(r² - 2 r + 2) has two complex roots with the same real part."""
    assert _positive_roots(np.array([-4.0, 6.0, -4.0, 1.0])) == pytest.approx([2.0])


@pytest.mark.parametrize("name", ["A", "B", "x0"])
def test_a_complex_system_is_refused(name: str) -> None:
    """The imaginary parts were dropped, which doubled the step."""
    asked = {"A": [[-1.0]], "B": [1.0], "x0": [0.0]} | {name: np.array([[-1 + 1j]])}

    with pytest.raises(ValueError, match=f"{name} is complex: give the real system of twice"):
        system(**asked)
