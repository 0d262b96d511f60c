"""The methods against themselves written out by hand, and against the exact solution."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin
from typing import Any

import numpy as np
import pytest
from armrig.physics.integrators.accuracy import convergence, sinusoid
from armrig.physics.integrators.methods import METHODS
from armrig.physics.integrators.stability import stability_limit
from armrig.physics.integrators.stepping import integrate
from armrig_core.rig.arm import ArmParameters, arm_matrices
from numpy.typing import NDArray

Vector = NDArray[np.float64]
EVERY = pytest.mark.parametrize("method", METHODS)
ORDERS = {"forward_euler": 1, "ab2": 2, "trapezoidal": 2, "heun": 2, "midpoint": 2}


def u(t: float) -> Vector:
    return np.array([sin(3 * t) + 1, cos(t)])


def by_hand(method: str, A: Vector, B: Vector, x: Vector, h: float, n: int) -> Vector:
    """Return (n + 1, nx), one step after the other, as a textbook writes it."""

    def f(t: float, x: Vector) -> Vector:
        return A @ x + B @ u(t)

    def heun(t: float, x: Vector) -> Vector:
        first = f(t, x)
        return x + h / 2 * (first + f(t + h, x + h * first))

    states = [x]
    for k in range(n):
        t = k * h
        if method == "forward_euler":
            x = x + h * f(t, x)
        elif method == "heun" or (method == "ab2" and k == 0):
            x = heun(t, x)
        elif method == "midpoint":
            x = x + h * f(t + h / 2, x + h / 2 * f(t, x))
        elif method == "ab2":
            x = x + h / 2 * (3 * f(t, x) - f(t - h, states[-2]))
        else:
            right = x + h / 2 * (f(t, x) + B @ u(t + h))
            x = np.linalg.solve(np.eye(x.size) - h / 2 * A, right)
        states.append(x)
    return np.array(states)


@EVERY
@pytest.mark.parametrize("n", [1, 2, 57])
def test_each_method_matches_the_formula_of_the_textbook(method: str, n: int) -> None:
    rng = np.random.default_rng(1)
    A, B, x0 = rng.normal(size=(3, 3)) - 2 * np.eye(3), rng.normal(size=(3, 2)), np.ones(3)

    t, x = integrate(A, B, u, x0, 0.05, n, method)

    np.testing.assert_allclose(x, by_hand(method, A, B, x0, 0.05, n), rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(t, 0.05 * np.arange(n + 1))


@EVERY
def test_halving_the_step_divides_the_error_by_two_to_the_order(
    method: str, params: ArmParameters
) -> None:
    """For a sinusoid on the handout's arm and on four others, the observed order within 0.05."""
    A, B, _ = arm_matrices(params)
    problem = sinusoid(A, B, amplitude=2.0, omega=5.0, span=0.5)
    h = stability_limit(A, "heun") * np.array([1 / 128, 1 / 256])

    assert convergence(problem, method, h).order == pytest.approx(ORDERS[method], abs=0.05)


def test_unbounded_growth_causes_no_numpy_warning() -> None:
    """Ten times beyond the limit the states overflow."""
    A, B, _ = arm_matrices(ArmParameters())

    _, x = integrate(A, B[:, 0], lambda t: 1.0, np.zeros(4), 0.5, 3000, "forward_euler")

    assert not np.isfinite(x[-1]).all()
    assert np.isfinite(x[:50]).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method": "rk4"}, "method='rk4' is none of forward_euler, ab2"),
        ({"h": 0.0}, "h=0.0 must be finite and > 0"),
        ({"n": 0}, "n=0 must be an integer >= 1"),
        ({"x0": [0.0]}, r"x0 has shape \(1,\).*must be \(2,\)"),
        ({"A": [[1.0, 2.0]]}, r"A has shape \(1, 2\), but must be \(n, n\)"),
        ({"B": [1.0, 2.0, 3.0]}, r"B has shape \(3,\)"),
        ({"u": lambda t: [1.0, 2.0]}, r"u\(t\) returns 2 numbers, but B takes 1"),
        ({"A": [[0.0, np.nan], [0.0, 0.0]]}, "A contains a number that is not finite"),
    ],
)
def test_impossible_arguments_are_refused(changes: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {"A": [[0.0, 1.0], [-1.0, -1.0]], "B": [0.0, 1.0]}
    given |= {"u": (lambda t: 1.0), "x0": [0.0, 0.0], "h": 0.1, "n": 3, "method": "heun"}
    one: Callable[..., Any] = integrate

    with pytest.raises(ValueError, match=message):
        one(**(given | changes))
